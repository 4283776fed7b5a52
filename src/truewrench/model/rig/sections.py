"""The sections of a rig: every key once, with its default, its meaning and what it must satisfy.

SI units; six-vectors [linear; angular]; sensor axes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self
from unicodedata import category

import numpy as np
from pydantic import AfterValidator, ValidationInfo, model_validator

from truewrench.model.arrays import Array
from truewrench.model.rig.ati_cal import read_ati_cal
from truewrench.model.rig.imperfections import ImperfectionsSpec
from truewrench.model.rig.strict import (
    CountedEach,
    Duration,
    Fraction,
    Listed,
    Mapped,
    Matrix,
    NonNegative,
    NonNegatives,
    Number,
    Numbers,
    Positive,
    PositiveInteger,
    Positives,
    Rate,
    Section,
    SixPositives,
    Switch,
    Switched,
    Text,
    ThreeNumbers,
    Uncertainty,
    WholeNumber,
    Word,
    Zero,
    choice,
    of_length,
    refuse,
    shown,
    word_or_number,
)


class AtiGain(Section):
    """The nominal gain as ATI's calibration file states it."""

    ati_cal: Text
    calibration: PositiveInteger = 1  # which one of the file


def _gain_rows(value: Any, info: ValidationInfo) -> Any:
    if not isinstance(value, AtiGain):
        return value
    stated = read_ati_cal((info.context or {}).get("folder", Path()) / value.ati_cal, value.calibration)
    if stated.matrix.shape != (6, 6):
        found = f"{stated.matrix.shape[1]} gauges"
        raise refuse("ati_cal", found, "6: of more gauges such a file does not tell the gain, but an inverse")
    return tuple(map(tuple, stated.gain.tolist()))


if TYPE_CHECKING:
    NominalGain = Literal["identity"] | Matrix
else:
    NominalGain = Annotated[
        Annotated[Literal["identity"], Word] | Annotated[Matrix, Listed] | Annotated[AtiGain, Mapped],
        choice("`identity`, rows of 6 or {ati_cal: FILE}"),
        AfterValidator(_gain_rows),
    ]


class CompensatedSpec(Section):
    """A body whose static weight the driver has subtracted from the channels."""

    mass: Positive  # [kg]
    center_of_mass: ThreeNumbers  # from the sensor origin, sensor axes [m]


