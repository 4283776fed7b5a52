"""Pose, twist and acceleration of the sensor frame are those of the arm in the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truewrench.model.errors import InputError, UnsupportedError
from truewrench.robot.arm import BaseMotion, Robot, load_robot, rotation_of
from truewrench.robot.base_path import BasePath
from truewrench.robot.chain import chain_of, sensor_motion

Array = NDArray[np.float64]

REST = BasePath(None, None, ())

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><mass value="2"/><origin xyz="0.1 0 0"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://nowhere/upper.stl"/></geometry></visual></link>
  <link name="slide"/><link name="wrist"/><link name="ft"/><link name="finger"/><link name="camera"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.4" rpy="0.1 0.2 0.3"/><axis xyz="0 0 1"/></joint>
  <joint name="pan" type="revolute"><parent link="base"/><child link="camera"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="extend" type="prismatic"><parent link="upper"/><child link="slide"/>
    <origin xyz="1 0 0" rpy="0.3 0.2 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" velocity="3" effort="4"/></joint>
  <joint name="roll" type="revolute"><parent link="slide"/><child link="wrist"/>
    <origin xyz="0.2 0.1 0"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-2" upper="2" velocity="5" effort="6"/></joint>
  <joint name="mount" type="fixed"><parent link="wrist"/><child link="ft"/>
    <origin xyz="0 0.2 0.1" rpy="0 0 1"/></joint>
  <joint name="grip" type="prismatic"><parent link="ft"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="1" velocity="2" effort="3"/></joint>
</robot>
"""


@pytest.fixture
def arm_of(tmp_path: Path) -> Callable[[str], Path]:
    """Write a URDF."""

    def write(text: str) -> Path:
        path = tmp_path / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def arm(arm_of: Callable[[str], Path]) -> Robot:
    """An arm with a continuous, a prismatic and a skew revolute joint, a camera and a gripper beside them."""
    return load_robot(arm_of(ARM), "ft")


def states(robot: Robot, rows: int = 5) -> tuple[Array, Array, Array]:
    q, qd, qdd = np.random.default_rng(1).uniform(-1.5, 1.5, size=(3, rows, robot.n))
    return q, qd, qdd


def test_only_the_joints_between_root_and_sensor_count(arm: Robot) -> None:
    assert arm.joints == ("turn", "extend", "roll")
    np.testing.assert_array_equal(arm.lower, [-np.inf, -1, -2])
    np.testing.assert_array_equal(arm.upper, [np.inf, 2, 2])
    np.testing.assert_array_equal(arm.velocity, [np.inf, 3, 5])
    np.testing.assert_array_equal(arm.effort, [np.inf, 4, 6])
    assert arm.model.nq == arm.model.nv == arm.n == 3


@pytest.mark.parametrize(
    ("joint", "link"), [("mount", "ft"), ("roll", "wrist"), ("pan", "camera"), ("grip", "slide")]
)
def test_joints_may_have_the_names_of_links(
    arm: Robot, arm_of: Callable[[str], Path], joint: str, link: str
) -> None:
    other = load_robot(arm_of(ARM.replace(f'joint name="{joint}"', f'joint name="{link}"')), "ft")
    q, qd, qdd = states(arm)
    np.testing.assert_array_equal(other.motion(q, qd, qdd).twist, arm.motion(q, qd, qdd).twist)
    np.testing.assert_array_equal(other.pose(q)[1], arm.pose(q)[1])


def test_pose_is_the_product_of_the_joints_transforms(arm: Robot) -> None:
    def placed(xyz: list[float], rpy: list[float]) -> Array:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
        return T

    q, _, _ = states(arm)
    R_root_sensor, p_root_sensor = arm.pose(q)
    for k, (turn, extend, roll) in enumerate(q):
        T = placed([0, 0, 0.4], [0.1, 0.2, 0.3]) @ placed([0, 0, 0], [0, 0, turn])
        T = T @ placed([1, 0, 0], [0.3, 0.2, 0.1]) @ placed([0, extend, 0], [0, 0, 0])
        T = T @ placed([0.2, 0.1, 0], [0, 0, 0])
        rolled = np.eye(4)
        rolled[:3, :3] = Rotation.from_rotvec(roll * np.array([0.6, 0, 0.8])).as_matrix()
        T = T @ rolled @ placed([0, 0.2, 0.1], [0, 0, 1])
        np.testing.assert_allclose(R_root_sensor[k], T[:3, :3], atol=1e-14)
        np.testing.assert_allclose(p_root_sensor[k], T[:3, 3], atol=1e-14)


