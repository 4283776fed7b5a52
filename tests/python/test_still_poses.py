"""Static poses alone: the gains of force from one payload, all of them from several, and no more."""

from __future__ import annotations

import csv
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.stats import chi2

import truewrench as tw
from truewrench.calibrating.still_agreement import agreement_of_still
from truewrench.calibrating.still_poses import estimate_still, only_still
from truewrench.cli import main
from truewrench.io.tables import GRAVITY, TWIST, write_table
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of

Array = NDArray[np.float64]

ONE = {"default": (0.8, [0.002, -0.001, 0.02])}  # hung close to the sensor: its moment hardly matters
SEVERAL = {
    "a": (0.8, [0.06, 0.0, 0.03]),
    "b": (0.8, [-0.03, 0.06, 0.03]),
    "c": (0.8, [0.0, -0.02, 0.1]),
    "d": (0.7, [0.0, 0.0, -0.02]),
}
FORCE: list[float | None] = [0.05, 0.05, 0.05, None, None, None]


def settings_of(payloads: dict[str, Any], required: Any = 0.05, uncertainty: float = 0.0) -> dict[str, Any]:
    known = {"mass": uncertainty, "center_of_mass": 0.2 * uncertainty, "inertia": 0}
    return {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": "payload_on_sensor",
            "noise": [0.02] * 3 + [0.002] * 3,
            "range": [10] * 3 + [1] * 3,
            "gain_prior": 0.1,
        },
        "payloads": {
            name: {
                "mass": mass,
                "center_of_mass": center,
                "inertia": {"xx": 4e-3, "yy": 4e-3, "zz": 1e-3},
                "uncertainty": known,
            }
            for name, (mass, center) in payloads.items()
        },
        "motion": {"source": "twist", "of": "sensor", "noise": [1e-4] * 6},
        "gravity": [0, 0, -9.81],
        "required": required,
    }


def directions(count: int) -> Array:
    """(count, 3) unit vectors spread over the sphere."""
    k = np.arange(count) + 0.5
    z, around = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.column_stack([np.sqrt(1.0 - z**2) * np.cos(around), np.sqrt(1.0 - z**2) * np.sin(around), z])


def poses(
    rig: Rig, seed: int, count: int = 12, *, held: int = 1, sign: float = 1.0, walk: float = 1e-4
) -> tuple[list[Log], Array]:
    """A log a payload, its true body drawn, rows 3 s apart or dwells of `held` rows; and the gain."""
    draw, sensor = np.random.default_rng(seed), rig.sensor
    units = sensor.channel_scale[:, None] / sensor.range_array
    gain = np.eye(6) + sensor.gain_prior * draw.standard_normal((6, 6)) * units
    logs = []
    for name, spec in rig.payloads.items():
        time = ((3.0 * np.arange(count))[:, None] + 0.01 * np.arange(held)).ravel()
        fall = np.repeat(9.81 * directions(count), held, axis=0)
        mass = spec.mass * (1.0 + spec.uncertainty.mass * draw.standard_normal())
        center = spec.center_of_mass_array + spec.uncertainty.center_of_mass * draw.standard_normal(3)
        force = sign * mass * fall
        wandering = np.cumsum(
            np.sqrt(np.diff(time, prepend=0.0))[:, None] * draw.standard_normal((time.size, 6)), 0
        )
        offset = 0.1 * sensor.range_array * draw.standard_normal(6) + walk * sensor.range_array * wandering
        noise = sensor.noise_array * draw.standard_normal((time.size, 6))
        raw = np.hstack([force, np.cross(center, force)]) @ gain.T + offset + noise
        twist = np.zeros((time.size, 6)) if held == 1 else 1e-4 * draw.standard_normal((time.size, 6))
        logs.append(Log(None, name, "", np.rint(1e9 * time).astype(np.int64), raw, twist=twist, gravity=fall))
    return logs, gain


