"""What of a recording a rig needs: streams chosen, checked against one another, and named as columns."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from truewrench.io.recordings.choice import (
    KEYS,
    commanded,
    derived,
    gravity_missing,
    named_topic,
    one_topic,
    roles_of,
    topics_in_words,
)
from truewrench.io.recordings.reader import Recording, Topic
from truewrench.io.recordings.streams import Stream, clock_notes, frame_notes, gather, role_of
from truewrench.io.table import SPECIFIC_FORCE
from truewrench.model.calibration import AXES
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of

_APART = 0.02  # [s] between the delays of sensor and motion, worth a note
_REPEATED = 0.01  # the largest share of samples that may repeat a stamp


@dataclass(frozen=True, slots=True)
class Selection:
    """Streams; where columns are found: number of the stream, position in it; what is worth a look."""

    streams: tuple[Stream, ...]
    places: Mapping[str, tuple[int, int]]
    notes: tuple[str, ...]


def select(
    recording: Recording, rig: Rig, whole: bool, progress: Callable[[int], object] | None = None
) -> Selection:
    """Read what the rig needs, which names topics where there is a choice.

    Unless `whole`, motion that cannot be read is left out, and no error; `progress` is told the number of
    messages read so far. InputError: the recording is broken, or does not tell which topics are meant.
    """
    topics = _topics(recording, rig)
    joints = robot_of(rig).joints if whole and rig.motion.source == "joints" else None
    wanted = _Wanted(rig, joints)
    streams = gather(recording, topics, rig.recording.stamps, wanted=wanted, progress=progress)
    notes = [*recording.miscounted()]
    chosen = [_sensor(recording, rig, streams)]
    _check(recording, rig, chosen[0])
    for role in roles_of(rig)[1:]:
        try:
            found = _of_role(recording, rig, role, streams, whole)
            for stream in found:
                _check(recording, rig, stream)
        except InputError as error:
            if whole:
                raise
            notes.append(f"left out: {error}")
        else:
            chosen += found
    if rig.recording.stamps == "header":
        notes += _apart(rig, chosen)
    for stream in chosen:
        notes += _stream_notes(stream)
    if whole:
        _check_complete(recording, rig, chosen, wanted)
        _check_overlap(recording, rig, chosen)
    return Selection(tuple(chosen), _places(rig, chosen), tuple(dict.fromkeys(notes)))


def _topics(recording: Recording, rig: Rig) -> list[Topic]:
    """Those that are named, and all that could be meant where none is."""
    topics: list[Topic] = []
    for role in roles_of(rig):
        name = getattr(rig.recording, KEYS[role])
        if role == "twist":
            name = name or rig.recording.joint_topic
        if name is not None:
            topics.append(named_topic(recording.path, recording.topics, name, role))
            continue
        kinds = ("wrench", "array") if role == "wrench" else (role,)
        topics += [
            topic
            for topic in recording.topics
            if role_of(topic.type_name) in kinds and topic.messages and not commanded(topic.name)
        ]
    return list({(topic.name, topic.type_name): topic for topic in topics}.values())


class _Wanted:
    """Which columns are read: joints of the arm, if it is known, and arrays as long as there are channels.

    Of an IMU, the angular velocity is read where it is the motion: a twist has its own.
    """

    def __init__(self, rig: Rig, joints: Sequence[str] | None) -> None:
        self.channels, self.joints = rig.sensor.n, joints
        self._turning = rig.motion.source == "imu"
        self.seen: set[str] = set()  # names of all joints that came by

    def __call__(self, topic: Topic, columns: tuple[str, ...]) -> Sequence[int]:
        role = role_of(topic.type_name)
        if role == "array":
            return range(len(columns)) if len(columns) == self.channels else ()
        if role == "imu":
            return [i for i, name in enumerate(columns) if self._turning or name in SPECIFIC_FORCE]
        if role != "joints":
            return range(len(columns))
        names = [column.partition("_")[2] for column in columns]
        self.seen.update(names)
        return [i for i, name in enumerate(names) if self.joints is None or name in self.joints]


def _sensor(recording: Recording, rig: Rig, streams: Sequence[Stream]) -> Stream:
    n = rig.sensor.n
    wrenches = [s for s in streams if role_of(s.topic.type_name) == "wrench"]
    arrays = [s for s in streams if role_of(s.topic.type_name) == "array"]
    found = wrenches if n == 6 else []
    if not found or rig.sensor.nominal_gain != "identity":
        found = found + arrays
    found = [s for s in found if not derived(s.topic.name)] or found
    what = "the sensor" if n == 6 else f"the {n} raw channels"
    stream = one_topic(recording.path, found, "wrench", what)
    if stream is None:
        wanted = "a wrench (WrenchStamped, Wrench), or an array of 6 numbers"
        wanted = wanted if n == 6 else f"arrays of {n} numbers"
        there = topics_in_words(recording.topics)
        wanted += "; one that is named like a command has to be chosen: `recording: {wrench_topic: ...}`"
        raise InputError.at(recording.path, "", f"none for {what} among {there}", f"a topic with {wanted}")
    return stream


def _of_role(
    recording: Recording, rig: Rig, role: str, streams: Sequence[Stream], whole: bool
) -> list[Stream]:
    found = [s for s in streams if role_of(s.topic.type_name) == role]
    if role == "joints":
        found = [s for s in found if not s.spool.all_nan]  # drivers fill in what they do not measure
        _check_publishers(recording, found)
        return found
    what = f"the {role}"
    if role == "imu":
        what = "the IMU" if rig.motion.source == "imu" else "the accelerometer"
    stream = one_topic(recording.path, found, role, what)
    if stream is None and role == rig.motion.source and whole:
        there = topics_in_words(recording.topics)
        expected = f"a topic with {what}; one that is named like a command has to be chosen"
        raise InputError.at(recording.path, "", f"none among {there}", expected)
    return [] if stream is None else [stream]


def _check_publishers(recording: Recording, streams: Sequence[Stream]) -> None:
    """Every joint comes from one topic, and there from one publisher."""
    owner: dict[str, Stream] = {}
    for stream in streams:
        for column in stream.columns:
            other = owner.setdefault(column, stream)
            if other is stream:
                continue
            joint = column.partition("_")[2]
            if other.topic.name != stream.topic.name:
                listed = "; ".join(dict.fromkeys(s.words for s in streams))
                found = f"joint `{joint}` on several topics: {listed}"
                expected = f"the choice of one: `recording: {{{KEYS['joints']}: {stream.topic.name}}}`"
            else:
                found = f"joint `{joint}` in messages with different sets of joints (several publishers?)"
                expected = "each joint of the arm from one publisher"
            raise InputError.at(recording.path, f"topic {stream.topic.name}", found, expected)


def _check(recording: Recording, rig: Rig, stream: Stream) -> None:
    spool = stream.spool
    if spool.repeated > _REPEATED * (spool.rows + spool.repeated):
        total = spool.rows + spool.repeated
        found = f"{spool.repeated} of {total} messages with a stamp that another one has"
        expected = "a stamp for every message"
        if rig.recording.stamps == "header" and stream.headers:
            expected += "; where the driver does not set them: `recording: {stamps: receive}` in the rig"
        raise InputError.at(recording.path, f"topic {stream.topic.name}", found, expected)


def _check_complete(recording: Recording, rig: Rig, chosen: Sequence[Stream], wanted: _Wanted) -> None:
    """Every joint of the arm is there, and gravity where a twist needs it."""
    there = {column.partition("_")[2] for stream in chosen for column in stream.columns}
    missing = [joint for joint in wanted.joints or () if joint not in there]
    if missing:
        seen = ", ".join(sorted(wanted.seen)) or "none"
        found = f"no samples of the joints {', '.join(missing)} (joints in the recording: {seen})"
        raise InputError.at(recording.path, "", found, "every joint of the arm, by its name in the URDF")
    expected = gravity_missing(rig)
    if expected is not None:
        raise InputError.at(recording.path, f"recording.{KEYS['gravity']}", "nothing", expected)


def _check_overlap(recording: Recording, rig: Rig, chosen: Sequence[Stream]) -> None:
    sensor = chosen[0]
    for other in chosen[1:]:
        a, b = sensor.spool, other.spool
        if a.last < b.first or b.last < a.first:
            found = f"{sensor.topic.name} from {a.first} to {a.last} ns, "
            found += f"but {other.topic.name} from {b.first} to {b.last} ns"
            expected = "streams that overlap"
            if rig.recording.stamps == "header":
                expected += "; of clocks that differ, `recording: {stamps: receive}` in the rig"
            raise InputError.at(recording.path, "", found, expected)


def _stream_notes(stream: Stream) -> list[str]:
    """What is worth a look in one stream: order, repetitions, clocks."""
    topic, spool = stream.topic.name, stream.spool
    notes = []
    if spool.late:
        notes.append(f"{topic}: {spool.late} messages came late and were sorted in by their stamps")
    if spool.repeated:
        notes.append(f"{topic}: {spool.repeated} messages with the stamp of an earlier one left out")
    return notes + clock_notes(topic, stream.clocks) + frame_notes(stream.topic, stream.frames)


def _apart(rig: Rig, chosen: Sequence[Stream]) -> list[str]:
    """Sensor and motion whose stamps are further apart than the rig's clock offset allows for."""
    sensor, allowed = chosen[0], max(_APART, 3.0 * rig.sensor.time_offset_prior)
    notes = []
    for other in chosen[1:]:
        apart = sensor.clocks.delay - other.clocks.delay
        if role_of(other.topic.type_name) == rig.motion.source and abs(apart) > allowed:
            which = "header" if sensor.headers and other.headers else "header and receive"
            notes.append(
                f"{sensor.topic.name} and {other.topic.name}: their {which} stamps are {apart:.3g} s apart "
                "by their times of receipt, more than the rig expects (sensor.time_offset_prior)"
            )
    return notes


def _places(rig: Rig, chosen: Sequence[Stream]) -> dict[str, tuple[int, int]]:
    """Columns by name, the sensor's channels by the axes they are called after, if they are."""
    n, channels = rig.sensor.n, rig.sensor.channels
    order = list(range(n))
    if role_of(chosen[0].topic.type_name) == "wrench" and set(channels) == set(AXES):
        order = [AXES.index(channel) for channel in channels]
    places = {f"raw_{i}": (0, order[i]) for i in range(n)}
    for k, stream in enumerate(chosen[1:], 1):
        places |= {column: (k, j) for j, column in enumerate(stream.columns)}
    return places
