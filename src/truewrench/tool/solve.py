"""theta by damped Gauss-Newton, the sizes of the offset's walk and of a pose's repeatability beside it.

    y = C R w(body, g) + b + walk(t) + e,  walk ~ rate^2 min(t_end - t, t_end - t'),   e: a pose's own

Rate and repeatability, one each for all channels as fractions of their range, maximise the marginal
likelihood with theta integrated out at the linearisation; how well they are known is part of sigma:
estimates and covariances are mixed over a grid of both. Body and gain bend within what is left of either:
the body is the one that is likeliest with the gain C integrated out,

    p(b) ~ exp(-Q(b) / 2) |H_CC(b)|^(-1/2),  1/2 d log |H_CC| / db = tr[(1 x dw/db w^-1) H P]
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import minimize

from truewrench.estimation.static_poses import REPEATABILITY, SIZE_SPREAD, WALK
from truewrench.model.arrays import Array
from truewrench.tool.model_rows import Problem, whitened

MOST_REPEATABILITY = 10.0  # times the prior: a pose that scatters more is no pose of this model
MOST_WALK = 500.0
_STEPS, _HALVINGS = 20, 8
_MIDDLE = 4  # steps at most, to 0.01 sigma: tolerance
_GRID = np.linspace(-2.5, 2.5, 6)  # sigma of the logarithms


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What was found."""

    problem: Problem  # that was solved
    x: Array  # (p,) estimate
    covariance: Array  # (p, p), the sizes' own uncertainty within
    prior_mean: Array  # (p,)
    prior_covariance: Array  # (p, p)
    rate: float  # of the walk, fraction of range per sqrt(s)
    repeatability: float  # fraction of range
    residual: Array  # (T, n) readings less what x predicts, the walk not subtracted [raw units]
    walk: Array  # (T, n) the walk's conditional mean [raw units]
    chi_square: float  # of the poses, whitened, over their number of readings less what theta took
    freedom: int  # that number
    steps: int  # of Gauss and Newton
    by_gain_of_poses: Array  # (p, 6n) by how much a gain that stands in the poses alone moves the estimate
    pose_chi_square: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The problem about x: residuals, derivatives and prior in units of the prior's sigma."""

    r: Array  # (T + L, n) of poses, and of the links between offsets of one session
    J: Array  # (n, T + L, p)
    before: Array  # information of what is normal in gain, or product, and body
    information: Array  # of that, motion and known figures
    pull: Array  # their gradient at x
    constant: float
    K: Array


def _linearise(problem: Problem, x: Array, mean: Array, inverse: Array, scale: Array, K: Array) -> _Linear:
    y, J = problem.of_poses(x)
    away = (mean - x) / scale
    before, information, pull = inverse, inverse.copy(), inverse @ away
    constant = float(away @ inverse @ away)
    if problem.motion is not None:
        m = problem.motion
        z, D = problem.of_motion(x)
        D = D * scale
        gap = m.at - z
        information += D.T @ m.information @ D
        if problem.normal_in_product:
            before = information.copy()
        pull += D.T @ (m.information @ gap + m.gradient)
        constant += float(gap @ m.information @ gap + 2.0 * m.gradient @ gap)
    if problem.prior.known:
        r, D = problem.of_known(x)
        D = D * scale
        information += D.T @ D
        pull += D.T @ r
        constant += float(r @ r)
    gap, D = problem.of_links(x)
    r, J = np.vstack([problem.poses.raw - y, gap]), np.concatenate([J, D], axis=1)
    return _Linear(r, J * scale, before, information, pull, constant, K)


def _sums(problem: Problem, at: _Linear, sizes: Array) -> tuple[Array, Array, float, float]:
    """Information, gradient, sum of squares at x, log determinant of the readings' covariance."""
    A, g, squares, logdet = at.information.copy(), at.pull.copy(), at.constant, 0.0
    if len(at.r):
        roots = problem.roots(float(np.exp(sizes[0])), float(np.exp(sizes[1])), at.K)
        both = whitened(roots, np.concatenate([at.J, at.r.T[:, :, None]], axis=2)).reshape(-1, len(g) + 1)
        Jw, rw = both[:, :-1], both[:, -1]
        A += Jw.T @ Jw
        g += Jw.T @ rw
        squares += float(rw @ rw)
        logdet = 2.0 * float(np.log(np.diagonal(roots, axis1=1, axis2=2)).sum())
    return A, g, squares, logdet


