"""A campaign tells honest estimators from others, loses no trial, and does not depend on how it was run."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from scipy.stats import binomtest, multivariate_normal

import truewrench.campaign.figures
import truewrench.campaign.run
import truewrench.campaign.trial
from truewrench import robots
from truewrench.calibrating.pipeline import calibrate
from truewrench.campaign.figures import coverage_figure, nees_figure, sigma_figure
from truewrench.campaign.run import campaign
from truewrench.campaign.statistics import cluster_interval, summarise, wilson_interval, wrong_and_confident
from truewrench.campaign.trial import SCHEMA, run_trial, trial_seed
from truewrench.campaign.workers import Lost
from truewrench.cli import main
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.rig import Rig, load_rig
from truewrench.simulation.arm.run import simulate_arm
from truewrench.simulation.free_body import default_trajectory, simulate
from truewrench.simulation.truth import nees

SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
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
    "motion": {"noise": [1e-3] * 6},
    "required": 0.1,
    "plan": {"duration": 4},
    "simulate": {"rate": 40, "sensor_rate": 40},
}


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.from_mapping(SETTINGS)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The trials that are run: in this process, in order, without pictures, and in one build."""
    trials: list[int] = []

    def here(function: Callable[[int], Any], items: Sequence[int], processes: int) -> Iterator[Any]:
        for item in items:
            trials.append(item)
            yield item, function(item)

    monkeypatch.setattr(truewrench.campaign.run, "in_processes", here)
    monkeypatch.setattr(truewrench.campaign.run, "_build", lambda: "build")
    for name in ("nees_figure", "sigma_figure", "coverage_figure"):
        monkeypatch.setattr(truewrench.campaign.figures, name, lambda path, result: False)
    return trials


def stored(folder: Path) -> list[dict[str, Any]]:
    """The rows in a folder without the time they took."""
    rows: list[dict[str, Any]] = pq.read_table(folder / "trials").sort_by("trial").to_pylist()
    assert all(row.pop("seconds") > 0.0 for row in rows)
    return rows


def raising(error: BaseException) -> Callable[..., Any]:
    def fail(*_: Any, **__: Any) -> Any:
        raise error

    return fail


