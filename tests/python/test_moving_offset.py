"""Claims about logs whose offset moves although the rig says nothing of it."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_disturbed_logs import NOISE, gain_error, pushed, rig_of

import truewrench as tw
from truewrench.calibration import Calibration
from truewrench.estimate.moving_offset import Jump, jump_in, jump_notes, log_cut_at, with_free_offsets
from truewrench.estimate.windows import estimate_windows
from truewrench.evidence import Evidence
from truewrench.log import Log
from truewrench.report.series import record_of
from truewrench.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate

RATE = 200


def jumped(log: Log, at: float, step: Any) -> Log:
    """The log with offsets that jump by `step` times the noise at a share of it."""
    raw = log.raw + (log.time > at * log.time[-1])[:, None] * np.asarray(step) * NOISE
    return replace(log, raw=raw)


def nees(rig: Rig, found: Calibration, run: SimulatedRun) -> float:
    unit = (rig.sensor.range_array / rig.sensor.channel_scale[:, None]).ravel()
    covariance = found.covariance[:36, :36] * np.outer(unit, unit)
    d = gain_error(rig, found.gain, run)
    return float(d @ np.linalg.solve(covariance, d) / 36)


def notes_of(found: Calibration) -> list[str]:
    return [note for note in found.figures["notes"] if "jumps" in note]


@pytest.mark.parametrize("estimator", ["map", "online"])
@pytest.mark.parametrize(("size", "at"), [(4.0, 0.63), (60.0, 0.31)])
def test_a_jump_of_the_offset_is_found_named_and_paid_for(estimator: Any, size: float, at: float) -> None:
    rig, scores = rig_of(RATE), []
    step = size * np.array([1, 0, 0, -0.5, 0, 0])
    for seed in range(3):
        run = simulate(rig, seed=seed)
        found = tw.calibrate(rig, jumped(run.log, at, step), estimator)
        assert found.verdict.usable, found.verdict.reasons
        (note,) = notes_of(found)
        begin, end, jump = re.findall(r"between (\S+) and (\S+) s \(fx by (\S+), mx by \S+\)", note)[0]
        assert float(begin) < at * run.log.time[-1] < float(end)
        assert float(jump) == pytest.approx(size * NOISE[0], rel=0.1)
        scores.append(nees(rig, found, run))
        end = run.truth.offset + step * NOISE
        assert (np.abs(found.offset - end) < 4.0 * found.offset_std).all()
    assert 0.6 < np.mean(scores) < 1.45


@pytest.mark.parametrize(
    ("estimator", "size"), [("map", 1.5), ("map", 5.0), ("online", 5.0), ("online", 80.0)]
)
def test_a_jump_near_the_end_is_no_contact_that_lasts(estimator: Any, size: float) -> None:
    rig, scores = rig_of(RATE), []
    step = size * np.array([1, 0, 0, -0.5, 0, 0])
    for seed, at in enumerate((0.82, 0.9, 0.95)):
        run = simulate(rig, seed=seed)
        found = tw.calibrate(rig, jumped(run.log, at, step), estimator, held_out=False)
        (note,) = notes_of(found)
        assert "whatever the sensor bears" in note
        end = run.truth.offset + step * NOISE
        assert (np.abs(found.offset - end) < 4.0 * found.offset_std).all()
        scores.append(nees(rig, found, run))
    assert 0.6 < np.mean(scores) < 1.45


def test_a_contact_that_lasts_to_the_end_leaves_the_offset_as_it_was_and_is_told() -> None:
    rig, scores = rig_of(RATE), []
    for seed in range(3):
        run = simulate(rig, seed=seed)
        log = run.log
        push = (3.0 + np.sin(20.0 * log.time)) * (log.time > 0.9 * log.time[-1])
        log = replace(log, raw=log.raw + 30.0 * np.outer(push, NOISE))
        found = tw.calibrate(rig, log, held_out=False)
        assert found.verdict.usable, found.verdict.reasons
        assert not notes_of(found)
        (note,) = [note for note in found.figures["notes"] if "hardly anything is known" in note]
        since = float(re.findall(r"log 1 from (\S+) s on", note)[0])
        assert since == pytest.approx(0.9 * log.time[-1], abs=0.5)
        assert (np.abs(found.offset - run.truth.offset) < 4.0 * found.offset_std).all()
        scores.append(nees(rig, found, run))
    assert 0.6 < np.mean(scores) < 1.45


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_a_jump_too_small_to_spoil_the_fit_is_found_too(estimator: Any) -> None:
    rig, scores = rig_of(RATE), []
    for seed in range(3):
        run = simulate(rig, seed=seed)
        found = tw.calibrate(rig, jumped(run.log, 0.45, [0, 0, 0, 0.6, 0, 0]), estimator, held_out=False)
        assert "mx by" in notes_of(found)[0]
        scores.append(nees(rig, found, run))
    assert np.mean(scores) < 1.45


def test_a_jump_and_a_contact_are_told_apart_by_what_explains_more() -> None:
    run = simulate(rig_of(RATE), seed=5)
    log, rows = run.log, np.arange(len(run.log.raw))
    wrench = np.random.default_rng(1).normal(size=(len(rows), 6))  # of any motion
    raw = wrench @ run.truth.gain.T + NOISE * np.random.default_rng(2).normal(size=log.raw.shape)
    late, stretch = rows > 0.55 * len(rows), (rows > 0.6 * len(rows)) & (rows < 0.68 * len(rows))
    none = np.zeros(len(rows), dtype=bool)
    for moved, left_out, jumps in (
        (0.5 * late, stretch, True),  # a part of what jumped was taken for a contact
        (0.5 * late, none, True),
        (4.0 * stretch, stretch, False),
        (0.0 * late, none, False),
        (0.0 * late, stretch, False),
    ):
        shown = replace(log, raw=raw + moved[:, None] * np.array([0, 0, 0, 1, 0, 0]) * NOISE)
        found = jump_in(shown, rows, wrench, NOISE, left_out)
        assert (found is not None and not found.contested) == jumps


def test_one_jump_is_simpler_than_contacts_that_explain_more() -> None:
    rig = rig_of(RATE)
    run = simulate(rig, seed=56)
    found = tw.calibrate(rig, jumped(run.log, 0.68, [0, 0, 0, 0, 0, 0.41]), held_out=False)
    assert found.verdict.usable, found.verdict.reasons
    assert len(notes_of(found)) == 1
    assert not found.logs[0].disturbances
    assert nees(rig, found, run) < 1.45


def test_offsets_that_are_free_to_follow_the_motion_show_no_jump_by_chance() -> None:
    run = simulate(rig_of(RATE), seed=5)
    rows, rng = np.arange(len(run.log.raw)), np.random.default_rng(3)
    part = rows * 24 // len(rows)
    size = 4.0 / np.sqrt(len(rows) / 24)  # of a part's mean, four times that of the sensor's noise
    for at in (0.3, 0.6):
        wrench = rng.normal(size=(len(rows), 6))
        slow = size * rng.normal(size=(24, 6))[part] + rng.normal(size=run.log.raw.shape)
        raw = wrench @ run.truth.gain.T + NOISE * slow
        assert jump_in(replace(run.log, raw=raw), rows, wrench, NOISE) is None
        log = jumped(replace(run.log, raw=raw), at, [0, 3, 0, 0, 0, 0])
        for left_out in (None, part % 5 == 0):  # and contacts are no better for taking it out
            found = jump_in(log, rows, wrench, NOISE, left_out)
            assert found is not None
            assert found.begin <= at * run.log.time[-1] <= found.end


def test_a_jump_that_slow_noise_moves_lies_between_its_times_still() -> None:
    log, rng = simulate(rig_of(RATE), seed=5).log, np.random.default_rng(6)
    rows, gain = np.arange(len(log.raw)), np.diag(1.0 / NOISE)
    part = rows * 24 // len(rows)
    size = 2.0 / np.sqrt(len(rows) / 24)  # of a part's mean, twice that of the sensor's noise
    cycles = log.time[:, None] / log.time[-1] * np.arange(0.5, 3.5, 0.5)
    found = 0
    for at in np.linspace(0.15, 0.85, 60).tolist():
        for jump in (1.0, 1.5):
            wrench = np.sin(2.0 * np.pi * (cycles + rng.uniform(size=6)))
            slow = size * rng.normal(size=(24, 6))[part] + rng.normal(size=log.raw.shape)
            still = replace(log, raw=wrench @ gain.T + NOISE * slow)
            shown = jump_in(jumped(still, at, [0, jump, 0, 0, 0, 0]), rows, wrench, NOISE)
            if shown is not None:
                found += 1
                assert shown.begin <= at * log.time[-1] <= shown.end
    assert found > 30


def test_what_a_slow_motion_takes_of_a_jump_does_not_hide_when_it_was() -> None:
    run, rng = simulate(rig_of(RATE), seed=5), np.random.default_rng(4)
    rows, log = np.arange(len(run.log.raw)), run.log
    cycles = log.time[:, None] / log.time[-1] * np.arange(0.5, 3.5, 0.5)
    wrench = np.sin(2.0 * np.pi * (cycles + rng.uniform(size=6)))
    for at in (0.2, 0.35, 0.5, 0.65, 0.8):
        raw = wrench @ run.truth.gain.T + NOISE * rng.normal(size=log.raw.shape)
        found = jump_in(jumped(replace(log, raw=raw), at, [0, 4, 0, 0, 0, 0]), rows, wrench, NOISE)
        assert found is not None
        assert found.begin <= at * log.time[-1] <= found.end < found.begin + 0.1


def test_a_jump_that_the_gain_would_hide_is_sought_more_closely() -> None:
    log, draws = simulate(rig_of(RATE), seed=5).log, 100
    rows, gain, at = np.arange(len(log.raw)), np.diag(1.0 / NOISE), 0.8
    step = (log.time > at * log.time[-1]).astype(float)
    found = dict.fromkeys([(motion, seen) for motion in ("slow", "fast") for seen in (0, 30)], 0)
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        for motion, cycles in (("slow", np.arange(0.2, 1.4, 0.2)), ("fast", np.arange(3.0, 9.0))):
            phase = log.time[:, None] / log.time[-1] * cycles + rng.uniform(size=6)
            wrench = np.sin(2.0 * np.pi * phase)
            known = np.column_stack([wrench, np.ones(len(rows))])
            left = step - known @ np.linalg.lstsq(known, step, rcond=None)[0]
            still = replace(log, raw=wrench @ gain.T + NOISE * rng.normal(size=log.raw.shape))
            for seen in (0, 30):  # energy of the jump, where it is known when it was
                size = np.sqrt(seen) / np.linalg.norm(left)
                moved = jumped(still, at, [0, size, 0, 0, 0, 0])
                jump = jump_in(moved, rows, wrench, NOISE)
                found[motion, seen] += jump is not None
                refused = jump_in(moved, rows, wrench, NOISE, share=0.0)  # the gain, whatever hides in it
                assert refused is None or not refused.faint
    assert found["fast", 0] == 0
    assert found["slow", 0] <= 10
    assert 0.3 * draws < found["fast", 30] < 0.65 * draws  # chance that chi-square exceeds 36: 0.47,
    assert 0.7 * draws < found["slow", 30]  # and 25: 0.83
    faint = Jump(1.0, 5.0, 9.0, NOISE, faint=True)
    assert "may have jumped between 1.000 and 9.000 s" in jump_notes(rig_of(RATE), [faint])[0]


def test_pieces_of_a_doubtful_time_meet_where_a_faint_jump_is_likeliest() -> None:
    log = simulate(rig_of(RATE), seed=0).log
    end = float(log.time[-10])

    def cuts(likeliest: float, faint: bool = True) -> Any:
        cut = log_cut_at(log, Jump(0.0, likeliest, end, NOISE, faint=faint))
        return 1e-9 * (np.array(cut.offset_jumps_ns) - log.time_ns[0])

    evenly = np.linspace(0.0, end, 7)
    assert cuts(0.9 * end) == pytest.approx([*evenly[:5], 0.9 * end, end], abs=1e-8)
    assert cuts(end - 2.0 / RATE) == pytest.approx(evenly, abs=1e-8)  # a piece of two rows tells nothing
    assert cuts(0.9 * end, faint=False) == pytest.approx(evenly, abs=1e-8)


@pytest.mark.parametrize("shape", ["line", "walk"])
def test_a_drift_that_no_rig_stated_is_refused_with_the_walk_to_state(shape: str) -> None:
    rig, scores = rig_of(RATE), []
    for seed in range(2):
        run = simulate(rig, seed=seed)
        drift = 12.0 * np.outer(run.log.time / run.log.time[-1], [1, 1, -1, 1, -1, 1])
        if shape == "walk":
            steps = np.random.default_rng(seed).normal(size=drift.shape)
            drift = 4.0 * np.cumsum(steps, axis=0) / np.sqrt(len(steps))
        log = replace(run.log, raw=run.log.raw + drift * NOISE)
        refused = tw.calibrate(rig, log, held_out=False)
        assert not refused.verdict.usable
        (walk,) = re.findall(r"offset_walk: \[(.*?)\]", " ".join(refused.verdict.reasons))
        stated = rig_of(RATE, offset_walk=[float(q) for q in walk.split(",")])
        found = tw.calibrate(stated, log, held_out=False)
        assert found.verdict.usable, found.verdict.reasons
        assert (np.abs(found.gain - refused.gain) < 0.1 * found.gain_std).all()
        scores.append(nees(stated, found, run))
    assert np.mean(scores) < 1.45


def test_contacts_and_clean_logs_have_offsets_that_stay() -> None:
    rig = rig_of(RATE)
    for seed in range(4):
        run = simulate(rig, seed=seed)
        for log in (run.log, pushed(run.log, 10.0, 3.0 + seed, 0.3)[0]):
            found = tw.calibrate(rig, log, held_out=False)
            assert found.verdict.usable, found.verdict.reasons
            assert not notes_of(found)
    assert found.logs[0].disturbances


def test_an_offset_that_follows_temperature_or_walks_as_stated_does_not_jump() -> None:
    settings = rig_of(RATE).to_mapping()
    warm = Rig.from_mapping(settings | {"temperature": {"reference": 20, "prior": 1e-3}})
    run = simulate(warm, seed=2)
    temperature = 20.0 + 3.0 * (run.log.time > 0.5 * run.log.time[-1])
    raw = run.log.raw + np.outer(temperature - 20.0, NOISE)
    found = tw.calibrate(warm, replace(run.log, raw=raw, temperature=temperature), held_out=False)
    assert found.verdict.usable, found.verdict.reasons
    assert not notes_of(found)
    walking = rig_of(RATE, offset_walk=NOISE.tolist())
    found = tw.calibrate(walking, jumped(run.log, 0.5, [1, 0, 0, 0, 0, 0]), held_out=False)
    assert found.verdict.usable, found.verdict.reasons
    assert not notes_of(found)


def test_the_report_shows_no_step_where_a_jump_was_found() -> None:
    rig, shown = rig_of(RATE), list[Evidence]()
    log = jumped(simulate(rig, seed=4).log, 0.5, [20, 0, 0, 0, 0, 0])
    calibration = tw.calibrate(rig, log, held_out=False, evidence=shown.append)
    series = record_of(calibration, shown[0]).logs[0]
    normalised = series.residual / series.sigma
    late = series.time > 0.6 * log.time[-1]
    early = series.time < 0.4 * log.time[-1]
    assert np.abs(np.nanmean(normalised[late], axis=0) - np.nanmean(normalised[early], axis=0)).max() < 0.2


def test_one_offset_for_all_logs_does_not_move() -> None:
    rig = rig_of(RATE, pool_offsets=True)
    log = jumped(simulate(rig, seed=1).log, 0.5, [8, 0, 0, 0, 0, 0])
    assert not with_free_offsets(rig, lambda changed: estimate_windows(changed, [log]))
    assert not tw.calibrate(rig, log, held_out=False).verdict.usable
