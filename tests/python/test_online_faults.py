"""`online` over whole logs: masks across gaps, dead channels, slow motion, and logs that make no sense."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from imperfect_cases import rig_of
from record_cases import light_rig

import truewrench as tw
from truewrench import _core
from truewrench.estimation.estimator import estimate
from truewrench.estimation.online import found_online
from truewrench.estimation.record import recorded_logs
from truewrench.judging import findings
from truewrench.model.errors import InputError
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate


def _streams(seconds: float, rate: float) -> tuple[Any, Any]:
    rig = light_rig(seconds=seconds, rate=rate)
    _, statement, streams = recorded_logs(rig, [tw.simulate(rig).log])
    return statement, streams[0]


def _cut(log: Any, begin: float, end: float) -> None:
    time, motion = np.asarray(log.time), log.motion[0]
    keep = (time < begin) | (time > end)
    log.time, log.raw = time[keep], np.asarray(log.raw)[keep]
    at = np.asarray(motion.time)
    keep = (at < begin) | (at > end)
    motion.time, motion.value = at[keep], np.asarray(motion.value)[keep]
    log.motion = [motion]


def _sigma(found: Any, channels: int = 6) -> float:
    return float(np.sqrt(np.mean(np.diag(np.asarray(found.gain_covariance))[: 6 * channels])))


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_a_component_that_was_never_measured_is_refused_by_its_name(estimator: Any) -> None:
    rig = light_rig(seconds=8.0, rate=100.0)
    log = tw.simulate(rig).log
    assert log.twist is not None
    twist = log.twist.copy()
    twist[:, 5] = np.nan
    with pytest.raises(InputError, match="column `wz`: found not one number, expected a number in at least"):
        tw.calibrate(rig, replace(log, twist=twist), estimator=estimator)


def test_what_is_masked_before_a_gap_is_told_at_the_end() -> None:
    statement, log = _streams(20.0, 100.0)
    raw = np.array(log.raw)
    contact = (np.asarray(log.time) > 5.0) & (np.asarray(log.time) < 5.5)
    raw[contact, :3] += 0.3
    log.raw = raw
    _cut(log, 14.0, 15.0)
    rows = found_online(statement, [log], 0.0).fit.rows(0)
    time, masked = np.asarray(rows["time"]), np.asarray(rows["masked"]) > 0
    assert masked[(time > 5.0) & (time < 5.5)].mean() > 0.9
    assert masked[time > 15.0].mean() < 0.05


def test_channels_that_die_leave_the_others_as_they_are() -> None:
    statement, log = _streams(10.0, 1000.0)
    whole = found_online(statement, [log], 0.0)
    raw = np.array(log.raw)
    raw[:, 5] = np.nan
    log.raw = raw
    found = found_online(statement, [log], 0.0)
    assert found.status == _core.Status.ok
    assert _sigma(found, 5) == pytest.approx(_sigma(whole, 5), rel=0.1)


def test_motion_slower_than_the_lag_holds_loses_no_sample() -> None:
    statement, log = _streams(40.0, 1000.0)
    motion = log.motion[0]
    motion.time, motion.value = np.asarray(motion.time)[::100].copy(), np.asarray(motion.value)[::100].copy()
    log.motion = [motion]
    found = _core.estimate_online(statement, [log], _core.IncrementalSettings())
    assert found.status == _core.Status.ok
    assert found.samples[0] > 0.98 * len(log.time)


@pytest.mark.parametrize(
    ("change", "status"),
    [
        (lambda s, log: setattr(log, "time", np.asarray(log.time)[::-1].copy()), "not_increasing"),
        (lambda s, log: setattr(log, "time", np.append(np.asarray(log.time)[:-1], np.nan)), "not_finite"),
        (lambda s, log: setattr(log, "time", np.asarray(log.time)[:-1].copy()), "wrong_size"),
        (lambda s, log: setattr(s, "gravity", np.array([0.0, 0.0, -9.81])), "wrong_size"),
        (lambda s, log: setattr(s, "body_prior", []), "wrong_size"),
        (lambda s, log: setattr(log, "body", 1), "wrong_size"),
        (lambda s, log: setattr(s, "noise", -np.asarray(s.noise)), "not_positive"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_told_by_both_estimators(change: Any, status: str) -> None:
    statement, log = _streams(6.0, 100.0)
    change(statement, log)
    settings = _core.IncrementalSettings()
    assert _core.estimate(statement, [log], _core.Settings()).status == getattr(_core.Status, status)
    assert _core.estimate_online(statement, [log], settings).status == getattr(_core.Status, status)


def test_the_loop_s_estimator_refuses_what_makes_no_sense() -> None:
    statement, log = _streams(6.0, 100.0)
    settings = _core.IncrementalSettings()
    for name in ("lag", "rate", "finest"):
        kept = getattr(settings, name)
        for wrong in (0.0, -1.0, np.nan):
            setattr(settings, name, wrong)
            with pytest.raises(ValueError, match="Incremental"):
                _core.Incremental(statement, log, settings)
        setattr(settings, name, kept)
    online: Any = _core.Incremental(statement, log, settings)
    other: Any = _streams(6.0, 100.0)[1]
    other.body = 1
    assert online.next_log(other) == _core.Status.wrong_size
    assert online.status == _core.Status.ok


def test_a_late_clock_is_no_jitter() -> None:
    """The motion that residuals are told by stood on the velocities' clock: 86 sigma of jitter, all of it."""
    settings = light_rig(seconds=20.0, rate=100.0).to_mapping()
    settings["sensor"]["time_offset_prior"] = 5e-3
    settings["simulate"] = {**settings.get("simulate", {}), "time_offset": 4e-3}
    rig = Rig.from_mapping(settings)
    log = tw.simulate(rig, seed=1).log
    found = tw.calibrate(rig, log, estimator="online")
    told = [assumed.what for assumed in found.assumed]
    assert any(what.startswith("clock") for what in told)
    assert not any(what.startswith(("jitter", "vibration")) for what in told)


