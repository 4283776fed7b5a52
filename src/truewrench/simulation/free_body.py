"""A log with known truth, from a rig and a motion.

The wrench is Newton's second law summed over material points of the payload, written for this file alone:
estimation uses the core's Newton-Euler equations, so a mistake in either shows as a disagreement.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.spatial import cross
from truewrench.model.motion.trajectory import Body, HarmonicTwist, Trajectory, attitude
from truewrench.model.rig import Rig
from truewrench.simulation.imperfect import FineMotion, Hardware
from truewrench.simulation.truth import Truth, begin, noise_of, readings, stamps_of, stated, write_run

_PERIOD = 100.0 / 3.0  # [s] after which the motion without a plan repeats itself
_FIRST = 5  # harmonic, the slowest: 0.15 Hz
_TURN = np.array([0, 2, 4, 1, 3, 5])  # neighbouring harmonics belong to forces and moments in turn
# [30 deg], one column an axis: of 4,600 sets the one whose 3, 4, 6 and 10 s determine the least certain gain
# of the payload of [A00] best. In a pattern, axes move together, and some gains are hardly determined.
_PHASES = np.array(
    [
        [9, 4, 10, 4, 10, 9],
        [9, 11, 11, 2, 7, 11],
        [9, 9, 4, 6, 2, 5],
        [9, 9, 5, 6, 9, 10],
        [4, 2, 2, 0, 2, 5],
        [5, 4, 4, 6, 5, 3],
    ]
)
_SPEED = 0.4  # [m/s, rad/s] where nothing is said
_LOOK = 2e-3  # [s] between the times at which limits are looked at
_SPARE = 0.999  # of a limit, for what happens between them


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A log, the truth it was made with, and the motion behind it."""

    log: Log
    truth: Truth
    trajectory: Trajectory

    def write(self, path: str | Path) -> tuple[Path, Path]:
        """Write the log (CSV, or Parquet by its suffix) and PATH.truth.yaml beside it; return both paths."""
        return write_run(path, self.log, self.truth)

    def figures(self) -> dict[str, float]:
        """Nothing beside the log is worth telling."""
        return {}


def simulate(
    rig: Rig, trajectory: Trajectory | None = None, *, payload: str | None = None, seed: int | None = None
) -> SimulatedRun:
    """Simulate the log of a twist rig that follows a trajectory, by the options of ``rig.simulate``.

    Args:
        rig: the rig; noise, signs, logged point and gravity are its own.
        trajectory: twist of the logged point (`motion.of`); `default_trajectory` if left out.
        payload: name of the payload that is carried; the first of the rig if left out.
        seed: of every random draw; ``rig.simulate.seed`` if left out.

    The sensor sample stamped t shows the motion at ``t + time_offset``. In gravity the sensor starts aligned
    with the root frame and turns with Omega; the log's gravity is the stated one, whatever tilt it has.

    Raises:
        UnsupportedError: for a joint rig or a sensor with a filter of its own that is not simulated.
        InputError: for a payload that the rig does not have, or an imperfection that the motion cannot have.
    """
    if rig.motion.source != "twist":
        expected = "`twist` (arms move in `simulate_arm`); what an IMU reads is not simulated"
        raise UnsupportedError.at(rig.path, "motion.source", rig.motion.source, expected)
    name, truth = begin(rig, payload, seed)
    motion = default_trajectory(rig) if trajectory is None else trajectory
    hardware = Hardware(rig, truth.seed, motion.duration)
    stamps = stamps_of(rig, motion.duration, truth.time_offset)
    rng = noise_of(rig, name, truth.seed)
    shown, read = hardware.read_at(stamps.shown, "sensor"), hardware.read_at(stamps.motion, "motion")
    rows, fine = stamps.time, hardware.fine_time
    rows[np.searchsorted(stamps.time_ns, stamps.motion_ns)] = read  # attitude and twist are of one reading
    rotation = _rotation(rig, motion, np.concatenate([rows, shown, fine]))
    point = _logged_point(rig, name)

    def wrench(time: Array, R_root_sensor: Array) -> Array:
        gravity = np.asarray(hardware.gravity @ R_root_sensor)  # R^T g
        nu, a = motion.twist(time), motion.acceleration(time)
        return wrench_on_sensor(truth.payloads[name], point, nu, a, gravity)

    at_shown, at_fine = np.split(rotation[rows.size :], [shown.size])
    twist = motion.twist(fine)
    moved = cumulative_trapezoid(twist, fine, axis=0, initial=0) if fine.size else twist
    ideal = FineMotion(wrench(fine, at_fine), twist, moved)
    readout = hardware.readout(truth.gain, ideal, shown, read)
    raw = readings(rig, truth, stamps, wrench(shown, at_shown), rng, readout)
    sigma = rig.motion.noise_array
    logged = readout.velocity(motion.twist(read), sigma, rng.standard_normal((read.size, 6)))
    log = Log(
        path=None, payload=name, sha256="", time_ns=stamps.time_ns, raw=raw,
        twist=stamps.rows_of(stamps.motion_ns, logged),
        gravity=np.asarray(rig.gravity_array @ rotation[: rows.size]) if rig.in_gravity else None,
    )  # fmt: skip
    truth = replace(truth, imperfections=readout.told)
    return SimulatedRun(log, truth, motion)