def test_row_is_what_simulating_and_calibrating_by_hand_gives(rig: Rig) -> None:
    row = run_trial(rig, default_trajectory(rig), "map", 5, 3)
    assert not isinstance(row, UnsupportedError)
    run = simulate(rig, seed=row["seed"])
    found = calibrate(rig, run.log)
    units = np.array(SETTINGS["sensor"]["range"])
    error = (found.gain - run.truth.gain) * units / units[:, None]
    deviation = np.abs(found.gain - run.truth.gain) / found.gain_std
    assert row["outcome"] == "calibrated"
    assert row["usable"] == found.verdict.usable
    assert row["rms_error"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    assert found.bound is not None
    assert row["rms_oracle"] == found.bound.oracle_rms
    assert row["largest_deviation"] == pytest.approx(deviation.max(), rel=1e-9)
    assert row["coverage"] == pytest.approx(np.mean(deviation < 1.959964))
    assert row["noise_v"] == found.figures["noise_found"][0]["velocities v"]
    assert row["masked"] < 0.01
    assert np.reshape(row["error"], (6, 6)) == pytest.approx(error, rel=1e-9)
    # log p at the mean minus log p at the error: half the NEES
    covariance = found.covariance[:36, :36] / np.outer(found.gain_std, found.gain_std)
    normal = multivariate_normal(np.zeros(36), covariance)
    drop = normal.logpdf(np.zeros(36)) - normal.logpdf(
        ((found.gain - run.truth.gain) / found.gain_std).ravel()
    )
    assert row["nees"] == pytest.approx(2.0 * drop, rel=1e-6)
    assert row["nees_dof"] == 36


def test_nees_counts_only_the_directions_that_a_covariance_has() -> None:
    basis = np.array([[1e3, 0.0], [1e3, 1e3], [0.0, 1e-3]])
    error = basis @ [1.0, 2.0]
    assert nees(error, basis @ basis.T) == (pytest.approx(5.0), 2)
    assert nees(error + [0.0, 0.0, 1e-4], basis @ basis.T)[0] == np.inf  # ruled out
    error = np.array([1e3, 2e3, 3e-3])
    assert nees(error, np.diag([1e6, 4e6, 9e-6])) == (pytest.approx(3.0), 3)
    assert nees(error, np.full((3, 3), np.nan))[1] == 0


def test_rows_are_the_same_for_any_number_of_processes(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(truewrench.campaign.run, "_build", lambda: "build")
    one, two = (campaign(rig, 2, tmp_path / f"{k}", seed=1, processes=k) for k in (1, 2))
    assert stored(tmp_path / "1") == stored(tmp_path / "2")
    assert one.summary["usable_trials"] == two.summary["usable_trials"]
    assert {path.name for path in one.outputs} >= {"summary.yaml", "nees.png", "sigma.png", "coverage.png"}
    assert all(path.exists() for path in one.outputs)
    assert yaml.safe_load((tmp_path / "1" / "summary.yaml").read_text())["trials"] == 2


def test_interrupted_campaign_goes_on_where_it_stood_and_can_be_extended(
    rig: Rig, tmp_path: Path, started: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop_at_half(phase: str, share: float | None) -> None:
        if share == 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign(rig, 4, tmp_path, "ls", progress=stop_at_half)
    assert started == [0, 1]
    campaign(rig, 4, tmp_path, "ls")
    assert started == [0, 1, 2, 3]
    summary = campaign(rig, 6, tmp_path, "ls").summary
    assert started == [0, 1, 2, 3, 4, 5]
    assert summary["trials"] == 6
    assert [row["trial"] for row in stored(tmp_path)] == started
    assert [row["seed"] for row in stored(tmp_path)] == [trial_seed(0, trial) for trial in started]


def test_other_rig_seed_or_build_is_refused_by_name_until_restarted(
    rig: Rig, tmp_path: Path, started: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign(rig, 1, tmp_path, "ls")
    before = stored(tmp_path)
    other = Rig.from_mapping(SETTINGS | {"plan": {"duration": 5}})
    with pytest.raises(InputError, match=r"rig\.plan\.duration: found 4.*, expected 5[^$]*--restart"):
        campaign(other, 1, tmp_path, "ls")
    with pytest.raises(InputError, match="seed: found 0, expected 1"):
        campaign(rig, 1, tmp_path, "ls", seed=1)
    with pytest.raises(InputError, match="estimator: found ls, expected map"):
        campaign(rig, 1, tmp_path)
    monkeypatch.setattr(truewrench.campaign.run, "_build", lambda: "another")
    with pytest.raises(InputError, match="build: found build, expected another"):
        campaign(rig, 1, tmp_path, "ls")
    assert stored(tmp_path) == before
    campaign(other, 2, tmp_path, "ls", restart=True)
    assert len(stored(tmp_path)) == 2


def test_no_trial_is_lost_to_refusals_faults_or_dying_processes(
    rig: Rig, tmp_path: Path, started: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = default_trajectory(rig)
    with monkeypatch.context() as patch:
        patch.setattr(truewrench.campaign.trial, "calibrate", raising(InputError("no motion in it")))
        refused = run_trial(rig, motion, "map", 0, 0)
        patch.setattr(truewrench.campaign.trial, "calibrate", raising(ZeroDivisionError("by nought")))
        fault = run_trial(rig, motion, "map", 0, 1)
    assert not isinstance(refused, UnsupportedError)
    assert not isinstance(fault, UnsupportedError)
    assert (refused["outcome"], refused["reasons"]) == ("refused", ["no motion in it"])
    assert fault["outcome"] == "fault"
    assert "ZeroDivisionError: by nought (test_campaign.py:" in fault["reasons"][0]
    results = {0: refused, 1: fault, 2: Lost("its process was killed by SIGKILL, 2 times")}
    monkeypatch.setattr(truewrench.campaign.run, "in_processes", lambda *_: iter(results.items()))
    summary = campaign(rig, 3, tmp_path).summary
    assert summary["outcomes"] == {"usable": 0, "not_usable": 0, "refused": 1, "faults": 2}
    assert not summary["verdict"]["usable"]
    assert summary["reasons"]["its process was killed by SIGKILL, # times"] == 1
    assert pq.read_table(tmp_path / "trials")["outcome"].to_pylist() == ["refused", "fault", "fault"]


def test_unsupported_rig_writes_nothing(tmp_path: Path, started: list[int]) -> None:
    sensor = SETTINGS["sensor"] | {"lowpass_hz": 10}
    with pytest.raises(UnsupportedError):
        campaign(Rig.from_mapping(SETTINGS | {"sensor": sensor}), 2, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_an_arm_is_simulated_and_calibrated_like_a_free_body(tmp_path: Path, started: list[int]) -> None:
    path = robots.path("ur10_ground")
    settings = load_rig(path).to_mapping()
    settings["plan"]["duration"] = 6
    settings["simulate"] |= {"rate": 100, "sensor_rate": 100}
    arm = Rig.from_mapping(settings, path)
    campaign(arm, 2, tmp_path)
    first, second = stored(tmp_path)
    assert [row["outcome"] for row in (first, second)] == ["calibrated"] * 2
    assert first["rms_error"] != second["rms_error"]
    run = simulate_arm(arm, seed=trial_seed(0, 1))
    found = calibrate(arm, run.log, threads=1, held_out=False)
    unit = arm.sensor.range_array / arm.sensor.channel_scale[:, None]
    np.testing.assert_array_equal(second["error"], ((found.gain - run.truth.gain) * unit).ravel())


def drawn_rows(trials: int, factor: float = 1.0, **changes: Any) -> pa.Table:
    """Rows of an estimator whose errors are `factor` times what it states; gains correlated, 0.5 each."""
    draw = np.random.default_rng(3)
    rows = []
    for trial in range(trials):
        z = factor * (np.sqrt(0.5) * draw.standard_normal(36) + np.sqrt(0.5) * draw.standard_normal())
        std = 1e-3 * np.ones(36)
        covariance = np.outer(std, std) * (0.5 * np.eye(36) + 0.5)
        squared, freedom = nees(z * std, covariance)
        row = dict.fromkeys(SCHEMA.names) | {
            "trial": trial, "seed": trial, "outcome": "calibrated", "usable": True, "reasons": [],
            "rms_error": np.sqrt(np.mean((z * std) ** 2)), "rms_stated": 1e-3, "rms_oracle": 0.8e-3,
            "nees": squared, "nees_dof": freedom, "largest_deviation": np.abs(z).max(),
            "coverage": np.mean(np.abs(z) <= 1.96), "masked": 0.25, "seconds": 0.5,
            "error": z * std, "std": std,
        }  # fmt: skip
        rows.append(row | changes)
    return pa.Table.from_pylist(rows, schema=SCHEMA)


def test_honest_estimator_passes_and_an_overconfident_one_does_not(rig: Rig) -> None:
    honest = summarise(rig, drawn_rows(500), "map", 0).summary["usable_trials"]
    low, high = honest["nees_honest_95"]
    assert low < honest["nees_mean"] < high
    assert honest["coverage_95"][0] < 0.95 < honest["coverage_95"][1]
    assert honest["rms_over_stated"] == pytest.approx(1.0, abs=0.1)
    assert honest["efficiency"] == pytest.approx(0.64, abs=0.1)
    assert honest["masked"] == pytest.approx(0.25)
    bold = summarise(rig, drawn_rows(500, 1.3), "map", 0).summary["usable_trials"]
    assert bold["nees_mean"] > bold["nees_honest_95"][1]
    assert bold["coverage_95"][1] < 0.95


def test_dependent_gains_count_for_fewer_than_their_number() -> None:
    draw = np.random.default_rng(0)
    covered = draw.random((400, 36)) < 0.95
    dependent = np.repeat(covered[:, :1], 36, axis=1)
    wide, narrow = (np.diff(cluster_interval(c.mean(axis=1), 36))[0] for c in (dependent, covered))
    assert wide == pytest.approx(np.diff(wilson_interval(covered[:, 0].sum(), 400))[0], rel=0.01)
    assert narrow == pytest.approx(wide / 6.0, rel=0.2)


@pytest.mark.parametrize(("successes", "trials"), [(0, 7), (95, 100), (40, 40)])
def test_interval_of_a_share_is_wilsons(successes: int, trials: int) -> None:
    exact = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((exact.low, exact.high), abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({}, False),
        ({"largest_deviation": 6.1}, True),
        ({"largest_deviation": 6.1, "usable": False}, False),
        ({"nees": 106.0}, True),  # chi-square of 36: 1e-8 beyond 105.4
        ({"nees": 104.0}, False),
        ({"nees": None}, True),  # usable without a covariance
    ],
)
def test_wrong_and_confident_is_six_sigma_or_an_impossible_nees_of_a_usable_result(
    rig: Rig, changes: dict[str, Any], wrong: bool
) -> None:
    rows = drawn_rows(2, 0.5, **changes)
    assert wrong_and_confident(rows).tolist() == [wrong, wrong]
    summary = summarise(rig, rows, "map", 0).summary
    assert summary["wrong_and_confident"]["count"] == 2 * wrong
    assert any("wrong and confident" in reason for reason in summary["verdict"]["reasons"]) == wrong


def test_truth_that_is_not_drawn_from_the_priors_is_said(rig: Rig) -> None:
    rows = drawn_rows(2)
    assert all(summarise(rig, rows, "map", 0).summary["drawn_from_priors"].values())
    simulated = {"gain": "nominal", "offset": "none", "payload": "nominal", "time_offset": "random"}
    fixed = summarise(Rig.from_mapping(SETTINGS | {"simulate": simulated}), rows, "map", 0)
    assert fixed.summary["drawn_from_priors"] == {
        "gain": False, "offset": False, "payload": True, "time_offset": True,
    }  # fmt: skip


def test_pictures_need_two_trials_and_stand_errors_beyond_their_frame(rig: Rig, tmp_path: Path) -> None:
    for draw in (nees_figure, sigma_figure, coverage_figure):
        assert not draw(tmp_path / "none.png", summarise(rig, drawn_rows(1), "map", 0))
        assert not (tmp_path / "none.png").exists()
        assert draw(tmp_path / "some.png", summarise(rig, drawn_rows(20, 30.0), "map", 0))


def test_command_prints_its_summary_and_exits_with_its_verdict(
    tmp_path: Path, started: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(SETTINGS))

    def run(*words: str) -> int:
        return main(["campaign", str(path), "-o", str(tmp_path / "out"), *words])

    assert run("--trials", "2", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == {"usable": True, "reasons": []}
    assert document["figures"]["outcomes"]["usable"] == 2
    assert all(Path(output).exists() for output in document["outputs"])
    assert run("--trials", "2") == 0
    assert "NOTHING AGAINST THE ESTIMATOR" in capsys.readouterr().out
    assert run("--trials", "2", "--estimator", "ls", "--restart") == 3
    assert "no trial is usable" in capsys.readouterr().out
    assert run("--trials", "0") == 2
