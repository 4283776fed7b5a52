"""`truewrench tool` from files to files, its exit statuses, and nothing written on 2."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tool_cases import a_rig, pose_log, write_log

from truewrench.cli import main
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.reading import read_tool

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
        (["--housing", "1,0,0,40"], "--housing: found 40 m, expected at most 10 m (mm?)"),
        (["--flange", "0,0,0.04,0,0,90"], "--flange: found an angle of 90, expected radians (degrees?)"),
        (["--export", "ur,fanuc"], "--export: found `fanuc`, expected a list of ur"),
        (["--on", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--mounting-sigma", "inf"], "--mounting-sigma"),
        (["--tilt-sigma", "nan"], "--tilt-sigma"),
    ],
)
def test_bad_options_are_2_and_write_nothing(
    files: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("tool", files / "rig.yaml", files / "poses.csv", "-o", files / "out", *options) == 2
    assert words in capsys.readouterr().err
    assert not (files / "out").exists()


def test_nothing_of_another_tool_stays_beside_a_new_one(files: Path) -> None:
    out = files / "out"
    own = out / "tool_ros" / "mine.yaml"
    words = ["tool", files / "rig.yaml", files / "poses.csv", "-o", out]
    assert run(*words, "--export", "ur,franka,urdf,abb,kuka,ros") == 0
    own.write_text("a file of one's own")
    assert len(list(out.glob("tool*.*"))) == 7
    assert run(*words, "--export", "ur") == 0
    assert {path.name for path in out.iterdir()} == {"tool.yaml", "tool.html", "tool_ur.script", "tool_ros"}
    assert list((out / "tool_ros").iterdir()) == [own]
    own.unlink()
    (out / "tool.urdf").write_text("<robot name='arm'/>")  # an arm of one's own
    assert run(*words) == 0
    assert {path.name for path in out.iterdir()} == {"tool.yaml", "tool.html", "tool.urdf"}


def test_a_body_that_a_controller_cannot_take_is_2_and_changes_nothing(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = files / "out"
    words = ["tool", files / "rig.yaml", files / "poses.csv", "-o", out, "--export", "ur"]
    assert run(*words) == 0
    before = {path: path.read_bytes() for path in out.iterdir()}
    monkeypatch.setattr("truewrench.tool.exports._UR_LARGEST", -1.0)
    assert run(*words) == 2
    assert "kg m^2, expected 133 at most" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.iterdir()} == before


def test_inputs_are_neither_overwritten_nor_counted_twice(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, log, out = files / "rig.yaml", files / "poses.csv", files / "out"
    assert run("tool", rig, log, log, "-o", out) == 2
    assert "poses.csv: log 2: found the same content as log 1" in capsys.readouterr().err
    assert not out.exists()
    assert run("tool", rig, log, "-o", out) == 0
    before = (out / "tool.yaml").read_bytes()
    assert run("tool", rig, log, "-o", out, "--on", out / "tool.yaml") == 2
    assert "tool.yaml: found an input of the command itself" in capsys.readouterr().err
    assert (out / "tool.yaml").read_bytes() == before


def test_raw_counts_are_not_exported_as_newtons(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gain = np.diag([100.0, 100.0, 100.0, 1e3, 1e3, 1e3])
    rig = a_rig(sensor={"noise": [10.0, 10.0, 10.0, 5.0, 5.0, 5.0], "nominal_gain": gain.tolist()})
    (files / "counts.yaml").write_text(yaml.safe_dump(rig))
    log = pose_log(tool_rig(a_rig()), MASS, CENTER)[0]
    write_log(files / "counts.csv", replace(log, raw=log.raw @ gain))
    words = ["tool", files / "counts.yaml", files / "counts.csv", "-o", files / "out", "--export", "ros"]
    assert run(*words) == 0
    assert "No tool_ros/ft_tools.yaml: it wants the offset in N and N m" in capsys.readouterr().out
    assert run(*words, "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert len(answer["figures"]["exports"]["left_out"]) == 2
    assert {Path(path).name for path in answer["outputs"]} == {
        "tool.yaml", "tool.html", "admittance_controller.yaml", "gravity_compensation_filter.yaml",
    }  # fmt: skip
