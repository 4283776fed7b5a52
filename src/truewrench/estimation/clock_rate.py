"""A sensor's clock that runs faster or slower than that of the motion, as crystals of two devices do.

A sensor that is late by s + r (t - t_m) leaves -r (t - t_m) C dw/dt in the residuals. How late it is in parts
of a record, beside what gain, offset and s can follow, is a straight line then, and no line where a clock was
set; the variance is that of shorter parts, as residuals last. The rate is undone at the sensor's stamps.
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench.estimation.estimate import Clock, Estimate, LogRows
from truewrench.model.arrays import Array, Integers
from truewrench.model.log import Log, Tracking
from truewrench.model.rig import Rig
from truewrench.robot.compensation import weight_added

TOLD, LEFT = 6.0, 2.0  # sigma of a rate: that is told, and then left; told in 0 of 230 records without one
STRAIGHT = 0.1  # of the chi-square of all lateness, or 3 a degree of freedom: what no line holds
PARTS, SHORTER = 10, 4  # of a record, and of each of them


def clock_rates(rig: Rig, logs: Sequence[Log], estimate: Estimate) -> Array:
    """(L,) how much faster than the motion's the sensor's clock runs in each log; 0 where none is told."""
    if not estimate.solved:
        return np.zeros(len(logs))
    gain = estimate.gain / rig.sensor.channel_scale[:, None]
    told = [TOLD if log.clock_rate == 0.0 else LEFT for log in logs]
    return np.array([_rate(rows, gain, z) for rows, z in zip(estimate.rows, told, strict=True)])


def with_weight_told(rig: Rig, logs: Sequence[Log], estimate: Estimate) -> Estimate:
    """Clocks as uncertain as a weight leaves them that a driver had subtracted and that was added back.

    A fit takes this weight W for fixed; in truth it is that of t + s. Of x = C dw/dt and y = dW/dt, less what
    gain and offset follow, the score of s is x^T r, and moves with x - y alone: of what the data told of s a
    share^2 is left, share = x^T (x - y) / x^T x. Where gamma (10.5) is free, it has taken up y.
    """
    if rig.sensor.subtracted is None or not estimate.solved:
        return estimate
    clocks, scale = [], rig.sensor.channel_scale
    for log, rows, of in zip(logs, estimate.rows, estimate.clocks, strict=True):
        if all(clock.gamma is not None for clock in of[:1]):  # none of a log at rest
            clocks.append(of)
            continue
        felt = rows.wrench @ estimate.gain.T / scale
        rates = [_rates_of(rows, values) for values in (felt, weight_added(rig, log)[rows.rows] / scale)]
        whole = np.isfinite(np.hstack([rows.residual, rates[1]])).all(axis=1)
        use = np.flatnonzero(~rows.masked & whole)
        noise = np.std((rows.residual + rows.discrepancy)[use], axis=0).clip(1e-12)
        x, y = (_unfollowed(rows, use, values) / noise for values in rates)
        share = float(np.sum(x * (x - y)) / max(np.sum(x * x), 1e-300))
        clocks.append(tuple(_shared(clock, min(share**2, 1.0)) for clock in of))
    return replace(estimate, clocks=tuple(clocks))


def _shared(clock: Clock, share: float) -> Clock:
    """With a share of what the data told beside the prior, which follows them (10.1)."""
    prior = max(clock.stated, abs(clock.late), clock.std) ** -2.0
    return replace(clock, std=(prior + share * (clock.std**-2.0 - prior)) ** -0.5)


def _unfollowed(rows: LogRows, use: Integers, values: Array) -> Array:
    """Some rows of (K, n) less what gain and offset can follow."""
    size = np.abs(rows.wrench[use]).max(axis=0, initial=1e-12)
    basis, _ = np.linalg.qr(np.column_stack([rows.wrench[use] / size, np.ones(use.size)]))
    return np.asarray(values[use] - basis @ (basis.T @ values[use]))


def _rate(rows: LogRows, gain: Array, least: float) -> float:
    use = np.flatnonzero(~rows.masked & np.isfinite(rows.residual).all(axis=1))
    if use.size < 10 * PARTS * SHORTER:
        return 0.0
    time = rows.time[use]
    rates = _rates_of(rows, rows.wrench @ gain.T)
    x, y = (_unfollowed(rows, use, values) for values in (rates, rows.residual + rows.discrepancy))
    variance = np.mean(y**2, axis=0)
    if not (variance > 0.0).all():
        return 0.0
    score, information = np.sum(x * y / variance, axis=1), np.sum(x * x / variance, axis=1)
    parts = np.array_split(np.arange(use.size), PARTS * SHORTER)
    S, J = (np.array([v[at].sum() for at in parts]).reshape(PARTS, SHORTER) for v in (score, information))
    if not (J > 0.0).all():
        return 0.0
    late = -S.sum(axis=1) / J.sum(axis=1)  # (PARTS,) [s]
    spread = np.sum((S + late[:, None] * J) ** 2 / J) / (PARTS * (SHORTER - 1))  # 1 where residuals are white
    weight = J.sum(axis=1) / max(spread, 1.0)
    middle = np.array([time[at].mean() for at in parts]).reshape(PARTS, SHORTER).mean(axis=1)
    return told_rate(middle, late, weight, least)


def told_rate(middle: Array, late: Array, weight: Array, least: float) -> float:
    """The slope of a lateness that grows along a straight line, 0 where that is not told.

    The sensor is late by (P,) [s] in the parts of a record with the middles (P,) [s], of which the weights
    (P,) [1/s^2] are the information; `least` is the sigma from which on it is told.
    """
    apart = middle - weight @ middle / weight.sum()
    late = late - weight @ late / weight.sum()
    r = float(weight * apart @ late / (weight @ apart**2))
    told = abs(r) * np.sqrt(weight @ apart**2) > least
    total, crooked = weight @ late**2, weight @ (late - r * apart) ** 2
    sums, weights = np.cumsum(weight * late)[:-1], np.cumsum(weight)[:-1]
    of_step = total - np.max(sums**2 / weights + sums**2 / (weight.sum() - weights))  # a clock that was set
    straight = crooked < min(max(STRAIGHT * total, 3.0 * (late.size - 2)), of_step)
    return r if told and straight else 0.0


def _rates_of(rows: LogRows, felt: Array) -> Array:
    """Derivative by time of (K, n), masked rows as well; 0 where a stretch has a single row."""
    out = np.zeros_like(felt)
    for k in np.unique(rows.stretch):
        at = np.flatnonzero(rows.stretch == k)
        if at.size > 1:
            out[at] = np.gradient(felt[at], rows.time[at], axis=0)
    return out


def with_rate(log: Log, rate: float, middle: float | None = None) -> Log:
    """The log with its sensor's stamps as the motion's clock would have them, at rows of their own.

    The sensor's clock runs faster by `rate`. Both agree at `middle` [ns], by default that of the sensor's
    samples.
    """
    sensed = np.flatnonzero(np.isfinite(log.raw).any(axis=1))
    if middle is None:
        middle = 0.5 * float(log.time_ns[sensed[0]] + log.time_ns[sensed[-1]])
    stamps = log.time_ns[sensed] - np.rint(rate * (log.time_ns[sensed] - middle)).astype(np.int64)
    return replace(with_stamps(log, stamps), clock_rate=log.clock_rate + rate)


def with_stamps(log: Log, stamps: Integers) -> Log:
    """The log with the rows that hold samples of the sensor stamped so [ns], at rows of their own."""
    sensed = np.flatnonzero(np.isfinite(log.raw).any(axis=1))
    union = np.unique(np.concatenate([stamps, log.time_ns]))
    places = np.searchsorted(union, log.time_ns)

    def moved(values: Array, to: NDArray[np.intp]) -> Array:
        out: Array = np.full((union.size, *values.shape[1:]), np.nan)
        out[to] = values
        return out

    changed: dict[str, Any] = {
        f.name: moved(getattr(log, f.name), places)
        for f in fields(log)
        if isinstance(getattr(log, f.name), np.ndarray) and f.name not in ("time_ns", "raw")
    }
    changed["raw"] = moved(log.raw[sensed], np.searchsorted(union, stamps))
    if log.tracking is not None:
        arrays = {f.name: getattr(log.tracking, f.name) for f in fields(Tracking)}
        rows: dict[str, Any] = {
            name: moved(x, places) for name, x in arrays.items() if isinstance(x, np.ndarray)
        }
        changed["tracking"] = replace(log.tracking, **rows)
    return replace(log, time_ns=union, **changed)
