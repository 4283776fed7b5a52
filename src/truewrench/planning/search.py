"""From random motions within the limits to the best of several optima that keep to them at all times."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench.planning.limits import Limits, Usage
from truewrench.planning.optimise import Problem
from truewrench.planning.series import FourierMotion
from truewrench.planning.solve import Solution, candidates, solve

__all__ = ["Effort", "Found", "Progress", "search"]

Array = NDArray[np.float64]
Progress = Callable[[str, float | None], None]

_ROUNDS = 6  # of tightening
_SPARE = 1e-7  # of a limit
_TRIES = 20
_HOPELESS = 1.2  # use of a limit that a smaller motion is not tried for
_LIVE = 0.7  # use of a limit by the best random motions from which on it is kept to from the start
_LOOKED_AT = 5  # of these motions


@dataclass(frozen=True, slots=True)
class Effort:
    """What a search may take.

    Attributes:
        random: motions that are drawn.
        starts: of them that are optimised.
        iterations: of IPOPT from each of them,
        again: and from an optimum, in every round of one with limits a little tighter.
        rounds: in each, with the constraints that the one before came near.
        excess: of a limit at which the motion is simply made smaller, which costs as much accuracy.
    """

    random: int = 200
    starts: int = 3
    iterations: int = 150
    again: int = 60
    rounds: int = 2
    excess: float = 0.003


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What was found.

    Attributes:
        motion: the best.
        values: criterion that every start reached.
        random: criterion of the random motions, sorted.
        iterations: of IPOPT, all together.
    """

    motion: FourierMotion
    values: tuple[float, ...]
    random: tuple[float, ...]
    iterations: int

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
) -> Found:
    """The best motion found.

    Args:
        problem_of: what is minimised, keeping to some kinds of limits besides those of series and wrench.
        limits: what is kept to.
        duration: of the motion, a whole number of periods [s].
        check: use of all limits by a motion at 1 kHz.
        seed: of the random motions.
        progress: is told what is being done, and the share of it that is done.
        effort: what it may take.
        near: (n,) a start to look at.
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
    for k, candidate in enumerate(drawn[: effort.starts]):
        progress(f"optimum {k + 1} of {effort.starts}", k / effort.starts)
        optima.append(solve(problem, candidate, limits, iterations=effort.iterations, rounds=effort.rounds))
    best, tight = min(optima, key=lambda optimum: optimum.value), limits
    iterations = sum(optimum.iterations for optimum in optima) - best.iterations
    for k in range(_ROUNDS):
        usage = check(motion_of(best))
        if max(use.share for use in usage) <= 1.0 + effort.excess:
            break
        progress("limits between the nodes", k / _ROUNDS)
        exceeded = {use.limit for use in usage if use.share > 1.0} & set(_KINDS)
        if not exceeded <= live:
            live |= exceeded
            problem, tight = problem_of(live), limits
        elif best.worst <= 1.0 + effort.excess:  # what the nodes keep to is exceeded between them
            tight = tight.tightened(usage)
        best = solve(problem, best, tight, iterations=effort.again, warm=True, rounds=effort.rounds)
    best = _shrunk(best, lambda solution: check(motion_of(solution)))
    return Found(
        motion_of(best),
        tuple(optimum.value for optimum in optima),
        tuple(candidate.value for candidate in drawn),
        iterations + best.iterations,
    )


def _shrunk(solution: Solution, check: Callable[[Solution], list[Usage]]) -> Solution:
    """The motion, a little smaller about its start, where it exceeds a limit by a little."""
    for _ in range(_TRIES):
        worst = max(use.share for use in check(solution))
        if worst <= 1.0 or worst > _HOPELESS:
            break
        smaller = solution.coefficients * (1.0 - _SPARE) / worst
        solution = replace(solution, coefficients=smaller)
    return solution


_KINDS = ("workspace", "torque", "clearance")