def told(parts: Sequence[tuple[Problem, Array]]) -> Iterator[tuple[float, list[tuple[Array, Array]]]]:
    """Information and gradient of parts of a problem, each about an x, in units of the prior's sigma.

    For one rate and repeatability after the other, which the poses of all parts have in common, as far as
    they are likely where each part has a theta of its own; with its weight among them. A slope with the
    temperature, the last of x, is not within where a part has none.
    """
    linear = []
    for part, x in parts:
        mean, P = part.prior_of_all()
        scale = np.sqrt(np.diag(P))
        linear.append(_linearise(part, x[: mean.size], mean, _inverse(P, scale), scale, part.walked(True)))
    posed = [k for k, (part, _) in enumerate(parts) if len(part.poses)]

    def evidence(s: Array) -> float:
        return sum(_evidence(parts[k][0], linear[k], s) - _unlikely(s) for k in posed) + _unlikely(s)

    top = _least(evidence, _START) if posed else _START
    best = evidence(top)
    for s in _likely(evidence, top) if posed else [top]:
        sums = [_sums(part, at, s) for (part, _), at in zip(parts, linear, strict=True)]
        worse = sum(_deviance(*sums[k]) for k in posed) + _unlikely(s) - best
        yield float(np.exp(-0.5 * worse)), [(A, g) for A, g, *_ in sums]


def _inverse(P: Array, scale: Array) -> Array:
    """Of the prior's covariance, in units of its sigma."""
    return np.asarray(np.linalg.inv(P / np.outer(scale, scale) + 1e-12 * np.eye(len(P))))


_START = np.log([WALK, REPEATABILITY])


def _evidence(problem: Problem, at: _Linear, sizes: Array) -> float:
    """-2 log of the marginal likelihood of the sizes, and of their own broad prior."""
    return _deviance(*_sums(problem, at, sizes)) + _unlikely(sizes)


def _deviance(A: Array, g: Array, squares: float, logdet: float) -> float:
    """-2 log of that likelihood, from the sums."""
    return squares - float(g @ np.linalg.solve(A, g)) + logdet + float(np.linalg.slogdet(A)[1])


def _unlikely(sizes: Array) -> float:
    """-2 log of that prior."""
    return float((((sizes - _START) / SIZE_SPREAD) ** 2).sum())


def _bounded(sizes: Array) -> Array:
    upper = _START + np.log([MOST_WALK, MOST_REPEATABILITY])
    return np.clip(sizes, _START - np.log(1e3), upper)


def solve(problem: Problem, start: Array | None = None, sizes: Array | None = None) -> Solution:
    """Estimate and covariance, from (p,) x to begin at, by default the usual linear recipe.

    The sizes, logarithms of rate and repeatability, are found unless held.
    """
    mean, P = problem.prior_of_all()
    scale = np.sqrt(np.diag(P))
    inverse = _inverse(P, scale)
    K = problem.walked(linked=True)
    x = mean.copy() if start is None else start.copy()
    if start is None and len(problem.poses):
        _linear_start(problem, x)
    held = sizes is not None
    now = _START.copy() if sizes is None else np.array(sizes)
    steps = 0
    at = _linearise(problem, x, mean, inverse, scale, K)
    for steps in range(1, _STEPS + 1):
        if not held and len(problem.poses) and steps > 1:
            now = _sizes(problem, at, now)
        A, g, squares, _ = _sums(problem, at, now)
        step = np.linalg.solve(A, g)
        size = float(np.sqrt(np.mean((A @ step) * step)))
        step = _limited(problem, np.asarray(step), scale)
        for _ in range(_HALVINGS):  # where gain and body bend, a whole step goes too far
            at = _linearise(problem, x + scale * step, mean, inverse, scale, K)
            if _sums(problem, at, now)[2] <= squares:
                break
            step *= 0.5
        x = x + scale * step
        if size < 1e-3 and steps > 2:
            break
    for _ in range(_MIDDLE):
        A, g, *_ = _sums(problem, at, now)
        slope = _slope(problem, x, A, at, scale)
        step = _limited(problem, np.asarray(np.linalg.solve(A, g - slope)), scale)
        x = x + scale * step
        at = _linearise(problem, x, mean, inverse, scale, K)
        if np.sqrt(np.mean((A @ step) * step)) < 0.01:
            break
    x_mixed, covariance = _mixed(problem, at, now, x, slope, scale, held)
    A, *_ = _sums(problem, at, now)
    residual, T = at.r, len(problem.poses)
    walk, chi, per_pose, taken = np.zeros_like(residual), 0.0, np.zeros(len(residual)), 0.0
    if len(residual):
        rate = float(np.exp(now[0]))
        inner = np.linalg.inv(A)
        roots = problem.roots(rate, float(np.exp(now[1])), K)
        upper = np.linalg.inv(roots).transpose(0, 2, 1)  # V^-1 = L^-T L^-1
        for i, scale_i in enumerate(problem.rig.sensor.channel_scale):
            rw, Jw = upper[i].T @ residual[:, i], upper[i].T @ at.J[i]
            solved = upper[i] @ rw
            walk[:, i] = (rate * scale_i) ** 2 * K @ solved
            chi += float(rw @ rw)
            taken += float(np.einsum("tp,pq,tq->", Jw, inner, Jw))
            per_pose += solved**2 / (upper[i] ** 2).sum(axis=1)  # over the diagonal of V^-1
    freedom = max(1, round(residual.size - taken))
    gains = problem.vector.layout.gain
    moved = np.linalg.solve(A, (A - at.information)[:, gains]) * scale[:, None] / scale[gains]
    return Solution(
        problem,
        x_mixed,
        covariance,
        mean,
        P,
        float(np.exp(now[0])),
        float(np.exp(now[1])),
        residual[:T],
        walk[:T],
        chi / freedom,
        freedom,
        steps,
        moved,
        per_pose[:T],
    )