def written(log: Log, path: Path) -> Path:
    assert log.twist is not None
    assert log.gravity is not None
    columns: dict[str, NDArray[Any]] = {"time_ns": log.time_ns}
    columns |= {f"raw_{i}": channel for i, channel in enumerate(log.raw.T)}
    columns |= dict(zip(TWIST, log.twist.T, strict=True)) | dict(zip(GRAVITY, log.gravity.T, strict=True))
    write_table(path, columns)
    return path


@pytest.mark.parametrize("held", [1, 100])
def test_one_payload_gives_the_force_axes_and_leaves_the_others_empty(tmp_path: Path, held: int) -> None:
    settings = settings_of(ONE, FORCE)
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    logs, gain = poses(Rig.from_mapping(settings), 1, held=held)
    log = written(logs[0], tmp_path / "poses.csv")
    words = ["calibrate", tmp_path / "rig.yaml", log, "-o", tmp_path / "out"]
    assert main([str(word) for word in words]) == 0
    calibration = tw.load_calibration(tmp_path / "out" / "calibration.yaml")
    assert list(calibration.axes.values()) == [True] * 3 + [False] * 3
    assert np.abs((calibration.gain - gain)[:, :3] / calibration.gain_std[:, :3]).max() < 4.0
    assert len(calibration.verdict.undetermined) == 18
    assert all("moment" in u.words for u in calibration.verdict.undetermined)
    assert calibration.verdict.blind_to[0].kind == "cable"
    out = tmp_path / "applied.csv"
    assert main(["apply", str(tmp_path / "out" / "calibration.yaml"), str(log), "-o", str(out)]) == 0
    with out.open(encoding="utf-8") as file:
        first = next(csv.DictReader(file))
    assert [first[k] for k in ("mx", "my", "mz", "mx_std")] == [""] * 4
    assert float(first["fx_std"]) > 0.0


def test_what_is_not_asked_for_refuses_nothing_and_what_is_asked_for_does() -> None:
    logs, _ = poses(Rig.from_mapping(settings_of(ONE)), 1)
    refused = tw.calibrate(Rig.from_mapping(settings_of(ONE)), logs)
    assert not refused.verdict.usable
    assert "accuracy: the gain of" in refused.verdict.reasons[0]
    assert [refused.axes[axis] for axis in ("fx", "fy", "fz")] == [True] * 3


def test_a_gain_that_was_right_is_not_held_against_the_new_one_for_the_walk_of_the_offset() -> None:
    """Both have the same poses and the same walk: neither is better."""
    settings = settings_of(ONE, FORCE)
    right = deepcopy(settings)
    right["sensor"]["gain_prior"] = 2e-3
    for seed in range(8):
        logs, _ = poses(Rig.from_mapping(right), seed, 60, walk=1.6e-3)
        calibration = tw.calibrate(Rig.from_mapping(settings), logs)
        assert calibration.verdict.usable, calibration.verdict.reasons
        for axis in ("fx", "fy", "fz"):
            improvement = calibration.improvement[axis]
            assert improvement.held_out
            assert improvement.new < 1.25 * improvement.nominal


def test_several_centres_of_mass_give_the_moments_too() -> None:
    rig = Rig.from_mapping(settings_of(SEVERAL, uncertainty=1e-3))
    logs, gain = poses(rig, 2)
    found = tw.calibrate(rig, logs)
    assert found.verdict.usable
    assert all(found.axes.values())
    assert not found.verdict.undetermined
    d = (found.gain - gain).ravel()
    assert d @ np.linalg.solve(found.covariance[:36, :36], d) < chi2.ppf(1.0 - 1e-4, 36)
    assert all(axis.held_out and axis.better is True for axis in found.improvement.values())


@pytest.mark.parametrize("payloads", [ONE, SEVERAL], ids=["one", "several"])
def test_sigma_is_what_the_errors_are(payloads: dict[str, Any]) -> None:
    rig = Rig.from_mapping(settings_of(payloads, uncertainty=5e-3) | {"gravity_tilt_prior": 0})
    squares = []
    for seed in range(20):
        logs, gain = poses(rig, seed)
        found = estimate_still(rig, logs).estimate
        d = (found.gain - gain).ravel()
        squares.append(d @ np.linalg.solve(found.covariance[:36, :36], d))
    assert chi2.ppf(1e-4, 720) < sum(squares) < chi2.ppf(1.0 - 1e-4, 720)


