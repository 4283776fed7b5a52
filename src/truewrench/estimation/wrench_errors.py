"""How large the errors of known wrenches are, and how long they last (METHOD 10.5).

Where the reference moves, the errors of a channel are white and Ornstein-Uhlenbeck; where it stands still on
most rows, each plateau is one mean with an effect of its own, which may last beyond it. Sizes and times are
found channel by channel: one of each for a group of channels is too sure of itself where they differ
(docs/results.md). Where the stated white noise explains the rows as well, it stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from truewrench.estimation.lasting_errors import ErrorSize, Spread, find_sizes
from truewrench.estimation.wrench_regression import Part, Problem, Solution, solve
from truewrench.estimation.wrench_rows import Rows, consistent
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.calibration_parts import Assumed

MOST_OUTLIERS = 0.1  # share of the rows that may be left out as outliers; of more, none is
_FOUND = 0.01  # about the probability that the stated white noise, where it is true, is taken for another
_NOTED = 0.5, 2.0  # sigma of the white errors over the stated one that is worth no word (METHOD 10.2)
_ROUNDS = 20  # of leaving out rows and estimating again; tolerance


@dataclass(frozen=True, slots=True, eq=False)
class FoundErrors:
    """Errors of all logs of one kind."""

    stepped: bool  # whether their reference stands still on most rows
    logs: tuple[int, ...]  # which logs
    sizes: tuple[ErrorSize, ...]  # per channel, over the stated variance of a row (sensor and reference)
    fall: Array  # (n,) of -2 log restricted likelihood, because something lasts
    found: bool  # whether the sizes are other than stated
    last: bool  # whether errors last


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What rows of given errors say, and which rows these are."""

    errors: tuple[FoundErrors, ...]
    used: Mask
    contradicting: int
    solution: Solution


def as_stated(rows: Rows, n: int) -> FoundErrors:
    """White noise of the stated size."""
    return FoundErrors(rows.stepped, rows.logs, (ErrorSize(),) * n, np.zeros(n), False, False)


def grouped_by(kinds: Sequence[Rows], errors: Sequence[FoundErrors]) -> list[Rows]:
    """Rows of white noise as stated stand by themselves."""
    return [
        rows.together() if found.found else rows.by_row() for rows, found in zip(kinds, errors, strict=True)
    ]


def parts_of(
    problem: Problem, kinds: Sequence[Rows], errors: Sequence[FoundErrors], used: Mask
) -> list[Part]:
    """One per kind of log, of the used rows."""
    return [
        rows.part(problem, used[rows.index], found.sizes) for rows, found in zip(kinds, errors, strict=True)
    ]


def fit_with(problem: Problem, kinds: Sequence[Rows], errors: tuple[FoundErrors, ...], used: Mask) -> Fit:
    """Estimate, leaving out rows that contradict the others, unless they are many."""
    grouped, sizes = grouped_by(kinds, errors), [found.sizes for found in errors]
    solution = solve(problem, parts_of(problem, grouped, errors, used))
    contradicting, seen = 0, [used]
    for _ in range(_ROUNDS):
        kept = consistent(problem, grouped, sizes, solution, used)
        count = int(np.count_nonzero(~kept))
        if count > max(1, int(MOST_OUTLIERS * kept.size)):
            contradicting, used = count, np.ones(kept.size, dtype=bool)
            solution = solve(problem, parts_of(problem, grouped, errors, used))
            break
        if np.array_equal(kept, used):
            break
        alternate = any(np.array_equal(kept, one) for one in seen)
        used = kept & used if alternate else kept  # out is what is out in either
        solution = solve(problem, parts_of(problem, grouped, errors, used))
        if alternate:
            break
        seen.append(used)
    return Fit(errors, used, contradicting, solution)


