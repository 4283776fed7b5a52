"""What the data did not tell of a tool, and what would."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from truewrench.estimation.static_poses import REPEATABILITY
from truewrench.model.arrays import Array
from truewrench.model.rig import Rig
from truewrench.tool.motion import MotionFit
from truewrench.tool.parameters import COLUMNS, ROWS, inertia_of, symmetric
from truewrench.tool.parts import Unknown
from truewrench.tool.solve import Solution

APART = np.radians(10.0)  # of two directions of gravity
NARROW = np.radians(30.0)
OWN = 0.5  # of a variance: what the gain explains of it


def directions_of(fall: Array) -> tuple[int, float, Array]:
    """How many directions unit vectors (T, 3) show, half the angle of the cone that holds them, its axis."""
    if not len(fall):
        return 0, 0.0, np.zeros(3)
    apart: list[Array] = []
    for one in fall:
        if all(np.arccos(np.clip(one @ other, -1.0, 1.0)) > APART for other in apart):
            apart.append(one)
    middle = fall.mean(axis=0)
    size = float(np.linalg.norm(middle))
    axis = middle / size if size > 1e-9 else fall[0]
    return len(apart), float(np.arccos(np.clip(fall @ axis, -1.0, 1.0)).max()), axis


def directions_in(solution: Solution) -> tuple[int, float, Array]:
    """The same of all poses: none without gravity."""
    fall = solution.problem.poses.R_sensor_root @ solution.problem.rig.gravity_array
    size = np.linalg.norm(fall, axis=1, keepdims=True)
    return directions_of(fall / size if solution.problem.rig.in_gravity else fall[:0])


def undetermined(
    rig: Rig,
    solution: Solution,
    motion: MotionFit | None,
    determined: Mapping[str, Any],
    figures: Mapping[str, Any],
) -> tuple[list[Unknown], list[str]]:
    """What is not told, in words, and what would tell it."""
    moving, out, needed = bool(solution.problem.moves), [], []
    v, P = solution.problem.vector, solution.covariance
    layout = v.layout
    std = np.sqrt(np.diag(P))
    share = _by_gain(P, layout.gain)
    if "mass" not in solution.problem.prior.known:
        words = (
            "Mass and the sensor's force scale cannot be told apart: the mass is as good as the scale, "
            f"{100.0 * std[layout.log_mass]:.2g}%. Weigh the tool once, or calibrate the sensor."
        )
        out.append(Unknown("mass", words))
        if share[layout.log_mass] > OWN and std[layout.log_mass] > 0.005:
            needed.append("Weigh the tool (`--known mass=KG:SIGMA`), or calibrate the sensor.")
    if not all(determined["inertia"]):
        lead = (
            "The tool was not accelerated: its" if not moving else "The tool was hardly turned: part of its"
        )
        out.append(Unknown("inertia", f"{lead} inertia is not known. Swing it at 1 rad/s for 5 s."))
        needed.append("Swing the tool at 1 rad/s for 5 s about all axes.")
    elif moving:
        out += _thin(solution)
    directions, cone, axis = directions_in(solution)
    if directions and cone < NARROW and motion is None:
        along = "xyz"[int(np.argmax(np.abs(axis)))]
        words = (
            f"Gravity stayed within {np.degrees(cone):.0f} deg of one direction: weight and offset along "
            f"{along} are not separated; tilt it further, opposite if possible."
        )
        out.append(Unknown("offset", words))
        needed.append("Poses at 45 deg of tilt and more, opposite ones in turn.")
    center = float(std[layout.center_of_mass].max())
    worst = layout.center_of_mass.start + int(np.argmax(std[layout.center_of_mass]))
    if share[worst] > OWN and all(determined["center_of_mass"]):
        words = (
            f"Centre of mass and the sensor's moment-from-force cross-talk look alike: {1e3 * center:.2g} mm."
        )
        out.append(Unknown("center_of_mass", words))
    prior = np.sqrt(np.diag(solution.prior_covariance)[layout.mounting])
    turn = float(std[layout.mounting].max())
    if prior.max() > 1e-6:
        words = (
            f"A turn of the sensor on its flange looks like cross-talk: {np.degrees(turn):.2g} deg; measure "
            "it or calibrate."
        )
        out.append(Unknown("mounting", words))
    out += _moved(rig, solution)
    if solution.problem.prior.gain_std > 0.0501:
        words = (
            f"Gains uncertain by {100 * solution.problem.prior.gain_std:.2g}%: beyond 5% gain times mass "
            "bends, and every sigma was widened for it."
        )
        out.append(Unknown("gain", words))
    if figures["poses"] and figures["poses"] < 8 and motion is None:
        needed.append("12 poses and more let some be held out.")
    return out, needed


def _by_gain(P: Array, gain: slice) -> Array:
    """Share of each parameter's variance that knowing the gain would remove."""
    scale = np.sqrt(np.maximum(np.diag(P)[gain], 1e-300))
    inner = P[gain, gain] / np.outer(scale, scale)
    cross = P[:, gain] / scale
    explained = np.einsum("pi,ip->p", cross, np.linalg.lstsq(inner, cross.T, rcond=1e-10)[0])
    return np.asarray(explained / np.maximum(np.diag(P), 1e-300))


def _thin(solution: Solution) -> list[Unknown]:
    layout = solution.problem.vector.layout
    mass = float(np.exp(solution.x[layout.log_mass]))
    values, vectors = np.linalg.eigh(symmetric(inertia_of(mass, solution.x[layout.S])))
    axis = vectors[:, 0]  # u^T I u = m (tr S - u^T S u)
    same = ROWS == COLUMNS
    by_S = mass * (same - np.where(same, 1, 2) * axis[ROWS] * axis[COLUMNS])
    sigma = float(np.sqrt(by_S @ solution.covariance[layout.S, layout.S] @ by_S))
    if values[0] > 2.0 * sigma:
        return []
    most = max(values[0], 0.0) + 2.0 * sigma
    words = f"The inertia about the long axis is too small to feel: between 0 and {most:.1g} kg m^2."
    return [Unknown("inertia", words)]


def _moved(rig: Rig, solution: Solution) -> list[Unknown]:
    """How far the offset moved during the poses, where it is worth a word."""
    if len(solution.walk) < 2:
        return []
    place = solution.problem.vector.layout.gain
    back = np.linalg.pinv(solution.x[place].reshape(-1, 6))
    moved = np.ptp(solution.walk @ back.T, axis=0)
    worth = np.ptp(solution.walk, axis=0) / rig.sensor.channel_scale > 10.0 * REPEATABILITY
    if not worth.any():
        return []
    relative = moved / rig.sensor.range_array
    axis = int(np.argmax(relative))
    size, unit = moved[axis], "N" if axis < 3 else "N m"
    words = (
        f"The offset moved by {size:.2g} {unit} during the poses; the weight was separated from it, but the "
        "offset holds only for minutes: tare before use."
    )
    return [Unknown("offset", words)]
