"""RIG: what is known of sensor, payload and motion before a calibration, validated (docs/formats.md).

SI units; six-vectors [linear; angular]; sensor axes. sections.py holds every key once, with its default.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.files import read_yaml
from truewrench.model.rig.imperfections import ImperfectionsSpec
from truewrench.model.rig.motion import MotionSpec, RobotSpec
from truewrench.model.rig.payload_sources import AnyPayload
from truewrench.model.rig.sections import (
    CompensatedSpec,
    InertiaSpec,
    LimitsSpec,
    PayloadSpec,
    PlanSpec,
    RecordingSpec,
    SensorSpec,
    SimulateSpec,
    TemperatureSpec,
    UncertaintySpec,
)
from truewrench.model.rig.strict import (
    ForAllOrEach,
    NonNegative,
    Section,
    SixPositives,
    Text,
    ThreeNumbers,
    input_error,
    refuse,
    shown,
)

__all__ = [
    "CompensatedSpec",
    "ImperfectionsSpec",
    "InertiaSpec",
    "LimitsSpec",
    "MotionSpec",
    "PayloadSpec",
    "PlanSpec",
    "RecordingSpec",
    "Rig",
    "RobotSpec",
    "SensorSpec",
    "SimulateSpec",
    "TemperatureSpec",
    "UncertaintySpec",
    "load_rig",
]


_NO_MOTION = MotionSpec(of="sensor", noise=(1e-3,) * 6)  # stands for one that is not stated
_MISSING = object()


def _stated(value: Any) -> Any:
    if value is _MISSING:
        raise PydanticCustomError("missing", "missing")
    return value


class Rig(Section):
    """Sensor, payloads and motion of a calibration, with the settings of everything built on them."""

    sensor: SensorSpec
    # both may be absent where `reference_noise` is stated: logs with ref_* need neither
    payloads: Annotated[dict[Text, AnyPayload], Field(min_length=1), BeforeValidator(_stated)] = Field({})
    motion: Annotated[MotionSpec, BeforeValidator(_stated)] = _NO_MOTION
    gravity: ThreeNumbers = (0.0, 0.0, 0.0)
    gravity_tilt_prior: NonNegative = 3.5e-3  # [rad] 1 sigma of gravity's direction about two axes
    reference_noise: SixPositives | None = None
    temperature: TemperatureSpec = TemperatureSpec()
    required: ForAllOrEach = 0.02  # sigma of a normalised gain; per wrench axis, null: not asked for
    limits: LimitsSpec = LimitsSpec()
    plan: PlanSpec = PlanSpec()
    simulate: SimulateSpec = SimulateSpec()
    recording: RecordingSpec = RecordingSpec()

    _path: Path | None = PrivateAttr(default=None)

    @classmethod
    def from_mapping(cls, data: Any, path: str | Path | None = None) -> Rig:
        """Validate settings that were not read from a file.

        Raises:
            InputError: with one line per problem: key, value found, what was expected.
        """
        try:
            rig = cls.model_validate(data, context=_context(path))
        except ValidationError as error:
            raise input_error(error, cls, path) from None
        rig._path = None if path is None else Path(path)
        return rig

    @model_validator(mode="before")
    @classmethod
    def _motion_or_reference(cls, data: Any) -> Any:
        """Require motion and payloads where no wrenches are known from elsewhere."""
        if not isinstance(data, Mapping) or data.get("reference_noise") is not None:
            return data
        return {"payloads": _MISSING, "motion": _MISSING, **data}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n, gain, offset = self.sensor.n, self.simulate.gain, self.simulate.offset
        if isinstance(gain, tuple) and len(gain) != n:
            raise refuse("simulate.gain", f"{len(gain)} rows", f"{n} rows of 6: one per channel")
        if isinstance(offset, tuple) and len(offset) != n:
            raise refuse("simulate.offset", f"{len(offset)} entries", f"{n}: one per channel")
        if self.sensor.subtracted is not None and not self.in_gravity:
            expected = "the gravity in which the driver subtracted a weight (`sensor.compensated`)"
            raise refuse("gravity", shown(self.gravity), expected)
        imperfect = self.simulate.imperfections
        if imperfect is not None and imperfect.gravity_tilt is not None and not self.in_gravity:
            raise refuse(
                "simulate.imperfections.gravity_tilt", shown(imperfect.gravity_tilt), "gravity to tilt"
            )
        motion = self.motion
        axes = len(motion.noise or motion.position_noise or ()) if motion.source == "joints" else 6
        for key in ("position", "velocity", "acceleration", "jerk"):
            values = getattr(self.limits, key)
            if values is not None and len(values) != axes:
                what = "one per joint" if motion.source == "joints" else "one per axis of the twist"
                raise refuse(f"limits.{key}", f"{len(values)} entries", f"{axes}: {what}")
        return self

    @property
    def states_motion(self) -> bool:
        """Whether `motion` is there; without it only logs with ref_* can be used."""
        return "motion" in self.model_fields_set

    def check_motion(self, what: str) -> None:
        """Refuse a rig without motion or payloads where both are needed, or something that makes up for them.

        `what` says so, as in "which a simulation needs". InputError: naming the key that is absent.
        """
        for key, told in (("motion", self.states_motion), ("payloads", bool(self.payloads))):
            if not told:
                raise InputError.at(self.path, key, "nothing", f"`{key}`, {what}")

    def payload_named(self, name: str | None) -> str:
        """The payload of a motion: the one named, else the first. InputError: there is none of that name."""
        found = next(iter(self.payloads)) if name is None else name
        if found not in self.payloads:
            expected = f"one of: {', '.join(self.payloads)}"
            raise InputError.at(self.path, "payloads", f"no payload `{found}`", expected)
        return found

    @property
    def required_array(self) -> Array:
        """(6,) acceptable sigma of the gains to each wrench axis; infinite where it is not asked for."""
        each = self.required if isinstance(self.required, tuple) else (self.required,) * 6
        return np.array([np.inf if value is None else value for value in each])

    @property
    def path(self) -> Path | None:
        """The file the rig was read from."""
        return self._path

    @property
    def urdf_path(self) -> Path | None:
        """The robot's URDF; a relative path is relative to the rig's file."""
        if self.motion.robot is None:
            return None
        return (self._path.parent if self._path else Path()) / self.motion.robot.urdf

    @property
    def gravity_array(self) -> Array:
        """(3,) acceleration of free fall in the robot's root frame [m/s^2]."""
        return np.array(self.gravity)

    @property
    def in_gravity(self) -> bool:
        """Whether gravity acts at all."""
        return any(self.gravity)

    def to_mapping(self) -> dict[str, Any]:
        """The settings, defaults filled in, as `from_mapping` and a rig file take them."""
        out: dict[str, Any] = self.model_dump(mode="json", exclude_none=True)
        if self.motion.source != "twist":
            del out["motion"]["of"]  # a key of twists alone
        if not self.states_motion:
            del out["motion"]
        if not self.payloads:
            del out["payloads"]
        return out


def _context(path: str | Path | None) -> dict[str, Path]:
    """What paths in a rig are relative to."""
    return {"folder": Path() if path is None else Path(path).parent}


def load_rig(path: str | Path) -> Rig:
    """Read and validate a rig file.

    Raises:
        InputError: naming file, line, key, what was found and what was expected, one line per problem.
    """
    data, locate = read_yaml(path)
    if not isinstance(data, Mapping):
        raise InputError.at(path, "", shown(data), "a mapping with sensor, payloads and motion")
    try:
        rig = Rig.model_validate(data, context=_context(path))
    except ValidationError as error:
        raise input_error(error, Rig, path, locate) from None
    rig._path = Path(path)
    return rig
