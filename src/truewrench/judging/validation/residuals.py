"""Residuals of the corrected wrench against the payload's, and what they are claimed to be."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from truewrench import _core
from truewrench.estimation.inertial import InertialChunk, InertialMotion
from truewrench.estimation.reference_clock import with_reference_on_time
from truewrench.estimation.static_poses import stands_still
from truewrench.estimation.unknowns import payload_rates, tilt_rates
from truewrench.judging.validation.at_rest import at_rest, poses_of
from truewrench.judging.validation.errors import (
    Carried,
    axis_covariance,
    carried,
    factor,
    fitted,
    joint_covariance,
)
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.payload import lever, payload_wrench
from truewrench.model.rig import Rig
from truewrench.model.temperature import at_reference_temperature
from truewrench.robot.compensation import subtracted, uncompensated

LONGEST_LAG = 60  # rows over which the correlation in time, which the motion brings, is followed

_FEWEST = 10  # rows of a stretch
_EDGE = 4.0  # times the median of the motion's variance: ends of splines, not compared


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Of one log."""

    old: Array  # (M, 6)
    new: Array  # (M, 6)
    wrench: Array  # (M, 6) without its mean
    noise: Array  # (M, 6) variance by sensor and motion
    nominal_noise: Array  # (M, 6) the same, the sensor's through the nominal gain
    payload: str  # that it carries
    carried: Carried | None  # the same as the calibration knows it; None where it brings no error
    by_payload: Array  # (M, 6, 10 or none) derivative of the wrench by it, without its mean
    # (M, 6, k) of 1 sigma of what is left of the log's own: gravity's tilt by root frame, or an IMU's biases
    by_own: Array
    begin: tuple[int, ...]  # where chunks begin
    # (LONGEST_LAG + 1, 6) mean of the motion's covariance at 0, 1, ... rows over the noise; of the walk of an
    # offset the root mean square: it has (tr V)^2 / sum V_tu^2 degrees of freedom
    lagged: Array
    period: float  # [s]
    time_offset: float
    tilt: Array  # (R, 2) of gravity, that the residuals ask for, under its prior [rad]
    rows: Integers  # (M,) of the log
    at_rest: bool  # static poses, a row each


def tared(rig: Rig) -> bool:
    """Whether offsets may differ from log to log, so that a constant says nothing of the gain."""
    return bool(rig.sensor.offset_prior_array.any())


