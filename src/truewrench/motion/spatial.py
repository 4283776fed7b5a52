"""Cross products, brackets of twists as matrices and products of rotations, for whole records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = ["cross", "cross_matrix", "rotated", "twist_adjoint"]

Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    """Of vectors (..., 3), of few of them in a tenth of the time of np.cross."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def cross_matrix(x: Array) -> Array:
    """Of vectors (N, 3): [x] (N, 3, 3) with [x] y = x cross y."""
    out = np.zeros((len(x), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, k, j], out[:, j, k] = x[:, i], -x[:, i]
    return out


def twist_adjoint(nu: Array) -> Array:
    """Of twists (N, 6): ad(nu) (N, 6, 6); a body displaced by p moves with nu + ad(nu) p + dp/dt."""
    out = np.zeros((len(nu), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = cross_matrix(nu[:, 3:])
    out[:, :3, 3:] = cross_matrix(nu[:, :3])
    return out


def rotated(steps: Array) -> Array:
    """Attitudes (N + 1, 3, 3) after rotations (N, 3) in body axes: R_0 = 1, R_k+1 = R_k exp [step_k]."""
    count = len(steps)
    length = int(
        np.ceil(np.sqrt(count + 1))
    )  # rows of so many steps: products along all at once, then of rows
    padded = np.zeros((length * length, 3))
    padded[1 : count + 1] = steps
    by_piece = Rotation.from_rotvec(padded).as_matrix().reshape(length, length, 3, 3)
    for k in range(1, length):
        by_piece[:, k] = by_piece[:, k - 1] @ by_piece[:, k]
    for k in range(1, length):
        by_piece[k] = by_piece[k - 1, -1] @ by_piece[k]
    return np.asarray(by_piece.reshape(-1, 3, 3)[: count + 1])
