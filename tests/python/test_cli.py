"""Exit status, standard output and files of every command are what scripts rely on."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pyarrow.csv as pacsv
import pytest
import typer
import yaml

import truewrench
from truewrench.cli import app, main
from truewrench.model.calibration import Calibration, Verdict, load_calibration
from truewrench.model.rig import Rig

Cells = dict[str, list[str]]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command: exit status, standard output, standard error."""

    def call(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main([str(word) for word in words])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return call


def test_main_returns_the_status_and_the_process_exits_with_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert main(["calibrat"]) == 2
    capsys.readouterr()
    for words, status in ((["--version"], 0), (["inspect", "nowhere.csv"], 2)):
        done = subprocess.run([sys.executable, "-m", "truewrench", *words], capture_output=True, check=False)
        assert done.returncode == status


def test_no_word_of_a_help_text_is_taken_for_markup() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    words = [option.help or "" for command in commands.values() for option in command.params]
    assert len(words) > 50
    assert not [help_text for help_text in words if "[" in help_text]


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_internal_fault(tmp_path: Path, closed: str) -> None:
    (tmp_path / "log.csv").write_text("time_s,raw_0\n0,1\n1,2\n", encoding="utf-8")
    words = f"{sys.executable} -m truewrench inspect log.csv {closed}"
    assert subprocess.run(words, shell=True, cwd=tmp_path, check=False).returncode == 0


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="no device that is always full")
@pytest.mark.parametrize("words", [["--version"], ["inspect", "log.csv"], ["inspect", "log.csv", "--json"]])
def test_a_full_disk_below_standard_output_is_no_internal_fault(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "log.csv").write_text("time_s,raw_0\n0,1\n1,2\n", encoding="utf-8")
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        command = [sys.executable, "-m", "truewrench", *words]
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False
        )
    assert done.returncode == 2
    assert done.stderr == "truewrench: standard output: cannot be written: No space left on device\n"


@pytest.fixture
def rig_file(tmp_path: Path, settings: dict[str, Any]) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(settings), encoding="utf-8")
    return path


@pytest.fixture
def pipeline(monkeypatch: pytest.MonkeyPatch, calibration: Calibration) -> ModuleType:
    """A pipeline that returns a ready calibration, and notes what it was asked for."""
    module = ModuleType("truewrench.calibrating.pipeline")

    def calibrate(rig: Rig, logs: Any, estimator: str, **options: Any) -> Calibration:
        module.asked = (rig, logs, estimator, options)  # type: ignore[attr-defined]
        return replace(calibration, estimator=estimator, verdict=module.verdict)  # type: ignore[attr-defined]

    module.calibrate = calibrate  # type: ignore[attr-defined]
    module.verdict = Verdict(usable=True)  # type: ignore[attr-defined]
    monkeypatch.setattr(
        truewrench, "calibrate", lambda *logs, **options: module.calibrate(*logs, **options), raising=False
    )
    return module


def test_usable_calibration_is_written_with_status_0(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path
) -> None:
    logs: list[object] = [csv_of(cells, "a.csv")]
    cells["vx"][3] = "0.25"
    logs.append(f"{csv_of(cells, 'b.csv')}@default")
    status, out, err = run("calibrate", rig_file, *logs, "-o", tmp_path / "out", "--estimator", "online")
    assert (status, err) == (0, "")
    assert out.startswith("USABLE")
    assert load_calibration(tmp_path / "out" / "calibration.yaml").estimator == "online"
    assert {
        Path(line.removeprefix("wrote ")) for line in out.splitlines() if line.startswith("wrote ")
    } == set((tmp_path / "out").iterdir())
    assert [log.payload for log in pipeline.asked[1]] == ["default", "default"]


def test_unusable_calibration_is_written_with_status_3_and_its_reasons(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path
) -> None:
    pipeline.verdict = Verdict(usable=False, reasons=("samples left out: 3",))  # type: ignore[attr-defined]
    status, out, _ = run("calibrate", rig_file, csv_of(cells), "-o", tmp_path / "out")
    assert status == 3
    assert out.startswith("NOT TO BE USED AS IT STANDS\n  - samples left out: 3\n")
    assert (tmp_path / "out" / "calibration.yaml").exists()


def test_options_reach_the_pipeline(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path
) -> None:
    words = "--estimator ekf --published --threads 2 --process-density 1e-1 --smooth spline"
    status, *_ = run("calibrate", rig_file, csv_of(cells), "-o", tmp_path / "out", *words.split())
    options = pipeline.asked[3]
    del options["progress"], options["evidence"]
    assert status == 0
    assert options == {
        "published": True, "threads": 2, "process_density": 0.1, "smooth": "spline", "held_out": True,
    }  # fmt: skip


