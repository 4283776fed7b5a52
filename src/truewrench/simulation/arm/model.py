"""The arm in MuJoCo: the rig's URDF as MuJoCo reads it, the payload welded on, ideal sensors at the weld.

Nothing here knows Pinocchio or the core's equations, from which logs are calibrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.motion.trajectory import Body

_PAYLOAD = "truewrench_payload"
# what MuJoCo measures at the sensor's site, in this order, three numbers each
_SENSORS = ("FORCE", "TORQUE", "VELOCIMETER", "GYRO", "ACCELEROMETER")
# of a link without any: it moves nothing and lets MuJoCo solve for its joint
_LEAST_MASS, _LEAST_INERTIA = 1e-3, 1e-6  # [kg], [kg m^2]


@dataclass(frozen=True, slots=True)
class Reading:
    """What ideal sensors at the sensor's centre measure, N samples in sensor axes."""

    wrench: Array  # (N, 6) of the payload on the sensor [N, N m]
    twist: Array  # (N, 6) of the sensor's origin [m/s, rad/s]
    specific_force: Array  # (N, 3) what an accelerometer reads there, vdot + Omega x v - g [m/s^2]
    gravity: Array  # (N, 3) acceleration of free fall [m/s^2]
    R_root_sensor: Array  # (N, 3, 3) turns sensor coordinates into those of the root
    p_root_sensor: Array  # (N, 3) position of the sensor's origin in the root [m]

    def at(self, rows: Integers) -> Reading:
        """Some of the rows."""
        return Reading(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """An arm with its payload, n joints in the order of the chain; all other joints are locked at zero."""

    joints: tuple[str, ...]  # their names
    model: Any  # the compiled `mujoco.MjModel`, nq = nv = n

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def inertia(self, position: Array) -> Array:
        """Joint-space inertia (n, n), payload and armature included, at one position (n,)."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = position
        mujoco.mj_forward(self.model, data)
        inertia = np.zeros((self.n, self.n))
        mujoco.mj_fullM(self.model, data, inertia)
        return inertia

    def skeleton(self, position: Array) -> Array:
        """Root, joints and sensor (K, n + 2, 3) in the root frame [m], at positions (K, n)."""
        data, points = mujoco.MjData(self.model), []
        for q in position:
            data.qpos[:] = q
            mujoco.mj_kinematics(self.model, data)
            points.append(np.concatenate([np.zeros((1, 3)), data.xanchor, data.site_xpos]))
        return np.array(points)

    def holding_torque(self, position: Array) -> Array:
        """Joint torques (n,) that hold one position (n,) at rest [N m, N]."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = position
        mujoco.mj_forward(self.model, data)
        return np.array(data.qfrc_bias - data.qfrc_passive)

    def ideal(self, position: Array, velocity: Array, acceleration: Array) -> Reading:
        """The readings of a motion (N, n) that is given rather than driven."""
        data = mujoco.MjData(self.model)
        rows = []
        for q, qd, qdd in zip(position, velocity, acceleration, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
            mujoco.mj_inverse(self.model, data)
            rows.append(self.read(data))
        return self.reading(np.array(rows))

    def read(self, data: Any) -> Array:
        """Sensors and the pose of their site (27,), of a state that MuJoCo has evaluated."""
        return np.concatenate([data.sensordata, data.site_xmat[0], data.site_xpos[0]])

    def reading(self, rows: Array) -> Reading:
        """Rows (N, 27) of `read` as readings."""
        R_root_sensor = rows[:, 15:24].reshape(-1, 3, 3)
        return Reading(
            wrench=-rows[:, :6],  # MuJoCo tells what the sensor does to the payload
            twist=rows[:, 6:12],
            specific_force=rows[:, 12:15],
            gravity=np.asarray(np.array(self.model.opt.gravity) @ R_root_sensor),  # R^T g
            R_root_sensor=R_root_sensor,
            p_root_sensor=rows[:, 24:],
        )


def arm_of(urdf: Path, sensor_frame: str, joints: Sequence[str], payload: Body, gravity: Array) -> Arm:
    """The arm of a URDF with a payload welded to its sensor frame.

    That is a link at the sensor's centre, with its axes. Links beyond the sensor frame are left out: a
    payload is everything beyond the sensing element. Meshes are not looked for and nothing collides. Joints,
    named in the order of the chain, have the damping of the URDF and no dry friction. Gravity (3,) is the
    acceleration of free fall in the root link's axes.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(urdf))
    except ValueError as error:
        raise InputError.at(urdf, "", f"a robot that cannot be simulated ({error})", "a URDF") from error
    spec.compiler.fusestatic = False  # a fused sensor frame would be gone
    for element in [*spec.meshes, *spec.geoms]:
        spec.delete(element)
    frame = spec.body(sensor_frame)
    if frame is None:
        raise UnsupportedError.at(urdf, "", f"no link `{sensor_frame}`", "a link as the sensor frame")
    for beyond in list(frame.bodies):
        spec.delete(beyond)
    for joint in list(spec.joints):
        if joint.name not in joints:
            spec.delete(joint)
            continue
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE  # whoever plans the motion keeps to the limits
        joint.frictionloss = 0.0
    for body in spec.bodies[1:]:
        _make_physical(body)
    _weld(spec, frame, payload)
    spec.option.gravity = gravity
    try:
        model = spec.compile()
    except ValueError as error:
        raise InputError.at(urdf, "", f"a robot that cannot be simulated ({error})", "a URDF") from error
    found = tuple(model.joint(k).name for k in range(model.njnt))
    if found != tuple(joints) or model.nq != len(found):
        raise RuntimeError(f"MuJoCo moves {sensor_frame} by {found}, expected {tuple(joints)}")
    return Arm(found, model)


def _make_physical(link: Any) -> None:
    """Give a link the mass or inertia that it lacks; others keep theirs to rounding."""
    if not link.mass > 0.0:
        link.mass, link.explicitinertial = _LEAST_MASS, True
    elements = np.array(link.fullinertia)
    stated = np.isfinite(elements).all()
    xx, yy, zz, xy, xz, yz = elements if stated else np.zeros(6)
    _set_inertia(link, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _weld(spec: Any, frame: Any, payload: Body) -> None:
    body = frame.add_body(name=_PAYLOAD)
    body.mass, body.ipos, body.explicitinertial = payload.mass, payload.center_of_mass, True
    _set_inertia(body, payload.inertia)
    body.add_site(name=_PAYLOAD)
    for kind in _SENSORS:
        spec.add_sensor(
            name=f"{_PAYLOAD}_{kind}",
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=_PAYLOAD,
        )


def _set_inertia(body: Any, inertia: Array) -> None:
    """Set the inertia (3, 3) about the centre of mass, in the axes that the body's inertia had before."""
    principal, axes = np.linalg.eigh(inertia)
    if not principal[2] > 0.0:
        principal = np.full(3, _LEAST_INERTIA)
    # Principal moments, not a tensor: rounding would put flat bodies (A + B = C) beyond what is allowed.
    principal = np.maximum(principal, 1e-9 * principal[2])
    principal[2] = min(principal[2], principal[0] + principal[1])
    axes[:, 2] *= np.linalg.det(axes)
    turn, quaternion = np.empty(4), np.empty(4)
    mujoco.mju_mat2Quat(turn, np.ascontiguousarray(axes).ravel())
    mujoco.mju_mulQuat(quaternion, np.array(body.iquat), turn)
    body.fullinertia = [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
    body.inertia, body.iquat = principal, quaternion
