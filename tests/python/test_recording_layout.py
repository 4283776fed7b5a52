"""Numbers are found where `rosbags` and ROS 2 itself put them, whatever the texts, lengths and paddings."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from truewrench.io.recordings.layout import layouts_of, read_layout

STORES = {True: get_typestore(Stores.ROS1_NOETIC), False: get_typestore(Stores.ROS2_HUMBLE)}
JOINTS = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"

numbers = st.lists(st.floats(width=64), max_size=5)
names = st.lists(
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=9), max_size=5
)
stamps = st.integers(0, 2**31 * 10**9 - 1)


def joint_state(ros1: bool, stamp: int, frame: str, texts: list[str], lists: list[list[float]]) -> bytes:
    store: Any = STORES[ros1]
    header = {"seq": 3} if ros1 else {}
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    message = store.types[JOINTS](
        header=store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **header),
        name=texts,
        position=np.array(lists[0]), velocity=np.array(lists[1]), effort=np.array(lists[2]),
    )  # fmt: skip
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    return bytes(serialize(message, JOINTS))


@settings(deadline=None, max_examples=60)
@given(
    st.booleans(),
    st.lists(st.tuples(stamps, names, st.tuples(numbers, numbers, numbers)), min_size=1, max_size=12),
)
def test_numbers_are_those_that_were_written(ros1: bool, drawn: list[Any]) -> None:
    messages = [joint_state(ros1, stamp, "", texts, lists) for stamp, texts, lists in drawn]
    seen = set()
    for rows, layout, block in layouts_of(messages, [], JOINTS, STORES[ros1].fielddefs, ros1):
        for k, row in enumerate(rows.tolist()):
            seen.add(row)
            stamp, texts, lists = drawn[row]
            assert layout.texts.get("name", ()) == tuple(texts)
            for path, values in zip(("position", "velocity", "effort"), lists, strict=True):
                np.testing.assert_array_equal(layout.read(block, path)[k], values)
            assert layout.read(block, "header.stamp.sec")[k, 0] == stamp // 10**9
            assert layout.read(block, "header.stamp.nanosec")[k, 0] == stamp % 10**9
    assert seen == set(range(len(messages)))


@pytest.mark.parametrize(
    "kind", ["nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "geometry_msgs/msg/TwistStamped"]
)
@pytest.mark.parametrize("ros1", [True, False])
def test_every_number_of_a_message_has_its_path(ros1: bool, kind: str) -> None:
    store: Any = STORES[ros1]
    draw = np.random.default_rng(0)
    expected: dict[str, Any] = {}

    def filled(name: str, path: str) -> Any:
        fields = {}
        for member, (node, what) in store.fielddefs[name][1]:
            inner = f"{path}{member}"
            if node == 2:
                fields[member] = filled(what, f"{inner}.")
            elif node == 3:
                fields[member] = expected[inner] = draw.normal(size=what[1])
            elif what[0] == "string":
                fields[member] = "text" + member
            else:
                value = draw.normal() if what[0] == "float64" else int(draw.integers(1000))
                fields[member], expected[inner] = value, [value]
        return store.types[name](**fields)

    message = filled(kind, "")
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    data = bytes(serialize(message, kind))
    layout = read_layout(data, kind, store.fielddefs, ros1)
    assert set(layout.numbers) == set(expected)
    for path, values in expected.items():
        np.testing.assert_array_equal(layout.read(np.frombuffer(data, np.uint8)[None], path)[0], values)


def test_big_endian_is_read() -> None:
    store = STORES[False]
    head = b"\0\0\0\0" + struct.pack(">iII5s7x", 5, 6, 5, b"abcd\0")
    layout = read_layout(head + struct.pack(">6d", *range(6)), WRENCH, store.fielddefs, False)
    assert layout.texts["header.frame_id"] == ("abcd",)
    message = np.frombuffer(head + struct.pack(">6d", *range(6)), np.uint8)[None]
    assert layout.read(message, "wrench.torque.z")[0, 0] == 5
    assert layout.read(message, "header.stamp.sec")[0, 0] == 5


@pytest.mark.parametrize("cut", [1, 5, 20, 60])
@pytest.mark.parametrize("ros1", [True, False])
def test_short_message_is_refused(ros1: bool, cut: int) -> None:
    data = joint_state(ros1, 10, "frame", ["a", "b"], [[1.0, 2.0], [], []])
    with pytest.raises(ValueError, match=r"message 1: .*(fewer|encoding)"):
        layouts_of([data, data[: len(data) - cut]], [], JOINTS, STORES[ros1].fielddefs, ros1)


def test_unknown_encoding_and_surplus_bytes_are_refused() -> None:
    data = joint_state(False, 10, "frame", ["a"], [[1.0], [], []])
    with pytest.raises(ValueError, match="an encoding 0007, which is not plain CDR"):
        read_layout(b"\0\7" + data[2:], JOINTS, STORES[False].fielddefs, False)
    with pytest.raises(ValueError, match="more than the"):
        read_layout(data + bytes(60), JOINTS, STORES[False].fielddefs, False)
    ros1 = joint_state(True, 10, "frame", ["a"], [[1.0], [], []])
    with pytest.raises(ValueError, match="more than the"):
        read_layout(ros1 + b"\0", JOINTS, STORES[True].fielddefs, True)


def test_messages_of_ros_2_itself_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    serialization = pytest.importorskip("rclpy.serialization")
    messages = pytest.importorskip("sensor_msgs.msg")
    joints = messages.JointState(name=["elbow", "wrist_1"], position=[1.5, -2.5])
    joints.header.stamp.sec = 9
    data = bytes(serialization.serialize_message(joints))
    layout = read_layout(data, JOINTS, STORES[False].fielddefs, False)
    block = np.frombuffer(data, np.uint8)[None]
    assert layout.texts["name"] == ("elbow", "wrist_1")
    np.testing.assert_array_equal(layout.read(block, "position")[0], [1.5, -2.5])
    assert layout.numbers["velocity"].count == 0
    assert layout.read(block, "header.stamp.sec")[0, 0] == 9
