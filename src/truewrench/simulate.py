"""A log with known truth, from a rig and a motion.

The wrench is Newton's second law summed over material points of the payload, written for this file alone:
estimation uses the core's Newton-Euler equations, so a mistake in either shows as a disagreement.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench.errors import InputError, UnsupportedError
from truewrench.files import write_yaml
from truewrench.io.table import GRAVITY, TWIST
from truewrench.io.tables import write_table
from truewrench.log import Log
from truewrench.rig import PayloadSpec, Rig
from truewrench.trajectory import Body, HarmonicTwist, Trajectory, attitude

__all__ = ["SimulatedRun", "Truth", "default_trajectory", "simulate", "wrench_on_sensor"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Truth:
    """What a log was made with: gain (n, 6) and offset (n,) [raw units], clock offset [s], payloads."""

    gain: Array
    offset: Array
    time_offset: float
    payloads: dict[str, Body]
    seed: int

    def to_mapping(self) -> dict[str, Any]:
        """Plain numbers and lists, as LOG.truth.yaml holds them."""
        return {
            "gain": self.gain.tolist(),
            "offset": self.offset.tolist(),
            "time_offset": self.time_offset,
            "payloads": {
                name: {
                    "mass": body.mass,
                    "center_of_mass": body.center_of_mass.tolist(),
                    "inertia": {
                        key: float(body.inertia[i, j])
                        for key, (i, j) in zip(
                            ("xx", "yy", "zz", "xy", "xz", "yz"),
                            ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)),
                            strict=True,
                        )
                    },
                }
                for name, body in self.payloads.items()
            },
            "seed": self.seed,
        }


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A log, the truth it was made with, and the motion behind it."""

    log: Log
    truth: Truth
    trajectory: Trajectory

    def write(self, path: str | Path) -> tuple[Path, Path]:
        """Write the log (CSV, or Parquet by its suffix) and PATH.truth.yaml beside it; return both paths."""
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        columns: dict[str, NDArray[np.int64] | Array] = {"time_ns": self.log.time_ns}
        columns |= {f"raw_{i}": channel for i, channel in enumerate(self.log.raw.T)}
        for names, block in ((TWIST, self.log.twist), (GRAVITY, self.log.gravity)):
            if block is not None:
                columns |= dict(zip(names, block.T, strict=True))
        write_table(target, columns)
        truth = target.with_name(target.name + ".truth.yaml")
        write_yaml(truth, self.truth.to_mapping())
        return target, truth


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
    with the root frame and turns with Omega.

    Raises:
        UnsupportedError: for a joint rig or a sensor with a filter of its own.
        InputError: for a payload that the rig does not have.
    """
    _check_supported(rig)
    name = next(iter(rig.payloads)) if payload is None else payload
    if name not in rig.payloads:
        raise InputError.at(rig.path, "payloads", f"no `{name}`", "one of " + ", ".join(rig.payloads))
    options = rig.simulate
    motion = default_trajectory(rig) if trajectory is None else trajectory
    truth = _draw_truth(rig, options.seed if seed is None else seed)
    rng = np.random.default_rng([truth.seed, 1])

    motion_ns = _stamps(motion.duration, options.rate)
    sensor_ns = _stamps(motion.duration, options.sensor_rate)
    shown = _seconds(sensor_ns) + truth.time_offset  # t_motion = t_sensor + time_offset
    inside = (shown >= 0.0) & (shown <= motion.duration)
    sensor_ns, shown = sensor_ns[inside], shown[inside]
    if sensor_ns.size == 0:
        found = f"{truth.time_offset:g} s"
        raise InputError.at(
            rig.path, "simulate.time_offset", found, f"less than the {motion.duration} s of motion"
        )
    time_ns = np.union1d(motion_ns, sensor_ns)

    gravity = _gravity_in_sensor(rig, motion, np.concatenate([_seconds(time_ns), shown]))
    wrench = rig.sensor.sign * wrench_on_sensor(
        truth.payloads[name], _logged_point(rig, name), motion.twist(shown), motion.acceleration(shown),
        gravity[time_ns.size :],
    )  # fmt: skip
    noise = rig.sensor.noise_array * rng.standard_normal((shown.size, rig.sensor.n))
    raw = np.full((time_ns.size, rig.sensor.n), np.nan)
    # the offset walks to what the truth says, which is its value at the end
    steps = np.sqrt(np.diff(shown, append=shown[-1]))[:, None] * rig.sensor.offset_walk_array
    steps = steps * np.random.default_rng([truth.seed, 3]).standard_normal(steps.shape)
    offset = truth.offset - np.cumsum(steps[::-1], axis=0)[::-1]
    raw[np.searchsorted(time_ns, sensor_ns)] = wrench @ truth.gain.T + offset + noise
    twist = np.full((time_ns.size, 6), np.nan)
    measured = motion.twist(_seconds(motion_ns))
    measured += rig.motion.noise_array * rng.standard_normal(measured.shape)
    twist[np.searchsorted(time_ns, motion_ns)] = measured
    log = Log(
        path=None, payload=name, sha256="", time_ns=time_ns, raw=raw, twist=twist,
        gravity=gravity[: time_ns.size] if rig.in_gravity else None,
    )  # fmt: skip
    return SimulatedRun(log, truth, motion)


def wrench_on_sensor(body: Body, point: Array, twist: Array, acceleration: Array, gravity: Array) -> Array:
    """Wrench (N, 6) of a payload on the sensor, at the sensor origin and in sensor axes.

    A rigid body moves like any set of material points with its mass, centre of mass and second moments. Each
    point P is accelerated by a force from the sensor and by gravity, ``f_P = m_P (a_P - g)``, and the sensor
    feels the reaction of them all.

    Args:
        body: the payload.
        point: body-fixed point that the twist belongs to, from the sensor origin (3,).
        twist: its twist (N, 6).
        acceleration: component-wise derivative of the twist (N, 6).
        gravity: acceleration of free fall in sensor axes (N, 3).
    """
    velocity, omega = twist[:, :3], twist[:, 3:]
    rotation_rate = acceleration[:, 3:]
    of_point = acceleration[:, :3] + np.cross(omega, velocity)  # inertial acceleration, rotating axes
    wrench = np.zeros((len(twist), 6))
    for mass, position in zip(*_material_points(body), strict=True):
        r = position - point
        at = of_point + np.cross(rotation_rate, r) + np.cross(omega, np.cross(omega, r))
        force = mass * (at - gravity)
        wrench[:, :3] -= force
        wrench[:, 3:] -= np.cross(position, force)
    return wrench


def default_trajectory(rig: Rig) -> HarmonicTwist:
    """One sine per twist axis, of distinct frequencies, for ``rig.plan.duration`` and within ``rig.limits``.

    0.3 to 0.9 Hz; 0.25 m/s and 0.25 rad/s where the rig does not limit the velocity.

    Raises:
        UnsupportedError: for a workspace, which only a planned motion can keep to.
        InputError: if the payload at rest already exceeds ``limits.wrench_fraction``.
    """
    limits = rig.limits
    if limits.workspace is not None:
        raise UnsupportedError.at(
            rig.path, "limits.workspace", "a workspace", "a planned motion to simulate (PLAN)"
        )
    frequency = np.array([0.30, 0.51, 0.69, 0.39, 0.60, 0.87])
    rate = 2.0 * np.pi * frequency
    amplitude = np.full(6, 0.25) if limits.velocity is None else np.array(limits.velocity)
    # position: the integral from 0 swings by twice its amplitude at most
    for limit, per_amplitude in (
        (limits.acceleration, rate),
        (limits.jerk, rate**2),
        (limits.position, 2.0 / rate),
    ):
        if limit is not None:
            amplitude = np.minimum(amplitude, np.array(limit) / per_amplitude)
    phase = np.array([0.0, 1.0, 2.0, 0.5, 1.5, 2.5])
    motion = HarmonicTwist(amplitude[None], frequency[None], phase[None], rig.plan.duration)
    if limits.wrench_fraction is None:
        return motion
    return _within_wrench(rig, motion, limits.wrench_fraction)


def _check_supported(rig: Rig) -> None:
    if rig.motion.source != "twist":
        raise UnsupportedError.at(
            rig.path, "motion.source", rig.motion.source, "`twist`: joints are not simulated"
        )
    if rig.sensor.lowpass_hz is not None:
        found = f"{rig.sensor.lowpass_hz}"
        raise UnsupportedError.at(rig.path, "sensor.lowpass_hz", found, "null: the filter is not simulated")


def _stamps(duration: float, rate: float) -> NDArray[np.int64]:
    """Stamps k/rate of a stream in [0, duration) [ns]."""
    count = int(np.ceil(duration * rate - 1e-6))
    stamps: NDArray[np.int64] = np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64)
    return stamps


def _seconds(time_ns: NDArray[np.int64]) -> Array:
    return np.asarray(time_ns * 1e-9, dtype=np.float64)


def _logged_point(rig: Rig, payload: str) -> Array:
    """Where the twist belongs to: the STATED centre of mass, whatever the true one is, or the sensor."""
    return rig.payloads[payload].center_of_mass_array if rig.motion.of == "com" else np.zeros(3)


def _gravity_in_sensor(rig: Rig, motion: Trajectory, time: Array) -> Array:
    if not rig.in_gravity:
        return np.zeros((time.size, 3))
    rotation = attitude(motion, time)  # R_root_sensor
    return np.asarray(rig.gravity_array @ rotation)  # R^T g


def _draw_truth(rig: Rig, seed: int) -> Truth:
    sensor, options = rig.sensor, rig.simulate
    rng = np.random.default_rng([seed, 0])
    # drawn whether used or not, so that one option does not change what another draws
    departure = sensor.gain_prior * rng.standard_normal((sensor.n, 6))
    drawn_offset = sensor.offset_prior_array * rng.standard_normal(sensor.n)
    gain = sensor.nominal_gain_array
    if options.gain == "random":
        gain = gain + departure * sensor.channel_scale[:, None] / sensor.range_array
    elif options.gain != "nominal":
        gain = np.array(options.gain)
    if options.offset == "random":
        offset = drawn_offset
    elif isinstance(options.offset, tuple):
        offset = np.array(options.offset)
    else:
        offset = np.zeros(sensor.n)
    draw = options.payload == "random"
    payloads = {
        name: _draw_payload(spec, rng) if draw else _stated(spec) for name, spec in rig.payloads.items()
    }
    time_offset = options.time_offset
    if time_offset == "random":
        time_offset = sensor.time_offset_prior * float(np.random.default_rng([seed, 2]).standard_normal())
    return Truth(gain, offset, time_offset, payloads, seed)


def _stated(spec: PayloadSpec) -> Body:
    return Body(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)


def _draw_payload(spec: PayloadSpec, rng: np.random.Generator) -> Body:
    """A payload from the stated uncertainty; inertias that no body can have are drawn again."""
    sigma, stated = spec.uncertainty, _stated(spec)
    diagonal = np.sqrt(np.diag(stated.inertia))
    for _ in range(1000):
        mass = stated.mass * (1.0 + sigma.mass * rng.standard_normal())
        center = stated.center_of_mass + sigma.center_of_mass * rng.standard_normal(3)
        upper = np.triu(rng.standard_normal((3, 3)))
        symmetric = upper + np.triu(upper, 1).T
        inertia = stated.inertia + sigma.inertia * symmetric * np.outer(diagonal, diagonal)
        principal = np.linalg.eigvalsh(inertia)
        if mass > 0.0 and principal[0] > 0.0 and principal[0] + principal[1] >= principal[2]:
            return Body(float(mass), center, inertia)
    raise InputError.at(
        None, "payloads: uncertainty", f"{sigma}", "an uncertainty that leaves physical bodies likely"
    )


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
        gravity = _gravity_in_sensor(rig, scaled, time)
        nu, a = scaled.twist(time), scaled.acceleration(time)
        wrenches = [
            wrench_on_sensor(_stated(spec), _logged_point(rig, name), nu, a, gravity)
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
