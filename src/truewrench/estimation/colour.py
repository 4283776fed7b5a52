"""Noise that a filter has coloured, made white again before anything is estimated.

Sensors and drivers filter what they log, noise and all. Taken for white, such noise seems smaller than it is
at the frequencies of a motion, and its slow part seems to be a motion or a disturbance. Where no motion is,
its spectrum tells the filter, by Whittle's likelihood: a mean of so many samples, one of which tells all that
they do; or an autoregressive model A(z), whose inverse A(z) / A(1) leaves white noise of the same density and
undoes the delay (docs/method.md, M12a).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import minimize

from truewrench.estimation.evenly import at_places, evenly, places_of, present, welch
from truewrench.model.arrays import Array
from truewrench.model.log import Log, Whitened
from truewrench.motion.smooth import segments

BEGIN = 12.0  # [Hz] from which on a spectrum is noise, as motions are slower
SLOW = 0.75  # of it, below which a corner is none: hysteresis and walks have spectra like that of a slow pole
END = 0.6  # of the Nyquist frequency, beyond which digital filters have zeros
LINES = 15  # bins of a running median, which passes over spectral lines
FEWEST = 512  # samples of a stretch, and of a spectrum
MOST = 131_072  # that are looked at
LONGEST = 64  # samples of a mean
TAKEN = 3.0  # [Hz] about a band that was taken out, where the spectrum tells nothing
FASTER, SLOWEST = 1.5, 50.0  # what is kept of an autoregressive stream: to so many times the corner, and [Hz]

TOLD = 30.0
"""Of -2 log L, by which one more coefficient has to lower it: of 250 healthy records none was coloured."""

GROWS = 1.15
"""Of the noise's 1 sigma at the same rate, from which on a filter matters: 3 of 210 imperfect records of
other kinds were taken for filtered; 12 with 1.08 and without `SLOW`."""

APART = 3.0
"""Between spectrum and model in a quarter of the band, from which on the model does not hold: second-order
filters reach 2.1."""

STREAMS = {
    "raw": "raw_*",
    "twist": "vx ... wz",
    "velocity": "dq_*",
    "angular_velocity": "wx wy wz",
    "specific_force": "accel_*",
}


@dataclass(frozen=True, slots=True)
class Colour:
    """What makes white noise of coloured one: every `step`-th of sum_i b_i y_(k-i)."""

    b: Array  # (p + 1,) whose sum is 1
    step: int  # samples
    growth: float  # of the noise's 1 sigma
    corner: float  # where its density had fallen to half, of the sampling rate

    @property
    def advance(self) -> float:
        """Of what is slow, samples."""
        return -float(np.arange(self.b.size) @ self.b)

    def whitened(self, values: Array) -> Array:
        """(N, M) evenly sampled; NaN where no sample is left, or one of those before is missing."""
        out = np.full_like(values, np.nan)
        p = self.b.size - 1
        if len(values) > p:
            filtered = sum(b * values[p - i : len(values) - i] for i, b in enumerate(self.b))
            out[p :: self.step] = filtered[:: self.step]
        return out


def without_filters(log: Log) -> Log:
    """The log with its streams as they would be without the filters that colour their noise; else itself."""
    changed: dict[str, Any] = {}
    whitened: dict[str, Whitened] = {}
    for name, columns in STREAMS.items():
        values = getattr(log, name)
        if values is None or (name == "twist" and log.tracking is not None):  # of joints, which made it
            continue
        time, values, rows = present(log.time, values)
        taken = log.vibrations if name == "raw" else ()
        colour = colour_of(time, values, [(x.low, x.high) for x in taken])
        if colour is None:
            continue
        out = np.full((len(log.time_ns), values.shape[1]), np.nan)
        for piece in segments(time):
            places = places_of(time[piece])
            out[rows[piece]] = colour.whitened(at_places(places, values[piece]))[places]
        period = float(np.median(np.diff(time)))
        changed[name] = out
        corner = colour.corner / period
        whitened[name] = Whitened(columns, colour.growth, colour.advance * period, corner, colour.step)
    return replace(log, **changed, whitened=whitened) if changed else log


def colour_of(time: Array, values: Array, without: Sequence[tuple[float, float]] = ()) -> Colour | None:
    """Of samples (N, M) at times (N,); None where their noise is white, or no model holds.

    `without` are bands that have been taken out [Hz].
    """
    found = _spectrum(time, values, without)
    if found is None:
        return None
    omega, power, averages, period = found
    slowest = np.exp(-np.pi * BEGIN * period)

    def cost(model: Array) -> float:
        return averages * _whittle(model, power, omega)

    def of_coefficients(x: Array) -> float:
        return cost(_density(_polynomial(x, slowest), omega))

    density = np.ones_like(omega)
    if np.abs(_levels(power, density)).max() < np.log(1.0 + 0.5 * (GROWS - 1.0)):
        return None
    lowest, colour = cost(density), None
    for start in ([1.0], [1.0, -0.3]):
        result = minimize(of_coefficients, start, method="Nelder-Mead")
        if result.fun < lowest - TOLD:
            a = _polynomial(result.x, slowest)
            lowest, colour, density = result.fun, _autoregressive(a, period), _density(a, omega)
    for length in range(2, LONGEST + 1):
        model = _without_lines(_mean_of(length, omega))
        if (now := cost(model)) < lowest - TOLD:
            lowest, colour, density = now, Colour(np.ones(1), length, 1.0, 0.443 / length), model
    if colour is None or np.abs(_levels(power, density)).max() > np.log(APART):
        return None
    matters = colour.growth * np.sqrt(colour.step) > GROWS and colour.corner > SLOW * BEGIN * period
    return colour if matters else None


def _spectrum(
    time: Array, values: Array, without: Sequence[tuple[float, float]]
) -> tuple[Array, Array, float, float] | None:
    """Angular frequencies (F,) a sample, densities (F, M) without lines, segments averaged, period [s]."""
    pieces = [piece for piece in segments(time) if piece.stop - piece.start >= FEWEST]
    if not pieces:
        return None
    period = float(np.median(np.diff(time)))
    frequency = np.fft.rfftfreq(FEWEST, period)
    use = (frequency >= BEGIN) & (frequency <= END * 0.5 / period)
    for low, high in without:
        use &= (frequency < low - TAKEN) | (frequency > high + TAKEN)
    if use.sum() < 2 * LINES:
        return None
    total: Array = np.zeros((int(use.sum()), values.shape[1]))
    count = 0
    for piece in pieces:
        part = evenly(time[piece], values[piece], MOST)
        if len(part) >= FEWEST + 2:
            twice = np.diff(part, 2, axis=0)  # else what is slow leaks into what is fast
            total += welch(twice, period, FEWEST)[use] * len(part)
            count += len(part)
    if not count:
        return None
    omega: Array = np.asarray(2.0 * np.pi * period * frequency[use], np.float64)
    power: Array = _without_lines(total / count / (2.0 - 2.0 * np.cos(omega))[:, None] ** 2)
    power = power[:, (power > 0.0).all(axis=0)]
    return (omega, power, count / FEWEST, period) if power.size else None


def _without_lines(power: Array) -> Array:
    return np.asarray(median_filter(power, (LINES, *(1,) * (power.ndim - 1)), mode="nearest"))


def _whittle(model: Array, power: Array, omega: Array) -> float:
    """-2 log L a segment, every octave with the same weight, the level of each column profiled out."""
    weight = omega.size / omega / np.sum(1.0 / omega)
    level = (weight[:, None] * power / model[:, None]).mean(axis=0)
    return float(2.0 * power.shape[1] * (weight @ np.log(model)) + 2.0 * omega.size * np.log(level).sum())


def _levels(power: Array, model: Array) -> Array:
    """Log of spectrum over model, in the quarters of the band."""
    ratio = np.log(power / model[:, None])
    ratio -= ratio.mean(axis=0)
    return np.array([np.median(part) for part in np.array_split(ratio, 4)])


def _autoregressive(a: Array, period: float) -> Colour:
    """A(z), and means of what is far faster than the corner: filters have other poles, and zeros, there."""
    grid = np.linspace(0.0, np.pi, 4097)
    density = _density(a, grid)
    fallen = density < 0.5 * density[0]
    corner = float(grid[np.argmax(fallen)]) / (2.0 * np.pi) if fallen.any() else 0.5
    step = max(2, int(0.5 / max(FASTER * corner, SLOWEST * period)))
    growth = np.sqrt(density[0] * np.pi / np.trapezoid(density, grid) / step)
    return Colour(np.convolve(a / a.sum(), np.full(step, 1.0 / step)), step, float(growth), corner)


def _mean_of(length: int, omega: Array) -> Array:
    """Density of a mean of so many samples."""
    return np.asarray((np.sin(0.5 * length * omega) / (length * np.sin(0.5 * omega))) ** 2)


def _density(a: Array, omega: Array) -> Array:
    return np.asarray(np.abs(np.exp(-1j * omega[:, None] * np.arange(a.size)) @ a) ** -2.0)


def _polynomial(x: Array, slowest: float) -> Array:
    """A(z) of reflection coefficients tanh x, its poles within a radius."""
    a = np.ones(1)
    for k in np.tanh(x):
        a = np.append(a, 0.0) - k * np.append(a, 0.0)[::-1]
    return np.asarray(a * slowest ** np.arange(a.size))
