"""Recordings as `rosbags` writes them, for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from truewrench.model.rig import Rig

KINDS = (
    "sqlite3",
    "mcap",
    "mcap-storage",
    "mcap-file",
    "mcap-message",
    "sqlite3-file",
    "sqlite3-message",
    "bag",
)
"""Storage, and how it is compressed."""

START = 1_700_000_000_000_000_000
"""Stamps as large as real ones: a double does not hold their nanoseconds."""

MS = 1_000_000

Numbers = Sequence[float] | np.ndarray[Any, Any]


class Bag:
    """A recording that is being written.

    Attributes:
        path: what is given to the reader: a folder, or a .bag.
        store: of message types.
    """

    def __init__(self, path: Path, kind: str = "mcap") -> None:
        self.ros1 = kind == "bag"
        self.path = path.with_suffix(".bag") if self.ros1 else path
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self._connections: dict[tuple[str, str], Any] = {}
        if self.ros1:
            self._writer: Any = Writer1(self.path)
        else:
            storage, _, compression = kind.partition("-")
            self._writer = Writer2(self.path, version=9, storage_plugin=StoragePlugin[storage.upper()])
            if compression:
                self._writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)

    def __enter__(self) -> Bag:
        self._writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def write(self, topic: str, type_name: str, receive: int, message: object) -> None:
        """Write one message."""
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.write_bytes(topic, type_name, receive, bytes(serialize(message, type_name)))

    def write_bytes(self, topic: str, type_name: str, receive: int, data: bytes) -> None:
        """Write one message as it is."""
        key = (topic, type_name)
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(topic, type_name, typestore=self.store)
        self._writer.write(self._connections[key], receive, data)

    def type(self, name: str) -> Any:
        """The class of a message."""
        return self.store.types[name]

    def header(self, stamp: int, frame: str = "tool0") -> Any:
        """A header with a stamp [ns]."""
        time = self.type("builtin_interfaces/msg/Time")(sec=stamp // 10**9, nanosec=stamp % 10**9)
        more = {"seq": 7} if self.ros1 else {}
        return self.type("std_msgs/msg/Header")(stamp=time, frame_id=frame, **more)

    def vector(self, xyz: Numbers) -> Any:
        """A Vector3."""
        x, y, z = (float(value) for value in xyz)
        return self.type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)

    def wrench(
        self, topic: str, stamp: int, six: Numbers, receive: int | None = None, frame: str = "ft"
    ) -> None:
        """A WrenchStamped."""
        kind = "geometry_msgs/msg/WrenchStamped"
        inner = self.type("geometry_msgs/msg/Wrench")(force=self.vector(six[:3]), torque=self.vector(six[3:]))
        self.write(
            topic, kind, receive or stamp, self.type(kind)(header=self.header(stamp, frame), wrench=inner)
        )

    def twist(self, topic: str, stamp: int, six: Numbers, receive: int | None = None) -> None:
        """A TwistStamped."""
        kind = "geometry_msgs/msg/TwistStamped"
        inner = self.type("geometry_msgs/msg/Twist")(
            linear=self.vector(six[:3]), angular=self.vector(six[3:])
        )
        self.write(topic, kind, receive or stamp, self.type(kind)(header=self.header(stamp), twist=inner))

    def joints(
        self, topic: str, stamp: int, q: Mapping[str, float], dq: Mapping[str, float] | None = None,
        receive: int | None = None,
    ) -> None:  # fmt: skip
        """A JointState, with or without velocities."""
        kind = "sensor_msgs/msg/JointState"
        velocity = [] if dq is None else [dq[name] for name in q]
        message = self.type(kind)(
            header=self.header(stamp, ""),
            name=list(q),
            position=np.array(list(q.values()), dtype=np.float64),
            velocity=np.array(velocity, dtype=np.float64),
            effort=np.empty(0),
        )
        self.write(topic, kind, receive or stamp, message)

    def array(self, topic: str, receive: int, values: Numbers, kind: str = "Float64") -> None:
        """A Float64MultiArray, or another; it has no header."""
        layout = self.type("std_msgs/msg/MultiArrayLayout")(dim=[], data_offset=0)
        name = f"std_msgs/msg/{kind}MultiArray"
        data = np.array(values, dtype=kind.lower())
        self.write(topic, name, receive, self.type(name)(layout=layout, data=data))


def record(path: Path, kind: str, columns: Mapping[str, np.ndarray[Any, Any]], start: int = 0) -> Path:
    """A table of `time_ns`, `raw_*` and a twist or joints as a recording; NaN: there is no message."""
    names = list(columns)
    joints = [name[2:] for name in names if name.startswith("q_")]
    groups = {"raw": [n for n in names if n.startswith("raw_")]}
    if joints:
        groups |= {"q": [f"q_{j}" for j in joints], "dq": [f"dq_{j}" for j in joints if f"dq_{j}" in names]}
    else:
        groups["twist"] = ["vx", "vy", "vz", "wx", "wy", "wz"]
    values = {key: np.column_stack([columns[n] for n in group]) for key, group in groups.items() if group}
    with Bag(path, kind) as bag:
        for i, t in enumerate(columns["time_ns"]):
            stamp = start + int(t)
            if not np.isnan(values["raw"][i]).all():
                bag.wrench("/ft/wrench", stamp, values["raw"][i])
            if joints and not np.isnan(values["q"][i]).all():
                dq = dict(zip(joints, values["dq"][i].tolist(), strict=True)) if "dq" in values else None
                bag.joints(
                    "/joint_states", stamp, dict(zip(joints, values["q"][i].tolist(), strict=True)), dq
                )
            if not joints and not np.isnan(values["twist"][i]).all():
                bag.twist("/tool/twist", stamp, values["twist"][i])
    return bag.path


def write(tmp_path: Path, kind: str, fill: Callable[[Bag], None]) -> Path:
    """A recording that a function fills."""
    with Bag(tmp_path / "run", kind) as bag:
        fill(bag)
    return bag.path


def still(bag: Bag, samples: int = 20) -> None:
    """A sensor and a twist on topics of their own."""
    for i in range(samples):
        bag.wrench("/ft", START + i * MS, [i, 0, 0, 0, 0, 1])
        bag.twist("/twist", START + i * MS, [0, 0, 0, 0, 0, i])


def with_recording(rig: Rig, **recording: str) -> Rig:
    """The rig with keys of its `recording`."""
    return Rig.from_mapping({**rig.to_mapping(), "recording": recording})
