"""Vibration is taken out of the channels: nothing slow changes, and nothing that a motion is made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import RigOf, arm_with, light_rig

import truewrench as tw
from truewrench.estimation.lines import WINDOW, without_lines
from truewrench.model.log import Log
from truewrench.motion.trajectory import HarmonicTwist
from truewrench.motion.trajectory_joint import SplineJoints
from truewrench.simulation.arm.run import ArmRun
from truewrench.simulation.free_body import SimulatedRun

Array = np.ndarray[Any, np.dtype[np.float64]]

RATE = 250.0  # [Hz]
RIG = light_rig(seconds=15, rate=RATE, discrepancy=0)
SLOW = np.tile([[0.2], [0.37], [0.53], [0.71], [0.9], [1.1]], (1, 6))  # [Hz]


def simulated(
    seed: int, ripple: float = 0.0, hz: float = 20.0, rate: float = RATE, **imperfect: Any
) -> SimulatedRun:
    """A run of 15 s, its twist with so much ripple [m/s, rad/s]."""
    rng = np.random.default_rng(seed)
    size = 0.25 * rng.uniform(0.2, 0.7, (6, 6))
    motion = HarmonicTwist(
        np.vstack([size, np.full((1, 6), ripple)]),
        np.vstack([SLOW, np.full((1, 6), 20.0)]),
        rng.uniform(0, 2 * np.pi, (7, 6)),
        15.0,
    )
    return tw.simulate(RIG, motion, seed=seed)


def shaken(log: Log, hz: float, size: float) -> Log:
    """The log with a force of one frequency on every channel, whose amplitude wanders [raw units]."""
    t = log.time[:, None]
    wave = (1.0 + 0.5 * np.sin(1.5 * t)) * np.sin(2.0 * np.pi * hz * t + np.arange(6.0))
    return replace(log, raw=log.raw + size * wave * np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]))


def nees(found: tw.Calibration, run: SimulatedRun | ArmRun) -> float:
    error = (found.gain - run.truth.gain).ravel()
    return float(error @ np.linalg.solve(found.covariance[:36, :36], error)) / 36.0


def test_a_log_without_lines_is_left_as_it_is() -> None:
    for seed in range(12):
        log = simulated(seed).log
        assert without_lines(RIG, log) is log


@pytest.mark.parametrize("hz", [12.0, 27.0, 40.0, 60.0])
def test_a_line_is_found_and_what_is_slow_is_left_as_it_was(hz: float) -> None:
    log = simulated(int(hz)).log
    left = without_lines(RIG, shaken(log, hz, 0.5))
    (line,) = left.lines
    assert line.hz == pytest.approx(hz, abs=0.1)
    assert line.size[0] == pytest.approx(0.5 * np.sqrt(1.125), rel=0.15)
    assert not line.shown
    assert left.twist is log.twist
    rows = np.isfinite(left.raw[:, 0])
    assert np.sum(~rows) == pytest.approx(WINDOW * RATE, abs=2)  # half a window at either end
    departure = left.raw[rows, 0] - log.raw[rows, 0]
    noise = np.std(np.diff(log.raw[:, 0], 2)) / np.sqrt(6.0)
    assert np.std(departure) < 0.3 * noise  # the noise of the band that went with the line
    smooth = np.convolve(departure, np.hanning(125) / 62.0, "valid")
    assert np.abs(smooth).max() < 0.02 * noise


def test_a_step_that_is_told_is_not_smeared_and_an_outlier_neither() -> None:
    log = shaken(simulated(1).log, 23.0, 0.5)
    raw = log.raw.copy()
    raw[2000:] += 5.0
    outliers = [700, 1500, 3000]
    raw[outliers, 2] += 20.0
    told = replace(log, raw=raw, offset_jumps_ns=(int(log.time_ns[2000]),))
    departure = without_lines(RIG, told).raw - without_lines(RIG, log).raw - (raw - log.raw)
    departure[outliers] = 0.0
    assert np.nanmax(np.abs(departure)) < 0.05  # half of the noise


def test_a_motion_that_is_made_of_lines_keeps_them() -> None:
    """A shaker's: what it teaches is in them."""
    rng = np.random.default_rng(5)
    motion = HarmonicTwist(
        np.full((1, 6), 0.02), np.full((1, 6), 12.5), rng.uniform(0, 2 * np.pi, (1, 6)), 15.0
    )
    log = tw.simulate(RIG, motion, seed=5).log
    left = without_lines(RIG, shaken(log, 30.0, 0.5))
    assert left.twist is log.twist
    assert [round(line.hz) for line in left.lines] == [30]


