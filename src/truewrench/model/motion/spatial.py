"""Cross products, brackets of twists as matrices and products of rotations, for whole records."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array


def cross(a: Array, b: Array) -> Array:
    """Of vectors (..., 3), of few of them in a tenth of the time of np.cross."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def at_point(six: Array, lever: Array) -> Array:
    """Twists (..., 6), or their derivatives, of the point at `lever` (..., 3): v + Omega x lever."""
    return np.concatenate([six[..., :3] + cross(six[..., 3:], lever), six[..., 3:]], axis=-1)


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


def turns_between(omega: Callable[[Array], Array], nodes: Array) -> Array:
    """Rotations (N - 1, 3) in body axes from each of times (N,) [s] to the next, of Omega (M, 3) at any (M,).

    By Magnus' expansion to the sixth order (Blanes, Casas and Ros 2000) of d/dt R^T = -[Omega] R^T.
    """
    h, middle = np.diff(nodes)[:, None], 0.5 * (nodes[1:] + nodes[:-1])
    first, second, third = (omega(middle + side * np.sqrt(0.15) * h[:, 0]) for side in (-1.0, 0.0, 1.0))
    a1 = -h * second
    a2, a3 = -np.sqrt(15.0) / 3.0 * h * (third - first), -10.0 / 3.0 * h * (third - 2.0 * second + first)
    c1 = cross(a1, a2)
    c2 = -cross(a1, 2.0 * a3 + c1) / 60.0
    return -(a1 + a3 / 12.0 + cross(-20.0 * a1 - a3 + c1, a2 + c2) / 240.0)
