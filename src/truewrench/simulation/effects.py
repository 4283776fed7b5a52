"""What imperfect hardware does to a signal, each effect by itself; rows are evenly spaced samples.

The definitions are those of docs/imperfections.md. Nothing here knows of rigs, logs or estimators.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from truewrench.model.arrays import Array, Integers

Rng = np.random.Generator

_DAHL_REACH = 0.03  # of range: load over which friction comes within 1/e of its limit
_CROSS = 0.3  # 1 sigma of the products of a nonlinearity, the square of a channel's own axis being 1
_CURVED = 0.5  # part of a cable's force that is not linear in the pose
_TURNS = 2.0  # 1 sigma of the phase that a cable's periodic part runs through, per sigma of the pose [rad]
_STILL = 1e-6  # of the pose that moves most: a component below it does not move
_SETTLED = 10.0  # delays of a filter after which its past is forgotten


def play(load: Array, size: float) -> Array:
    """The play operator on each column of a load (F, n): the reading stays until the load is `size` away."""
    out = np.empty_like(load)
    for channel, column in enumerate(load.T.tolist()):
        reading = column[0]
        for row, value in enumerate(column):
            reading = min(max(reading, value - size), value + size)
            out[row, channel] = reading
    return out


def dahl(load: Array, size: float) -> Array:
    """Dahl's friction (F, n) of each column of a load (F, n), 0 at first: it comes on top of the load.

    ``dz/dx = (size - sign(dx) z) / reach``, solved exactly for each step of the load.
    """
    step = np.diff(load, axis=0)
    kept, limit = np.exp(-np.abs(step) / _DAHL_REACH), size * np.sign(step)
    friction = np.zeros_like(load)
    for row in range(len(step)):
        friction[row + 1] = limit[row] + (friction[row] - limit[row]) * kept[row]
    return friction


def nonlinearity(own_axis: Integers, rng: Rng) -> Array:
    """Coefficients (n, 21) of the products w_j w_l, j <= l, in n channels: 1 for the square of the own axis.

    That is the wrench axis that each channel feels most (n,); the others are drawn.
    """
    j, k = np.triu_indices(6)
    coefficients = _CROSS * rng.standard_normal((own_axis.size, j.size))
    coefficients[:, j != k] *= np.sqrt(2.0)  # w_j w_l and w_l w_j are one product
    coefficients[own_axis[:, None] == np.where(j == k, j, -1)] = 1.0
    return coefficients


def products(wrench: Array) -> Array:
    """(F, 21) w_j w_l, j <= l, of wrenches (F, 6)."""
    j, k = np.triu_indices(6)
    return np.asarray(wrench[:, j] * wrench[:, k])


@dataclass(frozen=True, slots=True)
class PoseForce:
    """A force that follows the pose, every axis of mean 0 and RMS 1 over the record."""

    force: Array  # (F, 6)
    # (6, d) of it, per standard deviation of each component of the pose; 0 where it does not move
    linear: Array
    spread: Array  # (d,) standard deviation of these components [m, rad]


def pose_force(pose: Array, rng: Rng) -> PoseForce | None:
    """What a cable does along a path of poses (F, d); None where nothing moves."""
    spread = pose.std(axis=0)
    moving = spread > _STILL * spread.max()
    if not moving.any():
        return None
    x = (pose - pose.mean(axis=0))[:, moving] / spread[moving]
    d = x.shape[1]
    slope = rng.standard_normal((d, 6))
    turns, phase = rng.normal(0.0, _TURNS, (d, 6)), rng.uniform(0.0, 2.0 * np.pi, 6)
    curvature = rng.standard_normal((d, 6, d))
    linear = x @ slope
    periodic = _unit(np.sin(x @ turns + phase))
    quadratic = _unit(np.stack([np.sum((x @ curvature[:, axis]) * x, axis=1) for axis in range(6)], axis=1))
    force = linear / linear.std(axis=0) + _CURVED * _unit(periodic + quadratic)
    all_slopes = np.zeros((6, pose.shape[1]))
    all_slopes[:, moving] = (slope / (linear.std(axis=0) * force.std(axis=0))).T
    return PoseForce(_unit(force), all_slopes, spread)


def wandering(time: Array, hz: float, rng: Rng) -> Array:
    """Vibration (F, 6): sines of one frequency and mean amplitude 1, which wanders by half."""
    slow, phases = rng.uniform(0.1, 0.5, 6), rng.uniform(0.0, 2.0 * np.pi, (2, 6))
    amplitude = 1.0 + 0.5 * np.sin(2.0 * np.pi * slow * time[:, None] + phases[0])
    return np.asarray(amplitude * np.sin(2.0 * np.pi * hz * time[:, None] + phases[1]))


def half_sine(time: Array, start: float, duration: float) -> Array:
    """(F,) of peak 1 within [start, start + duration], 0 outside."""
    inside = (time >= start) & (time < start + duration)
    return np.asarray(np.where(inside, np.sin(np.pi * (time - start) / duration), 0.0))


@dataclass(frozen=True, slots=True)
class LowPass:
    """A low-pass filter in continuous time, -3 dB at `hz`: of first order, or Butterworth's of second."""

    hz: float
    order: int

    @property
    def delay(self) -> float:
        """How late a slow signal comes out [s]."""
        return float((1.0 if self.order == 1 else np.sqrt(2.0)) / (2.0 * np.pi * self.hz))

    def of_motion(self, signal: Array, rate: float) -> Array:
        """A smooth signal (F, d) filtered, linear between samples, as if it had come along its tangent."""
        slope = (signal[1] - signal[0]) * rate
        line = signal[0] + slope * np.arange(len(signal))[:, None] / rate
        return np.asarray(line - self.delay * slope + self._run(signal - line, rate, "foh"))

    def of_rough(self, signal: Array, rate: float) -> Array:
        """Any signal (F, d) filtered, linear between samples, as if it had always had its first value."""
        return np.asarray(signal[0] + self._run(signal - signal[0], rate, "foh"))

    def of_noise(self, noise: Array, rate: float, rng: Rng) -> Array:
        """White noise (M, n) filtered, each value held for a sample, the filter having run for long."""
        sigma = noise.std(axis=0) if len(noise) > 1 else np.zeros(noise.shape[1])
        earlier = sigma * rng.standard_normal((int(np.ceil(_SETTLED * self.delay * rate)), noise.shape[1]))
        return self._run(np.concatenate([earlier, noise]), rate, "zoh")[len(earlier) :]

    def _run(self, signal: Array, rate: float, between: Literal["foh", "zoh"]) -> Array:
        corner = 2.0 * np.pi * self.hz
        numerator = np.array([corner**self.order])
        denominator = np.array([1.0, np.sqrt(2.0) * corner, corner**2] if self.order == 2 else [1.0, corner])
        from scipy.signal import cont2discrete, lfilter  # brings scipy.stats: half a second

        b, a, _ = cont2discrete((numerator, denominator), 1.0 / rate, method=between)
        return np.asarray(lfilter(b.ravel(), a, signal, axis=0))


def _unit(values: Array) -> Array:
    """Columns of mean 0 and standard deviation 1."""
    return np.asarray((values - values.mean(axis=0)) / values.std(axis=0))
