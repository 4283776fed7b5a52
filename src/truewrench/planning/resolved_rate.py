"""A planned twist of the sensor, followed by an arm in velocity mode within its joints' limits.

At every step a quadratic programme finds the joint velocities that come closest to the planned motion while
no joint leaves its range or exceeds its speed. Where the arm has more joints than needed, those near a limit
leave the work to the others; what is left over keeps the arm near the posture that it starts from.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.motion.spatial import at_point
from truewrench.model.motion.trajectory import Trajectory
from truewrench.model.rig import Rig
from truewrench.planning.limits import SMALLEST
from truewrench.robot.arm import Robot, planned_robot_of

_SUBSTEPS = 4  # of the target pose between two commands
_METRE_PER_RADIAN = 1.0  # what a radian of attitude weighs against a metre
_POSTURE = 1e-4  # weight of the posture against the pose: it acts in what the pose leaves free
_RETURN = 2.0  # [s] in which the posture is returned to
_SLOWING = 0.2  # [s]: at most this part of the way to a limit in a second, so that a joint brakes smoothly


@dataclass(frozen=True, slots=True, eq=False)
class JointLimits:
    """What n joints keep to; inf where there is no limit."""

    lower: Array  # (n,) smallest position [rad, m]
    upper: Array  # (n,) largest position
    velocity: Array  # (n,) largest speed [rad/s, m/s]


@dataclass(frozen=True, slots=True, eq=False)
class FollowedTwist:
    """Commands to the joints and how well they follow the plan, at N times."""

    time: Array  # (N,) [s], the first 0
    position: Array  # (N, n) joint positions that the commands lead to [rad, m]
    velocity: Array  # (N, n) commands, each held until the next time; the last is that of rest
    twist: Array  # (N, 6) of the sensor's origin half-way to the next time, sensor axes [m/s, rad/s]
    twist_error: Array  # (N, 6) `twist` less the plan's
    position_error: Array  # (N,) distance of the sensor from its planned place [m]


def limits_of(rig: Rig) -> JointLimits:
    """The stricter of the robot's limits and those of the rig's `limits` section."""
    robot = planned_robot_of(rig)
    position = np.inf if rig.limits.position is None else np.array(rig.limits.position)
    velocity = np.inf if rig.limits.velocity is None else np.maximum(rig.limits.velocity, SMALLEST)
    return JointLimits(
        lower=np.maximum(robot.lower, -position),
        upper=np.minimum(robot.upper, position),
        velocity=np.minimum(robot.velocity, velocity),
    )


def follow_twist(
    robot: Robot,
    plan: Trajectory,
    start: Array,
    *,
    limits: JointLimits | None = None,
    rate: float = 100.0,
    lever: Array | None = None,
) -> FollowedTwist:
    """Joint velocities by which an arm follows a planned twist.

    It is that of a point fixed to the sensor, in sensor axes. The start is (n,) joint positions at time 0,
    within the limits, by default those of the URDF; the rate is of commands [Hz]. The lever (3,) is the
    plan's point seen from the sensor's origin [m]: the centre of mass for a plan of it; by default the origin
    itself.
    """
    import pinocchio as pin
    from pink import Configuration, solve_ik
    from pink.limits import ConfigurationLimit, VelocityLimit
    from pink.tasks import FrameTask, PostureTask

    limits = JointLimits(robot.lower, robot.upper, robot.velocity) if limits is None else limits
    q = np.array(start, dtype=np.float64)
    _check_start(robot, limits, q)
    steps = max(1, int(np.ceil(plan.duration * rate - 1e-9)))
    time = np.linspace(0.0, plan.duration, steps + 1)
    dt = plan.duration / steps

    model = robot.model.copy()  # pink leaves notes of its own on a model
    model.lowerPositionLimit, model.upperPositionLimit = limits.lower, limits.upper
    model.velocityLimit = limits.velocity
    braking = min(1.0, dt / _SLOWING)
    inequalities = [ConfigurationLimit(model, config_limit_gain=braking), VelocityLimit(model)]
    pose = FrameTask(robot.sensor_frame, position_cost=1.0, orientation_cost=_METRE_PER_RADIAN)
    posture = PostureTask(cost=_POSTURE, gain=min(1.0, dt / _RETURN))
    posture.set_target(q)
    configuration = Configuration(model, model.createData(), q)
    target = configuration.get_transform_frame_to_world(robot.sensor_frame).copy()

    back = np.zeros(3) if lever is None else -lever
    planned = at_point(plan.twist(_fine(time)), back).reshape(steps, _SUBSTEPS, 6)
    position, velocity = np.empty((steps + 1, robot.n)), np.zeros((steps + 1, robot.n))
    error = np.empty((steps + 1, 6))
    position[0], error[0] = q, 0.0
    for k in range(steps):
        for nu in planned[k]:
            target = target * pin.exp6(pin.Motion(nu * dt / _SUBSTEPS))
        pose.set_target(target)
        commanded = solve_ik(
            configuration, [pose, posture], dt, solver="daqp", limits=inequalities, safety_break=False
        )
        velocity[k] = _within(commanded, q, limits, dt)
        q = q + velocity[k] * dt
        configuration.update(q)
        position[k + 1] = q
        error[k + 1] = pose.compute_error(configuration)
    twist, wanted = _between(robot, position, velocity, dt), at_point(plan.twist(time[:-1] + dt / 2), back)
    rest = np.zeros((1, 6))
    return FollowedTwist(
        time=time,
        position=position,
        velocity=velocity,
        twist=np.vstack([twist, rest]),
        twist_error=np.vstack([twist - wanted, rest]),
        position_error=np.linalg.norm(error[:, :3], axis=1),
    )


def _check_start(robot: Robot, limits: JointLimits, q: Array) -> None:
    if q.shape != (robot.n,):
        raise InputError.at(
            None, "start", f"{q.size} joint positions", f"{robot.n}: {', '.join(robot.joints)}"
        )
    outside = np.flatnonzero((q < limits.lower) | (q > limits.upper))
    if len(outside):
        i = int(outside[0])
        expected = f"{limits.lower[i]:g} to {limits.upper[i]:g}"
        raise InputError.at(None, f"start, joint `{robot.joints[i]}`", f"{q[i]:g}", expected)


def _fine(time: Array) -> Array:
    """The middles of the substeps between the times (N,)."""
    step = np.diff(time)[:, None] / _SUBSTEPS
    middles: Array = time[:-1, None] + step * (np.arange(_SUBSTEPS) + 0.5)
    return middles.ravel()


def _within(commanded: Any, q: Array, limits: JointLimits, dt: float) -> Array:
    """The solver's answer to the last bit within the limits, which it holds to a tolerance."""
    low = np.maximum(-limits.velocity, (limits.lower - q) / dt)
    high = np.minimum(limits.velocity, (limits.upper - q) / dt)
    held: Array = np.clip(commanded, low, high)
    return held


def _between(robot: Robot, position: Array, velocity: Array, dt: float) -> Array:
    """Twists (N, 6) half-way between N + 1 positions."""
    middle = position[:-1] + velocity[:-1] * (dt / 2)
    twist: Array = np.einsum("kij,kj->ki", robot.jacobian(middle), velocity[:-1])
    return twist
