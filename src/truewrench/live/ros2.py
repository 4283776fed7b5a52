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

from truewrench import _core
from truewrench.correction.apply import corrector, used_in_part, without_weight
from truewrench.correction.warmth import Warmth
from truewrench.io.recordings.choice import KEYS
from truewrench.live.progress import Progress
from truewrench.live.ros2_node import Node, finish, lost, ros_type, taken, unreliable
from truewrench.live.ros2_sources import SensorSource, Source, motion_sources
from truewrench.live.ros2_types import (
    DiagnosticArray,
    DiagnosticStatus,
    Header,
    KeyValue,
    Temperature,
    Time,
    WrenchStamped,
)
from truewrench.live.stamps import BeganAgainError, Order
from truewrench.live.stop import Stop
from truewrench.model.calibration import Calibration
from truewrench.model.channels import Ranges
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig

if TYPE_CHECKING:  # all that an estimate needs takes a second to import
    from cyclonedds.sub import DataReader

    from truewrench.live.ros2_types import Message
    from truewrench.live.session import LiveCalibration

OUTPUT = "/truewrench/wrench"  # topic of the corrected wrench
STD = "_std"  # what the topic of its 1 sigma ends in
DIAGNOSTICS = "/diagnostics"

_WAIT = 0.1  # [s] after which an end that was asked for is noticed at the latest
_PATIENCE = 10.0  # [s] for a topic to appear
_SILENCE = 5.0  # [s] without any message, which is told
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
    interface: str | None = None  # of the network, None: what the environment says


@dataclass(slots=True)
class Counts:
    """Messages of the sensor (or of sensor and motion)."""

    received: int = 0  # those that arrived
    used: int = 0  # those that became a wrench, or part of the record
    refused: int = 0  # those that were wrong
    lost: int = 0  # those that did not arrive, where the middleware knows


class Frames:
    """The frames of a sensor's messages, which are one sensor's."""

    def __init__(self, topic: str, complain: Complain) -> None:
        self._topic, self._complain, self._seen = topic, complain, list[str]()

    def see(self, header: Header) -> None:
        """Tell where there are more than one."""
        if header.frame_id in self._seen:
            return
        self._seen.append(header.frame_id)
        if len(self._seen) > 1:
            frames = ", ".join(f"`{frame}`" for frame in self._seen)
            self._complain(f"{self._topic}: messages of frames {frames}: is it more than one sensor?")


class _Wrenches:
    """The true wrench on a topic, and its 1 sigma on another, where somebody listens."""

    def __init__(self, node: Node, topic: str, n: int) -> None:
        self._wrench = node.writer(topic, WrenchStamped)
        self._std = node.writer(topic + STD, WrenchStamped)
        self._raw = np.empty((1, n))
        self.withheld = np.zeros(6, dtype=np.bool_)  # axes that are NaN in every message
        self.warmth: Warmth | None = None

    def write(
        self, correct: _core.Corrector, header: Header, channels: Sequence[float], with_std: bool
    ) -> None:
        """Publish the wrench of a sample; InputError if there is none."""
        self._raw[0] = channels
        if self.warmth is not None and self.warmth.follows:
            self._raw -= self.warmth.shift
        wrench, std = correct.correct(self._raw)
        values = wrench[0].tolist()
        if not math.isfinite(sum(values)):
            raise InputError("found channels of such a size that no wrench can be told")
        spread = std[0] if self.warmth is None else self.warmth.widened(std[0], self.warmth.latest)
        told = np.where(self.withheld, np.nan, [values, spread])
        self._wrench.write(WrenchStamped.of(header, told[0].tolist()))
        if with_std:
            self._std.write(WrenchStamped.of(header, told[1].tolist()))

    @property
    def std_wanted(self) -> bool:
        """Whether anybody listens to the 1 sigma."""
        return bool(self._std.get_matched_subscriptions())

    def finish(self) -> None:
        """Wait for what is still under way."""
        finish(self._wrench)


