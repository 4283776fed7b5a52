"""Rows of known wrenches: which of them belong together, and which contradict all others (METHOD 10.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from truewrench.estimation.lasting_errors import Chain, ErrorSize, predicted
from truewrench.estimation.plateaus import is_stepped, plateaus
from truewrench.estimation.wrench_regression import Part, Problem, Solution
from truewrench.model.arrays import Array, Integers, Mask

_OUTLIER = 1e-3  # probability that any row of a record without outliers is taken for one
_MOST_PLACES = 20_000  # rows of logs whose errors last; of more, neighbours are averaged; tolerance
_BRIEF = 0.5, 0.15  # shortest time that errors last over the spacing of rows, of plateaus; tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """All usable rows of logs of one kind, K of the problem's."""

    stepped: bool  # whether the reference stands still on most rows of these logs
    logs: tuple[int, ...]  # which logs
    index: Integers  # (K,) which rows of the problem
    place: Integers  # (K,) the place of each, from 0: a row, a plateau, or what lies between two
    time: Array  # (K,) since the log's first row [s]
    log: Integers  # (K,) whose row it is
    still: Mask  # (K,) whether the reference stands still there

    def mean(self, x: Array, used: Mask) -> Array:
        """(M, k) mean of x (K, k) over the used rows of each place; 0 of none."""
        sums = np.add.reduceat(x * used[:, None], self._begins, axis=0)
        return np.asarray(sums / np.maximum(self.count(used), 1.0)[:, None])

    def count(self, used: Mask) -> Array:
        """(M,) used rows of each place."""
        return np.add.reduceat(used.astype(np.float64), self._begins)

    @property
    def _begins(self) -> Integers:
        return np.flatnonzero(np.diff(self.place, prepend=-1))

    def chain(self, used: Mask, everywhere: bool = False) -> Chain:
        """Of the places with a used row; or of all, at the mean time of all rows."""
        count, at = self.count(used), used | everywhere
        kept = np.ones(len(count), dtype=bool) if everywhere else count > 0.0
        time = self.mean(self.time[:, None], at)[kept, 0]
        log = self.log[self._begins][kept]
        step = np.append(np.inf, np.where(log[1:] == log[:-1], np.diff(time), np.inf))[: time.size]
        finite = step[np.isfinite(step)]
        usual = float(np.median(finite)) if finite.size else 1.0
        shortest = _BRIEF[self.stepped] * usual
        longest = max([2.0 * np.ptp(time[log == k]) for k in self.logs if (log == k).any()], default=0.0)
        return Chain(step, np.maximum(count[kept], 1.0), shortest, max(longest, 2.0 * shortest))

    def part(self, problem: Problem, used: Mask, sizes: tuple[ErrorSize, ...]) -> Part:
        """Means over the used rows of each place."""
        kept = self.count(used) > 0.0
        raw, reference, columns = (
            self.mean(x[self.index], used)[kept] for x in (problem.raw, problem.reference, problem.columns)
        )
        return Part(raw, reference, columns, self.chain(used), sizes)

    def apart(self, x: Array, used: Mask) -> Array:
        """(K, k) rows of x about the mean of their place; 0 of rows that are not used."""
        return np.asarray((x - self.mean(x, used)[self.place]) * used[:, None])

    def by_row(self) -> Rows:
        """The same, each row by itself."""
        return replace(self, place=np.arange(len(self.index)))

    def together(self) -> Rows:
        """Those that are estimated from where errors last: between plateaus, it is unknown what they do."""
        if not self.stepped:
            return self
        kept, place = self.still, np.unique(self.place[self.still], return_inverse=True)[1]
        at = self.index[kept], place, self.time[kept], self.log[kept], self.still[kept]
        return Rows(self.stepped, self.logs, *at)


