"""ROS 1 bags of any size: chunk by chunk, without an index of their messages."""

import struct
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Generator, Iterator
from operator import itemgetter
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader, ReaderError

_MESSAGE = 2  # `op` of a record; between them are those of connections
_LENGTH, _TIME = struct.Struct("<I"), struct.Struct("<II")
_NANOSECONDS = 1_000_000_000

_Received = tuple[int, Connection, bytes]
_time_of = itemgetter(0)


class BagReader(Reader):
    """A reader of `rosbags` that holds one chunk of messages, or as many as overlap in time.

    `rosbags` keeps place and time of every message, some 200 bytes for each. The summary of a chunk says how
    many messages of a connection it has, and from when to when.
    """

    def open(self) -> None:
        """Open the bag, and count its messages."""
        super().open()
        count: Counter[int] = Counter()
        for chunk in self.chunk_infos:
            count.update(chunk.connection_counts)
        self.connections = [c._replace(msgcount=count[c.id]) for c in self.connections]

    def read_index_data(self, pos: int, indexes: Any) -> None:
        """Not needed."""

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Connection, time of receipt [ns] and bytes of messages, in order of time.

        From `start` to before `stop`. Those of all connections, if none is given. A broken bag raises
        ReaderError.
        """
        wanted = {c.id: c for c in connections or self.connections}
        chunks = [chunk for chunk in self.chunk_infos if wanted.keys() & chunk.connection_counts.keys()]
        chunks.sort(key=lambda chunk: chunk.start_time)
        waiting: list[_Received] = []
        for place, chunk in enumerate(chunks):
            waiting += self._in_chunk(chunk.pos, wanted)
            waiting.sort(key=_time_of)
            later = chunks[place + 1].start_time if place + 1 < len(chunks) else None
            due = len(waiting) if later is None else bisect_left(waiting, later, key=_time_of)
            for time, connection, data in waiting[:due]:
                if (start is None or time >= start) and (stop is None or time < stop):
                    yield connection, time, data
            del waiting[:due]

    def _in_chunk(self, position: int, wanted: dict[int, Connection]) -> Iterator[_Received]:
        chunk = self.chunks[position]
        assert self.bio is not None
        self.bio.seek(chunk.datapos)
        data = chunk.decompressor(self.bio.read(chunk.datasize))
        try:
            yield from _received(data, wanted)
        except (KeyError, IndexError, struct.error) as error:
            raise ReaderError(f"chunk at byte {position}: {error}") from error


def _received(data: bytes, wanted: dict[int, Connection]) -> Iterator[_Received]:
    """Messages among the records of a chunk."""
    at, length_at = 0, _LENGTH.unpack_from
    while at < len(data):
        fields: dict[bytes, bytes] = {}
        at, end = at + 4, at + 4 + length_at(data, at)[0]
        while at < end:
            at, field_end = at + 4, at + 4 + length_at(data, at)[0]
            name, _, fields[name] = data[at:field_end].partition(b"=")
            at = field_end
        at, end = end + 4, end + 4 + length_at(data, end)[0]
        if end > len(data):
            raise IndexError(f"a record of {end - at} bytes with {len(data) - at} left")
        if fields[b"op"][0] == _MESSAGE:
            connection = wanted.get(length_at(fields[b"conn"])[0])
            if connection is not None:
                seconds, nanoseconds = _TIME.unpack(fields[b"time"])
                yield seconds * _NANOSECONDS + nanoseconds, connection, data[at:end]
        at = end
