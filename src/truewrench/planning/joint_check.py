"""What a joint motion does between its nodes, by Pinocchio: independent of what it was planned with."""

import numpy as np
import pinocchio as pin

from truewrench.model.arrays import Array
from truewrench.model.motion.spatial import at_point
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig
from truewrench.planning.buffered import Buffered
from truewrench.planning.check import Preview, check_times, place_usage, wrench_usage
from truewrench.planning.joint_space import ArmOutputs, near_pairs
from truewrench.planning.limits import Limits, Usage, clearance_usage, usage_of
from truewrench.robot.arm import Robot


def check_joints(
    rig: Rig, payload: str, robot: Robot, limits: Limits, motion: SplineJoints, until: float
) -> Preview:
    """Look at a joint motion until some time [s], against the limits."""
    time = check_times(until)
    q, qd, qdd = motion.position(time), motion.velocity(time), motion.acceleration(time)
    moved = robot.motion(q, qd, qdd)
    center = rig.payloads[payload].center_of_mass_array
    twist = at_point(moved.twist, center)
    gravity = np.asarray(np.einsum("kji,j->ki", moved.R_root_sensor, rig.gravity_array))
    wrench = payload_wrench(rig, payload, moved.twist, moved.acceleration, gravity)
    mass_at = moved.p_root_sensor + moved.R_root_sensor @ center
    origins = _origins(robot, q)
    distance = np.column_stack(
        [
            np.empty((time.size, 0)),  # an arm of four joints has no pair
            *(
                np.linalg.norm(
                    (moved.p_root_sensor if outer == "sensor" else mass_at)
                    - (1.0 - share) * origins[:, link]
                    - share * origins[:, link + 1],
                    axis=1,
                )
                for outer, _, link, share in near_pairs(robot)
            ),
        ]
    )
    usage = [
        *_of_joints(robot, limits, motion, time),
        *usage_of("torque", robot.joints, time, _torque(rig, payload, robot, q, qd, qdd), -limits.torque,
                  limits.torque),
        *wrench_usage(limits, time, wrench),
        *place_usage(limits, time, moved.p_root_sensor, mass_at),
        *clearance_usage(
            [f"{a} from {b}" for a, b, _, _ in near_pairs(robot)], time, distance, limits.clearance
        ),
    ]  # fmt: skip
    skeleton = np.concatenate([origins, moved.p_root_sensor[:, None]], axis=1)
    return Preview(time, twist, wrench, gravity, moved.R_root_sensor, moved.p_root_sensor, skeleton, usage)


def quick_usage(
    rig: Rig, robot: Robot, outputs: ArmOutputs, limits: Limits, motion: SplineJoints, until: float
) -> list[Usage]:
    """The same use of the limits by the expressions that the motion is planned with: a tenth of the time."""
    time = check_times(until)
    states = (motion.position(time).T, motion.velocity(time).T, motion.acceleration(time).T)
    wrench, every = (x.T for x in Buffered(outputs.function.map(time.size))(*states))
    workspace, torque = every[:, outputs.workspace], every[:, outputs.torque]
    high = limits.torque[: torque.shape[1]]
    return [
        *_of_joints(robot, limits, motion, time),
        *usage_of("torque", robot.joints[: torque.shape[1]], time, torque, -high, high),
        *wrench_usage(limits, time, wrench * rig.sensor.range_array),
        *place_usage(limits, time, workspace[:, :3], workspace[:, 3:]),
        *clearance_usage(outputs.pairs, time, every[:, outputs.distance] ** -0.5, limits.clearance),
    ]


def _of_joints(robot: Robot, limits: Limits, motion: SplineJoints, time: Array) -> list[Usage]:
    names = robot.joints
    return [
        *usage_of("position", names, time, motion.position(time), limits.lower, limits.upper),
        *usage_of("velocity", names, time, motion.velocity(time), -limits.velocity, limits.velocity),
        *usage_of(
            "acceleration", names, time, motion.acceleration(time), -limits.acceleration, limits.acceleration
        ),
        *usage_of("jerk", names, time, np.asarray(motion.spline(time, nu=3)), -limits.jerk, limits.jerk),
    ]


def _origins(robot: Robot, q: Array) -> Array:
    """(N, n, 3) of every joint in the root, root first."""
    data, found = robot.model.createData(), np.empty((len(q), robot.n, 3))
    places = [data.oMi[i + 1].translation for i in range(robot.n)]  # views of what is computed
    for k, position in enumerate(q):
        pin.forwardKinematics(robot.model, data, position)
        found[k] = places
    return found


def _torque(rig: Rig, payload: str, robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """(N, n) by RNEA, with the payload on the last link."""
    model, body = robot.model.copy(), rig.payloads[payload]
    model.gravity.linear = rig.gravity_array
    frame = model.frames[robot.frame_id]
    inertia = pin.Inertia(body.mass, body.center_of_mass_array, body.inertia_matrix)
    model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    data = model.createData()
    return np.array([pin.rnea(model, data, *state) for state in zip(q, qd, qdd, strict=True)])
