"""Unknown tools drawn from the priors, and what a sensor reads of them in poses and in motion.

Sensor of 100 N and 10 N m, noise of 0.1 N and 0.005 N m, or eight gauges of 1e-3 of range; gains, mounting,
gravity, offsets and bodies (a quarter of them rods) are drawn; 12 poses 8 s apart with an offset that walks
at a rate drawn about 1e-4 of range per sqrt(s), 10 s of motion of four frequencies an axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tool_bound import Readings, Truth

from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.parameters import Layout, channel_turn, inertia_of, symmetric, tilted
from truewrench.tool.prior import make_prior

Array = NDArray[np.float64]
LAYOUT = Layout(6)
POSES, APART, SECONDS, RATE = 12, 8.0, 10.0, 100
REPEATABILITY = 2e-4
SPREAD = 0.7  # of sensors: what is believed beforehand is 2
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def rig_of(gain_prior: float, channels: int = 6) -> Rig:
    span = [100.0] * 3 + [10.0] * 3
    sensor: dict[str, Any] = {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.1] * 3 + [0.005] * 3,
        "range": span,
        "gain_prior": gain_prior,
        "discrepancy": 0,
        "time_offset_prior": 0.0,
    }
    if channels != 6:  # gauges: rows of chance, of unit size
        rows = np.random.default_rng(channels).normal(size=(channels, 6))
        rows /= np.abs(rows).sum(axis=1, keepdims=True)
        sensor |= {
            "channels": [f"g{i}" for i in range(channels)],
            "nominal_gain": (rows / span).tolist(),
            "noise": [1e-3] * channels,
        }
    return tool_rig({"sensor": sensor, "gravity": [0, 0, -9.81]})


def newton_euler(at: Layout, theta: Array, gravity: Array, nu: Array, a: Array, fall_turn: Array) -> Array:
    """Wrench (N, 6) on the sensor of the tool that theta holds, point by point."""
    mass, c = float(np.exp(theta[at.log_mass])), theta[at.center_of_mass]
    inertia = symmetric(inertia_of(mass, theta[at.S]))
    fall = fall_turn @ tilted(gravity, theta[at.tilt])[0]
    omega, alpha = nu[:, 3:], a[:, 3:]
    at_mass = a[:, :3] + np.cross(omega, nu[:, :3]) + np.cross(alpha, c)
    at_mass += np.cross(omega, np.cross(omega, c)) - fall
    moment = alpha @ inertia + np.cross(omega, omega @ inertia) + mass * np.cross(c, at_mass)
    return -np.column_stack([mass * at_mass, moment])


def channels_of(rig: Rig, turns: Rotation) -> Readings:
    """Channels (N, n) of theta and a motion at attitudes R_root_sensor, without noise and drift."""
    at, R_sensor_root = Layout(rig.sensor.n), turns.inv().as_matrix()

    def readings(theta: Array, nu: Array, a: Array) -> Array:
        R6 = np.kron(np.eye(2), channel_turn(theta[at.mounting])[0])
        wrench = newton_euler(at, theta, rig.gravity_array, nu, a, R_sensor_root)
        return np.asarray(wrench @ (theta[at.gain].reshape(-1, 6) @ R6).T + theta[at.offset])

    return readings


def draw(rng: np.random.Generator, rig: Rig, seed: int) -> Array:
    """Theta from the prior, the body physical and of an ordinary mass."""
    prior, at = make_prior(rig, rig), Layout(rig.sensor.n)
    theta = rng.multivariate_normal(prior.mean, prior.covariance)
    theta[at.log_mass] = np.log(rng.uniform(0.5, 3.0))
    theta[at.center_of_mass] = rng.normal(size=3) * [0.02, 0.02, 0.03] + [0.0, 0.0, 0.09]
    root = 0.03 * rng.normal(size=(3, 3))
    S = np.diag([1e-6, 1e-6, 2e-3]) if seed % 4 == 0 else root @ root.T
    theta[at.S] = [S[i, j] for i, j in PAIRS]
    return theta


def read(rng: np.random.Generator, rig: Rig, theta: Array, truth: Truth) -> Array:
    """Channels with an offset of their own, its walk, noise and what a pose does not repeat."""
    theta[Layout(rig.sensor.n).offset] = rng.normal(size=rig.sensor.n) * rig.sensor.offset_prior_array
    ideal, scale, t = truth.readings(theta, truth.twist, truth.rate), rig.sensor.channel_scale, truth.time
    steps = rng.normal(size=ideal.shape) * np.sqrt(np.diff(t, prepend=t[0]))[:, None]
    drift = np.cumsum(steps, axis=0) * truth.walk * scale
    own = truth.repeatability * scale * rng.normal(size=ideal.shape)
    return ideal + drift - drift[-1] + own + rng.normal(size=ideal.shape) * rig.sensor.noise_array


def log_of(rig: Rig, turns: Rotation, t: Array, raw: Array, nu: Array, start: int) -> Log:
    quaternion = turns.as_quat()[:, [3, 0, 1, 2]]
    stamps = (t * 1e9).astype(np.int64) + start
    fall = turns.inv().apply(rig.gravity_array)
    return Log(None, "tool", "", stamps, raw, twist=nu, gravity=fall, attitude=quaternion)


def walk_of(rng: np.random.Generator, spread: float = SPREAD) -> float:
    """Rate of an offset's walk, fraction of range per sqrt(s); `spread` is 1 sigma of its logarithm."""
    return 1e-4 * float(np.exp(spread * rng.normal()))


