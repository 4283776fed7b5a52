"""ROS 2 topics: wrenches of the sensor's messages, or a calibration from sensor and motion."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from cyclonedds.idl import IdlStruct
from cyclonedds.util import duration

from truewrench.apply import corrector
from truewrench.arm.robot import robot_of
from truewrench.calibration import Calibration
from truewrench.errors import InputError, UnsupportedError
from truewrench.io.table import TWIST
from truewrench.rig import Rig
from truewrench.stream.progress import Progress
from truewrench.stream.ros2_node import Node, lost, ros_type, taken, unreliable
from truewrench.stream.ros2_types import (
    DiagnosticArray,
    DiagnosticStatus,
    Float64MultiArray,
    Header,
    JointState,
    KeyValue,
    Time,
    TwistStamped,
    WrenchStamped,
)
from truewrench.stream.stop import Stop

if TYPE_CHECKING:  # all that an estimate needs takes a second to import
    from truewrench.stream.session import LiveCalibration

__all__ = ["OUTPUT", "Counts", "Topics", "calibrate_topics", "correct_topic"]

OUTPUT = "/truewrench/wrench"
"""Topic of the corrected wrench."""

DIAGNOSTICS = "/diagnostics"

_WAIT = 0.1  # [s] after which an end that was asked for is noticed at the latest
_PATIENCE = 10.0  # [s] for a topic to appear
_SILENCE = 5.0  # [s] without any message, which is told
_RESTART = 1_000_000_000  # [ns] back in time, which is another run of the source and no disorder
_PERIOD = 1.0  # [s] of diagnostics
_OK, _WARNING = 0, 1

Complain = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Topics:
    """What to subscribe to and publish; None is found by its type."""

    wrench: str | None = None
    motion: str | None = None
    output: str = OUTPUT
    reliable: bool = False


@dataclass(slots=True)
class Counts:
    """Messages of the sensor (or of sensor and motion).

    Attributes:
        received: those that arrived.
        used: those that became a wrench, or part of the record.
        refused: those that were wrong.
        lost: those that did not arrive, where the middleware knows.
    """

    received: int = 0
    used: int = 0
    refused: int = 0
    lost: int = 0


class _Sensor:
    """Messages of a sensor with n channels: wrenches where there are six, else plain arrays."""

    def __init__(self, rig: Rig) -> None:
        self._n = rig.sensor.n
        self._receive = rig.recording.stamps == "receive"
        self.kind: type[IdlStruct] = WrenchStamped if self._n == 6 else Float64MultiArray

    def read(self, message: Any, info: Any) -> tuple[Header, int, Any]:
        """Header, time [ns] and channels.

        Raises:
            InputError: the message has not n finite channels, or no stamp.
        """
        if self.kind is WrenchStamped:
            header, values = message.header, message.values
        else:
            header, values = Header(Time.of(info.source_timestamp)), message.data
            if len(values) != self._n:
                raise InputError(f"found {len(values)} numbers, expected {self._n}: one per channel")
        if not math.isfinite(sum(values)):
            raise InputError(f"found {list(values)}, expected finite channels")
        return header, info.source_timestamp if self._receive else _stamp(header), values


def _stamp(header: Header) -> int:
    if header.stamp.ns == 0:
        expected = "a stamp in every message, or `recording: {stamps: receive}` in the rig"
        raise InputError(f"found no stamp, expected {expected}")
    return header.stamp.ns


class _Order:
    """Stamps that increase; a source that begins again, far back, is let through."""

    def __init__(self) -> None:
        self._last: int | None = None

    def check(self, stamp: int) -> None:
        last = self._last
        if last is not None and last - _RESTART < stamp <= last:
            raise InputError(f"stamp: found {stamp} ns after {last} ns, expected time that increases")
        self._last = stamp


def correct_topic(
    calibration: Calibration, topics: Topics, stop: Stop, complain: Complain, seconds: float = math.inf
) -> Counts:
    """Publish the true wrench of every message of the sensor, with its header, until `stop`.

    A message that is wrong (channels that are not finite, no stamp, one that does not lie after the last) is
    counted and told, and nothing is published in its place.

    Raises:
        InputError: no topic is found, or the gain cannot be inverted.
    """
    correct = corrector(calibration, "ROS 2").correct
    sensor, order, counts = _Sensor(calibration.rig), _Order(), Counts()
    node = Node()
    name = topics.wrench or node.find(sensor.kind, {topics.output}, _PATIENCE, stop)
    if name.strip("/") == topics.output.strip("/"):
        raise InputError.at(None, "--output-topic", f"`{name}`", "another topic than the sensor's own")
    writer = node.writer(topics.output, WrenchStamped)
    reader = node.reader(name, sensor.kind, topics.reliable)
    raw = np.empty((1, calibration.n))
    begun = time.monotonic()
    silent = True
    while not stop.requested and time.monotonic() - begun < seconds:
        node.wait(_WAIT)
        for message, info in taken(reader):
            counts.received += 1
            try:
                header, stamp, raw[0] = sensor.read(message, info)
                order.check(stamp)
                wrench = correct(raw)[0][0].tolist()
                if not math.isfinite(sum(wrench)):
                    raise InputError("found channels of such a size that no wrench can be told")
            except InputError as error:
                counts.refused += 1
                complain(f"{name}: {error}")
                continue
            writer.write(WrenchStamped.of(header, wrench))
            counts.used += 1
        silent = _told_silence(silent, counts, begun, node, [(name, sensor.kind, reader)], complain)
    writer.wait_for_acks(duration(seconds=1))
    counts.lost = lost(reader)
    return counts


def _told_silence(
    silent: bool,
    counts: Counts,
    begun: float,
    node: Node,
    readers: Sequence[tuple[str, type[IdlStruct], Any]],
    complain: Complain,
) -> bool:
    """Whether silence may still have to be told of."""
    if not silent or counts.received or time.monotonic() - begun < _SILENCE:
        return silent and not counts.received
    for name, kind, reader in readers:
        published = node.topics().get(f"/{name.strip('/')}", set())
        if not published:
            why = "nobody publishes it"
        elif ros_type(kind) not in published:
            why = f"it carries {', '.join(published)}, expected {ros_type(kind)}"
        elif unreliable(reader):
            why = "its publisher is not reliable: leave --reliable out"
        else:
            why = "its publisher is silent"
        complain(f"{name}: no message for {_SILENCE:g} s: {why}")
    return False


class _Motion:
    """Messages that tell the motion of a rig: its joints, or the twist of the sensor."""

    def __init__(self, rig: Rig) -> None:
        self._receive = rig.recording.stamps == "receive"
        self._joints: tuple[str, ...] = ()
        self.kind: type[IdlStruct] = TwistStamped
        if rig.motion.source == "joints":
            self.kind, self._joints = JointState, robot_of(rig).joints
        elif rig.in_gravity:
            found = "a twist in gravity, whose direction no topic tells"
            raise UnsupportedError.at(
                rig.path, "motion.source", found, "`joints`, or JSON lines with gx gy gz"
            )

    def read(self, message: Any, info: Any) -> tuple[tuple[str, ...], int, list[float]]:
        """Columns, time [ns] and values; no columns where no joint moves the sensor.

        Raises:
            InputError: the message is no such motion.
        """
        stamp = info.source_timestamp if self._receive else _stamp(message.header)
        if self.kind is TwistStamped:
            return TWIST, stamp, self._checked(list(message.values))
        names, values = self._of_joints(message)
        return names, stamp, self._checked(values)

    @staticmethod
    def _checked(values: list[float]) -> list[float]:
        if any(map(math.isinf, values)):
            raise InputError("found an infinity, expected finite numbers, or NaN where there is none")
        return values

    def _of_joints(self, message: JointState) -> tuple[tuple[str, ...], list[float]]:
        places = {name: k for k, name in enumerate(message.name)}
        if len(places) < len(message.name):
            raise InputError("found a joint a second time, expected every name once")
        known = [joint for joint in self._joints if joint in places]
        names: tuple[str, ...] = ()
        values: list[float] = []
        for letter, numbers in (("q", message.position), ("dq", message.velocity)):
            if numbers and len(numbers) != len(places):
                expected = f"{len(places)}: one per name, or none at all"
                raise InputError(f"found {len(numbers)} numbers, expected {expected}")
            if numbers:
                names += tuple(f"{letter}_{joint}" for joint in known)
                values += [numbers[places[joint]] for joint in known]
        return names, values


def calibrate_topics(
    session: LiveCalibration,
    folder: Path | None,
    topics: Topics,
    stop: Stop,
    complain: Complain,
    seconds: float = math.inf,
) -> tuple[Counts, Progress]:
    """Feed a calibration from the sensor's topic and the motion's until `stop`, then finish it in a folder.

    What is known on the way, and the result, are published as diagnostics.

    Raises:
        InputError: no topic is found, or no calibration can be made of what arrived.
    """
    rig = session.rig
    sensor, motion, counts = _Sensor(rig), _Motion(rig), Counts()
    channels = tuple(f"raw_{i}" for i in range(rig.sensor.n))
    node = Node()
    name = topics.wrench or node.find(sensor.kind, {topics.output}, _PATIENCE, stop)
    moving = topics.motion or node.find(motion.kind, set(), _PATIENCE, stop)
    writer = node.writer(DIAGNOSTICS, DiagnosticArray)
    readers = [
        (name, sensor.kind, node.reader(name, sensor.kind, topics.reliable)),
        (moving, motion.kind, node.reader(moving, motion.kind, topics.reliable)),
    ]

    def of_sensor(message: Any, info: Any) -> tuple[tuple[str, ...], int, Any]:
        _, stamp, values = sensor.read(message, info)
        return channels, stamp, values

    begun = time.monotonic()
    told, progress, silent = begun, Progress(0, 0.0, 0, reason="no estimate yet"), True
    while not stop.requested and time.monotonic() - begun < seconds:
        node.wait(_WAIT)
        for (topic, _, reader), read in zip(readers, (of_sensor, motion.read), strict=True):
            for message, info in taken(reader):
                counts.received += 1
                try:
                    names, stamp, values = read(message, info)
                    if names:
                        session.record.add(names, stamp, values)
                        counts.used += 1
                except InputError as error:
                    counts.refused += 1
                    complain(f"{topic}: {error}")
        found = session.poll()
        if found is not None or time.monotonic() - told > _PERIOD:
            told, progress = time.monotonic(), found or progress
            writer.write(_diagnostics(rig, progress))
        silent = _told_silence(silent, counts, begun, node, readers, complain)
    counts.lost = sum(lost(reader) for *_, reader in readers)
    final = session.finish(folder)
    writer.write(_diagnostics(rig, final))
    writer.wait_for_acks(duration(seconds=1))
    return counts, final


def _diagnostics(rig: Rig, progress: Progress) -> DiagnosticArray:
    name = "" if rig.path is None else rig.path.stem
    level, message = (_OK, "usable") if progress.usable else (_WARNING, "; ".join(progress.reasons))
    values = [
        KeyValue(key, value if isinstance(value, str) else json.dumps(value))
        for key, value in progress.to_mapping().items()
    ]
    status = DiagnosticStatus(level, "truewrench: calibration", message, name, values)
    return DiagnosticArray(Header(Time.of(time.time_ns())), [status])
