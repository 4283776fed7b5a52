"""Vibration, taken out of channels and motion before anything is estimated.

A force that shakes the sensor faster than a motion is no noise at the frequencies of a motion; taken for
white it makes the sigma of every gain too large. And what shakes the arm with it teaches nothing: at 20 Hz a
payload is hardly rigid. A filter of even length takes the band out, without delay and without a trace of
anything slow (docs/method.md, M12b): of the channels, and of the motion where that shows it as well.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from truewrench.estimation.evenly import (
    at_places,
    blackman_harris,
    evenly,
    filled,
    hann,
    places_of,
    present,
    welch,
)
from truewrench.model.arrays import Array
from truewrench.model.log import Log, Vibration
from truewrench.model.motion.smooth import segments
from truewrench.model.rig import Rig
from truewrench.robot.track import track

SLOWEST = 10.0  # [Hz] of a vibration, as in words: motions are slower
QUIET = 5.0  # [Hz] from which on up to `SLOWEST` the noise is that which counts
WINDOW = 0.7  # [s] of the filter: what is 5.7 Hz and more below a band passes unchanged to 2e-5
APART = 0.7  # [Hz] between the frequencies that fill a band
SMOOTH = 0.7  # [Hz] on either side, over which spectra are averaged
RESOLVED = 4.0  # [s] of a spectrum's segments,
BRIEF = 2.0  # and of those of half a record, at most
SHORTEST = 1.0  # and at least
SEGMENTS = 3.5
"""Of their lengths that a record has, six that overlap by half: of one, the densities of white noise seem to
shake in 42% of records of 4 to 6 s; of six in 10 of 4,000 of 5 to 20 s."""

MOST = 131_072  # samples that are looked at
OUTLIER = 8.0  # sigma of a sample, from which on it tells nothing of a vibration

SHARE = 0.3
"""Of the variance of that noise in some channel, from which on a vibration matters: 1.14 times its sigma."""

ABOVE = 4.0
"""Times the density of that noise, from which on there is a vibration: in none of 2,480 records without,
clean and of 15 kinds of imperfect hardware; in 79 of 80 with it (benchmarks/imperfect.py, seed 812)."""

SEEN = 2.0
"""Times the noise of a stream of the motion in and beside a band, from which on the motion shows it: in 0.2%
of 1,800 bands of white noise of six components."""

CORNERS = (40.0, 27.0, 18.0, 12.0, 8.0)  # [Hz] from one of which on everything may be left out: tolerance
LOWPASS = 0.8  # [s] of the filter that does
EDGE = 5.0  # [Hz] below its corner it changes nothing by more than 2e-5
WIDEST = 12.0  # [Hz] of all bands together, beyond which everything is left out: tolerance

REST = 4.0
"""Times the density of the slowest noise that is found outside all bands, from which on everything from a
corner on is left out: in none of 500 records of imperfect hardware (benchmarks/imperfect.py, seed 96). Of
each half of a record, whose spectra are rougher, its root: tolerance."""

_MOTION = (
    *("position", "velocity", "twist", "acceleration", "angular_velocity", "specific_force"),
    "base_twist",
)


def without_vibrations(rig: Rig, log: Log) -> Log:
    """The log without vibrations in its channels, nor in the motion where that shows them; else itself."""
    found, still = _vibrations(rig, log), log
    if shown := [x for x in found if x.shown]:
        still = _motion_without(rig, log, shown) or log
        found = tuple(x for x in found if still is not log or not x.shown)
    if not found or (raw := _left(log, log.raw, found)) is None:
        return log
    return replace(still, raw=raw[0], vibrations=found, calmed=dict(still.calmed) | {"raw": raw[1]})


def _motion_without(rig: Rig, log: Log, bands: Sequence[Vibration]) -> Log | None:
    """The log with another motion; None of one that is made of vibration, and of integrated velocities."""
    streams = _motion(log)
    changed: dict[str, Any] = {}
    calmed: dict[str, float] = {}
    for name, values in streams.items():
        if (left := _left(log, values, bands)) is None:
            return None
        changed[name], calmed[name] = left
    if not any(_moves(changed[name], values) for name, values in streams.items()):
        return None
    if log.tracking is None:
        return replace(log, **changed, calmed=calmed)
    if log.position is None:  # these begin where the record does
        return None
    found = track(rig, replace(log, **changed, twist=None, gravity=None, tracking=None))
    return replace(found, notes=log.notes, calmed=calmed)


def _moves(left: Array, values: Array) -> bool:
    """Whether vibration was the smaller part of a stream, and not what it was made of."""
    return bool(np.nanvar(left, axis=0).sum() > 0.5 * np.nanvar(values, axis=0).sum())


def _motion(log: Log) -> dict[str, Array]:
    """Its streams; the twist of joints is none, which they made."""
    names = [name for name in _MOTION if name != "twist" or log.tracking is None]
    return {name: values for name in names if (values := getattr(log, name)) is not None}


def _left(log: Log, values: Array, bands: Sequence[Vibration]) -> tuple[Array, float] | None:
    """A stream without bands, and what of the 1 sigma of its noise; None where too few samples would be left.

    Of the rest of a white spectrum so many samples are left as make it white again.
    """
    out = np.full_like(values, np.nan)
    time, there, rows = present(log.time, values)
    period = float(np.median(np.diff(time))) if rows.size > 1 else np.inf
    told = [band for band in bands if min(band.high, 1.1 * band.low) < 0.5 / period]
    if not told:
        return values, 1.0
    everything = told[0].open
    kernel = _all_from(told[0].low, period) if everything else _kernel(told, period)
    share = 1.0 - 2.0 * kernel[kernel.size // 2] + kernel @ kernel  # of the variance of white noise
    for piece in _pieces(log, time):
        places = places_of(time[piece])
        without = _without(kernel, at_places(places, there[piece]), lone=not everything)
        counted = np.floor(share * np.arange(len(without) + 1))
        without[counted[1:] == counted[:-1]] = np.nan
        out[rows[piece]] = without[places]
    least = 0.5 * share if everything else 0.5
    enough = np.isfinite(out).sum() > least * np.isfinite(values).sum()
    return (out, float(np.sqrt(share))) if enough else None


def _pieces(log: Log, time: Array) -> list[slice]:
    """Of the sensor's samples at times (N,), that no gap and no stated step of the offset interrupts."""
    jumps = (np.asarray(log.offset_jumps_ns, np.float64) - float(log.time_ns[0])) * 1e-9
    out = []
    for piece in segments(time):
        inner = np.searchsorted(time[piece], jumps) + piece.start
        ends = [piece.start, *sorted(int(i) for i in inner if piece.start < i < piece.stop), piece.stop]
        out += [slice(a, b) for a, b in pairwise(ends)]
    return out


