"""Tools with an honest covariance, motions of the sensor, and what it measures, written without the core."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tool_cases import a_rig, a_tool

from truewrench.model.motion.spatial import cross
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.model import Tool

Array = NDArray[Any]

AXIS = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
START = Rotation.from_rotvec([0.4, -0.7, 0.2])


def tool_of(seed: int = 0, *, size: float = 1.0, **rig: Any) -> Tool:
    """A tool of 2 kg whose covariance has the correlations of chance.

    Args:
        seed: of it.
        size: of all sigmas: 1: 1% gains, 0.5% mass, 0.5 mm, 0.2 N and 0.02 N m of offset.
        **rig: of `a_rig`.
    """
    rng, tool = np.random.default_rng(seed), a_tool(seed)
    settings = tool_rig(a_rig(motion={"source": "twist", "of": "sensor", "noise": [1e-3] * 6}, **rig))
    n = settings.sensor.n
    wrench = np.array([0.2, 0.2, 0.2, 0.02, 0.02, 0.02])
    sigma = np.concatenate(
        [
            np.full(36, 0.01),
            [5e-3],
            np.full(3, 5e-4),
            np.full(6, 1e-4),
            wrench,
            np.full(3, 3e-3),
            np.full(2, 3e-3),
        ]
    )
    sigma[:36] *= np.outer(wrench, 1.0 / wrench).ravel()  # moments from forces are small, and so on
    sigma *= size
    root = rng.normal(size=(sigma.size, 2 * sigma.size)) / np.sqrt(2.0 * sigma.size)
    covariance = (root @ root.T) * np.outer(sigma, sigma)
    covariance = 0.5 * (covariance + covariance.T)
    std, layout = np.sqrt(np.diag(covariance)), tool.layout
    assert n == 6
    return replace(
        tool,
        rig=settings,
        covariance=covariance,
        mass_std=tool.mass * std[layout.log_mass],
        center_of_mass_std=std[layout.center_of_mass],
        offset_std=std[layout.offset],
        mounting_std=std[layout.mounting],
        tilt_std=std[layout.tilt],
        sample_noise=settings.sensor.noise_array,
        vibrations=np.zeros((0, 1 + n)),
        offset_time_ns=0,
        offset_walk=np.array([0.02, 0.02, 0.02, 0.002, 0.002, 0.002]),
    )


@dataclass(frozen=True)
class Swing:
    """A motion of the sensor: a swing about a fixed axis and a wave of its origin; R is R_root_sensor."""

    rate: float = 3.0
    amplitude: float = 0.8
    start: Rotation = START

    def R(self, time: Array) -> Array:
        """(N, 3, 3)."""
        angle = self.amplitude * np.sin(self.rate * time)
        return (self.start * Rotation.from_rotvec(angle[:, None] * AXIS)).as_matrix()

    def twist(self, time: Array) -> tuple[Array, Array]:
        """(N, 6) of the origin in sensor axes, and its component-wise derivative."""
        rates, phases = np.array([2.0, 3.0, 4.0]), np.array([0.0, 1.0, 2.0])
        turns = self.amplitude * self.rate * np.cos(self.rate * time)
        faster = -self.amplitude * self.rate**2 * np.sin(self.rate * time)
        angle = rates * time[:, None] + phases
        size = np.array([0.3, 0.2, 0.1])
        v, vdot = size * np.sin(angle), size * rates * np.cos(angle)
        return np.hstack([v, turns[:, None] * AXIS]), np.hstack([vdot, faster[:, None] * AXIS])


def unpacked(theta: Array) -> tuple[Array, float, Array, Array, Array, Array, Array]:
    """Gain, mass, c, inertia (3, 3), offset, R of the mounting, tilt of six channels' parameters."""
    mass, S = float(np.exp(theta[36])), theta[40:46]
    moments = np.array([[S[0], S[3], S[4]], [S[3], S[1], S[5]], [S[4], S[5], S[2]]])
    inertia = mass * (np.trace(moments) * np.eye(3) - moments)
    R = Rotation.from_euler("xyz", theta[52:55]).as_matrix().T
    return theta[:36].reshape(6, 6), mass, theta[37:40], inertia, theta[46:52], R, theta[55:57]


def tilted(gravity: Array, tilt: Array) -> Array:
    """Gravity turned by two angles about axes normal to it."""
    size = np.linalg.norm(gravity)
    e1 = cross(gravity, np.eye(3)[int(np.argmin(np.abs(gravity)))])
    e1 /= np.linalg.norm(e1)
    e2 = cross(gravity, e1) / size
    x = gravity + cross(e1, gravity) * tilt[0] + cross(e2, gravity) * tilt[1]
    return np.asarray(x * size / np.linalg.norm(x))


def body_wrench(mass: float, c: Array, inertia: Array, nu: Array, a: Array, g: Array) -> Array:
    """Reaction of a body on the sensor, (N, 6); Newton and Euler at the centre of mass."""
    v, omega, vdot, alpha = nu[:, :3], nu[:, 3:], a[:, :3], a[:, 3:]
    of_mass = vdot + cross(omega, v) + cross(alpha, c) + cross(omega, cross(omega, c))
    f = mass * (of_mass - g)
    n = cross(c, f) + alpha @ inertia.T + cross(omega, omega @ inertia.T)
    return -np.hstack([f, n])


def raw_of(theta: Array, sign: int, gravity: Array, motion: Swing, time: Array, contact: Array) -> Array:
    """(N, 6) channels without noise."""
    gain, mass, c, inertia, offset, R, tilt = unpacked(theta)
    g = np.einsum("kji,j->ki", motion.R(time), tilted(gravity, tilt))
    w = sign * body_wrench(mass, c, inertia, *motion.twist(time), g) + contact
    return np.hstack([w[:, :3] @ R.T, w[:, 3:] @ R.T]) @ gain.T + offset


def columns_of(motion: Swing, time: Array) -> dict[str, Array]:
    """Twist and attitude as a log has them."""
    nu = motion.twist(time)[0]
    quaternion = Rotation.from_matrix(motion.R(time)).as_quat()[:, [3, 0, 1, 2]]
    columns = {name: nu[:, k] for k, name in enumerate(("vx", "vy", "vz", "wx", "wy", "wz"))}
    return columns | {name: quaternion[:, k] for k, name in enumerate(("qw", "qx", "qy", "qz"))}


def write_log(path: Path, time_ns: NDArray[np.int64], raw: Array, columns: dict[str, Array]) -> Path:
    """A CSV of them, every number to its last bit."""
    names = ["time_ns", *(f"raw_{i}" for i in range(raw.shape[1])), *columns]
    rows = [",".join(names)]
    for k, stamp in enumerate(time_ns):
        values = [*raw[k], *(column[k] for column in columns.values())]
        rows.append(",".join([str(int(stamp)), *("" if np.isnan(x) else repr(float(x)) for x in values)]))
    path.write_text("\n".join(rows) + "\n")
    return path
