"""Streams that are slower than the rows that they are logged in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from record_cases import RigOf, light_rig

import truewrench as tw
from truewrench.model.log import Log
from truewrench.model.repeats import without_repeats
from truewrench.simulation.free_body import SimulatedRun

Array = NDArray[np.float64]


def held(values: Array) -> Array:
    """Each value until the next one, as a driver with a loop of its own reports it."""
    known = np.isfinite(values).all(axis=1)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where(last[:, None] >= 0, values[np.maximum(last, 0)], np.nan)


def slower(rate: float, sensor_rate: float) -> tuple[tw.Rig, SimulatedRun, Log]:
    settings = light_rig(seconds=8, rate=rate, discrepancy=0, time_offset_prior=0.02).to_mapping()
    settings["simulate"]["sensor_rate"] = sensor_rate
    rig = tw.Rig.from_mapping(settings)
    run = tw.simulate(rig)
    assert run.log.twist is not None
    faster = np.isfinite((run.log.twist if rate > sensor_rate else run.log.raw)[:, 0])
    raw, twist = held(run.log.raw)[faster], held(run.log.twist)[faster]
    return rig, run, replace(run.log, time_ns=run.log.time_ns[faster], raw=raw, twist=twist)


@pytest.mark.parametrize(("rate", "sensor_rate"), [(500, 125), (500, 200), (125, 500)])
def test_a_stream_that_is_held_says_what_it_says_by_itself(rate: float, sensor_rate: float) -> None:
    rig, run, logged = slower(rate, sensor_rate)
    apart, found = (tw.calibrate(rig, log, held_out=False) for log in (run.log, logged))
    assert found.verdict.usable
    assert any("held by the driver" in note for note in found.figures["notes"])
    std = np.sqrt(np.diag(apart.covariance)[:36]).reshape(6, 6)
    assert np.abs((found.gain - apart.gain) / std).max() < 0.5  # a held value is late by part of a row
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)[:36]).reshape(6, 6), std, rtol=0.1)


@pytest.mark.parametrize("name", ["gravity", "attitude", "base_twist", "base_attitude"])
def test_every_stream_that_is_held_is_told(name: str) -> None:
    width = {"gravity": 3, "base_twist": 6}.get(name, 4)
    values: Any = np.repeat(np.random.default_rng(0).normal(size=(200, width)), 4, axis=0)
    log = Log(None, "default", "", np.arange(800) * 2_500_000, np.full((800, 6), np.nan), **{name: values})
    assert np.flatnonzero(np.isfinite(getattr(without_repeats(log), name)[:, 0])).tolist() == [
        *range(0, 800, 4)
    ]
    still = replace(log, **{name: np.broadcast_to(values[0], values.shape)})
    assert without_repeats(still) is still


def test_a_direction_of_gravity_that_is_held_is_not_late() -> None:
    """A tracker of 100 Hz in rows of 400 Hz: 4 ms late, gravity moved the clock by up to 6 sigma."""
    settings = light_rig(seconds=10, rate=400, discrepancy=0).to_mapping()
    rig = tw.Rig.from_mapping(settings | {"gravity": [0, 0, -9.81]})
    usable = 0
    for seed in range(3):
        run = tw.simulate(rig, seed=seed)
        assert run.log.twist is not None
        assert run.log.gravity is not None
        rows = np.arange(len(run.log.time_ns)) // 4 * 4
        log = replace(run.log, twist=run.log.twist[rows], gravity=run.log.gravity[rows])
        found = tw.calibrate(rig, log, held_out=False)
        assert found.time_offset == pytest.approx(run.truth.time_offset, abs=4 * found.time_offset_std)
        assert np.abs((found.gain - run.truth.gain) / found.gain_std).max() < 4.5
        usable += found.verdict.usable
    assert usable >= 2


def drawn(values: Array, rows: int, rate: float) -> Array:
    """Linear interpolation to 500 Hz, as who makes a table brings its streams together."""
    t, of = np.arange(rows) / 500.0, np.arange(len(values)) / rate
    return np.column_stack([np.interp(t, of, column) for column in values.T])


@pytest.mark.parametrize("rate", [50.0, 125.0, 137.0, 200.0, 250.0])
@pytest.mark.parametrize("noise", [1e-3, 1e-9])
def test_of_lines_between_samples_one_row_a_sample_is_read(rate: float, noise: float) -> None:
    t = np.arange(0.0, 10.1, 1.0 / rate)[:, None]
    smooth = np.sin(2 * np.pi * np.array([0.3, 0.5, 0.7, 0.9, 1.1, 1.3]) * t + np.arange(6.0))
    values = drawn(smooth + noise * np.random.default_rng(0).normal(size=smooth.shape), 5000, rate)
    log = Log(None, "default", "", np.arange(5000) * 2_000_000, values)
    left = without_repeats(log)
    kept = np.flatnonzero(np.isfinite(left.raw[:, 0]))
    assert abs(len(kept) - 10.0 * rate) < 0.02 * 10.0 * rate
    assert np.abs(np.diff(kept) - 500.0 / rate).max() <= 2.5
    assert "interpolated" in left.notes[-1]


def test_of_a_smooth_motion_that_begins_slowly_no_second_is_lost() -> None:
    """Its lines hardly bend there: of gravity that was read so, the ends and a gap were lost."""
    t = np.arange(0.0, 10.1, 0.01)[:, None]
    ramp = np.clip(np.minimum(t, 10 - t) / 3, 0, 1) ** 3
    values = drawn(ramp * np.sin(2 * np.pi * np.array([0.3, 0.5, 0.7]) * t), 5000, 100.0)
    log = Log(None, "default", "", np.arange(5000) * 2_000_000, np.full((5000, 6), np.nan), gravity=values)
    left = without_repeats(log).gravity
    assert left is not None
    kept = np.flatnonzero(np.isfinite(left[:, 0]))
    assert 950 < len(kept) < 1050
    assert np.diff(kept).max() < 25


def test_what_is_straight_by_itself_is_not_interpolated() -> None:
    """White noise, a smooth motion that nothing disturbs, one that is planned with ramps, and rest."""
    t, rng = np.arange(5000)[:, None] / 500.0, np.random.default_rng(0)
    smooth = np.sin(2 * np.pi * np.array([0.3, 0.5, 0.7]) * t)
    ramps = np.clip(2 * np.abs(t % 2 - 1) - 0.5, 0, 0.6) * [1.0, 0.5, 0.3]
    for values in (rng.normal(size=(5000, 6)), smooth, ramps, 0 * smooth, smooth[:, :1]):
        log = Log(
            None, "default", "", np.arange(5000) * 2_000_000, np.full((5000, 6), np.nan), velocity=values
        )
        assert without_repeats(log) is log


@pytest.mark.parametrize(("rate", "sensor_rate"), [(500, 125), (500, 137), (60, 500)])
def test_a_table_of_interpolated_streams_is_as_good_as_the_streams(rate: float, sensor_rate: float) -> None:
    """Lines taken for measurements, 12 of 12 were refused, for a slow disturbance or vibration."""
    settings = light_rig(seconds=10, rate=rate, discrepancy=0).to_mapping()
    settings["simulate"]["sensor_rate"] = sensor_rate
    rig = tw.Rig.from_mapping(settings)
    for seed in range(2):
        run = tw.simulate(rig, seed=seed)
        time = np.arange(5000) * 2_000_000
        table = {}
        for name in ("raw", "twist"):
            values = getattr(run.log, name)
            there = np.isfinite(values[:, 0])
            table[name] = np.column_stack(
                [np.interp(time, run.log.time_ns[there], column) for column in values[there].T]
            )
        apart = tw.calibrate(rig, run.log, held_out=False)
        found = tw.calibrate(rig, replace(run.log, time_ns=time, **table), held_out=False)
        assert found.verdict.usable
        assert np.abs((found.gain - run.truth.gain) / found.gain_std).max() < 4.5
        np.testing.assert_allclose(found.gain_std, apart.gain_std, rtol=0.25)


def test_coarse_readings_are_no_repeats() -> None:
    log = tw.simulate(light_rig(seconds=8, rate=200)).log
    step = 3.0 * np.std(np.diff(log.raw, axis=0), axis=0)
    assert without_repeats(replace(log, raw=step * np.round(log.raw / step))).notes == log.notes


def test_an_arm_that_rests_is_not_held() -> None:
    """Encoders repeat themselves for as long as it does (40% here): without these rows nobody would know."""
    t = np.arange(2000)[:, None] * 0.01
    moving = np.clip(np.sin(0.3 * np.pi * t), -0.4, 0.4) * np.array([[1.0, 0.7, -0.5]])
    log = Log(None, "default", "", np.arange(2000) * 10_000_000, np.full((2000, 6), np.nan), position=moving)
    assert without_repeats(log).position is log.position


def test_rows_that_a_slow_stream_held_for_longer_stay() -> None:
    """At rest a held stream says more than nothing: that it rests."""
    rng = np.random.default_rng(0)
    values: Any = np.repeat(rng.normal(size=(200, 6)), 4, axis=0)
    values[300:400] = values[300]
    log = Log(None, "default", "", np.arange(800) * 2_000_000, values)
    kept = np.isfinite(without_repeats(log).raw[:, 0])
    assert kept[300:400].all()
    assert kept[:300].sum() == 75


def test_a_drivers_marks_for_no_sample_are_none() -> None:
    """65535 and -999 in 0.2% of the cells of a motion: the record could not be solved."""
    rig = light_rig(seconds=12, rate=200, discrepancy=0)
    for seed in range(3):
        run, rng = tw.simulate(rig, seed=seed), np.random.default_rng(seed)
        assert run.log.twist is not None
        marked = rng.random(run.log.twist.shape) < 2e-3
        twist = np.where(marked, rng.choice([-999.0, 65535.0], run.log.twist.shape), run.log.twist)
        found = tw.calibrate(rig, replace(run.log, twist=twist), held_out=False)
        assert any("mark for no sample" in note for note in found.figures["notes"])
        assert found.verdict.usable
        assert np.abs((found.gain - run.truth.gain) / found.gain_std).max() < 4.5


def test_knocks_and_starts_are_no_marks() -> None:
    """A joint that rests for all but 1% of the record, and spikes of ten times the range of a column."""
    t, rng = np.arange(10_000)[:, None] / 500.0, np.random.default_rng(0)
    rest = np.sin(np.pi * np.clip((t - 10) / 0.2, 0, 1)) ** 2 * [1.0, 0.3] + 1e-5 * rng.normal(
        size=(10_000, 2)
    )
    spikes = np.sin(t * [1.0, 2.0]) + 1e-3 * rng.normal(size=(10_000, 2))
    spikes[::500] += 20.0
    log = Log(None, "default", "", np.arange(10_000) * 2_000_000, np.full((10_000, 6), np.nan))
    resting = replace(log, position=rest)
    assert without_repeats(resting) is resting
    found = without_repeats(replace(log, position=spikes))
    assert found.position is not None
    np.testing.assert_array_equal(
        np.isnan(found.position).any(axis=1)[2:], (np.arange(10_000) % 500 == 0)[2:]
    )
    (note,) = found.notes
    assert note.endswith("alone, left out as a glitch")


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_glitches_of_the_motion_move_no_gain(estimator: Any) -> None:
    """0.2% of the cells of the velocities are 1 m/s or rad/s off: usable, and 9 sigma beside the truth."""
    rig = light_rig(seconds=20, rate=200, discrepancy=0)
    run, rng = tw.simulate(rig, seed=5), np.random.default_rng(5)
    assert run.log.twist is not None
    off = np.where(rng.random(run.log.twist.shape) < 2e-3, rng.choice([-1.0, 1.0], run.log.twist.shape), 0.0)
    found = tw.calibrate(rig, replace(run.log, twist=run.log.twist + off), estimator, held_out=False)
    assert any("left out as a glitch" in note for note in found.figures["notes"])
    assert found.verdict.usable
    z = ((found.gain - run.truth.gain) / found.gain_std).ravel()
    assert np.abs(z).max() < 4.5
    clean = tw.calibrate(rig, run.log, estimator, held_out=False)
    assert (found.gain_std < 1.1 * clean.gain_std).all()


def test_coarse_velocities_and_tremors_have_no_glitches() -> None:
    t, rng = np.arange(10_000)[:, None] / 500.0, np.random.default_rng(0)
    slow = np.round(0.05 * np.sin(0.3 * t * [1.0, 2.0]) + 1e-3 * rng.normal(size=(10_000, 2)), 2)
    pulses = 0.01 * (rng.random((10_000, 2)) < 0.02)  # a step of an encoder now and then, over a period
    tremor = np.sin(t) + 0.02 * rng.standard_t(5, size=(10_000, 2)) * (1.0 + np.sin(0.2 * t))
    log = Log(None, "default", "", np.arange(10_000) * 2_000_000, np.full((10_000, 6), np.nan))
    for values in (slow, pulses, tremor):
        same = replace(log, velocity=values)
        assert without_repeats(same).velocity is values


def test_notes_name_what_was_logged_and_not_what_follows_from_joints(arm_rig: RigOf) -> None:
    rig = arm_rig("panda", plan={"duration": 4}, simulate={"rate": 400, "sensor_rate": 400})
    log = tw.simulate_arm(rig, seed=1).log
    assert log.tracking is not None
    assert log.twist is not None
    assert log.position is not None
    assert log.velocity is not None
    slow = np.arange(len(log.time_ns)) // 4 * 4
    held_log = replace(log, position=log.position[slow], velocity=log.velocity[slow], twist=log.twist[slow])
    left = without_repeats(held_log)
    assert [note.split(":")[0] for note in left.notes[len(log.notes) :]] == ["q_*", "dq_*"]
    assert left.twist is not None
    assert np.isnan(left.twist[1::4]).all()


def test_few_rows_and_dead_channels_tell_nothing() -> None:
    rng = np.random.default_rng(0)
    for rows, dead in ((8, False), (300, True)):
        values = np.zeros((rows, 6)) if dead else np.repeat(rng.normal(size=(rows // 4, 6)), 4, axis=0)
        log = Log(None, "default", "", np.arange(rows) * 2_000_000, values)
        assert without_repeats(log) is log


@pytest.mark.parametrize("streams", [("twist",), ("twist", "raw"), ("raw",)])
def test_a_stream_that_hangs_is_no_measurement(streams: tuple[str, ...]) -> None:
    """For 0.6 s the driver publishes what it had, and then goes on."""
    rig = light_rig(seconds=10, rate=200, discrepancy=0)
    run = tw.simulate(rig)
    stuck = {name: np.array(getattr(run.log, name)) for name in streams}
    for values in stuck.values():
        values[800:920] = values[800]
    log = replace(run.log, **stuck)
    left = without_repeats(log)
    for name in ("raw", "twist"):
        gone = np.flatnonzero(np.isnan(getattr(left, name)[:, 0]))
        assert gone.tolist() == (list(range(801, 920)) if name in streams else [])
    found, clean = (tw.calibrate(rig, x, held_out=False) for x in (log, run.log))
    assert found.verdict.usable
    assert any("hung" in note for note in found.figures["notes"])
    std = np.sqrt(np.diag(clean.covariance)[:36]).reshape(6, 6)
    assert np.abs((found.gain - clean.gain) / std).max() < 1.5
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)[:36]).reshape(6, 6), std, rtol=0.3)


def test_joints_that_hang_while_one_turns_back_are_left_out_together() -> None:
    """Of a velocity that is at its peak nothing jumps: its position does."""
    t = np.arange(2000)[:, None] * 0.005
    rng = np.random.default_rng(0)
    position = np.sin(np.pi * t * [1.0, 0.8]) + 1e-5 * rng.normal(size=(2000, 2))
    velocity = np.pi * np.array([1.0, 0.8]) * np.cos(np.pi * t * [1.0, 0.8]) + 1e-3 * rng.normal(
        size=(2000, 2)
    )
    position[990:1015], velocity[990:1015] = position[990], velocity[990]
    empty = np.full((2000, 6), np.nan)
    log = Log(None, "default", "", np.arange(2000) * 5_000_000, empty, position=position, velocity=velocity)
    left = without_repeats(log)
    for values in (left.position, left.velocity):
        assert values is not None
        assert np.flatnonzero(np.isnan(values[:, 0])).tolist() == list(range(991, 1015))


def test_poses_without_the_way_between_them_do_not_hang() -> None:
    """Encoders that rest repeat themselves, and the next pose is elsewhere."""
    t = np.arange(600) * 0.01
    swing = 0.3 * np.sin(2.0 * np.pi * 0.3 * t)
    poses = np.repeat([0.8, -0.5, 1.1], 100)
    position = np.append(swing, poses)[:, None]
    time = np.arange(900) * 10_000_000 + 5_000_000_000 * (np.maximum(np.arange(900) - 500, 0) // 100)
    log = Log(None, "default", "", time, np.full((900, 6), np.nan), position=position)
    assert without_repeats(log).position is position
