"""`truewrench tool` from files to files, its exit statuses, and nothing written on 2."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from tool_cases import a_rig, pose_log, write_log

from truewrench.cli import main
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.model import read_tool

MASS, CENTER = 2.0, np.array([0.01, -0.02, 0.09])


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(a_rig()))
    write_log(tmp_path / "poses.csv", pose_log(tool_rig(a_rig()), MASS, CENTER)[0])
    return tmp_path


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


def test_from_poses_to_a_tool_its_page_and_its_exports(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = files / "out"
    options = ["--export", "ur,franka,urdf,abb,kuka,ros", "--known", "mass=2.0:0.01"]
    assert run("tool", files / "rig.yaml", files / "poses.csv", "-o", out, *options, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"]["usable"] is True
    assert document["figures"]["mass"] == pytest.approx(MASS, rel=0.02)
    tool = read_tool(out / "tool.yaml")
    assert tool.mass == document["figures"]["mass"]
    assert all((Path(path)).is_file() for path in document["outputs"])
    page = (out / "tool.html").read_text()
    assert page.index("Usable") < page.index("centre of mass")
    assert "not determined" in page
    assert page.count("<figcaption>") == 4
    assert "<script" not in page


def test_words_name_what_is_not_determined(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("tool", files / "rig.yaml", files / "poses.csv", "-o", files / "out") == 0
    text = capsys.readouterr().out
    assert text.startswith("usable")
    assert "inertia xx      not determined" in text
    assert "The tool was not accelerated" in text


def test_a_set_up_that_is_not_as_stated_ends_in_3(files: Path) -> None:
    rig = a_rig(sensor={"feels": "sensor_on_payload"})
    (files / "wrong.yaml").write_text(yaml.safe_dump(rig))
    assert run("tool", files / "wrong.yaml", files / "poses.csv", "-o", files / "out") == 3
    verdict = read_tool(files / "out" / "tool.yaml").verdict
    assert "sign, axes or units of the log are not as stated" in verdict.reasons[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--known", "mass=2"], "--known: found `mass=2`, expected NAME=VALUE:SIGMA"),
        (["--known", "weight=2:1"], "known: found `weight`, expected one of mass"),
        (["--flange", "0,0,0"], "--flange: found `0,0,0`, expected 6 numbers"),
        (["--housing", "-1,0,0,0"], "--housing: found a mass of -1"),
        (["--export", "ur,fanuc"], "--export: found `fanuc`, expected a list of ur"),
        (["--on", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
    ],
)
def test_bad_options_are_2_and_write_nothing(
    files: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("tool", files / "rig.yaml", files / "poses.csv", "-o", files / "out", *options) == 2
    assert words in capsys.readouterr().err
    assert not (files / "out").exists()
