"""Recordings by ROS 2 and ROS 1 themselves and by Foxglove's writer are read, every message of them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from truewrench.inspection.recording import inspect_recording
from truewrench.io.tables import read_log
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of

SAMPLES = 300
START = 1_700_000_000_000_000_000

# A node that publishes, and one that takes the bytes as they come and gives them to Foxglove's writer.
ROS_2 = """
import sys, time, rclpy
from geometry_msgs.msg import WrenchStamped
from mcap.writer import Writer
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

path, samples, start, *names = sys.argv[1:]
samples, start, store = int(samples), int(start), get_typestore(Stores.ROS2_HUMBLE)
rclpy.init(args=["--ros-args", "--disable-rosout-logs"])
node, qos = Node("recorder"), QoSProfile(depth=10 * samples)
taken = {"/ft": [], "/joint_states": []}
kinds = {"/ft": WrenchStamped, "/joint_states": JointState}
publishers = {topic: node.create_publisher(kind, topic, qos) for topic, kind in kinds.items()}
for topic, kind in kinds.items():
    node.create_subscription(kind, topic, taken[topic].append, qos, raw=True)
wanted = time.monotonic() + 20
while any(p.get_subscription_count() < 1 for p in publishers.values()) and time.monotonic() < wanted:
    rclpy.spin_once(node, timeout_sec=0.01)
for i in range(samples):
    stamp = start + i * 1_000_000
    position = [0.1 * i + j for j in range(len(names))]
    wrench, joints = WrenchStamped(), JointState(name=names, position=position)
    for message in (wrench, joints):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.header.frame_id = "tool0"
    wrench.wrench.force.x, wrench.wrench.torque.z = i / 3, -i / 7
    publishers["/ft"].publish(wrench)
    publishers["/joint_states"].publish(joints)
    rclpy.spin_once(node, timeout_sec=0)
while min(map(len, taken.values())) < samples and time.monotonic() < wanted:
    rclpy.spin_once(node, timeout_sec=0.01)
with open(path, "wb") as file:
    writer = Writer(file)
    writer.start(profile="ros2", library="test")
    types = {"/ft": "geometry_msgs/msg/WrenchStamped", "/joint_states": "sensor_msgs/msg/JointState"}
    for topic, kind in types.items():
        definition = store.generate_msgdef(kind, ros_version=2)[0]
        schema = writer.register_schema(kind, "ros2msg", definition.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        for i, data in enumerate(taken[topic]):
            writer.add_message(channel, log_time=start + i * 1_000_000 + 5, publish_time=0, data=data)
    writer.finish()
"""

ROS_1 = """
import sys, rosbag, rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

path, samples, start, compression, *names = sys.argv[1:]
with rosbag.Bag(path, "w", compression=compression) as bag:
    for i in range(int(samples)):
        stamp = rospy.Time(*divmod(int(start) + i * 1000000, 10**9))
        wrench, joints = WrenchStamped(), JointState()
        for message in (wrench, joints):
            message.header.stamp, message.header.seq, message.header.frame_id = stamp, i, "tool%d" % (i % 3)
        wrench.wrench.force.x, wrench.wrench.torque.z = i / 3, -i / 7
        joints.name, joints.position = names, [0.1 * i + j for j in range(len(names))]
        bag.write("/ft", wrench, stamp)
        bag.write("/joint_states", joints, stamp)
"""


def positions_alone(arm_rig: Callable[..., Rig]) -> tuple[Rig, list[str]]:
    rig = arm_rig("ur10")
    names = list(robot_of(rig).joints)
    settings = rig.to_mapping()
    settings["motion"] |= {"position_noise": [1e-5] * len(names)}
    return Rig.from_mapping(settings, rig.path), names


def check(path: Path, rig: Rig, joints: int) -> None:
    log = read_log(path, rig)
    assert log.position is not None
    i = np.arange(SAMPLES)
    np.testing.assert_array_equal(log.time_ns, START + 1_000_000 * i)
    np.testing.assert_array_equal(log.raw[:, 0], i / 3)
    np.testing.assert_array_equal(log.raw[:, 5], -i / 7)
    np.testing.assert_array_equal(log.position, 0.1 * i[:, None] + np.arange(joints))
    assert log.velocity is None
    content = inspect_recording(path)
    assert {topic.topic: topic.messages for topic in content.topics} == {
        "/ft": SAMPLES,
        "/joint_states": SAMPLES,
    }


def test_messages_that_passed_through_ros_2_are_all_read(arm_rig: Callable[..., Rig], tmp_path: Path) -> None:
    for name in ("rclpy", "mcap"):
        pytest.importorskip(name)
    rig, names = positions_alone(arm_rig)
    path = tmp_path / "run.mcap"
    environment = {**os.environ, "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "ROS_DOMAIN_ID": "87"}
    command = [sys.executable, "-c", ROS_2, str(path), str(SAMPLES), str(START), *names]
    subprocess.run(command, check=True, env=environment, timeout=60)
    check(path, rig, len(names))


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_bag_of_ros_1_is_read_to_the_last_message(
    arm_rig: Callable[..., Rig], tmp_path: Path, compression: str
) -> None:
    python = "/usr/bin/python3"  # that of the system, whose packages ROS 1 is
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    probe = [python, "-c", "import rosbag, rospy, geometry_msgs.msg, sensor_msgs.msg"]
    if not Path(python).exists() or subprocess.run(probe, env=environment, capture_output=True).returncode:
        pytest.skip("no ROS 1 here (Debian: python3-rosbag python3-geometry-msgs python3-sensor-msgs)")
    rig, names = positions_alone(arm_rig)
    path = tmp_path / "run.bag"
    command = [python, "-c", ROS_1, str(path), str(SAMPLES), str(START), compression, *names]
    subprocess.run(command, check=True, env=environment, timeout=60)
    check(path, rig, len(names))


def test_recording_of_foxglove_is_read(rig: Rig, tmp_path: Path) -> None:
    ros2 = pytest.importorskip("mcap_ros2.writer")
    well_known = pytest.importorskip("mcap.well_known")
    assert well_known.Profile.ROS2 == "ros2"
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = ros2.Writer(file)
        kinds = [f"geometry_msgs/msg/{name}Stamped" for name in ("Wrench", "Twist")]
        schemas = [
            writer.register_msgdef(kind, store.generate_msgdef(kind, ros_version=2)[0]) for kind in kinds
        ]
        for i in range(SAMPLES):
            stamp = START + i * 1_000_000
            header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "ft" * (i % 4)}
            force, torque = {"x": i / 3, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": -i / 7}
            wrench = {"header": header, "wrench": {"force": force, "torque": torque}}
            twist = {"header": header, "twist": {"linear": force, "angular": torque}}
            writer.write_message("/ft", schemas[0], wrench, log_time=stamp)
            writer.write_message("/twist", schemas[1], twist, log_time=stamp)
        writer.finish()
    log = read_log(tmp_path / "run.mcap", rig)
    assert log.twist is not None
    np.testing.assert_array_equal(log.time_ns, START + 1_000_000 * np.arange(SAMPLES))
    for values in (log.raw, log.twist):
        np.testing.assert_array_equal(values[:, 0], np.arange(SAMPLES) / 3)
        np.testing.assert_array_equal(values[:, 5], -np.arange(SAMPLES) / 7)
    note = "/ft: messages of 3 frames (`ft`, `ftft`, `ftftft`): is it more than one sensor?"
    assert log.notes == (note,)
