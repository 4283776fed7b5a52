"""Live in a ROS 2 graph: a real rclpy node (rmw_fastrtps_cpp) on the other side, loopback alone."""

from __future__ import annotations

import importlib.util
import json
import math
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from truewrench.calibrating.pipeline import calibrate
from truewrench.correction.apply import corrector
from truewrench.live import ros2_types
from truewrench.live.ros2 import Topics, calibrate_topics, correct_topic
from truewrench.live.ros2_node import Node, configuration, domain_id, ros_type, taken
from truewrench.live.ros2_types import (
    Float64MultiArray,
    Header,
    Temperature,
    Time,
    WrenchStamped,
    type_hash,
)
from truewrench.live.session import LiveCalibration
from truewrench.live.stop import Stop
from truewrench.model.calibration import Calibration, Verdict, load_calibration
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.rig import Rig
from truewrench.simulation.arm import simulate_arm
from truewrench.simulation.free_body import simulate

HERE = Path(__file__).parent
COMMAND = Path(sys.executable).with_name("truewrench")

needs_rclpy = pytest.mark.skipif(
    importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed: it is the other side"
)

Peer = Callable[..., "subprocess.Popen[str]"]


pytestmark = pytest.mark.usefixtures("ros2_graph")


def start_peer(script: str = "ros2_peer.py", **asked: Any) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    command = [sys.executable, str(HERE / script)]
    peer = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
    assert peer.stdin is not None
    peer.stdin.write(json.dumps(asked) + "\n")
    peer.stdin.flush()
    return peer


@dataclass
class Answer:
    """What a peer printed, once it has ended; then the stream is stopped, too."""

    stop: Stop
    peer: subprocess.Popen[str]
    said: dict[str, Any] | None = None

    def wait(self) -> None:
        assert self.peer.stdout is not None
        self.said = json.loads(self.peer.stdout.readlines()[-1])
        self.peer.wait()
        self.stop.request()


def samples(count: int) -> list[Any]:
    draw = np.random.default_rng(5)
    begin = 1_700_000_000_123_456_789
    return [
        [begin + 1_000_001 * k, f"tool{k % 3}", draw.normal(scale=20.0, size=6).tolist()]
        for k in range(count)
    ]


@needs_rclpy
def test_every_wrench_arrives_with_its_header_and_exact(calibration: Calibration) -> None:
    sent, complaints = samples(1000), list[str]()
    with Stop() as stop:
        answer = Answer(stop, start_peer(wrenches=sent, listen=["/truewrench/wrench"], until=1000))
        thread = threading.Thread(target=answer.wait)
        thread.start()
        counts = correct_topic(calibration, Topics(reliable=True), stop, complaints.append, 90.0)
        thread.join()
    assert answer.said is not None
    received = answer.said["received"]
    assert [message[:2] for message in received] == [message[:2] for message in sent]
    raw = np.array([message[2] for message in sent])
    wrench = np.linalg.solve(calibration.gain, (raw - calibration.offset).T).T
    np.testing.assert_allclose([message[2] for message in received], wrench, rtol=1e-12, atol=1e-12)
    assert counts.received == counts.used >= 1000  # and some probes
    assert (counts.refused, counts.lost) == (0, 0)
    assert all("is it more than one sensor?" in complaint for complaint in complaints)  # of frames
    # what `ros2 topic info -v` shows there is what it shows of ROS 2's own endpoints
    of_ros = answer.said["own"]["/ft/wrench_raw"][0]
    kind = "geometry_msgs/msg/WrenchStamped"
    assert answer.said["endpoints"]["/truewrench/wrench"] == [[kind, of_ros, "RELIABLE"]]
    assert answer.said["endpoints"]["/ft/wrench_raw"] == [[kind, of_ros, "RELIABLE"]]