def crept(log: Log, share: float, seed: int) -> Log:
    """In any order, where a pose has a share of the load of the one before in place of its own."""
    order = np.random.default_rng(seed).permutation(len(log.raw))
    assert log.gravity is not None
    raw = log.raw[order]
    settled = raw - raw.mean(axis=0)
    lags = np.roll(settled, 1, axis=0) - settled
    lags[0] = 0.0
    return replace(log, raw=raw + share * lags, gravity=log.gravity[order])


def test_what_scatters_the_poses_is_within_sigma_as_far_as_it_follows_them() -> None:
    squares: dict[Any, float] = {"auto": 0.0, 0: 0.0}
    for stated in squares:
        settings = settings_of(SEVERAL, uncertainty=5e-3) | {"gravity_tilt_prior": 0}
        settings["sensor"] |= {"noise": [2e-3] * 3 + [2e-4] * 3, "discrepancy": stated}
        rig = Rig.from_mapping(settings)
        for seed in range(20):
            logs, gain = poses(rig, seed, walk=0.0)
            found = tw.calibrate(rig, [crept(log, 4e-3, seed) for log in logs], held_out=False)
            d = (found.gain - gain).ravel()
            squares[stated] += d @ np.linalg.solve(found.covariance[:36, :36], d) / 36.0 / 20.0
            said = [assumed for assumed in found.assumed if "scatter of the poses" in assumed.what]
            assert bool(said) == (stated == "auto")
    assert squares[0] > 1.6
    assert squares["auto"] < 1.4


@pytest.mark.parametrize("payloads", [ONE, SEVERAL], ids=["one", "several"])
def test_poses_in_several_logs_say_what_they_say_in_one(payloads: dict[str, Any]) -> None:
    """But for the offset, which each log has anew: here from the middle on."""
    rig = Rig.from_mapping(settings_of(payloads, uncertainty=1e-3))
    logs, gain = poses(rig, 5, 24)
    split = [rows_of(log, slice(half * 12, half * 12 + 12)) for log in logs for half in (0, 1)]
    one, several = tw.calibrate(rig, logs), tw.calibrate(rig, split)
    assert several.axes == one.axes
    std = np.sqrt(np.diag(one.covariance)[:36])
    assert np.abs((several.gain - one.gain).ravel() / std).max() < 2.0
    assert np.all(np.sqrt(np.diag(several.covariance)[:36]) > 0.99 * std)
    d = (several.gain - gain).ravel()
    assert d @ np.linalg.solve(several.covariance[:36, :36], d) < chi2.ppf(1.0 - 1e-4, 36)


@pytest.mark.parametrize("names", ["abcd", "aa"], ids=["several payloads", "one payload"])
def test_a_log_with_another_payload_than_stated_is_told_by_the_others(names: str) -> None:
    """Gain and walk would follow it: 5% of mass, and a gain between the two."""
    rig = Rig.from_mapping(settings_of(SEVERAL, uncertainty=1e-3) | {"gravity_tilt_prior": 0})
    for seed in range(4):
        logs, _ = poses(rig, seed, 24)
        if names == "aa":
            logs = [rows_of(logs[0], slice(12)), rows_of(logs[0], slice(12, 24))]
        assert np.min(agreement_of_still(rig, logs, estimate_still(rig, logs))) > 1e-4
        raw = logs[1].raw + 0.05 * (logs[1].raw - logs[1].raw.mean(axis=0))
        spoilt = [logs[0], replace(logs[1], raw=raw), *logs[2:]]
        (reason,) = [x for x in tw.calibrate(rig, spoilt).verdict.reasons if "tell different gains" in x]
        assert ("log 2 and the others" if names == "abcd" else "one log and the other") in reason