def test_what_was_left_out_of_a_log_is_told(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path
) -> None:
    cells["vx"][3] = "nan"
    for name in cells:
        if name != "time_ns":
            cells[name][7] = ""
    _, _, err = run("calibrate", rig_file, csv_of(cells), "-o", tmp_path / "out")
    assert "run.csv: 1 rows without any measurement left out" in err
    assert "run.csv: column `vx`: 1 NaN left out" in err


def test_apply_writes_the_log_and_hands_on_the_verdict(
    run: Run, csv_of: Callable[..., Path], cells: Cells, calibration: Calibration, tmp_path: Path
) -> None:
    log, output, path = csv_of(cells), tmp_path / "new" / "out.csv", tmp_path / "calibration.yaml"
    calibration.write_yaml(path)
    status, out, err = run("apply", path, log, "-o", output)
    assert (status, err) == (0, "")
    assert "10 of 10 rows with the true wrench" in out
    assert pacsv.read_csv(output).column_names[-12:-9] == ["fx", "fy", "fz"]
    replace(calibration, verdict=Verdict(usable=False, reasons=("reference estimator",))).write_yaml(path)
    status, out, _ = run("apply", path, log, "-o", output)
    assert status == 3
    assert "not to be used as it stands: reference estimator" in out


def test_demo_names_its_files(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from truewrench import demo

    def short(output: Path, seed: int, progress: Callable[[str], None]) -> dict[str, Any]:
        progress("motion")
        return {"outputs": [str(output / "fig.png")], "figures": {"seed": seed}, "text": "online [1.0]"}

    monkeypatch.setattr(demo, "run", short)
    status, out, err = run("demo", "-o", tmp_path, "--seed", 5)
    assert (status, err) == (0, "")
    assert out == f"online [1.0]\nwrote {tmp_path / 'fig.png'}\n"
    _, out, _ = run("demo", "-o", tmp_path, "--seed", 5, "--json")
    assert json.loads(out)["figures"] == {"seed": 5}


@pytest.mark.parametrize(
    "command",
    [
        "simulate RIG -o",
        "plan RIG -o",
        "plan RIG --tool -o",
        "calibrate RIG LOG -o",
        "tool RIG LOG -o",
        "demo -o",
    ],
)
def test_a_path_below_a_file_is_2_before_any_work(
    run: Run, rig_file: Path, command: str, tmp_path: Path
) -> None:
    words = [{"RIG": rig_file, "LOG": tmp_path / "log.csv"}.get(word, word) for word in command.split()]
    status, _, err = run(*words, rig_file / "x.csv")
    assert status == 2
    assert f"a path below the file {rig_file.name}" in err


@pytest.mark.parametrize("command", ["calibrate", "stream --calibrate"])
def test_a_calibration_is_not_written_over_the_rig_that_it_is_made_with(
    run: Run, rig_file: Path, command: str, tmp_path: Path
) -> None:
    rig = rig_file.rename(tmp_path / "calibration.yaml")
    before = rig.read_text(encoding="utf-8")
    logs = [tmp_path / "log.csv"] if command == "calibrate" else []
    status, _, err = run(*command.split(), rig, *logs, "-o", tmp_path)
    assert status == 2
    assert "an input of the command itself" in err
    assert rig.read_text(encoding="utf-8") == before


@pytest.mark.parametrize("as_json", [False, True])
def test_interrupted_calibration_says_that_nothing_was_written(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path,
    as_json: bool,
) -> None:  # fmt: skip
    def interrupted(*_: Any, **__: Any) -> Calibration:
        raise KeyboardInterrupt

    pipeline.calibrate = interrupted  # type: ignore[attr-defined]
    words = ["calibrate", rig_file, csv_of(cells), "-o", tmp_path / "out", *["--json"] * as_json]
    status, out, err = run(*words)
    assert (status, err) == (130, "truewrench: interrupted: nothing was written\n")
    assert (json.loads(out)["status"] == 130) if as_json else not out
    assert not (tmp_path / "out").exists()


def test_validation_judges_held_out_logs_with_status_0_or_3(
    run: Run, settings: dict[str, Any], tmp_path: Path
) -> None:
    settings["sensor"]["time_offset_prior"] = 0
    settings["simulate"] = {"gain": "nominal"}
    settings["plan"] = {"duration": 10}
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(settings), encoding="utf-8")
    log, out_folder = tmp_path / "run.csv", tmp_path / "out"
    assert run("simulate", rig, "-o", log)[0] == 0
    gain, none = np.diag([1.0, 1.0, 1.4, 1.0, 1.0, 1.0]), np.zeros(6)
    for name, found in (("right", np.eye(6)), ("wrong", gain)):
        Calibration(
            gain=found, gain_std=np.full((6, 6), 1e-3), offset=none, offset_std=none,
            inverse=np.linalg.inv(found), covariance=np.diag(np.append(np.full(36, 1e-6), none)),
            verdict=Verdict(usable=True), logs=(), rig=Rig.from_mapping(settings), estimator="map",
        ).write_yaml(tmp_path / f"{name}.yaml")  # fmt: skip
    status, out, err = run("validate", tmp_path / "right.yaml", rig, log)
    assert (status, err) == (0, "")
    assert out.startswith("HOLDS")
    assert "wrote" not in out
    status, out, _ = run("validate", tmp_path / "wrong.yaml", rig, log, "-o", out_folder)
    assert status == 3
    assert "fz is worse than with the nominal gain" in out
    assert yaml.safe_load((out_folder / "validation.yaml").read_text())["axes"]["fz"]["better"] is False
    status, out, _ = run("validate", tmp_path / "wrong.yaml", rig, log, "-o", out_folder, "--json")
    answer = json.loads(out)
    assert answer["status"] == status == 3
    assert answer["verdict"]["usable"] is False
    assert answer["figures"]["axes"]["fx"]["better"] in (True, False, "unsure")


