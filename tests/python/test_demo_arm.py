"""Claims about the demonstration with an arm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.image import imread

from truewrench import robots
from truewrench.cli import main
from truewrench.demo import arm as demo_arm
from truewrench.demo.arm import _copy, run_arm
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.rig import Rig, load_rig
from truewrench.report.figures.arm import driven_figure, gain_figure
from truewrench.robot.arm import robot_of


def test_an_arm_that_is_neither_packaged_nor_a_rig_is_refused_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`pandas` \\(nearest: `panda`\\)"):
        run_arm("pandas", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_folder_of_results_holds_rig_and_robot(tmp_path: Path) -> None:
    packaged = load_rig(robots.path("panda"))
    copied = _copy(packaged, tmp_path / "out")
    assert copied.path == tmp_path / "out" / "rig.yaml"
    assert copied.urdf_path == tmp_path / "out" / "panda.urdf"
    assert robot_of(copied).joints == robot_of(packaged).joints
    _copy(copied, tmp_path / "out")  # a rig that is already there
    assert copied.to_mapping() == load_rig(tmp_path / "out" / "rig.yaml").to_mapping()


class Sines:
    """A plan that took no optimiser."""

    prediction, predicted_rms, seconds = None, 0.3, 0.0

    def __init__(self, rig: Rig, violations: tuple[str, ...] = ()) -> None:
        self.rig, self.violations, self.feasible = rig, violations, not violations

    def write(self, path: Path) -> tuple[Path, Path]:
        time = np.linspace(0.0, 12.0, 601)
        swing = 0.4 * np.sin(np.pi * time / 12.0) ** 4
        start = np.array(self.rig.motion.initial_position)
        frequency = 0.1 * np.array([4, 6, 5, 3, 6, 4, 7])
        q = start + swing[:, None] * np.sin(2.0 * np.pi * frequency * time[:, None] + np.arange(7))
        names = ",".join(["time_s", *(f"q_{name}" for name in robot_of(self.rig).joints)])
        np.savetxt(path, np.column_stack([time, q]), delimiter=",", header=names, comments="")
        beside = path.with_name(path.name + ".plan.yaml")
        beside.write_text("feasible: true\n")
        return path, beside


@pytest.fixture
def small_rig(tmp_path: Path) -> Path:
    """An arm in gravity whose sensor is good enough for a motion of 12 s."""
    settings = load_rig(robots.path("panda_ground")).to_mapping()
    settings["motion"]["robot"]["urdf"] = str(robots.path("panda_ground").with_name("panda.urdf"))
    settings["payloads"]["default"]["uncertainty"] = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    settings["sensor"]["time_offset_prior"] = 0
    settings["sensor"]["noise"] = [0.005] * 3 + [0.0005] * 3
    settings["plan"]["duration"] = 12
    settings["simulate"] |= {"rate": 100, "sensor_rate": 100}
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


def test_chain_ends_with_a_verdict_and_every_file(
    small_rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo_arm, "make_plan", lambda rig, progress: Sines(rig))
    out = tmp_path / "out"
    status = main(["demo", "--arm", str(small_rig), "-o", str(out), "--json"])
    said = json.loads(capsys.readouterr().out)
    assert all(Path(file).stat().st_size > 0 for file in said["outputs"])
    calibration = yaml.safe_load((out / "calibration.yaml").read_text())
    validation = yaml.safe_load((out / "validation.yaml").read_text())
    usable = calibration["verdict"]["usable"] and validation["verdict"]["usable"]
    assert status == said["status"] == (0 if usable else 3)
    assert said["verdict"]["usable"] == usable
    truth = yaml.safe_load((out / "run.csv.truth.yaml").read_text())
    assert yaml.safe_load((out / "validation.csv.truth.yaml").read_text())["gain"] == truth["gain"]
    error = (np.array(calibration["gain"]) - truth["gain"]) / np.array(calibration["gain_std"])
    assert np.sqrt(np.mean(error**2)) < 1.6
    assert said["figures"]["rms_error"] < 0.1 * said["figures"]["rms_start"]


def test_nothing_moves_without_a_feasible_plan(
    small_rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_arm, "make_plan", lambda rig, progress: Sines(rig, ("the wrench is too large",)))
    result = run_arm(str(small_rig), tmp_path / "out")
    assert result["verdict"] == {"usable": False, "reasons": ["the wrench is too large"]}
    assert not (tmp_path / "out" / "run.csv").exists()


def test_a_rig_without_an_arm_is_refused(tmp_path: Path, settings: dict[str, Any]) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(settings))
    with pytest.raises(UnsupportedError, match="joints"):
        run_arm(str(path), tmp_path / "out")


def test_pictures_of_any_number_of_joints_and_channels_can_be_drawn(tmp_path: Path) -> None:
    time, rng = np.linspace(0, 5, 100), np.random.default_rng(0)
    joints = [f"joint_{k}" for k in range(9)]
    motion = np.sin(time[:, None] + np.arange(9))
    wrench = time[:50], rng.uniform(-0.5, 0.5, (50, 6))
    driven_figure(tmp_path / "driven.png", joints, time, motion, 0.01 * motion, wrench, "Nine joints.")
    sigma = np.exp(rng.normal(size=(8, 6))) * 1e-3
    channels = [f"gauge {k}" for k in range(8)]
    gain_figure(tmp_path / "gain.png", channels, [("a", sigma), ("b", 2 * sigma)], sigma, "Eight gauges.")
    for name in ("driven", "gain"):
        picture = imread(tmp_path / f"{name}.png")
        assert picture.shape[0] > 500
        assert picture[:, :, :3].std() > 0.05
