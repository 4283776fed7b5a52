"""Joint positions as the coordinates of a motion."""

from collections.abc import Set
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.planning.arm import ArmExpressions, arm_expressions, has_link_inertias
from truewrench.planning.limits import Limits
from truewrench.planning.optimise import Bounds, Space
from truewrench.planning.symbolic import at_point, wrench_over_range
from truewrench.robot.arm import Robot

_CLEARANCE = 0.07  # of the arm's length: what hand and payload keep from the inner links


@dataclass(frozen=True, slots=True, eq=False)
class ArmOutputs:
    """SX function of (q, qd, qdd) to what is limited, and what each output is."""

    function: ca.Function  # to wrench over range (6,) and all outputs (y,)
    workspace: slice  # (6,) x, y, z of sensor and centre of mass [m]
    torque: slice  # (n,) [N m, N]
    distance: slice  # (d,) inverse squares of the distances between the pairs [1/m^2]
    pairs: tuple[str, ...]  # names of these pairs


def joint_limits(rig: Rig, robot: Robot) -> Limits:
    """The stricter of the limits of the rig and of the URDF; InputError if they leave a joint no range."""
    limits = Limits.of(rig, robot.n)
    lower, upper = np.maximum(limits.lower, robot.lower), np.minimum(limits.upper, robot.upper)
    for k in np.flatnonzero(lower >= upper)[:1]:
        stated = f"limits.position ({limits.lower[k]:g} to {limits.upper[k]:g})"
        found = f"no range within both {stated} and the URDF ({robot.lower[k]:g} to {robot.upper[k]:g})"
        raise InputError.at(rig.path, f"joint `{robot.joints[k]}`", found, "room to move")
    lengths = [np.linalg.norm(robot.model.jointPlacements[i + 1].translation) for i in range(robot.n)]
    lengths.append(np.linalg.norm(robot.model.frames[robot.frame_id].placement.translation))
    return replace(
        limits,
        lower=lower,
        upper=upper,
        velocity=np.minimum(limits.velocity, robot.velocity),
        torque=robot.effort if has_link_inertias(robot) else np.full(robot.n, np.inf),
        clearance=_CLEARANCE * float(np.sum(lengths)),
    )


def arm_outputs(rig: Rig, payload: str, robot: Robot) -> ArmOutputs:
    """What is limited, as a function of the joints."""
    q, qd, qdd = (ca.SX.sym(name, robot.n) for name in ("q", "qd", "qdd"))
    body = rig.payloads[payload]
    center = body.center_of_mass_array
    arm = arm_expressions(robot, q, qd, qdd, rig.gravity_array, (body.mass, center, body.inertia_matrix))
    gravity = ca.mtimes(arm.R_root_sensor.T, ca.DM(rig.gravity_array))
    wrench = wrench_over_range(
        rig, payload, at_point(arm.twist, center), at_point(arm.acceleration, center), gravity
    )
    mass_at = arm.p_root_sensor + ca.mtimes(arm.R_root_sensor, ca.DM(center))
    torque = ca.SX(0, 1) if arm.torque is None else arm.torque
    names, distances = _distances(robot, arm, mass_at)
    ends = np.cumsum([0, 6, torque.numel(), len(distances)]).tolist()
    outputs = ca.vertcat(arm.p_root_sensor, mass_at, torque, *distances)
    function = ca.Function("arm", [q, qd, qdd], [ca.densify(wrench), ca.densify(outputs)])
    workspace, joints, distance = (slice(a, b) for a, b in pairwise(ends))
    return ArmOutputs(function, workspace, joints, distance, names)


def near_pairs(robot: Robot) -> list[tuple[str, str, int, float]]:
    """What is kept apart: sensor and payload from points on the links up to the elbow.

    Names of both, the joint at whose origin the link begins, and where on it the point is, from 0 to 1.
    """
    found = []
    for link in range(max(0, robot.n - 4)):
        for share in (0.0, 0.5):
            inner = f"link of {robot.joints[link]}" if share else f"joint {robot.joints[link]}"
            found += [(outer, inner, link, share) for outer in ("sensor", "payload")]
    return found


def _distances(robot: Robot, arm: ArmExpressions, mass_at: Any) -> tuple[tuple[str, ...], list[Any]]:
    names, inverse = [], []
    for outer, inner, link, share in near_pairs(robot):
        point = (1.0 - share) * arm.origins[link] + share * arm.origins[link + 1]
        names.append(f"{outer} from {inner}")
        away = (arm.p_root_sensor if outer == "sensor" else mass_at) - point
        inverse.append(1.0 / (ca.sumsqr(away) + 1e-12))
    return tuple(names), inverse


def joint_space(
    rig: Rig, outputs: ArmOutputs, limits: Limits, scale: Array, start: Array | None, kinds: Set[str]
) -> Space:
    """Coordinates are the positions of n joints, whose typical velocities are the scale (n,).

    The start (n,) is None where it is free. Of `workspace`, `torque` and `clearance`, the kinds of limits
    that are not named are left out.
    """
    n = scale.size

    def all_bounds(limits: Limits) -> tuple[Array, Array]:
        low, high = np.full(outputs.distance.stop, -np.inf), np.full(outputs.distance.stop, np.inf)
        low[outputs.workspace], high[outputs.workspace] = (np.tile(side, 2) for side in limits.workspace.T)
        count = outputs.torque.stop - outputs.torque.start
        low[outputs.torque], high[outputs.torque] = -limits.torque[:count], limits.torque[:count]
        # of the inverse square, which is never negative
        high[outputs.distance] = limits.clearance**-2.0
        low[outputs.distance] = -high[outputs.distance]
        return low, high

    wanted = np.concatenate(
        [
            np.arange(part.start, part.stop)
            for kind, part in (
                ("workspace", outputs.workspace),
                ("torque", outputs.torque),
                ("clearance", outputs.distance),
            )
            if kind in kinds
        ]
        or [np.zeros(0, dtype=np.int64)]
    )
    kept = wanted[np.isfinite(all_bounds(limits)[1][wanted])].tolist()
    z, velocity, acceleration = (ca.SX.sym(name, n) for name in ("z", "velocity", "acceleration"))
    at = z if start is None else z + ca.DM(start)
    wrench, every = outputs.function(at, velocity, acceleration)
    node = ca.Function("node", [z, velocity, acceleration], [wrench, every[kept], ca.SX(0, 1)])
    origin = np.zeros(n) if start is None else start

    def bounds(limits: Limits) -> Bounds:
        low, high = all_bounds(limits)
        none = np.zeros(0)
        share = limits.wrench / rig.sensor.range_array
        ends = (limits.lower - origin, limits.upper - origin)
        series = (*ends, limits.velocity, limits.acceleration, limits.jerk)
        return Bounds(*series, low[kept], high[kept], share, none, none)

    return Space(n, node, bounds, scale, free_start=start is None)
