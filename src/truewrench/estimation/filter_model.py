"""Models of a filter by the noise that passed it: autoregressive ones and means, by Whittle's likelihood.

Motions that start and stop reach into the band of the noise; what is left of them there falls to a white
floor, as no filter's noise does: P(f) = |H(f)|^2 (1 + x f^-k).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from scipy.optimize import minimize

from truewrench.estimation.evenly import NoiseSpectrum, noise_spectrum, without_lines
from truewrench.estimation.thinning import BEGINS, GROWS, LEFT, window
from truewrench.model.arrays import Array

BEGIN = 12.0  # [Hz] from which on a spectrum is noise, as motions are slower
SLOW = 0.75  # of it, below which a corner is none: hysteresis and walks have spectra like that of a slow pole
END = 0.6  # of the Nyquist frequency, beyond which digital filters have zeros
LONGEST = 64  # samples of a mean
FASTER, SLOWEST = 1.5, 50.0  # what is kept of an autoregressive stream: to so many times the corner, and [Hz]

TOLD = 30.0
"""Of -2 log L, by which one more coefficient has to lower it: of 250 healthy records none was coloured."""

APART = 3.0
"""Between spectrum and model in a quarter of the band, from which on the model does not hold: second-order
filters reach 2.1."""

FLOOR = 0.2
"""Of white noise, up to which what is left of a motion at the end of the band is its tail, and no filter."""

SHARES = np.append(0.0, np.geomspace(1e-3, 1.0, 20) * FLOOR)
POWERS = np.array([2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0])
"""By which such a tail falls: of jumps of acceleration 2, of jerk 4; velocities by 2 more."""


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


class Tails:
    """What a filter smooths: white noise and a motion's tail, 1 + x f^-k, k of all columns and x of each."""

    def __init__(self, found: NoiseSpectrum, shares: Array) -> None:
        self._found, self._shares = found, shares  # at the end of the band
        self._weight = found.hz.size / found.hz / np.sum(1.0 / found.hz)  # (F,) of every octave the same
        shapes = 1.0 + shares[:, None] * (found.hz[-1] / found.hz) ** POWERS[:, None, None]  # (K, X, F)
        self._logs = 2.0 * (np.log(shapes) @ self._weight)
        self._inverse = self._weight / self._weight.size / shapes

    def _costs(self, model: Array) -> Array:
        """-2 log L by Whittle (K, X, M), the level of each column profiled out."""
        level = (self._inverse / model) @ self._found.power
        of_model = self._logs[..., None] + 2.0 * (np.log(model) @ self._weight)
        return np.asarray(self._found.averages * (of_model + 2.0 * self._weight.size * np.log(level)))

    def cost(self, model: Array) -> float:
        """The least with a filter's density (F,)."""
        return float(self._costs(model).min(axis=1).sum(axis=1).min())

    def fitted(self, model: Array) -> tuple[Array, Callable[[Array], Array]]:
        """The levels (M,) of that, and its tails (F, M) of frequencies [Hz]."""
        costs = self._costs(model)
        k = int(costs.min(axis=1).sum(axis=1).argmin())
        chosen = costs[k].argmin(axis=0)
        level = ((self._inverse[k, chosen] / model) * self._found.power.T).sum(axis=1)
        x, end = self._shares[chosen], self._found.hz[-1]
        return level, lambda hz: 1.0 + x * (end / hz[:, None]) ** POWERS[k]


@dataclass(frozen=True, slots=True)
class FilterModel:
    """A filter by its model."""

    colour: Colour
    density: Callable[[Array], Array]  # (F, M) of frequencies [Hz] (F,): of noise, and of tails
    noise: Array  # (M,) of that, where it is slow

    def explains(self, stated: Array | None, period: float) -> bool:
        """Whether the noise is as much as is stated; else a steep filter's slope was taken for a tail."""
        if stated is None or stated.size != self.noise.size:
            return True
        return bool(np.log(self.noise / (2.0 * period * stated**2)).mean() > np.log(LEFT))

    def below(self, time: Array, values: Array, without: Sequence[tuple[float, float]]) -> float:
        """Times the model, what is found where motions hardly reach, to which no model was fitted."""
        period = float(np.median(np.diff(time)))
        found = noise_spectrum(time, values, BEGINS[-1], END, window(period), without)
        if found is None:
            return 1.0
        ratio = found.power / self.density(found.hz)
        slow = found.hz < BEGIN
        apart = np.log(np.median(ratio[slow], axis=0) / np.median(ratio[~slow], axis=0))
        return float(np.exp(apart.mean()))


