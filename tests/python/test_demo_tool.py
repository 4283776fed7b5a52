"""Claims about the demonstration of an unknown gripper."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from truewrench.cli import main
from truewrench.demo import tool as demo
from truewrench.demo.tool import FINGERTIP, GRIPPER, PRESS, Size
from truewrench.tool.reading import read_tool


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo") / "out"
    demo.run_tool(out, size=Size(poses=6, dwell=2.0, record=6.0))
    return out


def test_gripper_is_found_within_its_sigma(done: Path) -> None:
    tool = read_tool(done / "tool.yaml")
    assert tool.verdict.usable, tool.verdict.reasons
    assert abs(tool.mass - GRIPPER["mass"]) < 4.0 * tool.mass_std
    away = tool.center_of_mass - GRIPPER["center_of_mass"]
    assert (np.abs(away) < 4.0 * tool.center_of_mass_std).all()
    assert "payloads" not in yaml.safe_load((done / "rig.yaml").read_text())


def test_the_press_is_read_where_it_was_and_nothing_elsewhere(done: Path) -> None:
    table = np.genfromtxt(done / "contact.csv", delimiter=",", names=True)
    wrench = np.column_stack([table[f"cf{axis}"] for axis in "xyz"])
    std = np.column_stack([table[f"cf{axis}_std"] for axis in "xyz"])
    time = 1e-9 * (table["time_ns"] - table["time_ns"][0])
    seen = np.isfinite(wrench).all(axis=1)
    touched = (time >= 0.45 * 6.0) & (time <= 0.45 * 6.0 + 1.5)
    assert (np.abs(wrench[seen & ~touched]) < 6.0 * std[seen & ~touched]).all()
    at = np.flatnonzero(seen & touched)[np.argmax(np.linalg.norm(wrench[seen & touched], axis=1))]
    np.testing.assert_allclose(wrench[at], PRESS, atol=0.5)
    moment = np.array([table[f"cm{axis}"][at] for axis in "xyz"])
    np.testing.assert_allclose(moment, np.cross(FINGERTIP, wrench[at]), atol=0.05)


def test_command_hands_on_verdict_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    verdict = {"usable": False, "reasons": ["no"]}
    answer = {"outputs": ["a"], "figures": {"mass": 1.0}, "verdict": verdict, "text": ""}
    monkeypatch.setattr(demo, "run_tool", lambda output, seed, progress: answer)
    assert main(["demo", "--tool", "-o", str(tmp_path / "out"), "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["figures"] == {"mass": 1.0}


def test_two_demonstrations_at_once_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--tool", "--arm", "panda", "-o", str(tmp_path / "out")]) == 2
    assert "--tool: found --arm beside it" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
