"""An arm's kinematics and dynamics as CasADi expressions, from the joints of its Pinocchio model."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from truewrench.model.arrays import Array
from truewrench.planning.symbolic import at_point, force_to_move
from truewrench.robot.arm import Robot


@dataclass(frozen=True, slots=True, eq=False)
class ArmExpressions:
    """What joint positions, velocities and accelerations make of the arm."""

    twist: Any  # of the sensor's origin (6,), sensor axes
    acceleration: Any  # its component-wise derivative (6,)
    R_root_sensor: Any  # (3, 3)
    p_root_sensor: Any  # (3,)
    origins: tuple[Any, ...]  # of every joint in the root (3,), root first
    torque: Any  # (n,) of the joints, None where the links have no inertia


def has_link_inertias(robot: Robot) -> bool:
    """Whether every moving link has a mass."""
    return all(robot.model.inertias[i].mass > 0.0 for i in range(1, robot.n + 1))


def unchecked_torques(robot: Robot) -> tuple[str, ...]:
    """What is worth saying of an arm whose torques are limited, and cannot be told."""
    without = [robot.joints[i - 1] for i in range(1, robot.n + 1) if not robot.model.inertias[i].mass > 0.0]
    if not without or not np.isfinite(robot.effort).any():
        return ()
    links = ", ".join(f"`{joint}`" for joint in without[:3]) + (", ..." if len(without) > 3 else "")
    return (f"torques are not looked at, which the URDF limits: it has no mass for what {links} moves",)


def arm_expressions(
    robot: Robot, q: Any, qd: Any, qdd: Any, gravity: Array, payload: tuple[float, Array, Array]
) -> ArmExpressions:
    """Recursion along the chain, every link in its own axes; gravity (3,) is in the root.

    The payload is mass, centre of mass from the sensor, inertia about it.
    """
    model, axes = robot.model, _axes(robot)
    rotation, place = ca.DM.eye(3), ca.DM.zeros(3)  # of the link in the root
    nu, a = ca.DM.zeros(6), ca.DM.zeros(6)
    origins, links = [], []
    for i, axis in enumerate(axes):
        placement = model.jointPlacements[i + 1]
        place = place + ca.mtimes(rotation, ca.DM(placement.translation))
        origins.append(place)
        to_link, shift = ca.DM(placement.rotation), ca.DM.zeros(3)  # of the link in its predecessor
        if np.any(axis[3:]):
            to_link = ca.mtimes(to_link, _turn(axis[3:], q[i]))
        else:
            shift = ca.DM(axis[:3]) * q[i]
            place = place + ca.mtimes(rotation, ca.mtimes(to_link, shift))
        lever = ca.DM(placement.translation) + ca.mtimes(ca.DM(placement.rotation), shift)
        rotation = ca.mtimes(rotation, to_link)
        s = ca.DM(axis)
        nu = _into(to_link, lever, nu) + s * qd[i]
        a = _into(to_link, lever, a) + s * qdd[i] + _cross(nu, s * qd[i])
        links.append((to_link, lever, nu, a, rotation))
    fixed = model.frames[robot.frame_id].placement
    R_last_sensor, lever = ca.DM(fixed.rotation), ca.DM(fixed.translation)
    twist, acceleration = _into(R_last_sensor, lever, nu), _into(R_last_sensor, lever, a)
    R_root_sensor = ca.mtimes(rotation, R_last_sensor)
    p_root_sensor = place + ca.mtimes(rotation, lever)

    torque: Any = None
    if has_link_inertias(robot):
        mass, center, inertia = payload
        g = ca.DM(gravity)
        carried = force_to_move(
            mass, center, inertia, at_point(twist, center), at_point(acceleration, center),
            ca.mtimes(R_root_sensor.T, g),
        )  # fmt: skip
        force, torques = _out_of(R_last_sensor, lever, carried), []
        for i in reversed(range(robot.n)):
            to_link, lever, nu, a, rotation = links[i]
            body = model.inertias[i + 1]
            own = force_to_move(
                body.mass, body.lever, body.inertia, at_point(nu, body.lever), at_point(a, body.lever),
                ca.mtimes(rotation.T, g),
            )  # fmt: skip
            force = force + own
            torques.append(ca.dot(ca.DM(axes[i]), force))
            force = _out_of(to_link, lever, force)
        torque = ca.vertcat(*reversed(torques))
    return ArmExpressions(twist, acceleration, R_root_sensor, p_root_sensor, tuple(origins), torque)


def _axes(robot: Robot) -> list[Array]:
    """Unit twist (6,) of every joint in its own frame."""
    data, zero = robot.model.createData(), np.zeros(robot.n)
    return [np.array(pin.computeJointJacobian(robot.model, data, zero, i + 1)[:, i]) for i in range(robot.n)]


def _turn(axis: Array, angle: Any) -> Any:
    """Rotation about a constant unit axis."""
    k = ca.DM(pin.skew(axis))
    return ca.DM.eye(3) + ca.sin(angle) * k + (1.0 - ca.cos(angle)) * ca.mtimes(k, k)


def _into(R: Any, p: Any, six: Any) -> Any:
    """Motion of the origin of a frame at p, with axes R, of the body that the motion (6,) belongs to."""
    return ca.vertcat(ca.mtimes(R.T, six[:3] + ca.cross(six[3:], p)), ca.mtimes(R.T, six[3:]))


def _out_of(R: Any, p: Any, wrench: Any) -> Any:
    """The wrench of a frame at p, with axes R, at the origin and in the axes that p and R are told in."""
    force = ca.mtimes(R, wrench[:3])
    return ca.vertcat(force, ca.cross(p, force) + ca.mtimes(R, wrench[3:]))


def _cross(nu: Any, s: Any) -> Any:
    """Cross product of twists, [v; Omega]."""
    linear = ca.cross(nu[3:], s[:3]) + ca.cross(nu[:3], s[3:])
    return ca.vertcat(linear, ca.cross(nu[3:], s[3:]))
