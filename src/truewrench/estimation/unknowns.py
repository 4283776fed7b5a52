"""What is unknown besides gain and offset, payloads, clocks, gravity, and what it does to the wrench.

Wrenches are normalised by the range of their axis and have the sign of the rig.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.motion.spatial import cross_matrix
from truewrench.model.rig import Rig
from truewrench.model.rig.sections import COLUMNS, ROWS
from truewrench.robot.attitude import attitude_at, attitude_of, own_roots

Motion = Callable[[Array], tuple[Array, Array, Array]]
"""Of times (M,): twist (M, 6) of the logged point, its derivative, free fall (M, 3) in sensor axes."""
Wrench = Callable[[Array, Array, Array], Array]  # of these three: the normalised wrench (M, 6)

_STEP = 1e-4  # [s] of the difference by time; motions of seconds are smooth over it, rounding is 1e-9 of w
_OF_PAYLOAD = ("mass", *["center_of_mass"] * 3, *["inertia"] * 6)


@dataclass(frozen=True, slots=True)
class Unknown:
    """One number that is known beforehand with some uncertainty."""

    group: str  # mass, center_of_mass, inertia, timing, gravity
    prior: float  # 1 sigma, greater than zero
    place: int  # which of the group's numbers: of a payload's ten, of the tilt's two in each root frame
    payload: str | None = None  # whose it is, None for clocks and gravity
    log: int | None = None  # the number of the log whose clock, or whose own root frame, it is of; else None


def unknowns_of(rig: Rig, logs: Sequence[Log]) -> list[Unknown]:
    """What the rig states with an uncertainty; what is exact is left out.

    Masses are relative, centres of mass in m, elements of the inertia relative to sqrt(I_ii I_jj); a clock in
    s, t_motion = t_sensor + time_offset; gravity's tilt in rad about `horizontal_axes` of a root frame.
    """
    found = []
    for name in dict.fromkeys(log.payload for log in logs):
        sigma = rig.payloads[name].uncertainty.of_each.tolist()
        found += [
            Unknown(group, s, k, payload=name)
            for k, (group, s) in enumerate(zip(_OF_PAYLOAD, sigma, strict=True))
        ]
    found += [Unknown("timing", rig.sensor.time_offset_prior, 0, log=k) for k in range(len(logs))]
    if rig.in_gravity:
        roots = {_root(rig, log, k): max(len(own_roots(rig, log)), 1) for k, log in enumerate(logs)}
        sigma = rig.gravity_tilt_prior
        found += [Unknown("gravity", sigma, k, log=root) for root in roots for k in range(2 * roots[root])]
    return [u for u in found if u.prior > 0.0]


def wrench_rates(
    rig: Rig,
    log: Log,
    number: int,
    unknowns: Sequence[Unknown],
    at: Array,
    motion: Motion,
    wrench: Wrench,
) -> Array:
    """Derivatives (M, 6, len(unknowns)) of the normalised wrench of a log at times (M,) of its motion.

    The log has a number among all; times are since its first row [s].
    """
    nu, a, gravity = motion(at)
    rates = np.zeros((at.size, 6, len(unknowns)))
    by_group: dict[str, Array] = {}
    for k, unknown in enumerate(unknowns):
        if unknown.payload == log.payload:
            if "payload" not in by_group:
                by_group["payload"] = payload_rates(rig, log.payload, nu, a, gravity)
            rates[:, :, k] = by_group["payload"][:, :, unknown.place]
        elif unknown.group == "timing" and unknown.log == number:
            # the sensor's sample shows the motion that much later
            ahead, back = (wrench(*motion(at + side * _STEP)) for side in (1.0, -1.0))
            rates[:, :, k] = (ahead - back) / (2.0 * _STEP)
        elif unknown.group == "gravity" and unknown.log == _root(rig, log, number):
            if "gravity" not in by_group:
                by_group["gravity"] = tilt_rates(rig, log, at, nu, a, gravity, wrench)
            rates[:, :, k] = by_group["gravity"][:, :, unknown.place]
    return rates


def _root(rig: Rig, log: Log, number: int) -> int | None:
    """Which log's own root frames a log has, None where it is the one that logs share."""
    return number if len(own_roots(rig, log)) else None


def payload_rates(rig: Rig, payload: str, nu: Array, a: Array, gravity: Array) -> Array:
    """Derivatives (M, 6, 10) of the normalised wrench by a payload: see `unknowns_of`; xx yy zz xy xz yz.

    The logged point, whose twist is nu (M, 6), stays where it is: at the STATED centre of mass, or at the
    sensor's origin. Gravity (M, 3), free fall, is in sensor axes.
    """
    spec, omega, alpha = rig.payloads[payload], nu[:, 3:], a[:, 3:]
    center, inertia = spec.center_of_mass_array, spec.inertia_matrix
    lever = center if rig.motion.of == "sensor" else np.zeros(3)
    turning = cross_matrix(omega)
    # ([A00] 5-9): f = m (vdot + Omega x v + D lever - g), D = [Omegadot] + [Omega][Omega]
    D = cross_matrix(alpha) + turning @ turning
    force = spec.mass * (a[:, :3] + np.cross(omega, nu[:, :3]) + D @ lever - gravity)
    c = cross_matrix(center[None])[0]
    found = np.empty((len(nu), 6, 10))
    found[:, :3, 0], found[:, 3:, 0] = force, np.cross(center, force)
    # of c x f + n_c by c: -[f] + m [c] D
    found[:, :3, 1:4] = spec.mass * D
    found[:, 3:, 1:4] = spec.mass * c @ D - cross_matrix(force)
    found[:, :3, 4:] = 0.0
    for k, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = np.sqrt(inertia[i, i] * inertia[j, j])
        found[:, 3:, 4 + k] = alpha @ unit + np.cross(omega, omega @ unit)
    return np.asarray(-rig.sensor.sign * found / rig.sensor.range_array[:, None])


def horizontal_axes(gravity: Array) -> Array:
    """(2, 3) unit vectors of the root frame at right angles to gravity (3,), about which it may be tilted."""
    down = gravity / np.linalg.norm(gravity)
    first = np.cross(down, np.eye(3)[np.argmin(np.abs(down))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first)])


def tilt_rates(rig: Rig, log: Log, at: Array, nu: Array, a: Array, gravity: Array, wrench: Wrench) -> Array:
    """Derivatives (M, 6, 2R) of a wrench by gravity's tilt in each root frame; 0 where no attitude is told.

    A tilt about e changes free fall in sensor axes by R (e x g). Arguments as of `wrench_rates`, and its
    motion.
    """
    roots = own_roots(rig, log)
    rates = np.zeros((at.size, 6, max(len(roots), 1), 2))
    told = attitude_of(rig, log)
    if told is None:
        return rates.reshape(at.size, 6, -1)
    R_sensor_root = attitude_at(*told, at)
    root = np.searchsorted(roots[1:, 0], at, side="right")
    here = wrench(nu, a, gravity)
    for k, axis in enumerate(horizontal_axes(rig.gravity_array)):
        change = R_sensor_root @ np.cross(axis, rig.gravity_array)
        rates[np.arange(at.size), :, root, k] = wrench(nu, a, gravity + change) - here  # linear in g: exact
    return rates.reshape(at.size, 6, -1)
