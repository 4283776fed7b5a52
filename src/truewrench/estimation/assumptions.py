"""What an estimate assumes, as numbers of its own: made once from a rig, which is neither copied nor altered.

Channels are fractions of R_i = |nominal_i| @ range, wrench axes of range_j (docs/method.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truewrench import _core
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import PayloadSpec, Rig

FIRST_POSITION_NOISE = 1e-6
"""[rad, m] 1 sigma of logged joint positions without a stated one, from which theirs is found."""

_KAPPA_CLOCK, _GAMMA_CLOCK = 0.5, 0.5  # means of (10.4), (10.5) where nothing is known of a filter
_KAPPA_FILTER, _GAMMA_FILTER = 0.0, 1.0  # of a first-order filter of the sensor


# 1 sigma of what is normalised, beyond which it is known, or nothing is: tolerance, of squares in sums
NARROWEST, WIDEST = 1e-9, 1e3


def assumed_gain_prior(rig: Rig) -> float:
    """1 sigma of a normalised gain, beside the estimator of motion: as stated, within what matters."""
    return min(max(rig.sensor.gain_prior, NARROWEST), WIDEST)


def assumed_offset_prior(rig: Rig) -> Array:
    """(n,) of the offsets likewise, fraction of range; 0: there is none."""
    stated = rig.sensor.offset_prior_array / rig.sensor.channel_scale
    return np.where(stated > 0.0, np.clip(stated, NARROWEST, WIDEST), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Assumptions:
    """Numbers that an estimate of n channels assumes; a sigma of 0 holds a parameter at its mean."""

    channel_scale: Array  # (n,) R_i = |nominal_i| @ range: full scale of a channel [raw units]
    range: Array  # (6,) full scale of a wrench axis [N, N m]
    sign: int  # of the wrench: +1 where the sensor feels the payload's reaction
    nominal: Array  # (n, 6) nominal gain, nominal_ij range_j / R_i: mean of C
    gain_prior: float  # 1 sigma of every gain's departure from nominal
    noise: Array  # (n,) 1 sigma of a sample of a channel, fraction of range; a factor is found
    offset_prior: Array  # (n,) 1 sigma of b, fraction of range
    pool_offsets: bool  # one offset for all logs
    slope_prior: float  # 1 sigma of the offset's slope with temperature [fraction of range / K]
    reference_temperature: float  # [degC] at which the offset is told
    gravity: Array  # (3,) free fall in the root frame [m/s^2]
    tilt_prior: float  # 1 sigma of the direction of gravity about two axes [rad]
    bodies: tuple[str, ...]  # names of the payloads, in the order of body_prior
    # (10,) a payload: 1 sigma of log mass, centre of mass [m], inertia xx yy zz xy xz yz [kg m^2]
    body_prior: tuple[Array, ...]
    time_offset_prior: float  # 1 sigma of s = -time_offset of a stream [s]; data may show more
    clock_mean: float  # s_0: how late the sensor is against the motion [s]
    kappa_mean: float  # of (10.4): 1/2 a clock, 0 a filter of the sensor
    gamma_mean: float  # of (10.5): 1 where the sensor alone is late
    # 1 sigma of a sample: (6,) of the twist, of a joint's velocity, (3,) of an IMU's Omega [m/s, rad/s]
    motion_noise: Array | None
    position_noise: Array | None  # 1 sigma of a joint's position [rad, m]; a factor is found
    # 1 sigma of a sample: (6,) of the twist's derivative, or (3,) of specific force [m/s^2, rad/s^2]
    acceleration_noise: Array | None
    accelerometer_bias_prior: float  # 1 sigma of each axis' constant error [m/s^2]
    gyro_bias_prior: float  # the same of a gyroscope [rad/s]
    discrepancy: float  # fraction of range; -1: found; 0: none; f: at least so much (10.10)

    @classmethod
    def of(cls, rig: Rig, logs: Sequence[Log]) -> Assumptions:
        """What a rig states, normalised, for logs that will be estimated together.

        InputError: a log without temperatures where the offset follows them and others have some.
        """
        sensor, motion = rig.sensor, rig.motion
        scale = sensor.channel_scale
        clock, kappa, gamma = 0.0, _KAPPA_CLOCK, _GAMMA_CLOCK
        if sensor.lowpass_hz is not None:
            clock, kappa, gamma = 1.0 / (2.0 * np.pi * sensor.lowpass_hz), _KAPPA_FILTER, _GAMMA_FILTER
        position, acceleration = None, _array(motion.acceleration_noise)
        if motion.source == "joints":
            if motion.position_noise is not None:
                position = np.array(motion.position_noise)
            elif motion.noise is not None:
                position = np.full(len(motion.noise), FIRST_POSITION_NOISE)
        return cls(
            channel_scale=scale,
            range=sensor.range_array,
            sign=sensor.sign,
            nominal=sensor.nominal_gain_array / sensor.gain_unit,
            gain_prior=sensor.gain_prior,
            noise=sensor.noise_array / scale * growth_of(logs, "raw"),
            offset_prior=sensor.offset_prior_array / scale,
            pool_offsets=sensor.pool_offsets,
            slope_prior=_slope_prior(rig, logs),
            reference_temperature=rig.temperature.reference,
            gravity=rig.gravity_array,
            tilt_prior=rig.gravity_tilt_prior if rig.in_gravity and motion.source != "imu" else 0.0,
            bodies=tuple(rig.payloads),
            body_prior=tuple(_body_prior(spec) for spec in rig.payloads.values()),
            time_offset_prior=sensor.time_offset_prior,
            clock_mean=clock,
            kappa_mean=kappa,
            gamma_mean=gamma,
            motion_noise=None
            if motion.noise is None
            else motion.noise_array * growth_of(logs, "twist", "velocity", "angular_velocity"),
            position_noise=position,
            acceleration_noise=None
            if acceleration is None
            else acceleration * growth_of(logs, "specific_force"),
            accelerometer_bias_prior=motion.accelerometer_bias_prior or 0.0,
            gyro_bias_prior=motion.gyro_bias_prior or 0.0,
            discrepancy=-1.0 if sensor.discrepancy == "auto" else float(sensor.discrepancy),
        )

    def body(self, payload: str) -> int:
        """Where a payload stands in `body_prior`."""
        return self.bodies.index(payload)


def statement(assumptions: Assumptions) -> _core.Statement:
    """The part that all logs share, as the core takes it."""
    out = _core.Statement()
    out.range = assumptions.range
    out.sign = float(assumptions.sign)
    out.noise = assumptions.noise
    out.nominal = np.ascontiguousarray(assumptions.nominal)
    out.gain_prior = assumptions.gain_prior
    out.offset_prior = assumptions.offset_prior
    out.pool_offsets = assumptions.pool_offsets
    out.gravity = assumptions.gravity
    out.tilt_prior = assumptions.tilt_prior
    out.gamma_mean = assumptions.gamma_mean
    out.slope_prior = assumptions.slope_prior
    out.body_prior = list(assumptions.body_prior)
    return out


def _body_prior(spec: PayloadSpec) -> Array:
    """1 sigma (10,) of log mass, centre of mass [m], inertia elements [kg m^2]."""
    return np.asarray(spec.uncertainty.of_each * np.append(1.0, spec.units[1:]))


def growth_of(logs: Sequence[Log], *streams: str) -> float:
    """Of the 1 sigma of noise whose filter has been undone."""
    return max(
        (log.whitened[name].growth for log in logs for name in streams if name in log.whitened), default=1.0
    )


def _slope_prior(rig: Rig, logs: Sequence[Log]) -> float:
    """1 sigma of the offset's slope; 0 where no log has a temperature."""
    told = [log.temperature is not None and bool(np.isfinite(log.temperature).any()) for log in logs]
    if not rig.temperature.prior > 0.0 or not any(told):
        return 0.0
    for log, known in zip(logs, told, strict=True):
        if not known:
            found = "no such column" if log.temperature is None else "a column without a reading"
            raise InputError.at(log.path, "temperature", found, "one in every log, as in the others")
    return rig.temperature.prior


def _array(values: Sequence[float] | None) -> Array | None:
    return None if values is None else np.array(values)
