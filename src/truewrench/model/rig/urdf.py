"""A robot description (URDF) as a Pinocchio model, without meshes, with errors that name file and place."""

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError, SubElement, fromstring, tostring

from truewrench.model.errors import InputError

_UNBOUNDED = "1e300"  # what stands in the model for a position that has no limit
_KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")  # as urdfdom knows it
_TREE = "one tree of links"


def nearest(name: str, known: Iterable[str]) -> str:
    """The names most like one that is missing, for an error message."""
    close = difflib.get_close_matches(name, list(known), n=3, cutoff=0.0)
    return ", ".join(f"`{other}`" for other in close) or "there are none"


def read_urdf(path: str | Path) -> Element:
    """The robot of a URDF file without its geometry, so that no mesh is ever looked for.

    Its links and joints have names of their own and form one tree; their numbers are finite, masses and
    largest speeds not negative. Continuous joints become revolute ones without limits: Pinocchio would give
    them two coordinates each. InputError: the file cannot be read, or is no such robot.
    """
    try:
        robot = fromstring(Path(path).read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ParseError as error:
        line, column = error.position
        raise InputError.at(f"{path}:{line}", f"column {column + 1}", f"{error.msg}", "XML") from error
    except (LookupError, ValueError) as error:
        raise InputError.at(path, "", f"an encoding that cannot be read ({error})", "XML in UTF-8") from error
    if any("xacro" in str(element.tag) for element in robot.iter()):
        raise InputError.at(path, "", "xacro macros", "a plain URDF: expand it first (`xacro FILE > URDF`)")
    if robot.tag != "robot":
        raise InputError.at(path, "", f"an element <{robot.tag}>", "a URDF: <robot>")
    links, joints = (_named(robot, tag, path) for tag in ("link", "joint"))
    for name, link in links.items():
        _check_link(link, f"{path}: link `{name}`")
    for name, joint in joints.items():
        _check_joint(joint, links, f"{path}: joint `{name}`")
    _check_tree(links, joints, path)
    return robot


def _named(robot: Element, tag: str, path: str | Path) -> dict[str, Element]:
    named: dict[str, Element] = {}
    for element in robot.findall(tag):
        name = element.get("name")
        if not name:
            raise InputError.at(path, f"{tag} {len(named) + 1}", "no name", f"<{tag} name=...>")
        if name in named:
            raise InputError.at(path, f"{tag} `{name}`", "a second one of this name", "a name of its own")
        named[name] = element
    return named


def _check_link(link: Element, place: str) -> None:
    _check_origins(link, place)
    for tag in ("visual", "collision"):
        for geometry in link.findall(tag):
            link.remove(geometry)
    inertial = link.find("inertial")
    if inertial is not None:
        mass = _numbers(inertial, "mass", "value", place)[0]
        if mass < 0.0:
            raise InputError.at(None, f"{place}: <mass>", f"{mass:g}", "0 kg or more")
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            _numbers(inertial, "inertia", key, place)


def _check_joint(joint: Element, links: Mapping[str, Element], place: str) -> None:
    for tag in ("parent", "child"):
        element = joint.find(tag)
        link = None if element is None else element.get("link")
        if link is None:
            raise InputError.at(None, place, f"no {tag} link", f"<{tag} link=...>")
        if link not in links:
            expected = f"a link of the robot (nearest: {nearest(link, links)})"
            raise InputError.at(None, place, f"the {tag} `{link}`", expected)
    _check_origins(joint, place)
    kind = joint.get("type")
    if kind not in _KINDS:
        raise InputError.at(None, f"{place}: type", f"`{kind}`", f"one of {', '.join(_KINDS)}")
    if kind not in ("fixed", "floating") and joint.find("axis") is not None:
        axis = _numbers(joint, "axis", "xyz", place, count=3)
        if not 1e-6 < math.hypot(*axis) < 1e6:  # squares far beyond are 0 or inf: no direction is left
            found = f"a length of {math.hypot(*axis):g}"
            raise InputError.at(None, f"{place}: <axis>", found, "a direction, best of length 1")
    limit = joint.find("limit")
    if limit is not None:
        lower, upper = (_numbers(joint, "limit", key, place, "0")[0] for key in ("lower", "upper"))
        for key in ("velocity", "effort"):
            most = _numbers(joint, "limit", key, place)[0]
            if most < 0.0:
                raise InputError.at(None, f"{place}: <limit> {key}", f"{most:g}", "0 or more")
        if lower > upper and kind in ("revolute", "prismatic"):
            found = f"lower {lower:g} above upper {upper:g}"
            raise InputError.at(None, f"{place}: <limit>", found, "lower <= upper")
    elif kind in ("revolute", "prismatic"):
        raise InputError.at(None, place, "no <limit>", f"the limits of a {kind} joint")
    if kind == "continuous":
        joint.set("type", "revolute")
        if limit is None:
            limit = SubElement(joint, "limit", velocity=_UNBOUNDED, effort=_UNBOUNDED)
        limit.set("lower", f"-{_UNBOUNDED}")
        limit.set("upper", _UNBOUNDED)
        for safety in joint.findall("safety_controller"):
            joint.remove(safety)


def _check_origins(part: Element, place: str) -> None:
    for holder in part.iter():
        if holder.find("origin") is not None:
            for key in ("xyz", "rpy"):
                _numbers(holder, "origin", key, place, "0 0 0", count=3)


def _numbers(
    part: Element, tag: str, key: str, place: str, default: str | None = None, *, count: int = 1
) -> list[float]:
    """The numbers of an attribute of the element `tag` in a part of the robot; `place` says file and part."""
    element = part.find(tag)
    text = default if element is None else element.get(key, default)
    words = [] if text is None else text.split() if count > 1 else [text]
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    if not len(words) == len(numbers) == count or not all(map(math.isfinite, numbers)):
        found = f"no {key}" if text is None else f'{key}="{text}"'
        expected = "a finite number" if count == 1 else "three numbers"
        raise InputError.at(None, f"{place}: <{tag}>", found, expected)
    return numbers


def _check_tree(links: Mapping[str, Element], joints: Mapping[str, Element], path: str | Path) -> None:
    above: dict[str, str] = {}
    for name, joint in joints.items():
        child = link_at(joint, "child")
        if child in above:
            raise InputError.at(path, f"joint `{name}`", f"a second parent of the link `{child}`", _TREE)
        above[child] = link_at(joint, "parent")
    rooted: set[str] = set()
    for first in links:
        link, way = first, set()
        while link in above and link not in rooted:
            if link in way:
                raise InputError.at(path, f"link `{link}`", "a loop of joints through it", _TREE)
            way.add(link)
            link = above[link]
        rooted |= way
    roots = [f"`{link}`" for link in links if link not in above]
    if len(roots) != 1:
        found = f"links without a parent: {', '.join(roots[:3]) or 'none'}"
        raise InputError.at(path, "", found, _TREE)


def link_at(joint: Element, end: str) -> str:
    """The `parent` or `child` of a joint that `read_urdf` has seen."""
    element = joint.find(end)
    assert element is not None
    return element.get("link", "")


def model_of(path: str | Path) -> Any:
    """The whole robot of a URDF as a `pinocchio.Model`, on a fixed base.

    Limits that are missing are infinite, and so is a velocity or an effort of 0: written where none is known.
    """
    import pinocchio as pin

    text = tostring(read_urdf(path), encoding="unicode")
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        found = f"a robot that Pinocchio cannot build ({error})"
        raise InputError.at(path, "", found, "a URDF that `check_urdf` accepts") from error
    for name in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit"):
        limits = getattr(model, name)
        limits[abs(limits) >= float(_UNBOUNDED)] *= math.inf
        if name in ("velocityLimit", "effortLimit"):
            limits[limits == 0.0] = math.inf
        setattr(model, name, limits)
    return model
