"""Where a reference stands still (METHOD 10.5): weights that hang for a while, poses that are held."""

import numpy as np

from truewrench.model.arrays import Array, Integers

HELD = 0.5  # [s] METHOD 10.5
STILL = 1.0  # sigma by which halves of a window, or windows of a plateau, may differ beside chance; tolerance
CHANCE = 3.0  # sigma of a mean that is still chance: 0.3% of the windows, which others overlap; tolerance
SCATTER = 2.0  # RMS within a window over the stated sigma, which may be misstated; tolerance


def is_stepped(plateau: Integers) -> bool:
    """Whether the reference stands still on most rows."""
    return bool(np.count_nonzero(plateau >= 0) > 0.5 * plateau.size)


def plateaus(time: Array, reference: Array, noise: Array) -> Integers:
    """Numbers of the plateaus that rows at times (N,) [s] belong to, -1 where the reference (N, 6) moves.

    A window of half a second stands still where no axis scatters more, and neither half nor first or last
    row differs more from the others, than noise (6,), 1 sigma, explains: of many rows one beyond a step, or
    a pause, moves neither half nor scatter. Rows that windows link are one plateau, as long as its
    windows do not drift apart: a slow motion stands still in each window, and is no plateau.
    """
    size = len(time)
    found = np.full(size, -1, dtype=np.int64)
    last = np.searchsorted(time, time + HELD * (1.0 - 1e-9))  # the window of row k is k ... last
    first = np.flatnonzero(last < size)
    if first.size == 0:
        return found
    last = last[first]
    x = (reference - reference.mean(axis=0)) / noise
    sums, squares = (np.vstack([np.zeros(6), np.cumsum(x**power, axis=0)]) for power in (1, 2))
    count = last + 1 - first
    half = first + count // 2
    mean = (sums[last + 1] - sums[first]) / count[:, None]
    scatter = (squares[last + 1] - squares[first]) / count[:, None] - mean**2
    earlier, later = (half - first)[:, None], (last + 1 - half)[:, None]
    moved = (sums[last + 1] - sums[half]) / later - (sums[half] - sums[first]) / earlier
    still = np.all(np.abs(moved) <= STILL + CHANCE * np.sqrt(1.0 / earlier + 1.0 / later), axis=1)
    still &= np.all(scatter <= SCATTER**2, axis=1)
    others = np.maximum(count - 1, 1)[:, None]
    for edge in (first, last):
        alone = np.abs(x[edge] - mean) * count[:, None] / others
        still &= np.all(alone <= STILL + CHANCE * np.sqrt(1.0 + 1.0 / others), axis=1)
    if not still.any():
        return found

    begin, end, mean, count = first[still], last[still], mean[still], count[still]
    change = np.bincount(begin, minlength=size + 1) - np.bincount(end, minlength=size + 1)
    linked = np.cumsum(change)[: size - 1] > 0  # rows k and k + 1, by some window
    number = np.append(0, np.cumsum(~linked))
    held = np.zeros(size, dtype=bool)
    held[:-1] |= linked
    held[1:] |= linked
    # windows of one plateau, which are neighbours in `begin`
    edges = np.flatnonzero(np.diff(number[begin], prepend=-1))
    apart = np.maximum.reduceat(mean, edges) - np.minimum.reduceat(mean, edges)
    allowed = STILL + 2.0 * CHANCE / np.sqrt(np.minimum.reduceat(count, edges))
    drifting = number[begin[edges]][np.any(apart > allowed[:, None], axis=1)]
    held &= ~np.isin(number, drifting)
    found[held] = np.unique(number[held], return_inverse=True)[1]
    return found
