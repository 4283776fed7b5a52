"""Newton-Euler as CasADi expressions, so that IPOPT gets exact derivatives ([A00] 5-8)."""

from typing import Any

import casadi as ca

from truewrench.model.arrays import Array
from truewrench.model.rig import Rig


def wrench_over_range(rig: Rig, payload: str, twist: Any, acceleration: Any, gravity: Any) -> Any:
    """Wrench (6,) as the sensor feels it, over its range, from the motion of the centre of mass.

    Twist (6,), its component-wise derivative and gravity (3,) are along the sensor axes.
    """
    body = rig.payloads[payload]
    reaction = -force_to_move(
        body.mass, body.center_of_mass_array, body.inertia_matrix, twist, acceleration, gravity
    )
    return rig.sensor.sign * reaction / ca.DM(rig.sensor.range_array)


def force_to_move(
    mass: float, center: Array, inertia: Array, twist: Any, acceleration: Any, gravity: Any
) -> Any:
    """Wrench (6,) at a frame's origin that moves a body, from the motion of its centre of mass.

    The centre (3,) [m] is from the origin, the inertia (3, 3) [kg m^2] about the centre of mass; twist (6,),
    its component-wise derivative and gravity (3,) are along the frame's axes.
    """
    v, omega = twist[:3], twist[3:]
    tensor = ca.DM(inertia)
    force = mass * (acceleration[:3] + ca.cross(omega, v) - gravity)
    moment = ca.mtimes(tensor, acceleration[3:]) + ca.cross(omega, ca.mtimes(tensor, omega))
    return ca.vertcat(force, ca.cross(ca.DM(center), force) + moment)


def at_point(six: Any, lever: Array) -> Any:
    """Twist of a point, or its derivative, from that of another that sees it at `lever`."""
    return ca.vertcat(six[:3] + ca.cross(six[3:], ca.DM(lever)), six[3:])


def total_derivative(expression: Any, z: Any, velocity: Any, acceleration: Any) -> Any:
    """Derivative by time of an expression in coordinates and their velocities."""
    return ca.jtimes(expression, z, velocity) + ca.jtimes(expression, velocity, acceleration)
