"""Errors that last beside white ones: their sizes by restricted likelihood (METHOD 10.5).

A chain is the rows of one log or several along time, or means of rows that belong together. In units of the
stated variance, the errors of one channel have over a chain the covariance

    T = white diag(1 / count) + lasting K,    K_kl = exp(-|t_k - t_l| / time)              Ornstein-Uhlenbeck

within a log, and 0 between logs. Such a process is Markov: with B the differences x_k - a_k x_(k-1),
a_k = exp(-step_k / time), B K B^T is diagonal and B T B^T tridiagonal. Its Cholesky factor L whitens,
E = L^-1 B x, in O(rows) for any stamps; these are the innovations of the Kalman filter of the same model.
A time of 0 makes an effect of each mean by itself: a random effect per plateau.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from scipy.linalg.lapack import dpttrf, dtbtrs
from scipy.optimize import minimize

from truewrench.model.arrays import Array, Mask

_RANK = 1e-9  # of the largest: a smaller combination of regressors is rounding; tolerance
_TIMES = 9  # correlation times where the search begins, from the shortest to the longest; tolerance
_RATES = -12.0, 8.0, 26  # logarithms of the growth of what lasts over what is white likewise; tolerance
_LOGIT = 16.0  # of a share: white errors of 1e-7 of what lasts are none; tolerance
_GRID = 7  # points along each axis of the sizes' posterior; tolerance
_REACH = 3.5  # of their sigma; tolerance
_WIDEST = 1.5  # sigma of a logit or log time that the curvature at the maximum is believed in; tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """M rows, or means of rows, along time."""

    step: Array  # (M,) time since the one before [s]; infinite where a log begins
    count: Array  # (M,) how many rows each is the mean of
    shortest: float  # correlation time below which what lasts does so within one place only [s]
    longest: float  # above which it is a constant [s]

    @property
    def spare(self) -> int:
        """Rows beyond the means."""
        return round(float(self.count.sum())) - self.count.size


@dataclass(frozen=True, slots=True)
class ErrorSize:
    """Errors of one channel: variances over the stated one, and how long they last."""

    white: float = 1.0  # variance of a row's own error
    lasting: float = 0.0  # variance of what lasts
    time: float = 0.0  # correlation time of that [s]; 0: from one mean to the next


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """What the uncertainty of one channel's sizes adds."""

    covariance: Array  # (p, p) of the parameters, to be added
    white: float  # 1 sigma of the white errors' standard deviation, over the stated one
    lasting: float  # the same of what lasts


def whitened(chain: Chain, size: ErrorSize, x: Array) -> tuple[Array, float]:
    """L^-1 B x, (M, k), of which T is the covariance of each column of x, and log |T|."""
    own = size.white / chain.count
    if size.lasting == 0.0:
        return x / np.sqrt(own)[:, None], float(np.log(own).sum())
    a, new = _memory(chain, size.time)
    diagonal = own + size.lasting * new
    diagonal[1:] += a[1:] ** 2 * own[:-1]
    pivot, lower, _ = dpttrf(diagonal, -a[1:] * own[:-1])
    differences = np.array(x, order="F")
    differences[1:] -= a[1:, None] * x[:-1]
    band = np.ones((2, len(a)), order="F")
    band[1, :-1] = lower
    E, _ = dtbtrs(band, differences, uplo="L", diag="U", overwrite_b=True)
    return E / np.sqrt(pivot)[:, None], float(np.log(pivot).sum())


def predicted(chain: Chain, size: ErrorSize, x: Array, known: Mask) -> tuple[Array, Array]:
    """What lasts of errors x (M,): mean (M,) and variance (M,) at each place, from all other known places."""
    if size.lasting == 0.0:
        return np.zeros_like(x), np.zeros_like(x)
    a, new = _memory(chain, size.time)
    inverse = 1.0 / (size.lasting * new)
    precision = np.where(known, chain.count / size.white, 0.0)
    diagonal = inverse + precision
    diagonal[:-1] += a[1:] ** 2 * inverse[1:]
    beside = -a[1:] * inverse[1:]
    pivot, lower, _ = dpttrf(diagonal, beside)
    back = dpttrf(diagonal[::-1].copy(), beside[::-1].copy())[0][::-1]
    band = np.ones((2, len(a)), order="F")
    band[1, :-1] = lower
    half, _ = dtbtrs(band, (precision * np.where(known, x, 0.0))[:, None], uplo="L", diag="U")
    mean = dtbtrs(band, half / pivot[:, None], uplo="L", trans="T", diag="U")[0][:, 0]
    others = np.maximum(pivot + back - diagonal - precision, 1e-12 * diagonal)  # 1 / variance from the others
    return (mean * (others + precision) - precision * np.where(known, x, 0.0)) / others, 1.0 / others


