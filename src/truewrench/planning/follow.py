"""A planned twist as files for an arm in velocity mode, with a verdict on how closely it can follow."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from truewrench.io.joint_trajectory import write_joint_trajectory
from truewrench.io.plans import joint_table, read_plan
from truewrench.io.tables import write_table
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig
from truewrench.planning.resolved_rate import FollowedTwist, JointLimits, follow_twist, limits_of
from truewrench.robot.arm import Robot, planned_robot_of

_FEWEST = 6  # rows of a quintic spline
_CLOSE = (
    0.01  # of the plan's largest linear and angular speed: what may be missing from a motion that follows
)


@dataclass(frozen=True, slots=True, eq=False)
class FollowedPlan:
    """How an arm follows a plan."""

    robot: Robot  # the arm
    motion: FollowedTwist  # commands and errors
    linear: float  # largest linear error over the plan's largest linear speed
    angular: float  # likewise
    speed: Array  # (n,) largest speed of each joint on the smooth motion over its limit

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the motion is not the planned one, in words; none where it follows closely."""
        missed = {"linear": self.linear, "angular": self.angular}
        return (
            *(
                f"the joints' limits cost up to {100 * share:.2g}% of the plan's largest {kind} speed"
                for kind, share in missed.items()
                if share > _CLOSE
            ),
            *(
                f"the smooth motion through the commands reaches {100 * share:.3g}% of the speed that "
                f"`{joint}` may have: the commands keep to it, FILE and its trajectory do not"
                for joint, share in zip(self.robot.joints, self.speed.tolist(), strict=True)
                if share > 1.0 + _CLOSE
            ),
        )

    def write(self, output: str | Path) -> tuple[Path, Path]:
        """Write the joints as a PLAN table, CSV or Parquet by its name, and for ROS FILE.trajectory.yaml.

        The table is the smooth motion through the positions that the commands lead to.
        """
        path, time = Path(output), self.motion.time
        joints = _smooth(self.motion)
        motion = [self.motion.position, joints.velocity(time), joints.acceleration(time)]
        message = path.with_name(f"{path.name}.trajectory.yaml")
        write_joint_trajectory(message, self.robot.joints, time, *motion)
        write_table(path, joint_table(self.robot.joints, time, *motion))
        return path, message


def _smooth(motion: FollowedTwist) -> SplineJoints:
    return SplineJoints.through(motion.time, motion.position)


def follow_plan(
    rig: Rig,
    plan: str | Path,
    *,
    of: Literal["com", "sensor"] = "com",
    payload: str | None = None,
    rate: float = 100.0,
) -> FollowedPlan:
    """Let the rig's arm follow a planned twist, from the rig's `motion.initial_position`, at a rate [Hz].

    The PLAN table of `vx ... wz` is that of the payload's centre of mass, by default the rig's first payload,
    or of the sensor's origin. InputError: for the robot, the plan, an unknown payload, or a start that is
    missing or outside its limits.
    """
    robot = planned_robot_of(rig)
    if rig.motion.initial_position is None:
        expected = "the joint positions that the motion starts from"
        raise InputError.at(rig.path, "motion.initial_position", "nothing", expected)
    rig.check_motion("which a motion needs")
    name = rig.payload_named(payload)
    lever = rig.payloads[name].center_of_mass_array if of == "com" else None
    trajectory = read_plan(plan)
    start = np.array(rig.motion.initial_position)
    steps = int(np.ceil(trajectory.duration * rate - 1e-9))
    if steps + 1 < _FEWEST:
        found = f"{rate:g} Hz for {trajectory.duration:g} s: {steps + 1} rows"
        raise InputError.at(plan, "--rate", found, f"at least {_FEWEST}, for a smooth motion through them")
    limits = limits_of(rig)
    _check_start(rig, robot, limits, start)
    motion = follow_twist(robot, trajectory, start, limits=limits, rate=rate, lever=lever)
    planned = motion.twist - motion.twist_error
    halves = (slice(0, 3), slice(3, 6))
    largest, missed = (
        [float(np.linalg.norm(six[:, half], axis=1).max()) for half in halves]
        for six in (planned, motion.twist_error)
    )
    linear, angular = (m / s if s > 0 else 0.0 for m, s in zip(missed, largest, strict=True))
    fastest = np.abs(_smooth(motion).velocity(motion.time)).max(axis=0)
    return FollowedPlan(robot, motion, linear, angular, fastest / limits.velocity)


def _check_start(rig: Rig, robot: Robot, limits: JointLimits, q: Array) -> None:
    for k in np.flatnonzero((q < limits.lower) | (q > limits.upper))[:1].tolist():
        place = f"motion.initial_position[{k}], joint `{robot.joints[k]}`"
        expected = f"{limits.lower[k]:g} to {limits.upper[k]:g}, its limits"
        raise InputError.at(rig.path, place, f"{q[k]:g}", expected)
