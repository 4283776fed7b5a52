"""The tare as a service: a caller of ROS 2 itself, rclpy, in a graph with the topics of sensor and motion."""

from __future__ import annotations

import importlib
import importlib.util
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_cases import Swing, columns_of, raw_of, tool_of
from numpy.typing import NDArray

from truewrench.correction.contact.run import TARED, ContactRun
from truewrench.live.ros2 import Topics
from truewrench.live.ros2_contact import CONTACT, COVARIANCE, TARE, contact_topics
from truewrench.live.ros2_node import Node, finish, taken
from truewrench.live.ros2_service import tare_service
from truewrench.live.ros2_types import (
    DiagnosticArray,
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
from truewrench.tool.model import Tool

Array = NDArray[np.float64]

PERIOD = 2_000_000  # [ns]
BEGIN = 1_700_000_000_000_000_000
PART = 300  # rows between two calls
HIT = np.array([20.0, -15.0, 10.0, 1.0, 0.5, -0.7])
OFF = np.array([0.5, -0.4, 0.6, 0.05, -0.04, 0.06])  # of the offset, since the tool was identified

needs_ros = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("rclpy", "std_srvs")),
    reason="rclpy and std_srvs are not installed: a service has no other caller",
)

CALLER = f"""
import json, sys, rclpy
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("caller")
client = node.create_client(Trigger, "{TARE}")
print(json.dumps(client.wait_for_service(timeout_sec=60.0)), flush=True)
for _ in sys.stdin:
    call = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, call, timeout_sec=30.0)
    print(json.dumps([call.result().success, call.result().message]), flush=True)
"""


pytestmark = pytest.mark.usefixtures("ros2_graph")


