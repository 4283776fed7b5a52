"""What the product of gain and body adds to mean and covariance, beyond the derivatives at the estimate.

The channels show K = C M(b), M the payload's spatial inertia: what is not told of the body b moves the gain
along K, and the estimate, the likeliest gain and body together, is not the middle of what is left.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truewrench.motion.spatial import cross_matrix

__all__ = ["PAIRS", "Carried", "bend", "changes", "explained", "to_the_middle", "volume_slope"]

Array = NDArray[np.float64]

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Of an inertia as xx yy zz xy xz yz."""
_NOTHING = 1e-17  # variance of a parameter that is exact
_FLAT = 1e-12  # of the largest moment of inertia: a body that thin resists no turn


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """A payload that logs moved.

    Attributes:
        places: (10,) of log mass, centre of mass, inertia xx yy zz xy xz yz among the parameters.
        mass: as found [kg].
        center_of_mass: (3,) on the sensor [m].
        inertia: (3, 3) about the centre of mass [kg m^2].
        felt: (6, 6) sum of w w^T over its samples, w its wrench on the sensor.
    """

    places: NDArray[np.int64]
    mass: float
    center_of_mass: Array
    inertia: Array
    felt: Array


def changes(mass: float, center: Array, inertia: Array, inertia_std: float = 0.0) -> Array:
    """L_k = (dM / db_k) M^-1 (10, 6, 6): where w is felt of a body, w + L_k w db_k is of one that is another.

    Args:
        mass: [kg]; its logarithm is b_0.
        center: (3,) of mass on the sensor [m], b_1 to b_3.
        inertia: (3, 3) about it [kg m^2], b_4 to b_9.
        inertia_std: 1 sigma of a moment of inertia; what is below resists no turn.
    """
    m, zero, E = mass, np.zeros((3, 3)), cross_matrix(np.eye(3))
    c = cross_matrix(center[None])[0]
    by_mass = np.block([[m * np.eye(3), -m * c], [m * c, -m * c @ c]])
    by_center = [np.block([[zero, -m * e], [m * e, -m * (e @ c + c @ e)]]) for e in E]
    by_inertia = np.zeros((6, 6, 6))
    for k, (i, j) in enumerate(PAIRS):
        by_inertia[k, 3 + i, 3 + j] = by_inertia[k, 3 + j, 3 + i] = 1.0
    flat = max(inertia_std, _FLAT * float(np.abs(inertia).max()), 1e-300) ** 2
    against = np.linalg.solve(inertia @ inertia + flat * np.eye(3), inertia)
    X = np.block([[np.eye(3), c], [zero, np.eye(3)]])  # M = X^-T diag(m, I) X^-1
    inner = np.block([[np.eye(3) / m, zero], [zero, against]])
    return np.asarray(np.stack([by_mass, *by_center, *by_inertia]) @ (X @ inner @ X.T))


def bend(gain: Array, center: Array, prior: Array) -> Array:
    """What the product of gain of moment and centre of mass adds to the covariance of the gain (6n, 6n).

    Of the force f the channels feel (C_f + C_m [c]) f. Where C_m is not told, an error of c turns it into one
    of C_f that no derivative at the estimate shows: dC_m [dc]. No gain's variance rises above its prior's.

    Args:
        gain: (6n, 6n) covariance, row by row [raw units, SI].
        center: (3, 3) of the centre of mass [m^2].
        prior: (6n,) variances of the gain beforehand.
    """
    n = len(gain) // 6
    E = cross_matrix(np.eye(3))
    moments = gain.reshape(n, 6, n, 6)[:, 3:, :, 3:]
    added = np.zeros((n, 6, n, 6))
    added[:, :3, :, :3] = np.einsum("pq,pka,ikjl,qlb->iajb", center, E, moments, E, optimize=True)
    out = added.reshape(6 * n, 6 * n)
    room, most = np.maximum(prior - np.diag(gain), 0.0), np.diag(out)
    g = np.sqrt(np.minimum(room, most) / np.where(most > 0.0, most, 1.0))
    return np.asarray(out * np.outer(g, g))


def volume_slope(change: Array, told: Array) -> Array:
    """How the volume of gains that the data leave falls as the body grows: 1/2 d log |H_CC| / db (k,).

    p(b) ~ exp(-Q(b) / 2) |H_CC(b)|^(-1/2), H_CC the information on the gain where the body is b, of which
    the data tell that of the product K alone: tr[(1 x L_k) H P].

    Args:
        change: (k, 6, 6) L_k.
        told: (6n, 6n) H P: the data's information on the gain times its covariance once the body is known.
    """
    n = len(told) // 6
    return np.asarray(np.einsum("kab,ibia->k", change, told.reshape(n, 6, n, 6)))


def to_the_middle(covariance: Array, prior: Array, span: Array, carried: Sequence[Carried]) -> Array:
    """How far from the likeliest parameters (p,) those lie with which the body is likeliest: -P slope.

    Args:
        covariance: P (p, p), the gain normalised and row by row first.
        prior: (6n,) variances of the gain beforehand.
        span: (6,) range of the wrench, which normalises the gain.
        carried: payloads that moved; each tells the share W_p W^-1 of the gain, W the sum of w w^T.
    """
    gains, out = prior.size, np.zeros(len(covariance))
    tied = [c for c in carried if covariance[:gains, c.places].any()]
    at = np.unique([k for c in tied for k in c.places])
    if not at.size:
        return out
    told = np.eye(gains) - conditional(covariance, gains, at) / prior[:, None]
    whole = np.linalg.pinv(sum(c.felt for c in carried) / np.outer(span, span), rcond=_FLAT, hermitian=True)
    for c in tied:
        std = float(np.sqrt(np.mean(np.diag(covariance)[c.places[4:7]])))
        L = changes(c.mass, c.center_of_mass, c.inertia, std) / span[:, None] * span
        out -= covariance[:, c.places] @ volume_slope(L @ (c.felt / np.outer(span, span) @ whole), told)
    return out


def conditional(covariance: Array, gains: int, at: Iterable[int]) -> Array:
    """Covariance of the first parameters once others are known: P_gg - P_gv P_vv^-1 P_vg."""
    inner, cross = _scaled(covariance, gains, at)
    return np.asarray(covariance[:gains, :gains] - cross @ _solve(inner, cross.T))


def explained(covariance: Array, gains: int, at: Iterable[int]) -> Array:
    """What of the variance of the first parameters others account for: the diagonal of P_gv P_vv^-1 P_vg.

    Args:
        covariance: of all.
        gains: how many the first are.
        at: places of the others; those that are exact explain nothing.
    """
    inner, cross = _scaled(covariance, gains, at)
    return np.asarray(np.einsum("ij,ji->i", cross, _solve(inner, cross.T)))


def _scaled(covariance: Array, gains: int, at: Iterable[int]) -> tuple[Array, Array]:
    known = [k for k in sorted(at) if covariance[k, k] > _NOTHING]
    scale = np.sqrt(np.diag(covariance)[known])
    return covariance[np.ix_(known, known)] / scale / scale[:, None], covariance[:gains, known] / scale


def _solve(inner: Array, right: Array) -> Array:
    return np.asarray(np.linalg.lstsq(inner, right, rcond=1e-12)[0]) if len(inner) else np.zeros_like(right)
