"""Noise that a filter has coloured, made white again before anything is estimated.

Sensors and drivers filter what they log, noise and all. Taken for white, such noise seems smaller than it is
at the frequencies of a motion, and its slow part seems to be a motion or a disturbance. Where no motion is,
its spectrum tells the filter, by Whittle's likelihood: a mean of so many samples, one of which tells all that
they do; or an autoregressive model A(z), whose inverse A(z) / A(1) leaves white noise of the same density and
undoes the delay (docs/method.md, M12a). Where no model holds, so many samples are one (thinning.py).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

from truewrench.estimation.evenly import (
    NoiseSpectrum,
    at_places,
    hann,
    noise_spectrum,
    places_of,
    present,
    without_lines,
)
from truewrench.estimation.thinning import BEGINS, GROWS, Thinning, thinning_of, window
from truewrench.model.arrays import Array
from truewrench.model.log import Log, Whitened
from truewrench.model.motion.smooth import segments
from truewrench.model.rig import Rig

BEGIN = 12.0  # [Hz] from which on a spectrum is noise, as motions are slower
SLOW = 0.75  # of it, below which a corner is none: hysteresis and walks have spectra like that of a slow pole
END = 0.6  # of the Nyquist frequency, beyond which digital filters have zeros
FEWEST = 512  # samples of a stretch, and of a spectrum
LONGEST = 64  # samples of a mean
FASTER, SLOWEST = 1.5, 50.0  # what is kept of an autoregressive stream: to so many times the corner, and [Hz]

TOLD = 30.0
"""Of -2 log L, by which one more coefficient has to lower it: of 250 healthy records none was coloured."""

APART = 3.0
"""Between spectrum and model in a quarter of the band, from which on the model does not hold: second-order
filters reach 2.1."""

HOLDS = 1.5  # times a model below `BEGIN`, from which on it is thinned, where that makes it white: tolerance

STREAMS = {
    "raw": "raw_*",
    "twist": "vx ... wz",
    "position": "q_*",
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


def without_filters(rig: Rig, log: Log) -> Log:
    """The log with its streams as they would be without the filters that colour their noise; else itself."""
    changed: dict[str, Any] = {}
    whitened: dict[str, Whitened] = {}
    for name, columns in STREAMS.items():
        values = getattr(log, name)
        if values is None or (name == "twist" and log.tracking is not None):  # of joints, which made it
            continue
        time, values, rows = present(log.time, values)
        taken = log.vibrations if name == "raw" else ()
        find = thinned_of if name == "position" else colour_of
        colour = find(time, values, _stated(rig, name), [(x.low, x.high) for x in taken])
        if colour is None:
            continue
        out = np.full((len(log.time_ns), values.shape[1]), np.nan)
        for piece in segments(time):
            places = places_of(time[piece])
            out[rows[piece]] = colour.whitened(at_places(places, values[piece]))[places]
        period = float(np.median(np.diff(time)))
        changed[name] = out
        corner = colour.corner / period
        whitened[name] = Whitened(
            columns, colour.growth, colour.advance * period, corner, colour.step, period
        )
    return replace(log, **changed, whitened=whitened) if changed else log


def _stated(rig: Rig, stream: str) -> Array | None:
    """1 sigma (M,) of its noise; None where the rig does not say."""
    if stream == "raw":
        return rig.sensor.noise_array
    motion = rig.motion
    other = {"position": motion.position_noise, "specific_force": motion.acceleration_noise}
    told = other.get(stream, motion.noise)
    return None if told is None else np.array(told)


def colour_of(
    time: Array, values: Array, stated: Array | None = None, without: Sequence[tuple[float, float]] = ()
) -> Colour | None:
    """Of samples (N, M) at times (N,); None where their noise is white, or no model holds.

    `stated` (M,) is 1 sigma of that noise, None where it is not known; `without` are bands that have been
    taken out [Hz].
    """
    found = noise_spectrum(time, values, BEGIN, END, hann(FEWEST), without)
    if found is None or np.abs(_levels(found.power, 1.0)).max() < np.log(1.0 + 0.5 * (GROWS - 1.0)):
        return None
    modelled, thinned = _modelled(found), thinning_of(time, values, stated, without)
    if thinned is None or (modelled is not None and modelled.holds(time, values, without)):
        return None if modelled is None else modelled.colour
    return _one_of(thinned)


def thinned_of(
    time: Array, values: Array, stated: Array | None, without: Sequence[tuple[float, float]]
) -> Colour | None:
    """As `colour_of` of what a motion is 100,000 times as large as: models take its slope for a filter's."""
    thinned = thinning_of(time, values, stated, without)
    return None if thinned is None else _one_of(thinned)


