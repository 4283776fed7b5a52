"""Serialised messages of a recording, by topic, through `rosbags`; every fault of a file in one form."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from truewrench.io.recordings.faults import CDR, faults_of
from truewrench.io.recordings.layout import Definitions
from truewrench.model.arrays import Integers
from truewrench.model.errors import InputError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_MAGIC = {b"\x89MCAP0\r\n": ".mcap", b"#ROSBAG ": ".bag", b"SQLite f": ".db3"}
_FORMATS = {".mcap": "MCAP", ".bag": "ROS 1 bag", ".db3": "SQLite of rosbag2", "": "rosbag2"}
_BATCH = 4096  # messages of a topic decoded at once,
_BYTES = 8 << 20  # or as many of all topics as these bytes hold


@dataclass(frozen=True, slots=True)
class Topic:
    """Messages of one type on one name."""

    name: str  # as it was published
    type_name: str  # `geometry_msgs/msg/WrenchStamped`
    messages: int  # how many, as the recording counts them
    publishers: int = 1  # known of ROS 1 only, else 1
    encoding: str = "cdr"  # of the messages; `ros1` in a .bag
    definitions: Definitions = field(repr=False, default_factory=dict)  # of the type and those in it


@dataclass(frozen=True, slots=True)
class Batch:
    """Consecutive messages of a topic: when each was received [ns], and its bytes."""

    topic: Topic
    receive: Integers
    messages: list[bytes]


@dataclass(slots=True)
class _Gathered:
    topic: Topic
    stamps: list[int] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)


class Recording:
    """A recording that is open; its topics are those that this package could read, and all others."""

    def __init__(self, path: Path, reader: Any, ros1: bool) -> None:
        self.path, self.ros1 = path, ros1
        self.format = _FORMATS["" if path.is_dir() else path.suffix.lower()]
        self._reader = reader
        self._connections: dict[str, list[Connection]] = {}
        self._read: dict[str, int] = {}
        for connection in reader.connections:
            self._connections.setdefault(f"{connection.topic}\n{connection.msgtype}", []).append(connection)
        self.topics = tuple(self._topic(connections) for connections in self._connections.values())
        for connection in _as_stored(reader):
            self._connections[f"{connection.topic}\n{connection.msgtype}"].append(connection)

    def _topic(self, connections: list[Connection]) -> Topic:
        first = connections[0]
        encoding = "ros1" if self.ros1 else getattr(first.ext, "serialization_format", "")
        return Topic(
            name=first.topic,
            type_name=first.msgtype,
            messages=sum(connection.msgcount for connection in connections),
            publishers=len({getattr(connection.ext, "callerid", None) for connection in connections}),
            encoding=encoding,
            definitions=_definitions(first, self.ros1) if encoding in ("cdr", "ros1") else {},
        )

    def batches(
        self, topics: Iterable[Topic], progress: Callable[[int], object] | None = None
    ) -> Iterator[Batch]:
        """Messages of some topics in one pass, in the order of their receive stamps per topic.

        InputError: the file is broken, or holds other than it says.
        """
        chosen = {f"{topic.name}\n{topic.type_name}": topic for topic in topics}
        connections = [c for key in chosen for c in self._connections[key]]
        if not connections:
            return
        gathered = {(topic.name, topic.type_name): _Gathered(topic) for topic in chosen.values()}
        self._read = dict.fromkeys(chosen, 0)
        size = 0
        for total, (connection, stamp, data) in enumerate(self._messages(connections), 1):
            part = gathered[connection.topic, connection.msgtype]
            part.stamps.append(stamp)
            part.messages.append(bytes(data))
            size += len(data)
            if len(part.messages) >= _BATCH:
                size -= sum(map(len, part.messages))
                yield self._batch(part)
            elif size >= _BYTES:
                size = 0
                yield from (self._batch(part) for part in gathered.values() if part.messages)
            else:
                continue
            if progress is not None:
                progress(total)
        yield from (self._batch(part) for part in gathered.values() if part.messages)

    def _batch(self, part: _Gathered) -> Batch:
        topic, stamps, messages = part.topic, part.stamps, part.messages
        part.stamps, part.messages = [], []
        self._read[f"{topic.name}\n{topic.type_name}"] += len(messages)
        return Batch(topic, np.array(stamps, dtype=np.int64), messages)

    def miscounted(self) -> list[str]:
        """Topics of which the last pass found another number of messages than the recording states."""
        stated = {f"{topic.name}\n{topic.type_name}": topic for topic in self.topics}
        return [
            f"{stated[key].name}: {count} messages, though the recording counts {stated[key].messages}"
            for key, count in self._read.items()
            if count != stated[key].messages
        ]

    def _messages(self, connections: list[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        with faults_of(self.path, reading=True):
            yield from self._reader.messages(connections=connections)


def _as_stored(reader: Any) -> Iterator[Connection]:
    """Connections of a rosbag2 folder as its files describe them.

    `rosbags` passes over the messages of a file whose quality of service is not that of `metadata.yaml`, word
    by word, as it is not after a conversion by `ros2 bag`.
    """
    by_topic = {(c.topic, c.msgtype): c for c in reader.connections}
    for file in getattr(getattr(reader, "storage", None), "storages", ()):
        for stored in file.connections:
            known = by_topic.get((stored.topic, stored.msgtype))
            if known is not None:
                yield known._replace(ext=stored.ext, digest=stored.digest)


def is_recording(path: Path) -> bool:
    """Whether a file or folder is a recording, by its first bytes or its name."""
    if path.is_dir():
        return True
    return path.suffix.lower() in _FORMATS or _suffix_by_content(path) is not None


def _suffix_by_content(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return _MAGIC.get(file.read(8))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a recording: a folder of rosbag2, or a file .mcap, .db3 or .bag."""
    _check(path)
    ros1 = path.suffix.lower() == ".bag" and path.is_file()
    with faults_of(path):
        if ros1:
            from truewrench.io.recordings.bag import BagReader

            reader: AbstractContextManager[Any] = BagReader(path)
        else:
            from rosbags.rosbag2 import Reader

            reader = Reader(path)
        opened = reader.__enter__()
    try:
        with faults_of(path):
            recording = Recording(path, opened, ros1)
        yield recording
    finally:
        reader.__exit__(None, None, None)


