"""What controllers are handed, read back by readers of their own, is the tool's wrench at the flange."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tool_cases import a_tool

from truewrench.errors import InputError
from truewrench.tool.exports import TARGETS, write_tool_exports
from truewrench.tool.identify import exported_body
from truewrench.tool.model import Tool
from truewrench.tool.parameters import second_moments

Array = NDArray[np.float64]

FLANGE = np.array([0.01, -0.02, 0.04, 0.3, -0.2, 1.1])
HOUSING = np.array([0.4, 0.002, 0.0, -0.015])
BODY = tuple[float, Array, Array]  # mass, centre of mass, inertia about it, flange axes


def a_mounted_tool(*, inertia: bool = True, housing: bool = True) -> Tool:
    tool = a_tool()
    body = np.concatenate([[np.log(tool.mass)], tool.center_of_mass, second_moments(tool.mass, tool.inertia)])
    shell = HOUSING if housing else np.zeros(4)
    place = tool.layout.body
    exported = exported_body(body, tool.covariance[place, place], inertia, shell)
    return replace(tool, exported=exported, flange=FLANGE, housing=shell)


def wrench(body: BODY, motion: Array, fall: Array) -> Array:
    """Force and moment (6,) on a body about the flange's origin, by Newton and Euler."""
    mass, center, inertia = body
    v, omega, a, alpha = motion.reshape(4, 3)
    at_mass = (
        a + np.cross(omega, v) + np.cross(alpha, center) + np.cross(omega, np.cross(omega, center)) - fall
    )
    moment = inertia @ alpha + np.cross(omega, inertia @ omega) + np.cross(center, mass * at_mass)
    return np.concatenate([mass * at_mass, moment])


def stated(tool: Tool) -> list[BODY]:
    """The bodies at the flange by another path: tool and housing apart, turned by SciPy."""
    R = Rotation.from_euler("xyz", FLANGE[3:]).as_matrix()
    out: list[BODY] = []
    for mass, center, inertia in (
        (tool.mass, tool.center_of_mass, _full(tool.inertia)),
        (float(tool.housing[0]), tool.housing[1:], np.zeros((3, 3))),
    ):
        out.append((mass, FLANGE[:3] + R @ center, R @ inertia @ R.T))
    return out


def _full(e: Array) -> Array:
    return np.array([[e[0], e[3], e[4]], [e[3], e[1], e[5]], [e[4], e[5], e[2]]])


def read_ur(folder: Path) -> BODY:
    text = (folder / "tool_ur.script").read_text()
    call = re.search(r"^set_target_payload\(([^,]+), \[([^]]+)\], \[([^]]+)\]\)$", text, re.M)
    assert call
    e = np.array([float(x) for x in call[3].split(",")])
    return float(call[1]), np.array([float(x) for x in call[2].split(",")]), _full(e)


def read_franka(folder: Path) -> BODY:
    data = json.loads((folder / "tool_franka.json").read_text())
    assert set(data) == {"mass", "F_x_Cload", "load_inertia", "comment"}
    return data["mass"], np.array(data["F_x_Cload"]), np.array(data["load_inertia"]).reshape(3, 3).T


def read_urdf(folder: Path) -> BODY:
    robot = (folder / "tool.urdf").read_text()
    body = pin.buildModelFromXML(robot, pin.JointModelFreeFlyer()).inertias[1]
    return body.mass, np.array(body.lever), np.array(body.inertia)


def read_abb(folder: Path) -> BODY:
    text = (folder / "tool_abb.mod").read_text()
    found = re.search(r"loaddata \w+ := (\[.*\]);", text)
    assert found
    mass, center, (w, x, y, z), *moments = json.loads(found[1])
    R = Rotation.from_quat([x, y, z, w]).as_matrix()
    return mass, np.array(center) / 1e3, R @ np.diag(moments) @ R.T