@needs_rclpy
def test_command_refuses_wrong_messages_one_by_one_and_ends_by_a_signal(
    calibration: Calibration, tmp_path: Path
) -> None:
    path = tmp_path / "calibration.yaml"
    replace(calibration, verdict=Verdict(False, ("too short",))).write_yaml(path)
    sent = samples(40)
    sent[10][2][3] = math.nan
    sent[11][2][0] = math.inf
    sent[12][0] = 0
    sent[13][0] = sent[8][0]  # older than those before
    options = ["--ros2", "--wrench-topic", "/ft/wrench_raw", "--output-topic", "/corrected", "--json"]
    pipe = subprocess.PIPE
    live = subprocess.Popen([COMMAND, "stream", path, *options], stdout=pipe, stderr=pipe)
    peer = start_peer(wrenches=sent, listen=["/corrected"], until=36, reliable=False)
    said = json.loads(peer.communicate()[0])
    live.send_signal(signal.SIGTERM)
    out, err = live.communicate(timeout=90)
    assert live.returncode == 3
    good = [message for k, message in enumerate(sent) if k not in (10, 11, 12, 13)]
    assert [message[:2] for message in said["received"]] == [message[:2] for message in good]
    figures = json.loads(out)["figures"]
    assert figures["received"] - figures["used"] == figures["refused"] == 4
    assert err.count(b"expected finite channels") == 2
    assert b"no stamp" in err
    assert b"expected time that increases" in err
    assert said["endpoints"]["/ft/wrench_raw"][0][2] == "BEST_EFFORT"


@needs_rclpy
def test_joints_and_wrenches_of_two_topics_become_the_calibration_of_their_record(
    arm_rig: Callable[..., Rig], tmp_path: Path
) -> None:
    rig = arm_rig(
        "panda_ground",
        plan={"duration": 6},
        simulate={"rate": 100, "sensor_rate": 160},
        recording={"wrench_topic": "/ft/wrench_raw", "joint_topic": "/joint_states"},
        required=0.5,
    )
    simulated = simulate_arm(rig)
    log, begin = simulated.log, 1_700_000_000_000_000_000
    assert log.position is not None
    assert log.velocity is not None
    names = [f"panda_joint{k}" for k in range(1, 8)]
    order = [3, 1, 0, 2, 6, 5, 4]  # a driver's own
    told = ["finger", *(names[k] for k in order)]
    wrenches, joints = [], []
    for k, at in enumerate((log.time_ns + begin).tolist()):
        if np.isfinite(log.raw[k]).all():
            wrenches.append([at, "ft", log.raw[k].tolist()])
        if np.isfinite(log.position[k]).all():
            q, dq = log.position[k][order].tolist(), log.velocity[k][order].tolist()
            joints.append([at, told, [0.02, *q], [0.0, *dq]])
    peer = start_peer(wrenches=wrenches, joints=joints, diagnostics=True)

    def end(stop: Stop, session: LiveCalibration) -> None:
        deadline = time.monotonic() + 60.0
        while session.record.samples < len(wrenches) + len(joints) and time.monotonic() < deadline:
            time.sleep(0.05)
        stop.request()

    heard: set[str] = set()

    def refused(words: str) -> None:
        before = len(heard)
        heard.add(words.partition(":")[0])
        if before < len(heard) == 2:
            assert peer.stdin is not None
            peer.stdin.write("heard\n")
            peer.stdin.flush()

    with Stop() as stop, LiveCalibration(rig, "default") as session:
        threading.Thread(target=end, args=[stop, session]).start()
        named = Topics("/ft/wrench_raw", "/joint_states", reliable=True)
        counts, final = calibrate_topics(session, tmp_path, named, stop, refused, 40.0)
    assert heard == {"/ft/wrench_raw", "/joint_states"}
    assert final.final
    said = json.loads(peer.communicate()[0])
    assert counts.used == len(wrenches) + len(joints)
    made = load_calibration(tmp_path / "calibration.yaml")
    expected = calibrate(rig, replace(log, time_ns=log.time_ns + begin, tracking=None))
    np.testing.assert_allclose(made.gain, expected.gain, rtol=1e-6, atol=1e-9)
    assert np.abs((made.gain - simulated.truth.gain) / made.gain_std).max() < 5.0
    level, name, message, values = said["diagnostics"][-1]
    assert name == "truewrench: calibration"
    assert values["final"] == "true"
    assert np.array_equal(json.loads(values["gain"]), made.gain)
    assert (level == 0) == (message == "usable") == made.verdict.usable
    assert len(said["diagnostics"]) > 1  # and there was progress before
    assert said["endpoints"]["/diagnostics"][0][0] == "diagnostic_msgs/msg/DiagnosticArray"
    assert said["endpoints"]["/joint_states"][0][1] == said["own"]["/joint_states"][0]