def _vibrations(rig: Rig, log: Log) -> tuple[Vibration, ...]:
    """Slowest first."""
    found = _spectrum(log.time, log.raw)
    if found is None:
        return ()
    hz, power = found
    step = float(hz[1] - hz[0])
    quiet = np.maximum(np.median(power[hz < SLOWEST], axis=0), 1e-300)  # a channel that never changes
    half = round(SMOOTH / step)
    above = (_moving_sum(power, half) > ABOVE * (2 * half + 1) * quiet).any(axis=1) & (hz >= SLOWEST)
    edges = np.flatnonzero(np.diff(above, prepend=False, append=False))
    excess = np.maximum(power - quiet, 0.0) * step
    white = quiet * (hz[-1] + step)
    seen = [slice(begin, end) for begin, end in edges.reshape(-1, 2)]
    bands = [band for band in seen if (excess[band].sum(axis=0) / white).max() >= SHARE]
    motion = [found for values in _motion(log).values() if (found := _spectrum(log.time, values))]

    def vibration(inner: slice, low: float, high: float, centre: float, shown: bool) -> Vibration:
        std = np.sqrt(excess[inner].sum(axis=0)) / rig.sensor.channel_scale
        channel = rig.sensor.channels[int(np.argmax(std))]
        return Vibration(low, high, centre, tuple(std.tolist()), channel, shown)

    corner = _corner(hz, power, bands, seen, motion)
    if corner is not None and any(_lasts(log.time, x) for x in (log.raw, *_motion(log).values())):
        shown = any(_shows(x, corner - EDGE, np.inf) or _loud(*x) for x in motion)
        return (vibration(slice(int(np.searchsorted(hz, corner)), None), corner, np.inf, corner, shown),)
    out = []
    for inner in bands:
        weight = np.sum(excess[inner] / white, axis=1)
        centre = float(weight @ hz[inner] / weight.sum())
        low, high = min(float(hz[inner][0]) + SMOOTH, centre), max(float(hz[inner][-1]) - SMOOTH, centre)
        out.append(vibration(inner, low, high, centre, any(_shows(x, low, high) for x in motion)))
    return tuple(out)


