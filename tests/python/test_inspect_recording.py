"""What `inspect` says of a recording is what was put into it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import MS, START, Bag

from truewrench.cli import main
from truewrench.inspection.recording import RecordingContent, TopicContent, inspect_recording
from truewrench.io.tables import read_log
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig


def written(tmp_path: Path, kind: str = "mcap") -> Path:
    """A sensor with a gap and a late clock, two publishers of joints, a command, gauges, and words."""
    with Bag(tmp_path / "run", kind) as bag:
        for i in range(3000):
            at = START + i * MS + (500 * MS if i >= 2000 else 0)
            bag.wrench("/ft", at, [i, 0, 0, 0, 0, np.nan if i < 10 else -1], receive=at + 300 * MS)
        for i in range(100):
            bag.joints("/joint_states", START + 10 * i * MS, {"a": float(i), "b": 1.0}, {"a": 2.0, "b": 3.0})
            bag.joints("/joint_states", START + 10 * i * MS + MS, {"gripper": 0.5})
            bag.array("/gauges", START + 10 * i * MS, range(8))
            bag.twist("/cmd_vel", START + 10 * i * MS, [0] * 6)
        log = bag.type("std_msgs/msg/String")
        bag.write("/words", "std_msgs/msg/String", START, log(data="[bold]hello"))
    return bag.path


def topic_of(content: RecordingContent, name: str) -> TopicContent:
    return next(topic for topic in content.topics if topic.topic == name)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "bag"])
def test_topics_rates_gaps_and_ranges(tmp_path: Path, kind: str) -> None:
    content = inspect_recording(written(tmp_path, kind))
    assert content.messages == 3401
    assert content.start_ns == START
    counts = {topic.topic: topic.messages for topic in content.topics}
    assert counts == {"/ft": 3000, "/joint_states": 200, "/gauges": 100, "/cmd_vel": 100, "/words": 1}

    sensor = topic_of(content, "/ft")
    assert sensor.stamps == "header"
    assert sensor.delay == pytest.approx(0.3)
    assert sensor.drift == pytest.approx(0.0, abs=1e-9)
    (stream,) = sensor.streams
    assert (stream.samples, stream.rate, stream.gap_count) == (3000, 1000.0, 1)
    assert stream.gaps[0].start == pytest.approx(1.999)
    assert stream.gaps[0].duration == pytest.approx(0.501)
    ranges = [(c.name, c.smallest, c.largest, c.numbers, c.nan) for c in stream.columns]
    assert ranges[0] == ("raw_0", 0.0, 2999.0, 3000, 0)
    assert ranges[5] == ("raw_5", -1.0, -1.0, 2990, 10)
    assert content.notes == ("/ft: header stamps are 0.3 s before those of receipt on average",)

    joints = {tuple(c.name for c in s.columns): s.rate for s in topic_of(content, "/joint_states").streams}
    assert joints == {("q_a", "q_b"): 100.0, ("dq_a", "dq_b"): 100.0, ("q_gripper",): 100.0}
    assert topic_of(content, "/gauges").stamps == "receive"
    assert topic_of(content, "/words").stamps is None


def test_each_topic_says_what_it_would_be_taken_for(tmp_path: Path) -> None:
    taken = {topic.topic: topic.taken_as for topic in inspect_recording(written(tmp_path)).topics}
    assert taken["/ft"] == "sensor"
    assert taken["/joint_states"] == "joints"
    assert taken["/gauges"] == "raw channels of a rig with n = 8"
    assert taken["/cmd_vel"] == "a command, by its name; unless named in recording.twist_topic"
    assert taken["/words"] == ""


def test_rivals_are_named(tmp_path: Path) -> None:
    with Bag(tmp_path / "run") as bag:
        for i in range(3):
            bag.wrench("/ft", START + i, [0] * 6)
            bag.wrench("/ft_filtered", START + i, [0] * 6)
    taken = {topic.topic: topic.taken_as for topic in inspect_recording(tmp_path / "run").topics}
    assert taken["/ft"] == "sensor, if named in recording.wrench_topic: /ft_filtered could be, too"


def test_jitter_lateness_and_repetition_are_those_of_the_stamps(tmp_path: Path) -> None:
    draw = np.random.default_rng(0)
    period = (MS * (1 + 0.1 * draw.standard_normal(5000))).astype(int)
    stamps = START + np.cumsum(period)
    stamps[[100, 3000]] = stamps[[99, 2999]]
    stamps[4000] = stamps[3990]
    with Bag(tmp_path / "run") as bag:
        for k, stamp in enumerate(stamps.tolist()):
            bag.wrench("/ft", stamp, [k] * 6, receive=START + k * MS)
    (stream,) = topic_of(inspect_recording(tmp_path / "run"), "/ft").streams
    assert stream.repeated == 2
    assert stream.late == 1
    assert stream.jitter == pytest.approx(0.1, rel=0.05)
    assert stream.rate == pytest.approx(1000, rel=0.02)


def test_packets_have_the_rate_of_their_samples(tmp_path: Path) -> None:
    with Bag(tmp_path / "run") as bag:
        for i in range(700):
            packet, place = divmod(i, 7)
            bag.wrench("/ft", START + i * 6 * MS, [0] * 6, receive=START + packet * 42 * MS + place * 25_000)
            bag.array("/gauges", START + packet * 42 * MS + place * 25_000, range(8))
    content = inspect_recording(tmp_path / "run")
    for name in ("/ft", "/gauges"):
        assert topic_of(content, name).rate == pytest.approx(1000 / 6, rel=0.02)
        assert topic_of(content, name).streams[0].rate == pytest.approx(1000 / 6, rel=0.02)
        assert topic_of(content, name).streams[0].gap_count == 0


def test_longest_pauses_are_listed_where_there_are_many(tmp_path: Path) -> None:
    with Bag(tmp_path / "run") as bag:
        stamp = START
        for i in range(15_000):
            stamp += (1 if i % 125 else 10 + i // 125) * MS
            bag.array("/gauges", stamp, [i])
    (stream,) = topic_of(inspect_recording(tmp_path / "run"), "/gauges").streams
    assert stream.gap_count == 119
    assert [round(gap.duration * 1000) for gap in stream.gaps] == list(range(30, 130))


def test_late_messages_are_as_many_as_where_the_log_is_read(tmp_path: Path, rig: Rig) -> None:
    draw = np.random.default_rng(0)
    stamps = START + MS * np.arange(6000) + (5 * MS * draw.random(6000)).astype(int)
    with Bag(tmp_path / "run") as bag:
        for k, stamp in enumerate(stamps.tolist()):
            bag.wrench("/ft", stamp, [k] * 6, receive=START + k * MS)
            bag.twist("/twist", START + k * MS, [k] * 6)
    (stream,) = topic_of(inspect_recording(tmp_path / "run"), "/ft").streams
    assert stream.late == int((stamps < np.maximum.accumulate(stamps)).sum())
    notes = read_log(tmp_path / "run", rig).notes
    assert f"/ft: {stream.late} messages came late and were sorted in by their stamps" in notes
    assert stream.rate == pytest.approx(1000, rel=0.01)


def test_frames_are_shown_and_two_on_one_topic_are_noted(
    tmp_path: Path, rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    with Bag(tmp_path / "run") as bag:
        for i in range(20):
            frame = "right_ft\x1b[1m" if i % 3 == 2 else "left_ft"
            bag.wrench("/ft", START + i * MS, [i] * 6, frame=frame)
            bag.twist("/twist", START + i * MS, [0] * 6)
            bag.joints("/joint_states", START + i * MS, {"a": 0.0})
            bag.array("/gauges", START + i * MS, range(8))
    content = inspect_recording(tmp_path / "run")
    frames = {topic.topic: topic.frames for topic in content.topics}
    assert frames["/ft"] == ("left_ft", "right_ft\x1b[1m")
    assert frames["/twist"] == ("tool0",)
    assert frames["/joint_states"] == frames["/gauges"] == ()
    note = "/ft: messages of 2 frames (`left_ft`, `right_ft\\x1b[1m`): is it more than one sensor?"
    assert content.notes == (note,)
    assert note in read_log(tmp_path / "run", rig).notes
    assert main(["inspect", str(tmp_path / "run")]) == 0
    assert "left_ft and 1 more" in capsys.readouterr().out


def test_command_shows_topics_to_people_and_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*words: str) -> tuple[Any, str, str]:
        status = main(["inspect", str(path), *words])
        return status, *capsys.readouterr()

    path = written(tmp_path)
    status, out, err = run()
    assert status == 0
    assert "raw channels of a rig with n = 8" in " ".join(out.split())
    assert "/ft: header stamps are 0.3 s before" in err
    status, out, _ = run("--json")
    assert status == 0
    assert json.loads(out)["figures"]["topics"][0]["topic"] == "/ft"


def test_long_array_is_no_sensor(tmp_path: Path) -> None:
    with Bag(tmp_path / "run") as bag:
        bag.array("/picture", START, np.zeros(10_000), "UInt8")
    (topic,) = inspect_recording(tmp_path / "run").topics
    assert (topic.messages, topic.streams, topic.taken_as) == (1, (), "")


def test_recording_without_messages_is_refused(tmp_path: Path) -> None:
    with Bag(tmp_path / "run"):
        pass
    with pytest.raises(InputError, match="found no message"):
        inspect_recording(tmp_path / "run")
