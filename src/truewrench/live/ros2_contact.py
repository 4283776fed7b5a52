"""ROS 2 topics: the contact wrench of sensor and motion, with covariance, contact test and tare."""

import json
import math
import time
from collections.abc import Callable
from typing import Any

from truewrench.correction.contact.run import ContactRun, Contacts
from truewrench.io.recordings.choice import KEYS
from truewrench.live.contact_lines import LiveContact
from truewrench.live.ros2 import DIAGNOSTICS, Counts, Frames, Topics
from truewrench.live.ros2_merge import Merger
from truewrench.live.ros2_node import Node, finish, lost, taken
from truewrench.live.ros2_service import tare_service
from truewrench.live.ros2_sources import SensorSource, motion_sources
from truewrench.live.ros2_types import (
    Bool,
    DiagnosticArray,
    DiagnosticStatus,
    Empty,
    Float64MultiArray,
    Header,
    KeyValue,
    MultiArrayDimension,
    MultiArrayLayout,
    Time,
    WrenchStamped,
)
from truewrench.live.stop import Stop
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig

CONTACT = "/truewrench/contact"  # topic of the contact wrench, its stamp the middle of the kernel
COVARIANCE = "/truewrench/contact_covariance"
IN_CONTACT = "/truewrench/in_contact"
TARE = "/truewrench/tare"
_WAIT = 0.02  # [s] after which an end, a tare or a late topic is noticed at the latest
_PATIENCE = 10.0  # [s] for a topic to appear
_LAYOUT = MultiArrayLayout([MultiArrayDimension("row", 6, 36), MultiArrayDimension("column", 6, 6)], 0)

Complain = Callable[[str], None]


class _Publisher:
    """What of a contact wrench is published."""

    def __init__(self, node: Node) -> None:
        self._contact = node.writer(CONTACT, WrenchStamped)
        self._covariance = node.writer(COVARIANCE, Float64MultiArray)
        self._in_contact = node.writer(IN_CONTACT, Bool)
        self._diagnostics = node.writer(DIAGNOSTICS, DiagnosticArray)
        self._of_covariance = self._of_in_contact = True

    def listen(self) -> None:
        """Find out what anybody listens to."""
        self._of_covariance = bool(self._covariance.get_matched_subscriptions())
        self._of_in_contact = bool(self._in_contact.get_matched_subscriptions())

    def write(self, found: Contacts, frame: str, in_contact: bool) -> None:
        """One wrench; covariance and test where somebody listens."""
        header = Header(Time.of(int(found.time_ns[0])), frame)
        self._contact.write(WrenchStamped.of(header, found.wrench[0].tolist()))
        if self._of_covariance:
            self._covariance.write(Float64MultiArray(_LAYOUT, found.covariance[0].ravel().tolist()))
        if self._of_in_contact:
            self._in_contact.write(Bool(in_contact))

    def tell(self, event: dict[str, Any]) -> None:
        """An event, as a diagnostic."""
        values = [KeyValue(key, json.dumps(value)) for key, value in event.items()]
        status = DiagnosticStatus(0, "truewrench: contact", str(event["event"]), "", values)
        self._diagnostics.write(DiagnosticArray(Header(Time.of(time.time_ns())), [status]))

    def finish(self) -> None:
        """Wait for what is still under way."""
        finish(self._contact)


def contact_topics(
    run: ContactRun, rig: Rig, topics: Topics, stop: Stop, complain: Complain, seconds: float = math.inf
) -> Counts:
    """Publish the contact wrench of sensor and motion until `stop`.

    Messages of all topics are rows in the order of their stamps, as in a recording; a source that begins
    again more than a second back is let through. A message on `/truewrench/tare`, or a call of the service of
    that name where rclpy can be imported, tares.
    """
    for note in run.notes:
        complain(note)
    node, counts, live = Node(topics.interface), Counts(), LiveContact(run)
    sources = [SensorSource(rig), *motion_sources(rig)]
    names = []
    for k, source in enumerate(sources):
        given = topics.wrench if k == 0 else topics.motion if k == 1 else None
        given = given or getattr(rig.recording, KEYS[source.role])
        names.append(given or node.find(source.kind, {CONTACT}, _PATIENCE, stop))
    readers = [(n, s, node.reader(n, s.kind, topics.reliable)) for n, s in zip(names, sources, strict=True)]
    awaited = [name for k, name in enumerate(names) if k < 2 or sources[k].role == "gravity"]
    tares, publisher, merger = node.reader(TARE, Empty, False), _Publisher(node), Merger(awaited)
    nothing, frame = (math.nan,) * rig.sensor.n, ""
    channels = tuple(f"raw_{i}" for i in range(rig.sensor.n))
    begun, frames = time.monotonic(), Frames(names[0], complain)
    with tare_service(TARE, complain) as service:
        while not stop.requested and time.monotonic() - begun < seconds:
            node.wait(_WAIT)
            publisher.listen()
            now = time.monotonic()
            for name, source, reader in readers:
                for message, info in taken(reader):
                    counts.received += 1
                    try:
                        columns, stamp, values = source.read(message, info)
                        header = source.header(message, info) if isinstance(source, SensorSource) else None
                        if header is not None:
                            frames.see(header)
                        if columns and merger.add(name, stamp, columns, values, header, now):
                            run.restart()
                            complain(f"{name}: stamps begin again at {stamp} ns: so does everything")
                    except InputError as error:
                        counts.refused += 1
                        complain(f"{name}: {error}")
                    else:
                        counts.used += 1
            for row in merger.rows(now):
                raw = tuple(row.values[c] for c in channels) if channels[0] in row.values else nothing
                frame = row.header.frame_id if row.header is not None else frame
                motion = {key: value for key, value in row.values.items() if key not in channels}
                try:
                    found = live.feed(row.time_ns, raw, motion)
                except InputError as error:
                    complain(str(error))
                    continue
                if found is not None:
                    publisher.write(found, frame, run.in_contact)
                for event in live.events():
                    publisher.tell(event)
            for _ in taken(tares):
                publisher.tell(live.tare())
            for answer in service.asked():
                told = live.tare()
                publisher.tell(told)
                answer(told["accepted"], told["reason"])
    publisher.finish()
    counts.lost = sum(lost(reader) for *_, reader in readers)
    return counts
