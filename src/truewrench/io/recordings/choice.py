"""Which topics of a recording hold sensor and motion: found where there is one answer, else asked for."""

import re
from collections.abc import Sequence
from pathlib import Path

from truewrench.io.recordings.reader import Topic
from truewrench.io.recordings.streams import Stream, role_of
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig

KEYS = {
    "wrench": "wrench_topic",
    "joints": "joint_topic",
    "twist": "twist_topic",
    "imu": "imu_topic",
    "temperature": "temperature_topic",
    "gravity": "gravity_topic",
}
"""Of the rig's `recording`, by role."""

_COMMANDS = re.compile(r"(^|[/_])(cmd|command|commands|desired|target|goal|setpoint|reference)([/_]|$)")


def roles_of(rig: Rig) -> list[str]:
    """What a rig uses: the sensor first, then the motion, then what else it names or has priors for."""
    roles = ["wrench", rig.motion.source]
    noise = rig.motion.acceleration_noise
    if "imu" not in roles and (rig.recording.imu_topic or (noise is not None and len(noise) == 3)):
        roles.append("imu")
    if rig.recording.temperature_topic or rig.temperature.prior > 0.0:
        roles.append("temperature")
    if rig.recording.gravity_topic:
        roles.append("gravity")
    return roles


def gravity_missing(rig: Rig) -> str | None:
    """What is expected of a rig that needs a topic of gravity and names none; None of every other rig."""
    source, weighed = rig.motion.source, rig.sensor.subtracted is not None
    needed = (source == "twist" and rig.in_gravity) or (source != "joints" and weighed)
    if not needed or rig.recording.gravity_topic:
        return None
    why = "`sensor.compensated`" if weighed else "a twist in gravity"
    return f"the topic of free fall in sensor axes (Vector3Stamped), which {why} needs"


def commanded(topic: str) -> bool:
    """Whether a topic's name says that it was not measured; it has to be chosen by name."""
    return _COMMANDS.search(topic) is not None


def derived(topic: str) -> bool:
    """Whether a topic's name says that this package made it; it is no sensor where there is another one."""
    return topic.strip("/").startswith("truewrench/") and topic.strip("/") != "truewrench/raw"


def named_topic(path: Path, topics: Sequence[Topic], name: str, role: str) -> Topic:
    """The topic of this name; InputError if there is none, or it holds something else."""
    roles = ("wrench", "array") if role == "wrench" else (role,)
    place = f"recording.{KEYS[role]}"
    same = [topic for topic in topics if topic.name.strip("/") == name.strip("/")]
    fitting = [topic for topic in same if role_of(topic.type_name) in roles]
    candidates = [topic for topic in topics if role_of(topic.type_name) in roles]
    if not same:
        raise InputError.at(path, place, f"no topic `{name}`", _one_of(candidates))
    if not fitting:
        raise InputError.at(path, place, f"`{name}` of type {same[0].type_name}", _one_of(candidates))
    if not fitting[0].messages:
        raise InputError.at(path, place, f"no message on `{name}`", "a topic with messages")
    return fitting[0]


def one_topic(path: Path, streams: Sequence[Stream], role: str, what: str) -> Stream | None:
    """The only stream, None where there is none; several are an InputError, whose text lists them."""
    if len(streams) > 1:
        found = f"{len(streams)} topics that could hold {what}: {_listed(streams)}"
        name = streams[0].topic.name
        expected = f"the choice of one in the rig: `recording: {{{KEYS[role]}: {name}}}`"
        if role == "wrench":
            expected += f"; in `apply` also: `--wrench-topic {name}`"
        raise InputError.at(path, "", found, expected)
    return streams[0] if streams else None


def topics_in_words(topics: Sequence[Topic]) -> str:
    """What there is, for an error."""
    return "; ".join(f"{t.name} ({t.type_name}, {t.messages} messages)" for t in topics) or "none"


def _listed(streams: Sequence[Stream]) -> str:
    return "; ".join(stream.words for stream in streams)


def _one_of(topics: Sequence[Topic]) -> str:
    if not topics:
        return "a topic of this kind, of which the recording has none"
    return f"one of: {topics_in_words(topics)}"
