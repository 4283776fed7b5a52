"""How likely chance makes residuals as they were found: their size, their ratio, their order in time."""

from collections.abc import Sequence

import numpy as np
from scipy.special import betainc, chdtr, chdtrc, ndtri

from truewrench.judging.validation.errors import factor
from truewrench.judging.validation.residuals import LONGEST_LAG, Residuals
from truewrench.model.arrays import Array, Integers

DRAWS = 1000  # of the bootstrap
LAGS = 10  # autocorrelations that are tested


def longest_block(parts: Sequence[Residuals]) -> int:
    """Of the `block_of` logs."""
    return max(block_of(part) for part in parts)


def block_of(part: Residuals) -> int:
    """Rows of about one period of the motion: four times the first zero of the wrench's autocorrelation."""
    longest = 1
    for series in part.wrench.T:
        size = 2 * len(series)
        correlation = np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2)[: len(series)]
        below = np.flatnonzero(correlation <= 0.0)
        longest = max(longest, 4 * int(below[0]) if below.size else len(series))
    return max(10, min(longest, len(part.wrench) // 5))


def bootstrap(old: Array, new: Array, block: int, seed: int) -> Array:
    """(DRAWS, 6) ratios of RMS residuals in moving blocks drawn with replacement."""
    squares = np.concatenate([old**2, new**2], axis=1)
    total = np.cumsum(np.concatenate([np.zeros((1, 12)), squares, squares[: block - 1]]), axis=0)
    sums = total[block:] - total[:-block]  # (M, 12), circular
    draws = max(1, round(len(old) / block))
    chosen = np.random.default_rng(seed).integers(len(sums), size=(DRAWS, draws))
    drawn = np.zeros((DRAWS, 12))
    for k in range(draws):
        drawn += sums[chosen[:, k]]
    tiny = np.finfo(np.float64).tiny
    return np.asarray(np.sqrt((drawn[:, 6:] + tiny) / (drawn[:, :6] + tiny)))


def deviate(coverage: float, rows: float) -> float:
    """Sigma of a normal variable that chance takes as far as so few of independent rows within 95% limits."""
    if coverage >= 0.95:
        return 0.0
    tail = float(betainc(rows * (1.0 - coverage), rows * coverage + 1.0, 0.05))  # binomial
    return -float(ndtri(max(tail, np.finfo(np.float64).tiny)))


def probability_of(nis: float, spread: float, skew: float, share: float, freedom: float) -> float:
    """Of a mean square so far from 1, a weighted sum of chi-squares of the given cumulants.

    From above by a chi-square of the same three cumulants (Hall, Buckley and Eagleson). From below against
    a calibration without any error: however uncertain the gain, it may happen to be right.
    """
    if nis > 1.0:
        k = 8.0 * spread**3 / skew**2
        return float(chdtrc(k, k + np.sqrt(2.0 * k / spread) * (nis - 1.0)))
    return float(chdtr(freedom, freedom * nis / share))


def correlations(parts: Sequence[Residuals], i: int) -> tuple[Array, Array]:
    """Autocovariance of an axis' residual over its noise, (LAGS + 1,) found and (LONGEST_LAG + 1,) expected.

    What can be done to it by the gain's own error, a constant and a share of every wrench axis, and by those
    of payload and tilt as far as they are uncertain, is taken out before. Static poses tell none.
    """
    sizes = [len(part.new) for part in parts]
    expected = np.average([part.lagged[:, i] for part in parts], axis=0, weights=sizes)
    expected[0] = 1.0
    found, total = np.zeros(LAGS + 1), 0
    for part, size in zip(parts, sizes, strict=True):
        if part.at_rest:
            continue
        uncertain = part.by_own[:, i]
        if part.carried is not None:
            of_payload = part.by_payload[:, i] @ factor(part.carried.covariance)
            uncertain = np.column_stack([uncertain, of_payload])
        design = np.column_stack([part.wrench, np.ones(size), uncertain])
        sigma = np.sqrt(np.mean(part.noise[:, i]))
        prior = np.eye(uncertain.shape[1], design.shape[1], 7) * sigma
        values = np.append(part.new[:, i], np.zeros(len(prior)))
        rest = part.new[:, i] - design @ np.linalg.lstsq(np.vstack([design, prior]), values)[0]
        u = rest / np.sqrt(part.noise[:, i])
        pairs = np.zeros(LAGS + 1)
        for lag in range(LAGS + 1):
            count = 0
            for begin, end in zip(part.begin, (*part.begin[1:], size), strict=True):
                pairs[lag] += u[begin : end - lag] @ u[begin + lag : end]
                count += end - begin - lag
            pairs[lag] /= max(1, count)
        found += size * pairs
        total += size
    return found / total if total else expected[: LAGS + 1], expected


def whiteness(found: Array, expected: Array, size: int) -> tuple[float, float]:
    """Largest autocorrelation beyond the expected one, and the probability of the first ones (Bartlett)."""
    c = expected.copy()
    c[0] = max(1.0, float(found[0]))
    reach = np.arange(-LONGEST_LAG, LONGEST_LAG + 1)

    def at(lag: Integers) -> Array:
        known = np.abs(lag) <= LONGEST_LAG
        return np.where(known, c[np.where(known, np.abs(lag), 0)], 0.0)

    lags = range(1, LAGS + 1)
    covariance = np.array(
        [[np.sum(at(reach) * at(reach + m - k) + at(reach + m) * at(reach - k)) for m in lags] for k in lags]
    )
    excess = found[1:] - expected[1 : LAGS + 1]
    statistic = size * float(excess @ np.linalg.solve(covariance, excess))
    return float(excess[np.argmax(np.abs(excess))] / c[0]), float(chdtrc(LAGS, statistic))
