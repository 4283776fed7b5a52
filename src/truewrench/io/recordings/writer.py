"""A recording that is written: MCAP, profile ros2."""

import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.files import atomic_output

WRENCH = "geometry_msgs/msg/WrenchStamped"
ARRAY = "std_msgs/msg/Float64MultiArray"

_LAST = 2**31 * 1_000_000_000  # seconds of a ROS 2 stamp have 31 bits


class McapWriter:
    """Messages of wrenches and arrays, many at once."""

    def __init__(self, path: Path, writer: Any, frame: str) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._path, self._writer, self._frame = path, writer, frame
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._connections: dict[str, Any] = {}

    def wrenches(self, topic: str, time: Integers, values: Array) -> None:
        """WrenchStamped: stamps (N,) [ns] and wrenches (N, 6) [N, N m]."""
        frame = self._frame.encode() + b"\0"
        start = -(-(16 + len(frame) - 4) // 8) * 8 + 4  # of the numbers, aligned to 8 after 4 bytes
        messages = np.zeros(
            len(time),
            np.dtype(
                {
                    "names": ["encoding", "sec", "nanosec", "length", "frame", "values"],
                    "formats": ["V4", "<i4", "<u4", "<u4", f"V{len(frame)}", "(6,)<f8"],
                    "offsets": [0, 4, 8, 12, 16, start],
                    "itemsize": start + 48,
                }
            ),
        )
        messages["encoding"] = np.void(b"\0\1\0\0")
        messages["sec"], messages["nanosec"] = np.divmod(time, 1_000_000_000)
        messages["length"], messages["frame"], messages["values"] = len(frame), np.void(frame), values
        self._write(topic, WRENCH, time, messages.tobytes(), messages.itemsize)

    def arrays(self, topic: str, time: Integers, values: Array) -> None:
        """Float64MultiArray: stamps of receipt (N,) [ns] and numbers (N, n)."""
        head = struct.pack("<4sIIIxxxx", b"\0\1\0\0", 0, 0, values.shape[1])  # no dimensions, no offset
        messages = np.empty(len(time), np.dtype([("head", "V20"), ("values", "<f8", (values.shape[1],))]))
        messages["head"], messages["values"] = np.void(head), values
        self._write(topic, ARRAY, time, messages.tobytes(), messages.itemsize)

    def _write(self, topic: str, kind: str, time: Integers, data: bytes, size: int) -> None:
        if len(time) and (time[0] < 0 or time[-1] >= _LAST):
            wrong = int(time[0] if time[0] < 0 else time[-1])
            raise InputError.at(
                self._path, "", f"a time of {wrong} ns", "0 to 2^31 s, as stamps of ROS 2 hold"
            )
        if topic not in self._connections:
            connection = self._writer.add_connection(topic, kind, typestore=self._store)
            self._connections[topic] = connection
        connection = self._connections[topic]
        for i, stamp in enumerate(time.tolist()):
            self._writer.write(connection, stamp, data[i * size : (i + 1) * size])


@contextmanager
def mcap_output(path: str | Path, frame: str) -> Iterator[McapWriter]:
    """A writer of an MCAP file that appears whole or not at all, of wrenches expressed in a frame."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    with atomic_output(path) as temporary, tempfile.TemporaryDirectory(dir=temporary.parent) as folder:
        bag = Path(folder, "bag")
        try:
            writer = Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP)
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            with writer:
                yield McapWriter(Path(path), writer, frame)
            shutil.move(bag / "bag.mcap", temporary)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