def posed(rng: np.random.Generator, rig: Rig, theta: Array, spread: float = SPREAD) -> tuple[Log, Truth]:
    """Poses with their truth; theta gets the offset at their end."""
    turns, still, t = Rotation.random(POSES, random_state=rng), np.zeros((POSES, 6)), np.arange(POSES) * APART
    walk = walk_of(rng, spread)
    truth = Truth(channels_of(rig, turns), t, still, still, walk, REPEATABILITY, moving=False)
    return log_of(rig, turns, t, read(rng, rig, theta, truth), still, 0), truth


def swung(rng: np.random.Generator) -> tuple[Rotation, Array, Array, Array]:
    """Attitudes R_root_sensor, times, twist and its derivative of a motion of four frequencies an axis."""
    t = np.arange(int(SECONDS * RATE)) / RATE
    f, phase = rng.uniform(0.2, 0.9, (6, 4)), rng.uniform(0.0, 2.0 * np.pi, (6, 4))
    size = np.repeat([0.5, 1.0], 3)

    def twist(at: Array) -> Array:
        return size * np.sin(2.0 * np.pi * f * at[:, None, None] + phase).sum(axis=2)

    rate = size * (2.0 * np.pi * f * np.cos(2.0 * np.pi * f * t[:, None, None] + phase)).sum(axis=2)
    fine = twist((np.arange(4 * (t.size - 1)) + 0.5) / (4.0 * RATE))[:, 3:] / (4.0 * RATE)
    turns = [Rotation.random(random_state=rng)]
    for part in fine:
        turns.append(turns[-1] * Rotation.from_rotvec(part))
    return Rotation.concatenate(turns[::4]), t, twist(t), rate


def moved(rng: np.random.Generator, rig: Rig, theta: Array) -> tuple[Log, Truth]:
    """A motion with its truth; theta gets its offset."""
    way, t, nu, rate = swung(rng)
    truth = Truth(channels_of(rig, way), t, nu, rate, 0.0, 0.0, moving=True)
    raw = read(rng, rig, theta, truth)
    noisy = nu + rng.normal(size=nu.shape) * rig.motion.noise_array
    return log_of(rig, way, t, raw, noisy, 10**12), truth


def poses(rng: np.random.Generator, rig: Rig, theta: Array) -> Log:
    return posed(rng, rig, theta)[0]


def motion(rng: np.random.Generator, rig: Rig, theta: Array) -> Log:
    return moved(rng, rig, theta)[0]
