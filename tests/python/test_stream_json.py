"""JSON lines: what a pipeline gets for good and for bad lines, and when it ends."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from truewrench.calibrating.pipeline import calibrate
from truewrench.cli import main
from truewrench.live.json_lines import calibrate_lines, correct_lines
from truewrench.live.lines import LONGEST, Output, batches
from truewrench.live.session import Record
from truewrench.live.stamps import BeganAgainError
from truewrench.live.stop import Stop
from truewrench.model.calibration import AXES, Calibration, Verdict, load_calibration
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

COMMAND = Path(sys.executable).with_name("truewrench")
SAMPLE = [1.5, -2.0, 30.0, 0.25, -0.5, 0.125]


class Corrected:
    """What came of lines."""

    def __init__(self, lines: list[dict[str, Any]], complaints: list[str]) -> None:
        self.lines = lines
        self.complaints = complaints


@pytest.fixture
def correct(calibration: Calibration, capsys: pytest.CaptureFixture[str]) -> Any:
    """Send bytes through a pipe that then ends."""

    def run(text: bytes) -> Corrected:
        complaints: list[str] = []
        source, sink = os.pipe()
        os.write(sink, text)
        os.close(sink)
        with Stop() as stop:
            correct_lines(calibration, Output(), stop, complaints.append, source)
        os.close(source)
        return Corrected([json.loads(line) for line in capsys.readouterr().out.splitlines()], complaints)

    return run


def line(time_ns: int, raw: list[float] | None = None, **more: Any) -> bytes:
    return json.dumps({"time_ns": time_ns, "raw": raw or SAMPLE, **more}).encode() + b"\n"


def test_wrench_and_sigma_are_those_of_linear_algebra(correct: Any, calibration: Calibration) -> None:
    raw = np.random.default_rng(3).normal(scale=50.0, size=(5, 6))
    by_name = [{f"raw_{i}": x for i, x in enumerate(row)} for row in raw.tolist()]
    text = b"".join(json.dumps({"time_ns": 10 * k, **row}).encode() + b"\n" for k, row in enumerate(by_name))
    found = correct(text).lines
    wrench = np.linalg.solve(calibration.gain, (raw - calibration.offset).T).T
    np.testing.assert_allclose(
        [[out[axis] for axis in AXES] for out in found], wrench, rtol=1e-12, atol=1e-12
    )
    for w, out in zip(wrench, found, strict=True):
        J = np.hstack([np.kron(np.eye(6), w), np.eye(6)])  # of raw by [gain row by row, offset]
        sensor = calibration.rig.sensor
        signal = calibration.gain @ w / sensor.channel_scale
        bent = (
            np.hypot(calibration.quadratic, calibration.quadratic_std) * signal**2
        )  # u and d, fractions of range
        beside = np.hypot(bent, calibration.discrepancy) * sensor.channel_scale
        of_raw = J @ calibration.covariance @ J.T + np.diag(sensor.noise_array**2 + beside**2)
        inverse = np.linalg.inv(calibration.gain)
        std = np.sqrt(np.diag(inverse @ of_raw @ inverse.T))
        np.testing.assert_allclose([out[f"{axis}_std"] for axis in AXES], std, rtol=1e-9)
    assert [out["time_ns"] for out in found] == [0, 10, 20, 30, 40]


def test_array_seconds_unknown_keys_and_a_missing_line_end_are_understood(correct: Any) -> None:
    first = {"time_s": 1.25, "raw": SAMPLE, "note": "x", "vx": "not asked for"}
    second = {f"raw_{i}": x for i, x in enumerate(SAMPLE)} | {"time_s": 1.5}
    found = correct(json.dumps(first).encode() + b"\r\n\n" + json.dumps(second).encode()).lines
    assert [out["time_s"] for out in found] == [1.25, 1.5]
    assert [found[0][axis] for axis in AXES] == [found[1][axis] for axis in AXES]


def test_null_channels_have_no_wrench_and_are_no_fault(correct: Any) -> None:
    done = correct(b'{"time_ns": 1, "raw": [1, 2, null, 4, 5, 6]}\n')
    assert not done.complaints
    assert set(done.lines[0].values()) == {1, None}


WRONG = {
    b"garbage": "not JSON",
    b"\xff\xfe": "UTF-8",
    b"[1, 2]": "JSON object",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5]}': "5 entries",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5, NaN]}': "NaN",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5, 1e999]}': "finite number",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5, "6"]}': "'6'",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5, true]}': "true",
    b'{"time_ns": 5, "raw": [1e308, 1e308, 1e308, 1e308, 1e308, 1e308]}': "no wrench can be told",
    b'{"time_ns": 5, "raw_0": 1, "raw_1": 1, "raw_2": 1, "raw_3": 1, "raw_5": 1}': "no `raw_4`",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5, 6], "raw_0": 1}': "one of the two",
    b'{"time_ns": 5, "raw_0":1,"raw_1":1,"raw_2":1,"raw_3":1,"raw_4":1,"raw_5":1,"raw_6":1}': "too many",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5, 6], "raw": [0, 0, 0, 0, 0, 0]}': "a second time",
    b'{"time_ns": 5, "vx": 1}': "no channel",
    b'{"raw": [1, 2, 3, 4, 5, 6]}': "no time",
    b'{"time_ns": 5.5, "raw": [1, 2, 3, 4, 5, 6]}': "whole nanoseconds",
    b'{"time_ns": 99999999999999999999, "raw": [1, 2, 3, 4, 5, 6]}': "64-bit",
    b'{"time_s": null, "raw": [1, 2, 3, 4, 5, 6]}': "seconds",
    b'{"time_ns": 1, "raw": [1, 2, 3, 4, 5, 6]}': "time that increases",
    b'{"time_ns": 0, "raw": [1, 2, 3, 4, 5, 6]}': "time that increases",
    b'{"time_ns": 5, "raw": [1, 2, 3, 4, 5, 6': "not JSON",
}


def test_offset_follows_the_latest_temperature(
    calibration: Calibration, capsys: pytest.CaptureFixture[str]
) -> None:
    slope = np.array([0.3, -0.2, 0.1, 0.02, 0.01, -0.03])
    warm = replace(calibration, offset_temperature=slope)
    reference = calibration.rig.temperature.reference
    text = line(1) + line(2, temperature=31.0) + line(3, temperature=None)
    text += b'{"time_ns": 4, "temperature": 22.5}\n' + line(5) + line(6, temperature="hot")
    text += b'{"time_ns": 7}\n'
    source, sink = os.pipe()
    os.write(sink, text)
    os.close(sink)
    told: list[str] = []
    with Stop() as stop:
        correct_lines(warm, Output(), stop, told.append, source)
    os.close(source)
    found = [json.loads(one) for one in capsys.readouterr().out.splitlines()]
    for k, celsius in ((0, reference), (1, 31.0), (2, 31.0), (4, 22.5)):
        raw = SAMPLE - calibration.offset - slope * (celsius - reference)
        expected = np.linalg.solve(calibration.gain, raw)
        np.testing.assert_allclose([found[k][axis] for axis in AXES], expected, rtol=1e-9)
    assert found[3]["time_ns"] == 4
    assert all(found[3][axis] is None for axis in AXES)
    assert "`temperature`: found the text 'hot'" in found[5]["error"]
    assert "no channel" in found[6]["error"]
    assert told[0].endswith(f"it is taken for that of {reference:g} degC until one arrives")


def test_wrong_line_gets_an_error_in_its_place_and_no_wrench(correct: Any) -> None:
    done = correct(line(1) + b"".join(bad + b"\n" for bad in WRONG) + line(9))
    assert "fx" in done.lines[0]
    assert "fx" in done.lines[-1]
    for k, (out, words) in enumerate(zip(done.lines[1:-1], WRONG.values(), strict=True)):
        assert {"line", "error"} <= set(out) <= {"line", "error", "time_ns"}
        assert out["line"] == k + 2
        assert words in out["error"]
        assert f"line {k + 2}: " in done.complaints[k]
        told = ("5 entries", "'6'", "no wrench can be told", "no channel", "NaN", "a second time")
        if words in told:  # JSON with its time
            assert out["time_ns"] == 5


def test_readings_that_no_sensor_of_this_range_has_are_told_once(correct: Any) -> None:
    done = correct(line(1) + line(2, [1e9] * 6) + line(3, [1e9] * 6))
    assert len(done.lines) == 3
    (said,) = done.complaints
    assert "is beyond 3 times its range" in said


def test_a_stamp_from_far_ahead_costs_no_line_after_it(correct: Any) -> None:
    ahead = 4_000_000_000_000_000_000
    done = correct(line(10) + line(ahead) + line(20) + line(20) + line(30))
    assert [one.get("time_ns") for one in done.lines] == [10, ahead, 20, 20, 30]
    assert ["fx" in one for one in done.lines] == [True, True, True, False, True]
    assert "begin again at 20 ns" in done.complaints[0]


def test_a_record_leaves_out_a_stamp_that_stands_alone_far_ahead() -> None:
    record = Record()
    for time_ns in (0, 1_000_000, 2_000_000):
        assert not record.add(("vx", "vy"), time_ns, (time_ns, 0.0))
    assert not record.add(("vx", "vy"), 4_000_000_000_000_000_000, (5.0, 5.0))
    assert "stands alone" in record.add(("vx", "vy"), 3_000_000, (3e6, 0.0))
    columns = record.columns()
    np.testing.assert_array_equal(columns["time_ns"], columns["vx"])
    for time_ns in (5_000_000_000, 5_001_000_000):  # not of one, but of a run of them
        assert not record.add(("vx", "vy"), time_ns, (0.0, 0.0))
    with pytest.raises(BeganAgainError):
        record.add(("vx", "vy"), 4_000_000, (0.0, 0.0))


def test_line_without_an_end_costs_no_more_memory_than_its_limit(correct: Any) -> None:
    source, sink = os.pipe()
    writer = subprocess.Popen(
        [sys.executable, "-c", f"print('7' * {3 * LONGEST}); print('{{}}')"], stdout=sink
    )
    os.close(sink)
    with Stop() as stop:
        found = [text for batch in batches(source, stop) for text in batch]
    writer.wait()
    assert len(found) == 2
    assert LONGEST < len(found[0]) < 2 * LONGEST
    assert found[1] == b"{}"


def start(*words: object) -> subprocess.Popen[bytes]:
    pipe = subprocess.PIPE
    return subprocess.Popen([COMMAND, "stream", *map(str, words)], stdin=pipe, stdout=pipe, stderr=pipe)


@pytest.fixture
def calibration_file(tmp_path: Path, calibration: Calibration) -> Path:
    path = tmp_path / "calibration.yaml"
    calibration.write_yaml(path)
    return path


@pytest.fixture
def live(calibration_file: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A stream that has answered once."""
    process = start(calibration_file)
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(line(1))
    process.stdin.flush()
    assert "fx" in json.loads(process.stdout.readline())  # though the input has not ended
    yield process
    process.kill()
    process.communicate()


