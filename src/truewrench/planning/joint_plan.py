"""Optimal motions of arms, and the log that a calibration would have of them."""

from collections.abc import Set
from typing import Literal

import numpy as np

from truewrench.io.plans import joint_table
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.motion.trajectory_joint import JointTrajectory, SplineJoints
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig
from truewrench.planning.arm import unchecked_torques
from truewrench.planning.criterion import Criterion
from truewrench.planning.joint_check import check_joints, quick_usage
from truewrench.planning.joint_space import arm_outputs, joint_limits, joint_space
from truewrench.planning.limits import Usage
from truewrench.planning.optimise import Problem
from truewrench.planning.period import cycles_of, plan_rows, typical_velocity
from truewrench.planning.result import Design
from truewrench.planning.search import Effort, Progress, search
from truewrench.planning.series import FourierMotion, SeriesBasis
from truewrench.planning.spread import spread_weight
from truewrench.robot.arm import planned_robot_of
from truewrench.robot.track import track
from truewrench.simulation.truth import begin, readings, stamps_of

_EFFORT = Effort(random=120, starts=6, first=20, finalists=2, iterations=60, again=20, rounds=1, excess=0.02)


def design_joints(rig: Rig, payload: str, criterion: Literal["A", "D"], progress: Progress) -> Design:
    """The best joint motion found within the limits of rig and arm."""
    robot, settings = planned_robot_of(rig), rig.plan
    limits = joint_limits(rig, robot)
    cycles = cycles_of(rig, limits)
    basis = SeriesBasis(settings.harmonics, settings.duration / cycles, settings.rest_to_rest)
    outputs = arm_outputs(rig, payload, robot)
    # a log without positions says nothing of where it began, other than the rig does
    fixed = rig.motion.position_noise is None and rig.motion.initial_position is not None
    start = np.array(rig.motion.initial_position) if fixed else None
    scale = typical_velocity(limits, basis)
    measure = Criterion(rig, settings.duration * rig.simulate.sensor_rate, criterion)

    def problem(kinds: Set[str]) -> Problem:
        space = joint_space(rig, outputs, limits, scale, start, kinds)
        return Problem(space, basis, measure, limits, spread=spread_weight(rig))

    origin = np.zeros(robot.n) if start is None else start

    def spline(motion: FourierMotion, rows: Array) -> SplineJoints:
        position = motion.position(rows) + origin
        return SplineJoints.through(rows, position, motion.velocity(rows), motion.acceleration(rows))

    def check(motion: FourierMotion) -> list[Usage]:
        rows = plan_rows(rig)
        rows = rows[: np.searchsorted(rows, basis.period) + 8]  # what follows a period repeats it
        return quick_usage(rig, robot, outputs, limits, spline(motion, rows), basis.period)

    found = search(
        problem,
        limits,
        settings.duration,
        check,
        settings.seed,
        progress,
        effort=_EFFORT,
        near=rig.motion.initial_position,
    )
    progress("last look at the limits", None)
    rows = plan_rows(rig)
    motion = spline(found.motion, rows)
    moves = (motion.position(rows), found.motion.velocity(rows), found.motion.acceleration(rows))
    columns = joint_table(robot.joints, rows, *moves)
    preview = check_joints(rig, payload, robot, limits, motion, basis.period)
    notes, facts = unchecked_torques(robot), found.facts()
    return Design(motion, columns, preview, basis.period, notes, facts, joints=robot.joints)


def simulated_joints(rig: Rig, payload: str, motion: JointTrajectory) -> Log:
    """A log of the arm as if it followed exactly: what a calibration would have, without servos."""
    robot = planned_robot_of(rig)
    name, truth = begin(rig, payload, None)
    stamps = stamps_of(rig, motion.duration, truth.time_offset)
    rng = np.random.default_rng([truth.seed, 1])
    at = stamps.shown
    moved = robot.motion(motion.position(at), motion.velocity(at), motion.acceleration(at))
    gravity = np.asarray(np.einsum("kji,j->ki", moved.R_root_sensor, rig.gravity_array))
    wrench = rig.sensor.sign * payload_wrench(rig, name, moved.twist, moved.acceleration, gravity)
    raw = readings(rig, truth, stamps, wrench, rng)
    time, settings = stamps.motion, rig.motion
    deviates = rng.standard_normal((2, time.size, robot.n))
    position, velocity = motion.position(time), None
    if settings.position_noise is not None:
        position = position + np.array(settings.position_noise) * deviates[0]
    if settings.noise is not None:
        noisy = motion.velocity(time) + settings.noise_array * deviates[1]
        velocity = stamps.rows_of(stamps.motion_ns, noisy)
    log = Log(
        path=None,
        payload=name,
        sha256="",
        time_ns=stamps.time_ns,
        raw=raw,
        position=stamps.rows_of(stamps.motion_ns, position),
        velocity=velocity,
    )
    return track(rig, log)
