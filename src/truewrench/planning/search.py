"""From random motions within the limits to the best of several optima that keep to them at all times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench.planning.limits import Limits, Usage
from truewrench.planning.optimise import Problem, Solution
from truewrench.planning.series import FourierMotion, SeriesBasis

__all__ = ["Found", "Progress", "search"]

Array = NDArray[np.float64]
Progress = Callable[[str, float | None], None]

_CANDIDATES = 200  # random motions that are looked at
_STARTS = 3  # of them that are optimised
_ROUNDS = 6  # of tightening
_FIRST = 150  # iterations from a random motion
_AGAIN = 60  # iterations from an optimum, with limits a little tighter


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What was found.

    Attributes:
        motion: the best.
        usage: of the limits, at 1 kHz.
        values: criterion that every start reached.
        random: criterion of the random motions, sorted.
        iterations: of IPOPT, all together.
    """

    motion: FourierMotion
    usage: list[Usage]
    values: tuple[float, ...]
    random: tuple[float, ...]
    iterations: int

    def facts(self) -> dict[str, Any]:
        """How it was found, as PLAN.plan.yaml holds it."""
        return {
            "harmonics": self.motion.basis.harmonics,
            "optima": np.exp(self.values).tolist(),
            "random_median": float(np.exp(np.median(self.random))) if self.random else None,
            "random_best": float(np.exp(self.random[0])) if self.random else None,
            "iterations": self.iterations,
        }


def search(
    problem: Problem,
    basis: SeriesBasis,
    limits: Limits,
    duration: float,
    check: Callable[[FourierMotion], list[Usage]],
    seed: int,
    progress: Progress,
    starts: int = _STARTS,
) -> Found:
    """The best motion found.

    Args:
        problem: what is minimised.
        basis: functions of the series.
        limits: what is kept to.
        duration: of the motion, a whole number of periods [s].
        check: use of the limits by a motion at 1 kHz.
        seed: of the random motions.
        progress: is told what is being done, and the share of it that is done.
        starts: how many of the random motions are optimised.
    """
    progress("random motions", None)
    candidates = sorted(problem.candidates(limits, seed, _CANDIDATES), key=lambda c: c.value)
    optima: list[Solution] = []
    for k, candidate in enumerate(candidates[:starts]):
        progress(f"optimum {k + 1} of {starts}", k / starts)
        optima.append(
            problem.solve(candidate.start, candidate.coefficients, limits, iterations=_FIRST, rounds=2)
        )
    iterations = sum(optimum.iterations for optimum in optima)
    best = min(optima, key=lambda optimum: optimum.value)

    progress("all limits", None)
    best = problem.solve(best.start, best.coefficients, limits, iterations=_FIRST, warm=True)
    iterations += best.iterations
    tight = limits
    for k in range(_ROUNDS):
        progress("limits between the nodes", k / _ROUNDS)
        motion = FourierMotion(basis, best.start, best.coefficients, duration)
        usage = check(motion)
        if all(use.share <= 1.0 for use in usage):
            break
        tight = tight.tightened(usage)
        best = problem.solve(best.start, best.coefficients, tight, iterations=_AGAIN, warm=True)
        iterations += best.iterations
    values = tuple(optimum.value for optimum in optima)
    return Found(motion, usage, values, tuple(c.value for c in candidates), iterations)
