"""Motion that a spline follows, and motion that none does, to `map` and `online`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from window_cases import FITTED, METHODS, Array, Method, error, honest, nees, rig_of

from truewrench import _core
from truewrench.estimate.attempts import Attempts
from truewrench.estimate.windows import estimate_windows
from truewrench.motion.trajectory import HarmonicTwist
from truewrench.rig import Rig
from truewrench.simulation.free_body import default_trajectory, simulate


@dataclass(frozen=True)
class RandomWalk:
    """A twist whose jerk is white noise, known at 100 Hz only."""

    values: Array
    slopes: Array
    duration: float

    @classmethod
    def draw(cls, seed: int, density: float = 3.0, dt: float = 0.01, count: int = 400) -> RandomWalk:
        rng = np.random.default_rng(seed)
        q = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        steps = rng.standard_normal((count, 6, 2)) @ np.linalg.cholesky(q).T
        slopes = 0.5 * rng.standard_normal(6) + np.cumsum(steps[:, :, 1], axis=0)
        values = np.cumsum(dt * slopes + steps[:, :, 0], axis=0)
        return cls(values, slopes, count * dt)

    def twist(self, time: Array) -> Array:
        return self.values[np.rint(time * 100).astype(int)]

    def acceleration(self, time: Array) -> Array:
        return self.slopes[np.rint(time * 100).astype(int)]


def with_ripple(rig: Rig, frequency: float, amplitude: float, seed: int) -> HarmonicTwist:
    base = default_trajectory(rig)
    one = np.ones((1, 6))
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, (1, 6))
    return HarmonicTwist(
        np.concatenate([base.amplitude, amplitude * one]),
        np.concatenate([base.frequency, frequency * one]),
        np.concatenate([base.phase, phase]),
        base.duration,
    )


@METHODS
def test_ripple_that_the_samples_resolve_is_absorbed(method: Method) -> None:
    rig = rig_of()
    scores = []
    for seed in range(6):
        run = simulate(rig, with_ripple(rig, 8.0, 0.005, seed), seed=seed)
        estimate = Attempts([run.log], method, _core.EstimatorSettings()).best(rig)
        assert all(w.status == FITTED for w in estimate.windows)
        scores.append(nees(rig, estimate, [run]))
    assert honest(scores, 42)


@METHODS
def test_ripple_too_fast_for_the_samples_is_rejected(method: Method) -> None:
    rig = rig_of()
    run = simulate(rig, with_ripple(rig, 20.0, 0.002, 0), seed=0)
    estimate = estimate_windows(rig, [run.log], method)
    assert all(w.status == _core.WindowStatus.misfit for w in estimate.windows)
    # Nothing was learned from it: the prior stands.
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.normalised_covariance)[:36]), 0.2)


@METHODS
def test_random_walk_of_the_acceleration_is_rejected(method: Method) -> None:
    rig = rig_of()
    run = simulate(rig, RandomWalk.draw(1), seed=1)
    estimate = estimate_windows(rig, [run.log], method)
    assert not any(w.status == FITTED for w in estimate.windows)


def test_a_disturbance_costs_only_its_samples() -> None:
    rig = rig_of(plan={"duration": 10})
    run = simulate(rig, seed=11)
    raw = run.log.raw.copy()
    raw[500:520, 2] += 60.0  # a contact
    estimate = estimate_windows(rig, [replace(run.log, raw=raw)])
    assert all(w.status == FITTED for w in estimate.windows)
    left_out = estimate.left_out[0]
    assert left_out[500:520].all()
    assert left_out.sum() <= 22  # its ends are found to a sample
    assert estimate.motion_left_out[0] == 0
    # where nothing was left out, the wrench is known
    np.testing.assert_array_equal(np.isnan(estimate.wrench[0]).any(axis=1), left_out)
    assert nees(rig, estimate, [run]) < 2.0


def test_slow_motion_gets_long_windows() -> None:
    """Twist of 0.03 to 0.09 Hz at 20 Hz: windows of a second would be wrong and sure of it."""
    rig = rig_of(simulate={"rate": 20, "sensor_rate": 20}, sensor={"offset_prior": 0})
    base = default_trajectory(rig)
    slow = HarmonicTwist(0.2 * base.amplitude, 0.1 * base.frequency, base.phase, 120.0)
    quiet = rig.to_mapping()
    quiet["simulate"]["offset"] = "none"
    scores = []
    for seed in range(6):
        run = simulate(Rig.from_mapping(quiet), slow, seed=seed)
        estimate = estimate_windows(rig, [run.log], "online")
        assert np.median([w.end - w.begin for w in estimate.windows]) >= 4.0
        d = error(rig, estimate, [run])[:36]
        scores.append(float(d @ np.linalg.solve(estimate.normalised_covariance[:36, :36], d) / 36))
    assert honest(scores, 36)
