"""Motions of a payload as functions of time: sinusoidal wrenches ([A00] 13-17) and twists, planned twists.

Conventions are those of docs/notation.md: six-vectors are linear first, angular second; the twist
``nu = [v; Omega]`` and its component-wise derivative ``a`` are in sensor axes; SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import OdeSolution, solve_ivp
from scipy.interpolate import BSpline, make_interp_spline

from truewrench.model.arrays import Array, Integers
from truewrench.model.motion.spatial import cross, rotated, turns_between

_ATTITUDE_STEP = 2e-3  # [s] at most: to 1e-11 [rad] in a second at 40 rad/s and 10 Hz, by its sixth power


class Trajectory(Protocol):
    """A twist of one body-fixed point in sensor axes, known at every time."""

    @property
    def duration(self) -> float:
        """Length of the motion [s]; it starts at time 0."""
        ...

    def twist(self, time: Array) -> Array:
        """Twist (N, 6) at the times (N,) [s]."""
        ...

    def acceleration(self, time: Array) -> Array:
        """Component-wise derivative of the twist (N, 6) at the times (N,) [s]."""
        ...


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid payload: mass [kg], centre of mass from the sensor origin [m], inertia about it [kg m^2]."""

    mass: float
    center_of_mass: Array
    inertia: Array


@dataclass(frozen=True, slots=True)
class HarmonicTwist:
    """Twist ``sum_k amplitude_k sin(2 pi frequency_k t + phase_k)``; the three arrays are (K, 6)."""

    amplitude: Array
    frequency: Array
    phase: Array
    duration: float

    def twist(self, time: Array) -> Array:
        """Twist (N, 6) at the times (N,) [s]."""
        return np.asarray((self.amplitude * np.sin(self._angle(time))).sum(axis=1))

    def acceleration(self, time: Array) -> Array:
        """Component-wise derivative of the twist (N, 6)."""
        rate = 2.0 * np.pi * self.frequency
        return np.asarray((self.amplitude * rate * np.cos(self._angle(time))).sum(axis=1))

    def scaled(self, factor: float | Array) -> HarmonicTwist:
        """The same motion with every amplitude times `factor`, of all axes or of each (6,)."""
        return HarmonicTwist(self.amplitude * factor, self.frequency, self.phase, self.duration)

    def _angle(self, time: Array) -> Array:
        return np.asarray(2.0 * np.pi * self.frequency * np.asarray(time)[:, None, None] + self.phase)


@dataclass(frozen=True, slots=True)
class SplineTwist:
    """A twist given at times and interpolated by a quintic spline."""

    spline: BSpline
    duration: float

    @classmethod
    def through(cls, time: Array, twist: Array) -> SplineTwist:
        """Interpolate the twist (N, 6) at strictly increasing times (N,) [s], N >= 6; time 0 is the first."""
        t = np.asarray(time, dtype=np.float64)
        spline = make_interp_spline(t - t[0], np.asarray(twist, dtype=np.float64), k=5)
        return cls(spline, float(t[-1] - t[0]))

    def twist(self, time: Array) -> Array:
        """Twist (N, 6) at the times (N,) [s]."""
        return np.asarray(self.spline(time))

    def acceleration(self, time: Array) -> Array:
        """Component-wise derivative of the twist (N, 6)."""
        return np.asarray(self.spline(time, nu=1))


@dataclass(frozen=True, slots=True)
class WrenchSinusoids:
    """Persistently exciting wrench ([A00] 13).

    ``f_i = f0_i sin(2 pi k_i t/tau)``, ``n_i = n0_i cos(2 pi k_i t/tau)``.
    """

    force: Array  # f0 (3,) [N]
    moment: Array  # n0 (3,) [N m]
    k: Integers  # three distinct integers
    tau: float  # period [s]

    @classmethod
    def of(cls, force: ArrayLike, moment: ArrayLike, k: ArrayLike, tau: float) -> WrenchSinusoids:
        """Build from plain sequences; the three `k` must be distinct positive integers."""
        counts = np.asarray(k, dtype=np.int64)
        if counts.shape != (3,) or len(set(counts.tolist())) != 3 or counts.min() < 1:
            raise ValueError(f"k: {k!r}, expected three distinct positive integers")
        return cls(
            np.asarray(force, dtype=np.float64), np.asarray(moment, dtype=np.float64), counts, float(tau)
        )

    def wrench(self, time: Array) -> Array:
        """Wrench (N, 6) of the payload on the sensor at the times (N,) [s]."""
        angle = 2.0 * np.pi * self.k * np.asarray(time)[..., None] / self.tau
        return np.concatenate([self.force * np.sin(angle), self.moment * np.cos(angle)], axis=-1)


