"""Nominal and new gain compared on a part of the record that the gain has not seen."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.stats import chi2

from truewrench.calibrating.pipeline import calibrate
from truewrench.cli import main
from truewrench.judging.validation.comparison import Comparison, compare_held_out
from truewrench.model.calibration import AXES, Calibration
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate


def settings_of(**changes: Any) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "sensor": {
            "channels": list(AXES),
            "feels": "payload_on_sensor",
            "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
            "range": [500, 500, 500, 50, 50, 50],
            "gain_prior": 0.1,
            "time_offset_prior": 0,
        },
        "payloads": {
            "default": {
                "mass": 50,
                "center_of_mass": [0.2, 0, 0],
                "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
                "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
            }
        },
        "motion": {"of": "com", "noise": [1e-3] * 6},
        "plan": {"duration": 12},
    }
    for section, values in changes.items():
        settings[section] = {**settings.get(section, {}), **values}
    return settings


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


def test_new_gain_reads_unseen_loads_to_the_noise(rig: Rig, run: SimulatedRun, result: Calibration) -> None:
    """Against what the true gain would leave: the noise turned by its inverse, and that of the motion."""
    left = np.sqrt(np.linalg.inv(run.truth.gain) ** 2 @ rig.sensor.noise_array**2)
    figures = result.figures["held_out"]
    samples = figures["samples"]
    for axis, noise in zip(AXES, left, strict=True):
        found = result.improvement[axis]
        assert found.held_out
        assert found.better is True
        assert found.new > 0.8 * noise
        low, high = chi2.ppf([1e-4, 1.0 - 1e-4], samples) / samples
        assert low < figures["nis"][axis] < high  # of noise, motion and gain together
    assert result.figures["held_out"]["share"] == 0.2
    assert set(result.figures["held_out"]["nis"]) == set(AXES)


def test_parts_are_blocks_that_the_judged_gain_has_not_seen(rig: Rig, run: SimulatedRun) -> None:
    seen: list[Log] = []

    def calibrated(kept: Sequence[Log]) -> Calibration:
        seen.extend(kept)
        return calibrate(rig, kept, held_out=False)

    found = compare_held_out(rig, [run.log], calibrated)
    assert isinstance(found, Comparison)
    (kept,) = seen
    missing = np.setdiff1d(run.log.time_ns, kept.time_ns)
    assert len(missing) == pytest.approx(0.2 * len(run.log.time_ns), rel=0.02)
    assert np.diff(missing).max() < 20_000_000  # one block of so short a record
    assert found.figures["samples"] <= len(missing)


def test_gain_that_is_worse_than_the_nominal_one_is_a_reason(rig: Rig) -> None:
    """The sensor is as good as new, and the calibration is off by 5% of range on one axis."""
    right = rig_of(simulate={"gain": "nominal"})
    log = simulate(right, seed=4).log
    good = calibrate(right, log)
    assert good.verdict.usable, good.verdict.reasons
    gain = good.gain.copy()
    gain[1, 1] += 0.05
    wrong = replace(good, gain=gain, inverse=np.linalg.inv(gain))
    found = compare_held_out(right, [log], lambda kept: wrong)
    assert isinstance(found, Comparison)
    (reason,) = found.reasons
    assert reason.startswith("on the part of the record that was held out, fy is worse than with the nominal")
    assert found.improvement["fy"].better is False
    assert found.improvement["fx"].better is not False


def test_worse_axis_forbids_the_use(
    monkeypatch: pytest.MonkeyPatch, rig: Rig, run: SimulatedRun, result: Calibration
) -> None:
    monkeypatch.setattr(
        "truewrench.calibrating.from_motion.compare_held_out",
        lambda *_: Comparison(result.improvement, ("fx is worse",), {}),
    )
    spoilt = calibrate(rig, run.log)
    assert spoilt.verdict.reasons == ("fx is worse",)
    assert not spoilt.verdict.usable


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_final_gain_rests_on_the_whole_record(estimator: str, rig: Rig, run: SimulatedRun) -> None:
    found = calibrate(rig, run.log, estimator)  # type: ignore[arg-type]
    alone = calibrate(rig, run.log, estimator, held_out=False)  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.gain, alone.gain)
    # all but the few samples that are unlikely by chance
    assert sum(report.used for report in found.logs) >= 0.995 * len(run.log.time_ns)
    assert not any(axis.held_out for axis in alone.improvement.values())
    assert alone.figures["held_out"] == {"none_because": "not asked for"}


def test_record_too_short_is_compared_on_what_was_fitted_and_says_so() -> None:
    rig = rig_of(plan={"duration": 8})
    found = calibrate(rig, simulate(rig, seed=2).log)
    assert found.improvement
    assert not any(axis.held_out for axis in found.improvement.values())
    assert "too short to hold a part of it out" in found.figures["held_out"]["none_because"]


def test_what_cannot_be_compared_is_said_and_not_fatal(rig: Rig, run: SimulatedRun) -> None:
    rows = np.arange(len(run.log.time_ns))
    middle = np.abs(rows / len(rows) - 0.5) < 0.11
    raw = run.log.raw.copy()
    raw[middle] = np.nan
    found = calibrate(rig, replace(run.log, raw=raw))
    assert "could not be compared" in found.figures["held_out"]["none_because"]
    assert not any(axis.held_out for axis in found.improvement.values())


@pytest.mark.parametrize("option", [[], ["--no-held-out"]])
def test_command_holds_out_unless_told_not_to(
    capsys: pytest.CaptureFixture[str], run: SimulatedRun, tmp_path: Path, option: list[str]
) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(settings_of()), encoding="utf-8")
    log, _ = run.write(tmp_path / "run.csv")
    capsys.readouterr()
    status = main(["calibrate", str(tmp_path / "rig.yaml"), str(log), "-o", str(tmp_path), "--json", *option])
    assert status == 0
    said = json.loads(capsys.readouterr().out)["figures"]["improvement"]
    written = yaml.safe_load((tmp_path / "calibration.yaml").read_text())["improvement"]["axes"]
    for axis in AXES:
        assert said[axis]["held_out"] == written[axis]["held_out"] == (not option)
        assert written[axis]["better"] is True
