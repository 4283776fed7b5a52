"""Topics as streams of a log: columns, time and numbers of every message."""

import math
from collections.abc import Sequence
from typing import Any

from cyclonedds.idl import IdlStruct

from truewrench.io.recordings.choice import KEYS, gravity_missing, roles_of
from truewrench.io.table import ANGULAR_VELOCITY, GRAVITY, SPECIFIC_FORCE, TWIST
from truewrench.live.ros2_types import (
    Float64MultiArray,
    Header,
    Imu,
    JointState,
    Temperature,
    Time,
    TwistStamped,
    Vector3Stamped,
    WrenchStamped,
)
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of

Sample = tuple[tuple[str, ...], int, Sequence[float]]


class Source:
    """What a topic of a type says."""

    kind: type[IdlStruct]  # of its messages

    def __init__(self, rig: Rig, role: str) -> None:
        self.role = role  # what they are to the rig
        self._receive = rig.recording.stamps == "receive"

    def read(self, message: Any, info: Any) -> Sample:
        """Columns, time [ns] and values; no columns where the message says nothing of the rig.

        InputError: the message is not as it should be.
        """
        names, values = self._values(message)
        return names, self._time(message.header, info), values

    def _values(self, message: Any) -> tuple[tuple[str, ...], Sequence[float]]:
        raise NotImplementedError

    def _time(self, header: Header, info: Any) -> int:
        if self._receive:
            return int(info.source_timestamp)
        if header.stamp.ns == 0:
            expected = "a stamp in every message, or `recording: {stamps: receive}` in the rig"
            raise InputError(f"found no stamp, expected {expected}")
        return header.stamp.ns


class SensorSource(Source):
    """A sensor with n channels: wrenches where there are six, else plain arrays."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig, "wrench")
        self._names = tuple(f"raw_{i}" for i in range(rig.sensor.n))
        self.kind = WrenchStamped if rig.sensor.n == 6 else Float64MultiArray

    def header(self, message: Any, info: Any) -> Header:
        """Its own, or when it was sent."""
        if self.kind is WrenchStamped:
            header: Header = message.header
            return header
        return Header(Time.of(info.source_timestamp))

    def read(self, message: Any, info: Any) -> Sample:
        """See `Source.read`; n finite channels."""
        values = message.values if self.kind is WrenchStamped else message.data
        if len(values) != len(self._names):
            raise InputError(f"found {len(values)} numbers, expected {len(self._names)}: one per channel")
        if not math.isfinite(sum(values)):
            raise InputError(f"found {list(values)}, expected finite channels")
        return self._names, self._time(self.header(message, info), info), values


class _Vector(Source):
    """A twist, an acceleration, a temperature or free fall."""

    def __init__(self, rig: Rig, role: str, kind: type[IdlStruct], names: tuple[str, ...]) -> None:
        super().__init__(rig, role)
        self.kind, self._names = kind, names

    def _values(self, message: Any) -> tuple[tuple[str, ...], Sequence[float]]:
        return self._names, _without_infinity(message.values)


class _Imu(Source):
    """A specific force, and where the motion is an IMU's the angular velocity before it."""

    kind = Imu

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig, "imu")
        whole = ANGULAR_VELOCITY + SPECIFIC_FORCE
        self._names = whole if rig.motion.source == "imu" else SPECIFIC_FORCE

    def _values(self, message: Any) -> tuple[tuple[str, ...], Sequence[float]]:
        return self._names, _without_infinity(message.values[-len(self._names) :])


class _Joints(Source):
    """Joints by name; those that do not move the sensor are passed over."""

    kind = JointState

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig, "joints")
        self._joints = robot_of(rig).joints

    def _values(self, message: Any) -> tuple[tuple[str, ...], Sequence[float]]:
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
        return names, _without_infinity(values)


def _without_infinity(values: Sequence[float]) -> Sequence[float]:
    if any(map(math.isinf, values)):
        raise InputError("found an infinity, expected finite numbers, or NaN where there is none")
    return values


_VECTORS: dict[str, tuple[type[IdlStruct], tuple[str, ...]]] = {
    "twist": (TwistStamped, TWIST),
    "temperature": (Temperature, ("temperature",)),
    "gravity": (Vector3Stamped, GRAVITY),
}


def motion_sources(rig: Rig) -> list[Source]:
    """Everything that a calibration needs beside the sensor, the motion first.

    UnsupportedError: gravity matters, and nothing tells its direction.
    """
    roles = roles_of(rig)[1:]
    expected = gravity_missing(rig)
    if expected is not None:
        raise UnsupportedError.at(rig.path, f"recording.{KEYS['gravity']}", "nothing", expected)
    own = {"joints": _Joints, "imu": _Imu}
    return [own[role](rig) if role in own else _Vector(rig, role, *_VECTORS[role]) for role in roles]