class SensorSpec(Section):
    """The sensor: n >= 6 channels, raw = gain @ w + offset."""

    channels: tuple[Text, ...]
    feels: Literal["payload_on_sensor", "sensor_on_payload"]
    noise: CountedEach
    range: SixPositives
    nominal_gain: NominalGain = "identity"
    gain_prior: Positive = 0.3
    offset_prior: (
        Annotated[
            Annotated[NonNegatives, Listed] | Annotated[NonNegative, Zero],
            choice("a list, one per channel, or 0 for no offset"),
        ]
        | None
    ) = None  # 10% of channel_scale
    pool_offsets: Switch = False
    time_offset_prior: NonNegative = 5.0e-3
    lowpass_hz: Positive | None = None
    discrepancy: Annotated[
        float | Literal["auto"], word_or_number("auto", "a fraction of range, 0 to 1", 0.0, 1.0)
    ] = "auto"  # what departs from the model together with the pose, 1 sigma; auto: found; 0: there is none
    compensated: Annotated[
        Annotated[Switch, Switched] | Annotated[CompensatedSpec, Mapped],
        choice("false, or {mass, center_of_mass} of the weight that the driver subtracted"),
    ] = False

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n = self.n
        if not 6 <= n <= 32:  # 32: max_channels of the core
            raise refuse("channels", f"{n} names", "6 to 32 names, in the order of the raw channels")
        for i, name in enumerate(self.channels):
            if name in self.channels[:i]:
                raise refuse(f"channels.{i}", shown(name), "every channel name once")
            if any(category(letter) == "Cc" for letter in name):  # a terminal obeys them
                raise refuse(f"channels.{i}", repr(name), "a name without control characters")
        if len(self.noise) != n:
            raise refuse("noise", f"{len(self.noise)} entries", f"{n}: one per channel")
        if self.compensated is True:
            raise refuse(
                "compensated",
                "true",
                "false, or {mass, center_of_mass} of the weight that the driver subtracted: where that is "
                "unknown, the wrench that calibrates the gain is gone; log the sensor's raw output",
            )
        self._check_nominal_gain()
        if isinstance(self.offset_prior, tuple) and len(self.offset_prior) != n:
            raise refuse(
                "offset_prior",
                f"{len(self.offset_prior)} entries",
                f"{n}: one per channel, or 0 for no offset",
            )
        return self

    def _check_nominal_gain(self) -> None:
        if self.nominal_gain == "identity":
            if self.n != 6:
                raise refuse(
                    "nominal_gain", "`identity`", f"{self.n} rows of 6: only 6 channels can be the identity"
                )
            return
        rows = self.nominal_gain
        if len(rows) != self.n:
            raise refuse("nominal_gain", f"{len(rows)} rows", f"{self.n} rows of 6: one per channel")
        for i, row in enumerate(rows):
            if not any(row):
                raise refuse(f"nominal_gain.{i}", shown(row), "a channel that feels at least one wrench axis")
        normalised = self.nominal_gain_array / self.gain_unit
        rank = int(np.linalg.matrix_rank(normalised))
        if rank < 6:
            raise refuse("nominal_gain", f"rows of rank {rank}", "rank 6: every wrench axis must be felt")

    @property
    def n(self) -> int:
        """Number of raw channels."""
        return len(self.channels)

    @property
    def sign(self) -> int:
        """+1 when the sensor feels the payload's reaction w, -1 when it feels the opposite."""
        return 1 if self.feels == "payload_on_sensor" else -1

    @property
    def subtracted(self) -> CompensatedSpec | None:
        """The body whose weight the driver has subtracted, None where the channels are raw."""
        return self.compensated if isinstance(self.compensated, CompensatedSpec) else None

    @property
    def noise_array(self) -> Array:
        """(n,) 1 sigma of one sample of each channel [raw units]."""
        return np.array(self.noise)

    @property
    def range_array(self) -> Array:
        """(6,) full scale of each wrench axis [N, N m]."""
        return np.array(self.range)

    @property
    def nominal_gain_array(self) -> Array:
        """(n, 6) gain that the sensor was believed to have [raw units per N or N m]."""
        return np.eye(6) if self.nominal_gain == "identity" else np.array(self.nominal_gain)

    @property
    def channel_scale(self) -> Array:
        """(n,) full scale of each channel, |nominal_gain| @ range [raw units]."""
        scale: Array = np.abs(self.nominal_gain_array) @ self.range_array
        return scale

    @property
    def gain_unit(self) -> Array:
        """(n, 6) 1 of the normalised gain: channel scale over range of the axis [raw units per N or N m]."""
        unit: Array = self.channel_scale[:, None] / self.range_array
        return unit

    @property
    def offset_prior_array(self) -> Array:
        """(n,) 1 sigma of each channel's offset [raw units]; 0 where there is none."""
        if self.offset_prior is None:
            return 0.1 * self.channel_scale
        return np.array(self.offset_prior) if isinstance(self.offset_prior, tuple) else np.zeros(self.n)


class InertiaSpec(Section):
    """Elements of the inertia tensor about the centre of mass, sensor axes [kg m^2]."""

    xx: Positive
    yy: Positive
    zz: Positive
    xy: Number = 0.0
    xz: Number = 0.0
    yz: Number = 0.0


ELEMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Order of the elements of an inertia tensor, and of second moments, wherever they are a list."""

ROWS, COLUMNS = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]).T
"""Where they stand in the matrix."""


def symmetric(elements: Array) -> Array:
    """(3, 3) of six elements in the order of `ELEMENTS`."""
    out = np.empty((3, 3))
    out[ROWS, COLUMNS] = out[COLUMNS, ROWS] = elements
    return out


class UncertaintySpec(Section):
    """1 sigma of what is known of a payload; 0 means exact."""

    mass: Uncertainty = 1.0e-3  # relative
    center_of_mass: Uncertainty = 5.0e-4  # [m]
    inertia: Uncertainty = 1.0e-2  # of I_ij, relative to sqrt(I_ii I_jj)

    @property
    def of_each(self) -> Array:
        """(10,) of the mass, the centre of mass and the inertia's elements xx yy zz xy xz yz."""
        return np.array([self.mass, *[self.center_of_mass] * 3, *[self.inertia] * 6])


UNKNOWN_MASS = 0.5  # 1 sigma of a payload's mass, relative, from which on it is not known
UNKNOWN_GYRATION = 0.005  # [m^2] inertia per mass of a body that nobody knows, about each axis (docs/tool.md)

UNKNOWN_UNCERTAINTY = UncertaintySpec(mass=1.5, center_of_mass=0.15, inertia=1.13)
"""1 sigma of log mass; [m]; of two second moments per mass, 0.004 m^2 each, over `UNKNOWN_GYRATION`."""