def test_twist_is_the_derivative_of_the_pose_in_sensor_axes(arm: Robot) -> None:
    q, qd, qdd = states(arm)
    h = 1e-6
    (R1, p1), (R2, p2) = arm.pose(q - h * qd), arm.pose(q + h * qd)
    R, _ = arm.pose(q)
    v = np.einsum("kji,kj->ki", R, (p2 - p1) / (2 * h))
    turning = np.einsum("kji,kjl->kil", R, (R2 - R1) / (2 * h))
    omega = np.column_stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]])
    twist = np.einsum("kij,kj->ki", arm.jacobian(q), qd)
    np.testing.assert_allclose(twist, np.column_stack([v, omega]), atol=1e-9)
    np.testing.assert_allclose(arm.motion(q, qd, qdd).twist, twist, atol=1e-14)


def test_jacobian_rate_is_the_derivative_of_every_component(arm: Robot) -> None:
    q, qd, qdd = states(arm)
    h = 1e-5
    difference = (arm.jacobian(q + h * qd) - arm.jacobian(q - h * qd)) / (2 * h)
    rate = sensor_motion(chain_of(arm), REST, np.zeros(len(q)), q, qd).jacobian_rate
    np.testing.assert_allclose(rate, difference, atol=1e-9)
    acceleration = np.einsum("kij,kj->ki", arm.jacobian(q), qdd) + np.einsum("kij,kj->ki", rate, qd)
    np.testing.assert_allclose(arm.motion(q, qd, qdd).acceleration, acceleration, atol=1e-13)


def test_a_base_that_moves_carries_the_sensor(arm: Robot) -> None:
    rng = np.random.default_rng(2)
    q, qd, qdd = states(arm, 1)
    nu, a = rng.normal(size=(2, 6))
    h = 1e-4

    def sensor(t: float) -> tuple[Array, Array]:
        """Pose of the sensor while the base's twist is nu + a t, to third order in t."""
        R_base, p_base, steps = np.eye(3), np.zeros(3), 40
        for i in range(steps):
            middle = nu + a * t * (i + 0.5) / steps
            dt = t / steps
            half = Rotation.from_rotvec(middle[3:] * dt / 2).as_matrix()
            p_base = p_base + R_base @ half @ middle[:3] * dt
            R_base = R_base @ Rotation.from_rotvec(middle[3:] * dt).as_matrix()
        R, p = arm.pose(q + qd * t + qdd * t**2 / 2)
        return R_base @ R[0], p_base + R_base @ p[0]

    def twist(t: float) -> Array:
        (R1, p1), (R, _), (R2, p2) = sensor(t - h), sensor(t), sensor(t + h)
        turning = R.T @ (R2 - R1) / (2 * h)
        return np.array([*(R.T @ (p2 - p1) / (2 * h)), turning[2, 1], turning[0, 2], turning[1, 0]])

    motion = arm.motion(q, qd, qdd, BaseMotion(nu[None], a[None]))
    np.testing.assert_allclose(motion.twist[0], twist(0.0), atol=1e-6)
    np.testing.assert_allclose(motion.acceleration[0], (twist(1e-3) - twist(-1e-3)) / 2e-3, atol=1e-4)


def test_attitude_quaternion_turns_base_axes_into_inertial_ones() -> None:
    turned = Rotation.random(7, rng=3)
    quaternions = turned.as_quat(scalar_first=True) * np.array([[1.7]])
    np.testing.assert_allclose(rotation_of(quaternions), turned.as_matrix(), atol=1e-14)


