"""The YAML of `tool --export ros` read as its nodes read it: what they subtract is the tool's weight.

Parameter files go through rcl's own parser, by a node of rclpy that takes them as its parameters. What the
nodes compute, which no package index has, is computed as their sources publish it.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from contact_cases import tilted
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tool_cases import FLANGE, a_mounted_tool, a_rig, stated

from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.exports import left_out, write_tool_exports
from truewrench.tool.model import Tool

Array = NDArray[np.float64]

# files and names of their nodes in, parameters out: name, rcl's type and value
NODE = """
import json, sys, rclpy
from rclpy.context import Context
from rclpy.node import Node
found = []
for name, path in json.loads(sys.argv[1]):
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", path, "--disable-rosout-logs"], context=context)
    node = Node(name, context=context, enable_rosout=False, start_parameter_services=False,
                automatically_declare_parameters_from_overrides=True)
    read = {key: [p.type_.name, p.value] for key, p in node.get_parameters_by_prefix("").items()}
    own = ("use_sim_time", "start_type_description_service")  # every node's
    found.append({key: [kind, list(v) if "ARRAY" in kind else v]
                  for key, (kind, v) in read.items() if key not in own})
    node.destroy_node()
    rclpy.shutdown(context=context)
print(json.dumps(found))
"""

needs_ros = pytest.mark.skipif(
    importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed, whose parser is rcl's"
)


def read_by_rcl(tmp_path: Path, *files: tuple[str, Path]) -> list[dict[str, tuple[str, Any]]]:
    """Parameters of nodes by their full names: type and value."""
    asked = json.dumps([[name, str(path)] for name, path in files])
    result = subprocess.run(
        [sys.executable, "-c", NODE, asked],
        env={**os.environ, "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "ROS_LOG_DIR": str(tmp_path)},
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout.splitlines()[-1])
    return [{key: (kind, value) for key, (kind, value) in one.items()} for one in found]


def written(tool: Tool, folder: Path) -> dict[str, Path]:
    return {path.name: path for path in write_tool_exports(tool, ["ros"], folder)}


def as_documents(tool: Tool, folder: Path) -> dict[str, Any]:
    return {name: yaml.safe_load(path.read_text()) for name, path in written(tool, folder).items()}


def weight_at_flange(tool: Tool, fall: Array) -> Array:
    """(6,) at the flange, along its axes, of tool and housing under free fall in the same axes."""
    parts = [np.concatenate([m * fall, np.cross(c, m * fall)]) for m, c, _ in stated(tool)]
    return np.asarray(np.sum(parts, axis=0))


FILTER = "sensor_filter_chain.filter1"


@needs_ros
@pytest.mark.parametrize("housing", [False, True])
def test_nodes_that_rcl_gives_the_parameters_leave_nothing_of_the_weight(
    housing: bool, tmp_path: Path
) -> None:
    tool = a_mounted_tool(housing=housing)
    files = written(tool, tmp_path)
    admittance, broadcaster = read_by_rcl(
        tmp_path,
        ("admittance_controller", files["admittance_controller.yaml"]),
        ("force_torque_sensor_broadcaster", files["gravity_compensation_filter.yaml"]),
    )
    prefix = f"{FILTER}.params"
    # names and types as the sources declare them
    assert {key: kind for key, (kind, _) in admittance.items()} == {
        "ft_sensor.frame.id": "STRING",
        "fixed_world_frame.frame.id": "STRING",
        "gravity_compensation.frame.id": "STRING",
        "gravity_compensation.CoG.pos": "DOUBLE_ARRAY",
        "gravity_compensation.CoG.force": "DOUBLE",
    }
    assert {key: kind for key, (kind, _) in broadcaster.items()} == {
        f"{FILTER}.name": "STRING",
        f"{FILTER}.type": "STRING",
        f"{prefix}.world_frame": "STRING",
        f"{prefix}.sensor_frame": "STRING",
        f"{prefix}.tool.CoG": "DOUBLE_ARRAY",
        f"{prefix}.tool.gravity_field": "DOUBLE_ARRAY",
        f"{prefix}.tool.mass": "DOUBLE",
    }
    assert broadcaster[f"{FILTER}.type"][1] == "control_filters/GravityCompensationWrench"
    for node, key in (
        (admittance, "ft_sensor.frame.id"),
        (admittance, "gravity_compensation.frame.id"),
        (broadcaster, f"{prefix}.sensor_frame"),
    ):
        assert node[key][1] == "flange"
    position, force = (np.array(admittance[f"gravity_compensation.CoG.{key}"][1]) for key in ("pos", "force"))
    center, field, mass = (
        np.array(broadcaster[f"{prefix}.tool.{key}"][1]) for key in ("CoG", "gravity_field", "mass")
    )
    true = tilted(tool.rig.gravity_array, tool.tilt)
    for R in Rotation.random(5, random_state=1):  # R_world_flange
        reading = weight_at_flange(tool, R.inv().apply([0.0, 0.0, -9.81]))
        # admittance_rule_impl.hpp: in the axes of the world, whose z points up
        end_effector_weight = np.array([0.0, 0.0, -force])
        left = np.concatenate([R.apply(reading[:3]), R.apply(reading[3:])])
        left[:3] -= end_effector_weight
        left[3:] -= np.cross(R.apply(position), end_effector_weight)
        np.testing.assert_allclose(left, 0.0, atol=1e-9)
        # gravity_compensation.cpp: in the axes of the sensor
        reading = weight_at_flange(tool, R.inv().apply(true))
        constant = R.inv().apply(field * mass)
        left = reading - np.concatenate([constant, np.cross(center, constant)])
        np.testing.assert_allclose(left, 0.0, atol=1e-9)


@needs_ros
def test_flat_files_are_parameters_that_rcl_takes_for_doubles(tmp_path: Path) -> None:
    """As someone pastes them under a node's name: an integer among doubles would be refused there."""
    tool = replace(a_mounted_tool(housing=False), offset=np.array([0.0, 1.0, -2.0, 1e-7, 3e9, 0.5]))
    files, nodes = written(tool, tmp_path), []
    for name in ("ft_tools", "force_torque_tools"):
        text = files[f"{name}.yaml"].read_text()
        inner = "".join(f"      {line}\n" for line in text.splitlines())
        path = tmp_path / f"{name}.node.yaml"
        path.write_text(f"{name}:\n  ros__parameters:\n    calibration:\n{inner}")
        nodes.append((name, path))
    ft_tools, ft_calib = read_by_rcl(tmp_path, *nodes)
    kinds = {
        "calibration.mass": "DOUBLE",
        "calibration.sensor_frame_to_com": "DOUBLE_ARRAY",
        "calibration.force_offset": "DOUBLE_ARRAY",
        "calibration.torque_offset": "DOUBLE_ARRAY",
    }
    assert {key: kind for key, (kind, _) in ft_tools.items()} == kinds
    ((mass, center, _), _) = stated(tool)
    np.testing.assert_allclose(ft_tools["calibration.mass"][1], mass, rtol=1e-12)
    np.testing.assert_allclose(ft_tools["calibration.sensor_frame_to_com"][1], center, rtol=1e-9)
    assert ft_calib["calibration.bias"] == ("DOUBLE_ARRAY", tool.offset.tolist())
    assert ft_calib["calibration.gripper_mass"][0] == "DOUBLE"
    assert ft_calib["calibration.gripper_com_pose"][0] == "DOUBLE_ARRAY"
    assert ft_calib["calibration.gripper_com_frame_id"] == ("STRING", "flange")


