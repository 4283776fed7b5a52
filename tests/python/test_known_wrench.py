"""From a table of dead weights to a verdict: what is accepted, what is refused, and what is said."""

from __future__ import annotations

import io
import json
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from rich.console import Console
from scipy.stats import binom

import truewrench as tw
from truewrench.cli import main
from truewrench.estimation.known_wrench import estimate_from_known_wrench
from truewrench.estimation.log_agreement import agreement_of_known_wrenches
from truewrench.io.tables import REFERENCE, write_table
from truewrench.model.calibration import load_calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.report.summary import calibration_summary, show

Array = NDArray[np.float64]

SPAN = np.array([100.0, 100.0, 100.0, 10.0, 10.0, 10.0])
NOISE = 5e-4 * SPAN
SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": NOISE.tolist(),
        "range": SPAN.tolist(),
        "gain_prior": 0.1,
    },
    "payloads": {
        "default": {"mass": 1, "center_of_mass": [0, 0, 0], "inertia": {"xx": 1, "yy": 1, "zz": 1}},
    },
    "motion": {"noise": [1e-3] * 6},
    "reference_noise": NOISE.tolist(),
}


@pytest.fixture
def rig() -> Rig:
    return Rig.from_mapping(SETTINGS)


@pytest.fixture
def truth() -> tuple[Array, Array]:
    draw = np.random.default_rng(0)
    gain = (np.eye(6) + 0.1 * draw.normal(size=(6, 6))) * SPAN[:, None] / SPAN
    return gain, 0.05 * SPAN * draw.normal(size=6)


def weights(truth: tuple[Array, Array], rows: int = 40, seed: int = 1, rank: int = 6) -> Log:
    """Loads of up to half the range, one every half minute; of rank 3 it is one weight in many poses."""
    draw = np.random.default_rng(seed)
    wrench = 0.5 * SPAN * draw.uniform(-1.0, 1.0, (rows, 6))
    if rank == 3:
        wrench[:, 3:] = np.cross([0.02, -0.01, 0.08], wrench[:, :3])
    raw = wrench @ truth[0].T + truth[1] + NOISE * draw.normal(size=(rows, 6))
    reference = wrench + NOISE * draw.normal(size=(rows, 6))
    return Log(None, "default", "", 30 * 10**9 * np.arange(rows), raw, reference=reference)


def through_command(
    capsys: pytest.CaptureFixture[str], folder: Path, log: Log, settings: dict[str, Any], *options: str
) -> tuple[int, dict[str, Any]]:
    (folder / "rig.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    columns: dict[str, NDArray[Any]] = {"time_ns": log.time_ns}
    columns |= {f"raw_{i}": channel for i, channel in enumerate(log.raw.T)}
    if log.reference is not None:
        columns |= dict(zip(REFERENCE, log.reference.T, strict=True))
    write_table(folder / "weights.csv", columns)
    capsys.readouterr()
    words = ["calibrate", folder / "rig.yaml", folder / "weights.csv", "-o", folder / "out", "--json"]
    status = main([*map(str, words), *options])
    return status, json.loads(capsys.readouterr().out)


def test_a_table_of_weights_becomes_a_usable_calibration(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array]
) -> None:
    status, said = through_command(capsys, tmp_path, weights(truth), SETTINGS)
    assert (status, said["verdict"]["usable"]) == (0, True)
    calibration = load_calibration(tmp_path / "out" / "calibration.yaml")
    assert calibration.estimator == "reference"
    assert np.abs((calibration.gain - truth[0]) / calibration.gain_std).max() < 4.0
    assert np.abs((calibration.offset - truth[1]) / calibration.offset_std).max() < 4.0
    assert calibration.logs[0].used == 40
    assert {axis.better for axis in calibration.improvement.values()} == {True}
    assert all(axis.held_out for axis in calibration.improvement.values())
    # noise of sensor and reference in the corrected wrench; each row is predicted by the others
    expected = np.sqrt(NOISE**2 + calibration.inverse**2 @ NOISE**2)
    new = [calibration.improvement[axis].new for axis in ("fx", "fy", "fz", "mx", "my", "mz")]
    np.testing.assert_allclose(new / expected, 1.0, atol=0.35)
    assert calibration.bound is not None
    assert calibration.bound.oracle_rms < calibration.bound.rms


