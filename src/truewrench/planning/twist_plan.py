"""Optimal motions of rigs that log a twist."""

from typing import Literal

import numpy as np

from truewrench.io.table import ACCELERATION, TWIST
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import AXES
from truewrench.model.motion.trajectory import SplineTwist
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig
from truewrench.planning.check import check_twist
from truewrench.planning.criterion import Criterion
from truewrench.planning.limits import Limits, Usage
from truewrench.planning.optimise import Problem
from truewrench.planning.period import cycles_of, plan_rows, typical_velocity
from truewrench.planning.result import Design
from truewrench.planning.search import Found, Progress, search
from truewrench.planning.series import FourierMotion, SeriesBasis
from truewrench.planning.spread import spread_weight
from truewrench.planning.twist_space import pose_space, pose_twist, twist_space


def design_twist(rig: Rig, payload: str, criterion: Literal["A", "D"], progress: Progress) -> Design:
    """The best twist found within the limits of the rig."""
    limits, settings = Limits.of(rig, 6), rig.plan
    obstacles = _at_rest(rig, payload, limits)
    if obstacles:
        still = np.zeros((plan_rows(rig).size, 6))
        return twist_design(rig, payload, limits, still, still, settings.duration, obstacles=obstacles)
    placed = settings.rest_to_rest or rig.in_gravity or rig.limits.workspace is not None
    reach = _reachable(rig, payload, limits)
    cycles = cycles_of(rig, reach) if placed else 1
    basis = SeriesBasis(settings.harmonics, settings.duration / cycles, settings.rest_to_rest)
    scale = typical_velocity(reach, basis)
    space = pose_space(rig, payload, limits, scale) if placed else twist_space(rig, payload, scale)
    measure = Criterion(rig, settings.duration * rig.simulate.sensor_rate, criterion)
    problem = Problem(space, basis, measure, limits, spread=spread_weight(rig))

    def twist(motion: FourierMotion, time: Array) -> tuple[Array, Array]:
        return pose_twist(motion, time) if placed else (motion.velocity(time), motion.acceleration(time))

    def check(motion: FourierMotion) -> list[Usage]:
        rows = plan_rows(rig)
        rows = rows[: np.searchsorted(rows, basis.period) + 8]  # what follows a period repeats it
        spline = SplineTwist.through(rows, twist(motion, rows)[0])
        return check_twist(rig, payload, limits, spline, basis.period, placed=placed).usage

    found = search(lambda _: problem, limits, settings.duration, check, settings.seed, progress)
    planned = twist(found.motion, plan_rows(rig))
    return twist_design(rig, payload, limits, *planned, basis.period, found=found)


def twist_design(
    rig: Rig,
    payload: str,
    limits: Limits,
    twist: Array,
    acceleration: Array,
    period: float,
    *,
    notes: tuple[str, ...] = (),
    obstacles: tuple[str, ...] = (),
    found: Found | None = None,
) -> Design:
    """The design whose table has the given twist (N, 6) and derivative at the rows of the plan."""
    time = plan_rows(rig)
    motion = SplineTwist.through(time, twist)
    columns = {"time_s": time}
    columns |= dict(zip(TWIST, twist.T, strict=True)) | dict(zip(ACCELERATION, acceleration.T, strict=True))
    preview = check_twist(rig, payload, limits, motion, period)
    facts = None if found is None else found.facts()
    return Design(motion, columns, preview, period, notes, facts, obstacles)


def _at_rest(rig: Rig, payload: str, limits: Limits) -> tuple[str, ...]:
    """Why not even rest is possible: what the payload weighs where the motion begins."""
    zero = np.zeros((1, 6))
    wrench = payload_wrench(rig, payload, zero, zero, rig.gravity_array[None])[0]
    over = np.abs(wrench) / limits.wrench
    return tuple(
        f"at rest, gravity alone loads {name} with {value:.4g}: {100 * share:.0f} % of what "
        f"limits.wrench_fraction allows"
        for name, value, share in zip(AXES, wrench, over, strict=True)
        if share > 1.0
    )


def _reachable(rig: Rig, payload: str, limits: Limits) -> Limits:
    """The limits, with accelerations no larger than those that the sensor's range allows."""
    body = rig.payloads[payload]
    inertia = np.diag(body.inertia_matrix)
    linear, angular = limits.wrench[:3] / body.mass, limits.wrench[3:] / inertia
    return limits.with_acceleration(np.minimum(limits.acceleration, np.concatenate([linear, angular])))
