"""What controllers are handed, read back by readers of their own, is the tool's wrench at the flange."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tool_cases import Rigid, a_mounted_tool, stated, tensor_of

from truewrench.model.errors import InputError
from truewrench.tool.exports import TARGETS, write_tool_exports
from truewrench.tool.identify import exported_body

Array = NDArray[np.float64]


def wrench(body: Rigid, motion: Array, fall: Array) -> Array:
    """Force and moment (6,) on a body about the flange's origin, by Newton and Euler."""
    mass, center, inertia = body
    v, omega, a, alpha = motion.reshape(4, 3)
    at_mass = (
        a + np.cross(omega, v) + np.cross(alpha, center) + np.cross(omega, np.cross(omega, center)) - fall
    )
    moment = inertia @ alpha + np.cross(omega, inertia @ omega) + np.cross(center, mass * at_mass)
    return np.concatenate([mass * at_mass, moment])


def read_ur(folder: Path) -> Rigid:
    text = (folder / "tool_ur.script").read_text()
    call = re.search(r"^set_target_payload\(([^,]+), \[([^]]+)\], \[([^]]+)\]\)$", text, re.M)
    assert call
    e = np.array([float(x) for x in call[3].split(",")])
    return float(call[1]), np.array([float(x) for x in call[2].split(",")]), tensor_of(e)


def read_franka(folder: Path) -> Rigid:
    data = json.loads((folder / "tool_franka.json").read_text())
    assert set(data) == {"mass", "F_x_Cload", "load_inertia", "comment"}
    return data["mass"], np.array(data["F_x_Cload"]), np.array(data["load_inertia"]).reshape(3, 3).T


def read_urdf(folder: Path) -> Rigid:
    robot = (folder / "tool.urdf").read_text()
    body = pin.buildModelFromXML(robot, pin.JointModelFreeFlyer()).inertias[1]
    return body.mass, np.array(body.lever), np.array(body.inertia)


def read_abb(folder: Path) -> Rigid:
    text = (folder / "tool_abb.mod").read_text()
    found = re.search(r"loaddata \w+ := (\[.*\]);", text)
    assert found
    mass, center, (w, x, y, z), *moments = json.loads(found[1])
    R = Rotation.from_quat([x, y, z, w]).as_matrix()
    return mass, np.array(center) / 1e3, R @ np.diag(moments) @ R.T


def read_kuka(folder: Path) -> Rigid:
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
