"""Messages of ROS 2 as DDS types: names, fields and type hashes as every ROS 2 has them on the wire.

A type hash (RIHS01, REP 2016) tells one version of a message from another; ROS 2 carries it in the user data
of an endpoint, since Iron.
"""

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self

from cyclonedds.idl import IdlStruct
from cyclonedds.idl import annotations as annotate
from cyclonedds.idl.types import array, byte, float64, int32, uint8, uint32

if TYPE_CHECKING:
    from builtins import list as sequence

    Nine = list[float]
else:
    from cyclonedds.idl.types import sequence

    Nine = array[float64, 9]


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


@dataclass
@annotate.final
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    """Linear [m/s] and angular velocity [rad/s]."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
@annotate.final
class TwistStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TwistStamped_"):
    """A twist."""

    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)

    @property
    def values(self) -> tuple[float, ...]:
        """All six, the linear velocity first."""
        v, w = self.twist.linear, self.twist.angular
        return (v.x, v.y, v.z, w.x, w.y, w.z)


@dataclass
@annotate.final
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    """An orientation."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


def _unknown() -> list[float]:
    return [0.0] * 9


@dataclass
@annotate.final
class Imu(IdlStruct, typename="sensor_msgs.msg.dds_.Imu_"):
    """Angular velocity [rad/s] and specific force [m/s^2], and what is not used here."""

    header: Header = field(default_factory=Header)
    orientation: Quaternion = field(default_factory=Quaternion)
    orientation_covariance: Nine = field(default_factory=_unknown)
    angular_velocity: Vector3 = field(default_factory=Vector3)
    angular_velocity_covariance: Nine = field(default_factory=_unknown)
    linear_acceleration: Vector3 = field(default_factory=Vector3)
    linear_acceleration_covariance: Nine = field(default_factory=_unknown)

    @property
    def values(self) -> tuple[float, ...]:
        """Angular velocity, then specific force."""
        w, a = self.angular_velocity, self.linear_acceleration
        return (w.x, w.y, w.z, a.x, a.y, a.z)


@dataclass
@annotate.final
class Temperature(IdlStruct, typename="sensor_msgs.msg.dds_.Temperature_"):
    """A temperature [degrees Celsius]."""

    header: Header = field(default_factory=Header)
    temperature: float64 = 0.0
    variance: float64 = 0.0

    @property
    def values(self) -> tuple[float, ...]:
        """It alone."""
        return (self.temperature,)


@dataclass
@annotate.final
class Vector3Stamped(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3Stamped_"):
    """Three numbers and their time."""

    header: Header = field(default_factory=Header)
    vector: Vector3 = field(default_factory=Vector3)

    @property
    def values(self) -> tuple[float, ...]:
        """All three."""
        return (self.vector.x, self.vector.y, self.vector.z)


@dataclass
@annotate.final
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    """Joints by name; each of the other sequences has an entry per name, or none at all."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
@annotate.final
class MultiArrayDimension(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayDimension_"):
    """One dimension of an array."""

    label: str = ""
    size: uint32 = 0
    stride: uint32 = 0


@dataclass
@annotate.final
class MultiArrayLayout(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayLayout_"):
    """How an array lies in memory."""

    dim: sequence[MultiArrayDimension] = field(default_factory=list)
    data_offset: uint32 = 0


@dataclass
@annotate.final
class Float64MultiArray(IdlStruct, typename="std_msgs.msg.dds_.Float64MultiArray_"):
    """Numbers without a stamp."""

    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: sequence[float64] = field(default_factory=list)


@dataclass
@annotate.final
class KeyValue(IdlStruct, typename="diagnostic_msgs.msg.dds_.KeyValue_"):
    """A figure by its name, as text."""

    key: str = ""
    value: str = ""


@dataclass
@annotate.final
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticStatus_"):
    """How a component does: 0 OK, 1 warning, 2 error."""

    level: byte = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: sequence[KeyValue] = field(default_factory=list)


@dataclass
@annotate.final
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs.msg.dds_.DiagnosticArray_"):
    """How components do."""

    header: Header = field(default_factory=Header)
    status: sequence[DiagnosticStatus] = field(default_factory=list)


@dataclass
@annotate.final
class Bool(IdlStruct, typename="std_msgs.msg.dds_.Bool_"):
    """Yes or no."""

    data: bool = False


@dataclass
@annotate.final
class Empty(IdlStruct, typename="std_msgs.msg.dds_.Empty_"):
    """That something happens; IDL knows no message without a member."""

    structure_needs_at_least_one_member: uint8 = 0


TYPE_HASHES: dict[type[IdlStruct], str] = {
    WrenchStamped: "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    TwistStamped: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    JointState: "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    Imu: "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    Temperature: "72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8",
    Vector3Stamped: "d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a",
    Float64MultiArray: "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f",
    Bool: "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    Empty: "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    DiagnosticArray: "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
"""Of the messages that are topics."""
