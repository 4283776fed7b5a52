"""Tools for tests: made up ones, on a flange, and logs of poses and motions of a known body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truewrench.io.tables import write_table
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.identify import exported_body
from truewrench.tool.model import Body, HeldOut, Tool, ToolVerdict, Unknown
from truewrench.tool.parameters import Layout, inertia_of, second_moments

Array = NDArray[np.float64]
Rigid = tuple[float, Array, Array]  # mass, centre of mass, inertia (3, 3) about it

FLANGE = np.array([0.01, -0.02, 0.04, 0.3, -0.2, 1.1])
HOUSING = np.array([0.4, 0.002, 0.0, -0.015])

SENSOR: dict[str, Any] = {
    "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
    "feels": "payload_on_sensor",
    "noise": [0.1, 0.1, 0.1, 0.005, 0.005, 0.005],
    "range": [100, 100, 100, 10, 10, 10],
}


def a_rig(**changes: Any) -> dict[str, Any]:
    """A rig without payloads, in gravity."""
    sensor = {**SENSOR, **changes.pop("sensor", {})}
    return {"sensor": sensor, "gravity": [0, 0, -9.81], **changes}


def a_tool(seed: int = 0) -> Tool:
    """A tool whose numbers agree with each other, and mean nothing."""
    rng, layout = np.random.default_rng(seed), Layout(6)
    root = rng.normal(size=(layout.size, layout.size)) * 0.01
    covariance = root @ root.T
    covariance = 0.5 * (covariance + covariance.T)
    std = np.sqrt(np.diag(covariance))
    mass, S = 2.0, np.array([0.004, 0.003, 0.002, 1e-4, -2e-4, 3e-4])
    return Tool(
        mass=mass,
        mass_std=mass * std[layout.log_mass],
        center_of_mass=np.array([0.01, -0.02, 0.09]),
        center_of_mass_std=std[layout.center_of_mass],
        inertia=inertia_of(mass, S),
        inertia_std=np.full(6, 1e-4),
        determined={"mass": True, "center_of_mass": (True,) * 3, "inertia": (True, True, False) * 2},
        offset=rng.normal(size=6),
        offset_std=std[layout.offset],
        offset_time_ns=123_456_789_012,
        offset_walk=np.full(6, 1e-3),
        pose_repeatability=np.full(6, 2e-3),
        sample_noise=np.full(6, 3e-3),
        vibrations=np.zeros((0, 7)),
        mounting=np.array([0.01, -0.02, 0.03]),
        mounting_std=std[layout.mounting],
        tilt=np.array([1e-3, -2e-3]),
        tilt_std=std[layout.tilt],
        gain=np.eye(6) + 0.01 * rng.normal(size=(6, 6)),
        covariance=covariance,
        exported=Body(mass, np.array([0.01, -0.02, 0.09]), inertia_of(mass, S)),
        verdict=ToolVerdict(True, (), (Unknown("inertia", "words"),), ("weigh it",)),
        rig=tool_rig(a_rig()),
        held_out=HeldOut(0.1, 0.01, 0.5, 0.05),
        logs=({"path": "poses.csv", "sha256": "", "poses": 12},),
        figures={"chi_square": 1.0},
        version="0",
        created="2026-01-01T00:00:00+00:00",
    )


def a_mounted_tool(*, inertia: bool = True, housing: bool = True) -> Tool:
    """A tool on a sensor that stands on a flange."""
    tool = a_tool()
    body = np.concatenate([[np.log(tool.mass)], tool.center_of_mass, second_moments(tool.mass, tool.inertia)])
    shell = HOUSING if housing else np.zeros(4)
    place = tool.layout.body
    exported = exported_body(body, tool.covariance[place, place], inertia, shell)
    return replace(tool, exported=exported, flange=FLANGE, housing=shell)


def stated(tool: Tool) -> list[Rigid]:
    """The bodies at the flange by another path: tool and housing apart, turned by SciPy."""
    R = Rotation.from_euler("xyz", FLANGE[3:]).as_matrix()
    out: list[Rigid] = []
    for mass, center, inertia in (
        (tool.mass, tool.center_of_mass, tensor_of(tool.inertia)),
        (float(tool.housing[0]), tool.housing[1:], np.zeros((3, 3))),
    ):
        out.append((mass, FLANGE[:3] + R @ center, R @ inertia @ R.T))
    return out


def tensor_of(e: Array) -> Array:
    """(3, 3) of Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
    return np.array([[e[0], e[3], e[4]], [e[3], e[1], e[5]], [e[4], e[5], e[2]]])