@pytest.mark.parametrize("housing", [False, True])
def test_ros_files_hold_the_same_body_at_the_flange(housing: bool, tmp_path: Path) -> None:
    tool = a_mounted_tool(housing=housing)
    files = as_documents(tool, tmp_path)
    mass = sum(part[0] for part in stated(tool))
    center = sum(part[0] * part[1] for part in stated(tool)) / mass
    simple, ft = files["ft_tools.yaml"], files["force_torque_tools.yaml"]
    assert ft["gripper_com_frame_id"] == "flange"
    for found in (simple["sensor_frame_to_com"], ft["gripper_com_pose"][:3]):
        np.testing.assert_allclose(found, center, rtol=1e-9)
    assert simple["mass"] == ft["gripper_mass"] == pytest.approx(mass)
    assert ft["bias"] == pytest.approx(tool.offset.tolist())
    text = (tmp_path / "tool_ros" / "ft_tools.yaml").read_text()
    assert ("does not feel its housing" in text) == housing


def test_nothing_is_left_of_weight_and_offset_at_the_flange(
    tmp_path: Path,
) -> None:
    """A reading at rest, moved to the flange by SciPy, less what ft_tools says."""
    tool = a_mounted_tool(housing=False)
    found = as_documents(tool, tmp_path)["ft_tools.yaml"]
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


@pytest.mark.parametrize("n", [6, 8])
def test_an_offset_in_units_of_its_own_is_not_written_as_newtons(n: int, tmp_path: Path) -> None:
    gain = np.vstack([np.diag([100.0, 100.0, 100.0, 1e3, 1e3, 1e3]), np.ones((2, 6))])[:n]
    sensor = {"channels": list("abcdefgh")[:n], "noise": [50.0] * n, "nominal_gain": gain.tolist()}
    tool = replace(
        a_mounted_tool(housing=False), gain=gain, offset=np.full(n, 4e3), rig=tool_rig(a_rig(sensor=sensor))
    )
    assert set(written(tool, tmp_path)) == {"admittance_controller.yaml", "gravity_compensation_filter.yaml"}
    reasons = left_out(tool, ["ros"])
    assert set(reasons) == {"tool_ros/ft_tools.yaml", "tool_ros/force_torque_tools.yaml"}
    assert all("N and N m" in reason for reason in reasons.values())
    assert left_out(tool, ["ur"]) == left_out(a_mounted_tool(), ["ros"]) == {}


def test_without_a_flange_ros_files_are_in_the_sensors_frame(tmp_path: Path) -> None:
    tool = replace(a_mounted_tool(housing=False), flange=np.zeros(6))
    files = as_documents(tool, tmp_path)
    gravity = files["admittance_controller.yaml"]["admittance_controller"]["ros__parameters"]
    assert (
        gravity["gravity_compensation"]["frame"]["id"] == gravity["ft_sensor"]["frame"]["id"] == "ft_sensor"
    )
    assert files["ft_tools.yaml"]["sensor_frame_to_com"] == pytest.approx(tool.center_of_mass.tolist())
    assert files["ft_tools.yaml"]["torque_offset"] == pytest.approx(tool.offset[3:].tolist())