def test_a_table_of_another_gain_is_told_and_named(rig: Rig, truth: tuple[Array, Array]) -> None:
    """0.5% of range in one of several, which otherwise passes for noise beyond the stated."""
    gain, offset = truth
    other = gain + 5e-3 * np.random.default_rng(5).normal(size=(6, 6)) * SPAN[:, None] / SPAN
    for count in (2, 3):
        logs = [weights(truth, seed=k) for k in range(count)]
        assert tw.calibrate(rig, logs).verdict.usable
        logs[-1] = weights((other, offset), seed=count)
        found = tw.calibrate(rig, logs)
        assert not found.verdict.usable
        which = "one log and the other" if count == 2 else "log 3 and the others"
        assert any(f"{which} tell different gains" in reason for reason in found.verdict.reasons)


def test_tables_of_one_sensor_differ_by_chance(rig: Rig, truth: tuple[Array, Array]) -> None:
    """Of 24 pools a tenth has p below 0.1; and a load a log says what all in one log do."""
    p = []
    for seed in range(24):
        logs = [weights(truth, seed=10 * seed + k) for k in range(2)]
        clocks = [None] * len(logs)
        found = estimate_from_known_wrench(rig, logs, clocks=clocks)
        p.append(agreement_of_known_wrenches(rig, logs, found, clocks)[0])
    assert np.count_nonzero(np.array(p) < 0.1) <= binom.ppf(0.9999, len(p), 0.1)
    assert np.count_nonzero(np.array(p) > 0.5) >= binom.ppf(1e-4, len(p), 0.5)
    log = weights(truth, 24)
    pooled = Rig.from_mapping({**SETTINGS, "sensor": {**SETTINGS["sensor"], "pool_offsets": True}})
    each, whole = (
        tw.calibrate(pooled, logs) for logs in ([rows_of(log, slice(k, k + 1)) for k in range(24)], log)
    )
    assert each.verdict.usable
    assert np.allclose(each.gain, whole.gain, rtol=0.0, atol=0.1 * whole.gain_std)


def test_a_mis_noted_weight_is_left_out_and_named_to_the_user(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array]
) -> None:
    log = weights(truth)
    assert log.reference is not None
    log.reference[17, 2] += 9.81
    status, said = through_command(capsys, tmp_path, log, SETTINGS)
    assert status == 0
    (outlier,) = said["figures"]["fit"]["outliers"]
    assert outlier == {"log": 0, "row": 18, "time": pytest.approx(510.0)}
    calibration = load_calibration(tmp_path / "out" / "calibration.yaml")
    assert calibration.logs[0].masked == {"contradict the other rows": 1}
    console = Console(file=io.StringIO(), width=200)
    show(console, calibration_summary(calibration))
    assert "row 18 (510 s) of" in console.file.getvalue()  # type: ignore[attr-defined]


def test_one_weight_in_many_poses_leaves_18_directions(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array]
) -> None:
    status, said = through_command(capsys, tmp_path, weights(truth, 100, rank=3), SETTINGS)
    assert status == 3
    assert len(said["verdict"]["undetermined"]) == 18
    words = {found["words"] for found in said["verdict"]["undetermined"]}
    assert "moment about x, always tied to force along y: gains of all channels" in words


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("sensor", "gain_prior", 1e-300),
        ("sensor", "gain_prior", 1e6),
        ("sensor", "gain_prior", 1e200),
        ("sensor", "offset_prior", [1e-300] * 6),
        ("sensor", "offset_prior", [1e200] * 6),
        ("sensor", "noise", [1e-12] * 6),
        ("sensor", "range", [1e29] * 6),
        ("reference_noise", None, [1e6] * 6),
    ],
)
@pytest.mark.parametrize(("rows", "rank"), [(40, 6), (40, 3), (3, 6)])
def test_whatever_is_stated_ends_in_a_reason(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    truth: tuple[Array, Array],
    section: str,
    key: str | None,
    value: Any,
    rows: int,
    rank: int,
) -> None:
    settings = deepcopy(SETTINGS)
    settings[section] = settings[section] | {key: value} if key else value
    status, said = through_command(capsys, tmp_path, weights(truth, rows, rank=rank), settings)
    assert status in (0, 2, 3)
    assert said["verdict"]["usable"] or said["verdict"]["reasons"]
    assert status == 2 or (tmp_path / "out" / "report.html").exists()


