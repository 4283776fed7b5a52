"""Packaged rigs of arms whose tool nobody knows: from plan to tool by the commands, truth by MuJoCo."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.stats import chi2

from truewrench import robots
from truewrench.cli import main
from truewrench.model.rig import load_rig
from truewrench.model.rig.tool_rig import load_tool_rig
from truewrench.tool.model import read_tool

# of ordinary grippers, one per arm: mass, centre of mass, inertia about it
GRIPPERS: dict[str, dict[str, Any]] = {
    "panda_tool": {
        "mass": 0.92,
        "center_of_mass": [0.003, -0.004, 0.061],
        "inertia": {"xx": 0.0021, "yy": 0.0018, "zz": 0.0009, "xy": 0.0001, "xz": 0.0, "yz": -0.0001},
    },
    "ur10_tool": {
        "mass": 2.6,
        "center_of_mass": [-0.012, 0.02, 0.11],
        "inertia": {"xx": 0.016, "yy": 0.014, "zz": 0.006, "xy": 0.0, "xz": 0.0008, "yz": -0.0006},
    },
}


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


def test_every_arm_in_the_laboratory_has_one() -> None:
    assert {
        f"{name.removesuffix('_ground')}_tool" for name in robots.NAMES if name.endswith("_ground")
    } == set(robots.TOOL_RIGS)


@pytest.mark.parametrize("name", robots.TOOL_RIGS)
def test_it_is_the_arm_in_the_laboratory_without_a_payload(name: str) -> None:
    text = robots.path(name).read_text()
    assert "payloads" not in yaml.safe_load(text)
    rig, ground = load_tool_rig(robots.path(name)), load_rig(robots.path(name.replace("_tool", "_ground")))
    for key in ("gravity", "limits", "motion"):
        assert getattr(rig, key) == getattr(ground, key)
    assert rig.sensor.gain_prior == 0.02
    assert rig.sensor.range_array.tolist() == ground.sensor.range_array.tolist()
    assert all(name in line or "truewrench" not in line for line in text.splitlines())


@pytest.mark.slow
@pytest.mark.parametrize("name", robots.TOOL_RIGS)
def test_planned_poses_find_the_tool_that_the_arm_carries(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    source = robots.path(name)
    shutil.copy(source, rig)
    settings = yaml.safe_load(source.read_text())
    urdf = settings["motion"]["robot"]["urdf"]
    shutil.copy(source.with_name(urdf), tmp_path / urdf)
    real = tmp_path / "real.yaml"  # what moves in place of an arm, with its gripper
    real.write_text(yaml.safe_dump(settings | {"payloads": {"gripper": GRIPPERS[name]}}))
    plan, log, out = tmp_path / "plan.csv", tmp_path / "poses.csv", tmp_path / "out"
    assert run("plan", rig, "--tool", "--poses", "8", "--dwell", "2", "--no-pictures", "-o", plan) == 0
    assert run("simulate", real, plan, "--seed", "3", "-o", log) == 0
    capsys.readouterr()
    assert run("tool", rig, log, "-o", out, "--json") == 0
    assert json.loads(capsys.readouterr().out)["verdict"]["usable"]
    tool, truth = read_tool(out / "tool.yaml"), yaml.safe_load(log.with_suffix(".csv.truth.yaml").read_text())
    body = truth["payloads"]["gripper"]
    assert tool.mass_std < 0.02 * body["mass"]
    assert (tool.center_of_mass_std < 4e-3).all()
    place = np.r_[tool.layout.log_mass, tool.layout.center_of_mass]
    error = tool.theta[place] - [np.log(body["mass"]), *body["center_of_mass"]]
    P = tool.covariance[np.ix_(place, place)]
    assert error @ np.linalg.solve(P, error) < chi2.ppf(0.999, 4)
    for key, (true, found, sigma) in {
        "offset": (np.array(truth["offset"]), tool.offset, tool.offset_std),
        "gain": (np.array(truth["gain"]), tool.gain, tool.gain_std),
    }.items():
        assert (np.abs(found - true) < 4.0 * sigma).all(), key