def _check(path: Path) -> None:
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            files = sorted(f.name for f in path.iterdir() if f.suffix in _FORMATS and f.suffix)
            expected = "a rosbag2 folder" + (f", or one of its files: {', '.join(files)}" if files else "")
            raise InputError.at(path, "", "a folder without metadata.yaml", expected)
        for database in path.glob("*.db3"):
            _check_closed(database)
        return
    suffix = _suffix_by_content(path)
    if suffix is None:
        found = "an empty file" if path.stat().st_size == 0 else "a file that does not begin like one"
        raise InputError.at(path, "", found, f"a recording ({_FORMATS[path.suffix.lower()]})")
    if suffix != path.suffix.lower():
        raise InputError.at(path, "", f"{_FORMATS[suffix]} under this name", f"a name that ends in {suffix}")
    if suffix == ".db3":
        _check_closed(path)
    if suffix == ".mcap":
        _check_profile(path)


def _check_profile(path: Path) -> None:
    """The header of an MCAP says whose messages it holds: after magic, code and length a string of 4 + n."""
    with path.open("rb") as file:
        head = file.read(21)
        size = int.from_bytes(head[17:], "little")
        profile = file.read(min(size, 256)).decode("utf-8", "replace")
    if len(head) == 21 and head[8] == 1 and profile != "ros2":
        raise InputError.at(path, "", f"an MCAP of the profile `{profile}`", f"`ros2`, with {CDR}")


def _check_closed(database: Path) -> None:
    """SQLite keeps what it has not yet merged in a file beside, which would be passed over."""
    log = database.with_name(f"{database.name}-wal")
    if log.is_file() and log.stat().st_size:
        expected = f"one that was closed; `sqlite3 {database.name} 'PRAGMA wal_checkpoint(TRUNCATE)'` does so"
        raise InputError.at(database, "", f"a recording that was cut off ({log.name} beside it)", expected)


def _definitions(connection: Connection, ros1: bool) -> Definitions:
    """As the recording states them, completed by those of the ROS distributions."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    standard: Definitions = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST).fielddefs
    given = connection.msgdef
    try:
        if given.format == MessageDefinitionFormat.MSG:
            return {**standard, **get_types_from_msg(given.data, connection.msgtype)}
        if given.format == MessageDefinitionFormat.IDL and connection.msgtype not in standard:
            return {**standard, **get_types_from_idl(given.data)}
    except Exception:
        return standard if connection.msgtype in standard else {}
    return standard


def sha256_of(path: Path) -> str:
    """Of a file; of a folder, that of the lines that `sha256sum *` prints in it."""
    if not path.is_dir():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    lines = [f"{sha256_of(file)}  {file.name}\n" for file in sorted(path.iterdir()) if file.is_file()]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