def test_what_an_earlier_log_told_of_its_payload_is_kept_by_a_log_of_another() -> None:
    settings = rig_of().to_mapping()
    uncertain, exact = settings["payloads"]
    settings["payloads"][uncertain]["uncertainty"] = {"mass": 0.02, "center_of_mass": 1e-3, "inertia": 0.05}
    rig = tw.Rig.from_mapping(settings | {"gravity": [0, 0, -9.81]})
    logs = [tw.simulate(rig, seed=4, payload=name).log for name in (uncertain, exact)]
    online, whole = (estimate(rig, logs, online=online).payloads[uncertain] for online in (True, False))
    assert online.std[:4] == pytest.approx(whole.std[:4], rel=0.2)
    assert (online.std[:4] < 0.9 * np.array([0.02, 1e-3, 1e-3, 1e-3])).all()


def test_clocks_of_all_logs_are_told_and_as_well_known_as_those_of_map() -> None:
    late, logs = np.array([0.003, -0.002, 0.0015]), []
    for seed, s in enumerate(late):
        settings = light_rig(seconds=10.0, rate=100.0).to_mapping()
        settings["sensor"]["time_offset_prior"] = 5e-3
        settings["simulate"] |= {"gain": "nominal", "time_offset": -float(s)}
        rig = Rig.from_mapping(settings)
        logs.append(tw.simulate(rig, seed=seed).log)
    whole, found = (estimate(rig, logs, online=online) for online in (False, True))
    assert (np.abs(found.time_offsets + late) < 4.0 * found.time_offsets_std).all()
    ratio = found.time_offsets_std / whole.time_offsets_std
    assert ((ratio > 0.9) & (ratio < 1.5)).all()  # at the gains of then
    assert (np.asarray(found.offsets_std) < 3.0 * np.asarray(whole.offsets_std)).all()
    told = [a.where for a in findings(found, rig, logs) if a.what.startswith("clock")]
    assert told == ["log 1", "log 2", "log 3"]


def test_a_motion_slower_than_the_lag_is_found_as_by_the_whole_record() -> None:
    """Over a lag it is nearly a parabola: its velocities were taken for noise, and no lag could be solved."""
    rig = light_rig(seconds=80.0, rate=20.0, gain_prior=0.3, offset_prior=0)
    rig = rig.model_copy(update={"motion": rig.motion.model_copy(update={"noise": (1e-4,) * 6})})
    frequency = np.array([[0.030, 0.051, 0.069, 0.039, 0.060, 0.087]])
    phase = np.array([[0.0, 1.0, 2.0, 0.5, 1.5, 2.5]])
    motion = HarmonicTwist(np.full((1, 6), 0.05), frequency, phase, 80.0)
    log = simulate(rig, motion, seed=3).log
    whole, online = (estimate(rig, [log], online=online) for online in (False, True))
    assert online.solved
    sigma = np.sqrt(np.diag(whole.normalised_covariance)[:36]).reshape(6, 6)
    scale = rig.sensor.range_array[:, None] / rig.sensor.range_array
    assert (np.abs(online.gain - whole.gain) / scale / sigma).max() < 1.0
