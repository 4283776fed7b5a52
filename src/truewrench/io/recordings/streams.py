"""What the messages of a recording say, as streams of numbers with their own time stamps."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from truewrench.io.recordings.faults import CDR
from truewrench.io.recordings.layout import Layout, layouts_of
from truewrench.io.recordings.reader import Batch, Recording, Topic
from truewrench.io.recordings.spool import Spool
from truewrench.io.table import ANGULAR_VELOCITY, GRAVITY, SPECIFIC_FORCE, TWIST
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.rig.strict import printable

_LARGE_DELAY = 0.1  # [s] from header stamp to receipt, worth a note,
_DRIFT = 0.01  # [s] over the recording, likewise
_MOST_CHANNELS = 256
_NAMED = 4  # frames that a note names
_SURE = 5.0  # sigma of a drift
_XYZ = ("x", "y", "z")
_STAMP, _FRAME = ("header.stamp.sec", "header.stamp.nanosec"), "header.frame_id"
_ARRAY = re.compile(r"std_msgs/msg/(Float32|Float64|Int8|Int16|Int32|UInt8|UInt16|UInt32)MultiArray")


def _paths(*parents: str) -> tuple[str, ...]:
    return tuple(f"{parent}.{axis}" for parent in parents for axis in _XYZ)


_COVARIANT = _paths("twist.twist.linear", "twist.twist.angular")
_VECTORS: dict[str, tuple[str, tuple[str, ...]]] = {
    "geometry_msgs/msg/WrenchStamped": ("wrench", _paths("wrench.force", "wrench.torque")),
    "geometry_msgs/msg/Wrench": ("wrench", _paths("force", "torque")),
    "geometry_msgs/msg/TwistStamped": ("twist", _paths("twist.linear", "twist.angular")),
    "geometry_msgs/msg/Twist": ("twist", _paths("linear", "angular")),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("twist", _COVARIANT),
    "nav_msgs/msg/Odometry": ("twist", _COVARIANT),
    "sensor_msgs/msg/Imu": ("imu", _paths("angular_velocity", "linear_acceleration")),
    "sensor_msgs/msg/Temperature": ("temperature", ("temperature",)),
    "geometry_msgs/msg/Vector3Stamped": ("gravity", _paths("vector")),
}  # fmt: skip
_COLUMNS = {
    "twist": TWIST,
    "imu": ANGULAR_VELOCITY + SPECIFIC_FORCE,
    "temperature": ("temperature",),
    "gravity": GRAVITY,
}
_JOINTS = "sensor_msgs/msg/JointState"


def role_of(type_name: str) -> str | None:
    """`wrench`, `array`, `joints`, `twist`, `imu`, `temperature`, `gravity`, or None: of no use here."""
    if type_name == _JOINTS:
        return "joints"
    if _ARRAY.fullmatch(type_name):
        return "array"
    return _VECTORS[type_name][0] if type_name in _VECTORS else None


@dataclass(frozen=True, slots=True)
class Samples:
    """Consecutive samples: columns, stamps of receipt and of the header, if there is one, numbers, frames."""

    columns: tuple[str, ...]
    receive: Integers
    header: Integers | None
    values: Array
    frames: tuple[str, ...]  # `header.frame_id` of them, each once, without the empty one


_Part = tuple[npt.NDArray[np.intp], Integers | None, Array, tuple[str, ...]]


def samples_of(batch: Batch, known: list[Layout], recording: Recording, first: int) -> Iterator[Samples]:
    """Decode a batch of a topic with a role, of which `first` messages came before.

    New layouts are added to the known ones of the topic. InputError: a message is not what its type says.
    """
    topic = batch.topic
    if topic.encoding not in ("cdr", "ros1"):
        raise InputError.at(recording.path, f"topic {topic.name}", f"messages in `{topic.encoding}`", CDR)
    try:
        groups = layouts_of(batch.messages, known, topic.type_name, topic.definitions, recording.ros1)
    except ValueError as error:
        number = re.match(r"message (\d+): ", str(error))
        reason = str(error)[number.end() :] if number else str(error)
        place = f"topic {topic.name}, message {first + int(number[1] if number else 0) + 1}"
        expected = f"a {topic.type_name}"
        raise InputError.at(recording.path, place, f"a broken message ({reason})", expected) from error
    found: dict[tuple[str, ...], list[_Part]] = {}
    for rows, layout, messages in groups:
        header = None
        if _STAMP[0] in layout.numbers and _STAMP[1] in layout.numbers:
            sec, nanosec = (layout.read(messages, path)[:, 0].astype(np.int64) for path in _STAMP)
            header = sec * 1_000_000_000 + nanosec
        frame = layout.texts.get(_FRAME, ())
        try:
            for columns, values in _values(topic.type_name, layout, messages):
                found.setdefault(columns, []).append((rows, header, values, frame))
        except (KeyError, ValueError) as error:
            place = f"topic {topic.name}, message {first + int(rows[0]) + 1}"
            raise InputError.at(recording.path, place, str(error), f"a {topic.type_name}") from error
    for columns, parts in found.items():
        rows = np.concatenate([part[0] for part in parts])
        order = np.argsort(rows)  # as they were received, whatever their layout
        headers = [part[1] for part in parts if part[1] is not None]
        yield Samples(
            columns,
            batch.receive[rows[order]],
            np.concatenate(headers)[order] if headers else None,
            np.concatenate([part[2] for part in parts])[order],
            tuple(dict.fromkeys(f for part in sorted(parts, key=lambda p: p[0][0]) for f in part[3] if f)),
        )


def _values(
    type_name: str, layout: Layout, messages: npt.NDArray[np.uint8]
) -> Iterator[tuple[tuple[str, ...], Array]]:
    if type_name == _JOINTS:
        names = layout.texts["name"]
        if len(set(names)) < len(names):
            raise ValueError(f"a joint named twice ({', '.join(names)})")
        for path, prefix in (("position", "q_"), ("velocity", "dq_")):
            count = layout.numbers[path].count
            if count not in (0, len(names)):
                raise ValueError(f"{count} numbers in `{path}` for {len(names)} names")
            if count:
                order = sorted(range(count), key=names.__getitem__)
                columns = tuple(prefix + names[i] for i in order)
                yield columns, layout.read(messages, path).astype(np.float64)[:, order]
    elif _ARRAY.fullmatch(type_name):
        count = layout.numbers["data"].count
        if 0 < count <= _MOST_CHANNELS:  # more is a picture, or a scan
            columns = tuple(f"raw_{i}" for i in range(count))
            yield columns, layout.read(messages, "data").astype(np.float64)
    else:
        role, paths = _VECTORS[type_name]
        missing = [path for path in paths if path not in layout.numbers]
        if missing:
            raise ValueError(f"a definition without `{missing[0]}`")
        values = np.hstack([layout.read(messages, path) for path in paths]).astype(np.float64)
        yield _COLUMNS.get(role) or tuple(f"raw_{i}" for i in range(6)), values


class Clocks:
    """Header stamps against those of receipt: their mean difference, and how it drifts."""

    def __init__(self) -> None:
        self._n = 0
        self._start = self._difference = 0
        self._sums = np.zeros(5)  # of x, y, x x, x y, y y: time and departure [s]
        self._latest = 0.0

    def add(self, receive: Integers, header: Integers) -> None:
        """Stamps (N,) [ns]."""
        if not self._n:
            self._start, self._difference = int(receive[0]), int(receive[0] - header[0])
        x = (receive - self._start) * 1e-9
        y = (receive - header - self._difference) * 1e-9
        self._n += len(x)
        self._sums += [x.sum(), y.sum(), x @ x, x @ y, y @ y]
        self._latest = max(self._latest, float(x.max()))

    @property
    def delay(self) -> float:
        """Mean time from header stamp to receipt [s]; 0 without headers."""
        return self._difference * 1e-9 + float(self._sums[1]) / self._n if self._n else 0.0

    @property
    def drift(self) -> tuple[float, float]:
        """How much that grows over the recording, and its 1 sigma [s]."""
        x, y, xx, xy, yy = self._sums
        if self._n < 3 or (spread := xx - x * x / self._n) <= 0.0:
            return 0.0, math.inf
        slope = (xy - x * y / self._n) / spread
        scatter = max(yy - y * y / self._n - slope**2 * spread, 0.0) / (self._n - 2)
        return float(slope * self._latest), math.sqrt(scatter / spread) * self._latest


def clock_notes(topic: str, clocks: Clocks) -> list[str]:
    """What is worth a look in the stamps of a topic."""
    notes = []
    delay, (drift, sigma) = clocks.delay, clocks.drift
    if abs(delay) > _LARGE_DELAY:
        notes.append(f"{topic}: header stamps are {delay:.6g} s before those of receipt on average")
    if abs(drift) > max(_DRIFT, _SURE * sigma):
        notes.append(f"{topic}: header stamps drift by {drift:.3g} s against those of receipt")
    return notes


def frame_notes(topic: Topic, frames: Iterable[str]) -> list[str]:
    """What is worth a look in the frames of a topic: of one sensor they are one."""
    names = list(frames)
    if role_of(topic.type_name) != "wrench" or len(names) < 2:
        return []
    more = ", ..." if len(names) > _NAMED else ""
    listed = ", ".join(f"`{printable(name)}`" for name in names[:_NAMED])
    return [f"{topic.name}: messages of {len(names)} frames ({listed}{more}): is it more than one sensor?"]


@dataclass(slots=True)
class Stream:
    """Columns that come together, in messages of one topic."""

    topic: Topic
    columns: tuple[str, ...]
    spool: Spool
    headers: bool
    clocks: Clocks = field(default_factory=Clocks)
    frames: dict[str, None] = field(default_factory=dict)  # in the order in which they came

    @property
    def words(self) -> str:
        """For a person: topic, type, count, rate."""
        rate = f", {self.spool.rate:.4g} Hz" if self.spool.rate else ""
        return f"{self.topic.name} ({self.topic.type_name}, {self.topic.messages} messages{rate})"


def gather(
    recording: Recording,
    topics: Iterable[Topic],
    stamps: str,
    *,
    wanted: Callable[[Topic, tuple[str, ...]], Sequence[int]] | None = None,
    progress: Callable[[int], object] | None = None,
) -> list[Stream]:
    """All streams of topics with a role, in one pass over the recording, their samples in order of time.

    Stamps are those of `header` or `receive`; messages without a header have the latter in any case. `wanted`
    says which columns of a topic are of interest, by default all; `progress` is told the number of messages
    read so far. InputError: a message is broken, or there is no room for the samples.
    """
    streams: dict[tuple[str, str, tuple[str, ...]], Stream] = {}
    layouts: dict[tuple[str, str], list[Layout]] = {}
    counts: dict[tuple[str, str], int] = {}
    for batch in recording.batches(topics, progress):
        key = (batch.topic.name, batch.topic.type_name)
        first = counts.get(key, 0)
        for samples in samples_of(batch, layouts.setdefault(key, []), recording, first):
            kept = range(len(samples.columns)) if wanted is None else wanted(batch.topic, samples.columns)
            columns = tuple(samples.columns[i] for i in kept)
            if not columns:
                continue
            stream = streams.get((*key, columns))
            if stream is None:
                stream = Stream(batch.topic, columns, Spool(len(columns)), samples.header is not None)
                streams[*key, columns] = stream
            if samples.header is not None:
                stream.clocks.add(samples.receive, samples.header)
            stream.frames |= dict.fromkeys(samples.frames)
            use_header = stamps == "header" and samples.header is not None
            time = samples.header if use_header and samples.header is not None else samples.receive
            stream.spool.append(time, samples.values[:, list(kept)])
        counts[key] = first + len(batch.messages)
    for stream in streams.values():
        stream.spool.finish()
    return list(streams.values())
