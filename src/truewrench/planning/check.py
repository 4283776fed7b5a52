"""What a motion does between its nodes: everything that is limited, 1000 times a second."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_simpson

from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import AXES
from truewrench.model.motion.spatial import at_point
from truewrench.model.motion.trajectory import SplineTwist, attitude
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig
from truewrench.planning.limits import Limits, Usage, usage_of

TWIST_AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
_RATE = 1000.0  # [Hz]


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """A planned motion at (N,) times, and its use of the limits."""

    time: Array  # [s]
    twist: Array  # (N, 6) of the centre of mass, sensor axes
    wrench: Array  # (N, 6) that the sensor will feel, with the sign of the rig [N, N m]
    gravity: Array  # (N, 3) in sensor axes
    R_root_sensor: Array  # (N, 3, 3)
    p_root_sensor: Array  # (N, 3) [m]
    skeleton: Array  # (N, P, 3) positions of joints, root first, sensor last; P = 0 without an arm [m]
    usage: list[Usage]  # of every limit


def check_times(duration: float) -> Array:
    """1000 times a second, both ends included."""
    return np.linspace(0.0, duration, 1 + int(np.ceil(duration * _RATE)))


def check_twist(
    rig: Rig, payload: str, limits: Limits, motion: SplineTwist, until: float, *, placed: bool = True
) -> Preview:
    """Look at a twist of the rig's point until some time [s].

    In gravity the sensor starts aligned with the root. Where it is not `placed`, the pose is not looked at,
    and the sensor does not leave the root.
    """
    time = check_times(until)
    nu, a = motion.twist(time), motion.acceleration(time)
    center = rig.payloads[payload].center_of_mass_array
    of_sensor = rig.motion.of == "sensor"
    at_center, at_sensor = (at_point(nu, center), nu) if of_sensor else (nu, at_point(nu, -center))
    rotation = attitude(motion, time) if placed else np.tile(np.eye(3), (time.size, 1, 1))
    velocity = np.einsum("kij,kj->ki", rotation, at_sensor[:, :3])
    place = cumulative_simpson(velocity, x=time, axis=0, initial=0.0)
    gravity = np.asarray(rig.gravity_array @ rotation)  # R^T g
    wrench = payload_wrench(rig, payload, nu, a, gravity)
    integral = motion.spline.antiderivative()(time)
    usage = [
        *usage_of("position", TWIST_AXES, time, integral, limits.lower, limits.upper),
        *usage_of("velocity", TWIST_AXES, time, nu, -limits.velocity, limits.velocity),
        *usage_of("acceleration", TWIST_AXES, time, a, -limits.acceleration, limits.acceleration),
        *usage_of("jerk", TWIST_AXES, time, motion.spline(time, nu=2), -limits.jerk, limits.jerk),
        *wrench_usage(limits, time, wrench),
        *place_usage(limits, time, place, place + rotation @ center),
    ]
    return Preview(time, at_center, wrench, gravity, rotation, place, np.zeros((time.size, 0, 3)), usage)


def wrench_usage(limits: Limits, time: Array, wrench: Array) -> list[Usage]:
    """Use of the sensor's range by wrenches (N, 6)."""
    return usage_of("wrench", AXES, time, wrench, -limits.wrench, limits.wrench)


def place_usage(limits: Limits, time: Array, sensor: Array, center: Array) -> list[Usage]:
    """Use of the workspace by sensor and centre of mass (N, 3) each."""
    found = []
    for name, place in (("sensor", sensor), ("centre of mass", center)):
        axes = [f"{axis} of the {name}" for axis in "xyz"]
        found += usage_of("workspace", axes, time, place, *limits.workspace.T)
    return found
