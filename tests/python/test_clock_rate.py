"""Clocks of two devices that run at different rates, and one that was set."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import RigOf, light_rig

import truewrench as tw
from truewrench.calibrating import from_motion
from truewrench.estimation.clock_rate import clock_rates, with_rate
from truewrench.estimation.estimator import estimate
from truewrench.model.calibration import Calibration
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig


def run_of(rig: Rig, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    frequency = np.tile([[0.2], [0.37], [0.53], [0.71], [0.9], [1.1]], (1, 6))
    size, phase = 0.25 * rng.uniform(0.2, 0.7, (6, 6)), rng.uniform(0, 2 * np.pi, (6, 6))
    return tw.simulate(rig, HarmonicTwist(size, frequency, phase, 20), seed=seed)


def rate_told(found: Calibration) -> float:
    return next((a.value for a in found.assumed if a.what.startswith("clock: rate")), 0.0)


@pytest.mark.parametrize("rate", [1e-4, -3e-4])
def test_a_rate_is_found_and_costs_nothing(rate: float) -> None:
    """Left alone, it is noise to the estimate, or a slow disturbance: sigma up to five times as large."""
    rig = light_rig(seconds=20, rate=400, discrepancy=0)
    errors, sigma, plain = [], [], []
    for seed in range(5):
        run = run_of(rig, seed)
        found = tw.calibrate(rig, with_rate(replace(run.log, clock_rate=rate), -rate), held_out=False)
        assert found.verdict.usable
        assert rate_told(found) == pytest.approx(rate, rel=0.3)
        error = (found.gain - run.truth.gain).ravel()
        errors.append(error @ np.linalg.solve(found.covariance[:36, :36], error) / 36.0)
        sigma.append(found.gain_std.mean())
        plain.append(tw.calibrate(rig, run.log, held_out=False).gain_std.mean())
    assert np.mean(errors) < 1.35
    assert np.mean(sigma) < 1.1 * np.mean(plain)


def test_clean_clocks_and_one_that_was_set_have_no_rate() -> None:
    rig = light_rig(seconds=20, rate=400, discrepancy=0)
    for seed in range(3):
        log = run_of(rig, seed).log
        assert not clock_rates(rig, [log], estimate(rig, [log])).any()
        late = with_rate(log, 1e-9)  # rows of their own
        late = replace(late, clock_rate=0.0)
        sensed = np.isfinite(late.raw).any(axis=1)
        step = np.where(sensed & (late.time > 10.0), 5_000_000, 0)
        order = np.argsort(late.time_ns + step, kind="stable")
        arrays = {name: getattr(late, name)[order] for name in ("raw", "twist")}
        stamps = (late.time_ns + step)[order]
        late = replace(late, time_ns=stamps, **arrays)
        assert not clock_rates(rig, [late], estimate(rig, [late])).any()


def test_a_rate_that_makes_the_record_less_likely_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of a fast tumbling under a precise sensor look like one."""
    rig = light_rig(seconds=20, rate=400, discrepancy=0)
    log = run_of(rig, 0).log
    plain = tw.calibrate(rig, log, held_out=False)
    monkeypatch.setattr(from_motion, "clock_rates", lambda *_: np.array([3e-4]))
    found = tw.calibrate(rig, log, held_out=False)
    assert rate_told(found) == 0.0
    assert np.array_equal(found.gain, plain.gain)


def test_only_the_sensor_moves() -> None:
    rig = light_rig(seconds=8, rate=100)
    log = run_of(rig, 0).log
    moved = with_rate(log, 1e-4)
    assert log.twist is not None
    assert moved.twist is not None
    rows = np.isin(moved.time_ns, log.time_ns)
    assert np.array_equal(moved.twist[rows], log.twist)
    sensed = np.isfinite(moved.raw).all(axis=1)
    assert np.array_equal(moved.raw[sensed], log.raw)
    expected = log.time - 1e-4 * (log.time - log.time.mean())
    start = 1e-9 * (moved.time_ns[0] - log.time_ns[0])
    assert moved.time[sensed] + start == pytest.approx(expected, abs=2e-9)


def test_arms(arm_rig: RigOf) -> None:
    """Their kinematics, told at rows of their own, stay with the joints."""
    rig = arm_rig("panda_ground", plan={"duration": 20}, simulate={"rate": 200, "sensor_rate": 200})
    run = tw.simulate_arm(rig)
    skewed: Log = replace(with_rate(run.log, -2e-4), clock_rate=0.0)
    found, clean = (tw.calibrate(rig, log, held_out=False) for log in (skewed, run.log))
    assert rate_told(found) == pytest.approx(2e-4, rel=0.3)
    assert np.abs(found.gain - clean.gain).max() < np.abs(clean.gain).max() * 0.02
    assert found.gain_std.mean() < 1.2 * clean.gain_std.mean()


def test_a_stretch_of_one_sample_tells_no_rate() -> None:
    rig = light_rig(seconds=20, rate=100, discrepancy=0)
    log = run_of(rig, 0).log
    found = estimate(rig, [log])
    stretch = found.rows[0].stretch.copy()
    stretch[-1] += 1
    alone = replace(found, rows=(replace(found.rows[0], stretch=stretch),))
    assert not clock_rates(rig, [log], alone).any()
