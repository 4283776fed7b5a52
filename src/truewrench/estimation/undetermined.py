"""Directions of the gain that the data leave as uncertain as they were: words, no verdict (METHOD 6)."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from truewrench import _core
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration_parts import Undetermined

TIED = 0.15  # share of an axis, in units of range, that another one has to make up to be named with it: words
STRONG = 0.3  # of a direction, from which on a channel is named: words

_WRENCH = tuple(f"{kind} {axis}" for kind in ("force along", "moment about") for axis in "xyz")


def undetermined_directions(
    covariance: Array, prior: Array, channels: Sequence[str]
) -> tuple[Undetermined, ...]:
    """Directions of the normalised gain that are still less certain than half their prior.

    The covariance (6n, 6n) is that before (10.10), row by row; an element of prior (6n,), 1 sigma, 0 is
    known.

    Returns:
        An orthonormal basis, as near to single gains as it can be. Where a direction of the wrench was not
        excited, no channel's gain to it is known: its n directions are named together. Such a direction is
        an axis, or an axis tied to others: its component was the same combination of theirs in all data.
    """
    n = len(channels)
    values, vectors = np.linalg.eigh(_relative(covariance, prior))
    basis = vectors[:, values > _core.UNDETERMINED**2]  # (6n, k)
    found: list[Undetermined] = []
    if basis.shape[1] >= n:
        # How much of u, in every channel, lies in the undetermined space.
        share = np.einsum("iak,ibk->ab", basis.reshape(n, 6, -1), basis.reshape(n, 6, -1)) / n
        weights, axes = np.linalg.eigh(share)
        unseen, pivots = _near_axes(axes[:, weights > 0.95])
        tied = unseen @ np.linalg.inv(unseen[pivots])  # each pivot as a combination of the other axes
        for u, relation, pivot in zip(unseen.T, tied.T, pivots, strict=True):
            words = f"{_wrench_words(relation, pivot)}: gains of all channels"
            whole = [np.kron(e, u) for e in np.eye(n)]
            found += [Undetermined(direction, words) for direction in whole]
            basis = basis - np.column_stack(whole) @ (np.column_stack(whole).T @ basis)
    left, sizes, _ = np.linalg.svd(basis, full_matrices=False)
    for direction in _near_axes(left[:, sizes > 0.5])[0].T:
        found.append(Undetermined(direction, _direction_words(direction.reshape(n, 6), channels)))
    return tuple(found)


def _relative(covariance: Array, prior: Array) -> Array:
    """Covariance in units of the prior; what is not a number has taught nothing."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        relative = covariance / prior[:, None] / prior
    relative = 0.5 * (relative + relative.T)
    exact = ~(prior > 0.0)
    relative[exact], relative[:, exact] = 0.0, 0.0
    unknown = ~np.isfinite(np.diag(relative))
    relative[unknown], relative[:, unknown] = 0.0, 0.0
    relative[unknown, unknown] = 1.0
    return np.asarray(np.where(np.isfinite(relative), relative, 0.0))


def _near_axes(basis: Array) -> tuple[Array, Integers]:
    """An orthonormal basis (m, k) of the same space, turned towards coordinate axes, and these axes (k,)."""
    k = basis.shape[1]
    pivots = np.sort(qr(basis.T, mode="r", pivoting=True)[1][:k]).astype(np.int64)
    u, _, vt = np.linalg.svd(basis[pivots])
    return basis @ (u @ vt).T, pivots


def _wrench_words(u: Array, pivot: int) -> str:
    """A direction of the wrench by its axis, and those that it is tied to: u @ w is always 0."""
    others = [k for k in range(6) if k != pivot and abs(u[k]) > TIED * abs(u[pivot])]
    if not others:
        return str(_WRENCH[pivot])
    kinds = [("force along", [k for k in others if k < 3]), ("moment about", [k for k in others if k >= 3])]
    listed = [f"{kind} {' and '.join('xyz'[k % 3] for k in axes)}" for kind, axes in kinds if axes]
    return f"{_WRENCH[pivot]}, always tied to {' and '.join(listed)}"


def _direction_words(direction: Array, channels: Sequence[str]) -> str:
    """One direction (n, 6): the wrench it belongs to and the channels that feel it, when it separates so."""
    rows, sizes, columns = np.linalg.svd(direction)
    if sizes[0] < 0.9:
        strongest = np.argsort(-np.abs(direction).ravel())[:3]
        pairs = ", ".join(f"{channels[k // 6]} to {_WRENCH[k % 6]}" for k in strongest)
        return f"a combination of gains, most of all {pairs}"
    strong = [channels[i] for i in np.argsort(-np.abs(rows[:, 0])) if abs(rows[i, 0]) > STRONG]
    u = columns[0]
    return f"{_wrench_words(u, int(np.argmax(np.abs(u))))}: gain of {' and '.join(strong)}"