def _one_of(thinned: Thinning) -> Colour:
    return Colour(np.ones(1), thinned.step, 1.0, thinned.corner)


@dataclass(frozen=True, slots=True)
class _Modelled:
    """A filter by its model."""

    colour: Colour
    density: Callable[[Array], Array]  # of angular frequencies a sample

    def holds(self, time: Array, values: Array, without: Sequence[tuple[float, float]]) -> bool:
        """Whether it does where motions hardly reach, too: the slope of a steep filter is no corner."""
        period = float(np.median(np.diff(time)))
        found = noise_spectrum(time, values, BEGINS[-1], END, window(period), without)
        if found is None:
            return True
        ratio = found.power / self.density(2.0 * np.pi * period * found.hz)[:, None]
        slow = found.hz < BEGIN
        return bool(
            np.log(np.median(ratio[slow], axis=0) / np.median(ratio[~slow], axis=0)).mean() < np.log(HOLDS)
        )


def _modelled(found: NoiseSpectrum) -> _Modelled | None:
    """By a mean, or an autoregressive model, whose corner is no slow departure's."""
    power, period = found.power, found.period
    omega = 2.0 * np.pi * period * found.hz
    slowest = np.exp(-np.pi * BEGIN * period)

    def cost(model: Array) -> float:
        return found.averages * _whittle(model, power, omega)

    def of_coefficients(x: Array) -> float:
        return cost(_density(_polynomial(x, slowest), omega))

    lowest, best = cost(np.ones_like(omega)), None
    for start in ([1.0], [1.0, -0.3]):
        result = minimize(of_coefficients, start, method="Nelder-Mead")
        if result.fun < lowest - TOLD:
            a = _polynomial(result.x, slowest)
            lowest, best = result.fun, _Modelled(_autoregressive(a, period), partial(_density, a))
    for length in range(2, LONGEST + 1):
        of_mean = partial(_mean_of, length)
        if (now := cost(of_mean(omega))) < lowest - TOLD:
            lowest, best = now, _Modelled(Colour(np.ones(1), length, 1.0, 0.443 / length), of_mean)
    if best is None or np.abs(_levels(power, best.density(omega)[:, None])).max() > np.log(APART):
        return None
    colour = best.colour
    matters = colour.growth * np.sqrt(colour.step) > GROWS and colour.corner > SLOW * BEGIN * period
    return best if matters else None


def _whittle(model: Array, power: Array, omega: Array) -> float:
    """-2 log L a segment, every octave with the same weight, the level of each column profiled out."""
    weight = omega.size / omega / np.sum(1.0 / omega)
    level = (weight[:, None] * power / model[:, None]).mean(axis=0)
    return float(2.0 * power.shape[1] * (weight @ np.log(model)) + 2.0 * omega.size * np.log(level).sum())


def _levels(power: Array, model: Array | float) -> Array:
    """Log of spectrum over model, in the quarters of the band."""
    ratio = np.log(power / model)
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
    """Density of a mean of so many samples, as of a spectrum without lines."""
    return without_lines((np.sin(0.5 * length * omega) / (length * np.sin(0.5 * omega))) ** 2)


def _density(a: Array, omega: Array) -> Array:
    return np.asarray(np.abs(np.exp(-1j * omega[:, None] * np.arange(a.size)) @ a) ** -2.0)


def _polynomial(x: Array, slowest: float) -> Array:
    """A(z) of reflection coefficients tanh x, its poles within a radius."""
    a = np.ones(1)
    for k in np.tanh(x):
        a = np.append(a, 0.0) - k * np.append(a, 0.0)[::-1]
    return np.asarray(a * slowest ** np.arange(a.size))
