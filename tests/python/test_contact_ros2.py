"""The contact wrench in a ROS 2 graph: topics, the numbers of a table, tare by topic."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_cases import Swing, columns_of, raw_of, tool_of

from truewrench.correction.contact.run import ContactRun
from truewrench.live.ros2 import Topics
from truewrench.live.ros2_contact import CONTACT, COVARIANCE, IN_CONTACT, TARE, contact_topics
from truewrench.live.ros2_merge import RESTART, Merger
from truewrench.live.ros2_node import Node, taken
from truewrench.live.ros2_types import (
    Bool,
    DiagnosticArray,
    Empty,
    Float64MultiArray,
    Header,
    Time,
    Twist,
    TwistStamped,
    Vector3,
    Vector3Stamped,
    WrenchStamped,
)
from truewrench.live.stop import Stop
from truewrench.model.errors import InputError
from truewrench.tool.model import Tool

COUNT = 600
PERIOD = 2_000_000
BEGIN = 1_700_000_000_000_000_000


pytestmark = pytest.mark.usefixtures("ros2_graph")


def tool_and_rows() -> tuple[Tool, Any, Any, dict[str, Any]]:
    topics = {"wrench_topic": "/ft/raw", "twist_topic": "/twist", "gravity_topic": "/gravity"}
    tool, motion = replace(tool_of(1, recording=topics), offset_time_ns=BEGIN), Swing()
    time_ns = BEGIN + PERIOD * np.arange(COUNT, dtype=np.int64)
    seconds = 1e-9 * (time_ns - BEGIN)
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, seconds, np.zeros(6))
    columns = columns_of(motion, seconds)
    fall = np.einsum("kji,j->ki", motion.R(seconds), tool.rig.gravity_array)
    columns = {name: columns[name] for name in ("vx", "vy", "vz", "wx", "wy", "wz")}
    return tool, time_ns, raw, columns | {name: fall[:, k] for k, name in enumerate(("gx", "gy", "gz"))}


def test_topics_have_the_numbers_of_a_table_and_a_tare_is_heard() -> None:
    tool, time_ns, raw, columns = tool_and_rows()
    node = Node()
    senders = [
        node.writer(topic, kind)
        for topic, kind in (
            ("/ft/raw", WrenchStamped),
            ("/twist", TwistStamped),
            ("/gravity", Vector3Stamped),
        )
    ]
    listeners: dict[str, Any] = {
        topic: node.reader(topic, kind, True)
        for topic, kind in (
            (CONTACT, WrenchStamped),
            (COVARIANCE, Float64MultiArray),
            (IN_CONTACT, Bool),
            ("/diagnostics", DiagnosticArray),
        )
    }
    tare = node.writer(TARE, Empty)
    heard: dict[str, list[Any]] = {topic: [] for topic in listeners}
    complaints: list[str] = []

    def collect() -> None:
        for topic, reader in listeners.items():
            heard[topic] += [message for message, _ in taken(reader)]

    def play() -> None:
        try:
            end = time.monotonic() + 60.0
            while time.monotonic() < end and not all(w.get_matched_subscriptions() for w in (*senders, tare)):
                time.sleep(0.05)
            for k in range(COUNT):
                header = Header(Time.of(int(time_ns[k])), "tool0")
                v, w, g = ([float(columns[c + a][k]) for a in "xyz"] for c in ("v", "w", "g"))
                senders[2].write(Vector3Stamped(header, Vector3(*g)))
                senders[1].write(TwistStamped(header, Twist(Vector3(*v), Vector3(*w))))
                senders[0].write(WrenchStamped.of(header, raw[k].tolist()))
                if k % 20 == 0:
                    time.sleep(0.02)
                    collect()
            quiet = 0  # turns: on a busy machine the tare must not overtake what comes before it
            while time.monotonic() < end and (len(heard[CONTACT]) <= COUNT - 30 or quiet < 25):
                time.sleep(0.02)
                before = len(heard[CONTACT])
                collect()
                quiet = quiet + 1 if len(heard[CONTACT]) == before else 0
            tare.write(Empty())
            time.sleep(0.5)
            collect()
        finally:
            stop.request()

    with Stop() as stop:
        thread = threading.Thread(target=play)
        thread.start()
        run = ContactRun(tool, None)
        counts = contact_topics(run, tool.rig, Topics(reliable=True), stop, complaints.append, 120.0)
        thread.join()
    assert not complaints
    assert counts.received == counts.used == 3 * COUNT
    table = ContactRun(tool, None).feed(time_ns, raw, columns)
    lagging = len(heard[CONTACT])
    assert lagging > COUNT - 30
    rows = table.rows[-lagging:]
    stamps = [m.header.stamp.ns for m in heard[CONTACT]]
    assert stamps == time_ns[rows].tolist()
    assert {m.header.frame_id for m in heard[CONTACT]} == {"tool0"}
    wrench = np.array([m.values for m in heard[CONTACT]])
    np.testing.assert_allclose(wrench, table.wrench[-lagging:], rtol=1e-12, atol=1e-12)
    covariance = np.array([m.data for m in heard[COVARIANCE]]).reshape(-1, 6, 6)
    np.testing.assert_allclose(covariance, table.covariance[-lagging:], rtol=1e-12, atol=1e-12)
    assert not any(m.data for m in heard[IN_CONTACT])
    told = [{v.key: v.value for v in m.status[0].values} for m in heard["/diagnostics"]]
    assert told[0]["event"] == '"tare"'
    assert told[0]["accepted"] == "true"


def test_messages_of_two_sensors_on_one_topic_are_told() -> None:
    tool, time_ns, raw, _ = tool_and_rows()
    node, complaints = Node(), list[str]()
    sender = node.writer("/ft/raw", WrenchStamped)

    def play() -> None:
        try:
            end = time.monotonic() + 60.0
            while time.monotonic() < end and not sender.get_matched_subscriptions():
                time.sleep(0.05)
            for k, frame in enumerate(("left", "right", "left")):
                sender.write(WrenchStamped.of(Header(Time.of(int(time_ns[k])), frame), raw[k].tolist()))
            while time.monotonic() < end and not complaints:
                time.sleep(0.02)
        finally:
            stop.request()

    with Stop() as stop:
        thread = threading.Thread(target=play)
        thread.start()
        contact_topics(ContactRun(tool, None), tool.rig, Topics(reliable=True), stop, complaints.append, 60.0)
        thread.join()
    assert complaints == ["/ft/raw: messages of frames `left`, `right`: is it more than one sensor?"]


def test_rows_of_several_topics_come_out_in_order() -> None:
    merger = Merger(["/a", "/b"])
    merger.add("/a", 10, ("raw_0",), (1.0,), "header", 0.0)
    merger.add("/a", 20, ("raw_0",), (2.0,), "header", 0.0)
    assert not list(merger.rows(0.0))
    merger.add("/warm", 7, ("temperature",), (25.0,), None, 0.0)
    merger.add("/b", 10, ("vx",), (3.0,), None, 0.0)
    (row,) = merger.rows(0.0)
    assert (row.time_ns, row.values, row.header) == (
        10,
        {"raw_0": 1.0, "vx": 3.0, "temperature": 25.0},
        "header",
    )
    assert [row.time_ns for row in merger.rows(1.0)] == [20]  # patience is over
    with pytest.raises(InputError, match="time that increases"):
        merger.add("/b", 20, ("vx",), (3.0,), None, 1.0)
    assert not merger.add("/a", 3 * RESTART, ("raw_0",), (2.0,), "header", 1.0)
    assert [row.time_ns for row in merger.rows(2.0)] == [3 * RESTART]
    assert merger.add("/a", 30, ("raw_0",), (2.0,), "header", 2.0)  # of another run, or one stamp was wrong
    assert not merger.add("/b", 30, ("vx",), (3.0,), None, 2.0)
    assert [row.time_ns for row in merger.rows(2.0)] == [30]