def test_a_rig_that_does_not_say_how_good_the_reference_is_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array]
) -> None:
    settings = deepcopy(SETTINGS)
    del settings["reference_noise"]
    status, said = through_command(capsys, tmp_path, weights(truth), settings)
    assert status == 2
    assert "reference_noise" in said["verdict"]["reasons"][0]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("estimator", ["online", "ekf", "ls"])
def test_other_estimators_do_not_know_references(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array], estimator: str
) -> None:
    status, said = through_command(capsys, tmp_path, weights(truth), SETTINGS, "--estimator", estimator)
    assert status == 2
    assert f"`{estimator}`" in said["verdict"]["reasons"][0]


def test_logs_with_and_without_reference_are_not_mixed(rig: Rig, truth: tuple[Array, Array]) -> None:
    log = weights(truth)
    moving = replace(log, path=Path("moving.csv"), reference=None, twist=np.zeros((40, 6)))
    with pytest.raises(InputError, match=r"moving\.csv: found no ref_\* columns"):
        tw.calibrate(rig, [log, moving])


def test_noise_stated_too_small_is_found_and_told(rig: Rig, truth: tuple[Array, Array]) -> None:
    quiet = Rig.from_mapping(SETTINGS | {"reference_noise": (0.1 * NOISE).tolist()})
    assert tw.calibrate(rig, weights(truth, 200)).verdict.usable
    found = tw.calibrate(quiet, weights(truth, 200))
    assert found.verdict.usable
    assert any("noise" in assumed.what for assumed in found.assumed)


def held(truth: tuple[Array, Array], loads: int, errors: float, seed: int = 1) -> Log:
    """Loads of two seconds at 25 Hz, each with an error of its own, fraction of range."""
    draw = np.random.default_rng(seed)
    of = np.repeat(np.arange(loads), 50)
    wrench = (0.5 * SPAN * draw.uniform(-1.0, 1.0, (loads, 6)))[of]
    raw = wrench @ truth[0].T + truth[1] + (errors * SPAN * draw.normal(size=(loads, 6)))[of]
    raw += NOISE * draw.normal(size=raw.shape)
    reference = wrench + NOISE * draw.normal(size=raw.shape)
    return Log(None, "default", "", 4 * 10**7 * np.arange(50 * loads), raw, reference=reference)


def test_errors_that_last_are_said_and_do_not_refuse(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array]
) -> None:
    """Ten times the noise of a row, for as long as a load hangs."""
    status, said = through_command(capsys, tmp_path, held(truth, 60, 5e-3), SETTINGS | {"required": 0.05})
    assert (status, said["verdict"]["usable"]) == (0, True)
    calibration = load_calibration(tmp_path / "out" / "calibration.yaml")
    assert np.abs((calibration.gain - truth[0]) / calibration.gain_std).max() < 4.5
    (note,) = calibration.figures["notes"]
    assert note.startswith("errors of sensor and reference last")
    assert "white noise beside them is" in note
    assert "my 0.5" in note or "my 0.4" in note
    assert {a.where for a in calibration.assumed} == {f"channel {c}" for c in SETTINGS["sensor"]["channels"]}
    assert all(a.value == pytest.approx(5e-3, rel=0.5) for a in calibration.assumed)
    assert all(axis.better is True for axis in calibration.improvement.values())


