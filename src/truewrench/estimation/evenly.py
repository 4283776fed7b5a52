"""A stream's samples at even times, as spectra and filters of a given length need them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter

from truewrench.model.arrays import Array, Integers
from truewrench.model.motion.smooth import segments

MOST = 131_072  # samples of a stretch that a spectrum is of
LINES = 15  # bins of a running median, which passes over spectral lines
TAKEN = 3.0  # [Hz] about a band that was taken out, where a spectrum tells nothing
HOLES = 0.04  # of a column, up to which they are filled: 0 of 60 white logs were coloured, 7 of 24 with 0.05


def present(time: Array, values: Array) -> tuple[Array, Array, Integers]:
    """Of a log's columns (N, M) the rows that hold anything: times, values, and which they are."""
    there = np.isfinite(values).any(axis=1)
    rows = np.flatnonzero(there)
    return (time, values, rows) if there.all() else (time[rows], values[rows], rows)  # hours: no copy


def places_of(time: Array) -> Integers:
    """Numbers (N,) of samples of a piece that are taken evenly: those of lost ones are passed over.

    A sample was lost where a stamp, and the median of the nine from there on, come a period late; stamps that
    jitter do not stay late.
    """
    rows = np.arange(time.size)
    if time.size < 3:
        return rows
    late = (time - time[0]) * (time.size - 1) / (time[-1] - time[0]) - rows  # periods
    stays = median_filter(late, 9, mode="nearest")
    stays = stays[np.minimum(rows[1:] + 4, rows[-1])] - stays[np.maximum(rows[:-1] - 4, 0)]
    lost = np.where(stays > 0.5, np.rint(np.diff(late)), 0.0)
    return np.concatenate([[0], np.cumsum(1.0 + np.maximum(lost, 0.0))]).astype(np.int64)


def at_places(places: Integers, values: Array) -> Array:
    """Values (N, M) at their places, NaN elsewhere."""
    out: Array = np.full((int(places[-1]) + 1, values.shape[1]), np.nan)
    out[places] = values
    return out


def filled(values: Array) -> Array:
    """Samples with cubics in place of the missing ones; none where these are too many.

    Left out, they would bring what is slow on both sides together: a step that looks like coloured noise.
    """
    out, missing = values.copy(), ~np.isfinite(values)
    if missing.mean(axis=0).max() > HOLES:
        return out[:0]
    for column, holes in zip(out.T, missing.T, strict=True):
        if holes.any():
            known = np.flatnonzero(~holes)
            column[holes] = make_interp_spline(known, column[known], k=3)(np.flatnonzero(holes))
    return out


def evenly(time: Array, values: Array, most: int) -> Array:
    """The first samples (N, M) of a piece at their places, so many at most, and filled."""
    return filled(at_places(places_of(time[:most]), values[:most])[:most])


def hann(length: int) -> Array:
    """Hann's window."""
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length))


def blackman_harris(phase: Array) -> Array:
    """Blackman and Harris' window at phases of 0 to 2 pi; its lobes are 92 dB down from four bins on."""
    return np.asarray(
        0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2.0 * phase) - 0.01168 * np.cos(3.0 * phase)
    )


def welch(values: Array, period: float, window: Array) -> Array:
    """One-sided densities (length // 2 + 1, M) by Welch's method: medians of segments that overlap by half.

    SciPy's brings scipy.stats, a third of what `truewrench calibrate` takes to import.
    """
    length = window.size
    parts = np.lib.stride_tricks.sliding_window_view(values, length, axis=0)[:: length // 2]
    parts = parts - parts.mean(axis=-1, keepdims=True)
    power = 2.0 * period / np.sum(window**2) * np.abs(np.fft.rfft(window * parts, axis=-1)) ** 2
    even = 2.0 * np.arange(1, (len(parts) - 1) // 2 + 1)
    median_over_mean = 1.0 - np.sum(1.0 / even - 1.0 / (even + 1.0))  # of exponential values
    return np.asarray(np.median(power, axis=0).T / median_over_mean)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseSpectrum:
    """Of a stream, where no motion is."""

    hz: Array  # (F,)
    power: Array  # (F, M) one-sided densities of its columns, without lines
    averages: float  # segments
    period: float  # [s] of its samples


def noise_spectrum(
    time: Array,
    values: Array,
    begin: float,
    end: float,
    window: Array,
    without: Sequence[tuple[float, float]] = (),
) -> NoiseSpectrum | None:
    """Of samples (N, M) at times (N,), from `begin` [Hz] to `end` of the Nyquist frequency.

    Medians over segments as long as the window, `without` some bands [Hz]; None of what has too few samples.
    """
    length = window.size
    pieces = [piece for piece in segments(time) if piece.stop - piece.start >= length]
    if not pieces:
        return None
    period = float(np.median(np.diff(time)))
    frequency = np.fft.rfftfreq(length, period)
    use = (frequency >= begin) & (frequency <= end * 0.5 / period)
    for low, high in without:
        use &= (frequency < low - TAKEN) | (frequency > high + TAKEN)
    if use.sum() < 2 * LINES:
        return None
    total: Array = np.zeros((int(use.sum()), values.shape[1]))
    count = 0
    for piece in pieces:
        part = evenly(time[piece], values[piece], MOST)
        if len(part) >= length + 2:
            twice = np.diff(part, 2, axis=0)  # else what is slow leaks into what is fast
            total += welch(twice, period, window)[use] * len(part)
            count += len(part)
    if not count:
        return None
    hz: Array = np.asarray(frequency[use], np.float64)
    gain = (2.0 - 2.0 * np.cos(2.0 * np.pi * period * hz)) ** 2
    power = without_lines(total / count / gain[:, None])
    power = power[:, (power > 0.0).all(axis=0)]
    return NoiseSpectrum(hz, power, count / length, period) if power.size else None


def without_lines(power: Array) -> Array:
    """Of a spectrum (F,) or (F, M)."""
    return np.asarray(median_filter(power, (LINES, *(1,) * (power.ndim - 1)), mode="nearest"))
