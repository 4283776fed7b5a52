"""The section `motion` of a rig: what is logged of the motion, and how well.

SI units; six-vectors [linear; angular]; sensor axes.
"""

from collections.abc import Mapping
from typing import Any, Literal, Self

import numpy as np
from pydantic import model_validator

from truewrench.model.arrays import Array
from truewrench.model.rig.strict import CountedEach, NonNegative, Numbers, Section, Text, refuse, shown

ACCELEROMETER_BIAS_PRIOR = 0.05
"""[m/s^2] 1 sigma of an accelerometer's constant error: 5 mg, what a factory leaves of a MEMS part."""

GYRO_BIAS_PRIOR = 0.005  # [rad/s] 1 sigma of a gyroscope's constant error: 0.3 deg/s, likewise

_ONLY_WITH = {
    "of": "twist",
    "position_noise": "joints",
    "initial_position": "joints",
    "robot": "joints",
    "accelerometer_bias_prior": "imu",
    "gyro_bias_prior": "imu",
}
"""Keys that one source alone has."""


class RobotSpec(Section):
    """The arm that carries the sensor."""

    urdf: Text
    sensor_frame: Text


class MotionSpec(Section):
    """What is logged of the motion, and how well."""

    source: Literal["twist", "joints", "imu"] = "twist"
    of: Literal["com", "sensor"] = "com"  # joints and an IMU tell of the sensor's origin
    noise: CountedEach | None = None  # of v and Omega; of every joint's velocity; of an IMU's Omega
    position_noise: CountedEach | None = None
    initial_position: Numbers | None = None
    acceleration_noise: CountedEach | None = None  # six: of ax ... alz; three: of accel_*
    accelerometer_bias_prior: NonNegative | None = None  # [m/s^2] of each axis, 0: no bias
    gyro_bias_prior: NonNegative | None = None  # [rad/s] of each axis, 0: no bias
    robot: RobotSpec | None = None

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any) -> Any:
        """Refuse the keys of other sources, and fill in what follows from this one."""
        if not isinstance(data, Mapping):
            return data
        source = data.get("source", "twist")
        if source not in ("twist", "joints", "imu"):
            return data  # which is told by itself
        for key, only in _ONLY_WITH.items():
            if data.get(key) is not None and source != only:
                raise refuse(key, shown(data[key]), f"this key only with `source: {only}`")
        if source == "twist":
            return data
        implied: dict[str, Any] = {"of": "sensor"}
        if source == "imu":
            implied["accelerometer_bias_prior"] = ACCELEROMETER_BIAS_PRIOR
            implied["gyro_bias_prior"] = GYRO_BIAS_PRIOR
        return {**data, **{key: value for key, value in implied.items() if data.get(key) is None}}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.acceleration_noise is not None and len(self.acceleration_noise) not in (3, 6):
            found = f"{len(self.acceleration_noise)} entries"
            raise refuse("acceleration_noise", found, "6, for ax ... alz, or 3, for accel_*")
        if self.source == "twist":
            self._require("noise", 6, "1 sigma of v [m/s] and Omega [rad/s]")
        elif self.source == "imu":
            self._require("noise", 3, "1 sigma of Omega [rad/s]")
            self._require("acceleration_noise", 3, "1 sigma of accel_* [m/s^2]")
        else:
            self._check_joints()
        return self

    def _require(self, key: str, count: int, what: str) -> None:
        values = getattr(self, key)
        if values is None:
            expected = f"{count} numbers, {what}: required with `source: {self.source}`"
            raise refuse(key, "nothing", expected)
        if len(values) != count:
            raise refuse(key, f"{len(values)} entries", f"{count}: {what}")

    def _check_joints(self) -> None:
        if self.robot is None:
            raise refuse("robot", "nothing", "{urdf, sensor_frame}: required with `source: joints`")
        if self.noise is None and self.position_noise is None:
            raise refuse(
                "noise",
                "nothing",
                "noise, position_noise or both, one number per joint, with `source: joints`",
            )
        lengths = {
            key: len(getattr(self, key))
            for key in ("noise", "position_noise", "initial_position")
            if getattr(self, key) is not None
        }
        first, joints = next(iter(lengths.items()))
        for key, length in lengths.items():
            if length != joints or length == 0:
                raise refuse(key, f"{length} entries", f"one per joint, as many as in `{first}` ({joints})")

    @property
    def noise_array(self) -> Array:
        """1 sigma per sample: (6,) of the twist, one per joint [rad/s], or (3,) of an IMU's Omega [rad/s]."""
        return np.array(self.noise if self.noise is not None else (), dtype=np.float64)