def correct_topic(
    calibration: Calibration, topics: Topics, stop: Stop, complain: Complain, seconds: float = math.inf
) -> Counts:
    """Publish the true wrench of every message of the sensor, with its header, until `stop`.

    A message that is wrong (channels that are not finite, no stamp, one that does not lie after the last) is
    counted and told, and nothing is published in its place.
    """
    correct = corrector(calibration, "ROS 2")  # before a topic is waited for
    warmth = Warmth.of(calibration)
    for note in (*warmth.note_until, *without_weight(calibration), *used_in_part(calibration)):
        complain(note)
    sensor, order, counts = SensorSource(calibration.rig), Order(), Counts()
    ranges = Ranges(calibration.rig)
    node = Node(topics.interface)
    name = _sensor_topic(node, sensor, topics, stop)
    wrenches = _Wrenches(node, topics.output, calibration.n)
    wrenches.withheld, wrenches.warmth = calibration.withheld, warmth
    reader, frames = node.reader(name, sensor.kind, topics.reliable), Frames(name, complain)
    thermometer = _thermometer(node, calibration.rig, complain) if warmth.follows else None
    begun = time.monotonic()
    silent = True
    while not stop.requested and time.monotonic() - begun < seconds:
        node.wait(_WAIT)
        with_std = wrenches.std_wanted
        if thermometer is not None:
            for reading, _ in taken(thermometer):
                if math.isfinite(reading.temperature):
                    warmth.latest = reading.temperature
        for message, info in taken(reader):
            counts.received += 1
            try:
                _, stamp, channels = sensor.read(message, info)
                header = sensor.header(message, info)
                frames.see(header)
                order.check(stamp, "stamp")
                order.last = stamp
                if far := ranges.told(np.asarray(channels)):
                    complain(f"{name}: {far}")
                wrenches.write(correct, header, channels, with_std)
            except InputError as error:
                counts.refused += 1
                complain(f"{name}: {error}")
            else:
                counts.used += 1
        silent = _told_silence(silent, counts, begun, node, [(name, sensor, reader)], complain)
    wrenches.finish()
    counts.lost = lost(reader)
    return counts


def _sensor_topic(node: Node, sensor: SensorSource, topics: Topics, stop: Stop) -> str:
    own = {topics.output, topics.output + STD}
    name = topics.wrench or node.find(sensor.kind, own, _PATIENCE, stop)
    if name.strip("/") in {topic.strip("/") for topic in own}:
        raise InputError.at(None, "--output-topic", f"`{name}`", "another topic than the sensor's own")
    return name


def _thermometer(node: Node, rig: Rig, complain: Complain) -> DataReader[Message] | None:
    """The topic that the rig names, else the only one of its type, else none: then the reference stands."""
    kind = ros_type(Temperature)
    name = getattr(rig.recording, KEYS["temperature"])
    published = sorted(topic for topic, kinds in node.topics().items() if kind in kinds)
    if name is None and len(published) != 1:
        found = ", ".join(published) or "none"
        expected = f"one topic of {kind}, or `recording.temperature_topic`"
        complain(f"temperature: found {found}, expected {expected}")
        return None
    return node.reader(name or published[0], Temperature, False)


def _told_silence(
    silent: bool,
    counts: Counts,
    begun: float,
    node: Node,
    readers: Sequence[tuple[str, Source, Any]],
    complain: Complain,
) -> bool:
    """Whether silence may still have to be told of."""
    if not silent or counts.received or time.monotonic() - begun < _SILENCE:
        return silent and not counts.received
    for name, source, reader in readers:
        published = node.topics().get(f"/{name.strip('/')}", set())
        wanted = ros_type(source.kind)
        if not published:
            why = "nobody publishes it"
        elif wanted not in published:
            why = f"it carries {', '.join(published)}, expected {wanted}"
        elif unreliable(reader):
            why = "its publisher is not reliable: leave --reliable out"
        else:
            why = "its publisher is silent"
        complain(f"{name}: no message for {_SILENCE:g} s: {why}")
    return False