def residuals(calibration: Calibration, rig: Rig, log: Log) -> Residuals:
    """Residuals of one log with the nominal and the calibration's gain.

    Against the wrench by the motion, the weight in static poses, or reference wrenches where a log has them.
    """
    log, _ = with_reference_on_time(rig, log)
    compensated = at_reference_temperature(calibration.offset_temperature, calibration.rig, log)
    still = log.reference is None and rig.in_gravity and stands_still(rig, log)
    if log.reference is not None:
        known = _by_reference(calibration, rig, compensated)
    elif still:
        [whole] = uncompensated(rig, [compensated])
        log, compensated = (poses_of(rig, of)[0] for of in (log, compensated))
        known = _by_weight(calibration, rig, whole, compensated)
    else:
        known = _by_motion(calibration, rig, compensated)
    sensor = rig.sensor
    inverse = np.nan_to_num(calibration.inverse)
    nominal_inverse = _core.generalised_inverse(sensor.nominal_gain_array, sensor.noise_array)
    wrench, by_payload, by_own = known.wrench, known.by_payload, known.by_own
    old = (log.raw[known.rows] + known.weight) @ nominal_inverse.T - wrench
    new = (compensated.raw[known.rows] + known.weight) @ inverse.T - wrench
    if tared(rig):
        old, new, wrench, by_payload, by_own = (
            x - x.mean(axis=0) for x in (old, new, wrench, by_payload, by_own)
        )
    else:
        new = new - calibration.offset @ inverse.T
    return Residuals(
        old,
        new,
        wrench,
        known.variance + known.channels @ (inverse**2).T,
        known.variance + known.channels @ (nominal_inverse**2).T,
        log.payload,
        known.carried,
        by_payload,
        by_own,
        known.begin,
        known.lagged,
        float(np.median(np.diff(log.time[known.rows]))),
        known.time_offset,
        known.tilt,
        known.rows,
        still,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """The payload's wrench at M rows of a log, of poses one each, by something else than the sensor."""

    rows: Integers
    weight: Array  # (M, n) channels of what the driver subtracted
    channels: Array  # (n,), or (M, n), variance of the channels
    wrench: Array  # (M, 6)
    variance: Array  # (M, 6)
    begin: tuple[int, ...]
    lagged: Array
    time_offset: float
    by_payload: Array
    by_own: Array
    tilt: Array = field(default_factory=lambda: np.zeros((1, 2)))
    carried: Carried | None = None


def _by_motion(calibration: Calibration, rig: Rig, log: Log) -> _Known:
    """With tilt of gravity or biases of an IMU, and the clock, as the residuals ask for, under priors."""
    sensor, inverse = rig.sensor, np.nan_to_num(calibration.inverse)
    body = carried(calibration, rig, log.payload)
    at = calibration.time_offset + log.advance()
    [whole] = uncompensated(rig, [log], at)
    motion = InertialMotion(rig, whole, body.body)
    of_sensor = inverse**2 @ sensor.noise_array**2
    moved = _moved(rig, log, motion, body, at, of_sensor)
    rate = moved.rate - subtracted(rig, moved.fall_rate) @ inverse.T
    prior = np.array([*_own_prior(rig, moved), sensor.time_offset_prior])
    own, P = fitted(
        joint_covariance(calibration, [body]),
        prior,
        whole.raw[moved.rows] @ inverse.T - moved.wrench,
        moved.wrench,
        moved.by_payload,
        np.concatenate([moved.by_own, rate[..., None]], axis=2),
        moved.variance + of_sensor,
    )
    own, later = own[:-1], float(own[-1])
    if later != 0.0:
        moved = _moved(rig, log, motion, body, at + later, of_sensor)
    return _Known(
        moved.rows,
        (whole.raw - log.raw)[moved.rows] + later * subtracted(rig, moved.fall_rate),
        sensor.noise_array**2,
        moved.wrench + moved.by_own @ own,
        moved.variance,
        moved.begin,
        moved.lagged,
        at + later,
        moved.by_payload,
        moved.by_own @ factor(P[:-1, :-1]),
        np.zeros((1, 2)) if rig.motion.source == "imu" else own.reshape(-1, 2),
        body if body.covariance.any() else None,
    )


def _by_reference(calibration: Calibration, rig: Rig, log: Log) -> _Known:
    assert log.reference is not None
    if rig.reference_noise is None:
        expected = "six numbers, 1 sigma of ref_fx ... ref_mz, which the log has"
        raise InputError.at(rig.path, "reference_noise", "nothing", expected)
    [whole] = uncompensated(rig, [log])
    rows = np.flatnonzero(np.isfinite(whole.raw).all(axis=1) & np.isfinite(log.reference).all(axis=1))
    if rows.size < 2 * _FEWEST:
        found = f"{rows.size} rows with raw channels and reference"
        raise InputError.at(log.path, "", found, f"at least {2 * _FEWEST}")
    variance = np.broadcast_to(np.square(rig.reference_noise), (rows.size, 6))
    lagged = np.zeros((LONGEST_LAG + 1, 6))  # white
    none = np.zeros((rows.size, 6, 0))
    wrench, time_offset, weight = log.reference[rows], calibration.time_offset, (whole.raw - log.raw)[rows]
    channels = rig.sensor.noise_array**2
    return _Known(rows, weight, channels, wrench, variance, (0,), lagged, time_offset, none, none)


def _by_weight(calibration: Calibration, rig: Rig, whole: Log, bare: Log) -> _Known:
    """In static poses, with gravity's tilt as their residuals ask for it, under its prior.

    `whole` is the log with what its driver subtracted, `bare` a row for each pose without.
    """
    inverse = np.nan_to_num(calibration.inverse)
    body = carried(calibration, rig, whole.payload)
    short, poses = poses_of(rig, whole)
    fall, still = short.gravity, np.zeros((len(short.raw), 6))
    assert fall is not None

    def weighed(g: Array) -> Array:
        return payload_wrench(rig, whole.payload, still, still, g, body.body)

    wrench = weighed(fall)
    rest = at_rest(rig, whole, poses, wrench)
    by_tilt = np.stack([weighed(fall + change) - wrench for change in rest.by_tilt], axis=2)
    size, spread = len(fall), inverse**2 @ rig.sensor.channel_scale**2
    walk = np.diag(rest.walk)[:, None] * spread
    noise = walk + rest.variance @ (inverse**2).T
    by_payload = payload_rates(rig, whole.payload, still, still, fall) * rig.sensor.range_array[:, None]
    tilt = np.zeros(2)
    if rest.common:
        residual, joint = short.raw @ inverse.T - wrench, joint_covariance(calibration, [body])
        tilt, P = fitted(joint, np.ones(2), residual, wrench, by_payload, by_tilt, noise)
        wrench, by_own = wrench + by_tilt @ tilt, by_tilt @ factor(P)
    else:  # nothing tells how a pose is turned about gravity: to each its own
        by_own = np.zeros((size, 6, size, 2))
        by_own[np.arange(size), :, np.arange(size)] = by_tilt
    lagged = np.zeros((LONGEST_LAG + 1, 6))
    for lag in range(min(size, LONGEST_LAG + 1)):
        lagged[lag] = np.sqrt(np.sum(np.diagonal(rest.walk, lag) ** 2) / size) * spread / noise.mean(axis=0)
    return _Known(
        np.arange(size),
        short.raw - bare.raw,
        rest.variance,
        wrench,
        walk,
        (0,),
        lagged,
        0.0,
        by_payload,
        by_own.reshape(size, 6, -1),
        rig.gravity_tilt_prior * tilt[None],
        body if body.covariance.any() else None,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Moved:
    """The wrench of a body by its motion at M rows of a log, and its derivatives."""

    rows: Integers
    wrench: Array  # (M, 6)
    variance: Array  # (M, 6)
    rate: Array  # (M, 6) by time
    fall_rate: Array  # (M, 3) of free fall in sensor axes, likewise
    by_payload: Array  # (M, 6, 10)
    by_own: Array  # (M, 6, 2R) by gravity's tilt, zero on orbit; (M, 6, 6) by an IMU's readings
    begin: tuple[int, ...]
    lagged: Array


def _moved(
    rig: Rig, log: Log, motion: InertialMotion, body: Carried, time_offset: float, of_sensor: Array
) -> _Moved:
    chunks = _compared(motion, log, time_offset)
    rows, wrench, variance, rate, twist, acceleration, gravity = (
        np.concatenate([getattr(chunk, name) for chunk in chunks])
        for name in ("rows", "wrench", "variance", "rate", "twist", "acceleration", "gravity")
    )
    lags = min(chunk.covariance.shape[1] for chunk in chunks)
    lagged = np.zeros((LONGEST_LAG + 1, 6))
    lagged[:lags] = np.average(
        [_correlation(chunk, of_sensor, lags) for chunk in chunks],
        axis=0,
        weights=[len(chunk.rows) for chunk in chunks],
    )
    by_payload = payload_rates(rig, log.payload, twist, acceleration, gravity)
    by_own = np.zeros((rows.size, 6, 2))
    if rig.motion.source == "imu":
        shift = _core.twist_shift(lever(rig, log.payload, body.body))
        by_a, by_nu = _core.payload_jacobians(body.body, np.ascontiguousarray(twist @ shift.T))
        by_own = np.concatenate([(by_a @ shift)[..., :3], (by_nu @ shift)[..., 3:]], axis=2) * rig.sensor.sign
    elif rig.in_gravity:
        at = log.time[rows] + time_offset

        def felt(nu: Array, a: Array, g: Array) -> Array:
            return payload_wrench(rig, log.payload, nu, a, g, body.body)

        by_own = tilt_rates(rig, log, at, twist, acceleration, gravity, felt)
    return _Moved(
        rows,
        wrench,
        variance,
        rate,
        np.cross(gravity, twist[:, 3:]),
        by_payload * rig.sensor.range_array[:, None],
        by_own,
        tuple(np.cumsum([0, *(len(chunk.rows) for chunk in chunks)])[:-1].tolist()),
        lagged,
    )


def _own_prior(rig: Rig, moved: _Moved) -> Array:
    """1 sigma of each of the log's own parameters."""
    count = moved.by_own.shape[2]
    if rig.motion.source != "imu":
        return np.full(count, rig.gravity_tilt_prior)
    biases = rig.motion.accelerometer_bias_prior or 0.0, rig.motion.gyro_bias_prior or 0.0
    return np.repeat(biases, count // 2)


def _correlation(chunk: InertialChunk, of_sensor: Array, lags: int) -> Array:
    """(lags, 6) covariance by the motion over the noise: chunks of finer knots have many times as much."""
    noise = chunk.variance + of_sensor
    there = noise[np.minimum(chunk.lagged[:, None] + np.arange(lags), len(noise) - 1)]
    correlation = chunk.covariance[:, :lags] / np.sqrt(noise[chunk.lagged][:, None] * there)
    return np.asarray(correlation.mean(axis=0))


def _compared(motion: InertialMotion, log: Log, time_offset: float) -> list[InertialChunk]:
    """The log's chunks without the ends of splines, where the velocities tell little of the acceleration."""
    chunks = motion.wrench(time_offset, LONGEST_LAG) or motion.wrench(time_offset, _FEWEST)
    if not chunks:
        raise InputError.at(log.path, "", "no stretch of motion and raw channels", "at least 2 s of both")
    usual = np.median(np.concatenate([chunk.variance for chunk in chunks]), axis=0)
    trimmed = []
    for chunk in chunks:
        inside = np.flatnonzero((chunk.variance <= _EDGE * usual).all(axis=1))
        if inside.size <= _FEWEST:
            continue
        cut = slice(int(inside[0]), int(inside[-1]) + 1)
        last = chunk.lagged + chunk.covariance.shape[1] - 1
        whole = (chunk.lagged >= cut.start) & (last < cut.stop)
        trimmed.append(
            replace(
                chunk,
                **{
                    name: getattr(chunk, name)[cut]
                    for name in ("rows", "wrench", "rate", "twist", "acceleration", "gravity", "variance")
                },
                lagged=chunk.lagged[whole] - cut.start,
                covariance=chunk.covariance[whole] if whole.any() else chunk.covariance,
            )
        )
    if not trimmed:
        raise InputError.at(log.path, "", "too few rows", "at least 2 s of motion and raw channels")
    return trimmed


def systematic_columns(calibration: Calibration, parts: Sequence[Residuals]) -> Iterator[Array]:
    """Of each wrench axis (M, k) of all logs: columns whose squares add up to the variance by what is common.

    Errors of the gain are common to all logs, those of a payload to all that carry it, those of a log's own
    parameters to one.
    """
    payloads = {part.payload: part.carried for part in parts if part.carried is not None}
    names, joint = list(payloads), joint_covariance(calibration, list(payloads.values()))
    rows = np.cumsum([0, *(len(part.new) for part in parts)])
    owns = np.cumsum([0, *(part.by_own.shape[2] for part in parts)])
    for axis in range(6):
        L = factor(axis_covariance(joint, axis))
        columns: Array = np.zeros((rows[-1], L.shape[1] + owns[-1]))
        for i, part in enumerate(parts):
            own = columns[rows[i] : rows[i + 1]]
            own[:, : L.shape[1]] = part.wrench @ L[:6]
            if part.carried is not None:
                first = 6 + 10 * names.index(part.payload)
                own[:, : L.shape[1]] += part.by_payload[:, axis] @ L[first : first + 10]
            own[:, L.shape[1] + owns[i] : L.shape[1] + owns[i + 1]] = part.by_own[:, axis]
        yield columns
