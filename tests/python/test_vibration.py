"""Vibration is taken out of the channels: nothing slow changes, and nothing that a motion is made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import RigOf, arm_with, light_rig
from scipy import signal
from scipy.stats import chi2

import truewrench as tw
from truewrench.estimation.vibration import without_vibrations
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.split import rows_of
from truewrench.simulation.arm.run import ArmRun
from truewrench.simulation.free_body import SimulatedRun

Array = np.ndarray[Any, np.dtype[np.float64]]

RATE = 250.0  # [Hz]
EDGE = 87  # samples of half a filter, which are lost at either end
RIG = light_rig(seconds=15, rate=RATE, discrepancy=0)
SLOW = np.tile([[0.2], [0.37], [0.53], [0.71], [0.9], [1.1]], (1, 6))  # [Hz]


def simulated(seed: int, ripple: float = 0.0) -> SimulatedRun:
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


def shaken(log: Log, hz: float, size: float, swing: float = 0.0) -> Log:
    """The log with a force on every channel whose amplitude wanders, and its frequency by `swing` [Hz]."""
    t = log.time[:, None]
    phase = 2.0 * np.pi * hz * t - swing / 0.3 * np.cos(2.0 * np.pi * 0.3 * t)
    wave = (1.0 + 0.5 * np.sin(1.5 * t)) * np.sin(phase + np.arange(6.0))
    return replace(log, raw=log.raw + size * wave * np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]))


def nees(found: tw.Calibration, run: SimulatedRun | ArmRun) -> float:
    error = (found.gain - run.truth.gain).ravel()
    return float(error @ np.linalg.solve(found.covariance[:36, :36], error)) / 36.0


def test_a_log_without_vibrations_is_left_as_it_is() -> None:
    for seed in range(12):
        log = simulated(seed).log
        assert without_vibrations(RIG, log) is log


@pytest.mark.parametrize("seconds", [4.2, 5.1, 5.7, 7.5])
def test_a_short_log_without_vibrations_is_left_as_it_is(seconds: float) -> None:
    """Of one segment, the density of white noise is four times that of a few bins in every second log."""
    changed = 0
    for seed in range(24):
        log = simulated(seed).log
        short = rows_of(log, log.time < seconds)
        changed += without_vibrations(RIG, short) is not short
    assert changed <= 1


def test_a_line_too_weak_to_matter_takes_nothing_with_it() -> None:
    """It is far above the density of the noise, and a sixth of its variance: no reason to leave all out."""
    for seed in range(12):
        weak = shaken(simulated(seed).log, 31.0, 0.4 * RIG.sensor.noise[0])
        assert not any(band.open for band in without_vibrations(RIG, weak).vibrations)


@pytest.mark.parametrize("hz", [12.0, 27.0, 40.0, 60.0])
def test_a_line_is_found_and_what_is_slow_is_left_as_it_was(hz: float) -> None:
    log = simulated(int(hz)).log
    left = without_vibrations(RIG, shaken(log, hz, 0.5))
    (found,) = left.vibrations
    assert found.centre == pytest.approx(hz, abs=0.1)
    assert found.size == pytest.approx(0.5 * np.sqrt(1.125) / 100.0, rel=0.15)  # of the range
    assert not found.shown
    assert left.twist is log.twist
    rows = np.isfinite(left.raw[:, 0])
    assert np.sum(rows) == np.sum(rows[EDGE:-EDGE])
    assert np.mean(rows[EDGE:-EDGE]) > 0.9
    departure = left.raw[rows, 0] - log.raw[rows, 0]
    noise = np.std(np.diff(log.raw[:, 0], 2)) / np.sqrt(6.0)
    assert np.std(departure) < 0.3 * noise  # the noise of the band that went with the line
    smooth = np.convolve(departure, np.hanning(125) / 62.0, "valid")
    assert np.abs(smooth).max() < 0.05 * noise


@pytest.mark.parametrize("swing", [0.0, 4.0])
def test_what_is_left_counts_as_white_noise(swing: float) -> None:
    """As many samples are left out as the band held of the noise's variance."""
    log = simulated(1).log
    noise = np.random.default_rng(2).standard_normal(log.raw.shape)
    left = without_vibrations(RIG, shaken(replace(log, raw=noise), 25.0, 2.0, swing)).raw
    left = left[EDGE:-EDGE]
    kept = np.isfinite(left[:, 0])
    assert np.mean(kept) < (0.96 if swing == 0.0 else 0.92)
    assert np.nanvar(left) == pytest.approx(np.mean(kept), rel=0.04)


def test_a_step_that_is_told_is_not_smeared_and_an_outlier_neither() -> None:
    log = shaken(simulated(1).log, 23.0, 0.5)
    raw = log.raw.copy()
    raw[2000:] += 5.0
    outliers = [700, 1500, 3000]
    raw[outliers, 2] += 20.0
    told = replace(log, raw=raw, offset_jumps_ns=(int(log.time_ns[2000]),))
    departure = without_vibrations(RIG, told).raw - without_vibrations(RIG, log).raw - (raw - log.raw)
    departure[outliers] = 0.0
    assert np.nanmax(np.abs(departure)) < 0.3  # three sigma of the noise; smeared 0.6