def test_ripple_that_the_motion_shows_leaves_both() -> None:
    run = simulated(3, ripple=0.002)
    left = without_lines(RIG, run.log)
    (line,) = left.lines
    assert line.hz == pytest.approx(20.0, abs=0.1)
    assert line.shown
    plain = simulated(3).log
    assert left.twist is not None
    assert plain.twist is not None
    assert run.log.twist is not None
    rows = np.isfinite(left.twist[:, 0])
    assert np.std(left.twist[rows] - plain.twist[rows]) < 0.3 * np.std(run.log.twist - plain.twist)


@pytest.mark.parametrize("estimator", ["map", "online"])
@pytest.mark.parametrize("kind", ["force", "ripple"])
def test_vibration_costs_no_accuracy_and_is_named(estimator: Any, kind: str) -> None:
    """Taken for noise it made sigma two to ten times as large, and ripple of 20 Hz could be ten sigma off."""
    ratios, errors = [], []
    for seed in range(8):
        run = simulated(seed, ripple=0.002 if kind == "ripple" else 0.0)
        log = shaken(run.log, 17.0, 0.5) if kind == "force" else run.log
        found = tw.calibrate(RIG, log, estimator, held_out=False)
        assert found.verdict.usable, found.verdict.reasons
        said = [x.evidence for x in found.assumed if x.what.startswith("vibration: mean amplitude")]
        assert len(said) == 1
        assert ("shows too" if kind == "ripple" else "does not show") in said[0]
        plain = tw.calibrate(RIG, simulated(seed).log, held_out=False)
        ratios.append(np.median(found.gain_std / plain.gain_std))
        errors.append(nees(found, run))
    assert np.median(ratios) < 1.1
    assert np.mean(errors) == pytest.approx(1.0, abs=0.2)


def test_ripple_of_servos_costs_no_honesty(arm_rig: RigOf) -> None:
    """Followed by finer knots it left NEES/36 of up to 33, and took ten times as long."""
    rig = arm_with(arm_rig, "panda_ground")
    errors = []
    for seed in range(4):
        plain = tw.simulate_arm(rig, seed=seed)
        t = np.arange(0.0, plain.trajectory.duration, 2e-3)
        wave = np.sin(2.0 * np.pi * (13.0 + 5.0 * seed) * t[:, None] + np.arange(7.0))
        rest = np.clip(np.minimum(t, t[-1] - t), 0.0, 1.0)[:, None]
        joints = SplineJoints.through(t, plain.trajectory.position(t) + 1e-4 * rest * wave)
        run = tw.simulate_arm(rig, joints, seed=seed)
        left = without_lines(rig, run.log)
        assert [(line.hz, line.shown) for line in left.lines] == [
            (pytest.approx(13.0 + 5.0 * seed, abs=0.2), True)
        ]
        assert left.tracking is not None
        assert left.tracking is not run.log.tracking
        assert left.notes == run.log.notes
        found = tw.calibrate(rig, run.log, held_out=False)
        assert all("accuracy" in reason for reason in found.verdict.reasons)
        errors.append(nees(found, run))
    assert np.mean(errors) < 1.5


def test_a_base_that_shakes_is_without_it_too(arm_rig: RigOf) -> None:
    rig = arm_with(arm_rig, "panda_ground")
    log = tw.simulate_arm(rig, seed=1).log
    t = log.time[:, None]
    slow = 0.2 * np.sin(2.0 * t + np.arange(6.0))
    base = slow + 1e-2 * np.sin(2.0 * np.pi * 17.0 * t + np.arange(6.0))
    noise = 1e-4 * np.random.default_rng(0).standard_normal(base.shape)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (t.size, 1))
    shaking = replace(log, base_twist=base + noise, base_attitude=still)
    left = without_lines(rig, shaken(shaking, 17.0, 2.0))
    assert [line.shown for line in left.lines] == [True]
    assert left.base_twist is not None
    rows = np.isfinite(left.base_twist[:, 0])
    assert np.abs(left.base_twist[rows] - slow[rows]).max() < 1e-3