def fit_with_found(problem: Problem, kinds: Sequence[Rows], fit: Fit) -> Fit:
    """The same with sizes of the errors by restricted likelihood, where these are others than stated.

    Sizes are found without rows that are far outside, which come back where the errors found explain them.
    """
    grouped, sizes = grouped_by(kinds, fit.errors), [found.sizes for found in fit.errors]
    every = np.ones(fit.used.size, dtype=bool)
    used = consistent(problem, grouped, sizes, fit.solution, fit.used, robust=True)
    if np.count_nonzero(~used) > max(1, int(MOST_OUTLIERS * used.size)):
        used = every
    again = fit
    for _ in range(_ROUNDS):
        errors = _errors(problem, kinds, again.errors, used)
        if fit.contradicting and not any(found.last for found in errors):
            # gross errors of many rows, which no size of what lasts explains: none is left out
            errors = _errors(problem, kinds, fit.errors, every)
            if not any(found.last for found in errors):
                solution = solve(problem, parts_of(problem, grouped_by(kinds, errors), errors, every))
                return Fit(errors, every, fit.contradicting, solution)
        if not any(found.found for found in errors):
            return fit
        again = fit_with(problem, kinds, errors, used)
        if np.array_equal(again.used, used):
            break
        used = again.used
    return again


def _errors(
    problem: Problem, kinds: Sequence[Rows], errors: Sequence[FoundErrors], used: Mask
) -> tuple[FoundErrors, ...]:
    """Sizes of the errors of all kinds of log, by the residuals of an estimate with those known so far."""
    kinds = [rows.together() for rows in kinds]
    solution = solve(problem, parts_of(problem, kinds, errors, used))
    return tuple(
        _sizes(problem, rows, design, residual, solution, used)
        for rows, design, residual in zip(kinds, solution.designs, solution.residuals, strict=True)
    )


def _sizes(
    problem: Problem, rows: Rows, design: Array, residual: Array, solution: Solution, used: Mask
) -> FoundErrors:
    """Sizes of the errors of one kind of log, given the regressors and residuals of its places."""
    sigma = np.sqrt(np.diag(solution.noise))
    mask, n = used[rows.index], sigma.size
    within = np.sum((rows.apart(residual_of(problem, rows, solution), mask) / sigma) ** 2, axis=0)
    sizes, fall, lasting = find_sizes(rows.chain(mask), design, residual / sigma, within)
    # -2 log L falls by chance about like a chi-square of 2 degrees of freedom a channel, of which 1 is that
    # something lasts: false alarms in 0 to 3% of the records (docs/results.md)
    found = float(fall.sum()) > float(chdtri(2 * n, _FOUND))
    last = found and float(lasting.sum()) > float(chdtri(n, _FOUND))
    if not found:
        return as_stated(rows, n)
    return FoundErrors(rows.stepped, rows.logs, tuple(sizes), lasting, found, last)


def residual_of(problem: Problem, rows: Rows, solution: Solution) -> Array:
    """(K, n) v of the rows."""
    every = np.hstack([problem.reference[rows.index], problem.columns[rows.index]])
    return np.asarray(problem.raw[rows.index] - every @ solution.parameters.T)


def findings_of(
    channels: Sequence[str],
    noise: Array,
    errors: Sequence[FoundErrors],
    spreads: Sequence[Sequence[Spread]],
    outliers: Sequence[Integers],
) -> tuple[Assumed, ...]:
    """What was found of the errors per kind of log, where it is not as stated, and the rows left out per log.

    The stated noise (n, n) is the normalised covariance of a row; `spreads`, per kind and channel, are empty
    where the noise is as stated.
    """
    said = []
    for found, of_kind in zip(errors, spreads, strict=True):
        logs = "" if len(errors) == 1 else f", log {', '.join(str(k + 1) for k in found.logs)}"
        stated = np.sqrt(np.diag(noise)).tolist()
        for name, sigma, s, spread, fall in zip(
            channels, stated, found.sizes, of_kind, found.fall, strict=bool(of_kind)
        ):
            where, ratio = f"channel {name}{logs}", float(np.sqrt(s.white))
            if not _NOTED[0] <= ratio <= _NOTED[1]:
                what = "noise: white errors of sensor and reference, over the stated"
                said.append(Assumed(what, where, ratio, spread.white, "residuals from row to row"))
            if found.last and fall > chdtri(2, _FOUND):
                kind = "a plateau, and beyond it" if found.stepped else "about"
                why = f"they last for {kind} {s.time:.2g} s; -2 log likelihood falls by {fall:.3g}"
                what = "drift, hysteresis or cable: errors that last, fraction of range"
                size, wide = sigma * float(np.sqrt(s.lasting)), sigma * spread.lasting
                said.append(Assumed(what, where, size, wide, why))
    what, why = "outliers: rows left out", "they contradict all other rows"
    said += [
        Assumed(what, f"log {k + 1}", float(rows.size), None, why)
        for k, rows in enumerate(outliers)
        if rows.size
    ]
    return tuple(said)
