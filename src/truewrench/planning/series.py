"""Fourier series in the coordinates of a motion: joint positions, or the integral of a twist by component.

With w = 2 pi / period, coordinate by coordinate and for harmonics k = 1 ... H,

    z(t) = z(0) + sum_k  a_k sin(k w t) / (k w) + b_k (1 - cos(k w t)) / (k w),

so that a_k and b_k are amplitudes of the velocity. The motion is closed; it starts and ends at rest, with
neither velocity nor acceleration, when sum a_k = 0 and sum k b_k = 0.
"""

from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class SeriesBasis:
    """m functions that span the series, all of one period; with `rest` those that rest at both ends."""

    harmonics: int  # H
    period: float  # [s]
    rest: bool  # whether the motion starts and ends at rest

    @property
    def size(self) -> int:
        """m: coefficients of one coordinate."""
        return 2 * (self.harmonics - 1) if self.rest else 2 * self.harmonics

    def table(self, time: Array, derivative: int) -> Array:
        """(N, m) of the basis functions at the times, or of their 1st, 2nd or 3rd derivatives."""
        k = np.arange(1, self.harmonics + 1)
        rate = 2.0 * np.pi / self.period * k
        angle = np.asarray(time)[:, None] * rate
        sine, cosine = np.sin(angle), np.cos(angle)
        a, b = {
            0: (sine / rate, (1.0 - cosine) / rate),
            1: (cosine, sine),
            2: (-rate * sine, rate * cosine),
            3: (-(rate**2) * cosine, -(rate**2) * sine),
        }[derivative]
        if not self.rest:
            return np.hstack([a, b])
        # orthonormal bases of sum a_k = 0 and of sum k b_k = 0
        return np.hstack([a @ _null_space(np.ones(k.size)), b @ _null_space(k.astype(np.float64))])


def _null_space(normal: Array) -> Array:
    """(H, H - 1) orthonormal columns that a vector (H,) is normal to."""
    q = np.linalg.qr(np.column_stack([normal, np.eye(normal.size)[:, 1:]]))[0]
    return np.asarray(q[:, 1:])


@dataclass(frozen=True, slots=True, eq=False)
class FourierMotion:
    """One series per coordinate, repeated until the motion ends."""

    basis: SeriesBasis  # the functions
    start: Array  # (n,) coordinates at time 0
    coefficients: Array  # (m, n)
    duration: float  # a whole number of periods [s]

    def position(self, time: Array) -> Array:
        """Coordinates (N, n) at the times (N,) [s]."""
        return np.asarray(self.start + self.basis.table(time, 0) @ self.coefficients)

    def velocity(self, time: Array) -> Array:
        """Their first derivatives (N, n)."""
        return np.asarray(self.basis.table(time, 1) @ self.coefficients)

    def acceleration(self, time: Array) -> Array:
        """Their second derivatives (N, n)."""
        return np.asarray(self.basis.table(time, 2) @ self.coefficients)
