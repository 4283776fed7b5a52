"""From rig and logs to a calibration, in Python and through the command."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import yaml
from record_cases import light_rig
from rigs import changed, two_payloads

import truewrench as tw
from truewrench.calibrating.pipeline import calibrate
from truewrench.cli import main
from truewrench.model.calibration import AXES, Calibration, load_calibration
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate


def settings_of(**changes: Any) -> dict[str, Any]:
    rig = changed(two_payloads("default"), sensor={"gain_prior": 0.1}, plan={"duration": 12})
    return changed(rig, **changes)


def rig_of(**changes: Any) -> Rig:
    return Rig.from_mapping(settings_of(**changes))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_of()


@pytest.fixture(scope="module")
def run(rig: Rig) -> SimulatedRun:
    return simulate(rig, seed=1)


@pytest.fixture(scope="module")
def result(rig: Rig, run: SimulatedRun) -> Calibration:
    return calibrate(rig, run.log)


def test_a_good_log_is_calibrated_and_usable(rig: Rig, run: SimulatedRun, result: Calibration) -> None:
    assert result.verdict.usable
    assert result.verdict.reasons == ()
    assert result.estimator == "map"
    assert np.abs((result.gain - run.truth.gain) / result.gain_std).max() < 4.5
    assert np.abs((result.offset - run.truth.offset) / result.offset_std).max() < 4.5
    assert datetime.fromisoformat(result.created).tzinfo is not None


def test_corrected_readings_are_the_true_wrench(rig: Rig, run: SimulatedRun, result: Calibration) -> None:
    """A load that the calibration never saw, ten times as large as those that it did, without noise."""
    wrench = np.array([[100.0, -200.0, 300.0, 5.0, -10.0, 20.0]])
    found = result.wrench(wrench @ run.truth.gain.T + run.truth.offset)
    nominal = np.linalg.norm((wrench @ run.truth.gain.T - wrench) / rig.sensor.range_array)
    error = (found - wrench)[0]
    assert np.linalg.norm(error / rig.sensor.range_array) < 0.2 * nominal
    by_gain = np.kron(result.inverse, wrench)  # d wrench / d gain, row by row
    std = np.sqrt(np.diag(by_gain @ result.covariance[:36, :36] @ by_gain.T))
    assert np.abs(error / std).max() < 4.0


def test_covariance_holds_the_stated_sigma(result: Calibration) -> None:
    assert result.covariance.shape == (42, 42)
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)[:36]).reshape(6, 6), result.gain_std)
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)[36:]), result.offset_std)
    np.testing.assert_allclose(result.covariance, result.covariance.T)
    correlation = result.covariance / np.outer(*[np.sqrt(np.diag(result.covariance))] * 2)
    assert np.linalg.eigvalsh(correlation).min() > 0.0


def test_inverse_undoes_the_gain(result: Calibration) -> None:
    np.testing.assert_allclose(result.inverse @ result.gain, np.eye(6), atol=1e-9)


def test_knowing_the_motion_could_only_have_helped(result: Calibration) -> None:
    assert result.bound is not None
    assert 0.0 < result.bound.oracle_rms < result.bound.rms
    # From the noise-free motion itself: sigma_i^2 (W^T W)^-1, a little above it for the offset.
    assert result.bound.rms < 0.1


def test_oracle_bound_is_that_of_regression_on_the_true_wrench() -> None:
    rig = rig_of(
        sensor={"offset_prior": 0, "gain_prior": 1.0}, simulate={"gain": "nominal", "offset": "none"}
    )
    run = simulate(rig, seed=3)
    quiet = rig_of(
        sensor={"noise": [1e-9] * 6, "offset_prior": 0}, simulate={"gain": "nominal", "offset": "none"}
    )
    wrench = simulate(quiet, seed=3).log.raw / rig.sensor.range_array  # C = I: the sensor reads the wrench
    information = wrench.T @ wrench
    variance = np.mean([
        np.diag(np.linalg.inv(information / (noise / span) ** 2 + np.eye(6))).mean()
        for noise, span in zip(rig.sensor.noise_array, rig.sensor.range_array, strict=True)
    ])  # fmt: skip
    result = calibrate(rig, run.log)
    assert result.bound is not None
    assert result.bound.oracle_rms == pytest.approx(np.sqrt(variance), rel=0.02)


def test_improvement_says_what_the_new_gain_is_worth_per_axis(rig: Rig, result: Calibration) -> None:
    assert tuple(result.improvement) == AXES
    for axis, noise in zip(AXES, rig.sensor.noise_array, strict=True):
        found = result.improvement[axis]
        assert found.better is True
        assert found.held_out
        assert found.new < 0.5 * found.nominal
        assert 0.7 * noise < found.new < 1.5 * noise  # what is left is the sensor's noise


def test_a_gain_that_was_right_all_along_is_not_called_worse() -> None:
    rig = rig_of(simulate={"gain": "nominal"})
    result = calibrate(rig, simulate(rig, seed=4).log)
    assert all(found.better is not False for found in result.improvement.values())
    assert any(found.better == "unsure" for found in result.improvement.values())


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_pooled_logs_are_reported_one_by_one(estimator: Literal["map", "online"], rig: Rig) -> None:
    first = simulate(rig, seed=5)
    same = rig_of(simulate={"gain": first.truth.gain.tolist()})
    second = simulate(same, seed=6, payload="small")
    cut = replace(second.log, dropped_rows=3, nan_counts={"vx": 2})
    result = calibrate(rig, [first.log, cut], estimator)
    assert result.estimator == estimator
    assert [report.payload for report in result.logs] == ["default", "small"]
    for report, run in zip(result.logs, [first, second], strict=True):
        assert report.used == 1200
        assert not report.rejected
        assert np.abs((report.offset - run.truth.offset) / report.offset_std).max() < 4.5
    np.testing.assert_array_equal(result.offset, result.logs[-1].offset)
    assert (result.logs[1].dropped_rows, result.logs[1].nan_counts) == (3, {"vx": 2})


@pytest.mark.parametrize(("first", "last", "left_out"), [(500, 560, 60), (300, 900, None)])
def test_every_sample_is_used_or_accounted_for(
    rig: Rig, run: SimulatedRun, first: int, last: int, left_out: int | None
) -> None:
    raw, twist = run.log.raw.copy(), np.array(run.log.twist)
    raw[:50] = np.nan  # the sensor starts late
    twist[1100:] = np.nan  # the motion ends early
    raw[first:last] += 40.0 * np.random.default_rng(0).normal(size=(last - first, 6))
    result = calibrate(rig, replace(run.log, raw=raw, twist=twist))
    (report,) = result.logs
    assert report.used + sum(report.masked.values()) + sum(report.rejected.values()) == 1150
    assert set(report.rejected) == {"outside every stretch of motion"}
    assert report.rejected["outside every stretch of motion"] == pytest.approx(100, abs=2)
    if left_out is None:  # more than half of the record
        assert not result.verdict.usable
    else:
        assert report.masked["contact"] == pytest.approx(left_out + 4, abs=4)  # widened by 20 ms each side
        begin, end = max(report.disturbances, key=lambda span: span[1] - span[0])
        assert (begin, end) == pytest.approx((run.log.time[first], run.log.time[last - 1]), abs=0.05)
        assert result.verdict.usable


def test_one_log_alone_is_a_list_of_one(rig: Rig, run: SimulatedRun, result: Calibration) -> None:
    again = calibrate(rig, [run.log], threads=1)
    np.testing.assert_array_equal(again.gain, result.gain)
    np.testing.assert_array_equal(again.covariance, result.covariance)


def test_progress_names_the_phases(rig: Rig, run: SimulatedRun) -> None:
    phases: list[str] = []
    calibrate(rig, run.log, "online", progress=lambda phase, share: phases.append(phase))
    assert phases[0] == "estimating (online)"
    assert len(phases) > 1


@pytest.mark.parametrize("estimator", ["ekf", "ls"])
def test_references_give_a_gain_that_is_not_to_be_used(
    estimator: Literal["ekf", "ls"], rig: Rig, run: SimulatedRun
) -> None:
    result = calibrate(rig, run.log, estimator)
    assert not result.verdict.usable
    assert result.verdict.reasons[0] == "reference estimator"
    assert result.gain.shape == (6, 6)
    assert result.estimator == estimator


def test_calibration_file_keeps_everything(result: Calibration, tmp_path: Path) -> None:
    target = tmp_path / "calibration.yaml"
    result.write_yaml(target)
    back = load_calibration(target)
    for name in ("gain", "gain_std", "offset", "offset_std", "inverse", "covariance"):
        np.testing.assert_array_equal(getattr(back, name), getattr(result, name))
    assert back.verdict.usable == result.verdict.usable
    assert back.improvement == result.improvement
    assert back.bound == result.bound
    content = yaml.safe_load(target.read_text(encoding="utf-8"))
    assert content["format"] == "truewrench/1"
    fields = (
        "gain gain_std offset offset_std offset_temperature time_offset time_offset_std inverse covariance "
        "payload_posterior logs verdict improvement bound rig estimator version created"
    )
    assert set(fields.split()) <= set(content)


@pytest.mark.parametrize("estimator", ["ekf", "ls"])
@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"sensor": {"lowpass_hz": 100.0}}, "sensor.lowpass_hz"),
    ],
)
def test_what_is_not_supported_is_refused(
    changes: dict[str, Any], key: str, estimator: Any, run: SimulatedRun
) -> None:
    with pytest.raises(UnsupportedError, match=key):
        calibrate(rig_of(**changes), run.log, estimator)


def test_options_of_other_estimators_are_refused(rig: Rig, run: SimulatedRun) -> None:
    with pytest.raises(UnsupportedError, match="published"):
        calibrate(rig, run.log, "map", published=True)
    with pytest.raises(UnsupportedError, match="smooth"):
        calibrate(rig, run.log, "online", smooth="spline")
    with pytest.raises(UnsupportedError, match="process_density"):
        calibrate(rig, run.log, "ls", process_density=2.0)


def test_no_log_is_refused(rig: Rig) -> None:
    with pytest.raises(InputError, match="at least one"):
        calibrate(rig, [])


def test_public_function_is_the_pipeline(rig: Rig, run: SimulatedRun, result: Calibration) -> None:
    np.testing.assert_array_equal(tw.calibrate(rig, run.log).gain, result.gain)


def through_command(
    capsys: pytest.CaptureFixture[str], settings: dict[str, Any], run: SimulatedRun, folder: Path,
    options: Sequence[str] = (),
) -> tuple[int, dict[str, Any]]:  # fmt: skip
    (folder / "rig.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    log, _ = run.write(folder / "run.csv")
    capsys.readouterr()
    status = main(
        ["calibrate", str(folder / "rig.yaml"), str(log), "-o", str(folder / "out"), "--json", *options]
    )
    return status, json.loads(capsys.readouterr().out)


def test_command_with_a_good_log_leaves_with_0(
    capsys: pytest.CaptureFixture[str], run: SimulatedRun, result: Calibration, tmp_path: Path
) -> None:
    status, said = through_command(capsys, settings_of(), run, tmp_path)
    assert status == 0
    assert said["verdict"]["usable"] is True
    calibration = load_calibration(tmp_path / "out" / "calibration.yaml")
    np.testing.assert_allclose(calibration.gain, result.gain, rtol=1e-9, atol=1e-12)
    assert len(calibration.logs[0].sha256) == 64


def test_command_with_a_poor_log_writes_and_leaves_with_3(
    capsys: pytest.CaptureFixture[str], run: SimulatedRun, tmp_path: Path
) -> None:
    disturbed = run.log.raw.copy()
    disturbed[200:900] += 40.0 * np.random.default_rng(0).normal(size=(700, 6))
    poor = replace(run, log=replace(run.log, raw=disturbed))
    status, said = through_command(capsys, settings_of(), poor, tmp_path)
    assert status == 3
    assert said["verdict"]["usable"] is False
    assert "of the sensor's samples were left out" in said["verdict"]["reasons"][0]
    assert not load_calibration(tmp_path / "out" / "calibration.yaml").verdict.usable


def test_command_with_a_log_of_another_rig_leaves_with_2_and_writes_nothing(
    capsys: pytest.CaptureFixture[str], run: SimulatedRun, tmp_path: Path
) -> None:
    status, _ = through_command(capsys, settings_of(gravity=[0, 0, -9.81]), run, tmp_path)
    assert status == 2
    assert not (tmp_path / "out").exists()


def test_command_pools_logs_of_other_payloads(
    capsys: pytest.CaptureFixture[str], rig: Rig, run: SimulatedRun, tmp_path: Path
) -> None:
    same = rig_of(simulate={"gain": run.truth.gain.tolist()})
    other, _ = simulate(same, seed=7, payload="small").write(tmp_path / "other.parquet")
    settings = settings_of()
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    log, _ = run.write(tmp_path / "run.csv")
    words = ["calibrate", tmp_path / "rig.yaml", f"{log}@default", f"{other}@small", "-o", tmp_path / "out"]
    status = main([str(word) for word in words])
    assert status == 0
    calibration = load_calibration(tmp_path / "out" / "calibration.yaml")
    assert [report.payload for report in calibration.logs] == ["default", "small"]
    assert np.abs((calibration.gain - run.truth.gain) / calibration.gain_std).max() < 4.5


def test_empty_cells_of_a_written_log_are_no_samples(tmp_path: Path) -> None:
    """A sensor four times as fast as the motion, through a CSV file and back."""
    rig = rig_of(simulate={"rate": 100, "sensor_rate": 400}, plan={"duration": 6})
    run = simulate(rig, seed=8)
    path, _ = run.write(tmp_path / "run.csv")
    log: Log = tw.read_log(path, rig)
    result, direct = calibrate(rig, log), calibrate(rig, run.log)
    np.testing.assert_allclose(result.gain, direct.gain, rtol=1e-7, atol=1e-9)
    assert result.logs[0].used == 2400 - 3  # the last three lie behind the last sample of the motion


@pytest.mark.parametrize("factor", [1e3, 1e-3, 9.80665])
def test_a_log_in_another_unit_is_refused_with_its_name(rig: Rig, run: SimulatedRun, factor: float) -> None:
    """A thousand times too much is noise to the estimate, and not to least squares."""
    verdict = calibrate(rig, replace(run.log, raw=factor * run.log.raw)).verdict
    named = {1e3: "mN for N", 1e-3: "kN for N", 9.80665: "N for kgf"}[factor]
    assert not verdict.usable
    assert any(named in reason for reason in verdict.reasons), verdict.reasons


@pytest.mark.parametrize("seed", range(4))
def test_an_arm_at_rest_teaches_nothing_and_is_told_so(seed: int) -> None:
    rig = light_rig(seconds=8, rate=100)
    log = simulate(rig).log
    rng = np.random.default_rng(seed)
    at_rest = replace(
        log,
        twist=rng.normal(0.0, rig.motion.noise_array, log.raw.shape),
        raw=rng.normal(0.0, rig.sensor.noise_array, log.raw.shape),
    )
    found = calibrate(rig, at_rest)
    assert not found.verdict.usable
    assert "nothing was learnt" in found.verdict.reasons[0]
    departure = (found.gain - rig.sensor.nominal_gain_array) * rig.sensor.range_array
    departure /= rig.sensor.channel_scale[:, None]
    assert np.abs(departure).max() < 0.5 * found.gain_std_normalised.min()


@pytest.mark.parametrize("wrong", ["another run", "three seconds late"])
def test_a_log_that_does_not_follow_its_motion_is_refused_by_that_name(wrong: str) -> None:
    """And by nothing else: what a gain without a cause looks like is no set-up error."""
    rig = light_rig(seconds=10, rate=100)
    frequencies = np.array([0.2, 0.37, 0.53, 0.71, 0.9, 1.1])

    def moved(seed: int) -> Log:
        rng = np.random.default_rng(seed)
        shape = (6, 6)
        f = frequencies[:, None] * rng.uniform(0.9, 1.1, shape)
        motion = HarmonicTwist(0.1 * rng.uniform(0.3, 1.0, shape), f, rng.uniform(0.0, 6.28, shape), 10.0)
        return simulate(rig, motion, seed=seed).log

    log = moved(1)
    if wrong == "another run":
        log = replace(log, twist=moved(2).twist)
    else:
        log = replace(log, raw=np.roll(log.raw, 300, axis=0))
    verdict = calibrate(rig, log).verdict
    assert not verdict.usable
    (reason,) = verdict.reasons
    assert "does not follow its motion" in reason
    assert "largest departure" in reason


@pytest.mark.parametrize("seed", [1, 4])
def test_rails_are_those_of_the_log_as_it_was_read(seed: int) -> None:
    """Readings in coarse steps, of which a filter is undone for the estimate, look like a rail only then."""
    rig = light_rig(seconds=10, rate=200)
    log = simulate(rig, seed=seed).log
    step = 10.0 * rig.sensor.noise_array
    coarse = replace(log, raw=np.round(log.raw / step) * step)
    assert not any(
        "extreme value" in reason for reason in calibrate(rig, coarse, held_out=False).verdict.reasons
    )
    short = replace(log, raw=np.minimum(log.raw, np.quantile(log.raw, 0.97, axis=0)))
    assert "extreme value" in calibrate(rig, short, held_out=False).verdict.reasons[0]


def test_per_cent_where_fractions_are_meant_is_told() -> None:
    rig = rig_of(required=2, plan={"duration": 8})
    log = simulate(rig, seed=0).log
    notes = calibrate(rig, log, held_out=False).figures["notes"]
    assert "`required` is 2, and so 200% of range: 0.02 is 2%" in notes
    assert not any("of range: 0.02" in note for note in calibrate(rig_of(), log).figures["notes"])


@pytest.mark.parametrize("estimator", ["ekf", "ls"])
def test_references_refuse_a_temperature_that_they_do_not_know(
    estimator: Literal["ekf", "ls"],
) -> None:
    rig = rig_of(temperature={"prior": 0.01}, plan={"duration": 8})
    log = simulate(rig, seed=0).log
    warm = replace(log, temperature=np.full(len(log.time_ns), 25.0))
    with pytest.raises(InputError, match=r"temperature\.prior.*knows no other"):
        calibrate(rig, warm, estimator)
