"""The arm between the robot's root and the sensor: pose, twist and acceleration of the sensor frame.

Everything is told at the origin of the sensor frame, along its axes ({S} of docs/notation.md). The root is
the root link of the URDF: the base, where the base moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.motion.spatial import at_point
from truewrench.model.motion.trajectory import rotation_matrix
from truewrench.model.rig import Rig
from truewrench.model.rig.urdf import model_of, nearest, read_urdf


@dataclass(frozen=True, slots=True, eq=False)
class BaseMotion:
    """How the root itself moves, in N rows."""

    twist: Array  # (N, 6) of the root's origin, root axes [m/s, rad/s]
    acceleration: Array  # (N, 6) its component-wise derivative


@dataclass(frozen=True, slots=True, eq=False)
class ArmMotion:
    """How the sensor frame moves, in N rows."""

    twist: Array  # (N, 6) of the sensor's origin, sensor axes [m/s, rad/s]
    acceleration: Array  # (N, 6) its component-wise derivative
    R_root_sensor: Array  # (N, 3, 3) turns sensor coordinates into those of the root
    p_root_sensor: Array  # (N, 3) position of the sensor's origin in the root [m]


@dataclass(frozen=True, eq=False)
class Robot:
    """The n joints that move the sensor frame, all others locked at zero."""

    # their names in the order of the chain, root first: the order of every per-joint list
    joints: tuple[str, ...]
    lower: Array  # (n,) smallest position [rad, m], -inf where there is none
    upper: Array  # (n,) largest position, inf where there is none
    velocity: Array  # (n,) largest speed [rad/s, m/s], inf where there is none
    effort: Array  # (n,) largest torque or force [N m, N], inf where there is none
    sensor_frame: str  # its name in the URDF
    model: Any  # the `pinocchio.Model` of these joints; its nq = nv = n
    frame_id: int  # of the sensor frame in the model
    mimics: dict[str, str]  # of those joints that mimic another: which

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Pose of the sensor frame in the root at joint positions (N, n) [rad, m].

        R_root_sensor (N, 3, 3) and p_root_sensor (N, 3) [m].
        """
        import pinocchio as pin

        q, data = _rows(q), self.model.createData()
        R_root_sensor, p_root_sensor = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
        for k, position in enumerate(q):
            pin.forwardKinematics(self.model, data, position)  # before any frame is read
            placement = pin.updateFramePlacement(self.model, data, self.frame_id)
            R_root_sensor[k], p_root_sensor[k] = placement.rotation, placement.translation
        return R_root_sensor, p_root_sensor

    def jacobian(self, q: Array) -> Array:
        """J (N, 6, n) of nu = J qd, twist of the sensor's origin in sensor axes; q as for `pose`."""
        import pinocchio as pin

        q, data = _rows(q), self.model.createData()
        J = np.empty((len(q), 6, self.n))
        for k, position in enumerate(q):
            J[k] = pin.computeFrameJacobian(self.model, data, position, self.frame_id, pin.LOCAL)
        return J

    def motion(self, q: Array, qd: Array, qdd: Array, base: BaseMotion | None = None) -> ArmMotion:
        """Motion of the sensor frame, relative to {O} where the base moves and to the root otherwise.

        Joint positions [rad, m], velocities and accelerations are (N, n).
        """
        import pinocchio as pin

        q, qd, qdd = _rows(q), _rows(qd), _rows(qdd)
        data = self.model.createData()
        twist, acceleration = np.empty((len(q), 6)), np.empty((len(q), 6))
        R_root_sensor, p_root_sensor = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
        placement = data.oMf[self.frame_id]
        R, p = placement.rotation, placement.translation  # views of what is computed
        for k in range(len(q)):
            pin.forwardKinematics(self.model, data, q[k], qd[k], qdd[k])
            pin.updateFramePlacement(self.model, data, self.frame_id)
            R_root_sensor[k], p_root_sensor[k] = R, p
            twist[k] = pin.getFrameVelocity(self.model, data, self.frame_id, pin.LOCAL).vector
            # a body's spatial acceleration, in its own axes, is the derivative of its twist's components
            acceleration[k] = pin.getFrameAcceleration(self.model, data, self.frame_id, pin.LOCAL).vector
        if base is not None:
            carried = _at_sensor(base.twist, R_root_sensor, p_root_sensor)
            carried_rate = _at_sensor(base.acceleration, R_root_sensor, p_root_sensor)
            acceleration += carried_rate - _cross(
                twist, carried
            )  # the sensor's axes turn under the carried part
            twist += carried
        return ArmMotion(twist, acceleration, R_root_sensor, p_root_sensor)


def rotation_of(attitude: Array) -> Array:
    """R_inertial_base (N, 3, 3) of quaternions (N, 4) w, x, y, z, base to inertial, of any length > 0."""
    unit = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    return rotation_matrix(unit[:, [1, 2, 3, 0]])