def _corner(
    hz: Array,
    power: Array,
    bands: Sequence[slice],
    seen: Sequence[slice],
    motion: Sequence[tuple[Array, Array]],
) -> float | None:
    """From where on everything is left out, as what shakes is not of a few bands; None where nothing is.

    `bands` are those of `seen` that matter.
    """
    step = float(hz[1] - hz[0])
    corners = [corner for corner in CORNERS if 1.25 * corner < hz[-1] + step]
    widest = max((band.stop - band.start for band in seen), default=0)
    wide = max(widest, sum(band.stop - band.start for band in bands)) * step > WIDEST
    known = [(float(hz[band.start]), float(hz[band.stop - 1])) for band in seen]
    if not corners or not (wide or any(_loud(*x, known) for x in ((hz, power), *motion))):
        return None
    louder, slow = _louder(hz, power), hz < SLOWEST
    loudest = [float(louder[part].max(axis=0).mean()) for part in (slow, ~slow)]
    if loudest[0] > loudest[1] and any(_shows(x, QUIET, SLOWEST) for x in motion):
        return None  # a motion that is so fast
    profiles = [(x[0], _louder(*x).mean(axis=1)) for x in ((hz, power), *motion)]
    passes = (c for c in corners if all(of[at <= c].max() < np.log(REST) for at, of in profiles))
    return next(passes, corners[-1])


def _louder(hz: Array, power: Array) -> Array:
    """(F, M) logarithms of densities over those of the slowest noise."""
    half = round(SMOOTH / float(hz[1] - hz[0]))
    slowest = np.maximum(power[hz < QUIET + 2.0 * SMOOTH].mean(axis=0), 1e-300)
    return np.asarray(np.log(np.maximum(_moving_sum(power, half) / (2 * half + 1), 1e-300) / slowest))


def _loud(hz: Array, power: Array, bands: Sequence[tuple[float, float]] = ()) -> bool:
    """Whether a stream shakes outside some bands [Hz]."""
    rest = hz >= SLOWEST
    for low, high in bands:
        rest &= (hz < low - SMOOTH) | (hz > high + SMOOTH)
    return bool(rest.any() and _louder(hz, power)[rest].max(axis=0).mean() > np.log(REST))


def _all_from(corner: float, period: float) -> Array:
    """(2 M + 1,) what passes everything from a corner on, by half of its amplitude there."""
    m = round(0.5 * LOWPASS / period)
    n = np.arange(-m, m + 1)
    slow = np.sinc(2.0 * corner * period * n) * blackman_harris(2.0 * np.pi * (n + m + 0.5) / (2 * m + 1))
    out = -slow / slow.sum()
    out[m] += 1.0
    return np.asarray(out)


def _lasts(time: Array, values: Array) -> bool:
    """Whether a stream shakes in both halves of a record: a burst of noise, or a contact, is in one."""
    middle = len(time) // 2
    halves = [_spectrum(time[part], values[part], BRIEF) for part in (slice(middle), slice(middle, None))]
    return all(
        half is not None and _louder(*half)[half[0] >= SLOWEST].mean(axis=1).max() > 0.5 * np.log(REST)
        for half in halves
    )