class PayloadSpec(Section):
    """Everything beyond the sensing element, as one rigid body."""

    mass: Positive
    center_of_mass: ThreeNumbers
    inertia: InertiaSpec
    uncertainty: UncertaintySpec = UncertaintySpec()

    @model_validator(mode="after")
    def _physical(self) -> Self:
        principal = np.linalg.eigvalsh(self.inertia_matrix)
        found = "principal moments " + ", ".join(f"{moment:.6g}" for moment in principal) + " kg m^2"
        if principal[0] <= 0:
            raise refuse("inertia", found, "a positive definite tensor")
        # 1e-9 forgives the rounding of a table, as the core does.
        if principal.sum() < 2 * principal[2] * (1 - 1e-9):
            raise refuse(
                "inertia",
                found,
                "no principal moment larger than the sum of the other two (triangle inequality)",
            )
        return self

    @property
    def center_of_mass_array(self) -> Array:
        """(3,) centre of mass seen from the sensor origin, sensor axes [m]."""
        return np.array(self.center_of_mass)

    @property
    def inertia_matrix(self) -> Array:
        """(3, 3) inertia about the centre of mass, sensor axes [kg m^2]."""
        i = self.inertia
        return np.array([[i.xx, i.xy, i.xz], [i.xy, i.yy, i.yz], [i.xz, i.yz, i.zz]])

    @property
    def units(self) -> Array:
        """(10,) what departures of mass, centre of mass and inertia are relative to [kg, 1, kg m^2]."""
        root = np.sqrt(np.diag(self.inertia_matrix))
        return np.concatenate([[self.mass], np.ones(3), root[ROWS] * root[COLUMNS]])

    @property
    def unknown(self) -> bool:
        """Whether the mass is so uncertain that the data are to tell the body."""
        return self.uncertainty.mass >= UNKNOWN_MASS

    @property
    def exact(self) -> bool:
        """Whether mass, centre of mass and inertia are all stated without uncertainty."""
        u = self.uncertainty
        return u.mass == 0 and u.center_of_mass == 0 and u.inertia == 0


class TemperatureSpec(Section):
    """How the offset depends on temperature."""

    reference: Number = 25.0  # [degC]
    prior: NonNegative = 0.0  # 1 sigma of the offset's slope, fraction of range per K


def _moving(value: tuple[float, ...]) -> tuple[float, ...]:
    if value and not any(value):
        raise refuse("", shown(value), "at least one that may move")
    return value


def _interval(value: tuple[float, ...]) -> tuple[float, ...]:
    if len(value) == 2 and not value[0] < value[1]:
        raise refuse("", shown(value), "[min, max] with min < max")
    return of_length(2, "[min, max]")(value)


class LimitsSpec(Section):
    """What the motion must keep to: per joint, or per axis of the twist."""

    position: Positives | None = None
    velocity: Annotated[NonNegatives, AfterValidator(_moving)] | None = None  # 0: does not move
    acceleration: Positives | None = None
    jerk: Positives | None = None
    wrench_fraction: Fraction | None = None
    workspace: (
        Annotated[
            tuple[Annotated[Numbers, AfterValidator(_interval)], ...],
            AfterValidator(of_length(3, "[min, max] of x, y and z")),
        ]
        | None
    ) = None


class PlanSpec(Section):
    """How a motion is planned."""

    duration: Duration = 20.0  # [s]
    rate: Rate = 40.0  # [Hz]
    harmonics: PositiveInteger = 6
    seed: WholeNumber = 0
    rest_to_rest: Switch = True


class SimulateSpec(Section):
    """What a simulated run is made of."""

    rate: Rate = 100.0  # [Hz] of the motion
    sensor_rate: Rate = 100.0  # [Hz] of the sensor
    seed: WholeNumber = 0
    gain: Annotated[
        Annotated[Literal["nominal", "random"], Word] | Annotated[Matrix, Listed],
        choice("`nominal`, `random` or rows of 6"),
    ] = "random"
    offset: Annotated[
        Annotated[Literal["none", "random"], Word]
        | Annotated[Numbers, Listed]
        | Annotated[NonNegative, Zero],
        choice("`none`, `random` or a list, one per channel"),
    ] = "random"
    time_offset: Annotated[float | Literal["random"], word_or_number("random", "a number of seconds")] = (
        0.0  # [s]
    )
    payload: Literal["nominal", "random"] = "nominal"
    imperfections: ImperfectionsSpec | None = None


class RecordingSpec(Section):
    """Which topics of a recording hold sensor and motion."""

    wrench_topic: Text | None = None  # a wrench, or an array of the raw channels
    joint_topic: Text | None = None
    twist_topic: Text | None = None
    imu_topic: Text | None = None
    temperature_topic: Text | None = None
    gravity_topic: Text | None = None
    stamps: Literal["header", "receive"] = "header"
