"""Residuals of the corrected wrench against the payload's, and what they are claimed to be."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truewrench import _core
from truewrench.estimation.inertial import InertialChunk, InertialMotion
from truewrench.estimation.reference_clock import with_reference_on_time
from truewrench.estimation.unknowns import payload_rates
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.temperature import at_reference_temperature

LONGEST_LAG = 60
"""Rows over which the correlation in time, which the motion brings, is followed."""

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
    systematic: Array  # (M, 6, k) columns whose squares add up to the variance by gain and payload
    begin: tuple[int, ...]  # where chunks begin
    lagged: Array  # (LONGEST_LAG + 1, 6) mean motion covariance at 0, 1, ... rows
    period: float  # [s]
    time_offset: float
    rows: Integers  # (M,) of the log


def tared(rig: Rig) -> bool:
    """Whether offsets may differ from log to log, so that a constant says nothing of the gain."""
    return bool(rig.sensor.offset_prior_array.any())


def residuals(calibration: Calibration, rig: Rig, log: Log) -> Residuals:
    """Residuals of one log with the nominal and the calibration's gain.

    Against the wrench by the motion, or against reference wrenches where the log has them.
    """
    log, _ = with_reference_on_time(rig, log)
    compensated = at_reference_temperature(calibration.offset_temperature, calibration.rig, log)
    by_another = _by_motion if log.reference is None else _by_reference
    known = by_another(calibration, rig, compensated)
    sensor = rig.sensor
    inverse = np.nan_to_num(calibration.inverse)
    nominal_inverse = _core.generalised_inverse(sensor.nominal_gain_array, sensor.noise_array)
    wrench, payload = known.wrench, known.payload
    old = log.raw[known.rows] @ nominal_inverse.T - wrench
    new = compensated.raw[known.rows] @ inverse.T - wrench
    n, P, size = sensor.n, calibration.covariance, 6 * sensor.n
    if tared(rig):
        old, new = old - old.mean(axis=0), new - new.mean(axis=0)
        wrench = wrench - wrench.mean(axis=0)
        payload = payload - payload.mean(axis=0)
    else:
        new = new - calibration.offset @ inverse.T
    # the gain's part: -C^+ dC w, a random row vector g times w per axis
    of_gain = P[:size, :size].reshape(n, 6, n, 6)
    columns = np.empty((len(new), 6, 6 + payload.shape[2]))
    for i in range(6):
        Q = np.einsum("a,ajbk,b->jk", inverse[i], of_gain, inverse[i])
        values, axes = np.linalg.eigh(Q)
        columns[:, i, :6] = wrench @ (axes * np.sqrt(np.maximum(values, 0.0)))
    columns[:, :, 6:] = payload
    return Residuals(
        old,
        new,
        wrench,
        known.variance + inverse**2 @ sensor.noise_array**2,
        known.variance + nominal_inverse**2 @ sensor.noise_array**2,
        columns,
        known.begin,
        known.lagged,
        float(np.median(np.diff(log.time[known.rows]))),
        known.time_offset,
        known.rows,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """The payload's wrench at M rows of a log, by something else than the sensor."""

    rows: Integers
    wrench: Array  # (M, 6)
    variance: Array  # (M, 6)
    payload: Array  # (M, 6, k) of its errors, those that the payload brings
    begin: tuple[int, ...]
    lagged: Array
    time_offset: float


def _by_motion(calibration: Calibration, rig: Rig, log: Log) -> _Known:
    sensor = rig.sensor
    tau = calibration.time_offset + log.advance()
    motion = InertialMotion(rig, log)
    chunks = _compared(motion, log, tau)
    if sensor.time_offset_prior > 0.0:
        inverse = np.nan_to_num(calibration.inverse)
        tau += _time_offset(chunks, log.raw, inverse, sensor.noise_array, sensor.time_offset_prior)
        chunks = _compared(motion, log, tau)
    rows, wrench, variance, twist, acceleration, gravity = (
        np.concatenate([getattr(chunk, name) for chunk in chunks])
        for name in ("rows", "wrench", "variance", "twist", "acceleration", "gravity")
    )
    lags = min(chunk.covariance.shape[1] for chunk in chunks)
    lagged = np.zeros((LONGEST_LAG + 1, 6))
    lagged[:lags] = np.mean([chunk.covariance[:, :lags].mean(axis=0) for chunk in chunks], axis=0)
    payload = _payload_columns(rig, calibration, log.payload, twist, acceleration, gravity)
    begin = np.cumsum([0, *(len(chunk.rows) for chunk in chunks)])[:-1].tolist()
    return _Known(rows, wrench, variance, payload, tuple(begin), lagged, tau)


def _by_reference(calibration: Calibration, rig: Rig, log: Log) -> _Known:
    assert log.reference is not None
    if rig.reference_noise is None:
        expected = "six numbers, 1 sigma of ref_fx ... ref_mz, which the log has"
        raise InputError.at(rig.path, "reference_noise", "nothing", expected)
    rows = np.flatnonzero(np.isfinite(log.raw).all(axis=1) & np.isfinite(log.reference).all(axis=1))
    if rows.size < 2 * _FEWEST:
        found = f"{rows.size} rows with raw channels and reference"
        raise InputError.at(log.path, "", found, f"at least {2 * _FEWEST}")
    variance = np.broadcast_to(np.square(rig.reference_noise), (rows.size, 6))
    lagged = np.zeros((LONGEST_LAG + 1, 6))
    lagged[0] = variance[0]
    none = np.zeros((rows.size, 6, 0))
    return _Known(rows, log.reference[rows], variance, none, (0,), lagged, calibration.time_offset)


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


def _time_offset(
    chunks: Sequence[InertialChunk], raw: Array, inverse: Array, noise: Array, prior: float
) -> float:
    """Change of the time offset that the residuals ask for, to first order, under its prior."""
    rows, wrench, rate, variance = (
        np.concatenate([getattr(chunk, name) for chunk in chunks])
        for name in ("rows", "wrench", "rate", "variance")
    )
    residual = raw[rows] @ inverse.T - wrench
    residual, rate = residual - residual.mean(axis=0), rate - rate.mean(axis=0)
    weight = 1.0 / (variance + inverse**2 @ noise**2)
    return float(np.sum(weight * rate * residual) / (np.sum(weight * rate**2) + prior**-2.0))


def _payload_columns(
    rig: Rig, calibration: Calibration, payload: str, twist: Array, acceleration: Array, gravity: Array
) -> Array:
    """(M, 6, 10) change of the wrench for 1 sigma of mass, centre of mass and inertia; none if exact.

    The payload that the gain was found with cannot contradict it: its errors are in both.
    """
    spec = rig.payloads[payload]
    if spec.exact or payload in {report.payload for report in calibration.logs}:
        return np.zeros((len(twist), 6, 0))
    rates = payload_rates(rig, payload, twist, acceleration, gravity)
    return np.asarray(rates * rig.sensor.range_array[:, None] * spec.uncertainty.of_each)


def joined_columns(parts: Sequence[Array]) -> Array:
    """Systematic columns of all logs: those of the gain are common, each payload's its own."""
    total = 6 + sum(part.shape[2] - 6 for part in parts)
    joined, column = [], 6
    for part in parts:
        wide = np.zeros((*part.shape[:2], total))
        wide[:, :, :6] = part[:, :, :6]
        own = part.shape[2] - 6
        wide[:, :, column : column + own] = part[:, :, 6:]
        column += own
        joined.append(wide)
    return np.concatenate(joined)
