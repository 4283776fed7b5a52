"""The paper's motions for an arm: the payload's twist under sinusoidal wrenches, followed by its joints."""

from dataclasses import replace

import numpy as np

from truewrench.io.plans import joint_table
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.motion.trajectory import SplineTwist, integrate_wrench
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig
from truewrench.planning.arm import unchecked_torques
from truewrench.planning.joint_check import check_joints
from truewrench.planning.joint_space import joint_limits
from truewrench.planning.limits import Limits
from truewrench.planning.period import plan_rows
from truewrench.planning.resolved_rate import follow_twist, limits_of
from truewrench.planning.result import Design
from truewrench.planning.search import Progress
from truewrench.planning.wrench_plan import ONE_FREQUENCY, best_sinusoids, facts_of, scaled
from truewrench.robot.arm import Robot, planned_robot_of

_REACHED = 0.5  # of what the joints could do together at the start
_TRAVEL = (0.15, 0.6)  # of the arm's length, and [rad]: what the hand may be away from the start
_SIZES = 0.7 ** np.arange(8)  # of the wrench that these limits suggest


def design_joint_wrench(rig: Rig, payload: str, progress: Progress) -> Design:
    """The largest sinusoidal wrenches that the joints can follow within their limits, where there are any.

    Not in gravity, which the paper's motions do not know, and not without a posture to start from.
    """
    if rig.in_gravity:
        expected = "`optimal`: sinusoidal wrenches are those of a free body"
        raise UnsupportedError.at(rig.path, "--method wrench", "a rig in gravity", expected)
    if rig.motion.initial_position is None:
        expected = "the joint positions that the motion starts from"
        raise InputError.at(rig.path, "motion.initial_position", "nothing", expected)
    robot = planned_robot_of(rig)
    limits, start = joint_limits(rig, robot), np.array(rig.motion.initial_position)
    best = best_sinusoids(rig, payload, _of_hand(rig, robot, limits, start), progress)
    body = rig.payloads[payload].center_of_mass_array
    rows = plan_rows(rig)
    for k, size in enumerate(_SIZES):
        progress("joints", k / _SIZES.size)
        found = scaled(best, float(size))
        motion = integrate_wrench(found.wrench, found.body, rig.plan.duration, found.initial)
        twist = SplineTwist.through(rows, motion.twist(rows))
        followed = follow_twist(robot, twist, start, limits=limits_of(rig), rate=rig.plan.rate, lever=body)
        joints = SplineJoints.through(followed.time, followed.position)
        preview = check_joints(rig, payload, robot, limits, joints, rig.plan.duration)
        missed = float(np.abs(followed.twist_error).max() / np.abs(twist.twist(rows)).max())
        if missed < 0.05 and max(use.share for use in preview.usage) <= 1.0:
            break
    moves = (joints.position(rows), joints.velocity(rows), joints.acceleration(rows))
    columns = joint_table(robot.joints, rows, *moves)
    notes = [
        *unchecked_torques(robot),
        "the motion neither starts nor ends at rest: it has to be led into its initial twist",
        ONE_FREQUENCY,
    ]
    if missed >= 0.05:
        notes.append(f"the joints miss up to {100 * missed:.0f} % of the twist that the wrench asks for")
    return Design(
        joints, columns, preview, rig.plan.duration, tuple(notes), facts_of(found), joints=robot.joints
    )


def _of_hand(rig: Rig, robot: Robot, limits: Limits, start: Array) -> Limits:
    """Limits (6,) of the hand's twist that the joints' limits suggest where the motion starts."""
    reach = np.abs(robot.jacobian(start)[0])
    travel, turn = _TRAVEL
    lengths = [np.linalg.norm(robot.model.jointPlacements[i + 1].translation) for i in range(robot.n)]
    away = np.repeat([travel * float(np.sum(lengths)), turn], 3)
    free = Limits.of(rig.model_copy(update={"limits": rig.limits.model_copy(update=_NONE)}), 6)
    velocity, acceleration = (
        _REACHED * reach @ np.where(np.isfinite(x), x, 1.0) for x in (limits.velocity, limits.acceleration)
    )
    return replace(free, lower=-away, upper=away, velocity=velocity, acceleration=acceleration)


_NONE = {key: None for key in ("position", "velocity", "acceleration", "jerk", "workspace")}
