"""Vibration of the sensor that the motion does not show, taken out before anything is estimated.

A force of one frequency that reaches the sensor beside the payload's is no noise at the frequencies of a
motion; taken for white, it makes the sigma of every gain too large: of 26 ordinary vibrations NEES/36 was 0.3
in the median, and is 0.7 without them. A filter of even length takes the band of the line out, without delay
and without a trace of anything slow (docs/method.md, M12b). A line that the motion's streams show as well is
the payload's own wrench and stays.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from truewrench.estimation.evenly import at_places, filled, places_of, welch
from truewrench.model.arrays import Array
from truewrench.model.log import Line, Log
from truewrench.model.rig import Rig
from truewrench.motion.smooth import segments
from truewrench.robot.track import track

SLOWEST = 10.0  # [Hz] of a line, as of a vibration in words: motions are slower
WINDOW = 0.7  # [s] of the filter: what is 5.7 Hz and more below a line passes unchanged to 2e-5
BAND = 1.4  # [Hz] on either side of a line, within which the filter takes half and more
RESOLVED = 4.0  # [s] of a spectrum's segments
FLOOR = 8.0  # [Hz] of a running median, which passes over lines
MOST = 131_072  # samples that are looked at
LINES = 8  # at most
OUTLIER = 8.0  # sigma of a sample, from which on it tells nothing of a line

SHARE = 0.3
"""Of the rest of the noise's variance in some channel, from which on a line matters: 1.14 times its sigma."""

ABOVE = 4.0
"""Times the bands beside it, from which on it is a line: none in 304 imperfect records of other kinds, eight
(of contacts and of sensors filtered at 20 Hz) without this; all but 1 of 32 vibrations are beyond both."""

SEEN = 2.0
"""Times the noise of a stream of the motion in the same band, from which on the motion shows it: at most 1.8
in 41 records whose motion does not."""

_MOTION = (
    *("position", "velocity", "twist", "acceleration", "angular_velocity", "specific_force"),
    "base_twist",
)


def without_lines(rig: Rig, log: Log) -> Log:
    """The log without lines in its channels, nor in the motion where that shows them; else itself."""
    lines, still = _lines(log), log
    if shown := [line.hz for line in lines if line.shown]:
        still = _motion_without(rig, log, shown) or log
        lines = tuple(line for line in lines if still is not log or not line.shown)
    raw = _left(log, log.raw, [line.hz for line in lines]) if lines else None
    return log if raw is None else replace(still, raw=raw, lines=lines)


def _motion_without(rig: Rig, log: Log, hz: Sequence[float]) -> Log | None:
    """The log with another motion; None of one that is made of lines, and of integrated velocities."""
    streams = _motion(log)
    changed: dict[str, Any] = {name: _left(log, values, hz) for name, values in streams.items()}
    if any(left is None for left in changed.values()):
        return None
    if not any(_moves(changed[name], values) for name, values in streams.items()):
        return None
    if log.tracking is None:
        return replace(log, **changed)
    if log.position is None:  # these begin where the record does
        return None
    found = track(rig, replace(log, **changed, twist=None, gravity=None, tracking=None))
    return replace(found, notes=log.notes)


def _moves(left: Array, values: Array) -> bool:
    """Whether lines were the smaller part of a stream, and not what it was made of."""
    return bool(np.nanvar(left, axis=0).sum() > 0.5 * np.nanvar(values, axis=0).sum())


def _motion(log: Log) -> dict[str, Array]:
    """Its streams; the twist of joints is none, which they made."""
    names = [name for name in _MOTION if name != "twist" or log.tracking is None]
    return {name: values for name in names if (values := getattr(log, name)) is not None}


def _left(log: Log, values: Array, hz: Sequence[float]) -> Array | None:
    """A stream without the bands of lines; None where less than half of its samples would be left."""
    rows, out = np.flatnonzero(np.isfinite(values).any(axis=1)), np.full_like(values, np.nan)
    time = log.time[rows]
    kernel = _kernel(hz, float(np.median(np.diff(time))))
    for piece in _pieces(log, time):
        places = places_of(time[piece])
        out[rows[piece]] = _without(kernel, at_places(places, values[rows[piece]]))[places]
    return out if np.isfinite(out).sum() > 0.5 * np.isfinite(values).sum() else None


def _pieces(log: Log, time: Array) -> list[slice]:
    """Of the sensor's samples at times (N,), that no gap and no stated step of the offset interrupts."""
    jumps = (np.asarray(log.offset_jumps_ns, np.float64) - float(log.time_ns[0])) * 1e-9
    out = []
    for piece in segments(time):
        inner = np.searchsorted(time[piece], jumps) + piece.start
        ends = [piece.start, *sorted(int(i) for i in inner if piece.start < i < piece.stop), piece.stop]
        out += [slice(a, b) for a, b in pairwise(ends)]
    return out