def test_simulated_log_is_written_with_its_truth(run: Run, rig_file: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.csv"
    status, _, err = run("simulate", rig_file, "-o", log)
    assert (status, err) == (0, "")
    truth = yaml.safe_load((tmp_path / "run.csv.truth.yaml").read_text(encoding="utf-8"))
    assert set(truth) >= {"gain", "offset", "time_offset", "payloads", "seed"}
    assert np.array(truth["gain"]).shape == (6, 6)
    status, out, _ = run("inspect", log)
    assert status == 0
    assert "raw channels" in out


def test_inspect_finds_rates_gaps_and_ranges(run: Run, csv_of: Callable[..., Path]) -> None:
    time = [0.001 * k for k in range(1000)] + [3 + 0.001 * k for k in range(500)]
    columns = {
        "time_s": [f"{t:.3f}" for t in time],
        "raw_0": [str(k % 7) for k in range(1500)],
        "vx": ["-2.5" if k % 10 == 0 else "" for k in range(1500)],
        "note": ["x"] * 1500,
    }
    columns["raw_0"][5] = "nan"
    status, out, _ = run("inspect", csv_of(columns), "--json")
    assert status == 0
    figures = json.loads(out)["figures"]
    raw, twist = figures["streams"]
    assert (figures["rows"], figures["unknown"]) == (1500, ["note"])
    assert figures["duration"] == pytest.approx(3.499)
    assert (raw["samples"], raw["rate"]) == (1499, pytest.approx(1000))
    assert (twist["samples"], twist["rate"]) == (150, pytest.approx(100))
    assert raw["gaps"] == [{"start": pytest.approx(0.999), "duration": pytest.approx(2.001)}]
    assert raw["columns"] == [
        {"name": "raw_0", "smallest": 0, "largest": 6, "numbers": 1499, "empty": 0, "nan": 1}
    ]
    assert twist["columns"][0] | {"name": ""} == {
        "name": "", "smallest": -2.5, "largest": -2.5, "numbers": 150, "empty": 1350, "nan": 0,
    }  # fmt: skip


def words_of(command: str, names: Mapping[str, object]) -> list[str]:
    return [str(names.get(word, word)) for word in command.split()]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("", ""),
        ("calibrate", "Missing argument 'RIG'"),
        ("calibrate RIG", "Missing argument 'LOG...'"),
        ("calibrate RIG LOG", "Missing option '-o'"),
        ("calibrate RIG LOG -o OUT --estimator best", "--estimator"),
        ("calibrate RIG LOG -o OUT --threads 0", "--threads"),
        ("calibrate RIG LOG -o OUT --fast", "No such option: --fast"),
        ("calibrate RIG NONE -o OUT", "none.csv: cannot be read"),
        ("calibrate NONE LOG -o OUT", "none.csv: cannot be read"),
        ("calibrate RIG BAD -o OUT", "row 3 (line 4), column `raw_0`: found the text 'oops'"),
        ("calibrate RIG LOG -o LOG", "found a file, expected a folder"),
        ("calibrate RIG LOG -o OUT --estimator ekf --process-density inf", "--process-density"),
        ("calibrate RIG LOG SAME -o OUT", "same.csv: log 2: found the same content as log 1, "),
        ("apply RIG LOG -o OUT", "format: found nothing, expected `truewrench/1`"),
        ("apply NONE LOG -o OUT", "none.csv: cannot be read"),
        ("inspect NONE", "none.csv: cannot be read"),
        ("simulate RIG NONE -o OUT", "none.csv"),
        ("simulate RIG -o OUT --payload hammer", "hammer"),
        ("simulate RIG LOG -o LOG", "run.csv: found an input of the command itself, expected another file"),
        ("simulate RIG -o RIG", "rig.yaml: found an input of the command itself"),
        ("simulate RIG -o MCAP", "out.mcap: found the name of a recording for a table, expected a"),
        ("plan RIG -o RIG", "rig.yaml: found an input of the command itself"),
        ("plan RIG -o LINK", "link.yaml: found an input of the command itself"),
        ("plan RIG --tool -o RIG", "rig.yaml: found an input of the command itself"),
        ("plan RIG --tool -o MCAP", "out.mcap: found the name of a recording"),
        ("plan RIG --tool -o OUT --poses 100000", "--poses: found 100000, expected at least 4"),
        ("plan RIG --tool -o OUT --dwell inf", "--dwell: found inf, expected more than 1.5 s"),
        ("plan RIG --tool -o OUT --cone inf", "--cone: found inf"),
        ("follow RIG LOG -o LOG", "run.csv: found an input of the command itself"),
        ("follow RIG LOG -o MCAP", "out.mcap: found the name of a recording"),
        ("follow RIG LOG -o OUT --rate inf", "--rate"),
        ("apply RIG LOG -o RIG", "rig.yaml: found an input of the command itself"),
        ("apply RIG LOG -o LOG", "run.csv: found an input of the command itself"),
        ("apply RIG LOG --tool BAD -o BAD", "bad.csv: found an input of the command itself"),
        ("apply RIG LOG -o BAG", "out.bag: found the name of a recording for a table, expected a name"),
        (
            "apply RIG LOG -o OTHER",
            "out.xlsx: found a name in .xlsx, expected a name in .csv, .parquet or .mcap",
        ),
        ("plan RIG -o OTHER", "out.xlsx: found a name in .xlsx, expected a name in .csv or .parquet"),
        ("demo", "Missing option '-o'"),
        ("demo -o LOG", "found a file, expected a folder"),
        ("fly", "No such command 'fly'"),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_bad_input_gives_status_2_one_message_and_no_file(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path,
    command: str, message: str, as_json: bool,
) -> None:  # fmt: skip
    log = csv_of(cells)
    cells["raw_0"][2] = "oops"
    bad, same, link = csv_of(cells, "bad.csv"), tmp_path / "same.csv", tmp_path / "link.yaml"
    same.write_bytes(log.read_bytes())
    link.symlink_to(rig_file)
    names = {
        "RIG": rig_file, "LOG": log, "BAD": bad, "SAME": same, "LINK": link, "NONE": tmp_path / "none.csv",
        "OUT": tmp_path / "out", "MCAP": tmp_path / "out.mcap", "BAG": tmp_path / "out.bag",
        "OTHER": tmp_path / "out.xlsx",
    }  # fmt: skip
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    status, out, err = run(*words_of(command, names), *(["--json"] if as_json else []))
    assert status == 2
    assert "Traceback" not in err
    assert message in err
    if as_json:
        answer = json.loads(out)
        assert answer["status"] == 2
        assert message in "\n".join(answer["verdict"]["reasons"])
        assert (answer["outputs"], answer["figures"]) == ([], {})
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_json_is_one_object_on_standard_output(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path
) -> None:
    log, out_folder = csv_of(cells), tmp_path / "out"
    calibration_file = out_folder / "calibration.yaml"
    for command in (
        ["calibrate", rig_file, log, "-o", out_folder],
        ["apply", calibration_file, log, "-o", tmp_path / "out.csv"],
        ["simulate", rig_file, "-o", tmp_path / "sim.parquet"],
        ["inspect", tmp_path / "sim.parquet"],
    ):
        status, out, _ = run(*command, "--json")
        answer = json.loads(out)
        assert list(answer) == ["status", "verdict", "outputs", "figures"]
        assert answer["status"] == status == 0
        assert all(Path(path).exists() for path in answer["outputs"])
    gain = load_calibration(calibration_file).gain
    _, out, _ = run("calibrate", rig_file, log, "-o", out_folder, "--json")
    assert np.array(json.loads(out)["figures"]["gain"]).tobytes() == gain.tobytes()


def test_json_says_what_was_assumed_and_what_the_record_is_blind_to(
    run: Run, calibration: Calibration, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType,
    rig_file: Path, tmp_path: Path,
) -> None:  # fmt: skip
    pipeline.verdict = calibration.verdict  # type: ignore[attr-defined]
    log = csv_of(cells)
    _, out, _ = run("calibrate", rig_file, log, "-o", tmp_path, "--no-report", "--json")
    answer = json.loads(out)
    assert answer["verdict"]["blind_to"][0]["kind"] == "delay"
    assert answer["figures"]["assumed"][0]["value"] == 2.5
    assert answer["figures"]["axes"]["mz"] is True
    assert answer["figures"]["discrepancy"] == [2e-4] * 6
    _, out, _ = run("apply", tmp_path / "calibration.yaml", log, "-o", tmp_path / "out.csv", "--json")
    assert json.loads(out)["verdict"] == answer["verdict"]


def test_internal_fault_gives_status_1_and_shows_its_place_on_request(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, pipeline: ModuleType, tmp_path: Path
) -> None:
    pipeline.verdict = None  # type: ignore[attr-defined]
    command = ["calibrate", rig_file, csv_of(cells), "-o", tmp_path / "out"]
    status, _, err = run(*command)
    assert status == 1
    assert "internal fault: AttributeError" in err
    assert "Traceback" not in err
    status, _, err = run(*command, "--debug")
    assert status == 1
    assert "Traceback" in err


def test_installed_command_answers_without_terminal_codes(tmp_path: Path) -> None:
    command = Path(sys.executable).with_name("truewrench")
    done = subprocess.run([command, "inspect", tmp_path / "none.csv"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == f"truewrench: {tmp_path / 'none.csv'}: cannot be read: No such file or directory\n"
    done = subprocess.run([command, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_one_file_is_no_two_logs(
    run: Run, rig_file: Path, csv_of: Callable[..., Path], cells: Cells, calibration: Calibration,
    tmp_path: Path,
) -> None:  # fmt: skip
    log, made = csv_of(cells), tmp_path / "calibration.yaml"
    calibration.write_yaml(made)
    for command in (["calibrate"], ["validate", made]):
        status, _, err = run(*command, rig_file, log, f"{log}@default", "-o", tmp_path / "out")
        assert status == 2
        assert f"{log}: log 2: found the same content as log 1, {log}, expected every log once" in err
    assert not (tmp_path / "out").exists()


def test_a_table_is_not_written_over_a_folder(run: Run, rig_file: Path, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    status, _, err = run("simulate", rig_file, "-o", tmp_path / "there")
    assert status == 2
    assert "there: found a folder, expected a file to write" in err


def test_many_faults_are_fifteen_lines(
    run: Run, settings: dict[str, Any], tmp_path: Path, csv_of: Callable[..., Path], cells: Cells
) -> None:
    settings["sensor"] |= {f"key{i}": 1 for i in range(40)}
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(settings), encoding="utf-8")
    status, out, err = run("calibrate", rig, csv_of(cells), "-o", tmp_path / "out", "--json")
    lines = err.splitlines()
    assert (status, len(lines)) == (2, 15)
    assert all("unknown key `key" in line for line in lines[:14])
    assert lines[14] == "truewrench: and 26 more"
    assert len(json.loads(out)["verdict"]["reasons"]) == 40


def test_control_characters_are_shown_escaped(
    run: Run, settings: dict[str, Any], tmp_path: Path, csv_of: Callable[..., Path], cells: Cells
) -> None:
    settings["sensor"]["\x1b[31mred\nline"] = 1
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(settings), encoding="utf-8")
    status, _, err = run("calibrate", rig, csv_of(cells), "-o", tmp_path / "out")
    assert status == 2
    assert len(err.splitlines()) == 1
    assert "sensor.\\x1b[31mred\\nline: unknown key `\\x1b[31mred\\nline`" in err
    status, _, err = run("inspect", tmp_path / "no\x1b[2Jne.csv")
    assert status == 2
    assert "no\\x1b[2Jne.csv: cannot be read" in err


def test_a_reader_that_goes_away_takes_no_status_with_it(
    rig_file: Path, csv_of: Callable[..., Path], cells: Cells, tmp_path: Path
) -> None:
    """`truewrench inspect LOG | head -1`: rich ends the program with 1 where nothing catches it."""
    words = [sys.executable, "-m", "truewrench", "inspect", str(csv_of(cells))]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == b""
    assert process.returncode == 0