def _shows(motion: tuple[Array, Array], low: float, high: float) -> bool:
    """Whether a component of a stream has more than its noise within a band."""
    hz, power = motion
    inner = power[(hz >= low - 2.0 * APART) & (hz <= high + 2.0 * APART)]
    return bool((inner.sum(axis=0) > SEEN * len(inner) * np.median(power, axis=0)).any())


def _spectrum(time: Array, values: Array, seconds: float = RESOLVED) -> tuple[Array, Array] | None:
    """Frequencies (F,) [Hz] and one-sided densities (F, M); None of what is too short or slow."""
    time, values, _ = present(time, values)
    if len(time) < 2:
        return None
    piece = max(segments(time), key=lambda x: x.stop - x.start)
    period = float(np.median(np.diff(time)))
    part = evenly(time[piece], values[piece], MOST)
    if len(part) * period < 1.25 * seconds or 0.4 / period < SLOWEST:  # of 4.2 s it is 7%
        return None
    length = round(min(seconds, max(len(part) * period / SEGMENTS, SHORTEST)) / period)
    twice = np.diff(part, 2, axis=0)  # else what is slow leaks into what is fast
    frequency = np.fft.rfftfreq(length, period)
    use = (frequency >= QUIET) & (frequency < 0.49 / period)
    hz: Array = np.asarray(frequency[use], np.float64)
    gain = (2.0 - 2.0 * np.cos(2.0 * np.pi * period * hz)) ** 2
    return hz, welch(twice, period, hann(length))[use] / gain[:, None]


def _moving_sum(values: Array, half: int) -> Array:
    """(F, M) over so many on either side."""
    sums = np.cumsum(np.pad(values, ((half + 1, half), (0, 0))), axis=0)
    return np.asarray(sums[2 * half + 1 :] - sums[: -2 * half - 1])


def _kernel(bands: Sequence[Vibration], period: float) -> Array:
    """(2 M + 1,) what passes bands by their full amplitude: cosines under Blackman and Harris' window."""
    m = round(0.5 * WINDOW / period)
    n = np.arange(-m, m + 1)
    phase = 2.0 * np.pi * (n + m + 0.5) / (2 * m + 1)
    hz = np.concatenate([x.centre + APART * np.arange(*_steps(x)) for x in bands])
    waves = np.cos(2.0 * np.pi * period * np.outer(hz, n))
    passed = waves * blackman_harris(phase)
    return np.asarray(np.linalg.lstsq(waves @ passed.T, np.ones(hz.size), rcond=1e-6)[0] @ passed)


def _steps(band: Vibration) -> tuple[int, int]:
    return round((band.low - band.centre) / APART), 1 + round((band.high - band.centre) / APART)


def _without(kernel: Array, values: Array, lone: bool) -> Array:
    """(N, n) evenly sampled less what a kernel passes; NaN at the ends, and where a sample is missing.

    With `lone`, samples that stand out alone are not spread over the filter's length.
    """
    out, m = np.full_like(values, np.nan), kernel.size // 2
    z = filled(values)
    if len(z) < kernel.size:
        return out
    from scipy.signal import oaconvolve  # brings scipy.stats: half a second

    def passed() -> Array:
        return np.asarray(oaconvolve(z, kernel[:, None], mode="valid", axes=0))

    for _ in range(2 if lone else 0):
        left = z[m:-m] - passed()
        stands = left - median_filter(left, (9, 1), mode="nearest")
        sigma = 1.4826 / np.sqrt(6.0) * np.median(np.abs(np.diff(left, 2, axis=0)), axis=0)
        outlier = (np.abs(stands) > OUTLIER * sigma) & (sigma > 0.0)
        if not outlier.any():
            break
        z[m:-m][outlier] -= stands[outlier]
    out[m:-m] = values[m:-m] - passed()
    return out
