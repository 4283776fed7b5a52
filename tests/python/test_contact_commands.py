"""`apply --tool` and `stream --tool`: columns, events, the same numbers, words for what is wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from contact_cases import Swing, columns_of, raw_of, tool_of, write_log
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from tool_cases import a_rig

from truewrench.cli import main
from truewrench.cli.contacts import sensor_and_tool
from truewrench.correction.contact.apply import apply_contact
from truewrench.correction.contact.log import contact
from truewrench.correction.contact.run import NEW_COLUMNS, ContactRun
from truewrench.io.tables import read_log, write_table
from truewrench.live.contact_lines import contact_lines
from truewrench.live.lines import Output
from truewrench.live.stop import Stop
from truewrench.model.files import write_yaml

PERIOD = 2_000_000
HIT = np.array([30.0, -20.0, 34.0, 1.0, -0.5, 0.7])


def status_of(arguments: list[str]) -> int:
    return main(arguments)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    """Rig, tool and a log of 0.6 s with a contact from 0.2 to 0.3 s."""
    tool, motion = tool_of(1), Swing()
    time_ns = PERIOD * np.arange(300, dtype=np.int64)
    time = 1e-9 * time_ns
    hit = np.where(((time >= 0.2) & (time < 0.3))[:, None], HIT, 0.0)
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, hit)
    raw += np.random.default_rng(0).normal(size=raw.shape) * tool.rig.sensor.noise_array
    log = write_log(tmp_path / "log.csv", time_ns, raw, columns_of(motion, time))
    tool.write_yaml(tmp_path / "tool.yaml")
    write_yaml(tmp_path / "rig.yaml", a_rig(motion={"source": "twist", "of": "sensor", "noise": [1e-3] * 6}))
    return tmp_path / "rig.yaml", tmp_path / "tool.yaml", log


def test_apply_adds_columns_and_tells_events(
    files: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    rig, tool, log = files
    out = log.with_name("out.csv")
    assert status_of(["apply", str(rig), str(log), "--tool", str(tool), "-o", str(out), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["figures"]["rows"] == 300
    assert answer["figures"]["contact_rows"] == 290
    (event,) = answer["figures"]["events"]
    assert abs(event["begin_ns"] - 200_000_000) <= 5 * PERIOD
    assert abs(event["end_ns"] - 300_000_000) <= 5 * PERIOD
    assert event["peak_force"] == pytest.approx(np.linalg.norm(HIT[:3]), rel=0.05)
    table = pacsv.read_csv(out)
    assert table.column_names[-13:] == list(NEW_COLUMNS)
    cells = np.column_stack([table[name].to_numpy(zero_copy_only=False) for name in NEW_COLUMNS])
    assert np.isnan(cells[:5]).all()
    assert np.isfinite(cells[5:295]).all()
    inside = slice(110, 140)
    assert np.abs(cells[inside, :6].mean(axis=0) - HIT).max() < 0.2
    assert (cells[inside, 12] > 48.4).all()
    assert out.read_text().splitlines()[1].startswith(log.read_text().splitlines()[1])


def test_topics_are_those_of_the_rig_that_is_named(files: tuple[Path, Path, Path]) -> None:
    """A tool that was found from a table serves a recording."""
    rig, tool, _ = files
    assert sensor_and_tool(rig, tool)[1].rig.recording.gravity_topic is None
    rig.write_text(rig.read_text() + "recording: {gravity_topic: /down}\n")
    assert sensor_and_tool(rig, tool)[1].rig.recording.gravity_topic == "/down"


def test_a_channel_at_its_rail_is_told(files: tuple[Path, Path, Path]) -> None:
    log = files[2]
    assert apply_contact(tool_of(1), log, log.with_name("out.csv")).notes == ()
    table = pacsv.read_csv(log)
    force = table["raw_2"].to_numpy(zero_copy_only=False)
    at = table.column_names.index("raw_2")
    low = pa.array(np.minimum(force, np.quantile(force, 0.8)))
    pacsv.write_csv(table.set_column(at, "raw_2", low), log)
    (note,) = apply_contact(tool_of(1), log, log.with_name("out.csv")).notes
    assert "its extreme value" in note


def test_all_ways_give_the_same_numbers(files: tuple[Path, Path, Path]) -> None:
    log = files[2]
    tool = tool_of(1)
    out = log.with_name("out.parquet")
    apply_contact(tool, log, out)
    table = pq.read_table(out)
    cells = np.column_stack([table[name].to_numpy() for name in NEW_COLUMNS])
    whole = contact(read_log(log, tool.rig), tool)
    std = np.sqrt(np.diagonal(whole.covariance, axis1=1, axis2=2))
    # the same but for the rounding of attitudes: a log has free fall by another routine
    expected = np.hstack([whole.wrench, std, whole.chi2[:, None]])
    np.testing.assert_allclose(cells, expected, rtol=1e-11, atol=1e-12)
    assert len(whole.events) == 1


@pytest.mark.parametrize("delay", ["0.01", "0", "0.004"])
def test_stream_answers_every_line_with_the_numbers_of_apply(
    files: tuple[Path, Path, Path],
    delay: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rig, tool_file, log = files
    out = log.with_name("out.parquet")
    arguments = ["apply", str(rig), str(log), "--tool", str(tool_file), "-o", str(out), "--delay", delay]
    assert status_of(arguments) == 0
    table = pq.read_table(out)
    cells = np.column_stack([table[name].to_numpy() for name in NEW_COLUMNS])
    header, *rows = [line.split(",") for line in log.read_text().splitlines()]
    lines: list[dict[str, Any]] = [
        {name: int(x) if name == "time_ns" else float(x) for name, x in zip(header, row, strict=True)}
        for row in rows
    ]
    for k in range(295, 0, -5):  # lines without a sample, which nothing waits for
        lines.insert(k, {"time_ns": lines[k - 1]["time_ns"] + 1, "temperature": 25.0})
    lines.insert(180, {"tare": True})
    source = log.with_name("lines.jsonl")
    source.write_text("".join(json.dumps(line) + "\n" for line in lines))
    capsys.readouterr()
    with source.open("rb") as file, Stop() as stop:
        run = ContactRun(tool_of(1), None, delay=float(delay))
        done = contact_lines(run, 6, Output(), stop, print, file.fileno())
    assert done.refused == 0
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    events = [answer for answer in answers if "event" in answer]
    assert [event["event"] for event in events] == ["tare", "contact"]
    assert events[0]["accepted"] is False
    answers = [answer for answer in answers if "event" not in answer]
    assert [answer["time_ns"] for answer in answers] == [
        line["time_ns"] for line in lines if "time_ns" in line
    ]
    told = [answer for answer in answers if answer["contact_time_ns"] is not None]
    assert len(told) > 260
    lag = {(answer["time_ns"] - answer["contact_time_ns"]) // PERIOD for answer in told}
    assert lag == {round(float(delay) / 2e-3)}
    for answer in told:
        row = cells[answer["contact_time_ns"] // PERIOD]
        np.testing.assert_allclose([answer[name] for name in NEW_COLUMNS], row, rtol=1e-12, atol=1e-12)


def test_words_for_what_is_wrong(
    files: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, tool, log = files
    out = tmp_path / "out.csv"
    base = ["apply", str(rig), str(log), "-o", str(out)]
    assert status_of([*base, "--tool", str(tool), "--at", "1,2,3"]) == 2
    assert status_of([*base, "--tool", str(tool), "--at", "0,0,0.1,0,0,90"]) == 2
    assert "six numbers" in capsys.readouterr().err
    other = tmp_path / "other.yaml"
    write_yaml(other, a_rig(sensor={"feels": "sensor_on_payload"}))
    assert status_of(["apply", str(other), str(log), "-o", str(out), "--tool", str(tool)]) == 2
    assert "feels" in capsys.readouterr().err
    assert status_of([*base, "--delay", "0.01"]) == 2
    assert "--tool" in capsys.readouterr().err
    assert not out.exists()
    assert status_of([*base, "--tool", str(tool), "--at", "0.1,0,0,0,0,0", "--axes", "base"]) == 0
    assert status_of(["apply", str(rig), str(out), "-o", str(tmp_path / "two.csv"), "--tool", str(tool)]) == 2
    assert "a log without it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gravity": [0, 0, -1.62]}, "rig.gravity"),
        ({"sensor": {"range": [5, 5, 5, 1, 1, 1]}}, "rig.sensor.range"),
        ({"temperature": {"reference": 100}}, "rig.temperature.reference"),
        ({"motion": {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}}, "rig.motion"),
    ],
)
def test_a_rig_of_another_sensor_or_arm_is_refused(
    files: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str], change: dict[str, Any], said: str
) -> None:
    _, tool, log = files
    other, out = log.with_name("other.yaml"), log.with_name("out.csv")
    motion = {"source": "twist", "of": "sensor", "noise": [1e-3] * 6}
    write_yaml(other, a_rig(**{"motion": motion, **change}))
    assert status_of(["apply", str(other), str(log), "-o", str(out), "--tool", str(tool)]) == 2
    message = capsys.readouterr().err
    assert said in message
    assert str(tool) in message
    assert str(other) in message
    assert not out.exists()


@pytest.mark.parametrize(("names", "factor"), [(("gx", "gy", "gz"), 1 / 9.81), (("wx", "wy", "wz"), 57.3)])
def test_other_units_are_refused_and_no_contact(
    files: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str], names: tuple[str, ...], factor: float
) -> None:
    rig, tool, log = files
    table = pacsv.read_csv(log)
    columns = {name: table[name].to_numpy() for name in table.column_names}
    fall = Rotation.from_quat(np.column_stack([columns[q] for q in ("qx", "qy", "qz", "qw")])).inv()
    columns |= dict(zip(("gx", "gy", "gz"), fall.apply([0.0, 0.0, -9.81]).T, strict=True))
    columns |= {name: factor * columns[name] for name in names}
    other, out = log.with_name("other.csv"), log.with_name("out.csv")
    write_table(other, columns)
    assert status_of(["apply", str(rig), str(other), "-o", str(out), "--tool", str(tool)]) == 2
    assert " ".join(names) in capsys.readouterr().err
    assert not out.exists()


def test_a_recording_has_the_wrench_and_its_sigma(files: tuple[Path, Path, Path]) -> None:
    log = files[2]
    out = log.with_name("out.mcap")
    done = apply_contact(tool_of(1), log, out)
    with AnyReader([out]) as reader:
        topics = {connection.topic: connection.msgcount for connection in reader.connections}
        first = next(iter(reader.messages()))
    assert topics == {"/truewrench/contact": 290, "/truewrench/contact_std": 290}
    assert first[1] == 5 * PERIOD
    assert done.found == 290