def calibrate_topics(
    session: LiveCalibration,
    folder: Path | None,
    topics: Topics,
    stop: Stop,
    complain: Complain,
    seconds: float = math.inf,
) -> tuple[Counts, Progress]:
    """Feed a calibration from the sensor's topic and the motion's until `stop`, then finish it in a folder.

    What is known on the way, and the result, are published as diagnostics. As soon as an estimate may be
    used, wrenches are published by the latest such. InputError: no calibration can be made of what arrived.
    """
    rig, counts = session.rig, Counts()
    sensor, others = SensorSource(rig), motion_sources(rig)
    node = Node(topics.interface)
    names = [_sensor_topic(node, sensor, topics, stop)]
    for k, source in enumerate(others):
        given = getattr(rig.recording, KEYS[source.role]) if k else topics.motion
        names.append(given or node.find(source.kind, set(), _PATIENCE, stop))
    writer = node.writer(DIAGNOSTICS, DiagnosticArray)
    wrenches = _Wrenches(node, topics.output, rig.sensor.n)
    correct: _core.Corrector | None = None  # of the latest estimate that may be used
    celsius: float | None = None  # the latest reading
    readers = [
        (name, source, node.reader(name, source.kind, topics.reliable))
        for name, source in zip(names, [sensor, *others], strict=True)
    ]
    begun, frames = time.monotonic(), Frames(names[0], complain)
    told, progress, silent = begun, Progress(0, 0.0, 0, reason="no estimate yet"), True
    over = False
    while not (stop.requested or over) and time.monotonic() - begun < seconds:
        node.wait(_WAIT)
        with_std = correct is not None and wrenches.std_wanted
        for topic, source, reader in readers:
            for message, info in taken(reader):
                counts.received += 1
                try:
                    columns, stamp, values = source.read(message, info)
                    if source is sensor:
                        frames.see(sensor.header(message, info))
                    if columns:
                        if alone := session.record.add(columns, stamp, values):
                            complain(f"{topic}: {alone}")
                        counts.used += 1
                    if columns == ("temperature",) and math.isfinite(values[0]):
                        celsius = float(values[0])
                        if wrenches.warmth is not None:
                            wrenches.warmth.latest = celsius
                    if correct is not None and source is sensor:
                        wrenches.write(correct, sensor.header(message, info), values, with_std)
                except BeganAgainError as error:  # what comes is no part of this record
                    counts.refused += 1
                    if not over:
                        complain(f"{topic}: {error}: the record ends here")
                    over = True
                except InputError as error:
                    counts.refused += 1
                    complain(f"{topic}: {error}")
        found = session.poll()
        if found is not None and found.calibration is not None and found.usable:
            correct = corrector(found.calibration, "ROS 2")
            wrenches.withheld = found.calibration.withheld
            wrenches.warmth = Warmth.of(found.calibration, celsius)
        if found is not None or time.monotonic() - told > _PERIOD:
            told, progress = time.monotonic(), found or progress
            writer.write(_diagnostics(rig, progress))
        silent = _told_silence(silent, counts, begun, node, readers, complain)
    counts.lost = sum(lost(reader) for *_, reader in readers)
    final = session.finish(folder)
    writer.write(_diagnostics(rig, final))
    finish(writer)
    return counts, final


def _diagnostics(rig: Rig, progress: Progress) -> Message:
    name = "" if rig.path is None else rig.path.stem
    level, message = (_OK, "usable") if progress.usable else (_WARNING, "; ".join(progress.reasons))
    values = [
        KeyValue(key, value if isinstance(value, str) else json.dumps(value))
        for key, value in progress.to_mapping().items()
    ]
    status = DiagnosticStatus(level, "truewrench: calibration", message, name, values)
    return DiagnosticArray(Header(Time.of(time.time_ns())), [status])
