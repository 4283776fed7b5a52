"""How densely the knots lie, where the seconds that tell it are few (METHOD 10.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from record_cases import estimate, light_rig, nees

import truewrench as tw
from truewrench.model.motion.trajectory import HarmonicTwist, Trajectory

Array = NDArray[np.float64]

QUICK, BEGIN, END = 2.0 * np.pi * 8.0, 10.0, 38.0  # [rad/s], [s]


@dataclass(frozen=True)
class Shaken:
    """A slow motion that is shaken at 8 Hz for most of its time, by `size` [m/s, rad/s]."""

    slow: HarmonicTwist
    size: float

    @property
    def duration(self) -> float:
        return self.slow.duration

    def twist(self, time: Array) -> Array:
        window, _ = self._window(time)
        return self.slow.twist(time) + (self.size * window * np.sin(QUICK * time))[:, None]

    def acceleration(self, time: Array) -> Array:
        window, rate = self._window(time)
        shaken = self.size * (rate * np.sin(QUICK * time) + QUICK * window * np.cos(QUICK * time))
        return self.slow.acceleration(time) + shaken[:, None]

    @staticmethod
    def _window(time: Array) -> tuple[Array, Array]:
        angle = np.pi * np.clip((time - BEGIN) / (END - BEGIN), 0.0, 1.0)
        return np.sin(angle) ** 2, np.sin(2.0 * angle) * np.pi / (END - BEGIN)


@pytest.fixture(scope="module")
def slow() -> HarmonicTwist:
    rng = np.random.default_rng(2)
    frequency = np.tile(np.array([0.2, 0.37, 0.53, 0.71, 0.9, 1.1])[:, None], (1, 6))
    return HarmonicTwist(
        0.25 * rng.uniform(0.2, 0.7, (6, 6)), frequency, rng.uniform(0, 2 * np.pi, (6, 6)), 40
    )


def found_of(motion: Trajectory) -> tuple[Any, float]:
    """The estimate, and its NEES per gain."""
    rig = light_rig(seconds=40, rate=100, discrepancy=0)
    run = tw.simulate(rig, motion)
    found = estimate(rig, run.log)
    return found, nees(found, rig, run.truth)


def test_a_motion_that_is_shaken_gets_finer_ones(slow: HarmonicTwist) -> None:
    found, error = found_of(Shaken(slow, 0.02))
    assert found.fit.spacing(0) < 0.05
    assert error < 1.6


def test_a_smooth_motion_keeps_the_coarsest(slow: HarmonicTwist) -> None:
    found, error = found_of(slow)
    assert found.fit.spacing(0) == 0.05
    assert error < 1.6


@dataclass(frozen=True)
class Moves:
    """Rests, and moves between them: bells of minimum jerk, whose jerk is a step at both ends."""

    starts: Array  # (moves,) [s]
    lengths: Array  # (moves,) [s]
    size: Array  # (moves, 6) [m/s, rad/s]
    duration: float

    def twist(self, time: Array) -> Array:
        move, s = self._at(time)
        return np.asarray(self.size[move] * (16.0 * (s * (1.0 - s)) ** 2)[:, None])

    def acceleration(self, time: Array) -> Array:
        move, s = self._at(time)
        slope = 32.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self.lengths[move]
        return np.asarray(self.size[move] * slope[:, None])

    def _at(self, time: Array) -> tuple[Array, Array]:
        move = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        return move, np.clip((time - self.starts[move]) / self.lengths[move], 0.0, 1.0)


def stop_and_go(seed: int) -> float:
    """NEES per gain of 12 s with a sensor of 1e-4 of range."""
    rng = np.random.default_rng(seed)
    lengths, rests = rng.uniform(0.5, 2.0, 18), rng.uniform(0.2, 1.0, 18)
    starts = np.cumsum(lengths + rests) - lengths
    motion = Moves(starts, lengths, 0.3 * rng.uniform(-1.0, 1.0, (18, 6)), 12.0)
    rig = light_rig(seconds=12, rate=800, discrepancy=0, noise=[0.01] * 3 + [0.001] * 3)
    rig = rig.model_copy(update={"motion": rig.motion.model_copy(update={"noise": [2e-4] * 6})})
    run = tw.simulate(rig, motion, seed=seed)
    return nees(estimate(rig, run.log), rig, run.truth)


def test_bursts_of_jerk_are_no_contacts() -> None:
    """The knots follow them in part; masked, they leave too smooth a motion: 1.9 in the mean, 3.0 at most."""
    errors = [stop_and_go(seed) for seed in range(8)]
    assert np.mean(errors) < 1.2
    assert max(errors) < 1.7