def load_robot(urdf: str | Path, sensor_frame: str) -> Robot:
    """The chain of a URDF from its root to a link (or joint) at the sensor's centre, with the sensor's axes.

    Meshes that it names are not looked for. InputError: the file cannot be read, the frame is missing, or no
    joint moves it. UnsupportedError: a joint of the chain is neither revolute, continuous nor prismatic.
    """
    import pinocchio as pin

    whole = model_of(urdf)
    if not whole.existFrame(sensor_frame):
        names = [frame.name for frame in whole.frames if frame.name != "universe"]
        expected = f"a link or joint of the robot (nearest: {nearest(sensor_frame, names)})"
        raise InputError.at(urdf, "", f"no frame `{sensor_frame}`", expected)
    sensor = _frame_id(whole, sensor_frame)
    support = list(whole.supports[whole.frames[sensor].parentJoint])[1:]
    if not support:
        raise InputError.at(
            urdf, f"frame `{sensor_frame}`", "no joint that moves it", "a frame on a moving link"
        )
    for joint in support:
        if whole.joints[joint].nq != 1:
            found = f"a joint of the kind {whole.joints[joint].shortname()}"
            place = f"joint `{whole.names[joint]}`"
            raise UnsupportedError.at(urdf, place, found, "revolute, continuous or prismatic joints")
    locked = [joint for joint in range(1, whole.njoints) if joint not in support]
    _tell_apart(whole)
    model = pin.buildReducedModel(whole, locked, pin.neutral(whole))
    return Robot(
        joints=tuple(model.names)[1:],
        lower=np.array(model.lowerPositionLimit),
        upper=np.array(model.upperPositionLimit),
        velocity=np.array(model.velocityLimit),
        effort=np.array(model.effortLimit),
        sensor_frame=sensor_frame,
        model=model,
        frame_id=model.getFrameId(whole.frames[sensor].name),
        mimics=_mimics(urdf, tuple(model.names)[1:]),
    )


def _mimics(urdf: str | Path, joints: Sequence[str]) -> dict[str, str]:
    """Which of some joints mimic another, and which."""
    marks = {joint.get("name", ""): joint.find("mimic") for joint in read_urdf(urdf).iter("joint")}
    found = {name: marks.get(name) for name in joints}
    return {name: mark.get("joint", "") for name, mark in found.items() if mark is not None}


def turning(robot: Robot) -> Mask:
    """(n,) Which joints turn, and do not slide."""
    return np.array([joint.shortname().startswith("JointModelR") for joint in robot.model.joints[1:]])


def robot_of(rig: Rig) -> Robot:
    """The robot of a rig with `motion.source: joints`, every list of which has one entry per joint."""
    path, motion = rig.urdf_path, rig.motion
    if path is None or motion.robot is None:
        raise InputError.at(
            rig.path, "motion.robot", "nothing", "{urdf, sensor_frame}, with `source: joints`"
        )
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    robot = _cached(path.resolve(), motion.robot.sensor_frame, changed)
    lists = {f"motion.{key}": getattr(motion, key) for key in ("noise", "position_noise", "initial_position")}
    lists |= {f"limits.{key}": getattr(rig.limits, key) for key in ("position", "velocity")}
    lists |= {f"limits.{key}": getattr(rig.limits, key) for key in ("acceleration", "jerk")}
    for key, values in lists.items():
        if values is not None and len(values) != robot.n:
            expected = f"{robot.n}: one per joint, in the order {', '.join(robot.joints)}"
            raise InputError.at(rig.path, key, f"{len(values)} entries", expected)
    return robot


def planned_robot_of(rig: Rig) -> Robot:
    """`robot_of`, for what is planned: every joint by itself.

    UnsupportedError: a joint of the chain mimics another, and no drive moves it otherwise.
    """
    robot = robot_of(rig)
    for joint, other in robot.mimics.items():
        expected = "joints that move by themselves, to be planned"
        raise UnsupportedError.at(rig.urdf_path, f"joint `{joint}`", f"<mimic> of `{other}`", expected)
    return robot


@lru_cache(maxsize=16)
def _cached(path: Path, sensor_frame: str, changed: int) -> Robot:
    del changed  # when the file was written: a file that changes is read again
    return load_robot(path, sensor_frame)


def _frame_id(model: Any, name: str) -> int:
    """A link's frame, where joint and link have one name."""
    import pinocchio as pin

    named = [i for i, frame in enumerate(model.frames) if frame.name == name]
    return next((i for i in named if model.frames[i].type == pin.FrameType.BODY), named[0])


def _tell_apart(model: Any) -> None:
    """Rename links that share a joint's name: URDF allows it, Pinocchio's reduction does not."""
    import pinocchio as pin

    moving = {frame.name for frame in model.frames if frame.type != pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.name in moving:
            frame.name += " (link)"


def _rows(values: Array) -> Array:
    return np.ascontiguousarray(np.atleast_2d(values), dtype=np.float64)


def _at_sensor(six: Array, R_root_sensor: Array, p_root_sensor: Array) -> Array:
    """Twists (N, 6) of the root's origin, root axes, as those of the sensor's origin in sensor axes."""
    moved = at_point(six, p_root_sensor)
    parts = (moved[:, :3], moved[:, 3:])
    return np.column_stack([np.einsum("kji,kj->ki", R_root_sensor, part) for part in parts])


def _cross(a: Array, b: Array) -> Array:
    """Cross product of twists (N, 6), [v; Omega]."""
    linear = np.cross(a[:, 3:], b[:, :3]) + np.cross(a[:, :3], b[:, 3:])
    return np.column_stack([linear, np.cross(a[:, 3:], b[:, 3:])])
