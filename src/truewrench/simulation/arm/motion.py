"""A joint motion for rigs without a plan: sines about a posture in the middle, from rest to rest."""

from collections.abc import Mapping

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig
from truewrench.robot.arm import Robot
from truewrench.simulation.arm.model import Arm, Reading

_RATE = 100.0  # [Hz] of the spline's knots
_LOWEST, _HIGHEST = 0.15, 0.8  # [Hz]
_SINES = 4  # per joint: with one, what follows the pose (a cable) passes for gain
_SWING = 0.4  # [rad, m] at most
_SHARE = 0.8  # of every limit
_WRENCH_SHARE = 0.9  # of the sensor's range, where the rig states no limit
_RAMP = 0.15  # of the duration, at both ends
_BEND = 0.35  # [rad] off the middle, every other joint to the other side: stretched arms are singular


def default_motion(rig: Rig, robot: Robot, arms: Mapping[str, Arm]) -> SplineJoints:
    """Four sines per joint, of distinct frequencies, for ``rig.plan.duration`` and within the limits.

    These are the rig's, those of the URDF and the sensor's range, with the arm that holds each of the
    payloads. InputError: a payload overloads the sensor at rest, or begins outside the workspace.
    """
    time = np.linspace(0.0, rig.plan.duration, max(64, 1 + round(_RATE * rig.plan.duration)))
    center = _posture(rig, robot)
    swing = _sines(rig, robot, time, center)

    def use(factor: float) -> dict[str, float]:
        """Share that the motion times `factor` uses of the limits that depend on all joints together."""
        motion = SplineJoints.through(time, center + factor * swing)
        some = time[:: max(1, time.size // 400)]
        state = motion.position(some), motion.velocity(some), motion.acceleration(some)
        used = [
            _use(rig, rig.payloads[name].center_of_mass_array, arm.ideal(*state))
            for name, arm in arms.items()
        ]
        return {key: max(shares[key] for shares in used) for key in used[0]}

    def fits(factor: float) -> bool:
        return max(use(factor).values()) <= 1.0

    factor = 1.0
    if not fits(1.0):
        for key, share in use(0.0).items():
            if share > 1.0:
                found = f"{share:.0%} used by the arm at rest"
                raise InputError.at(rig.path, f"limits.{key}", found, "room for a motion, or a PLAN")
        low, high = 0.0, 1.0
        for _ in range(12):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(middle) else (low, middle)
        factor = low
    return SplineJoints.through(time, center + factor * swing)


def _use(rig: Rig, center_of_mass: Array, reading: Reading) -> dict[str, float]:
    fraction = rig.limits.wrench_fraction or _WRENCH_SHARE
    shares = {"wrench_fraction": float(np.max(np.abs(reading.wrench) / (fraction * rig.sensor.range_array)))}
    if rig.limits.workspace is not None:
        low, high = np.array(rig.limits.workspace).T
        for point in (reading.p_root_sensor, reading.p_root_sensor + reading.R_root_sensor @ center_of_mass):
            share = float(np.max(np.abs(2.0 * point - low - high) / (high - low)))
            shares["workspace"] = max(share, shares.get("workspace", 0.0))
    return shares


def _posture(rig: Rig, robot: Robot) -> Array:
    """Where the joints begin, and swing about."""
    if rig.motion.initial_position is not None:
        return np.array(rig.motion.initial_position)
    lower, upper = _range(rig, robot)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    middle, half = np.clip(0.0, lower, upper), np.full(robot.n, np.inf)
    middle[bounded] = 0.5 * (lower[bounded] + upper[bounded])
    half[bounded] = 0.5 * (upper[bounded] - lower[bounded])
    return np.asarray(middle + np.minimum(_BEND, 0.25 * half) * (-1.0) ** np.arange(robot.n))


def _sines(rig: Rig, robot: Robot, time: Array, center: Array) -> Array:
    """Departures (N, n) from the centre, as large as the limits of the joints allow."""
    duration, joints = time[-1], np.arange(robot.n)
    frequency = np.geomspace(_LOWEST, _HIGHEST, _SINES * robot.n).reshape(_SINES, robot.n)
    frequency = frequency[:, np.argsort(joints * 5 % robot.n)]  # neighbours do not swing alike
    frequency = np.maximum(1.0, np.round(frequency * duration)) / duration
    ramp = np.clip(np.minimum(time, duration - time) / (_RAMP * duration), 0.0, 1.0)
    ramp = ramp**4 * (35.0 - 84.0 * ramp + 70.0 * ramp**2 - 20.0 * ramp**3)  # three derivatives vanish
    k = np.arange(_SINES)[:, None]
    phase = 0.7 * joints + k * (k + 1.0) + 2.1 * k * joints
    sines = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase) / np.sqrt(frequency)
    shape = ramp[:, None] * sines.sum(axis=1)
    shape /= np.abs(shape).max(axis=0)
    unit = SplineJoints.through(time, shape)
    lower, upper = _range(rig, robot)
    amplitude = np.minimum(_SWING, _SHARE * np.minimum(upper - center, center - lower))
    limits = rig.limits
    jerk = np.gradient(unit.acceleration(time), time, axis=0)
    for values, stated in (
        (unit.velocity(time), [robot.velocity, limits.velocity]),
        (unit.acceleration(time), [limits.acceleration]),
        (jerk, [limits.jerk]),
    ):
        for limit in stated:
            if limit is not None:
                amplitude = np.minimum(amplitude, _SHARE * np.array(limit) / np.abs(values).max(axis=0))
    if (amplitude < 0.0).any():
        joint = int(np.argmin(amplitude))
        place, found = f"motion.initial_position[{joint}]", f"{center[joint]:g}"
        raise InputError.at(rig.path, place, found, f"within [{lower[joint]:g}, {upper[joint]:g}]")
    return np.asarray(amplitude * shape)


def _range(rig: Rig, robot: Robot) -> tuple[Array, Array]:
    """Smallest and largest positions (n,) that URDF and rig allow."""
    if rig.limits.position is None:
        return robot.lower, robot.upper
    stated = np.array(rig.limits.position)
    return np.maximum(robot.lower, -stated), np.minimum(robot.upper, stated)
