"""Motions and payloads drawn for the campaigns: analytic twists of any length, with the knots they need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded

from truewrench.model.motion.trajectory import (
    Body,
    HarmonicTwist,
    Trajectory,
    WrenchSinusoids,
    integrate_wrench,
)
from truewrench.simulation.free_body import wrench_on_sensor

Array = NDArray[np.float64]

KINDS = ("sinusoids", "fourier", "slow", "tumbling", "wrench", "stop and go")
DEGREE = 4  # of the acceleration of a quintic twist
MOST_SAMPLES = 30_000
LONGEST_WRENCH = 20.0  # [s]: driven open loop, a body spins up


@dataclass(frozen=True)
class Moves:
    """From rest to rest and on: moves of all six axes, each followed by a rest.

    The twist of a move is a bell ``(4 s (1-s))^power``: minimum jerk with a power of 2, whose jerk is a step
    at both ends; 3 makes the jerk continuous.
    """

    starts: Array  # (M,)
    lengths: Array  # (M,)
    amplitude: Array  # (M, 6) largest twist of each move
    duration: float
    power: int

    def twist(self, time: Array) -> Array:
        """Twist (N, 6) at the times (N,) [s]."""
        s, amplitude, _ = self._at(time)
        return np.asarray(amplitude * ((4.0 * s * (1.0 - s)) ** self.power)[:, None])

    def acceleration(self, time: Array) -> Array:
        """Its derivative (N, 6)."""
        s, amplitude, length = self._at(time)
        slope = 4.0 * (1.0 - 2.0 * s) * self.power * (4.0 * s * (1.0 - s)) ** (self.power - 1)
        return np.asarray(amplitude * (slope / length)[:, None])

    def _at(self, time: Array) -> tuple[Array, Array, Array]:
        k = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        s = np.clip((time - self.starts[k]) / self.lengths[k], 0.0, 1.0)
        return s, self.amplitude[k], self.lengths[k]


def draw_motion(
    kind: str, rng: np.random.Generator, duration: float, speed: float, body: Body
) -> tuple[Trajectory, float]:
    """A motion of about this speed [m/s, rad/s], and the knot spacing that represents it [s]."""
    if kind == "stop and go":
        count = int(duration / 0.7) + 1
        lengths, rests = rng.uniform(0.5, 2.0, count), rng.uniform(0.2, 1.0, count)
        starts = np.cumsum(lengths + rests) - lengths
        amplitude = 1.5 * speed * rng.uniform(-1.0, 1.0, (count, 6))
        return Moves(starts, lengths, amplitude, duration, int(rng.integers(2, 4))), 0.08
    if kind == "wrench":
        # amplitudes that reach the speed: v = f / (2 pi k / tau m)
        k, tau = rng.choice(np.arange(3, 12), 3, replace=False), min(duration, 10.0)
        rate = 2.0 * np.pi * k / tau
        force = body.mass * speed * rate
        moment = np.diag(body.inertia).mean() * speed * rate
        driven = integrate_wrench(WrenchSinusoids.of(force, moment, k, tau), body, duration)
        return driven, 0.2 / highest_frequency(driven)
    if kind == "fourier":
        base, count = np.exp(rng.uniform(np.log(0.05), np.log(0.25))), 6
        frequency = np.repeat(base * np.arange(1, count + 1)[:, None], 6, axis=1)
        amplitude = speed * rng.standard_normal((count, 6)) / np.sqrt(count / 2)
        phase = rng.uniform(0.0, 2.0 * np.pi, (count, 6))
        return HarmonicTwist(amplitude, frequency, phase, duration), 0.2 / frequency.max()
    low, high = (0.02, 0.1) if kind == "slow" else (0.2, 1.2)
    middle = np.exp(rng.uniform(np.log(low), np.log(high)))
    frequency = middle * rng.permutation(np.array([0.5, 0.65, 0.85, 1.0, 1.2, 1.45]))[None]
    amplitude = speed * rng.uniform(0.5, 1.5, (1, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (1, 6))
    if kind == "tumbling":  # a steady spin beside
        spin = np.zeros((1, 6))
        spin[0, 3:] = rng.standard_normal(3)
        spin *= rng.uniform(1.0, 5.0) / np.linalg.norm(spin)
        amplitude = np.concatenate([amplitude, spin])
        frequency = np.concatenate([frequency, np.zeros((1, 6))])
        phase = np.concatenate([phase, np.full((1, 6), np.pi / 2.0)])
    return HarmonicTwist(amplitude, frequency, phase, duration), 0.2 / frequency.max()


def highest_frequency(motion: Trajectory) -> float:
    """That below which all but a millionth of the power of every component of the twist lies [Hz].

    A light body that moments drive turns many times: its velocities are faster than what drives them.
    """
    time = np.linspace(0.0, motion.duration, int(1000 * motion.duration))
    twist = motion.twist(time)
    power = np.cumsum(np.abs(np.fft.rfft(twist * np.hanning(len(time))[:, None], axis=0)) ** 2, axis=0)
    last = [int(np.searchsorted(p, (1.0 - 1e-6) * p[-1])) for p in power.T]
    return max(last) / motion.duration


def unresolved(body: Body, motion: Trajectory, rate: float, noise: Array) -> float:
    """Mean square over the noise (6,) of what no spline of three samples a coefficient can follow.

    Of the wrench at the sensor's samples, in the worst second of the first minute or 30,000 samples.
    """
    time = np.arange(int(min(motion.duration * rate, 60.0 * rate, MOST_SAMPLES))) / rate
    intervals = max(1, len(time) // 3)
    knots = (time[-1] + 1e-9) / intervals * np.arange(-DEGREE, intervals + DEGREE + 1)
    true = motion.acceleration(time)
    D = BSpline.design_matrix(time, knots, DEGREE).tocsr()
    normal = (D.T @ D).todia()
    band = np.array([np.append(normal.diagonal(-k), np.zeros(k)) for k in range(DEGREE + 1)])
    band[0] += 1e-12 * band[0].max()
    error = D @ solveh_banded(band, D.T @ true, lower=True) - true
    still = np.zeros((len(time), 6))
    wrench = wrench_on_sensor(body, body.center_of_mass, still, error, still[:, :3]) / noise
    squared = np.mean(wrench**2, axis=1)
    second = np.arange(0, len(time), min(len(time), int(rate)))
    return float(np.max(np.add.reduceat(squared, second) / np.diff(np.append(second, len(time)))))


def draw_body(rng: np.random.Generator, mass: float) -> Body:
    """A payload of this mass, of about the size that its mass makes likely."""
    size = 0.2 * (mass / 50.0) ** (1.0 / 3.0)  # [m]
    center = size * rng.uniform(0.2, 1.0) * _direction(rng)
    # second moments of a box about its centre, turned
    second = mass * (size * rng.uniform(0.4, 1.2, 3)) ** 2 / 3.0
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    inertia = turn @ np.diag(second.sum() - second) @ turn.T
    return Body(mass, center, 0.5 * (inertia + inertia.T))


def _direction(rng: np.random.Generator) -> Array:
    x = rng.standard_normal(3)
    return np.asarray(x / np.linalg.norm(x))