def _limited(problem: Problem, step: Array, scale: Array) -> Array:
    """The mass by a factor of two at most."""
    mass = problem.vector.layout.log_mass
    return np.asarray(step * min(1.0, 0.7 / max(abs(step[mass] * scale[mass]), 1e-12)), np.float64)


def _slope(problem: Problem, x: Array, A: Array, at: _Linear, scale: Array) -> Array:
    """1/2 d log |H_CC| by x, in units of the prior's sigma; H P: what data tell of a gain, the body known."""
    v = problem.vector
    linear = np.r_[v.layout.gain, v.layout.offset, v.carried.start : v.size]  # y is linear in these
    P = np.linalg.inv(A[np.ix_(linear, linear)])
    told = ((A - at.before)[np.ix_(linear, linear)] @ P)[: 6 * v.n, : 6 * v.n]
    gains = scale[v.layout.gain]
    told = (told / gains[:, None] * gains).reshape(v.n, 6, v.n, 6)
    # logs of other units than each other's leave A so ill-conditioned that rounding takes a variance below 0
    sigma = np.sqrt(np.maximum(np.diag(np.linalg.inv(A)), 0.0))
    change = problem.changes(x, sigma * scale)
    return np.asarray(np.einsum("pab,ibia->p", change, told) * scale, np.float64)


def _sizes(problem: Problem, at: _Linear, start: Array) -> Array:
    return _least(lambda sizes: _evidence(problem, at, sizes), start)


def _least(evidence: Callable[[Array], float], start: Array) -> Array:
    def bounded(sizes: Array) -> float:
        return evidence(_bounded(sizes))

    options: Any = {"xatol": 0.05, "fatol": 0.02, "maxiter": 60, "initial_simplex": start + _SIMPLEX}
    found = minimize(bounded, start, method="Nelder-Mead", options=options)
    return _bounded(np.asarray(found.x))


_SIMPLEX = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


def _mixed(
    problem: Problem, at: _Linear, sizes: Array, x: Array, slope: Array, scale: Array, held: bool
) -> tuple[Array, Array]:
    """Mean and covariance of x over what the sizes may be."""
    A, g, *_ = _sums(problem, at, sizes)
    own = np.linalg.inv(A)
    if held or not len(problem.poses):
        return x, own * np.outer(scale, scale)
    means, parts, weights = [], [], []
    for where in _likely(lambda s: _evidence(problem, at, s), sizes):
        A, g, squares, logdet = _sums(problem, at, where)
        g -= slope
        inverse = np.linalg.inv(A)
        step = inverse @ g
        weights.append(squares - g @ step + logdet + np.linalg.slogdet(A)[1] + _unlikely(where))
        means.append(step)
        parts.append(inverse)
    share = np.exp(-0.5 * (np.array(weights) - np.min(weights)))
    share /= share.sum()
    mean = np.einsum("k,kp->p", share, np.array(means))
    away = np.array(means) - mean
    P = np.einsum("k,kpq->pq", share, np.array(parts)) + np.einsum("k,kp,kq->pq", share, away, away)
    return x + scale * mean, P * np.outer(scale, scale)


def _likely(evidence: Callable[[Array], float], sizes: Array) -> list[Array]:
    """Sizes on a grid about the likeliest, as far as they may be."""
    width = np.array([_width(evidence, sizes, k) for k in range(2)])
    grid = [sizes + width * [a, b] for a in _GRID for b in _GRID]
    return [where for where in grid if (where <= _bounded(where) + 1e-9).all()]


def _width(evidence: Callable[[Array], float], sizes: Array, k: int) -> float:
    """1 sigma of the logarithm of a size, by the curvature of the evidence."""
    step = np.zeros(2)
    step[k] = 0.5
    lower, here, upper = (evidence(sizes + s * step) for s in (-1.0, 0.0, 1.0))
    curvature = 0.5 * (lower + upper - 2.0 * here) / 0.25
    return float(np.clip(1.0 / np.sqrt(max(curvature, 1e-9)), 0.1, SIZE_SPREAD))


def _linear_start(problem: Problem, x: Array) -> None:
    """Mass, centre of mass and offsets of the ten-parameter recipe, per log, into x."""
    from truewrench.tool.recipe import recipe

    found = recipe(problem.rig, problem.poses, np.arange(len(problem.poses)))
    v = problem.vector
    mass = found.mass
    if v.on:
        mass -= float(np.exp(x[v.before.start]))
    x[v.layout.log_mass] = np.log(np.clip(mass, 0.02, 1e4))
    if mass > 0.02:
        center = found.center_of_mass
        if v.on:
            first = float(np.exp(x[v.before.start]))
            center = (found.mass * center - first * x[v.before.start + 1 : v.before.start + 4]) / mass
        x[v.layout.center_of_mass] = np.clip(center, -1.0, 1.0)
