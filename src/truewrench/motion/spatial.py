"""Cross products and brackets of twists as matrices, for whole records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["cross_matrix", "twist_adjoint"]

Array = NDArray[np.float64]


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