def test_few_plateaus_are_too_few_to_trust_however_many_rows(rig: Rig, truth: tuple[Array, Array]) -> None:
    assert "too few plateaus" in " ".join(tw.calibrate(rig, held(truth, 8, 5e-3)).verdict.reasons)
    assert "too few" not in " ".join(tw.calibrate(rig, held(truth, 14, 5e-3)).verdict.reasons)


def test_weights_in_kilograms_are_suspected(rig: Rig, truth: tuple[Array, Array]) -> None:
    log = weights(truth)
    assert log.reference is not None
    verdict = tw.calibrate(rig, replace(log, reference=log.reference / 9.80665)).verdict
    assert not verdict.usable
    assert any("suspected set-up error" in reason and "9.807" in reason for reason in verdict.reasons)


@pytest.mark.parametrize("loaded", [[1, 1, 1, 1, 1, 0], [1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0]])
@pytest.mark.parametrize("period", [0.02, 10.0])
def test_an_axis_that_was_never_loaded_is_not_known_and_nothing_is_suspected(
    rig: Rig, loaded: list[int], period: float
) -> None:
    draw = np.random.default_rng(5)
    wrench = np.repeat(0.5 * SPAN * draw.uniform(-1.0, 1.0, (30, 6)) * loaded, 40, axis=0)
    raw = 1.02 * wrench + NOISE * draw.normal(size=wrench.shape)
    time_ns = (1e9 * period * np.arange(len(raw))).astype(np.int64)
    calibration = tw.calibrate(rig, Log(None, "default", "", time_ns, raw, reference=wrench))
    (reason,) = calibration.verdict.reasons
    assert "reference wrenches that load that axis by itself" in reason
    assert list(calibration.axes.values()) == [bool(x) for x in loaded]
    log = Log(None, "default", "", time_ns, raw - 1.02 * wrench, reference=0.0 * wrench)
    nothing = tw.calibrate(rig, log)
    assert nothing.verdict.reasons[0].endswith("the wrench was nearly the same in all of it")


def test_accuracy_that_is_not_reached_says_what_helps(rig: Rig, truth: tuple[Array, Array]) -> None:
    strict = Rig.from_mapping(SETTINGS | {"required": 1e-5})
    verdict = tw.calibrate(strict, weights(truth)).verdict
    assert any("more than the required" in reason for reason in verdict.reasons)


def test_as_many_rows_as_unknowns_are_too_few_to_trust(rig: Rig, truth: tuple[Array, Array]) -> None:
    assert "too few rows" in " ".join(tw.calibrate(rig, weights(truth, 8)).verdict.reasons)
    assert tw.calibrate(rig, weights(truth, 14)).verdict.usable


def test_a_dead_channel_is_named(rig: Rig, truth: tuple[Array, Array]) -> None:
    log = weights(truth)
    log.raw[:, 3] = 0.1
    verdict = tw.calibrate(rig, log).verdict
    assert not verdict.usable
    assert verdict.reasons[0].startswith("channel mx ")


def test_a_sensor_that_is_as_it_was_is_not_called_better(rig: Rig) -> None:
    unchanged = np.eye(6), np.zeros(6)
    calibration = tw.calibrate(rig, weights(unchanged, 400))
    assert calibration.verdict.usable
    assert {axis.better for axis in calibration.improvement.values()} == {"unsure"}


def test_few_rows_are_compared_on_what_was_fitted(rig: Rig, truth: tuple[Array, Array]) -> None:
    few = tw.calibrate(rig, weights(truth, 9))
    assert not any(axis.held_out for axis in few.improvement.values())
    assert "fewer than 10 rows" in few.figures["held_out"]["none_because"]
    asked = tw.calibrate(rig, weights(truth), held_out=False)
    assert asked.figures["held_out"]["none_because"] == "not asked for"


def test_other_weights_confirm_a_calibration(rig: Rig, truth: tuple[Array, Array]) -> None:
    calibration = tw.calibrate(rig, weights(truth))
    validations = [tw.validate(calibration, rig, weights(truth, 100, seed)) for seed in range(10, 30)]
    assert all(found.verdict.usable for found in validations)
    assert all(axis.better is True for found in validations for axis in found.axes.values())
    nis = [axis.nis for found in validations for axis in found.axes.values()]
    assert np.mean(nis) == pytest.approx(1.0, abs=0.05)


