"""Motions of an arm's joints as functions of time; (N, n), joints in the order of the chain, SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from truewrench.model.arrays import Array


class JointTrajectory(Protocol):
    """Positions, velocities and accelerations of n joints, known at every time."""

    @property
    def duration(self) -> float:
        """Length of the motion [s]; it starts at time 0."""
        ...

    def position(self, time: Array) -> Array:
        """Joint positions (N, n) at the times (N,) [s]: rad, or m of prismatic joints."""
        ...

    def velocity(self, time: Array) -> Array:
        """Joint velocities (N, n)."""
        ...

    def acceleration(self, time: Array) -> Array:
        """Joint accelerations (N, n)."""
        ...


@dataclass(frozen=True, slots=True)
class JointCurves:
    """Positions of n joints as one spline (N, n), and its derivatives."""

    spline: BSpline

    def position(self, time: Array) -> Array:
        """Joint positions (N, n) at the times (N,) [s]."""
        return np.asarray(self.spline(time))

    def velocity(self, time: Array) -> Array:
        """Joint velocities (N, n)."""
        return np.asarray(self.spline(time, nu=1))

    def acceleration(self, time: Array) -> Array:
        """Joint accelerations (N, n)."""
        return np.asarray(self.spline(time, nu=2))


@dataclass(frozen=True, slots=True)
class SplineJoints(JointCurves):
    """Joint positions given at times and interpolated by a quintic spline."""

    duration: float

    @classmethod
    def through(
        cls, time: Array, position: Array, velocity: Array | None = None, acceleration: Array | None = None
    ) -> SplineJoints:
        """Interpolate positions (N, n) at N >= 6 strictly increasing times [s]; time 0 is the first.

        The first and the last row of velocity and acceleration (N, n) hold at the ends: a motion that ends at
        rest does so to the last bit. That is left to the spline when either is left out.
        """
        t = np.asarray(time, dtype=np.float64)
        ends: Any = None
        if velocity is not None and acceleration is not None:
            first, last = ([(1, velocity[k]), (2, acceleration[k])] for k in (0, -1))
            ends = (first, last)
        spline = make_interp_spline(t - t[0], np.asarray(position, dtype=np.float64), k=5, bc_type=ends)
        return cls(spline, float(t[-1] - t[0]))