def test_arrays_of_more_channels_become_wrenches_at_their_sending(
    calibration: Calibration, settings: dict[str, Any]
) -> None:
    draw = np.random.default_rng(11)
    gain, offset, noise = draw.normal(size=(8, 6)), draw.normal(size=8), draw.uniform(0.5, 2.0, size=8)
    names = [f"gauge{k}" for k in range(8)]
    sensor = {**settings["sensor"], "channels": names, "noise": noise.tolist(), "nominal_gain": gain.tolist()}
    more = replace(
        calibration,
        quadratic=None,
        quadratic_std=None,
        discrepancy=None,
        rig=Rig.from_mapping({**settings, "sensor": sensor}),
        gain=gain,
        offset=offset,
        covariance=1e-6 * np.eye(56),
    )
    other = Node()
    writer = other.writer("/gauges", Float64MultiArray)
    reader = other.reader("/truewrench/wrench", WrenchStamped, reliable=True)
    sent = draw.normal(scale=10.0, size=(5, 8))
    found: list[Any] = []

    def play(stop: Stop) -> None:
        end = time.monotonic() + 10.0
        while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
            time.sleep(0.02)
        begun = time.time_ns()
        for row in [*sent, sent[0][:6]]:  # the last one has too few
            writer.write(Float64MultiArray(data=row.tolist()))
        while len(found) < len(sent) and time.monotonic() < end:
            found.extend(message for message, _ in taken(reader))
            time.sleep(0.02)
        assert all(begun <= message.header.stamp.ns <= time.time_ns() for message in found)
        stop.request()

    complaints: list[str] = []
    with Stop() as stop:
        thread = threading.Thread(target=play, args=[stop])
        thread.start()
        correct_topic(more, Topics(reliable=True), stop, complaints.append, 15.0)
        thread.join()
    weight = np.diag(noise**-2.0)
    wrench = np.linalg.solve(gain.T @ weight @ gain, gain.T @ weight @ (sent - offset).T).T
    np.testing.assert_allclose([message.values for message in found], wrench, rtol=1e-9, atol=1e-9)
    assert complaints == ["/gauges: found 6 numbers, expected 8: one per channel"]


def test_type_hash_is_that_which_ros_2_publishes() -> None:  # share/geometry_msgs/msg/WrenchStamped.json
    known = "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
    assert type_hash(ros_type(WrenchStamped)) == f"RIHS01_{known}"