def filter_model(found: NoiseSpectrum, tails: Tails, lowest: float) -> FilterModel | None:
    """By a mean, or an autoregressive model, whose corner is no slow departure's.

    `lowest` is -2 log L without a filter.
    """
    period = found.period
    omega = 2.0 * np.pi * period * found.hz
    slowest = np.exp(-np.pi * BEGIN * period)
    best: tuple[Colour, Callable[[Array], Array]] | None = None

    def of_coefficients(x: Array, zeros: int) -> float:
        return tails.cost(_density(_polynomial(x, slowest), zeros, omega))

    for start, zeros in product(([1.0], [1.0, -0.3], [2.5, -2.0]), (False, True)):
        zeros_of = len(start) * zeros
        result = minimize(of_coefficients, start, (zeros_of,), method="Nelder-Mead")
        if result.fun < lowest - TOLD:
            a = _polynomial(result.x, slowest)
            of_poles = partial(_density, a, zeros_of)
            lowest, best = result.fun, (_autoregressive(a, of_poles, period), of_poles)
    for length in range(2, LONGEST + 1):
        of_mean = partial(_mean_of, length)
        if (now := tails.cost(of_mean(omega))) < lowest - TOLD:
            lowest, best = now, (Colour(np.ones(1), length, 1.0, 0.443 / length), of_mean)
    if best is None:
        return None
    colour, of_noise = best
    level, of_tails = tails.fitted(of_noise(omega))

    def density(hz: Array) -> Array:
        return level * of_noise(2.0 * np.pi * period * hz)[:, None] * of_tails(hz)

    if np.abs(levels(found.power, density(found.hz))).max() > np.log(APART):
        return None
    matters = colour.growth * np.sqrt(colour.step) > GROWS and colour.corner > SLOW * BEGIN * period
    return FilterModel(colour, density, level * of_noise(np.array([1e-6]))) if matters else None


def _autoregressive(a: Array, of_poles: Callable[[Array], Array], period: float) -> Colour:
    """A(z), and means of what is far faster than the corner: filters have other poles, and zeros, there."""
    grid = np.linspace(0.0, np.pi, 4097)
    density = of_poles(grid)
    fallen = density < 0.5 * density[0]
    corner = float(grid[np.argmax(fallen)]) / (2.0 * np.pi) if fallen.any() else 0.5
    step = max(2, int(0.5 / max(FASTER * corner, SLOWEST * period)))
    growth = np.sqrt(density[0] * np.pi / np.trapezoid(density, grid) / step)
    return Colour(np.convolve(a / a.sum(), np.full(step, 1.0 / step)), step, float(growth), corner)


def _mean_of(length: int, omega: Array) -> Array:
    """Density of a mean of so many samples, as of a spectrum without lines."""
    return without_lines((np.sin(0.5 * length * omega) / (length * np.sin(0.5 * omega))) ** 2)


def _density(a: Array, zeros: int, omega: Array) -> Array:
    """Of (1 + 1/z)^zeros / A(z): a filter that was made from an analogue one has its zeros where z = -1."""
    poles = np.abs(np.exp(-1j * omega[:, None] * np.arange(a.size)) @ a) ** 2
    return np.asarray(np.cos(0.5 * omega) ** (2 * zeros) / poles)


def _polynomial(x: Array, slowest: float) -> Array:
    """A(z) of reflection coefficients tanh x, its poles within a radius."""
    a = np.ones(1)
    for k in np.tanh(x):
        a = np.append(a, 0.0) - k * np.append(a, 0.0)[::-1]
    return np.asarray(a * slowest ** np.arange(a.size))


def levels(power: Array, model: Array | float) -> Array:
    """Log of spectrum over model, in the quarters of the band."""
    ratio = np.log(power / model)
    ratio -= ratio.mean(axis=0)
    return np.array([np.median(part) for part in np.array_split(ratio, 4)])
