"""ROS 1 bags are read chunk by chunk, and yield what a reader with an index of all messages does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader, ReaderError, Writer
from rosbags.typesys import Stores, get_typestore

from truewrench.io.recordings.bag import BagReader

STORE = get_typestore(Stores.ROS1_NOETIC)
TOPICS = {"/ft": "std_msgs/msg/String", "/js": "std_msgs/msg/String", "/seldom": "std_msgs/msg/Int8"}
COMPRESSIONS = (None, Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4)


def bag_of(path: Path, times: list[tuple[str, int]], chunk: int, compression: Any = None) -> Path:
    """Messages that say which they are, on topics and at times [ns], in chunks of at least so many bytes."""
    writer = Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    writer.chunk_threshold = chunk
    with writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=STORE) for topic, kind in TOPICS.items()
        }
        for number, (topic, time) in enumerate(times):
            writer.write(connections[topic], time, number.to_bytes(4, "little") * (1 + number % 7))
    return path


def all_of(reader: Reader, topics: set[str], **limits: int) -> list[tuple[int, str, bytes]]:
    """Messages of topics; by time, and of one time in any order."""
    with reader:
        chosen = [connection for connection in reader.connections if connection.topic in topics]
        found = [(time, c.topic, bytes(data)) for c, time, data in reader.messages(chosen, **limits)]
    assert [each[0] for each in found] == sorted(each[0] for each in found)
    return sorted(found)


@given(
    times=st.lists(
        st.tuples(st.sampled_from(sorted(TOPICS)), st.integers(0, 3 * 10**9)), min_size=1, max_size=60
    ),
    chunk=st.sampled_from([1, 100, 500, 10**6]),
    compression=st.sampled_from(COMPRESSIONS),
    topics=st.sets(st.sampled_from(sorted(TOPICS)), min_size=1),
)
@settings(max_examples=60, deadline=None)
def test_messages_are_those_of_rosbags_in_order_of_time(
    tmp_path_factory: pytest.TempPathFactory,
    times: list[tuple[str, int]],
    chunk: int,
    compression: Any,
    topics: set[str],
) -> None:
    path = bag_of(tmp_path_factory.mktemp("bag") / "run.bag", times, chunk, compression)
    assert all_of(BagReader(path), topics) == all_of(Reader(path), topics)
    limits = {"start": 10**9, "stop": 2 * 10**9}
    assert all_of(BagReader(path), topics, **limits) == all_of(Reader(path), topics, **limits)
    with BagReader(path) as reader, Reader(path) as other:
        assert [c.msgcount for c in reader.connections] == [c.msgcount for c in other.connections]


def test_no_message_is_held_that_is_not_in_the_chunk(tmp_path: Path) -> None:
    path = bag_of(tmp_path / "run.bag", [("/ft", 1000 * k) for k in range(2000)], 4000)
    with BagReader(path) as reader:
        assert not any(reader.indexes.values())
        assert reader.connections[0].msgcount == 2000
        most = max(sum(chunk.connection_counts.values()) for chunk in reader.chunk_infos)
        assert most < 100 < len(list(reader.messages()))


def test_broken_chunk_is_an_error(tmp_path: Path) -> None:
    path = bag_of(tmp_path / "run.bag", [("/ft", k) for k in range(100)], 10**6)
    data = bytearray(path.read_bytes())
    at = data.index((17).to_bytes(4, "little") * 4)  # a message in the middle
    data[at - 4 : at] = np.uint32(10**6).tobytes()  # which says that it is longer than all
    path.write_bytes(data)
    with pytest.raises(ReaderError, match="a record of 1000000 bytes"), BagReader(path) as reader:
        list(reader.messages())
