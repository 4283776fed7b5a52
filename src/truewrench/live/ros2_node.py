"""A participant in ROS 2 without ROS: the environment that ROS programs obey, endpoints, discovery."""

import os
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, TypeVar

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import (
    DDSException,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from truewrench.live.ros2_types import type_hash
from truewrench.live.stop import Stop
from truewrench.model.errors import InputError

_LARGEST_DOMAIN = 232
_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_PREFIX = "rt/"  # of a ROS topic among those of DDS
_TAKEN_AT_ONCE = 256
_WRITTEN = 1000  # messages kept for a reader that is slow
_UNREADABLE = "1.15"  # Fast DDS, whose descriptions of types Cyclone cannot read: names of types must do
_MOST_INDEX = 32  # as many participants on this machine are looked for, where there is no multicast

_Message = TypeVar("_Message", bound=IdlStruct)


def domain_id() -> int:
    """What ROS_DOMAIN_ID says; InputError if it is no domain."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdecimal() or int(text) > _LARGEST_DOMAIN:
        raise InputError.at(None, "ROS_DOMAIN_ID", f"`{text}`", f"a number from 0 to {_LARGEST_DOMAIN}")
    return int(text)


def configuration(interface: str | None = None) -> str:
    """Cyclone's settings for ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY and ROS_STATIC_PEERS.

    CYCLONEDDS_URI comes before all of these, and an `interface`, the address or the name of a network's,
    before that.
    """
    common = f"<Compatibility><IgnoreTypeInformation>{_UNREADABLE}</IgnoreTypeInformation></Compatibility>"
    given, chosen = os.environ.get("CYCLONEDDS_URI", ""), "" if interface is None else _chosen(interface)
    if given:
        return ",".join([_settings(common), given, *([_settings(chosen)] if chosen else [])])
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    local = reach == "LOCALHOST" or (not reach and os.environ.get("ROS_LOCALHOST_ONLY") == "1")
    local, common = local and not chosen, common + chosen
    peers = [peer.strip() for peer in os.environ.get("ROS_STATIC_PEERS", "").split(";") if peer.strip()]
    for peer in peers:
        if not re.fullmatch(r"[\w.:%-]+", peer):
            raise InputError.at(None, "ROS_STATIC_PEERS", f"`{peer}`", "addresses with semicolons between")
    if local:
        interface = '<NetworkInterface address="127.0.0.1" multicast="false"/>'
        multicast = "<AllowMulticast>false</AllowMulticast>"
        common += f"<General><Interfaces>{interface}</Interfaces>{multicast}</General>"
        peers.append("127.0.0.1")
    if peers:
        addresses = "".join(f'<Peer Address="{peer}"/>' for peer in peers)
        index = f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{_MOST_INDEX}"
        common += f"<Discovery>{index}</MaxAutoParticipantIndex><Peers>{addresses}</Peers></Discovery>"
    return _settings(common)


def _chosen(interface: str) -> str:
    if not re.fullmatch(r"[\w.:%-]+", interface):
        expected = "the address of one of this machine's networks, or its name"
        raise InputError.at(None, "--interface", f"`{interface}`", expected)
    key = "address" if re.search(r"[.:]", interface) else "name"
    return f'<General><Interfaces><NetworkInterface {key}="{interface}"/></Interfaces></General>'


def _settings(of_domain: str) -> str:
    return f'<CycloneDDS><Domain Id="any">{of_domain}</Domain></CycloneDDS>'


def ros_type(kind: type[IdlStruct]) -> str:
    """`geometry_msgs/msg/WrenchStamped` of a message class."""
    return _as_ros(kind.__idl__.idl_transformed_typename)


def _as_ros(dds_type: str) -> str:
    return dds_type.replace("::dds_::", "::").removesuffix("_").replace("::", "/")


class Node:
    """Readers and writers of ROS topics in the domain of ROS_DOMAIN_ID; InputError if it cannot be joined.

    `interface` is that of `configuration`.
    """

    def __init__(self, interface: str | None = None) -> None:
        domain, settings = domain_id(), configuration(interface)
        try:
            self._domain = _configured(domain, settings)
            self._participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
            self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        except DDSException as error:
            by = "" if interface is None else f" by --interface {interface}"
            raise InputError(f"ROS 2: domain {domain} cannot be joined{by}: {error}") from error
        self._waitset = WaitSet(self._participant)
        self._found: dict[str, set[str]] = {}

    def reader(self, topic: str, kind: type[_Message], reliable: bool) -> DataReader[_Message]:
        """Subscribe; messages that have arrived are kept until they are taken."""
        quality = _reliable() if reliable else Policy.Reliability.BestEffort
        qos = Qos(quality, Policy.History.KeepAll, *_common(kind))
        reader = DataReader(self._participant, Topic(self._participant, _dds_name(topic), kind), qos=qos)
        states = ViewState.Any | InstanceState.Any | SampleState.NotRead
        self._waitset.attach(ReadCondition(reader, states))
        return reader

    def writer(self, topic: str, kind: type[_Message]) -> DataWriter[_Message]:
        """Publish, for readers of either reliability; one that is slow holds nobody up."""
        qos = Qos(_reliable(), Policy.History.KeepLast(_WRITTEN), *_common(kind))
        return DataWriter(self._participant, Topic(self._participant, _dds_name(topic), kind), qos=qos)

    def wait(self, seconds: float) -> None:
        """Until a message has arrived, at most so long."""
        self._waitset.wait(duration(seconds=seconds))

    def topics(self) -> dict[str, set[str]]:
        """Topics that somebody publishes, by name, and their types; ROS topics alone."""
        for found in self._publications.take(_TAKEN_AT_ONCE):
            name, kind = getattr(found, "topic_name", ""), getattr(found, "type_name", "")
            if name.startswith(_PREFIX):
                self._found.setdefault(name.removeprefix(_PREFIX[:-1]), set()).add(_as_ros(kind))
        return self._found

    def find(self, kind: type[IdlStruct], without: set[str], patience: float, stop: Stop) -> str:
        """The one topic of a type, `without` those that are not meant.

        InputError: there is none, or there are several. It waits with patience for a first one [s], then a
        little more for others, unless `stop` ends the search.
        """
        wanted, end = ros_type(kind), time.monotonic() + patience
        others = 1.0  # [s] that may pass between the discovery of two
        matching: list[str] = []
        while time.monotonic() < end and not stop.requested:
            time.sleep(0.05)
            before = matching
            matching = sorted(t for t, kinds in self.topics().items() if wanted in kinds and t not in without)
            if matching and not before:
                end = time.monotonic() + others
        if len(matching) == 1:
            return matching[0]
        seen = ", ".join(f"{topic} ({', '.join(sorted(of))})" for topic, of in sorted(self.topics().items()))
        found = f"the topics {', '.join(matching)}" if matching else f"no topic of type {wanted}"
        expected = "one, or the name of one as an option" if matching else "a publisher of one"
        raise InputError.at(
            None, f"ROS 2, domain {domain_id()}", found, f"{expected}; seen: {seen or 'none'}"
        )


def _configured(domain: int, settings: str) -> Domain | None:
    """The domain, or None where this process has set it up before."""
    try:
        return Domain(domain, settings)
    except DDSException as error:
        if error.code != DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
            raise
        return None


def taken(reader: DataReader[_Message]) -> Iterator[tuple[_Message, Any]]:
    """Messages that have arrived, each with what DDS says of it."""
    sample: Any
    for sample in reader.take(_TAKEN_AT_ONCE):
        info = sample.sample_info
        if info.valid_data:  # else it tells of a publisher that has gone
            yield sample, info


def lost(reader: Any) -> int:
    """Messages that a reliable publisher no longer had."""
    return int(reader.get_sample_lost_status().total_count)


def finish(writer: Any) -> None:
    """Wait a second at most for what is still under way; a reader that is slow or gone is not waited for."""
    with suppress(DDSException, AttributeError):  # the latter is how Cyclone's Python tells of a timeout
        writer.wait_for_acks(duration(seconds=1))


def unreliable(reader: Any) -> bool:
    """Whether there is a publisher that offers less than the reader asks for."""
    return bool(reader.get_requested_incompatible_qos_status().total_count)


def _reliable() -> Any:
    return Policy.Reliability.Reliable(duration(milliseconds=100))


def _common(kind: type[IdlStruct]) -> list[Any]:
    return [
        Policy.Durability.Volatile,
        Policy.Userdata(f"typehash={type_hash(ros_type(kind))};".encode()),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]


def _dds_name(topic: str) -> str:
    if not _NAME.fullmatch(topic):
        raise InputError.at(None, "ROS 2 topic", f"`{topic}`", "a name such as /ft/wrench_raw")
    return _PREFIX + topic.removeprefix("/")
