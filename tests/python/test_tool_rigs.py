"""Packaged rigs of arms whose tool nobody knows: from plan to tool by the commands, truth by MuJoCo."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray
from scipy.stats import chi2

from truewrench import robots
from truewrench.cli import main
from truewrench.model.rig import load_rig
from truewrench.model.rig.tool_rig import load_tool_rig
from truewrench.robot.arm import robot_of
from truewrench.tool.reading import read_tool

Array = NDArray[np.float64]

# of ordinary grippers, one per arm: mass, centre of mass, inertia about it
GRIPPERS: dict[str, dict[str, Any]] = {
    "panda_tool": {
        "mass": 0.92,
        "center_of_mass": [0.003, -0.004, 0.061],
        "inertia": {"xx": 0.0021, "yy": 0.0018, "zz": 0.0009, "xy": 0.0001, "xz": 0.0, "yz": -0.0001},
    },
    "fr3_tool": {
        "mass": 0.74,
        "center_of_mass": [-0.002, 0.005, 0.047],
        "inertia": {"xx": 0.0014, "yy": 0.0016, "zz": 0.0008, "xy": 0.0, "xz": 0.0001, "yz": 0.0},
    },
    "ur3e_tool": {
        "mass": 0.96,
        "center_of_mass": [0.004, 0.002, 0.056],
        "inertia": {"xx": 0.0019, "yy": 0.0022, "zz": 0.0011, "xy": 0.0001, "xz": 0.0, "yz": 0.0001},
    },
    "ur5e_tool": {
        "mass": 1.41,
        "center_of_mass": [0.009, -0.006, 0.072],
        "inertia": {"xx": 0.0046, "yy": 0.0041, "zz": 0.0021, "xy": 0.0, "xz": -0.0002, "yz": 0.0002},
    },
    "ur10e_tool": {
        "mass": 3.1,
        "center_of_mass": [0.015, 0.011, 0.104],
        "inertia": {"xx": 0.019, "yy": 0.021, "zz": 0.008, "xy": -0.0005, "xz": 0.0007, "yz": 0.0},
    },
    "ur10_tool": {
        "mass": 2.6,
        "center_of_mass": [-0.012, 0.02, 0.11],
        "inertia": {"xx": 0.016, "yy": 0.014, "zz": 0.006, "xy": 0.0, "xz": 0.0008, "yz": -0.0006},
    },
}


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


WITH_PAYLOAD = tuple(name for name in robots.TOOL_RIGS if name.replace("_tool", "_ground") in robots.NAMES)

HALF = np.pi / 2

# (a, d, alpha) of the manufacturers' tables: Franka's in Craig's convention with the flange last, Universal
# Robots' in the standard one, and there masses and centres of mass in the frame of the same row
FRANKA = [(0, 0.333, 0), (0, 0, -HALF), (0, 0.316, HALF), (0.0825, 0, HALF), (-0.0825, 0.384, -HALF)]
FRANKA += [(0, 0, HALF), (0.088, 0, HALF), (0, 0.107, 0)]
UNIVERSAL: dict[str, list[tuple[float, float, float]]] = {
    "ur3e_tool": [
        (0, 0.15185, HALF), (-0.24355, 0, 0), (-0.2132, 0, 0),
        (0, 0.13105, HALF), (0, 0.08535, -HALF), (0, 0.0921, 0),
    ],
    "ur5e_tool": [
        (0, 0.1625, HALF), (-0.425, 0, 0), (-0.3922, 0, 0),
        (0, 0.1333, HALF), (0, 0.0997, -HALF), (0, 0.0996, 0),
    ],
    "ur10e_tool": [
        (0, 0.1807, HALF), (-0.6127, 0, 0), (-0.57155, 0, 0),
        (0, 0.17415, HALF), (0, 0.11985, -HALF), (0, 0.11655, 0),
    ],
}  # fmt: skip
BODIES: dict[str, list[tuple[float, tuple[float, float, float]]]] = {
    "ur3e_tool": [
        (1.98, (0, -0.02, 0)), (3.4445, (0.13, 0, 0.1157)), (1.437, (0.05, 0, 0.0238)),
        (0.871, (0, 0, 0.01)), (0.805, (0, 0, 0.01)), (0.261, (0, 0, -0.02)),
    ],
    "ur5e_tool": [
        (3.761, (0, -0.02561, 0.00193)), (8.058, (0.2125, 0, 0.11336)), (2.846, (0.15, 0, 0.0265)),
        (1.37, (0, -0.0018, 0.01634)), (1.3, (0, 0.0018, 0.01634)), (0.365, (0, 0, -0.001159)),
    ],
    "ur10e_tool": [
        (7.369, (0.021, 0, 0.027)), (13.051, (0.38, 0, 0.158)), (3.989, (0.24, 0, 0.068)),
        (2.1, (0, 0.007, 0.018)), (1.98, (0, 0.007, 0.018)), (0.615, (0, 0, -0.026)),
    ],
}  # fmt: skip


def frames(name: str, q: Array) -> list[Array]:
    """Poses of the Denavit-Hartenberg frames in the base, the flange's last."""
    poses, T = [], np.eye(4)
    if name == "fr3_tool":
        for (a, d, alpha), theta in zip(FRANKA, [*q, 0.0], strict=True):
            c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
            rows = [[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]]
            T = T @ np.array(rows)
            poses.append(T)
        return poses
    for (a, d, alpha), theta in zip(UNIVERSAL[name], q, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        T = T @ np.array(rows)
        poses.append(T)
    return poses


def model_of(name: str) -> pin.Model:
    return pin.buildModelFromUrdf(str(robots.path(name).with_name(f"{name.removesuffix('_tool')}.urdf")))


@pytest.mark.parametrize("name", ["fr3_tool", *UNIVERSAL])
def test_flange_is_where_the_published_parameters_put_it(name: str) -> None:
    model = model_of(name)
    data, sensor = model.createData(), model.getFrameId("ft")
    for q in np.random.default_rng(5).uniform(-np.pi, np.pi, size=(20, model.nv)):
        pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), q))
        np.testing.assert_allclose(data.oMf[sensor].homogeneous, frames(name, q)[-1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", UNIVERSAL)
def test_masses_lie_where_the_published_table_puts_them(name: str) -> None:
    model = model_of(name)
    data, mass = model.createData(), sum(m for m, _ in BODIES[name])
    for q in np.random.default_rng(6).uniform(-np.pi, np.pi, size=(5, 6)):
        moment = sum(m * (T @ [*c, 1.0])[:3] for T, (m, c) in zip(frames(name, q), BODIES[name], strict=True))
        found = pin.centerOfMass(model, data, pin.integrate(model, pin.neutral(model), q))
        np.testing.assert_allclose(found, moment / mass, rtol=0, atol=1e-12)
    assert pin.computeTotalMass(model) == pytest.approx(mass)


def test_every_arm_in_the_laboratory_has_one() -> None:
    assert {
        f"{name.removesuffix('_ground')}_tool" for name in robots.NAMES if name.endswith("_ground")
    } == set(WITH_PAYLOAD)


@pytest.mark.parametrize("name", WITH_PAYLOAD)
def test_it_is_the_arm_in_the_laboratory_without_a_payload(name: str) -> None:
    rig, ground = load_tool_rig(robots.path(name)), load_rig(robots.path(name.replace("_tool", "_ground")))
    for key in ("gravity", "limits", "motion"):
        assert getattr(rig, key) == getattr(ground, key)
    assert rig.sensor.range_array.tolist() == ground.sensor.range_array.tolist()


@pytest.mark.parametrize("name", robots.TOOL_RIGS)
def test_it_is_consistent_with_its_arm(name: str) -> None:
    text = robots.path(name).read_text()
    assert "payloads" not in yaml.safe_load(text)
    assert all(name in line or "truewrench" not in line for line in text.splitlines())
    rig = load_tool_rig(robots.path(name))
    robot = robot_of(rig)
    assert rig.sensor.gain_prior == 0.02
    q, velocity = np.array(rig.motion.initial_position), np.array(rig.limits.velocity)
    assert ((robot.lower < q) & (q < robot.upper)).all()
    np.testing.assert_allclose(velocity, robot.velocity / 2, rtol=1e-3)
    assert rig.limits.workspace is not None
    low, high = np.array(rig.limits.workspace).T
    R_root_sensor, p_root_sensor = robot.pose(q)
    assert ((low < p_root_sensor[0]) & (p_root_sensor[0] < high)).all()
    assert R_root_sensor[0, 2, 2] < -0.99  # the flange looks down


@pytest.mark.parametrize("name", robots.TOOL_RIGS)
def test_poses_can_be_planned_as_it_stands(name: str, tmp_path: Path) -> None:
    plan = tmp_path / "poses.csv"
    assert run("plan", robots.path(name), "--tool", "--no-pictures", "-o", plan) == 0
    told = yaml.safe_load(plan.with_suffix(".csv.plan.yaml").read_text())
    assert told["feasible"]
    assert len(told["poses"]) >= 8
    determined = told["predicted"]["determined"]
    assert determined["mass"]
    assert all(determined["center_of_mass"])
    assert told["predicted"]["mass_std"] < 0.02 * told["expected"]["mass"]


OFTEN = ("fr3_tool", "ur5e_tool")  # one of each maker; `make test-benchmarks` has the others


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=() if x in OFTEN else pytest.mark.campaign) for x in robots.TOOL_RIGS]
)
def test_planned_poses_find_the_tool_that_the_arm_carries(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    source = robots.path(name)
    shutil.copy(source, rig)
    settings = yaml.safe_load(source.read_text())
    urdf = settings["motion"]["robot"]["urdf"]
    shutil.copy(source.with_name(urdf), tmp_path / urdf)
    real = tmp_path / "real.yaml"  # what moves in place of an arm, with its gripper
    real.write_text(yaml.safe_dump(settings | {"payloads": {"gripper": GRIPPERS[name]}}))
    plan, log, out = tmp_path / "plan.csv", tmp_path / "poses.csv", tmp_path / "out"
    assert run("plan", rig, "--tool", "--poses", "8", "--dwell", "2", "--no-pictures", "-o", plan) == 0
    assert run("simulate", real, plan, "--seed", "3", "-o", log) == 0
    capsys.readouterr()
    assert run("tool", rig, log, "-o", out, "--json") == 0
    assert json.loads(capsys.readouterr().out)["verdict"]["usable"]
    tool, truth = read_tool(out / "tool.yaml"), yaml.safe_load(log.with_suffix(".csv.truth.yaml").read_text())
    body = truth["payloads"]["gripper"]
    assert tool.mass_std < 0.02 * body["mass"]
    scale = load_tool_rig(source).sensor.range_array
    feigned = 0.02 * scale[3] / scale[0]  # what a force may feign of a moment, as the gains are believed
    assert (tool.center_of_mass_std < max(4e-3, feigned)).all()
    place = np.r_[tool.layout.log_mass, tool.layout.center_of_mass]
    error = tool.theta[place] - [np.log(body["mass"]), *body["center_of_mass"]]
    P = tool.covariance[np.ix_(place, place)]
    assert error @ np.linalg.solve(P, error) < chi2.ppf(0.999, 4)
    for key, (true, found, sigma) in {
        "offset": (np.array(truth["offset"]), tool.offset, tool.offset_std),
        "gain": (np.array(truth["gain"]), tool.gain, tool.gain_std),
    }.items():
        assert (np.abs(found - true) < 4.0 * sigma).all(), key