@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_stream_with_the_status_of_the_verdict(
    live: subprocess.Popen[bytes], signal_: signal.Signals
) -> None:
    live.send_signal(signal_)
    assert live.wait(10) == 0
    assert live.stderr is not None
    assert live.stderr.read() == b"1 lines\n"


def test_reader_that_goes_away_ends_a_stream_without_a_fault(live: subprocess.Popen[bytes]) -> None:
    assert live.stdin is not None
    assert live.stdout is not None
    live.stdout.close()
    live.stdin.write(line(2) + line(3))
    live.stdin.flush()
    assert live.wait(10) == 0
    assert live.stderr is not None
    assert b"Traceback" not in live.stderr.read()


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Run the command on an input: exit status, standard output, standard error."""

    def call(text: bytes, *words: object) -> tuple[Any, str, str]:
        (tmp_path / "input").write_bytes(text)
        with monkeypatch.context() as patch, (tmp_path / "input").open() as file:
            patch.setattr(sys, "stdin", file)
            status = main(["stream", *map(str, words)])
        return status, *capsys.readouterr()

    return call


def test_wrong_lines_and_unusable_calibrations_show_in_the_exit_status(
    command: Any, calibration: Calibration, tmp_path: Path
) -> None:
    path = tmp_path / "unusable.yaml"
    replace(calibration, verdict=Verdict(False, ("the moment was never excited",))).write_yaml(path)
    status, out, err = command(line(1) + line(2), path, "--json")
    assert status == 3
    assert "the moment was never excited" in err
    assert json.loads(out)["figures"] == {"lines": 2}
    status, out, err = command(line(1) + b"{}\n", path)
    assert status == 2
    assert "line 2: found no time" in err
    assert "fx" in json.loads(out.splitlines()[0])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "a CALIBRATION or --calibrate RIG"),
        (["c.yaml", "--calibrate", "rig.yaml"], "found both"),
        (["c.yaml", "-o", "out"], "--calibrate only"),
        (["c.yaml", "--reliable"], "--ros2 only"),
    ],
)
def test_options_that_mean_nothing_together_are_refused(
    command: Any, words: list[str], expected: str
) -> None:
    status, _, err = command(b"", *words)
    assert status == 2
    assert expected in err


@pytest.fixture(scope="module")
def run(valid_settings: dict[str, Any]) -> Any:
    """A short run, whose gains are found."""
    exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    settings = {
        **valid_settings,
        "sensor": {**valid_settings["sensor"], "time_offset_prior": 0},
        "payloads": {"default": {**valid_settings["payloads"]["default"], "uncertainty": exact}},
        "required": 0.1,
        "plan": {"duration": 6},
    }
    return settings, simulate(Rig.from_mapping(settings))


def test_signal_ends_a_calibration_with_that_of_the_whole_record(run: Any, tmp_path: Path) -> None:
    settings, simulated = run
    rig_file, folder = tmp_path / "rig.yaml", tmp_path / "out"
    rig_file.write_text(yaml.safe_dump(settings))
    log = simulated.log
    process = start("--calibrate", rig_file, "-o", folder)
    assert process.stdin is not None
    assert process.stdout is not None
    half = len(log.time_ns) // 2
    for k, (at, raw, twist) in enumerate(zip(log.time_ns, log.raw.tolist(), log.twist.tolist(), strict=True)):
        motion = dict(zip(("vx", "vy", "vz", "wx", "wy", "wz"), twist, strict=True))
        process.stdin.write(line(int(at), raw))  # sensor and motion on lines of their own
        process.stdin.write(json.dumps({"time_ns": int(at), **motion}).encode() + b"\n")
        if k == half:
            process.stdin.write(b"garbage\n")
            process.stdin.flush()
            progress = json.loads(process.stdout.readline())
            while "seconds" not in progress:
                progress = json.loads(process.stdout.readline())
            assert not progress["final"]
    process.stdin.flush()
    time.sleep(0.5)  # for the rest to be read
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    final = json.loads(out.splitlines()[-1])
    assert process.returncode == 0, err
    assert final["final"]
    assert b"not JSON" in err
    assert b"wrote" in err
    made = load_calibration(folder / "calibration.yaml")
    record = pq.read_table(folder / "record.parquet")
    assert record.num_rows == len(log.time_ns)
    assert np.array_equal(record["raw_3"].to_numpy(), log.raw[:, 3])
    assert np.array_equal(record["wz"].to_numpy(), log.twist[:, 5])
    expected = calibrate(made.rig, log)
    np.testing.assert_allclose(made.gain, expected.gain, rtol=1e-9, atol=1e-12)
    assert made.gain.tolist() == final["gain"]
    departure = (made.gain - simulated.truth.gain) / made.gain_std
    assert np.abs(departure).max() < 5.0
    assert made.logs[0].path == folder / "record.parquet"


def test_a_full_disk_below_the_output_loses_no_calibration(run: Any, tmp_path: Path) -> None:
    class Full(Output):
        def write(self, line: str) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    finished: list[Path] = []
    session: Any = SimpleNamespace(
        rig=Rig.from_mapping(run[0]),
        record=SimpleNamespace(add=lambda *_: None),
        poll=lambda: SimpleNamespace(to_mapping=dict),
        finish=finished.append,
    )
    source, sink = os.pipe()
    os.write(sink, line(1))
    os.close(sink)
    with Stop() as stop, pytest.raises(OSError, match="No space left"):
        calibrate_lines(session, tmp_path, Full(), stop, print, source)
    os.close(source)
    assert finished == [tmp_path]


def test_calibration_from_nothing_writes_nothing(command: Any, run: Any, tmp_path: Path) -> None:
    rig_file = tmp_path / "rig.yaml"
    rig_file.write_text(yaml.safe_dump(run[0]))
    status, out, err = command(b"", "--calibrate", rig_file, "-o", tmp_path / "out")
    assert status == 2
    assert "no sample has arrived" in err
    assert not out
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_solved_ends_in_numbers_or_null(command: Any, run: Any, tmp_path: Path) -> None:
    settings, simulated = run
    rig_file = tmp_path / "rig.yaml"
    rig_file.write_text(yaml.safe_dump(settings))
    log, text = simulated.log, b""
    for k in range(300):
        motion = dict(zip(("vx", "vy", "vz", "wx", "wy", "wz"), log.twist[k].tolist(), strict=True))
        row = {"time_ns": int(log.time_ns[k]), "raw": log.raw[k].tolist(), **motion}
        if k == 150:
            row["raw"][2] = row["vx"] = 1e250
        text += json.dumps(row).encode() + b"\n"
    status, out, err = command(text, "--calibrate", rig_file, "-o", tmp_path / "out")
    assert status == 3, err
    final = json.loads(out.splitlines()[-1], parse_constant=pytest.fail)
    assert final["final"]
    assert final["reasons"]