class Caller:
    """An rclpy node in a process of its own, which calls the service when it is told to."""

    def __init__(self) -> None:
        command = [sys.executable, "-c", CALLER]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def answer(self) -> Any:
        """The next line that it prints."""
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def call(self) -> Any:
        """Success and message."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self.answer()

    def end(self) -> None:
        """End it."""
        self._process.communicate(timeout=30)


@pytest.fixture
def caller() -> Iterator[Caller]:
    one = Caller()
    yield one
    one.end()


def heard(reader: Any) -> list[Any]:
    """All messages that have arrived."""
    found: list[Any] = []
    while some := [message for message, _ in taken(reader)]:
        found += some
    return found


class Robot:
    """Sensor, twist and gravity as topics, and what is heard of the contact wrench."""

    def __init__(self, tool: Tool) -> None:
        self._tool, self._motion, self._node, self._sent = tool, Swing(), Node(), 0
        kinds = {"/ft/raw": WrenchStamped, "/twist": TwistStamped, "/gravity": Vector3Stamped}
        self._senders = [self._node.writer(topic, kind) for topic, kind in kinds.items()]
        self._wrench = self._node.reader(CONTACT, WrenchStamped, True)
        self._covariance = self._node.reader(COVARIANCE, Float64MultiArray, True)
        self._diagnostics = self._node.reader("/diagnostics", DiagnosticArray, True)

    def wait(self) -> None:
        """Until somebody listens to all topics."""
        end = time.monotonic() + 60.0
        while time.monotonic() < end and not all(w.get_matched_subscriptions() for w in self._senders):
            time.sleep(0.05)

    def play(self, contact: Array) -> tuple[Array, Array]:
        """Move on under a contact; wrenches (M, 6) and covariances (M, 6, 6) that came of it."""
        rows = self._sent + np.arange(PART)
        self._sent += PART
        seconds = 1e-9 * PERIOD * rows
        tool = self._tool
        raw = raw_of(tool.theta, 1, tool.rig.gravity_array, self._motion, seconds, contact) + OFF
        columns = columns_of(self._motion, seconds)
        fall = np.einsum("kji,j->ki", self._motion.R(seconds), tool.rig.gravity_array)
        for k, row in enumerate(rows):
            header = Header(Time.of(BEGIN + PERIOD * int(row)), "tool0")
            v, w = ([float(columns[c + a][k]) for a in "xyz"] for c in ("v", "w"))
            self._senders[2].write(Vector3Stamped(header, Vector3(*fall[k].tolist())))
            self._senders[1].write(TwistStamped(header, Twist(Vector3(*v), Vector3(*w))))
            self._senders[0].write(WrenchStamped.of(header, raw[k].tolist()))
            if k % 20 == 0:
                time.sleep(0.02)
        time.sleep(0.5)
        wrench = np.array([message.values for message in heard(self._wrench)])
        covariance = np.array([message.data for message in heard(self._covariance)]).reshape(-1, 6, 6)
        return wrench, covariance

    def told(self) -> list[dict[str, Any]]:
        """What the diagnostics say of tares."""
        found = [{v.key: json.loads(v.value) for v in m.status[0].values} for m in heard(self._diagnostics)]
        return [one for one in found if one["event"] == "tare"]


def a_drifted_tool() -> Tool:
    topics = {"wrench_topic": "/ft/raw", "twist_topic": "/twist", "gravity_topic": "/gravity"}
    tool = replace(tool_of(1, recording=topics), offset_time_ns=BEGIN - 3600 * 10**9)
    return replace(tool, offset_walk=np.array([0.02, 0.02, 0.02, 0.002, 0.002, 0.002]))


@needs_ros
def test_a_caller_tares_away_from_contact_and_is_refused_in_contact(caller: Caller) -> None:
    tool, complaints = a_drifted_tool(), list[str]()
    parts: list[tuple[Array, Array]] = []
    answers: list[Any] = []
    told: list[dict[str, Any]] = []
    still = np.zeros(6)
    robot = Robot(tool)

    def play() -> None:
        try:
            robot.wait()
            answers.append(caller.answer())
            answers.append(caller.call())
            for contact in (still, still, HIT, still):
                parts.append(robot.play(contact))
                if len(parts) < 4:
                    answers.append(caller.call())
            told.extend(robot.told())
        finally:
            stop.request()

    with Stop() as stop:
        thread = threading.Thread(target=play)
        thread.start()
        run = ContactRun(tool, None)
        counts = contact_topics(run, tool.rig, Topics(reliable=True), stop, complaints.append, 180.0)
        thread.join()
    assert not complaints
    assert counts.used == 3 * 4 * PART
    there, early, first, again, touched = answers
    assert there, "no service appeared"
    assert early == [False, TARED["nothing"]]
    assert first == again == [True, ""]
    assert touched == [False, TARED["in_contact"]]
    assert [one["accepted"] for one in told] == [False, True, True, False]
    assert told[-1]["reason"] == touched[1]
    before, after, hit, free = (wrench[20:-20] for wrench, _ in parts)
    # what the offset has moved by is gone, in every pose after it; the contact is the one that was there
    gone = np.linalg.inv(tool.gain) @ OFF
    assert (np.abs(before.mean(axis=0)) > 0.5 * np.abs(gone)).any()
    assert np.linalg.norm(after[:20].mean(axis=0)) < 0.1 * np.linalg.norm(before[-20:].mean(axis=0))
    sigma = np.sqrt(np.diagonal(parts[1][1][20:-20], axis1=1, axis2=2))
    assert (np.abs(after) < 3.0 * sigma).all()
    assert (np.abs(hit - HIT) < 3.0 * sigma.max(axis=0)).all()
    # refused, the tare has taken nothing of the contact away
    assert (np.abs(free) < 3.0 * sigma.max(axis=0)).all()
    size = [float(np.trace(covariance[-1][:3, :3])) for _, covariance in parts]
    assert max(size[1:]) < 0.2 * size[0]  # an hour of drift is no longer in it


LISTENER = f"""
import rclpy
from geometry_msgs.msg import WrenchStamped
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(WrenchStamped, "{CONTACT}", lambda message: None, 10)
rclpy.spin(node)
"""


@needs_ros
def test_a_listener_that_hangs_does_not_hold_up_the_end() -> None:
    node = Node()
    writer = node.writer(CONTACT, WrenchStamped)
    listener = subprocess.Popen([sys.executable, "-c", LISTENER])
    try:
        end = time.monotonic() + 60.0
        while time.monotonic() < end and not writer.get_matched_subscriptions():
            time.sleep(0.05)
        time.sleep(0.5)
        listener.send_signal(signal.SIGSTOP)
        writer.write(WrenchStamped.of(Header(Time.of(BEGIN), "tool0"), [0.0] * 6))
        begun = time.monotonic()
        finish(writer)
        assert 0.5 < time.monotonic() - begun < 5.0  # it was waited for, and not for long
    finally:
        listener.kill()
        listener.wait()


def test_without_rclpy_there_is_no_service_and_no_word_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    complaints: list[str] = []
    with tare_service(TARE, complaints.append) as service:
        assert not list(service.asked())
    assert not complaints


def test_a_ros_that_is_half_installed_costs_the_service_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(name: str) -> Any:
        raise ImportError(f"no library of {name}")

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(importlib, "import_module", fail)
    complaints: list[str] = []
    with tare_service(TARE, complaints.append) as service:
        assert not list(service.asked())
    assert complaints == [f"{TARE}: no service: ImportError: no library of rclpy"]
