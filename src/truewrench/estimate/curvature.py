"""What an uncertain payload adds to the uncertainty of a gain beyond the first order (docs/method.md)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["PAYLOAD", "Curvature", "enlarged"]

Array = NDArray[np.float64]

PAYLOAD = 10
"""Departures of a payload: mass, relative; centre of mass [m]; xx yy zz xy xz yz of the inertia, relative."""

_INERTIA = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_EXACT = 1e-8  # 1 sigma of a departure below which nothing can be said of its effect
_SINGULAR = 1e-3  # of the largest singular value of the gain
# A product of two normal deviates has long tails: it leaves 2.8 * 1.5 of its own sigma as rarely (0.5%) as
# one deviate leaves 2.8. A normal distribution that stands for it needs 1.5^2 times its variance.
TAILS = 2.25


@dataclass(frozen=True, slots=True, eq=False)
class Curvature:
    """How far a gain departs from its tangent when the payload does from its estimate.

    The data fix X T(p), with X = [C b] and [w(t; p); 1] = T(p) [w(t); 1], far better than they know p: the
    posterior is normal in (X T(p), p), and X itself moves on a curve.

    Attributes:
        covariance: (q + 10, q + 10) of [gain row by row, offset if there is one, departures of the payload].
        form: (n, c, 16, 16) for each element of X (n, c), symmetric: its departure is the quadratic form of
            [the gain's row; the payload].
        tangent: (q, 10) change of gain and offset with the payload.
    """

    covariance: Array
    form: Array
    tangent: Array

    @classmethod
    def of(cls, gain: Array, covariance: Array, mass: float, stated: float, inertia: Array) -> Curvature:
        """From an estimate and its covariance.

        Args:
            gain: (n, 6), normalised.
            covariance: as in the class.
            mass: estimate of the payload's [kg].
            stated: mass that departures are relative to [kg].
            inertia: (3, 3) that departures are relative to [kg m^2].
        """
        n, q = len(gain), len(covariance) - PAYLOAD
        columns = q // n
        sigma = np.sqrt(np.diag(covariance)[q:])
        unit = np.outer(sigma, sigma)
        # K = P_xp P_pp^-1 = -C dT/dp: what the data make of a change of the payload
        tangent = np.linalg.solve(covariance[q:, q:] / unit, covariance[q:, :q] / sigma[:, None]).T / sigma
        tangent[:, sigma < _EXACT] = 0.0
        by_payload = np.concatenate(
            [x.reshape(n, -1, PAYLOAD) for x in (tangent[: 6 * n], tangent[6 * n :])], axis=1
        )
        # T^-1 = 1 + A_i p_i + (A_i A_j - T_ij / 2) p_i p_j
        A = np.einsum("kn,nmi->ikm", np.linalg.pinv(gain, rcond=_SINGULAR), by_payload)  # (10, 6, c)
        square = np.einsum("ikl,jlm->ijkm", A[:, :, :6], A)
        bend = np.array(square)
        bend[0, 1:4] += A[1:4] * stated / mass  # w is linear in the mass
        root = np.sqrt(np.diag(inertia))
        for k, (i, j) in enumerate(_INERTIA):  # a shifted centre of mass: m (c^2 E - c c^T) of inertia
            effect = mass / (root[i] * root[j]) * A[4 + k]
            bend[1 + i, 1 + j] -= effect
            if i == j:
                bend[[1, 2, 3], [1, 2, 3]] += effect
        # X T(p) is independent of the payload: of [C b] its part, the rest of what [C b] departs by
        both = np.einsum("rk,ijkm->rmij", gain, bend - square)
        form = np.zeros((n, columns, 6 + PAYLOAD, 6 + PAYLOAD))
        form[:, :, :6, 6:] = 0.5 * A.transpose(2, 1, 0)
        form[:, :, 6:, :6] = 0.5 * A.transpose(2, 0, 1)
        form[:, :, 6:, 6:] = 0.5 * (both + both.swapaxes(2, 3))
        return cls(covariance, form, tangent)

    def second_moment(self) -> Array:
        """(q, q) of the departure, as a normal distribution that has its tails needs it."""
        return self._moment(self.covariance)

    def alone(self, departures: Iterable[int]) -> Array:
        """The same if only these departures of the payload, of 0 ... 9, were uncertain and nothing else."""
        at = list(departures)
        q = len(self.tangent)
        effect = np.vstack([self.tangent, np.eye(PAYLOAD)])[:, at]
        known = self.covariance[q:, q:][np.ix_(at, at)]
        return self._moment(effect @ known @ effect.T)

    def _moment(self, covariance: Array) -> Array:
        """Of normal deviates x, y: E[x'Fx] = tr F P_xx, Cov[x'Fx, y'Gy] = 2 tr F P_xy G P_yx."""
        n, columns = self.form.shape[:2]
        q = len(covariance) - PAYLOAD
        rows = np.hstack([np.arange(6 * n).reshape(n, 6), np.tile(np.arange(q, q + PAYLOAD), (n, 1))])
        P = covariance[rows[:, None, :, None], rows[None, :, None, :]]  # (n, n, 16, 16)
        FP = self.form[:, :, None] @ P[:, None]  # (n, c, n, 16, 16)
        size = 6 + PAYLOAD
        left = FP.transpose(0, 2, 1, 3, 4).reshape(n, n, columns, size * size)
        right = FP.transpose(2, 0, 4, 3, 1).reshape(n, n, size * size, columns)
        moment = 2.0 * (left @ right).transpose(0, 2, 1, 3).reshape(q, q)
        own = np.arange(n)
        mean = np.trace(FP[own, :, own], axis1=2, axis2=3).ravel()
        order = np.arange(q).reshape(n, columns)
        at = np.concatenate([order[:, :6].ravel(), order[:, 6:].ravel()])
        moment = (moment + np.outer(mean, mean))[np.ix_(at, at)]
        return TAILS * _positive_part(moment, np.sqrt(np.maximum(np.diag(moment), 0.0)))


def enlarged(moment: Array, other: Array, sigma: Array) -> Array:
    """A second moment that is smaller than neither of two; other may be of the first elements only.

    Args:
        moment: (q, q).
        other: (k, k), k <= q.
        sigma: (k,) units of the elements.
    """
    k = len(other)
    out = np.array(moment)
    out[:k, :k] += _positive_part(other - moment[:k, :k], sigma)
    return out


def _positive_part(matrix: Array, unit: Array) -> Array:
    """Symmetric, without its negative eigenvalues in units of its elements."""
    unit = np.where(unit > 0.0, unit, 1.0)
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T) / np.outer(unit, unit))
    half = vectors * np.sqrt(np.maximum(values, 0.0)) * unit[:, None]
    return np.asarray(half @ half.T)