def test_a_motion_that_is_made_of_lines_keeps_them() -> None:
    """A shaker's: what it teaches is in them."""
    rng = np.random.default_rng(5)
    motion = HarmonicTwist(
        np.full((1, 6), 0.02), np.full((1, 6), 12.5), rng.uniform(0, 2 * np.pi, (1, 6)), 15.0
    )
    log = tw.simulate(RIG, motion, seed=5).log
    left = without_vibrations(RIG, shaken(log, 30.0, 0.5))
    assert left.twist is log.twist
    assert [round(found.centre) for found in left.vibrations] == [30]


def test_ripple_that_the_motion_shows_leaves_both() -> None:
    run = simulated(3, ripple=0.002)
    left = without_vibrations(RIG, run.log)
    (found,) = left.vibrations
    assert found.centre == pytest.approx(20.0, abs=0.1)
    assert found.shown
    plain = simulated(3).log
    assert left.twist is not None
    assert plain.twist is not None
    assert run.log.twist is not None
    rows = np.isfinite(left.twist[:, 0])
    assert np.std(left.twist[rows] - plain.twist[rows]) < 0.3 * np.std(run.log.twist - plain.twist)


def structure(log: Log, seed: int, size: float, rate: float = RATE) -> tuple[Array, Array]:
    """Force (N, 6) of three modes of 11 to 60 Hz that noise excites, of unit ranges, and its integral."""
    rng = np.random.default_rng(seed)
    force, integral = np.zeros((2, len(log.time_ns), 6))
    for hz in (11.0, 23.0, 61.0):
        omega, excited = 2.0 * np.pi * hz, rng.standard_normal(len(log.time_ns) + 500)
        for b, into in (([omega, 0.0], force), ([omega], integral)):
            mode = signal.bilinear(b, [1.0, 0.06 * omega, omega**2], rate)
            into += np.outer(signal.lfilter(*mode, excited)[500:], np.cos(np.arange(6.0) + hz))
    scale = size / force.std(axis=0).max()
    return scale * force, scale * integral


@pytest.mark.parametrize("shown", [False, True])
def test_an_arm_that_shakes_as_it_moves_is_calibrated_all_the_same(shown: bool) -> None:
    """Sigma was two to thirty times as large; nothing above a corner is left, and what is left is white."""
    ratios, errors = [], []
    for seed in range(6):
        run = simulated(seed)
        body = next(iter(RIG.payloads.values()))
        span = RIG.sensor.range_array
        force, integral = structure(run.log, seed, 0.003)
        wrench = RIG.sensor.sign * (force * span) @ run.truth.gain.T
        log = replace(run.log, raw=run.log.raw + wrench)
        if shown:
            assert log.twist is not None
            momentum = integral * span
            arm = np.cross(body.center_of_mass_array, momentum[:, :3])
            turn = np.linalg.solve(body.inertia_matrix, (arm - momentum[:, 3:]).T).T
            log = replace(log, twist=log.twist + np.hstack([-momentum[:, :3] / body.mass, turn]))
        left = without_vibrations(RIG, log)
        (found,) = left.vibrations
        assert found.high == np.inf
        assert found.shown == shown
        assert "from 8 Hz on" in found.words
        calibration = tw.calibrate(RIG, log, held_out=False)
        assert calibration.verdict.usable, calibration.verdict.reasons
        assert not any("resolved in steps" in x.evidence for x in calibration.assumed)
        plain = tw.calibrate(RIG, run.log, held_out=False)
        ratios.append(np.sqrt(np.trace(calibration.covariance) / np.trace(plain.covariance)))
        errors.append(nees(calibration, run))
    assert np.mean(ratios) < 2.0
    assert 36 * np.sum(errors) < chi2.ppf(0.999, 36 * len(errors))


@pytest.mark.parametrize("estimator", ["map", "online"])
@pytest.mark.parametrize("kind", ["force", "gears", "ripple"])
def test_vibration_costs_no_accuracy_and_is_named(estimator: Any, kind: str) -> None:
    """Taken for noise it made sigma two to ten times as large, and ripple of 20 Hz could be ten sigma off."""
    ratios, errors = [], []
    for seed in range(8):
        run = simulated(seed, ripple=0.002 if kind == "ripple" else 0.0)
        log = run.log if kind == "ripple" else shaken(run.log, 17.0, 0.5, 4.0 if kind == "gears" else 0.0)
        found = tw.calibrate(RIG, log, estimator, held_out=False)
        assert found.verdict.usable, found.verdict.reasons
        said = [x.evidence for x in found.assumed if x.what == "vibration: mean amplitude, fraction of range"]
        assert len(said) == 1
        assert ("shows too" if kind == "ripple" else "does not show") in said[0]
        assert (" from 1" in said[0]) == (kind == "gears")
        plain = tw.calibrate(RIG, simulated(seed).log, held_out=False)  # of the same gain
        ratios.append(np.median(found.gain_std / plain.gain_std))
        errors.append((nees(found, run), nees(plain, run)))
    assert np.median(ratios) < 1.1
    assert np.mean(errors, axis=0) == pytest.approx(np.ones(2), abs=0.25)


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
        left = without_vibrations(rig, run.log)
        assert [(found.centre, found.shown) for found in left.vibrations] == [
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
    left = without_vibrations(rig, shaken(shaking, 17.0, 2.0))
    assert [found.shown for found in left.vibrations] == [True]
    assert left.base_twist is not None
    rows = np.isfinite(left.base_twist[:, 0])
    assert np.abs(left.base_twist[rows] - slow[rows]).max() < 1e-3