def wrench_on_sensor(body: Body, point: Array, twist: Array, acceleration: Array, gravity: Array) -> Array:
    """Wrench (N, 6) of a payload on the sensor, at the sensor origin and in sensor axes.

    A rigid body moves like any set of material points with its mass, centre of mass and second moments. Each
    point P is accelerated by a force from the sensor and by gravity, ``f_P = m_P (a_P - g)``, and the sensor
    feels the reaction of them all. Twist (N, 6) and its component-wise derivative belong to a body-fixed
    point, (3,) from the sensor origin; gravity (N, 3) is the acceleration of free fall in sensor axes.
    """
    velocity, omega = twist[:, :3], twist[:, 3:]
    rotation_rate = acceleration[:, 3:]
    of_point = acceleration[:, :3] + cross(omega, velocity)  # inertial acceleration, rotating axes
    wrench = np.zeros((len(twist), 6))
    for mass, position in zip(*_material_points(body), strict=True):
        r = position - point
        at = of_point + cross(rotation_rate, r) + cross(omega, cross(omega, r))
        force = mass * (at - gravity)
        wrench[:, :3] -= force
        wrench[:, 3:] -= cross(position, force)
    return wrench


def default_trajectory(rig: Rig) -> HarmonicTwist:
    """Six sines per twist axis, for ``rig.plan.duration`` and within ``rig.limits``.

    0.15 to 1.2 Hz, no frequency twice; 0.4 m/s and 0.4 rad/s at most where the rig does not limit the
    velocity. Where every axis moves at one frequency, its pose is minus its acceleration: what follows the
    pose, a cable say, would pass for gain (docs/method.md, "What follows the pose"). A workspace is
    unsupported: only a planned motion can keep to it.
    """
    limits = rig.limits
    if limits.workspace is not None:
        raise UnsupportedError.at(
            rig.path, "limits.workspace", "a workspace", "a planned motion to simulate (PLAN)"
        )
    harmonic = _FIRST + 6 * np.arange(6)[:, None] + _TURN
    frequency = harmonic / _PERIOD
    unit = HarmonicTwist(frequency**0.25, frequency, np.pi / 6.0 * _PHASES, rig.plan.duration)
    motion = unit.scaled(_amplitude(rig, unit))
    if limits.wrench_fraction is None:
        return motion
    return _within_wrench(rig, motion, limits.wrench_fraction)


def _amplitude(rig: Rig, unit: HarmonicTwist) -> Array:
    """(6,) factors by which a motion of whole harmonics reaches the first limit of each axis."""
    limits, time = rig.limits, np.arange(0.0, _PERIOD, _LOOK)
    velocity = unit.twist(time)
    displacement = np.vstack([np.zeros(6), np.cumsum(velocity[1:] + velocity[:-1], axis=0) * 0.5 * _LOOK])
    factor = np.full(6, np.inf)
    for values, limit in (
        (velocity, (_SPEED,) * 6 if limits.velocity is None else limits.velocity),
        (unit.acceleration(time), limits.acceleration),
        (np.gradient(unit.acceleration(time), _LOOK, axis=0), limits.jerk),
        (displacement, limits.position),
    ):
        if limit is not None:
            factor = np.minimum(factor, _SPARE * np.array(limit) / np.abs(values).max(axis=0))
    return factor


def _logged_point(rig: Rig, payload: str) -> Array:
    """Where the twist belongs to: the STATED centre of mass, whatever the true one is, or the sensor."""
    return rig.payloads[payload].center_of_mass_array if rig.motion.of == "com" else np.zeros(3)


def _rotation(rig: Rig, motion: Trajectory, time: Array) -> Array:
    """R_root_sensor (N, 3, 3); without gravity nobody asks for it, and it is the identity."""
    if not rig.in_gravity:
        return np.broadcast_to(np.eye(3), (time.size, 3, 3))
    return attitude(motion, time)


def _material_points(body: Body) -> tuple[Array, Array]:
    """Masses (6,) and positions from the sensor origin (6, 3) of points equivalent to a rigid body.

    Second moments ``integral r r^T dm = tr(I)/2 E - I`` along their principal axes are carried by three pairs
    of points at the radius of gyration d about the centre of mass: their masses then sum to the body's.
    """
    moments, axes = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
    d = np.sqrt(0.5 * np.trace(body.inertia) / body.mass)
    arms = d * np.concatenate([axes.T, -axes.T])
    return np.tile(moments / (2.0 * d**2), 2), body.center_of_mass + arms


def _within_wrench(rig: Rig, motion: HarmonicTwist, fraction: float) -> HarmonicTwist:
    """The motion scaled down until every payload's wrench stays within a fraction of the range."""
    time = np.linspace(0.0, motion.duration, 1 + round(50.0 * motion.duration))

    def load(factor: float) -> float:
        scaled = motion.scaled(factor)
        gravity = np.asarray(rig.gravity_array @ _rotation(rig, scaled, time))
        nu, a = scaled.twist(time), scaled.acceleration(time)
        wrenches = [
            wrench_on_sensor(stated(spec), _logged_point(rig, name), nu, a, gravity)
            for name, spec in rig.payloads.items()
        ]
        return float(np.max(np.abs(wrenches) / (fraction * rig.sensor.range_array)))

    if load(1.0) <= 1.0:
        return motion
    low, high = 0.0, 1.0
    if load(1e-3) > 1.0:
        raise InputError.at(
            rig.path, "limits.wrench_fraction", f"{fraction}", "more: the payload at rest exceeds it"
        )  # fmt: skip
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if load(middle) <= 1.0 else (low, middle)
    return motion.scaled(low)