def read_kuka(folder: Path) -> BODY:
    text = (folder / "tool_kuka.dat").read_text()
    line = next(line for line in text.splitlines() if line.startswith("DECL LOAD"))
    one = {
        key: float(value) for key, value in re.findall(r"\b([MXYZABC]) (-?[\d.e+-]+)", line.split("J {")[0])
    }
    J = [float(value) for value in re.findall(r"[XYZ] (-?[\d.e+-]+)", line.split("J {")[1])]
    R = Rotation.from_euler("ZYX", [one["A"], one["B"], one["C"]], degrees=True).as_matrix()
    return one["M"], np.array([one["X"], one["Y"], one["Z"]]) / 1e3, R @ np.diag(J) @ R.T


READERS = {"ur": read_ur, "franka": read_franka, "urdf": read_urdf, "abb": read_abb, "kuka": read_kuka}


@pytest.mark.parametrize("target", READERS)
def test_the_exported_body_has_the_wrench_of_tool_and_housing_at_the_flange(
    target: str, tmp_path: Path
) -> None:
    tool = a_mounted_tool()
    write_tool_exports(tool, [target], tmp_path)
    body, rng = READERS[target](tmp_path), np.random.default_rng(2)
    for motion in rng.normal(size=(20, 12)):
        fall = 9.81 * Rotation.random(random_state=rng).as_matrix()[:, 2]
        expected = sum(wrench(part, motion, fall) for part in stated(tool))
        np.testing.assert_allclose(wrench(body, motion, fall), expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("target", READERS)
def test_inertia_that_was_not_determined_is_zero_or_said_to_be_assumed(target: str, tmp_path: Path) -> None:
    tool = a_mounted_tool(inertia=False, housing=False)
    (path,) = write_tool_exports(tool, [target], tmp_path)
    mass, _, inertia = READERS[target](tmp_path)
    assert mass == pytest.approx(tool.mass)
    assert "inertia: not determined" in path.read_text()
    if target in ("franka", "urdf"):
        assert "assumed" in path.read_text()
        radius = max(0.05, float(np.linalg.norm(tool.center_of_mass)))
        np.testing.assert_allclose(inertia, 0.4 * mass * radius**2 * np.eye(3), rtol=1e-6, atol=1e-9)
    else:
        np.testing.assert_array_equal(inertia, np.zeros((3, 3)))


@pytest.mark.parametrize("target", READERS)
def test_every_exported_inertia_is_physical(target: str, tmp_path: Path) -> None:
    """A rod whose estimate is thinner than nothing."""
    tool = a_mounted_tool(housing=False)
    rod = np.array([np.log(2.0), 0.0, 0.0, 0.1, -3e-5, -2e-5, 4e-3, 1e-5, 2e-5, 0.0])
    spread = np.diag([0.01, 1e-3, 1e-3, 1e-3, *[3e-5] * 6]) ** 2
    tool = replace(tool, exported=exported_body(rod, spread, True, np.zeros(4)))
    write_tool_exports(tool, [target], tmp_path)
    _, _, inertia = READERS[target](tmp_path)
    principal = np.linalg.eigvalsh(inertia)
    assert principal[0] > 0.0
    assert principal[0] + principal[1] >= principal[2] * (1.0 - 1e-6)


def ros_files(tool: Tool, folder: Path) -> dict[str, Any]:
    return {path.name: yaml.safe_load(path.read_text()) for path in write_tool_exports(tool, ["ros"], folder)}


@pytest.mark.parametrize("housing", [False, True])
def test_ros_files_hold_the_same_body_at_the_flange(housing: bool, tmp_path: Path) -> None:
    tool = a_mounted_tool(housing=housing)
    files = ros_files(tool, tmp_path)
    mass = sum(part[0] for part in stated(tool))
    center = sum(part[0] * part[1] for part in stated(tool)) / mass
    gravity = files["admittance_controller.yaml"]["admittance_controller"]["ros__parameters"]
    gravity = gravity["gravity_compensation"]
    toolbox = files["gravity_compensation_filter.yaml"]["filter"]["params"]
    simple, ft = files["ft_tools.yaml"], files["force_torque_tools.yaml"]
    assert gravity["frame"]["id"] == toolbox["sensor_frame"] == ft["gripper_com_frame_id"] == "flange"
    for found in (
        gravity["CoG"]["pos"],
        [toolbox["tool"]["CoG"][axis] for axis in "xyz"],
        simple["sensor_frame_to_com"],
        ft["gripper_com_pose"][:3],
    ):
        np.testing.assert_allclose(found, center, rtol=1e-9)
    assert gravity["CoG"]["force"] == pytest.approx(mass * 9.81)
    field = [toolbox["tool"]["gravity_field"][axis] for axis in "xyz"]
    np.testing.assert_allclose(field, tool.gravity)
    assert toolbox["tool"]["mass"] == simple["mass"] == ft["gripper_mass"] == pytest.approx(mass)
    assert ft["bias"] == pytest.approx(tool.offset.tolist())
    text = (tmp_path / "tool_ros" / "ft_tools.yaml").read_text()
    assert ("does not feel its housing" in text) == housing


def test_nothing_is_left_of_weight_and_offset_at_the_flange(
    tmp_path: Path,
) -> None:
    """A reading at rest, moved to the flange by SciPy, less what ft_tools says."""
    tool = a_mounted_tool(housing=False)
    found = ros_files(tool, tmp_path)["ft_tools.yaml"]
    R = Rotation.from_euler("xyz", FLANGE[3:])
    for fall in 9.81 * Rotation.random(5, random_state=0).as_matrix()[:, 2]:
        own = (
            np.concatenate([tool.mass * fall, np.cross(tool.center_of_mass, tool.mass * fall)]) + tool.offset
        )
        force = R.apply(own[:3])
        moment = R.apply(own[3:]) + np.cross(FLANGE[:3], force)
        weight = found["mass"] * R.apply(fall)
        left = force - found["force_offset"] - weight
        turned = moment - found["torque_offset"] - np.cross(found["sensor_frame_to_com"], weight)
        np.testing.assert_allclose(np.concatenate([left, turned]), 0.0, atol=1e-9)


def test_without_a_flange_ros_files_are_in_the_sensors_frame(tmp_path: Path) -> None:
    tool = replace(a_mounted_tool(housing=False), flange=np.zeros(6))
    files = ros_files(tool, tmp_path)
    gravity = files["admittance_controller.yaml"]["admittance_controller"]["ros__parameters"]
    assert (
        gravity["gravity_compensation"]["frame"]["id"] == gravity["ft_sensor"]["frame"]["id"] == "ft_sensor"
    )
    assert files["ft_tools.yaml"]["sensor_frame_to_com"] == pytest.approx(tool.center_of_mass.tolist())
    assert files["ft_tools.yaml"]["torque_offset"] == pytest.approx(tool.offset[3:].tolist())


def test_mujoco_reads_the_body_that_pinocchio_reads(tmp_path: Path) -> None:
    """On a joint of a mount: MuJoCo welds a link without one to the world, and forgets its mass."""
    tool = a_mounted_tool()
    write_tool_exports(tool, ["urdf"], tmp_path)
    mass, center, inertia = read_urdf(tmp_path)
    robot = ElementTree.fromstring((tmp_path / "tool.urdf").read_text())
    ElementTree.SubElement(robot, "link", name="mount")
    joint = ElementTree.SubElement(robot, "joint", name="turn", type="continuous")
    ElementTree.SubElement(joint, "parent", link="mount")
    ElementTree.SubElement(joint, "child", link="tool")
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding="unicode"))
    assert model.nbody == 2
    x, y, z, w = np.roll(model.body_iquat[1], -1)
    R = Rotation.from_quat([x, y, z, w]).as_matrix()
    assert model.body_mass[1] == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(model.body_ipos[1], center, atol=1e-9)
    np.testing.assert_allclose(R @ np.diag(model.body_inertia[1]) @ R.T, inertia, atol=1e-9)


def test_an_unknown_target_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`fanuc`, expected one of ur, franka"):
        write_tool_exports(a_mounted_tool(), ["ur", "fanuc"], tmp_path)
    assert not list(tmp_path.iterdir())


def test_targets_are_those_of_the_command() -> None:
    assert tuple(TARGETS) == ("ur", "franka", "urdf", "abb", "kuka", "ros")