@dataclass(frozen=True, slots=True)
class WrenchMotion:
    """The motion of a free body under a given wrench, integrated from an initial twist at time 0."""

    wrench: WrenchSinusoids
    body: Body
    duration: float
    state: OdeSolution  # [v; Omega; r; quaternion xyzw] as a function of time

    def twist(self, time: Array) -> Array:
        """Twist of the centre of mass (N, 6) at the times (N,) [s]."""
        return self._states(time)[:, :6]

    def acceleration(self, time: Array) -> Array:
        """Component-wise derivative of the twist (N, 6), from the equations of motion."""
        t = np.asarray(time, dtype=np.float64)
        return motion_of_wrench(self.body, self.wrench.wrench(t), self.twist(t))

    def pose(self, time: Array) -> tuple[Array, Array]:
        """Position of the centre of mass (N, 3) [m] and attitude quaternion xyzw (N, 4), inertial frame."""
        state = self._states(time)
        quaternion = state[:, 9:13]
        return state[:, 6:9], quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)

    def _states(self, time: Array) -> Array:
        t = np.atleast_1d(np.asarray(time, dtype=np.float64))
        return (
            np.asarray(self.state(t).T) if t.size else np.empty((0, 13))
        )  # SciPy's solution takes no empty array


def motion_of_wrench(body: Body, wrench: Array, twist: Array) -> Array:
    """Acceleration (N, 6) of a free body from its wrench (N, 6) on the sensor and its twist (N, 6).

    The inverse of [A00] 5-8, without gravity: ``vdot = -f/m - Omega x v``,
    ``Omegadot = I_c^-1 (c x f - n - Omega x I_c Omega)``.
    """
    force, moment = wrench[..., :3], wrench[..., 3:]
    velocity, omega = twist[..., :3], twist[..., 3:]
    linear = -force / body.mass - cross(omega, velocity)
    torque = cross(body.center_of_mass, force) - moment - cross(omega, omega @ body.inertia.T)
    return np.concatenate([linear, torque @ np.linalg.inv(body.inertia).T], axis=-1)


def integrate_wrench(
    wrench: WrenchSinusoids, body: Body, duration: float, initial_twist: Array | None = None
) -> WrenchMotion:
    """Integrate the motion that a wrench trajectory asks of a free body, pose included ([A00] 15-17).

    The centre of mass has the initial twist (6,), by default 0; the attitude starts as the identity and the
    position at the origin.
    """
    inverse_inertia = np.linalg.inv(body.inertia)
    mass, lever, inertia = body.mass, body.center_of_mass, body.inertia

    def rate(t: float, x: Array) -> Array:
        w = wrench.wrench(np.asarray(t))
        v, omega, q = x[:3], x[3:6], x[9:13]
        r = rotation_matrix(q / np.linalg.norm(q))
        vdot = -w[:3] / mass - cross(omega, v)
        omegadot = inverse_inertia @ (cross(lever, w[:3]) - w[3:] - cross(omega, inertia @ omega))
        return np.concatenate([vdot, omegadot, r @ v, _quaternion_rate(q, omega)])

    start = np.zeros(13)
    start[:6] = 0.0 if initial_twist is None else initial_twist
    start[12] = 1.0

    return WrenchMotion(wrench, body, float(duration), _integrate(rate, duration, start))


def attitude(trajectory: Trajectory, time: Array) -> Array:
    """Rotations R_root_sensor (N, 3, 3) at times (N,) >= 0, integrated from Omega; the identity at time 0."""
    t = np.asarray(time, dtype=np.float64)
    nodes = np.union1d(np.append(t, 0.0), np.arange(0.0, float(t.max()), _ATTITUDE_STEP))
    turns = turns_between(lambda at: trajectory.twist(at)[:, 3:], nodes)
    return rotated(turns)[np.searchsorted(nodes, t)]


def excitation_alpha(time: Array, wrench: Array) -> float:
    """The alpha of [A00] 12: smallest eigenvalue of ``integral w w^T dt`` over a record of wrenches (N, 6).

    Units mix ([N^2 s] and [N^2 m^2 s]): divide the wrench by the sensor's range to compare motions.
    """
    return float(np.linalg.eigvalsh(np.trapezoid(wrench[:, :, None] * wrench[:, None, :], time, axis=0))[0])


def rotation_matrix(quaternion: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions xyzw (..., 4)."""
    x, y, z, w = np.moveaxis(np.asarray(quaternion), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _quaternion_rate(quaternion: Array, omega: Array) -> Array:
    """``qdot = q (Omega, 0) / 2`` for the body rate Omega (3,)."""
    x, y, z, w = quaternion
    p, q, r = omega
    return 0.5 * np.array(
        [w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p, -x * p - y * q - z * r]
    )


def _integrate(rate: Callable[[float, Array], Array], until: float, start: Array) -> OdeSolution:
    """Solution of ``dx/dt = rate(t, x)`` from time 0 to `until`, with errors far below any noise."""
    solution = solve_ivp(
        rate,
        (0.0, until),
        start,
        method="DOP853",
        dense_output=True,
        rtol=1e-11,
        atol=1e-12,
        max_step=0.05,  # [s], so that no short burst of motion is stepped over
    )
    if solution.sol is None or not solution.success:
        raise RuntimeError(f"the motion could not be integrated: {solution.message}")
    return solution.sol
