"""What a payload may be taken from instead of being spelt out: a URDF, or what robot controllers are told.

Every source becomes a `PayloadSpec` in sensor axes about the sensor's origin when the rig is read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal
from xml.etree import ElementTree

import numpy as np
from pydantic import AfterValidator, AliasChoices, Discriminator, Field, Tag, ValidationError, ValidationInfo
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array
from truewrench.model.rig.sections import (
    COLUMNS,
    ELEMENTS,
    ROWS,
    UNKNOWN_GYRATION,
    UNKNOWN_UNCERTAINTY,
    InertiaSpec,
    PayloadSpec,
    UncertaintySpec,
    symmetric,
)
from truewrench.model.rig.strict import (
    Numbers,
    Positive,
    Section,
    SixNumbers,
    Text,
    ThreeNumbers,
    Word,
    of_length,
    refuse,
    shown,
)
from truewrench.model.rig.urdf import link_at, nearest, read_urdf

UNKNOWN_MASS_GUESS = 1.5  # [kg] of a payload stated as `unknown`: the middle of its prior

_SYMMETRIC = 1e-6  # of the largest element: what the digits of a table may leave


class Pose(Section):
    """A frame seen from another, as in a URDF."""

    xyz: ThreeNumbers
    rpy: ThreeNumbers = (0.0, 0.0, 0.0)

    @property
    def matrix(self) -> Array:
        """(4, 4) homogeneous transform."""
        return _transform(np.array(self.xyz), np.array(self.rpy))


class FrankaLoad(Section):
    """What franka's SetLoad (libfranka `setLoad`) is told: flange axes, tensor about the centre of mass."""

    mass: Positive
    F_x_center_load: ThreeNumbers = Field(
        validation_alias=AliasChoices("F_x_center_load", "center_of_mass")  # ROS 1, ROS 2
    )
    load_inertia: Annotated[Numbers, AfterValidator(of_length(9, "a 3 x 3 matrix, column by column"))]
    flange_to_sensor: Pose


class UrLoad(Section):
    """What UR's set_target_payload (ur_msgs/SetPayload) is told: axes and tensor as for `FrankaLoad`."""

    mass: Positive
    center_of_gravity: ThreeNumbers
    inertia: SixNumbers  # Ixx, Iyy, Izz, Ixy, Ixz, Iyz
    flange_to_sensor: Pose


class FrankaPayload(Section):
    """A payload as a franka arm knows it."""

    franka: FrankaLoad
    uncertainty: UncertaintySpec = UncertaintySpec()

    def body(self, folder: Path) -> dict[str, Any]:
        """Mass, centre of mass and inertia at the sensor."""
        load = self.franka
        inertia = np.array(load.load_inertia).reshape(3, 3, order="F")
        if np.abs(inertia - inertia.T).max() > _SYMMETRIC * np.abs(inertia).max():
            raise refuse("franka.load_inertia", shown(load.load_inertia), "a symmetric matrix")
        return _seen_from(load.flange_to_sensor.matrix, load.mass, np.array(load.F_x_center_load), inertia)


class UrPayload(Section):
    """A payload as a UR arm knows it."""

    ur: UrLoad
    uncertainty: UncertaintySpec = UncertaintySpec()

    def body(self, folder: Path) -> dict[str, Any]:
        """Mass, centre of mass and inertia at the sensor."""
        load = self.ur
        inertia, center = symmetric(np.array(load.inertia)), np.array(load.center_of_gravity)
        return _seen_from(load.flange_to_sensor.matrix, load.mass, center, inertia)


class UrdfPayload(Section):
    """The links of a URDF from one of them outward, as one body; joints among them stand at zero.

    `frame` is the sensor's; `link` is the first one of the payload, by default the frame's own.
    """

    urdf: Text
    frame: Text
    link: Text | None = None
    uncertainty: UncertaintySpec = UncertaintySpec()

    def body(self, folder: Path) -> dict[str, Any]:
        """Mass, centre of mass and inertia at the sensor."""
        robot = read_urdf(folder / self.urdf)
        links = {link.get("name", ""): link for link in robot.findall("link")}
        joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
        if self.frame in links:
            frame = self.frame
        elif self.frame in joints:
            frame = link_at(joints[self.frame], "child")
        else:
            expected = f"a link or joint of `{self.urdf}` (nearest: {nearest(self.frame, [*links, *joints])})"
            raise refuse("frame", shown(self.frame), expected)
        first = frame if self.link is None else self.link
        if first not in links:
            expected = f"a link of `{self.urdf}` (nearest: {nearest(first, links)})"
            raise refuse("link", shown(first), expected)
        children: dict[str, list[ElementTree.Element]] = {name: [] for name in links}
        for joint in joints.values():
            children[link_at(joint, "parent")].append(joint)
        (root,) = links.keys() - {link_at(joint, "child") for joint in joints.values()}
        T_root_link = dict(_outward(root, np.eye(4), children))
        beyond = dict(_outward(first, np.linalg.inv(T_root_link[frame]) @ T_root_link[first], children))
        return self._sum({name: (links[name], T) for name, T in beyond.items()})

    def _sum(self, beyond: Mapping[str, tuple[ElementTree.Element, Array]]) -> dict[str, Any]:
        mass, moment, about_origin = 0.0, np.zeros(3), np.zeros((3, 3))
        for link, T in beyond.values():
            inertial = link.find("inertial")
            if inertial is None:
                continue
            T_sensor_body = T @ _origin(inertial)
            (m,) = _stated(inertial, "mass", "value")
            elements = _stated(inertial, "inertia", *(f"i{element}" for element in ELEMENTS))
            R, p = T_sensor_body[:3, :3], T_sensor_body[:3, 3]
            inertia = R @ symmetric(np.array(elements)) @ R.T
            mass, moment = mass + m, moment + m * p
            about_origin += inertia + m * (p @ p * np.eye(3) - np.outer(p, p))
        if mass <= 0.0:
            found = f"no mass in {', '.join(f'`{name}`' for name in beyond)}"
            raise refuse("urdf", found, "an <inertial> in a link of the payload")
        c = moment / mass
        about_c = about_origin - mass * (c @ c * np.eye(3) - np.outer(c, c))
        return _spelt(mass, c, about_c)


