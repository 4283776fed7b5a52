"""A robot description (URDF) as a Pinocchio model, without meshes, with errors that name file and place."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from truewrench.model.errors import InputError

__all__ = ["model_of", "nearest", "read_urdf"]

_UNBOUNDED = "1e300"  # what stands in the model for a position that has no limit


def nearest(name: str, known: Iterable[str]) -> str:
    """The names most like one that is missing, for an error message."""
    close = difflib.get_close_matches(name, list(known), n=3, cutoff=0.0)
    return ", ".join(f"`{other}`" for other in close) or "there are none"


def read_urdf(path: str | Path) -> ElementTree.Element:
    """The robot of a URDF file without its geometry, so that no mesh is ever looked for.

    Continuous joints become revolute ones without limits: Pinocchio would give them two coordinates each.

    Raises:
        InputError: the file cannot be read, is no URDF, or a joint in it lacks what every joint needs.
    """
    try:
        robot = ElementTree.fromstring(Path(path).read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ElementTree.ParseError as error:
        line, column = error.position
        raise InputError.at(f"{path}:{line}", f"column {column + 1}", f"{error.msg}", "XML") from error
    if any("xacro" in str(element.tag) for element in robot.iter()):
        raise InputError.at(path, "", "xacro macros", "a plain URDF: expand it first (`xacro FILE > URDF`)")
    if robot.tag != "robot":
        raise InputError.at(path, "", f"an element <{robot.tag}>", "a URDF: <robot>")
    links = {link.get("name", "") for link in robot.findall("link")}
    for joint in robot.findall("joint"):
        _check(joint, links, path)
    for origin in robot.iter("origin"):
        for key in ("xyz", "rpy"):
            _check_three(origin.get(key, "0 0 0"), key, path)
    for link in robot.findall("link"):
        for tag in ("visual", "collision"):
            for geometry in link.findall(tag):
                link.remove(geometry)
    return robot


def _check_three(text: str, key: str, path: str | Path) -> None:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise InputError.at(path, "an <origin>", f'{key}="{text}"', "three numbers")


def _check(joint: ElementTree.Element, links: set[str], path: str | Path) -> None:
    place = f"joint `{joint.get('name')}`"
    for tag in ("parent", "child"):
        element = joint.find(tag)
        link = None if element is None else element.get("link")
        if link is None:
            raise InputError.at(path, place, f"no {tag} link", f"<{tag} link=...>")
        if link not in links:
            expected = f"a link of the robot (nearest: {nearest(link, links)})"
            raise InputError.at(path, place, f"the {tag} `{link}`", expected)
    kind, limit = joint.get("type"), joint.find("limit")
    if kind in ("revolute", "prismatic") and limit is None:
        raise InputError.at(path, place, "no <limit>", f"the limits of a {kind} joint")
    if kind == "continuous":
        joint.set("type", "revolute")
        if limit is None:
            limit = ElementTree.SubElement(joint, "limit", velocity=_UNBOUNDED, effort=_UNBOUNDED)
        limit.set("lower", f"-{_UNBOUNDED}")
        limit.set("upper", _UNBOUNDED)
        for safety in joint.findall("safety_controller"):
            joint.remove(safety)


def model_of(path: str | Path) -> Any:
    """The whole robot of a URDF as a `pinocchio.Model`, on a fixed base; limits that are missing are inf.

    Raises:
        InputError: as for `read_urdf`, and when Pinocchio does not accept the robot.
    """
    import pinocchio as pin

    text = ElementTree.tostring(read_urdf(path), encoding="unicode")
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise InputError.at(
            path, "", f"a robot that cannot be built ({error})", "one tree of links"
        ) from error
    for name in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit"):
        limits = getattr(model, name)
        limits[abs(limits) >= float(_UNBOUNDED)] *= math.inf
        setattr(model, name, limits)
    return model
