"""What is in a recording: topics, rates, gaps, stamps, and what would be taken for what."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truewrench.inspection.log import ColumnContent, Gap, Ranges
from truewrench.io.recordings.cadence import Cadence
from truewrench.io.recordings.choice import KEYS, commanded, derived
from truewrench.io.recordings.layout import Layout
from truewrench.io.recordings.reader import Batch, Recording, Topic, open_recording
from truewrench.io.recordings.streams import Clocks, clock_notes, frame_notes, role_of, samples_of
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError

_LISTED = 100  # gaps that are named one by one

_TAKEN = {
    "wrench": "sensor",
    "array": "raw channels",
    "joints": "joints",
    "twist": "twist",
    "imu": "accelerometer, or with `motion.source: imu` the motion",
    "temperature": "temperature",
    "gravity": "gravity",
}


@dataclass(frozen=True, slots=True)
class StreamContent:
    """Columns that come together."""

    columns: tuple[ColumnContent, ...]  # with their ranges
    samples: int  # how many messages have them
    rate: float  # samples a second over the time they span, pauses left out; 0 with fewer than two samples
    jitter: float  # standard deviation of the period over its mean, pauses left out
    gaps: tuple[Gap, ...]  # the longest pauses, of more than five times the ordinary period
    gap_count: int  # how many there are
    late: int  # samples stamped earlier than one before them
    repeated: int  # samples with the latest stamp before them


@dataclass(frozen=True, slots=True)
class TopicContent:
    """One topic."""

    topic: str  # its name
    type: str  # of its messages
    publishers: int  # known of ROS 1 only, else 1
    messages: int  # as counted
    rate: float  # of receipt, likewise
    stamps: str | None  # `header`, `receive` where the messages have no header, None where they are not read
    delay: float | None  # mean time from header stamp to receipt [s], None without headers
    drift: float | None  # how much that grows over the recording [s], likewise
    frames: tuple[str, ...]  # `header.frame_id` of what is read, without the empty one, as they came
    streams: tuple[StreamContent, ...]  # what is read of it, stamped by headers if there are any
    taken_as: str  # what a rig without topics of its own would take it for, or why it would not


@dataclass(frozen=True, slots=True)
class RecordingContent:
    """A whole recording; its start and duration are those of the stamps of receipt."""

    path: Path
    format: str
    messages: int
    start_ns: int
    duration: float
    topics: tuple[TopicContent, ...]
    notes: tuple[str, ...]


def inspect_recording(path: str | Path, progress: Callable[[int], object] | None = None) -> RecordingContent:
    """Read a recording once and say what is in it; no rig is needed."""
    path = Path(path)
    with open_recording(path) as recording:
        counters = {(topic.name, topic.type_name): _TopicCounter(topic) for topic in recording.topics}
        for batch in recording.batches(recording.topics, progress):
            counters[batch.topic.name, batch.topic.type_name].add(batch, recording)
        notes = recording.miscounted()
    counted = [counter for counter in counters.values() if counter.receive.samples]
    if not counted:
        raise InputError.at(path, "", "no message", "at least one")
    start = min(counter.receive.first for counter in counted)
    taken = _taken([counter for counter in counters.values()])
    topics = [c.content(start, words) for c, words in zip(counters.values(), taken, strict=True)]
    for counter in counted:
        notes += clock_notes(counter.topic.name, counter.clocks)
        notes += frame_notes(counter.topic, counter.frames)
    return RecordingContent(
        path=path,
        format=recording.format,
        messages=sum(topic.messages for topic in topics),
        start_ns=start,
        duration=(max(counter.receive.last for counter in counted) - start) * 1e-9,
        topics=tuple(topics),
        notes=tuple(notes),
    )


def _taken(counters: Sequence[_TopicCounter]) -> list[str]:
    words = []
    for counter in counters:
        role = role_of(counter.topic.type_name)
        if role is None or (role == "array" and counter.receive.samples and not counter.streams):
            words.append("")
        elif not counter.receive.samples:
            words.append("no message")
        elif commanded(counter.topic.name):
            words.append(
                f"a command, by its name; unless named in recording.{KEYS.get(role, KEYS['wrench'])}"
            )
        else:
            rivals = [c for c in counters if c is not counter and _rivals(c, counter)]
            measured = [c for c in rivals if not derived(c.topic.name)]
            if measured and derived(counter.topic.name):
                words.append(
                    f"a result of truewrench, by its name; unless named in recording.{KEYS['wrench']}"
                )
                continue
            rivals = rivals if derived(counter.topic.name) else measured
            meant = _TAKEN[role]
            if role == "array":
                meant += " of a rig with n = " + " or ".join(str(len(c)) for c in counter.streams)
            if rivals:
                meant += f", if named in recording.{KEYS.get(role, KEYS['wrench'])}: "
                meant += f"{', '.join(c.topic.name for c in rivals)} could be, too"
            words.append(meant)
    return words


def _rivals(a: _TopicCounter, b: _TopicCounter) -> bool:
    """Whether a rig could take either for the same thing."""
    if not a.receive.samples or commanded(a.topic.name) or role_of(a.topic.type_name) is None:
        return False
    roles = {role_of(a.topic.type_name), role_of(b.topic.type_name)}
    if roles in ({"joints"}, {"array"}):
        columns = [{column for columns in c.streams for column in columns} for c in (a, b)]
        return bool(columns[0] & columns[1]) if roles == {"joints"} else bool(set(a.streams) & set(b.streams))
    return len(roles) == 1


class _Pauses:
    """The longest periods of stamps that are passed over once, and their cadence."""

    def __init__(self) -> None:
        self.cadence = Cadence()
        self._longest = np.empty((2, 0), dtype=np.int64)  # length and begin

    def add(self, stamps: Integers) -> None:
        known = bool(self.cadence.samples)
        earlier = self.cadence.add(stamps)
        begin = earlier if known else earlier[1:]  # the first has no period
        period = stamps[len(stamps) - len(begin) :] - begin
        found = np.concatenate([self._longest, [period, begin]], axis=1)
        self._longest = found[:, np.argsort(-found[0], kind="stable")[:_LISTED]]

    @property
    def longest(self) -> list[tuple[int, int]]:
        """Begin and length of the longest pauses, in order of time."""
        period, begin = self._longest[:, self.cadence.is_pause(self._longest[0])].tolist()
        return sorted(zip(begin, period, strict=True))


class _StreamCounter:
    def __init__(self, names: Sequence[str]) -> None:
        self.pauses = _Pauses()
        self._ranges = Ranges(names)

    def add(self, stamps: Integers, values: Array) -> None:
        self.pauses.add(stamps)
        self._ranges.add(values)

    def content(self, start: int) -> StreamContent:
        cadence = self.pauses.cadence
        return StreamContent(
            self._ranges.columns(),
            cadence.samples,
            cadence.rate,
            cadence.jitter,
            tuple(Gap((begin - start) * 1e-9, length * 1e-9) for begin, length in self.pauses.longest),
            cadence.pauses,
            cadence.late,
            cadence.repeated,
        )


class _TopicCounter:
    """What one pass over the batches gathers of a topic."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.receive = Cadence()
        self.clocks = Clocks()
        self.streams: dict[tuple[str, ...], _StreamCounter] = {}
        self.frames: dict[str, None] = {}
        self._headers: bool | None = None
        self._layouts: list[Layout] = []

    def add(self, batch: Batch, recording: Recording) -> None:
        if role_of(self.topic.type_name) is not None:
            for samples in samples_of(batch, self._layouts, recording, self.receive.samples):
                counter = self.streams.setdefault(samples.columns, _StreamCounter(samples.columns))
                self._headers = samples.header is not None
                self.frames |= dict.fromkeys(samples.frames)
                if samples.header is not None:
                    self.clocks.add(samples.receive, samples.header)
                counter.add(samples.receive if samples.header is None else samples.header, samples.values)
        self.receive.add(batch.receive)

    def content(self, start: int, taken_as: str) -> TopicContent:
        headers = bool(self._headers)
        origins = [counter.pauses.cadence.first for counter in self.streams.values()]
        return TopicContent(
            topic=self.topic.name,
            type=self.topic.type_name,
            publishers=self.topic.publishers,
            messages=self.receive.samples,
            rate=self.receive.rate,
            stamps=None if self._headers is None else "header" if headers else "receive",
            delay=self.clocks.delay if headers else None,
            drift=self.clocks.drift[0] if headers else None,
            frames=tuple(self.frames),
            streams=tuple(
                counter.content(min(origins) if headers else start) for counter in self.streams.values()
            ),
            taken_as=taken_as,
        )