def _memory(chain: Chain, time: float) -> tuple[Array, Array]:
    """a_k of each place, and the variance that is new there, over that of what lasts."""
    if time == 0.0:
        return np.zeros_like(chain.step), np.ones_like(chain.step)
    return np.exp(-chain.step / time), -np.expm1(-2.0 * chain.step / time)


class _Likelihood:
    """-2 log restricted likelihood of (share of what lasts, time), the overall variance at its best.

    REML: the regressors' own directions are left out of the count, so that sizes are not too small by what
    the parameters follow.
    """

    def __init__(self, chain: Chain, design: Array, residual: Array, within: Array) -> None:
        self.chain, self.x, self.within = chain, np.column_stack([design, residual]), within
        self.p = design.shape[1]
        values, vectors = np.linalg.eigh(design.T @ (chain.count[:, None] * design))
        kept = values > _RANK * values[-1]
        self.basis = vectors[:, kept] / np.sqrt(values[kept])  # (p, r)
        self.freedom = len(chain.step) - int(kept.sum()) + chain.spare

    def gram(self, share: float, time: float) -> tuple[Array, float]:
        E, log_det = whitened(self.chain, ErrorSize(1.0 - share, share, time), self.x)
        return E.T @ E, log_det

    def squares(self, gram: Array, log_det: float, share: float) -> tuple[Array, float]:
        """(n,) whitened squares that no parameter follows, and the determinants' part."""
        p, W = self.p, self.basis
        information, pull = W.T @ gram[:p, :p] @ W, W.T @ gram[:p, p:]
        left = np.diag(gram[p:, p:]) - np.sum(pull * np.linalg.solve(information, pull), axis=0)
        determinants = log_det + float(np.linalg.slogdet(information)[1])
        if self.chain.spare:
            determinants += self.chain.spare * np.log1p(-share)
        return np.maximum(left, 1e-12 * np.diag(gram[p:, p:])) + self.within / (1.0 - share), determinants

    def __call__(self, share: float, time: float) -> Array:
        squares, determinants = self.squares(*self.gram(share, time), share)
        return np.asarray(determinants + self.freedom * np.log(squares / self.freedom))

    def as_stated(self) -> Array:
        """(n,) the same with the stated variance, all of it white."""
        squares, determinants = self.squares(*self.gram(0.0, 0.0), 0.0)
        return np.asarray(determinants + squares - self.freedom)


def find_sizes(
    chain: Chain, design: Array, residual: Array, within: Array
) -> tuple[list[ErrorSize], Array, Array]:
    """Sizes of the errors of each of n channels by restricted likelihood.

    Of M places: regressors (M, p), and residuals (M, n) in units of the stated sigma of a row; `within` (n,)
    are the squares of the rows about the means of which the chain is made, likewise.

    Returns:
        The sizes; by how much -2 log L falls with them against the stated noise (n,); and how much of this
        is that something lasts (n,). All of it the stated noise where too little is left to tell.
    """
    n = residual.shape[1]
    likelihood = _Likelihood(chain, design, residual, within)
    stated = [ErrorSize()] * n
    if len(chain.step) - likelihood.basis.shape[1] < 3 or likelihood.freedom < 5:  # of t and F; tolerance
        return stated, np.zeros(n), np.zeros(n)
    white = likelihood(0.0, chain.shortest)
    times = np.log(np.geomspace(chain.shortest, chain.longest, _TIMES))
    rates = np.linspace(*_RATES)
    coarse = np.array([[likelihood(*_share(chain, _point(chain, r, t))) for r in rates] for t in times])
    sizes, found = [], []
    for i in range(n):
        one = _Likelihood(chain, design, residual[:, i : i + 1], within[i : i + 1])
        share, time, best = 0.0, 0.0, float(white[i])
        for point in _profile(chain, times, rates, coarse[:, :, i]):
            value = _of_coordinates(one, point)
            if value < best:
                best, (share, time) = value, _share(chain, point)
        if share > 0.0:
            start = _coordinates(chain, ErrorSize(1.0 - share, share, time))
            # along the valley, in which what is new at each place stays the same, and across
            simplex = start + np.array([[0.0, 0.0], [0.5, 0.5], [0.2, 0.0]])
            better = minimize(
                partial(_of_coordinates, one),
                start,
                method="Nelder-Mead",
                options={"xatol": 0.02, "fatol": 0.01, "maxfev": 80, "initial_simplex": simplex},
            )
            if better.fun < best:
                best, (share, time) = float(better.fun), _share(chain, better.x)
        variance = float(one.squares(*one.gram(share, time), share)[0][0]) / one.freedom
        sizes.append(ErrorSize(variance * (1.0 - share), variance * share, time))
        found.append(best)
    return sizes, likelihood.as_stated() - found, white - found