def test_other_weights_refute_a_gain_that_is_wrong(rig: Rig, truth: tuple[Array, Array]) -> None:
    calibration = tw.calibrate(rig, weights(truth))
    wrong = calibration.gain.copy()
    wrong[4] *= 1.02
    found = tw.validate(
        replace(calibration, gain=wrong, inverse=np.linalg.inv(wrong)), rig, weights(truth, 100, 3)
    )
    assert not found.verdict.usable
    assert not found.axes["my"].keep
    assert found.axes["fz"].keep


def test_weights_to_validate_with_need_their_noise_and_some_rows(
    rig: Rig, truth: tuple[Array, Array]
) -> None:
    calibration = tw.calibrate(rig, weights(truth))
    with pytest.raises(InputError, match="19 rows with raw channels and reference, expected at least 20"):
        tw.validate(calibration, rig, weights(truth, 19, 3))
    settings = {key: value for key, value in SETTINGS.items() if key != "reference_noise"}
    with pytest.raises(InputError, match="reference_noise: found nothing"):
        tw.validate(calibration, Rig.from_mapping(settings), weights(truth, 100, 3))


def without(*keys: str) -> dict[str, Any]:
    return {key: value for key, value in SETTINGS.items() if key not in keys}


def test_known_wrenches_need_neither_motion_nor_payload(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array]
) -> None:
    _, same = through_command(capsys, tmp_path, weights(truth), SETTINGS)
    status, said = through_command(capsys, tmp_path, weights(truth), without("motion", "payloads"))
    assert status == 0
    assert said["figures"]["gain"] == same["figures"]["gain"]
    calibration = load_calibration(tmp_path / "out" / "calibration.yaml")
    assert not calibration.rig.states_motion
    assert main(["apply", *(str(tmp_path / name) for name in ("out/calibration.yaml", "weights.csv")),
                 "-o", str(tmp_path / "applied.csv")]) == 0  # fmt: skip
    assert calibration.wrench(weights(truth).raw).shape == (40, 6)


@pytest.mark.parametrize("key", ["motion", "payloads"])
def test_logs_without_known_wrenches_need_motion_and_payload(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, truth: tuple[Array, Array], key: str
) -> None:
    log = replace(weights(truth), reference=None)
    status, said = through_command(capsys, tmp_path, log, without(key))
    assert status == 2
    assert (
        f"rig.yaml: {key}: found nothing, expected `{key}`, or ref_* columns in"
        in said["verdict"]["reasons"][0]
    )
    assert not (tmp_path / "out").exists()
    status, said = through_command(capsys, tmp_path, log, without(key, "reference_noise"))
    assert status == 2
    assert f"{key}: missing required key, which only `reference_noise`" in said["verdict"]["reasons"][0]
    with pytest.raises(InputError, match=f"{key}: found nothing, expected `{key}`, or reference wrenches"):
        tw.calibrate(Rig.from_mapping(without(key)), log)


@pytest.mark.parametrize(
    "words",
    [["simulate", "-o", "out.csv"], ["plan", "-o", "out.csv"], ["campaign", "--trials", "1", "-o", "out"],
     ["stream", "--calibrate", "-o", "out"]],
)  # fmt: skip
@pytest.mark.parametrize("key", ["motion", "payloads"])
def test_commands_say_what_such_a_rig_lacks(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: list[str], key: str
) -> None:
    rig, out = tmp_path / "rig.yaml", tmp_path / words[-1]
    rig.write_text(yaml.safe_dump(without(key)), encoding="utf-8")
    command = [words[0], *words[1:-1], str(out)]
    at = 2 if "--calibrate" in command else 1
    assert main([*command[:at], str(rig), *command[at:]]) == 2
    assert f"rig.yaml: {key}: found nothing, expected `{key}`, which" in capsys.readouterr().err
    assert not out.exists()