@pytest.mark.parametrize("frame", ["", "ft", "tool0_1", "wörld"])
def test_wrenches_are_packed_as_ros_2_packs_them(frame: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    message = WrenchStamped.of(Header(Time(1, 999_999_999), frame), [1.5, -2.0, 3.0, 4.0, 5.0, 1e-300])
    other = store.deserialize_cdr(message.serialize(), "geometry_msgs/msg/WrenchStamped")
    assert other.header.frame_id == frame
    assert (other.header.stamp.sec, other.header.stamp.nanosec) == (1, 999_999_999)
    assert (other.wrench.force.y, other.wrench.torque.z) == (-2.0, 1e-300)
    for little in (True, False):
        packed = bytes(store.serialize_cdr(other, "geometry_msgs/msg/WrenchStamped", little_endian=little))
        assert WrenchStamped.deserialize(packed) == message


def test_topic_that_nobody_publishes_is_named(
    calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("truewrench.live.ros2._PATIENCE", 0.2)
    with Stop() as stop, pytest.raises(InputError, match="no topic of type geometry_msgs/msg/WrenchStamped"):
        correct_topic(calibration, Topics(), stop, print, 1.0)


def test_silence_is_told_with_its_cause(calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truewrench.live.ros2._SILENCE", 0.3)
    other = Node()
    _kept = [other.writer("/silent", WrenchStamped), other.writer("/gauges", Float64MultiArray)]
    for topic, cause in (
        ("/none", "nobody"),
        ("/silent", "silent"),
        ("gauges", "carries std_msgs/msg/Float64M"),
    ):
        complaints: list[str] = []
        with Stop() as stop:
            correct_topic(calibration, Topics(topic), stop, complaints.append, 0.6)
        assert len(complaints) == 1
        assert cause in complaints[0]


def test_offset_follows_the_thermometer(calibration: Calibration) -> None:
    slope = np.array([0.3, -0.2, 0.1, 0.02, 0.01, -0.03])
    warm = replace(calibration, offset_temperature=slope)
    node, ended = Node(), threading.Event()
    wrench, celsius = node.writer("/ft/raw", WrenchStamped), node.writer("/warm", Temperature)
    heard = node.reader("/truewrench/wrench", WrenchStamped, False)
    found: list[float] = []

    def publish() -> None:
        stamp = time.time_ns()
        while not ended.is_set():
            stamp += 1_000_000
            header = Header(Time.of(stamp))
            celsius.write(Temperature(header, 31.0))
            wrench.write(WrenchStamped.of(header, [1.5, -2.0, 30.0, 0.25, -0.5, 0.125]))
            found.extend(message.wrench.force.x for message, _ in taken(heard))
            time.sleep(0.01)

    peer = threading.Thread(target=publish)
    peer.start()
    told: list[str] = []
    with Stop() as stop:
        counts = correct_topic(warm, Topics(), stop, told.append, 3.0)
    ended.set()
    peer.join()
    assert counts.used > 10
    raw = np.array([1.5, -2.0, 30.0, 0.25, -0.5, 0.125]) - calibration.offset
    expected = np.linalg.solve(calibration.gain, raw - slope * (31.0 - calibration.rig.temperature.reference))
    assert found[-1] == pytest.approx(expected[0], rel=1e-9)
    assert any("until one arrives" in words for words in told)
    assert not any(words.startswith("temperature:") for words in told)


def test_several_topics_of_a_type_are_listed(calibration: Calibration) -> None:
    other = Node()
    _kept = [other.writer(topic, WrenchStamped) for topic in ("/left/ft", "/right/ft")]
    with Stop() as stop, pytest.raises(InputError, match="the topics /left/ft, /right/ft, expected one"):
        correct_topic(calibration, Topics(), stop, print, 1.0)


def test_twist_rig_in_gravity_asks_for_its_topic(settings: dict[str, Any]) -> None:
    rig = Rig.from_mapping({**settings, "gravity": [0, 0, -9.81]})
    refused = pytest.raises(
        UnsupportedError, match=r"recording.gravity_topic: found nothing, expected the topic"
    )
    with Stop() as stop, LiveCalibration(rig, "default") as session, refused:
        calibrate_topics(session, None, Topics(), stop, print, 1.0)


@pytest.mark.parametrize("twist_topic", ["/twist", None])
@needs_rclpy
def test_calibrates_from_a_twist_in_gravity_and_corrects_as_soon_as_it_may(
    settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch, twist_topic: str | None
) -> None:
    """Twist, direction of gravity and temperature by topics of their own; wrenches by the latest estimate."""
    topics = {"wrench": "/ft/wrench_raw", "gravity": "/down", "temperature": "/warm"}
    rig = Rig.from_mapping({
        **settings, "gravity": [0, 0, -9.81], "plan": {"duration": 6}, "required": 10.0,
        "simulate": {"rate": 50, "sensor_rate": 100, "gain": "random", "seed": 3},
        "temperature": {"prior": 1e-3},
        "recording": {f"{role}_topic": name for role, name in topics.items()},
    })  # fmt: skip
    log = simulate(rig).log
    begin = 1_700_000_000_000_000_000
    streams = {
        "/ft/wrench_raw": ("geometry_msgs/msg/WrenchStamped", log.raw),
        "/twist": ("geometry_msgs/msg/TwistStamped", log.twist),
        "/down": ("geometry_msgs/msg/Vector3Stamped", log.gravity),
        "/warm": ("sensor_msgs/msg/Temperature", 20.0 + 0.0 * log.raw[:, :1]),
    }
    sent = {
        topic: (kind, [
            (begin + int(at), values.tolist())
            for at, values in zip(log.time_ns, rows, strict=True) if np.isfinite(values).all()
        ])
        for topic, (kind, rows) in streams.items() if rows is not None
    }  # fmt: skip
    total = sum(len(of) for _, of in sent.values())
    listen = ["/truewrench/wrench", "/truewrench/wrench_std"]
    # However long an estimate takes here, samples are left to correct by it.
    peer = start_peer("ros2_publisher.py", streams=sent, listen=listen, pause=begin + 4_000_000_000)
    used: list[Calibration] = []

    def tell(words: str) -> None:
        assert peer.stdin is not None
        peer.stdin.write(words + "\n")
        peer.stdin.flush()

    def noted(found: Calibration, name: str) -> Any:
        if not used:
            tell("an estimate may be used")
        used.append(found)
        return corrector(found, name)

    monkeypatch.setattr("truewrench.live.ros2.corrector", noted)
    heard: set[str] = set()

    def refused(words: str) -> None:
        assert "found no stamp" in words  # the probes
        before = len(heard)
        heard.add(words.partition(":")[0])
        if before < len(heard) == len(sent):
            tell("heard")

    def end(stop: Stop, session: LiveCalibration) -> None:
        deadline = time.monotonic() + 90.0
        while session.record.samples < total and time.monotonic() < deadline:
            time.sleep(0.05)
        stop.request()

    with Stop() as stop, LiveCalibration(rig, "default") as session:
        threading.Thread(target=end, args=[stop, session]).start()
        asked = Topics(motion=twist_topic, reliable=True)
        counts, final = calibrate_topics(session, None, asked, stop, refused, 90.0)
        columns = session.record.columns()
    said = json.loads(peer.communicate()[0])
    assert (counts.used, counts.lost) == (total, 0)
    for name, values in {"wz": log.twist[:, 5], "gz": log.gravity[:, 2], "raw_3": log.raw[:, 3]}.items():
        np.testing.assert_array_equal(columns[name], values)
    assert final.usable
    assert used  # an estimate on the way was usable, too
    raw = dict(sent["/ft/wrench_raw"][1])
    wrenches, stds = (
        {stamp: np.array(values) for topic, stamp, values in said if topic == name} for name in listen
    )
    assert wrenches
    for stamp, wrench in wrenches.items():
        by_each = []
        for found in used:
            assert found.offset_temperature is not None
            offset = found.offset + found.offset_temperature * (20.0 - rig.temperature.reference)
            by_each.append(np.linalg.solve(found.gain, raw[stamp] - offset))
        assert min(np.abs(wrench - one).max() for one in by_each) < 1e-9
    assert stds.keys() <= wrenches.keys()
    assert all((std > 0.0).all() for std in stds.values())


@pytest.mark.parametrize("name", ["Imu", "Temperature", "Vector3Stamped"])
def test_other_messages_are_read_as_ros_2_packs_them(name: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = getattr(ros2_types, name)
    draw, types = np.random.default_rng(3), store.types

    def filled(type_name: str) -> Any:
        if type_name == "std_msgs/msg/Header":
            stamp = types["builtin_interfaces/msg/Time"](sec=5, nanosec=6)
            return types[type_name](stamp=stamp, frame_id="frame")
        fields = {}
        for field, (node, what) in store.fielddefs[type_name][1]:
            if node == 2:
                fields[field] = filled(what)
            else:
                fields[field] = draw.normal(size=9) if node == 3 else float(draw.normal())
        return types[type_name](**fields)

    message = filled(ros_type(kind))
    read = kind.deserialize(bytes(store.serialize_cdr(message, ros_type(kind))))
    expected = {
        "Imu": lambda m: tuple(
            getattr(part, axis) for part in (m.angular_velocity, m.linear_acceleration) for axis in "xyz"
        ),
        "Temperature": lambda m: (m.temperature,),
        "Vector3Stamped": lambda m: (m.vector.x, m.vector.y, m.vector.z),
    }[name](message)
    assert read.values == expected
    assert (read.header.stamp.ns, read.header.frame_id) == (5_000_000_006, "frame")


def test_environment_of_ros_decides_who_is_met(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 'NetworkInterface address="127.0.0.1"' in configuration()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    assert "127.0.0.1" not in configuration()
    monkeypatch.setenv("ROS_STATIC_PEERS", "192.0.2.1;robot.local")
    assert '<Peer Address="192.0.2.1"/><Peer Address="robot.local"/>' in configuration()
    chosen = configuration("192.0.2.7")
    assert '<NetworkInterface address="192.0.2.7"/>' in chosen
    assert '<Peer Address="192.0.2.1"/>' in chosen
    assert '<NetworkInterface name="eth0"/>' in configuration("eth0")
    with pytest.raises(InputError, match="--interface"):
        configuration('a"b')
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///etc/cyclone.xml")
    assert configuration().endswith(",file:///etc/cyclone.xml")
    _, uri, over = configuration("192.0.2.7").split(",")
    assert uri == "file:///etc/cyclone.xml"
    assert "192.0.2.7" in over
    assert "robot.local" not in configuration()
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    with pytest.raises(InputError, match="0 to 232"):
        domain_id()