def _lines(log: Log) -> tuple[Line, ...]:
    """Strongest first."""
    found = _spectrum(*_present(log.time, log.raw))
    if found is None:
        return ()
    hz, power, floor = found
    step = float(hz[1] - hz[0])
    half = max(1, round(BAND / step))
    excess = np.maximum(power - floor, 0.0) * step
    white = np.median(floor, axis=0) * (hz[-1] + step)
    mean = _moving_sum(power, half) / (2 * half + 1)
    beside = np.full_like(mean, np.inf)
    beside[2 * half : -2 * half] = np.maximum(mean[: -4 * half], mean[4 * half :])
    candidates = (hz >= SLOWEST)[:, None] & (mean > ABOVE * beside)
    motion = [found for values in _motion(log).values() if (found := _spectrum(*_present(log.time, values)))]
    lines: list[Line] = []
    while len(lines) < LINES:
        share = np.where(candidates, _moving_sum(excess, half) / white, 0.0).max(axis=1)
        top = int(np.argmax(share))
        if share[top] < SHARE:
            break
        near = slice(max(0, top - half), top + half + 1)
        weight = np.sum(excess[near] / white, axis=1)
        centre = float(weight @ hz[near] / weight.sum())
        amplitude = np.sqrt(2.0 * excess[near].sum(axis=0))
        lines.append(Line(centre, tuple(amplitude.tolist()), any(_shows(of, centre) for of in motion)))
        excess[max(0, top - 2 * half) : top + 2 * half + 1] = 0.0
    return tuple(lines)


def _present(time: Array, values: Array) -> tuple[Array, Array]:
    rows = np.isfinite(values).any(axis=1)
    return time[rows], values[rows]


def _shows(motion: tuple[Array, Array, Array], hz: float) -> bool:
    """Whether a component of a stream has more than its noise about a frequency."""
    frequency, power, floor = motion
    near = np.abs(frequency - hz) <= BAND
    return bool((power[near].sum(axis=0) > SEEN * floor[near].sum(axis=0)).any())


def _spectrum(time: Array, values: Array) -> tuple[Array, Array, Array] | None:
    """Frequencies (F,) [Hz], one-sided densities (F, M), their floor; None of what is too short or slow."""
    if len(time) < 2:
        return None
    piece = max(segments(time), key=lambda x: x.stop - x.start)
    period = float(np.median(np.diff(time)))
    length = round(RESOLVED / period)
    part = filled(at_places(places_of(time[piece]), values[piece])[:MOST])
    if len(part) < length + 2 or 0.4 / period < SLOWEST:
        return None
    twice = np.diff(part, 2, axis=0)  # else what is slow leaks into what is fast
    frequency = np.fft.rfftfreq(length, period)
    use = (frequency >= 0.5 * SLOWEST) & (frequency < 0.49 / period)
    hz: Array = np.asarray(frequency[use], np.float64)
    gain = (2.0 - 2.0 * np.cos(2.0 * np.pi * period * hz)) ** 2
    power = welch(twice, period, length)[use] / gain[:, None]
    width = 2 * round(0.5 * FLOOR / float(hz[1] - hz[0])) + 1
    floor = median_filter(power, (width, 1), mode="nearest")
    return hz, power, np.maximum(floor, 1e-300)  # a channel that never changes


def _moving_sum(values: Array, half: int) -> Array:
    """(F, M) over so many on either side."""
    sums = np.cumsum(np.pad(values, ((half + 1, half), (0, 0))), axis=0)
    return np.asarray(sums[2 * half + 1 :] - sums[: -2 * half - 1])


def _kernel(hz: Sequence[float], period: float) -> Array:
    """(2 M + 1,) what passes the bands of lines, each by its full amplitude: Blackman and Harris' windows."""
    m = round(0.5 * WINDOW / period)
    n = np.arange(-m, m + 1)
    phase = 2.0 * np.pi * (n + m + 0.5) / (2 * m + 1)
    window = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    waves = np.cos(2.0 * np.pi * period * np.outer(hz, n))
    bands = waves * window
    return np.asarray(np.linalg.solve(waves @ bands.T, np.ones(len(hz))) @ bands)


def _without(kernel: Array, values: Array) -> Array:
    """(N, n) evenly sampled less the bands of lines; NaN at the ends, and where a sample is missing."""
    out, m = np.full_like(values, np.nan), kernel.size // 2
    z = filled(values)
    if len(z) < kernel.size:
        return out
    for _ in range(2):  # what stands out would be spread over the filter's length
        left = z[m:-m] - _convolved(z, kernel)
        stands = left - median_filter(left, (9, 1), mode="nearest")
        sigma = 1.4826 / np.sqrt(6.0) * np.median(np.abs(np.diff(left, 2, axis=0)), axis=0)
        outlier = (np.abs(stands) > OUTLIER * sigma) & (sigma > 0.0)
        if not outlier.any():
            break
        z[m:-m][outlier] -= stands[outlier]
    out[m:-m] = values[m:-m] - _convolved(z, kernel)
    return out


def _convolved(values: Array, kernel: Array) -> Array:
    """(N, n) with a kernel, where it lies within: (N - 2 M, n), by parts."""
    part = 1 << 16
    return np.concatenate(
        [
            _fft(values[k : k + part + kernel.size - 1], kernel)
            for k in range(0, len(values) - kernel.size + 1, part)
        ]
    )


def _fft(values: Array, kernel: Array) -> NDArray[np.float64]:
    n = 1 << (len(values) + kernel.size - 2).bit_length()
    both = np.fft.rfft(values, n, axis=0) * np.fft.rfft(kernel, n)[:, None]
    return np.asarray(np.fft.irfft(both, n, axis=0)[kernel.size - 1 : len(values)], np.float64)
