"""Motions of a free body under many sinusoidal wrenches at once ([A00] 13-17)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.motion.spatial import cross
from truewrench.model.motion.trajectory import Body, motion_of_wrench, rotation_matrix

_STEPS_PER_PERIOD = 16  # of the fastest sinusoid, by Runge and Kutta's fourth order
_FEWEST_STEPS = 120
_DIFFERENCE = 1e-4  # [m/s, rad/s] of an initial twist, for the derivative of its drift


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """B wrenches ``f_i = f0_i sin(2 pi k_i t/tau)``, ``n_i = n0_i cos(2 pi k_i t/tau)`` on one body."""

    body: Body  # the payload
    force: Array  # (B, 3) f0 [N]
    moment: Array  # (B, 3) n0 [N m]
    k: Integers  # (B, 3) three distinct integers each
    tau: float  # their period, and the length of the motion [s]

    def scaled(self, factor: float) -> Batch:
        """All amplitudes times a factor."""
        return Batch(self.body, factor * self.force, factor * self.moment, self.k, self.tau)

    def chosen(self, which: Mask | Integers) -> Batch:
        """Some of the wrenches."""
        return Batch(self.body, self.force[which], self.moment[which], self.k[which], self.tau)

    def wrench(self, time: Array) -> Array:
        """(T, B, 6) at times (T,)."""
        angle = (2.0 * np.pi / self.tau) * time[:, None, None] * self.k
        return np.concatenate([self.force * np.sin(angle), self.moment * np.cos(angle)], axis=2)

    def slow_twist(self) -> Array:
        """(B, 6) initial twists without drift, for motions so slow that Omega x v does not matter."""
        rate = 2.0 * np.pi * self.k / self.tau
        linear = self.force / (self.body.mass * rate)
        # Omegadot = I^-1 (c x f - n): what the sine of f gives is a cosine and needs an initial value
        angular = -cross(self.body.center_of_mass, self.force / rate) @ np.linalg.inv(self.body.inertia).T
        return np.concatenate([linear, angular], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """What the wrenches do to the body, in S + 1 even steps."""

    time: Array  # (S + 1,) [s]
    twist: Array  # (S + 1, B, 6) of the centre of mass
    acceleration: Array  # (S + 1, B, 6)
    place: Array  # (S + 1, B, 3) of the centre of mass, from where it starts, in the axes at the start [m]
    rotation: Array  # (S + 1, B, 3, 3) from body axes into those

    @property
    def drift(self) -> Array:
        """(B, 6) mean twist by component."""
        return np.asarray(np.trapezoid(self.twist, self.time, axis=0) / self.time[-1])


def integrated(batch: Batch, initial: Array, *, placed: bool = True) -> Motions:
    """Integrate from initial twists (B, 6); without `placed` the pose stays at the start."""
    steps = max(_FEWEST_STEPS, _STEPS_PER_PERIOD * int(batch.k.max()))
    time = np.linspace(0.0, batch.tau, steps + 1)
    h, count = batch.tau / steps, len(batch.k)
    state = np.zeros((count, 13))
    state[:, :6], state[:, 12] = initial, 1.0
    states = np.empty((steps + 1, count, 13))
    states[0] = state

    # what the wrench does, at every half step, is known beforehand; what the turning adds is not
    half = batch.wrench(np.linspace(0.0, batch.tau, 2 * steps + 1))
    driven = motion_of_wrench(batch.body, half, np.zeros_like(half))
    inertia, inverse = batch.body.inertia.T, np.linalg.inv(batch.body.inertia).T

    def turning(twist: Array) -> Array:
        omega = twist[..., 3:]
        angular = cross(omega, omega @ inertia) @ inverse
        return np.concatenate([cross(omega, twist[..., :3]), angular], axis=-1)

    def rate(at: int, x: Array) -> Array:
        twist = x[:, :6]
        found = np.zeros_like(x)
        found[:, :6] = driven[at] - turning(twist)
        if placed:
            q, omega = x[:, 9:], twist[:, 3:]
            found[:, 6:9] = np.einsum("bij,bj->bi", rotation_matrix(q), twist[:, :3])
            found[:, 9:12] = 0.5 * (q[:, 3:] * omega + cross(q[:, :3], omega))
            found[:, 12] = -0.5 * np.einsum("bi,bi->b", q[:, :3], omega)
        return found

    for s in range(steps):
        k1 = rate(2 * s, state)
        k2 = rate(2 * s + 1, state + 0.5 * h * k1)
        k3 = rate(2 * s + 1, state + 0.5 * h * k2)
        k4 = rate(2 * s + 2, state + h * k3)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        state[:, 9:] /= np.linalg.norm(state[:, 9:], axis=1, keepdims=True)
        states[s + 1] = state
    twist = states[..., :6]
    acceleration = driven[::2] - turning(twist)
    return Motions(time, twist, acceleration, states[..., 6:9], rotation_matrix(states[..., 9:]))


def without_drift(batch: Batch, initial: Array, steps: int = 2) -> Array:
    """Initial twists (B, 6) that leave no mean twist, by Gauss and Newton from given ones.

    Where that does not reduce the drift, the given twist stays.
    """
    count = len(batch.k)
    many = batch.chosen(np.tile(np.arange(count), 7))
    for _ in range(steps):
        tried = np.tile(initial, (7, 1)).reshape(7, count, 6)
        tried[1:] += _DIFFERENCE * np.eye(6)[:, None]
        drift = integrated(many, tried.reshape(-1, 6), placed=False).drift.reshape(7, count, 6)
        jacobian = ((drift[1:] - drift[0]) / _DIFFERENCE).transpose(1, 2, 0)  # (B, drift, twist)
        finite = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(drift[0]).all(axis=1)
        step = np.zeros((count, 6))
        for b in np.flatnonzero(finite):
            step[b] = -np.linalg.lstsq(jacobian[b], drift[0, b], rcond=1e-6)[0]
        better = initial + step
        after = integrated(batch, better, placed=False).drift
        improved = np.linalg.norm(after, axis=1) < np.linalg.norm(drift[0], axis=1)
        initial = np.where(improved[:, None], better, initial)
    return initial