def test_meshes_are_never_looked_for_and_nothing_is_printed(
    arm_of: Callable[[str], Path], capfd: pytest.CaptureFixture[str]
) -> None:
    load_robot(arm_of(ARM), "ft")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("</robot>", "", ["arm.urdf:", "XML"]),
        ("<robot name", "<body name", ["XML"]),
        ('name="ft"', 'name="fx"', ["joint `mount`", "`ft`", "nearest: `fx`"]),
        ('<limit lower="-1" upper="2" velocity="3" effort="4"/>', "", ["joint `extend`", "limits of a"]),
        ('<parent link="upper"/>', "", ["joint `extend`", "no parent link"]),
        ('child link="wrist"', 'child link="upper"', ["joint `roll`", "parent of the link `upper`"]),
        ('parent link="base"', 'parent link="finger"', ["link `upper`", "a loop", "one tree of links"]),
        ('name="pan"', 'name="turn"', ["joint `turn`", "a second one of this name"]),
        ('type="prismatic"', 'type="hinge"', ["joint `extend`: type", "`hinge`", "revolute, continuous"]),
        ('type="prismatic"', "", ["joint `extend`: type", "`None`", "revolute, continuous"]),
        ('lower="-2"', 'lower="a"', ["joint `roll`: <limit>", 'lower="a"', "a finite number"]),
        ('lower="-2"', 'lower="nan"', ["joint `roll`: <limit>", 'lower="nan"', "a finite number"]),
        ('lower="-2"', 'lower="2.5"', ["joint `roll`: <limit>", "lower 2.5 above upper 2", "lower <= upper"]),
        (' velocity="5"', "", ["joint `roll`: <limit>", "no velocity", "a finite number"]),
        ('effort="6"', "", ["joint `roll`: <limit>", "no effort", "a finite number"]),
        ('velocity="5"', 'velocity="-5"', ["joint `roll`: <limit> velocity", "-5", "0 or more"]),
        ('xyz="0.6 0 0.8"', 'xyz="0.6 0.8"', ["joint `roll`: <axis>", 'xyz="0.6 0.8"', "three numbers"]),
        ('xyz="0.6 0 0.8"', 'xyz="0 0 0"', ["joint `roll`: <axis>", "a length of 0", "a direction"]),
        ('xyz="0.6 0 0.8"', "", ["joint `roll`: <axis>", "no xyz", "three numbers"]),
        ('mass value="2"', 'mass value="-2"', ["link `upper`: <mass>", "-2", "0 kg or more"]),
        ('mass value="2"', 'mass value="2,5"', ["link `upper`: <mass>", 'value="2,5"', "a finite number"]),
    ],
)  # fmt: skip
def test_faults_of_a_urdf_are_named_and_nothing_else_is_said(
    arm_of: Callable[[str], Path],
    capfd: pytest.CaptureFixture[str],
    old: str,
    new: str,
    words: list[str],
) -> None:
    assert old in ARM
    with pytest.raises(InputError, match=r"arm\.urdf") as caught:
        load_robot(arm_of(ARM.replace(old, new)), "ft")
    for word in words:
        assert word in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_what_pinocchio_alone_refuses_is_not_called_a_fault_of_the_tree(
    arm_of: Callable[[str], Path],
) -> None:
    path = arm_of(ARM.replace('<robot name="arm"', "<robot"))
    with pytest.raises(InputError, match=r"arm\.urdf: found a robot that Pinocchio cannot .*check_urdf"):
        load_robot(path, "ft")


def test_what_urdf_lets_be_absent_may_be(arm_of: Callable[[str], Path]) -> None:
    """Limits of position are 0 and the axis is x; a fixed joint may have an axis that is none."""
    text = ARM.replace('<axis xyz="0.6 0 0.8"/>', "").replace('lower="-2" ', "")
    text = text.replace('rpy="0 0 1"/></joint>', 'rpy="0 0 1"/><axis xyz="0 0 0"/></joint>')
    robot = load_robot(arm_of(text), "ft")
    assert (robot.lower[2], robot.upper[2]) == (0.0, 2.0)
    assert robot.model.joints[3].shortname() == "JointModelRX"


def test_a_frame_that_is_missing_names_the_nearest(arm_of: Callable[[str], Path]) -> None:
    with pytest.raises(InputError, match=r"arm\.urdf.*no frame `wrst`.*nearest: `wrist`"):
        load_robot(arm_of(ARM), "wrst")
    with pytest.raises(InputError, match=r"frame `base`.*no joint that moves it"):
        load_robot(arm_of(ARM), "base")
    with pytest.raises(InputError, match=r"nowhere\.urdf: cannot be read"):
        load_robot(Path("nowhere.urdf"), "ft")


def test_joints_with_several_coordinates_are_refused(arm_of: Callable[[str], Path]) -> None:
    planar = ARM.replace('name="turn" type="continuous"', 'name="turn" type="planar"')
    with pytest.raises(UnsupportedError, match=r"joint `turn`.*revolute, continuous or prismatic"):
        load_robot(arm_of(planar), "ft")


def test_xacro_is_told_to_be_expanded(arm_of: Callable[[str], Path]) -> None:
    with pytest.raises(InputError, match="expand it first"):
        load_robot(arm_of('<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/></robot>'), "ft")