def _profile(chain: Chain, times: Array, rates: Array, values: Array) -> list[Array]:
    """For each log time (T,) the (logit, log time) that is best: a parabola's top about the best rate."""
    points, apart = [], float(rates[1] - rates[0])
    for time, along in zip(times, values, strict=True):
        k = int(np.clip(np.argmin(along), 1, len(rates) - 2))
        below, at, above = along[k - 1 : k + 2]
        bend = below - 2.0 * at + above
        away = 0.5 * (below - above) / bend if bend > 0.0 else float(np.argmin(along) - k)
        points.append(_point(chain, float(rates[k] + apart * np.clip(away, -1.0, 1.0)), float(time)))
    return points


def _point(chain: Chain, rate: float, time: float) -> Array:
    """(logit, log time) of the logarithms of a time and of how fast what lasts grows over what is white."""
    return np.array([rate + time - np.log(chain.shortest), time])


def spread_of_sizes(
    chain: Chain, design: Array, residual: Array, within: float, size: ErrorSize, known: Array
) -> Spread:
    """What not knowing the sizes adds to the covariance of one channel's parameters.

    Parameters and their covariance are averaged over the sizes, weighted by the likelihood, which is largest
    at `size`. Design, residual and `within` are those of `find_sizes` for this channel; `known` (p, p) is the
    information on the parameters from elsewhere, in the same units.
    """
    likelihood = _Likelihood(chain, design, residual[:, None], np.array([within]))
    p, freedom = likelihood.p, likelihood.freedom
    centre = _coordinates(chain, size)
    gram, _ = likelihood.gram(*_share(chain, centre))
    pull = gram[:p, p] / (size.white + size.lasting)  # at the estimate, what is known elsewhere pulls back

    def at(u: Array, wider: float) -> tuple[float, Array, Array, Array]:
        """-log L; step and covariance of the parameters; what the sizes are."""
        share, time = _share(chain, u)
        gram, log_det = likelihood.gram(share, time)
        squares, determinants = likelihood.squares(gram, log_det, share)
        variance = float(squares[0]) / freedom
        covariance = np.asarray(np.linalg.inv(gram[:p, :p] / (variance * wider) + known))
        step: Array = covariance @ (gram[:p, p] / (variance * wider) - pull)
        sizes = np.array([np.sqrt(variance * (1.0 - share)), np.sqrt(variance * share), np.log(time)])
        return float(0.5 * (determinants + freedom * np.log(variance))), step, covariance, sizes

    # of the overall variance: Student's t, whose variance is that much larger
    wider = freedom / (freedom - 2.0)
    grid = np.zeros((1, 2)) if size.lasting == 0.0 else _about_maximum(lambda u: at(centre + u, wider)[0])
    values, steps, covariances, sizes = zip(*(at(centre + u, wider) for u in grid), strict=True)
    weights = np.exp(np.min(values) - np.array(values))
    weights /= weights.sum()
    away, scatter = np.array(steps), np.array(sizes)
    covariance = np.einsum("g,gij->ij", weights, covariances) + (weights * away.T) @ away
    excess, vectors = np.linalg.eigh(covariance - at(centre, 1.0)[2])
    squared = weights @ (scatter - weights @ scatter) ** 2
    squared[:2] += np.array([size.white, size.lasting]) / (2.0 * freedom)
    return Spread((vectors * np.maximum(excess, 0.0)) @ vectors.T, *np.sqrt(squared[:2]).tolist())


def _of_coordinates(likelihood: _Likelihood, u: Array) -> float:
    return float(likelihood(*_share(likelihood.chain, u))[0])


def _about_maximum(value: Callable[[Array], float]) -> Array:
    """(G, 2) a grid about the origin, along the axes of the curvature of -log L there."""
    h, here = 0.3, value(np.zeros(2))
    x, y = h * np.eye(2)
    curvature = np.empty((2, 2))
    curvature[0, 0] = value(x) + value(-x) - 2.0 * here
    curvature[1, 1] = value(y) + value(-y) - 2.0 * here
    curvature[0, 1] = curvature[1, 0] = 0.25 * (value(x + y) + value(-x - y) - value(x - y) - value(y - x))
    bent, axes = np.linalg.eigh(curvature / h**2)
    sigma = np.minimum(1.0 / np.sqrt(np.maximum(bent, 1e-12)), _WIDEST)
    line = np.linspace(-_REACH, _REACH, _GRID)
    return np.asarray(np.array(list(product(line * sigma[0], line * sigma[1]))) @ axes.T)


def _coordinates(chain: Chain, size: ErrorSize) -> Array:
    """(logit of the share that lasts, log time) of a size."""
    odds = max(size.lasting, 1e-12) / max(size.white, 1e-12)
    return np.array([np.log(odds), np.log(max(size.time, chain.shortest))])


def _share(chain: Chain, u: Array) -> tuple[float, float]:
    """The share that lasts and its time, as far as they can be told."""
    share = 1.0 / (1.0 + np.exp(-np.clip(u[0], -_LOGIT, _LOGIT)))
    return float(share), float(np.clip(np.exp(u[1]), chain.shortest, chain.longest))
