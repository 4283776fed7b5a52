"""What is left in poses that a fit did not see, interleaved and last in time, beside the usual recipe."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.tool.model_rows import Problem
from truewrench.tool.parts import HeldOut
from truewrench.tool.recipe import recipe
from truewrench.tool.solve import Solution, solve

FEWEST = 8  # poses: fewer leave too few to fit
FOLDS = 5
LAST = 0.25  # of the poses


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """Residuals in held-out poses."""

    figures: HeldOut  # of the interleaved ones
    by_kind: Mapping[str, HeldOut]  # `interleaved` and `last`: RMS figures
    ratio: Mapping[str, float]  # of the squared errors to what was predicted of them, by kind
    details: Mapping[str, Any]  # residuals (T, 6) by kind and method, NaN where not held out [N, N m]


def held_out(problem: Problem, solution: Solution) -> Left:
    """Hold poses out, fit the others with the sizes that were found, and predict them, walk included."""
    T = len(problem.poses)
    if T < FEWEST:
        return Left(HeldOut(), {}, {}, {})
    rows = np.arange(T)
    order = np.argsort(problem.poses.time_ns, kind="stable")
    last = np.zeros(T, dtype=bool)
    last[order[round(T * (1.0 - LAST)) :]] = True
    kinds = {"interleaved": [rows % FOLDS == k for k in range(FOLDS)], "last": [last]}
    by_kind, ratio, details = {}, {}, {}
    for kind, folds in kinds.items():
        ours, theirs = np.full((T, 6), np.nan), np.full((T, 6), np.nan)
        squares, count = 0.0, 0
        for out in folds:
            error, scaled = _predicted(problem, solution, out)
            ours[out], squares, count = error, squares + float((scaled**2).sum()), count + scaled.size
            theirs[out] = recipe(problem.rig, problem.poses, np.flatnonzero(~out)).residual[out]
        by_kind[kind] = HeldOut(*_norms(ours), *_norms(theirs))
        ratio[kind] = squares / count
        details[kind] = {"ours": ours, "recipe": theirs}
    return Left(by_kind["interleaved"], by_kind, ratio, details)


def _norms(residual: Array) -> tuple[float, float]:
    known = residual[np.isfinite(residual[:, 0])]
    force, moment = (
        float(np.sqrt(np.mean(np.sum(known[:, at] ** 2, axis=1)))) for at in (slice(3), slice(3, 6))
    )
    return force, moment


def _predicted(problem: Problem, solution: Solution, out: Mask) -> tuple[Array, Array]:
    """Errors (K, 6) [N, N m] of the predicted readings, and (K, n) in units of their sigma."""
    kept = ~out
    part = replace(problem, poses=problem.poses.of(kept))
    sizes = np.log([solution.rate, solution.repeatability])
    found = solve(part, solution.x, sizes)
    y, J = problem.of_poses(found.x)
    K = problem.walked()
    residual = problem.poses.raw - y
    error, scaled = np.empty((int(out.sum()), y.shape[1])), np.empty((int(out.sum()), y.shape[1]))
    for i, root in enumerate(problem.roots(solution.rate, solution.repeatability, K)):
        V = root @ root.T
        link = np.linalg.solve(V[np.ix_(kept, kept)], V[np.ix_(kept, out)])
        error[:, i] = residual[out, i] - link.T @ residual[kept, i]
        own = np.diag(V[np.ix_(out, out)]) - np.einsum("kt,kt->t", V[np.ix_(kept, out)], link)
        slope = J[i][out] - link.T @ J[i][kept]
        scaled[:, i] = error[:, i] / np.sqrt(own + np.einsum("tp,pq,tq->t", slope, found.covariance, slope))
    place = problem.vector.layout.gain
    back = np.linalg.pinv(found.x[place].reshape(-1, 6))
    return error @ back.T, scaled