def rows_by_kind(
    time: Sequence[Array], reference: Sequence[Array], complete: Sequence[Integers], noise: Array
) -> list[Rows]:
    """Rows of the logs whose reference moves, and of those where it stands still on most rows.

    Per log: times (N,) [s], reference (N, 6), NaN where there is none, and which rows are complete; the noise
    (6,) is 1 sigma of the reference.
    """
    ends = np.cumsum([rows.size for rows in complete])
    found: dict[bool, list[tuple[int, Integers, Integers, Array, Mask]]] = {False: [], True: []}
    for k, (at, w, rows) in enumerate(zip(time, reference, complete, strict=True)):
        told = np.flatnonzero(np.isfinite(w).all(axis=1))
        plateau = plateaus(at[told], w[told], noise)
        place = np.empty(len(at), dtype=np.int64)
        place[told] = np.cumsum(np.diff(plateau, prepend=-2) != 0)  # what lies between two is one place
        still = np.zeros(len(at), dtype=bool)
        still[told] = plateau >= 0
        index = np.arange(ends[k] - rows.size, ends[k])
        found[is_stepped(plateau)].append((k, index, place[rows], at[rows], still[rows]))
    kinds = []
    for stepped, logs in found.items():
        if not logs:
            continue
        size = sum(index.size for _, index, *_ in logs)
        together = -(-size // _MOST_PLACES)
        places, first = [], 0
        for _, index, place, *_ in logs:
            own = place if stepped else np.arange(index.size) // together
            own = np.unique(own, return_inverse=True)[1] + first
            places.append(own)
            first = int(own[-1]) + 1
        kinds.append(
            Rows(
                stepped,
                tuple(k for k, *_ in logs),
                np.concatenate([index for _, index, *_ in logs]),
                np.concatenate(places),
                np.concatenate([at for _, _, _, at, _ in logs]),
                np.concatenate([np.full(index.size, k) for k, index, *_ in logs]),
                np.concatenate([still for *_, still in logs]),
            )
        )
    return kinds


def consistent(
    problem: Problem,
    kinds: Sequence[Rows],
    sizes: Sequence[tuple[ErrorSize, ...]],
    solution: Solution,
    used: Mask,
    robust: bool = False,
) -> Mask:
    """Which rows (N,) have a residual within its noise, what lasts known from the other rows.

    As long as some is far outside, only the worst are not: one gross error bends the fit so that good rows
    lie outside, too, which are taken back once it is gone. A plateau outside as a whole goes with its rows.
    Each row belongs to one kind; the sizes of errors are per kind and channel, the solution that of the used
    rows. `robust` takes noise as stated for as large as the median of the residuals says.
    """
    every = np.hstack([problem.reference, problem.columns])
    v = problem.raw - every @ solution.parameters.T
    leverage = np.einsum("ka,ab,kb->k", every, solution.followed, every)
    stated = np.diag(solution.noise)
    kept = np.ones(len(used), dtype=bool)
    for rows, size in zip(kinds, sizes, strict=True):
        mask, own = used[rows.index], v[rows.index]
        count, mean = rows.count(mask), rows.mean(own, mask)
        if all(s == ErrorSize() for s in size):
            squared = np.sum(own * np.linalg.solve(solution.noise, own.T).T, axis=1)
            limit = float(chdtri(stated.size, _OUTLIER / len(used)))
            if robust:
                squared /= max(1.0, float(np.median(squared) / chdtri(stated.size, 0.5)))
            kept[rows.index] = _within(squared, leverage[rows.index], mask, limit)
            continue
        white = np.array([s.white for s in size])
        chain = rows.chain(mask, everywhere=True)
        told = [predicted(chain, s, x, count > 0.0) for s, x in zip(size, mean.T, strict=True)]
        lasting, variance = (np.column_stack(x) for x in zip(*told, strict=True))  # (M, n) from other places
        # a row from the others of its place, and these from the other places
        others = (count[rows.place] - mask)[:, None]
        beside = (mean * count[:, None])[rows.place] - own * mask[:, None]
        share = variance[rows.place] * others / (variance[rows.place] * others + white)
        center = lasting[rows.place] * (1.0 - share) + share * beside / np.maximum(others, 1.0)
        left = white + variance[rows.place] * (1.0 - share)
        # how channels go together is not known of what was found: the worst of them counts
        squared = np.max((own - center) ** 2 / (left * stated), axis=1)
        limit = float(chdtri(1, _OUTLIER / (len(used) * stated.size)))
        # what lasts takes up most of what parameters leave: on average they follow that share of a place
        followed = np.full(len(count), min(0.5, every.shape[1] / len(count)))
        ok = _within(squared, followed[rows.place] / np.maximum(count[rows.place], 1.0), mask, limit)
        if rows.stepped:
            any_of = mask | (count == 0.0)[rows.place]
            left = white / rows.count(any_of)[:, None] + variance
            squared = np.max((rows.mean(own, any_of) - lasting) ** 2 / (left * stated), axis=1)
            limit = float(chdtri(1, _OUTLIER / (len(count) * stated.size)))
            ok &= _within(squared, followed, count > 0.0, limit)[rows.place]
        kept[rows.index] = ok
    return kept


def _within(squared: Array, followed: Array, used: Mask, limit: float) -> Mask:
    """Which squares chance explains; the fit follows what was used, and predicts what was not."""
    statistic = squared / np.where(used, np.maximum(1.0 - followed, 0.01), 1.0 + followed)
    return np.asarray(statistic <= max(limit, 0.25 * float(statistic[used].max(initial=0.0))))
