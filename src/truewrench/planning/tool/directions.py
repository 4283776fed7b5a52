"""Directions of gravity that determine a tool: evenly spread on the rim of what is reached.

Their order is one in which a drifting offset cancels.
"""

import numpy as np

from truewrench.model.arrays import Array, Integers
from truewrench.model.motion.spatial import cross

_ROUNDS = 400  # of repulsion
_FIRST_STEP = 0.2  # [rad]


def axes_of(direction: Array) -> Array:
    """R (3, 3), right-handed, whose last column is a unit vector (3,)."""
    x = cross(np.eye(3)[int(np.argmin(np.abs(direction)))], direction)
    x /= np.linalg.norm(x)
    return np.column_stack([x, cross(direction, x), direction])


def spread(count: int, axis: Array, half_angle: float) -> Array:
    """Unit vectors (count, 3) evenly spread: on the rim of a cone, or over what is more than half a sphere.

    The axis (3,) is the middle of the cone; a half angle of pi [rad] is all directions.
    """
    if half_angle <= 0.5 * np.pi:
        return rim(axis, half_angle, count)
    points = _opposite_pairs(count)
    tilt = np.arccos(np.clip(points[:, 2], -1.0, 1.0))
    for k in np.flatnonzero(tilt > half_angle):  # out of reach: the nearest on the rim
        side = points[k, :2] / np.linalg.norm(points[k, :2])
        points[k] = [*(np.sin(half_angle) * side), np.cos(half_angle)]
    return np.asarray(points @ axes_of(axis).T)


def rim(axis: Array, half_angle: float, count: int) -> Array:
    """Unit vectors (count, 3) evenly spread on the rim of a cone about an axis (3,)."""
    turn = 2.0 * np.pi * np.arange(count) / count
    side = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(count)])
    return np.asarray((np.sin(half_angle) * side + [0.0, 0.0, np.cos(half_angle)]) @ axes_of(axis).T)


def _opposite_pairs(count: int) -> Array:
    """Unit vectors (count, 3), each with its opposite (but for the last of an odd number), that repel."""
    half = (count + 1) // 2
    k = np.arange(half) + 0.5
    polar, turn = np.arccos(1.0 - k / half), np.pi * (1.0 + 5.0**0.5) * k
    x = np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    for step in _FIRST_STEP * (1.0 - np.arange(_ROUNDS) / _ROUNDS):
        every = np.concatenate([x, -x])
        away = x[:, None] - every
        distance = np.linalg.norm(away, axis=2)
        distance[distance < 1e-9] = np.inf
        push = (away / distance[..., None] ** 3).sum(axis=1)
        push -= (push * x).sum(axis=1, keepdims=True) * x
        x = x + step * push / max(1.0, float(np.linalg.norm(push, axis=1).max()))
        x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.asarray(np.stack([x, -x], axis=1).reshape(-1, 3)[:count])


def spread_among(candidates: Array, count: int) -> Integers:
    """Which of unit vectors (M, 3) to take, `count` at most: one by one the farthest from all before.

    For what can be reached and is no cone. The first two are the farthest apart of all.
    """
    cosine = candidates @ candidates.T
    chosen = [int(k) for k in np.unravel_index(int(np.argmin(cosine)), cosine.shape)]
    nearest = cosine[:, chosen].max(axis=1)
    while len(chosen) < min(count, len(candidates)):
        chosen.append(int(np.argmin(nearest)))
        nearest = np.maximum(nearest, cosine[:, chosen[-1]])
    return np.array(chosen[:count], dtype=np.int64)


def abba(directions: Array) -> Integers:
    """The order (N,) in which to visit unit vectors: A, its opposite B, a neighbour of B, its opposite, ...

    An offset that drifts adds the same to the two poses of each half of such a block and to neither direction
    of the tool's weight.
    """
    left, cosine = list(range(len(directions))), directions @ directions.T
    order: list[int] = []
    while left:
        # the next pair is a neighbour of the last, and begins where that has ended
        first = left[0] if not order else max(left, key=lambda k: cosine[order[-1], k])
        left.remove(first)
        order.append(first)
        if left:
            second = min(left, key=lambda k: cosine[first, k])
            left.remove(second)
            order.append(second)
    return np.array(order, dtype=np.int64)
