"""The 46,080 signed permutations of the wrench axes: which fit a matrix best, how likely, and in words."""

from __future__ import annotations

import math
from functools import cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from truewrench.calibration import AXES

__all__ = ["SIGNS", "in_words", "log_prior", "shortlist"]

Array = NDArray[np.float64]


def shortlist(T: Array, variance: Array, spread: Array, factor: Array, count: int) -> list[Array]:
    """`SIGNS` and the signed permutation matrices that are most likely, without the identity.

    Row i of `T` is compared with sign * factor_ij e_j, of variance factor_ij^2 spread + variance_i.
    """
    total = factor[:, :, None] ** 2 * spread + variance[:, None, :]  # (i, j, k)
    meant = np.array([1.0, -1.0])[:, None, None, None] * factor[:, :, None] * np.eye(6)  # (sign, i, j, k)
    score = -0.5 * np.sum((T[:, None, :] - meant) ** 2 / total + np.log(total), axis=-1)  # (sign, i, j)
    orders = _permutations()
    rows = np.arange(6)
    best = orders[np.argsort(-score.max(axis=0)[rows, orders].sum(axis=1))[:count]]
    scores = score[_SIGNS[None, :, :], rows, best[:, None, :]].sum(axis=-1)  # (orders, signs)
    trace = np.sum((1 - 2 * _SIGNS)[None] * (best == rows)[:, None, :], axis=-1)
    scores += np.array([_log_prior_of_trace(t) for t in range(-6, 7)])[trace + 6]
    found = list(SIGNS)
    for where in np.argsort(-scores, axis=None)[: count + 1]:
        order, sign = np.unravel_index(where, scores.shape)
        signed = np.zeros((6, 6))
        signed[rows, best[order]] = 1.0 - 2.0 * _SIGNS[sign]
        if not any(np.array_equal(signed, known) for known in (np.eye(6), *SIGNS)):
            found.append(signed)
    return found


SIGNS = tuple(np.diag(np.repeat(signs, 3)) for signs in ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0)))
"""The most frequent of all: the sign of the whole wrench, of forces, of moments."""

_SIGNS = np.array(list(product((0, 1), repeat=6)))  # (64, 6), 1 for minus


@cache
def _permutations() -> NDArray[np.int64]:
    return np.array(list(permutations(range(6))))


@cache
def _same_trace() -> dict[int, int]:
    """How many of the 46,080 signed permutations have a trace, by the trace."""
    fixed = (_permutations() == np.arange(6)).sum(axis=1)
    count: dict[int, int] = {}
    for f, orders in zip(*np.unique(fixed, return_counts=True), strict=True):
        for minus in range(f + 1):
            trace = int(f) - 2 * minus
            ways = int(orders) * 2 ** (6 - int(f)) * math.comb(int(f), minus)
            count[trace] = count.get(trace, 0) + ways
    return count


def log_prior(signed: Array) -> float:
    """Half for the three of `SIGNS`; of the rest, every step away from the identity is half as likely.

    The squared distance from the identity is 12 - 2 trace. It starts at 4, for two axes swapped or one sign.
    """
    if any(np.array_equal(signed, known) for known in SIGNS):
        return math.log(0.5 / len(SIGNS))
    return _log_prior_of_trace(int(np.trace(signed)))


def _log_prior_of_trace(trace: int) -> float:
    return math.log(0.5 ** (6 - min(trace, 4)) / _same_trace().get(trace, 1))


def in_words(signed: Array) -> str:
    """What output i reads, for a matrix with one sign per row."""
    order, sign = np.abs(signed).argmax(axis=1), signed.sum(axis=1)
    if np.array_equal(order, np.arange(6)):
        flipped = [axis for axis, s in zip(AXES, sign, strict=True) if s < 0]
        if len(flipped) == 6:
            return "wrong sign of the whole wrench (`feels`)"
        for axes, group in ((AXES[:3], "all forces"), (AXES[3:], "all moments")):
            if tuple(flipped) == axes:
                return f"wrong sign of {group}"
        return f"wrong sign of {' and '.join(flipped)}"
    reads = [
        f"{AXES[i]} holds {'-' if sign[i] < 0 else ''}{AXES[order[i]]}"
        for i in range(6)
        if order[i] != i or sign[i] < 0
    ]
    listed = ", ".join(reads)
    moved = np.flatnonzero(order != np.arange(6))
    if len(moved) == 2 and len(reads) == 2 and np.all(sign > 0):
        return f"{AXES[moved[0]]} and {AXES[moved[1]]} swapped"
    force = signed[slice(0, 3), slice(0, 3)]
    if np.array_equal(force, signed[slice(3, 6), slice(3, 6)]) and abs(round(np.linalg.det(force))) == 1:
        turned = "turned" if np.linalg.det(force) > 0 else "mirrored"
        return f"axes {turned} ({listed})"
    return f"axes mixed up ({listed})"