def directions(count: int, rng: np.random.Generator) -> Array:
    """Attitudes R_root_sensor (count, 3, 3) of any kind."""
    return Rotation.random(count, random_state=rng).as_matrix()


def pose_log(
    rig: Rig,
    mass: float,
    center: Array,
    *,
    poses: int = 16,
    gain: Array | None = None,
    walk: float = 1e-4,
    seed: int = 0,
    attitudes: Array | None = None,
    apart: float = 8.0,
) -> tuple[Log, Array]:
    """Static poses of a tool, a row each, and the offset at their end.

    Args:
        rig: sensor and gravity.
        mass: [kg].
        center: (3,) [m].
        poses: how many.
        gain: (6, 6), identity by default.
        walk: of the offset, fraction of range per sqrt(s).
        seed: of noise, walk and attitudes.
        attitudes: R_root_sensor (poses, 3, 3).
        apart: seconds between them.
    """
    rng = np.random.default_rng(seed)
    R = directions(poses, rng) if attitudes is None else attitudes
    poses = len(R)
    fall = R.transpose(0, 2, 1) @ rig.gravity_array
    wrench = rig.sensor.sign * mass * np.column_stack([fall, np.cross(center, fall)])
    steps = rng.normal(size=(poses, 6)) * np.sqrt(apart) * walk * rig.sensor.range_array
    drift = np.cumsum(steps, axis=0)
    offset = rng.normal(size=6) * 0.05 * rig.sensor.range_array
    raw = wrench @ (np.eye(6) if gain is None else gain).T + offset + drift
    raw += rng.normal(size=raw.shape) * rig.sensor.noise_array
    attitude = Rotation.from_matrix(R).as_quat()[:, [3, 0, 1, 2]]
    time_ns = (np.arange(poses) * apart * 1e9).astype(np.int64)
    log = Log(None, "tool", "", time_ns, raw, twist=np.zeros((poses, 6)), gravity=fall, attitude=attitude)
    return log, offset + drift[-1]


def newton_euler(mass: float, center: Array, inertia: Array, nu: Array, a: Array, fall: Array) -> Array:
    """Wrench (N, 6) on the sensor about its origin, written apart from the package's."""
    omega, alpha = nu[:, 3:], a[:, 3:]
    at_mass = a[:, :3] + np.cross(omega, nu[:, :3]) + np.cross(alpha, center)
    at_mass = at_mass + np.cross(omega, np.cross(omega, center)) - fall
    moment = alpha @ inertia.T + np.cross(omega, omega @ inertia.T) + mass * np.cross(center, at_mass)
    return -np.hstack([mass * at_mass, moment])


def tour_log(
    rig: Rig, mass: float, center: Array, inertia: Array, *, dwell: float, walk: float, seed: int
) -> tuple[Log, Array]:
    """Eight poses held for a while, 1.5 s of turning from each to the next, 100 Hz; the offset at the end.

    The offset walks by so much of range per sqrt(s) from sample to sample.
    """
    rng = np.random.default_rng(seed)
    poses = Rotation.random(8, random_state=rng)
    s = np.linspace(0.0, 1.0, 151)[1:-1]
    turns, nu, a = [], [], []
    still = np.zeros((round(100 * dwell), 6))
    for k, pose in enumerate(poses):
        turns.append(Rotation.from_quat(np.tile(pose.as_quat(), (len(still), 1))))
        nu.append(still)
        a.append(still)
        if k + 1 == len(poses):
            break
        way = (pose.inv() * poses[k + 1]).as_rotvec()
        part = 10 * s**3 - 15 * s**4 + 6 * s**5
        turns.append(pose * Rotation.from_rotvec(part[:, None] * way))
        rate = (30 * s**2 - 60 * s**3 + 30 * s**4) / 1.5
        bend = (60 * s - 180 * s**2 + 120 * s**3) / 1.5**2
        nu.append(np.column_stack([np.zeros((s.size, 3)), rate[:, None] * way]))
        a.append(np.column_stack([np.zeros((s.size, 3)), bend[:, None] * way]))
    twist, R = np.vstack(nu), Rotation.concatenate(turns)
    fall = R.inv().apply(rig.gravity_array)
    drift = np.cumsum(0.1 * walk * rig.sensor.range_array * rng.normal(size=twist.shape), axis=0)
    drift += 0.05 * rig.sensor.range_array * rng.normal(size=6)
    raw = rig.sensor.sign * newton_euler(mass, center, inertia, twist, np.vstack(a), fall) + drift
    raw += rng.normal(size=raw.shape) * rig.sensor.noise_array
    twist = twist + rng.normal(size=twist.shape) * rig.motion.noise_array
    time_ns = np.arange(len(twist)) * 10_000_000
    quaternion = R.as_quat()[:, [3, 0, 1, 2]]
    return Log(None, "tool", "", time_ns, raw, twist=twist, gravity=fall, attitude=quaternion), drift[-1]


