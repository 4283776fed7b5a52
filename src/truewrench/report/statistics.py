"""What is drawn of residuals: envelope over time, density over frequency, histogram."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import chdtri

from truewrench.model.arrays import Array, Integers
from truewrench.report.series import Record, Series

BUCKETS = 1000  # of the time axis: about the pixels of a wide screen
_LONGEST = 2048  # samples of a transform
_SHORTEST = 128
_BANDS = 100  # of frequency, equal on a logarithmic axis
_IRREGULAR = 1.5  # periods between two samples that end a run


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """Curves over the common time axis."""

    time: Array  # (K,) [s]; NaN breaks the lines
    values: Array  # (K, C): where decimated, smallest and largest in turns
    bucket: float | None  # length of a bucket [s], None where every sample is there


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Power density of the residuals over the one expected of their noise."""

    frequency: Array  # (K,) [Hz]
    ratio: Array  # (K, 6)
    low: Array  # (K,) bounds between which chance keeps 95 of 100 ratios
    high: Array  # (K,)


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Of residuals in units of their sigma."""

    edges: Array  # (B + 1,)
    density: Array  # (B, 6) per sigma
    within: Array  # (6,) share of the samples within 1.96 sigma
    outside: Integers  # (6,) samples beyond the edges
    size: Array  # (6,) RMS


def envelope(record: Record, values_of: Callable[[Series], Array]) -> Envelope:
    """Every sample, or where these are too many, smallest and largest of each of `BUCKETS` stretches."""
    total = sum(len(series.time) for series in record.logs)
    width = record.end / BUCKETS if total > 2 * BUCKETS else None
    times, values = [], []
    for series in record.logs:
        if len(series.time) == 0:
            continue
        time, found = series.time, values_of(series)
        if width is not None:
            time, found = _decimated(time, found, width)
        times += [time + series.begin, np.array([np.nan])]
        values += [found, np.full((1, found.shape[1]), np.nan)]
    return Envelope(np.concatenate(times), np.concatenate(values), width)


def _decimated(time: Array, found: Array, width: float) -> tuple[Array, Array]:
    bucket = np.where(np.isnan(time), -1.0, np.floor(np.nan_to_num(time) / width)).astype(int)
    known = bucket >= 0
    bucket, found = bucket[known], found[known]
    starts = np.flatnonzero(np.diff(bucket, prepend=-1))
    empty = np.isnan(found)
    values = np.empty((2 * starts.size, found.shape[1]))
    values[::2] = np.minimum.reduceat(np.where(empty, np.inf, found), starts, axis=0)
    values[1::2] = np.maximum.reduceat(np.where(empty, -np.inf, found), starts, axis=0)
    values[np.isinf(values)] = np.nan
    middle = (np.repeat(bucket[starts], 2) + np.tile([0.25, 0.75], starts.size)) * width
    gaps = np.flatnonzero(np.diff(bucket[starts]) > 1) + 1  # buckets without any row: the line breaks
    return np.insert(middle, 2 * gaps, np.nan), np.insert(values, 2 * gaps, np.nan, axis=0)


def spectrum(record: Record) -> Spectrum | None:
    """Mean over all unbroken runs of all logs; None where no run is long enough."""
    runs = [(series, run) for series in record.logs for run in _runs(series)]
    if not runs:
        return None
    size = min(_LONGEST, max(run.stop - run.start for _, run in runs))
    period = float(np.median([np.median(np.diff(series.time[run])) for series, run in runs]))
    total, segments = np.zeros((size // 2 + 1, 6)), 0
    for series, run in runs:
        if run.stop - run.start < size:
            continue
        u = series.normalised[run] * np.sqrt(series.left.mean())  # over all noise: what a fit follows is slow
        powers = _powers(u, size)
        total += powers.sum(axis=0)
        segments += len(powers)
    frequency, ratio = np.asarray(np.fft.rfftfreq(size, period), np.float64), total / segments
    return _banded(frequency[1:-1], ratio[1:-1], segments)


def _powers(u: Array, size: int) -> Array:
    """(S, size // 2 + 1, 6) of overlapping halves under Hann's window, 1 for white noise: Welch's method.

    SciPy's brings scipy.stats, a second to import.
    """
    parts = np.lib.stride_tricks.sliding_window_view(u, size, axis=0)[:: size - size // 2]  # (S, 6, size)
    window = np.sin(np.pi * np.arange(size) / size) ** 2
    found = np.fft.rfft((parts - parts.mean(axis=2, keepdims=True)) * window, axis=2)
    return np.asarray(np.abs(found).swapaxes(1, 2) ** 2 / np.sum(window**2))


def _banded(frequency: Array, ratio: Array, segments: int) -> Spectrum:
    edges = np.geomspace(frequency[0], frequency[-1] * 1.0001, _BANDS + 1)
    band = np.searchsorted(edges, frequency, side="right")
    starts = np.flatnonzero(np.diff(band, prepend=-1))
    count = np.diff(np.append(starts, band.size))
    mean = np.add.reduceat(ratio, starts, axis=0) / count[:, None]
    middle = np.add.reduceat(frequency, starts) / count
    # overlapping halves under Hann's window: 1.06 times as many averages as half the segments
    freedom = 2.0 * count * max(1.0, 0.53 * segments)
    low, high = (chdtri(freedom, q) / freedom for q in (0.975, 0.025))
    return Spectrum(middle, mean, low, high)


def _runs(series: Series) -> list[slice]:
    """Stretches of samples at equal distances, without a gap."""
    if len(series.time) < _SHORTEST:
        return []
    known = np.isfinite(series.residual).all(axis=1) & np.isfinite(series.time)
    step = np.diff(series.time)
    usual = float(np.nanmedian(step))
    broken = np.append(True, ~known[1:] | ~known[:-1] | ~(step < _IRREGULAR * usual))
    edges = np.append(np.flatnonzero(broken), len(known))
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if b - a >= _SHORTEST and known[a]]


def histogram(record: Record) -> Histogram:
    """Of all samples of all logs."""
    u = np.concatenate([series.normalised for series in record.logs])
    u = u[np.isfinite(u).all(axis=1)]
    edges = np.linspace(-5.0, 5.0, 41)
    counts = np.column_stack([np.histogram(column, edges)[0] for column in u.T])
    return Histogram(
        edges,
        counts / (len(u) * 0.25),
        np.mean(np.abs(u) <= 1.96, axis=0),
        np.asarray(len(u) - counts.sum(axis=0), dtype=np.int64),
        np.sqrt(np.mean(u**2, axis=0)),
    )
