"""Clocks of sensor and motion that are tenths of a second apart, as those of two computers are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from record_cases import RigOf, arm_with, light_rig
from tool_cases import a_rig, swing_log

import truewrench as tw
from truewrench.estimation.clock_rate import with_stamps
from truewrench.estimation.far_clock import LEAST, set_within, with_clock_set
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.robot.compensation import subtracted
from truewrench.simulation.free_body import SimulatedRun

ROUNDING = 5e-3  # [s] half a sample, to which a clock is set, of a log of 100 Hz


def run_of(rig: Rig, seed: int = 0) -> SimulatedRun:
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(0.2, 1.1, (6, 6))
    size = rng.uniform(0.2, 0.7, (6, 6)) / np.sqrt(6.0)
    phase = rng.uniform(0, 2 * np.pi, (6, 6))
    return tw.simulate(rig, HarmonicTwist(size, frequency, phase, 12), seed=seed)


def later(log: Log, by: float) -> Log:
    """The sensor stamped so much later [s]."""
    sensed = np.isfinite(log.raw).any(axis=1)
    return with_stamps(log, log.time_ns[sensed] + round(1e9 * by))


def without_weight(rig: Rig, log: Log) -> Log:
    """As a driver hands it on that subtracts what its own tool weighs."""
    assert log.gravity is not None
    return replace(log, raw=log.raw - subtracted(rig, log.gravity))


@pytest.mark.parametrize("by", [-0.6, -0.08, 0.2])
@pytest.mark.parametrize("source", ["twist", "joints"])
def test_a_late_sensor_tells_the_same_gain(source: str, by: float, arm_rig: RigOf) -> None:
    """Whatever clocks say, the same wrench stands beside the same motion."""
    if source == "twist":
        rig = light_rig(seconds=12, rate=100)
        log = run_of(rig).log
    else:
        rig = arm_with(arm_rig, "panda_ground")
        log = tw.simulate_arm(rig, seed=2).log
    plain = tw.calibrate(rig, log, held_out=False)
    found = tw.calibrate(rig, later(log, by), held_out=False)
    assert found.verdict.usable == plain.verdict.usable
    # half a second of either end has no counterpart any more
    assert np.abs((found.gain - plain.gain) / plain.gain_std).max() < 1.5
    assert found.gain_std == pytest.approx(plain.gain_std, rel=0.5)
    late = pytest.approx(by - plain.time_offset, abs=5.0 * plain.time_offset_std)
    assert -found.time_offset == late
    assert any(one.what.startswith("clock") and one.value == late for one in found.assumed)


@pytest.mark.parametrize("source", ["twist", "imu"])
def test_so_does_a_tool(source: str) -> None:
    motion = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
    rig = tool_rig(a_rig(motion=motion) if source == "imu" else a_rig())
    log = swing_log(rig, 1.5, np.array([0.01, -0.02, 0.08]), np.diag([0.01, 0.012, 0.006]))
    plain, found = (tw.identify_tool(rig, [one]) for one in (log, later(log, 0.15)))
    assert abs(found.mass - plain.mass) < 0.5 * plain.mass_std
    assert found.time_offset == pytest.approx(plain.time_offset - 0.15, abs=5.0 * plain.time_offset_std)


@pytest.mark.parametrize("by", [-0.08, 0.6])
def test_a_weight_that_was_subtracted_stays_with_the_motion(by: float) -> None:
    """The driver reads g when it reads the sensor; both are stamped late."""
    bare = light_rig(seconds=12, rate=100).to_mapping() | {"gravity": [3.0, -5.0, 7.0]}
    body = {"mass": 4.5, "center_of_mass": [0.02, -0.01, 0.1]}
    rig = Rig.from_mapping(bare | {"sensor": bare["sensor"] | {"compensated": body}})
    log = without_weight(rig, run_of(Rig.from_mapping(bare)).log)
    plain, found = (tw.calibrate(rig, one, held_out=False) for one in (log, later(log, by)))
    assert plain.verdict.usable
    assert found.verdict.usable
    assert np.abs((found.gain - plain.gain) / plain.gain_std).max() < 1.0
    assert -found.time_offset == pytest.approx(by, abs=5.0 * found.time_offset_std)

    of_tool = tool_rig(a_rig(sensor={"compensated": {"mass": 1.2, "center_of_mass": [0.01, -0.02, 0.07]}}))
    log = swing_log(tool_rig(a_rig()), 1.5, np.array([0.01, -0.02, 0.08]), np.diag([0.01, 0.012, 0.006]))
    tool = tw.identify_tool(of_tool, [later(without_weight(of_tool, log), by)])
    assert tool.verdict.usable
    assert abs(tool.mass - 1.5) < 2.0 * tool.mass_std
    assert -tool.time_offset == pytest.approx(by, abs=5.0 * tool.time_offset_std)


def test_what_is_near_is_left_to_the_estimate() -> None:
    rig = light_rig(seconds=12, rate=100)
    for seed in range(4):
        log = run_of(rig, seed).log
        for one in (log, later(log, 0.5 * LEAST)):
            assert with_clock_set(rig, one) is one


def test_a_push_and_a_foreign_motion_are_no_clock() -> None:
    """What is left then is no small share at any delay."""
    rig = light_rig(seconds=12, rate=100)
    log, other = (run_of(rig, seed).log for seed in (0, 1))
    raw = log.raw.copy()
    raw[(log.time > 8.5) & (log.time < 9.5), 2] += 40.0
    for one in (replace(log, raw=raw), replace(log, twist=other.twist)):
        assert with_clock_set(rig, one) is one


def test_a_delay_that_the_gain_imitates_is_not_set() -> None:
    """One frequency an axis, all the same: no delay leaves more than another."""
    rig = light_rig(seconds=12, rate=100)
    frequency, phase = np.full((1, 6), 0.5), np.linspace(0.0, 2.0, 6)[None]
    trajectory = HarmonicTwist(np.full((1, 6), 0.05), frequency, phase, 12)
    log = tw.simulate(rig, trajectory, seed=0).log
    assert with_clock_set(rig, log) is log


def test_loggers_started_by_hand_are_seconds_apart() -> None:
    """And of a motion that repeats itself the nearest of its repetitions is taken."""
    rig = light_rig(seconds=16, rate=100)
    rng = np.random.default_rng(0)
    frequency, phase = rng.integers(1, 5, (6, 6)) / 4.0, rng.uniform(0.0, 2.0 * np.pi, (6, 6))
    again = HarmonicTwist(rng.uniform(0.2, 0.7, (6, 6)) / np.sqrt(6.0), frequency, phase, 16)
    for log, by in ((run_of(rig).log, 2.6), (tw.simulate(rig, again, seed=0).log, -1.5)):
        assert with_clock_set(rig, later(log, by)).clock_set == pytest.approx(by, abs=0.01 + ROUNDING)


def test_a_clock_is_set_to_a_sample() -> None:
    """So that rows which held sensor and motion go on to do so."""
    rig = light_rig(seconds=12, rate=100)
    log = run_of(rig).log
    found = with_clock_set(rig, replace(log, twist=np.roll(log.twist, -13, axis=0)))
    assert found.clock_set == pytest.approx(0.13, abs=ROUNDING)
    both = np.isfinite(found.raw[:, 0]) & np.isfinite(found.twist[:, 0])  # type: ignore[index]
    assert np.count_nonzero(both) == len(log.time_ns) - 13
    assert found.advance() == found.clock_set


def test_a_clock_that_was_set_is_as_uncertain_as_the_motion_leaves_it() -> None:
    """Though the rig states that clocks are exact, and what was set is right to the last digit."""
    rig = light_rig(seconds=12, rate=100, time_offset_prior=0)
    found = tw.calibrate(rig, later(run_of(rig).log, 0.37))
    assert 1e-6 < found.time_offset_std < 1e-3
    assert abs(found.time_offset + 0.37) < 4 * found.time_offset_std


def test_a_clock_that_was_set_within_a_log_is_named() -> None:
    """It cannot be undone, but it is no contact; and what moves as it should is not called so."""
    rig = light_rig(seconds=12, rate=100)
    log = run_of(rig).log
    stamps = log.time_ns + np.where(log.time > 6.0, 200_000_000, 0)
    found = tw.calibrate(rig, with_stamps(log, stamps), held_out=False)
    assert not found.verdict.usable
    assert any("clock was set within the log" in r and "200 ms later" in r for r in found.verdict.reasons)
    pushed = log.raw.copy()
    pushed[(log.time > 3.0) & (log.time < 9.0), 0] += 30.0
    for one in (log, replace(log, raw=pushed)):
        assert set_within(rig, one) == 0.0
