"""From random motions within the limits to the best of several optima that keep to them at all times."""

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truewrench.planning.limits import Limits, Usage
from truewrench.planning.optimise import Problem
from truewrench.planning.series import FourierMotion
from truewrench.planning.solve import Solution, candidates, solve

Progress = Callable[[str, float | None], None]

_ROUNDS = 6  # of tightening
_SPARE = 1e-7  # of a limit
_TRIES = 10
_HALVINGS = 6  # of the step that led within the limits
_SMALLEST = 0.8  # of the size found: smaller motions are not tried
_LAST = 0.05  # unless nothing else is within the limits
_DRAWS = 4  # of random motions, until an optimum keeps to the limits: tolerance
_LIVE = 0.7  # use of a limit by the best random motions from which on it is kept to from the start
_LOOKED_AT = 5  # of these motions


@dataclass(frozen=True, slots=True)
class Effort:
    """What a search may take."""

    random: int = 200  # motions that are drawn
    starts: int = 6  # of them that are optimised
    first: int = 30  # iterations of IPOPT from each of them,
    finalists: int = 2  # how many of them are optimised further,
    iterations: int = 60  # by so many,
    again: int = 30  # and iterations from the best, in every round of one with limits a little tighter
    rounds: int = 1  # of each optimisation, with the constraints that the one before came near
    excess: float = 0.003  # of its size that a motion may lose to limits that it exceeds; sigma grows as much


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What was found."""

    motion: FourierMotion  # the best
    values: tuple[float, ...]  # criterion that every start reached
    random: tuple[float, ...]  # criterion of the random motions, sorted
    iterations: int  # of IPOPT, all together
    kept: bool  # whether an optimum, hardly made smaller, keeps to the limits

    def facts(self) -> dict[str, Any]:
        """How it was found, as PLAN.plan.yaml holds it."""
        return {
            "harmonics": self.motion.basis.harmonics,
            "optima": np.exp(self.values).tolist(),
            "random_median": float(np.exp(np.median(self.random))),
            "random_best": float(np.exp(self.random[0])),
            "iterations": self.iterations,
        }


def search(
    problem_of: Callable[[Set[str]], Problem],
    limits: Limits,
    duration: float,
    check: Callable[[FourierMotion], list[Usage]],
    seed: int,
    progress: Progress,
    *,
    effort: Effort = Effort(),
    near: Sequence[float] | None = None,
    draws: int = _DRAWS,
) -> Found:
    """The best motion found, of a duration that is a whole number of periods [s].

    `problem_of` keeps to some kinds of limits besides those of series and wrench; `check` gives the use of
    all limits by a motion at 1 kHz; `near` (n,) is a start to look at. Where no optimum of a draw keeps to
    the limits, as in a narrow workspace, another one is made, of so many at most.
    """
    progress("random motions", None)
    problem = problem_of(frozenset(_KINDS))
    drawn = candidates(problem, limits, seed, effort.random, near)

    def motion_of(solution: Solution) -> FourierMotion:
        return FourierMotion(problem.basis, solution.start, solution.coefficients, duration)

    looked_at = [use for solution in drawn[:_LOOKED_AT] for use in check(motion_of(solution))]
    live = {use.limit for use in looked_at if use.limit in _KINDS and use.share > _LIVE}
    problem = problem_of(live)
    optima: list[Solution] = []
    steps = effort.starts + effort.finalists
    for k, candidate in enumerate(drawn[: effort.starts]):
        progress(f"optimum {k + 1} of {effort.starts}", k / steps)
        optima.append(solve(problem, candidate, limits, iterations=effort.first, rounds=effort.rounds))
    for k in range(min(effort.finalists, len(optima))):
        progress(f"further from the best, {k + 1} of {effort.finalists}", (effort.starts + k) / steps)
        optima.sort(key=lambda optimum: optimum.merit)
        optima[k] = solve(
            problem, optima[k], limits, iterations=effort.iterations, warm=True, rounds=effort.rounds
        )
    best, tight = min(optima, key=lambda optimum: optimum.merit), limits
    iterations = sum(optimum.iterations for optimum in optima) - best.iterations

    def looked(solution: Solution) -> list[Usage]:
        return check(motion_of(solution))

    seen: list[tuple[float, Solution]] = []
    for k in range(_ROUNDS + 1):
        usage = looked(best)
        size = _size_within(usage, looked(_scaled(best, 0.0)))
        within = _shrunk(best, looked) if size >= 1.0 - effort.excess else None
        # sigma grows as the motion is made smaller until it keeps to the limits
        seen.append((best.value - float(np.log(max(size, 1e-3))), within or best))
        if within is not None or k == _ROUNDS:
            break
        progress("limits between the nodes", k / _ROUNDS)
        exceeded = {use.limit for use in usage if use.share > 1.0} & set(_KINDS)
        if not exceeded <= live:
            live |= exceeded
            problem, tight = problem_of(live), limits
        elif best.worst <= 1.0 + effort.excess:  # what the nodes keep to is exceeded between them
            tight = tight.tightened(usage)
        best = solve(problem, best, tight, iterations=effort.again, warm=True, rounds=effort.rounds + 2)
    iterations += best.iterations
    # a round may end further from the limits than it began
    likely = [solution for _, solution in sorted(seen, key=lambda found: found[0])]
    good = next(filter(None, (_shrunk(one, looked) for one in likely)), None)
    best = good or likely[0]
    if good is None:  # none of them is near the limits: a random motion within these, or a small one
        random = drawn[:_LOOKED_AT]
        tries = [(one, _SMALLEST) for one in random] + [(one, _LAST) for one in (*likely, *random)]
        best = next(filter(None, (_shrunk(one, looked, least) for one, least in tries)), best)
    found = Found(
        motion_of(best),
        tuple(optimum.criterion for optimum in optima),
        tuple(sorted(candidate.criterion for candidate in drawn)),
        iterations,
        good is not None,
    )
    if found.kept or draws == 1:
        return found
    again = search(
        problem_of, limits, duration, check, seed + 1, progress, effort=effort, near=near, draws=draws - 1
    )
    return again if again.kept else found


def _shrunk(
    solution: Solution, check: Callable[[Solution], list[Usage]], least: float = _SMALLEST
) -> Solution | None:
    """The motion, smaller about its start where it exceeds a limit, as little as keeps to all of them.

    None where it would have to be smaller than `least` of it, or does not come nearer: a body that turns far
    may turn faster about an axis of its own.
    """
    rest = check(_scaled(solution, 0.0))

    def room(size: float) -> float:
        """How much smaller still, as if use grew linearly; 0 where all limits hold."""
        return 1.0 - _size_within(check(_scaled(solution, size)), rest)

    low, high, more = 1.0, 1.0, room(1.0)
    if more == 0.0:
        return solution
    for k in range(_TRIES):  # where use falls more slowly than linearly, equal steps would never arrive
        low *= (1.0 - min(2.0**k * more, 1.0)) * (1.0 - _SPARE)
        if low < least:
            return None
        more = room(low)
        if more == 0.0:
            break
        high = low
    else:
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if room(middle) == 0.0 else (low, middle)
    return _scaled(solution, low)


def _scaled(solution: Solution, size: float) -> Solution:
    return replace(solution, coefficients=size * solution.coefficients)


def _size_within(usage: Sequence[Usage], rest: Sequence[Usage]) -> float:
    """Size of a motion, 1 is as it is, at which all limits hold if use grows linearly from that at rest."""
    still = {(use.limit, use.axis): use.share for use in rest}
    sizes = [1.0]
    for use in usage:
        if use.share > 1.0:
            room = 1.0 - still[use.limit, use.axis]
            sizes.append(max(room, 0.0) / (use.share - 1.0 + max(room, 0.0)))
    return min(sizes)


_KINDS = ("workspace", "torque", "clearance")