def swing_log(
    rig: Rig, mass: float, center: Array, inertia: Array, *, seconds: float = 8.0, seed: int = 0
) -> Log:
    """A tool swung at four frequencies an axis, 100 Hz; R_root_sensor integrated in small steps.

    With `motion.source: imu` it holds what an IMU reads in place of twist and attitude.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round(100 * seconds)) / 100.0
    f, phase = rng.uniform(0.2, 0.9, (6, 4)), rng.uniform(0.0, 2.0 * np.pi, (6, 4))
    size = np.repeat([0.3, 0.8], 3)

    def twist(t: Array, derivative: int = 0) -> Array:
        """(T, 6), or its derivative."""
        angle = 2.0 * np.pi * f * t[:, None, None] + phase + 0.5 * np.pi * derivative
        return np.asarray(size * ((2.0 * np.pi * f) ** derivative * np.sin(angle)).sum(axis=2))

    nu, a = twist(time), twist(time, 1)
    R = [Rotation.random(random_state=rng).as_matrix()]
    middle = 0.0025 * (np.arange(4 * (time.size - 1)) + 0.5)
    for step in Rotation.from_rotvec(0.0025 * twist(middle)[:, 3:]).as_matrix():
        R.append(R[-1] @ step)
    turns = Rotation.from_matrix(np.array(R[::4]))
    fall = turns.inv().apply(rig.gravity_array)
    raw = rig.sensor.sign * newton_euler(mass, center, inertia, nu, a, fall)
    raw += rng.normal(size=raw.shape) * rig.sensor.noise_array + rng.normal(size=6) * 0.5
    stamps = (time * 1e9).astype(np.int64) + 10**12
    if rig.motion.source == "imu":
        return as_imu(Log(None, "tool", "", stamps, raw, gravity=fall), nu, a, rng)
    nu += rng.normal(size=nu.shape) * rig.motion.noise_array
    quaternion = turns.as_quat()[:, [3, 0, 1, 2]]
    return Log(None, "tool", "", stamps, raw, twist=nu, gravity=fall, attitude=quaternion)


def as_imu(log: Log, nu: Array, a: Array, rng: np.random.Generator) -> Log:
    """The log with what an IMU reads, constant errors within, in place of twist, gravity and attitude."""
    force = a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - log.gravity
    read = np.column_stack([force, nu[:, 3:]]) + rng.normal(size=6) * np.repeat([0.02, 0.002], 3)
    read += rng.normal(size=read.shape) * np.repeat([1e-2, 1e-3], 3)
    return replace(
        log,
        twist=None,
        gravity=None,
        attitude=None,
        specific_force=read[:, :3],
        angular_velocity=read[:, 3:],
    )


def write_log(path: Path, log: Log) -> Path:
    """A log as a table."""
    assert log.twist is not None
    assert log.attitude is not None
    columns: dict[str, Any] = {"time_ns": log.time_ns}
    columns |= {f"raw_{i}": log.raw[:, i] for i in range(log.raw.shape[1])}
    columns |= dict(zip(("vx", "vy", "vz", "wx", "wy", "wz"), log.twist.T, strict=True))
    columns |= dict(zip(("qw", "qx", "qy", "qz"), log.attitude.T, strict=True))
    write_table(path, columns)
    return path


def apart(log: Log, by_ns: int) -> Log:
    """The samples of the sensor on rows of their own, so much later, as topics of a recording have them."""
    sensed = np.isfinite(log.raw).all(axis=1)
    stamps = np.concatenate([log.time_ns, log.time_ns[sensed] + by_ns])
    order, rows = np.argsort(stamps), len(log.time_ns)
    changed: dict[str, Any] = {"time_ns": stamps[order]}
    for name in ("raw", "twist", "gravity", "attitude", "position", "velocity"):
        values = getattr(log, name)
        if values is None:
            continue
        out = np.full((len(stamps), values.shape[1]), np.nan)
        if name == "raw":
            out[rows:] = values[sensed]
        else:
            out[:rows] = values
        changed[name] = out[order]
    return replace(log, **changed)
