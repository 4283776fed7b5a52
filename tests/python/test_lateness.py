"""Velocities of joints that are later than the positions beside them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter

import truewrench as tw
from truewrench import robots
from truewrench.model.log import Log
from truewrench.model.rig import load_rig
from truewrench.robot.lateness import in_step

Array = np.ndarray[Any, np.dtype[np.float64]]

RATE = 200.0  # [Hz]


def joints(seed: int, late: float = 0.0) -> Log:
    """Two seconds' silence in the middle; encoders of 2e-5 rad, tachometers of 5e-4 rad/s."""
    draw = np.random.default_rng(seed)
    time = np.arange(int(20.0 * RATE)) / RATE
    f, phase = draw.uniform(0.1, 1.0, (3, 1, 6)), draw.uniform(0.0, 6.0, (3, 1, 6))
    angle = 2.0 * np.pi * f * time[:, None] + phase
    position = 0.3 * np.sin(angle).sum(axis=0)
    velocity = (0.3 * 2.0 * np.pi * f * np.cos(angle - 2.0 * np.pi * f * late)).sum(axis=0)
    kept = (time < 9.0) | (time > 11.0)
    stamps = np.rint(1e9 * time[kept]).astype(np.int64)
    return Log(
        None,
        "default",
        "",
        stamps,
        np.zeros((stamps.size, 6)),
        position=(position + 2e-5 * draw.standard_normal(position.shape))[kept],
        velocity=(velocity + 5e-4 * draw.standard_normal(velocity.shape))[kept],
    )


def test_streams_in_step_are_left_as_they_are() -> None:
    for seed in range(40):
        log = joints(seed)
        assert in_step(log) == (log, 0.0)


@pytest.mark.parametrize("late", [-4e-3, 5e-4, 8e-3, 3e-2])
def test_how_late_velocities_are_is_found_and_undone(late: float) -> None:
    moved, found = in_step(joints(3, late))
    assert found == pytest.approx(late, abs=5e-5)
    again, rest = in_step(moved)
    assert rest == 0.0
    assert again is moved
    assert moved.position is not None
    at = moved.time - late
    expected = joints(3, 0.0).position
    assert expected is not None
    inside = (at > 0.1) & (at < 8.9)
    of_truth = np.column_stack([np.interp(at[inside], moved.time, q) for q in expected.T])
    np.testing.assert_allclose(moved.position[inside], of_truth, atol=5e-4)


def test_a_log_of_one_stream_and_a_short_one_tell_nothing() -> None:
    log = joints(0, 8e-3)
    for other in (replace(log, position=None), replace(log, velocity=None)):
        assert in_step(other) == (other, 0.0)
    short = replace(
        log,
        time_ns=log.time_ns[:3],
        raw=log.raw[:3],
        position=None if log.position is None else log.position[:3],
        velocity=None if log.velocity is None else log.velocity[:3],
    )
    assert in_step(short) == (short, 0.0)


def test_online_reads_positions_at_the_clock_of_filtered_velocities_and_says_so() -> None:
    path = robots.path("ur10_ground")
    settings = load_rig(path).to_mapping()
    settings["simulate"] |= {"rate": 200.0, "sensor_rate": 200.0}
    rig = tw.Rig.from_mapping(settings, path)
    run = tw.simulate_arm(rig, seed=1)
    assert run.log.velocity is not None
    told = np.isfinite(run.log.velocity).all(axis=1)
    velocity = run.log.velocity.copy()
    first = velocity[told][0]
    velocity[told] = first + lfilter(*butter(1, 20.0 / 100.0), velocity[told] - first, axis=0)
    found = tw.calibrate(rig, replace(run.log, velocity=velocity), estimator="online", held_out=False)
    assert np.abs((found.gain - run.truth.gain) / found.gain_std).max() < 5.0
    assert any("late against the positions" in note for note in found.figures["notes"])
