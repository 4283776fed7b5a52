"""Messages of ROS 2 as DDS types: names and fields as every ROS 2 has them on the wire.

rosbags knows the definitions; only what every sample goes through is written out.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from types import new_class
from typing import TYPE_CHECKING, Any, Self

from cyclonedds.idl import IdlStruct, types
from cyclonedds.idl import annotations as annotate
from cyclonedds.idl.types import byte, float64, int32, uint8, uint32
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

if TYPE_CHECKING:

    class Message(IdlStruct):
        """Any message, whose fields are those of its definition."""

        def __init__(self, *values: Any, **named: Any) -> None: ...
        def __getattr__(self, name: str) -> Any: ...


_STORE = get_typestore(Stores.LATEST)
_OF: Any = types  # its hints know no `sequence[...]`


@dataclass
@annotate.final
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    """Seconds and nanoseconds."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @classmethod
    def of(cls, time_ns: int) -> Self:
        """From nanoseconds."""
        return cls(*divmod(time_ns, 1_000_000_000))

    @property
    def ns(self) -> int:
        """All of it."""
        return self.sec * 1_000_000_000 + self.nanosec


@dataclass
@annotate.final
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    """When and in which frame."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
@annotate.final
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    """Three numbers."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
@annotate.final
class Wrench(IdlStruct, typename="geometry_msgs.msg.dds_.Wrench_"):
    """Force [N] and torque [N m]."""

    force: Vector3 = field(default_factory=Vector3)
    torque: Vector3 = field(default_factory=Vector3)


_HEAD, _SIX = (
    {0: struct.Struct(">iII"), 1: struct.Struct("<iII")},
    {0: struct.Struct(">6d"), 1: struct.Struct("<6d")},
)
_BEGIN = 4  # of the message behind the encapsulation, from which CDR aligns


@dataclass
@annotate.final
class WrenchStamped(IdlStruct, typename="geometry_msgs.msg.dds_.WrenchStamped_"):
    """Every sample goes through this one: it is packed here, and not field by field."""

    header: Header = field(default_factory=Header)
    wrench: Wrench = field(default_factory=Wrench)

    @classmethod
    def of(cls, header: Header, values: tuple[float, ...] | list[float]) -> Self:
        """From six numbers, the force first."""
        return cls(header, Wrench(Vector3(*values[:3]), Vector3(*values[3:])))

    @property
    def values(self) -> tuple[float, ...]:
        """All six, the force first."""
        f, n = self.wrench.force, self.wrench.torque
        return (f.x, f.y, f.z, n.x, n.y, n.z)

    def serialize(self, buffer: Any = None, endianness: Any = None, use_version_2: Any = None) -> bytes:
        """Little-endian CDR."""
        frame = self.header.frame_id.encode() + b"\0"
        stamp = self.header.stamp
        head = _HEAD[1].pack(stamp.sec, stamp.nanosec, len(frame))
        padding = b"\0" * (-(len(head) + len(frame)) % 8)
        return b"".join([b"\0\1\0\0", head, frame, padding, _SIX[1].pack(*self.values)])

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Self:
        """From CDR of either endianness."""
        head, six = _HEAD[data[1]], _SIX[data[1]]
        sec, nanosec, length = head.unpack_from(data, _BEGIN)
        text = _BEGIN + head.size
        frame = bytes(data[text : text + length - 1]).decode(errors="replace")
        numbers = text + length + -(head.size + length) % 8
        return cls.of(Header(Time(sec, nanosec), frame), six.unpack_from(data, numbers))


_BASIC: Mapping[str, tuple[Any, Callable[[], Any]]] = {
    "bool": (bool, bool),
    "byte": (byte, int),
    "float64": (float64, float),
    "string": (str, str),
    "uint8": (uint8, int),
    "uint32": (uint32, int),
}
_KNOWN: dict[str, Any] = {
    "builtin_interfaces/msg/Time": Time,
    "geometry_msgs/msg/Vector3": Vector3,
    "std_msgs/msg/Header": Header,
}


def _field(kind: Nodetype, of: Any) -> tuple[Any, Callable[[], Any]]:
    """The type of a field in IDL, and what makes a value where none is given."""
    if kind is Nodetype.BASE:
        return _BASIC[of[0]]
    if kind is Nodetype.NAME:
        known = _KNOWN.get(of) or _message(of)
        return known, known
    element, make = _field(*of[0])
    if kind is Nodetype.SEQUENCE:
        return _OF.sequence[element], list
    return _OF.array[element, of[1]], lambda: [make() for _ in range(of[1])]


def _message(name: str, values: Callable[[Any], tuple[float, ...]] | None = None) -> "type[Message]":
    """A message by its definition; `values` are the numbers of it that are used here."""
    package, _, kind = name.split("/")
    fields = {key: _field(*of) for key, of in _STORE.fielddefs[name][1]}

    def define(body: dict[str, Any]) -> None:
        body["__annotations__"].update((key, of) for key, (of, _) in fields.items())
        body.update((key, field(default_factory=make)) for key, (_, make) in fields.items())
        if values is not None:
            body["values"] = property(values)

    made = new_class(kind, (IdlStruct,), {"typename": f"{package}.msg.dds_.{kind}_"}, define)
    _KNOWN[name] = annotate.final(dataclass(made))
    return _KNOWN[name]  # type: ignore[no-any-return]


def _xyz(*vectors: str) -> Callable[[Any], tuple[float, ...]]:
    return attrgetter(*(f"{vector}.{axis}" for vector in vectors for axis in "xyz"))


Twist = _message("geometry_msgs/msg/Twist")
TwistStamped = _message("geometry_msgs/msg/TwistStamped", _xyz("twist.linear", "twist.angular"))
Vector3Stamped = _message("geometry_msgs/msg/Vector3Stamped", _xyz("vector"))
Imu = _message("sensor_msgs/msg/Imu", _xyz("angular_velocity", "linear_acceleration"))
Temperature = _message("sensor_msgs/msg/Temperature", lambda message: (message.temperature,))
JointState = _message("sensor_msgs/msg/JointState")
MultiArrayDimension = _message("std_msgs/msg/MultiArrayDimension")
MultiArrayLayout = _message("std_msgs/msg/MultiArrayLayout")
Float64MultiArray = _message("std_msgs/msg/Float64MultiArray")
KeyValue = _message("diagnostic_msgs/msg/KeyValue")
DiagnosticStatus = _message("diagnostic_msgs/msg/DiagnosticStatus")
DiagnosticArray = _message("diagnostic_msgs/msg/DiagnosticArray")
Bool = _message("std_msgs/msg/Bool")
Empty = _message("std_msgs/msg/Empty")


def type_hash(name: str) -> str:
    """Of a message (RIHS01, REP 2016): ROS 2 carries it in the user data of an endpoint, since Iron."""
    return _STORE.hash_rihs01(name)