def test_a_payload_that_slips_between_poses_is_told() -> None:
    rig = Rig.from_mapping(settings_of(ONE, FORCE, uncertainty=1e-3) | {"gravity_tilt_prior": 0})
    for seed in range(3):
        (log,), _ = poses(rig, seed, 24)
        assert tw.calibrate(rig, log).verdict.usable
        raw = log.raw.copy()
        raw[12:] += 0.05 * (raw[12:] - raw.mean(axis=0))
        reasons = tw.calibrate(rig, replace(log, raw=raw)).verdict.reasons
        assert any("the first and the last poses of the log tell different gains" in x for x in reasons)


def test_mistakes_of_the_set_up_are_refused() -> None:
    rig = Rig.from_mapping(settings_of(ONE, FORCE))
    logs, _ = poses(rig, 3, sign=-1.0)
    assert not tw.calibrate(rig, logs).verdict.usable
    logs, _ = poses(rig, 3)
    logs[0].raw[5] += [0.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    touched = tw.calibrate(rig, logs).verdict
    assert not touched.usable
    assert "contact" in " ".join(touched.reasons)
    few, _ = poses(rig, 3, count=4)
    assert any("too few poses" in reason for reason in tw.calibrate(rig, few).verdict.reasons)


def test_a_motion_is_no_pose_and_free_fall_weighs_nothing() -> None:
    rig = Rig.from_mapping(settings_of(ONE))
    logs, _ = poses(rig, 0, held=100)
    assert only_still(rig, logs)
    assert logs[0].twist is not None
    assert not only_still(rig, [replace(logs[0], twist=logs[0].twist + 0.1)])
    settings = deepcopy(settings_of(ONE))
    settings["gravity"] = [0, 0, 0]
    assert not only_still(Rig.from_mapping(settings), logs)


def test_an_unknown_body_is_found_beside_known_ones() -> None:
    truth = Rig.from_mapping(settings_of(SEVERAL))
    settings = settings_of(SEVERAL)
    settings["payloads"]["b"] = "unknown"
    rig = Rig.from_mapping(settings)
    squares, masses = [], []
    for seed in range(6):
        logs, gain = poses(truth, seed)
        found = estimate_still(rig, logs).estimate
        d = (found.gain - gain).ravel()
        squares.append(d @ np.linalg.solve(found.covariance[:36, :36], d))
        body = found.payloads["b"]
        masses.append((1.5 * (1.0 + body.mean[0]) - SEVERAL["b"][0]) / (1.5 * body.std[0]))
    assert sum(squares) < chi2.ppf(1.0 - 1e-4, 36 * 6)
    assert np.abs(masses).max() < 4.0
    calibration = tw.calibrate(rig, logs)
    assert calibration.verdict.usable
    assert any("unknown payload `b`" in note for note in calibration.figures["notes"])
    alone = tw.calibrate(rig, logs[1])
    assert "no log carries a known payload" in alone.verdict.reasons[0]


@pytest.mark.parametrize("prior", [1e6, 1e80, 1e200])
@pytest.mark.parametrize("count", [2, 3, 12])
def test_a_prior_however_wide_ends_in_a_reason(prior: float, count: int) -> None:
    logs, gain = poses(Rig.from_mapping(settings_of(SEVERAL)), 1)
    logs = [
        replace(log, time_ns=log.time_ns[:count], raw=log.raw[:count], twist=np.zeros((count, 6)))
        for log in logs
    ]
    logs = [replace(log, gravity=None if log.gravity is None else log.gravity[:count]) for log in logs]
    settings = settings_of(SEVERAL)
    settings["sensor"]["gain_prior"] = prior
    found = tw.calibrate(Rig.from_mapping(settings), logs)
    assert np.isfinite(found.covariance).all()
    assert found.verdict.usable or found.verdict.reasons
    assert np.abs((found.gain - gain) / found.gain_std).max() < 5.0
