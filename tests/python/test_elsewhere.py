"""A tool.yaml or calibration.yaml leads to the robot that its rig named, wherever it lies."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tool_cases import a_tool

from truewrench import robots
from truewrench.model.rig import load_rig
from truewrench.model.rig.elsewhere import within
from truewrench.model.rig.tool_rig import load_tool_rig
from truewrench.robot.arm import robot_of
from truewrench.tool.reading import read_tool


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    source = robots.path("panda_ground")
    (tmp_path / "robot").mkdir()
    shutil.copy(source.with_name("panda.urdf"), tmp_path / "robot" / "arm.urdf")
    data = yaml.safe_load(source.read_text())
    data["motion"]["robot"]["urdf"] = "robot/arm.urdf"
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
    return tmp_path / "rig.yaml"


def test_a_tool_in_another_folder_finds_its_robot(
    rig_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool = replace(a_tool(), rig=load_tool_rig(rig_file))
    (tmp_path / "out" / "deep").mkdir(parents=True)
    path = tmp_path / "out" / "deep" / "tool.yaml"
    tool.write_yaml(path)
    assert yaml.safe_load(path.read_text())["rig"]["motion"]["robot"]["urdf"] == "../../robot/arm.urdf"
    monkeypatch.chdir(tmp_path / "out")  # as from anywhere
    found = read_tool(os.path.join("deep", "tool.yaml"))
    assert robot_of(found.rig).joints == robot_of(tool.rig).joints
    np.testing.assert_array_equal(found.covariance, tool.covariance)


def test_a_rig_named_from_where_one_stands_is_seen_from_the_file(
    rig_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = load_rig("rig.yaml")
    held = within(rig.to_mapping(), rig, Path("out") / "calibration.yaml")
    assert held["motion"]["robot"]["urdf"] == "../robot/arm.urdf"
    assert rig.to_mapping()["motion"]["robot"]["urdf"] == "robot/arm.urdf"


def test_absolute_paths_and_rigs_without_a_robot_stay(rig_file: Path, tmp_path: Path) -> None:
    data = yaml.safe_load(rig_file.read_text())
    data["motion"]["robot"]["urdf"] = str(tmp_path / "robot" / "arm.urdf")
    rig_file.write_text(yaml.safe_dump(data))
    rig = load_rig(rig_file)
    assert within(rig.to_mapping(), rig, tmp_path / "a" / "b.yaml") == rig.to_mapping()
    plain = a_tool().rig
    assert within(plain.to_mapping(), plain, tmp_path / "a" / "b.yaml") == plain.to_mapping()
