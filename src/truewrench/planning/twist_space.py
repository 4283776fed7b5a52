"""Coordinates for rigs whose motion is a twist: its integral by component, or the pose of the body."""

import casadi as ca
import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.rig import Rig
from truewrench.planning.buffered import Buffered
from truewrench.planning.limits import Limits
from truewrench.planning.optimise import Bounds, Space
from truewrench.planning.series import FourierMotion
from truewrench.planning.symbolic import at_point, total_derivative, wrench_over_range


def twist_space(rig: Rig, payload: str, scale: Array) -> Space:
    """Coordinates are the integrals of the six components of the twist: free of gravity and of any place."""
    z, nu, a = (ca.SX.sym(name, 6) for name in ("z", "nu", "a"))
    lever = _lever(rig, payload)
    wrench = wrench_over_range(rig, payload, at_point(nu, lever), at_point(a, lever), ca.SX.zeros(3))
    node = ca.Function("node", [z, nu, a], [wrench, ca.SX(0, 1), ca.SX(0, 1)])
    none = np.zeros(0)

    def bounds(limits: Limits) -> Bounds:
        share = limits.wrench / rig.sensor.range_array
        series = (limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk)
        return Bounds(*series, none, none, share, none, none)

    return Space(6, node, bounds, scale, free_start=False)


def pose_space(rig: Rig, payload: str, limits: Limits, scale: Array) -> Space:
    """Coordinates are position [m] and attitude (four times its modified Rodrigues parameters) of the point.

    They begin at zero, the axes of the sensor then being those of the root. A series in them closes the path
    of the body; that the integral of its twist by component closes as well is a constraint. The limits of the
    jerk hold for the coordinates here, and are corrected from what a solution uses.
    """
    z, velocity, acceleration = (ca.SX.sym(name, 6) for name in ("z", "velocity", "acceleration"))
    nu, rotation = _twist(z, velocity)
    a = total_derivative(nu, z, velocity, acceleration)
    lever = _lever(rig, payload)
    gravity = ca.mtimes(rotation.T, ca.DM(rig.gravity_array))
    wrench = wrench_over_range(rig, payload, at_point(nu, lever), at_point(a, lever), gravity)
    center = rig.payloads[payload].center_of_mass_array
    # the root's origin is where the sensor starts
    place = ca.DM(center - lever) + z[:3]
    at_sensor, at_center = (place + ca.mtimes(rotation, ca.DM(point)) for point in (lever - center, lever))
    outputs = ca.vertcat(nu, a, at_sensor, at_center)

    def both(limits: Limits) -> tuple[Array, Array]:
        box = limits.workspace
        symmetric = np.concatenate([limits.velocity, limits.acceleration])
        lower, upper = (
            np.concatenate([sign * symmetric, side, side]) for sign, side in zip((-1, 1), box.T, strict=True)
        )
        return lower, upper

    kept = np.flatnonzero(np.isfinite(both(limits)[1])).tolist()
    node = ca.Function("node", [z, velocity, acceleration], [wrench, outputs[kept], nu])
    free = np.full(6, np.inf)

    def bounds(limits: Limits) -> Bounds:
        lower, upper = both(limits)
        share = limits.wrench / rig.sensor.range_array
        series = (-free, free, free, free, limits.jerk)
        return Bounds(*series, lower[kept], upper[kept], share, limits.lower, limits.upper)

    return Space(6, node, bounds, scale, free_start=False)


def pose_twist(motion: FourierMotion, time: Array) -> tuple[Array, Array]:
    """Twist (N, 6) in body axes, and its derivative, of a motion in the coordinates of `pose_space`."""
    z, velocity, acceleration = (ca.SX.sym(name, 6) for name in ("z", "velocity", "acceleration"))
    nu = _twist(z, velocity)[0]
    a = total_derivative(nu, z, velocity, acceleration)
    states = (motion.position(time).T, motion.velocity(time).T, motion.acceleration(time).T)
    function = ca.Function("twist", [z, velocity, acceleration], [ca.densify(nu), ca.densify(a)])
    twist, derivative = Buffered(function.map(len(time)))(*states)
    return twist.T, derivative.T


def _twist(z: ca.SX, velocity: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Twist in body axes and R_root_body of coordinates and their velocities."""
    s, rate = z[3:] / 4.0, velocity[3:] / 4.0
    square = ca.dot(s, s)
    vector, scalar = 2.0 * s / (1.0 + square), (1.0 - square) / (1.0 + square)  # the quaternion
    cross = ca.skew(vector)
    rotation = ca.SX.eye(3) + 2.0 * scalar * cross + 2.0 * ca.mtimes(cross, cross)
    omega = (
        4.0
        / (1.0 + square) ** 2
        * ((1.0 - square) * rate - 2.0 * ca.cross(s, rate) + 2.0 * s * ca.dot(s, rate))
    )
    return ca.vertcat(ca.mtimes(rotation.T, velocity[:3]), omega), rotation


def _lever(rig: Rig, payload: str) -> Array:
    """Where the planned point sees the centre of mass, sensor axes."""
    return rig.payloads[payload].center_of_mass_array if rig.motion.of == "sensor" else np.zeros(3)
