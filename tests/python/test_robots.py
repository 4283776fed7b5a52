"""The packaged arms are those of the publications that their files cite."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from truewrench import robots
from truewrench.model.errors import InputError
from truewrench.model.rig import load_rig
from truewrench.robot.arm import Robot, load_robot, robot_of

Array = NDArray[np.float64]

ARMS = ("ssrms", "spdm", "panda", "ur10", "fr3", "ur3e", "ur5e", "ur10e")
DEGREES = np.pi / 180


def urdf(name: str) -> Path:
    return Path(robots.__file__).with_name(f"{name}.urdf")


def arm(name: str) -> Robot:
    return load_robot(urdf(name), "ft")


def turned(axis: str, angle: float) -> Array:
    """A rotation about x, y or z, as a 4 x 4 matrix."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T = np.eye(4)
    T[i, i] = T[j, j] = np.cos(angle)
    T[j, i], T[i, j] = np.sin(angle), -np.sin(angle)
    return T


def moved(x: float, y: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def panda(q: Array) -> Array:
    """Denavit-Hartenberg, Craig's convention: (a, d, alpha) of the manufacturer's table, the flange last."""
    quarter = np.pi / 2
    table = [(0, 0.333, 0), (0, 0, -quarter), (0, 0.316, quarter), (0.0825, 0, quarter)]
    table += [(-0.0825, 0.384, -quarter), (0, 0, quarter), (0.088, 0, quarter), (0, 0.107, 0)]
    T = np.eye(4)
    for (a, d, alpha), theta in zip(table, [*q, 0.0], strict=True):
        T = T @ turned("x", alpha) @ moved(a, 0, 0) @ turned("z", theta) @ moved(0, 0, d)
    return T


def ur10(q: Array) -> Array:
    """Denavit-Hartenberg, standard convention: (a, d, alpha) of the manufacturer's table."""
    quarter = np.pi / 2
    table = [(0, 0.1273, quarter), (-0.612, 0, 0), (-0.5723, 0, 0)]
    table += [(0, 0.163941, quarter), (0, 0.1157, -quarter), (0, 0.0922, 0)]
    T = np.eye(4)
    for (a, d, alpha), theta in zip(table, q, strict=True):
        T = T @ turned("z", theta) @ moved(0, 0, d) @ moved(a, 0, 0) @ turned("x", alpha)
    return T


def ssrms(q: Array) -> Array:
    """Roll, yaw, pitch; pitch; pitch, yaw, roll, with the offsets of Nguyen and Hughes between them."""
    T = moved(1.3589, 0, 0) @ turned("x", q[0]) @ moved(0, 0, 0.7026) @ turned("z", q[1])
    T = T @ moved(0, -0.5692, 0) @ turned("y", q[2]) @ moved(7.11, -0.475, 0) @ turned("y", q[3])
    T = T @ moved(7.11, 0, 0) @ turned("y", q[4]) @ moved(0, -0.5692, 0) @ turned("z", q[5])
    return T @ moved(0, 0, -0.7026) @ turned("x", q[6]) @ moved(1.3589, 0, 0)


@pytest.mark.parametrize("product", [panda, ur10, ssrms], ids=lambda f: f.__name__)
def test_pose_is_that_of_the_published_parameters(product: object) -> None:
    assert callable(product)
    robot = arm(product.__name__)
    for q in np.random.default_rng(0).uniform(-3, 3, size=(20, robot.n)):
        R_root_sensor, p_root_sensor = robot.pose(q)
        T = product(q)
        np.testing.assert_allclose(R_root_sensor[0], T[:3, :3], atol=1e-12)
        np.testing.assert_allclose(p_root_sensor[0], T[:3, 3], atol=1e-11)


def test_stretched_arms_reach_as_far_as_published() -> None:
    _, ssrms_tip = arm("ssrms").pose(np.zeros(7))
    assert ssrms_tip[0, 0] == pytest.approx(2 * (1.3589 + 7.11))
    assert np.linalg.norm(ssrms_tip[0]) == pytest.approx(17.0, abs=0.1)
    _, spdm_tip = arm("spdm").pose(np.zeros(7))
    np.testing.assert_allclose(spdm_tip[0], [3.35, 0, 0], atol=1e-12)
    _, ur10_tip = arm("ur10").pose(np.array([0, 0, 0, -np.pi / 2, 0, 0]))  # the wrist stretched along the arm
    assert abs(ur10_tip[0, 0]) == pytest.approx(1.3, abs=1e-3)
    franka = arm("panda")

    def shortness(q: Array) -> float:
        return -float(np.linalg.norm(franka.pose(q)[1][0] - [0, 0, 0.333]))  # from the shoulder

    middle, limits = (franka.lower + franka.upper) / 2, list(zip(franka.lower, franka.upper, strict=True))
    assert -minimize(shortness, middle, bounds=limits).fun == pytest.approx(0.855, abs=5e-3)


def test_joint_limits_are_the_published_ones() -> None:
    for name in ("ssrms", "spdm"):
        robot = arm(name)
        assert robot.joints == ("SR", "SY", "SP", "EP", "WP", "WY", "WR")
        np.testing.assert_allclose(robot.upper, 270 * DEGREES)
        np.testing.assert_allclose(robot.lower, -270 * DEGREES)
        np.testing.assert_allclose(robot.velocity, 4 * DEGREES)
    franka = arm("panda")
    np.testing.assert_array_equal(
        franka.lower, [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    )
    np.testing.assert_array_equal(franka.upper, [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
    np.testing.assert_array_equal(franka.velocity, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_array_equal(franka.effort, [87] * 4 + [12] * 3)
    research = arm("fr3")
    np.testing.assert_array_equal(research.upper, [2.3093, 1.5133, 2.4937, -0.4461, 2.48, 4.2094, 2.6895])
    np.testing.assert_array_equal(
        research.lower, [-2.3093, -1.5133, -2.4937, -2.7478, -2.48, 0.8521, -2.6895]
    )
    np.testing.assert_array_equal(research.velocity, [2, 1, 1.5, 1.25, 3, 1.5, 3])
    np.testing.assert_array_equal(research.effort, [87] * 4 + [12] * 3)
    for name, speed, effort in (
        ("ur3e", [180, 180, 180, 360, 360, 360], [54, 54, 28, 9, 9, 9]),
        ("ur5e", [180] * 6, [150, 150, 150, 28, 28, 28]),
        ("ur10e", [120, 120, 180, 180, 180, 180], [330, 330, 150, 54, 54, 54]),
    ):
        endless = np.inf if name == "ur3e" else 360
        np.testing.assert_allclose(arm(name).upper, np.array([360, 360, 180, 360, 360, endless]) * DEGREES)
        np.testing.assert_array_equal(arm(name).lower, -arm(name).upper)
        np.testing.assert_allclose(arm(name).velocity, np.array(speed) * DEGREES)
        np.testing.assert_array_equal(arm(name).effort, effort)
    universal = arm("ur10")
    np.testing.assert_allclose(universal.upper, np.array([360, 360, 180, 360, 360, 360]) * DEGREES)
    np.testing.assert_allclose(universal.velocity, np.array([120, 120, 180, 180, 180, 180]) * DEGREES)


def test_centres_of_mass_of_the_ur10_are_those_of_the_table() -> None:
    """In Denavit-Hartenberg frames: the whole arm's centre of mass at random postures."""
    table = [(7.1, (0.021, 0, 0.027)), (12.7, (0.38, 0, 0.158)), (4.27, (0.24, 0, 0.068))]
    table += [(2, (0, 0.007, 0.018)), (2, (0, 0.007, 0.018)), (0.365, (0, 0, -0.026))]
    import pinocchio as pin

    robot, quarter = arm("ur10"), np.pi / 2
    dh = [(0, 0.1273, quarter), (-0.612, 0, 0), (-0.5723, 0, 0)]
    dh += [(0, 0.163941, quarter), (0, 0.1157, -quarter), (0, 0.0922, 0)]
    data = robot.model.createData()
    for q in np.random.default_rng(1).uniform(-3, 3, size=(5, 6)):
        T, moment, mass = np.eye(4), np.zeros(3), 0.0
        for (a, d, alpha), theta, (m, c) in zip(dh, q, table, strict=True):
            T = T @ turned("z", theta) @ moved(0, 0, d) @ moved(a, 0, 0) @ turned("x", alpha)
            moment += m * (T @ [*c, 1.0])[:3]
            mass += m
        np.testing.assert_allclose(pin.centerOfMass(robot.model, data, q), moment / mass, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_mujoco_accepts_every_link_as_a_real_body(name: str) -> None:
    text = urdf(name).read_text()
    assert "mesh" not in text
    model = mujoco.MjModel.from_xml_string(text)  # refuses inertias that break the triangle inequality
    assert model.nq == arm(name).n


@pytest.mark.parametrize("name", robots.NAMES)
def test_rig_of_a_packaged_arm_is_consistent_with_it(name: str) -> None:
    rig = load_rig(robots.path(name))
    robot = robot_of(rig)
    assert rig.in_gravity == name.endswith("_ground")
    assert bool(np.any(rig.sensor.offset_prior_array)) == rig.in_gravity
    assert rig.motion.noise is not None
    assert rig.motion.position_noise is not None
    q = np.array(rig.motion.initial_position)
    assert ((robot.lower < q) & (q < robot.upper)).all()
    assert np.linalg.svd(robot.jacobian(q)[0], compute_uv=False)[5] > 0.1  # all six directions at hand
    assert rig.limits.velocity is not None
    assert (np.array(rig.limits.velocity) <= robot.velocity).all()
    if rig.limits.workspace is not None:
        low, high = np.array(rig.limits.workspace).T
        tip = robot.pose(q)[1][0]
        assert ((low < tip) & (tip < high)).all()


def test_space_arms_carry_the_payload_of_the_paper() -> None:
    for name in ("ssrms", "spdm"):
        payload = load_rig(robots.path(name)).payloads["default"]
        assert payload.mass == 50
        np.testing.assert_array_equal(payload.center_of_mass_array, [0.2, 0, 0])
        np.testing.assert_array_equal(payload.inertia_matrix, np.diag([1.5, 1.5, 0.4]))


def test_an_arm_that_is_not_packaged_names_the_nearest() -> None:
    with pytest.raises(InputError, match=r"`pandas` \(nearest: `panda`\)"):
        robots.path("pandas")


def test_arms_are_part_of_what_is_installed() -> None:
    here = Path(robots.__file__).parent
    assert {path.stem for path in here.glob("*.yaml")} == set(robots.NAMES + robots.TOOL_RIGS)
    assert {path.stem for path in here.glob("*.urdf")} == set(ARMS)


def test_arms_are_at_hand_after_the_package_alone_is_imported() -> None:
    code = "import truewrench as tw; print(tw.robots.path('panda').name)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "panda.yaml", done.stderr