def _source(value: Any) -> str:
    """Which of the five ways of stating a payload a value is meant to be."""
    if isinstance(value, str):
        return "<word>"
    if isinstance(value, Mapping):
        return next((f"<{key}>" for key in ("urdf", "franka", "ur") if key in value), "<body>")
    return "<body>"


def _at_sensor(
    value: PayloadSpec | UrdfPayload | FrankaPayload | UrPayload | str, info: ValidationInfo
) -> PayloadSpec:
    if isinstance(value, PayloadSpec):
        return value
    if isinstance(value, str):
        moment = UNKNOWN_MASS_GUESS * UNKNOWN_GYRATION
        return PayloadSpec(
            mass=UNKNOWN_MASS_GUESS,
            center_of_mass=(0.0, 0.0, 0.0),
            inertia=InertiaSpec(xx=moment, yy=moment, zz=moment),
            uncertainty=UNKNOWN_UNCERTAINTY,
        )
    body = value.body((info.context or {}).get("folder", Path()))
    try:
        return PayloadSpec.model_validate({**body, "uncertainty": value.uncertainty})
    except ValidationError as error:  # no body of this world: the only fault that is left
        details, key = error.errors()[0], next(iter(type(value).model_fields))
        context = details.get("ctx", {})
        if details["type"] == "refused":
            raise refuse(key, context["found"], context["expected"]) from None
        found = f"{'.'.join(str(part) for part in details['loc'])} = {details['input']}"
        expected = "a tensor about the centre of mass that is known (controllers take zero for unknown)"
        raise refuse(key, found, expected) from None


if TYPE_CHECKING:
    AnyPayload = PayloadSpec
else:
    AnyPayload = Annotated[
        Annotated[PayloadSpec, Tag("<body>")]
        | Annotated[UrdfPayload, Tag("<urdf>")]
        | Annotated[FrankaPayload, Tag("<franka>")]
        | Annotated[UrPayload, Tag("<ur>")]
        | Annotated[Literal["unknown"], Word],
        Discriminator(_source),
        AfterValidator(_at_sensor),
    ]


def _spelt(mass: float, c: Array, inertia: Array) -> dict[str, Any]:
    """A body as a rig spells it out."""
    elements = dict(zip(ELEMENTS, inertia[ROWS, COLUMNS].tolist(), strict=True))
    return {"mass": float(mass), "center_of_mass": c.tolist(), "inertia": elements}


def _seen_from(T_flange_sensor: Array, mass: float, c_flange: Array, inertia_flange: Array) -> dict[str, Any]:
    R, p = T_flange_sensor[:3, :3], T_flange_sensor[:3, 3]
    return _spelt(mass, R.T @ (c_flange - p), R.T @ inertia_flange @ R)


def _transform(xyz: Array, rpy: Array) -> Array:
    """A URDF's origin: rotation about fixed x, then y, then z."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
    return T


def _origin(element: ElementTree.Element) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz, rpy = ([float(x) for x in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    return _transform(np.array(xyz), np.array(rpy))


def _stated(inertial: ElementTree.Element, tag: str, *keys: str) -> list[float]:
    element = inertial.find(tag)
    assert element is not None  # read_urdf has looked
    return [float(element.get(key, "")) for key in keys]


def _outward(
    link: str, T: Array, children: Mapping[str, list[ElementTree.Element]]
) -> Iterator[tuple[str, Array]]:
    """A link and those beyond it, with their poses; T is that of the first."""
    waiting = [(link, T)]
    while waiting:
        link, T = waiting.pop()
        yield link, T
        waiting += [(link_at(joint, "child"), T @ _origin(joint)) for joint in reversed(children[link])]
