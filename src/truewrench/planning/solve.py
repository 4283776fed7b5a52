"""Optima of a problem: random motions to begin with, and IPOPT on the constraints that matter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.planning.ipopt import minimise
from truewrench.planning.limits import Limits
from truewrench.planning.optimise import FINE, Problem, Rows

_SIZES = 0.5 ** np.arange(0.0, 6.0, 0.5)  # of a random motion: of the largest that its series may be,
_TYPICAL = 4.0  # or of typical velocities, where that is less
_FREE = 1e3  # [rad, m] stands for no limit
_NEAR = 0.3  # [rad, m] 1 sigma of random starts about a given one
_FEASIBLE = 1e-6  # of a limit
_LARGE = 0.3  # use of a limit by a random motion from which on an optimum may reach it
_CLOSE = 0.85  # use of a limit from which on a constraint is looked at


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A motion."""

    start: Array  # (n,)
    coefficients: Array  # (m, n)
    value: float  # of what is minimised
    criterion: float  # of it, without the price of few frequencies
    worst: float  # largest use of a limit at the nodes; above 1 it is violated
    iterations: int = 0  # that it took

    @property
    def merit(self) -> float:
        """What its value would be, made smaller until it keeps to the limits, about."""
        return self.value + float(np.log(max(self.worst, 1.0)))


def candidates(
    problem: Problem, limits: Limits, seed: int, count: int, near: Sequence[float] | None = None
) -> list[Solution]:
    """Random motions as large as the limits allow at the nodes, the best first.

    Of the `count` drawn, starts that violate a limit are left out; where no motion keeps to the limits, those
    that violate least come back. Every second one starts near `near` (n,).
    """
    bounds = problem.space.bounds(limits)
    lower, upper = problem.limits(bounds)
    every = problem.rows(np.ones(problem.count, dtype=bool))
    L, n, free = len(problem.linear), problem.space.n, problem.space.free_start
    of = np.array([j for _, j in problem.linear_of], dtype=np.int64)
    rng = np.random.default_rng([seed, 11])
    room = 0.9 * np.minimum(bounds.upper - bounds.lower, 2.0 * np.pi)
    middle = 0.5 * (np.maximum(bounds.lower, -_FREE) + np.minimum(bounds.upper, _FREE))
    found: list[Solution] = []
    for k in range(count):
        start, departure = middle + room * rng.uniform(-0.5, 0.5, n), _NEAR * rng.standard_normal(n)
        drawn = rng.standard_normal((problem.basis.size, n)) * problem.space.scale
        if not free:
            start = np.zeros(n)
        elif near is not None and k % 2:
            start = np.clip(near + (k > 1) * departure, bounds.lower, bounds.upper)
        if found and _worst(problem, problem.pack(start, 0.0 * drawn), every, lower, upper) > 1.0 + _FEASIBLE:
            continue  # not even rest
        still, moving = (
            problem.linear @ problem.pack(*at) for at in ((start, 0.0 * drawn), (0.0 * start, drawn))
        )
        room_there = np.where(moving > 0.0, upper[:L] - still, still - lower[:L])
        largest = np.full(n, _TYPICAL)  # of each coordinate
        np.minimum.at(largest, of, room_there / np.maximum(np.abs(moving), 1e-12))
        for size in _SIZES:
            coefficients = size * largest * drawn
            x = problem.pack(start, coefficients)
            worst = _worst(problem, x, every, lower, upper)
            if worst <= 1.0 + _FEASIBLE:
                break
        found.append(Solution(start, coefficients, problem.value(x), problem.criterion(x), worst))
    feasible = [motion for motion in found if motion.worst <= 1.0 + _FEASIBLE]
    if feasible:
        return sorted(feasible, key=lambda motion: motion.value)
    return sorted(found, key=lambda motion: motion.worst)


def solve(
    problem: Problem,
    motion: Solution,
    limits: Limits,
    *,
    iterations: int,
    warm: bool = False,
    rounds: int = 5,
) -> Solution:
    """A local optimum within limits, from a motion, which if `warm` is nearly optimal already.

    The limits are no wider than those that the problem was made with. In each of some rounds, of so many
    iterations at most, the constraints count that the one before came near.
    """
    lower, upper = problem.limits(problem.space.bounds(limits))
    every = problem.rows(np.ones(problem.count, dtype=bool))
    x, count = problem.pack(motion.start, motion.coefficients), 0
    share = use(problem.constraints(x, every), lower, upper)
    kept = _first_rows(problem, share)
    for _ in range(rounds):
        rows = problem.rows(kept | (share > _CLOSE))
        kept = rows.kept
        x, used = minimise(problem, rows, x, lower[kept], upper[kept], iterations=iterations, warm=warm)
        count, warm = count + used, True
        share = use(problem.constraints(x, every), lower, upper)
        if share.max() <= 1.0 + _FEASIBLE:
            break
    start, coefficients = problem.unpack(x)
    worst, value = float(share.max()), problem.value(x)
    return Solution(start, coefficients, value, problem.criterion(x), worst, motion.iterations + count)


def _worst(problem: Problem, x: Array, rows: Rows, lower: Array, upper: Array) -> float:
    """Largest use of what is not equal anyway."""
    return float(use(problem.constraints(x, rows), lower, upper)[lower < upper].max())


def use(g: Array, lower: Array, upper: Array) -> Array:
    """How much of its interval each constraint uses; above 1 it is violated."""
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    equal = half == 0.0
    used = np.abs(g - middle) / np.where(equal, 1.0, half)
    return np.where(equal, used * (used > _FEASIBLE), used)


def _first_rows(problem: Problem, share: Array) -> Mask:
    """Constraints to begin with; the others are looked at where a solution comes near them."""
    L, nodal = len(problem.linear), problem.nodes * (6 + problem.bounded)
    even = np.arange(problem.nodes) % 2 == 0
    # velocities and accelerations always; the rest where a random motion already uses some of it
    by_kind = share[:L].reshape(-1, FINE * problem.nodes)
    always = np.array([kind in (1, 2) for kind, _ in problem.linear_of[:: FINE * problem.nodes]], dtype=bool)
    wanted = always | (by_kind.max(axis=1, initial=0.0) > _LARGE)
    coarse = np.arange(FINE * problem.nodes) % FINE == 0
    large = share[L : L + nodal].reshape(problem.nodes, -1).max(axis=0) > _LARGE
    kept = np.ones(share.size, dtype=bool)
    kept[:L] = (wanted[:, None] & coarse).ravel()
    kept[L : L + nodal] = (even[:, None] & large).ravel()
    last = share.size - problem.nodes * problem.summed.size
    kept[last:] = even.repeat(problem.summed.size)
    return kept
