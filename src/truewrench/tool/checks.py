"""Logs and statements that cannot be right, refused before anything is estimated."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.attitude import check_fall
from truewrench.robot.joint_faults import joint_faults
from truewrench.tool.model import Tool
from truewrench.tool.parameters import ELEMENTS

KNOWN = ("mass", *(f"center_of_mass.{axis}" for axis in "xyz"), *(f"inertia.{name}" for name in ELEMENTS))
"""What may be stated of a tool."""

_TURNS = 4.0 * np.pi  # [rad] no joint of an arm is beyond
_FASTEST = 40.0  # [rad/s]
_NEXT = 0.3  # [s] between rows whose attitudes are compared
_CLEARLY = 20.0  # times the noise: a turn that differences of rows show
_FAR = 1.0  # [rad] that gravity's direction should have gone
_FROZEN = 5e-3  # of the way that its direction should have gone; tolerance
_DEGREES = np.radians([0.8, 1.25])  # share of -Omega x g that is found where Omega is in degrees; tolerance
_LARGEST = 1e6  # of a mass: tolerance
_FARTHEST = 10.0  # [m] between frames of one wrist: tolerance
_HEAVIEST = 50.0  # [kg] of a sensor's housing: tolerance
_LIKE = 0.2  # of the squares of the change of g that another unit leaves unexplained; tolerance


def check_known(known: Mapping[str, tuple[float, float]]) -> None:
    """Refuse statements about something else, and numbers that are none."""
    for name, (value, sigma) in known.items():
        if name not in KNOWN:
            raise InputError.at(None, "known", f"`{name}`", f"one of {', '.join(KNOWN)}")
        positive = name == "mass" or name in ("inertia.xx", "inertia.yy", "inertia.zz")
        if not np.isfinite(value) or (positive and value <= 0.0):
            expected = "a number greater than 0" if positive else "a finite number"
            raise InputError.at(None, f"known {name}", f"{value:g}", expected)
        if not np.isfinite(sigma) or sigma <= 0.0:
            raise InputError.at(None, f"known {name}", f"a sigma of {sigma:g}", "a number greater than 0")


def check_options(
    flange: npt.ArrayLike | None,
    housing: npt.ArrayLike | None,
    sigmas: Mapping[str, float | None] = MappingProxyType({}),
) -> None:
    """Refuse poses and bodies that are none, and negative uncertainties, None where not stated.

    The flange is (6,) x, y, z, roll, pitch, yaw, the housing (4,) mass and centre of mass.
    """
    for name, given, count in (("flange", flange, 6), ("housing", housing, 4)):
        values = np.zeros(count) if given is None else np.asarray(given, dtype=np.float64)
        if values.shape != (count,) or not (np.abs(values) < _LARGEST).all():
            raise InputError.at(None, f"--{name}", f"{given!r}", f"{count} finite numbers in SI units")
        if name == "housing" and values[0] < 0.0:
            raise InputError.at(None, f"--{name}", f"a mass of {values[0]:g}", "a number of at least 0")
        if name == "housing" and values[0] > _HEAVIEST:
            raise InputError.at(None, f"--{name}", f"{values[0]:g} kg", f"at most {_HEAVIEST:g} kg (g?)")
        check_place(f"--{name}", values[1:] if name == "housing" else values)
    for name, sigma in sigmas.items():
        if sigma is not None and not 0.0 <= sigma <= np.pi:
            raise InputError.at(None, f"--{name}", f"{sigma:g}", "an angle from 0 to pi [rad]")


def check_place(option: str, values: Array) -> None:
    """Refuse a place, x, y, z and then roll, pitch, yaw if any, that no frame of a wrist has: other units."""
    farthest = float(np.abs(values[:3]).max())
    if farthest > _FARTHEST:
        raise InputError.at(None, option, f"{farthest:g} m", f"at most {_FARTHEST:g} m (mm?)")
    turn = float(np.abs(values[3:]).max(initial=0.0))
    if turn > 2.0 * np.pi:
        raise InputError.at(None, option, f"an angle of {turn:g}", "radians (degrees?)")


def check_positions(place: str | Path | None, position: Array) -> None:
    """Refuse joints (N, n) that are further than any turns: degrees."""
    turned = float(np.nanmax(np.abs(position), initial=0.0))
    if turned > _TURNS:
        raise InputError.at(place, "q_*", f"a joint at {turned:.4g}", "radians (degrees?)")


def check_rates(place: str | Path | None, omega: Array) -> None:
    """Refuse rates of turn (N, 3) that no arm has: degrees."""
    fastest = float(np.nanmax(np.abs(omega), initial=0.0))
    if fastest > _FASTEST:
        raise InputError.at(place, "wx wy wz", f"a turn of {fastest:.4g}", "rad/s (degrees?)")


def check_logs(rig: Rig, logs: Sequence[Log]) -> None:
    """Refuse silent channels, degrees, free fall of another size than the rig's, joints of no arm."""
    stated = float(np.linalg.norm(rig.gravity_array))
    moving = any(
        values is not None for log in logs for values in (log.twist, log.position, log.specific_force)
    )
    if stated == 0.0 and not moving:
        raise InputError.at(rig.path, "gravity", "0", "gravity, which poses need")
    for log in logs:
        if not len(log.time_ns):
            raise InputError.at(log.path, "", "no row", "poses, or a motion")
        log.check_channels()
        check_fall(rig, log)
        if log.position is not None and rig.motion.source == "joints":
            check_positions(log.path, log.position)
        omega = log.angular_velocity if log.twist is None else log.twist[:, 3:]
        if omega is not None:
            check_rates(log.path, omega)
        _check_turns(rig, log)
    for log in logs:
        if faults := joint_faults(rig, [log]):
            raise InputError.at(log.path, "joints", "; ".join(faults[:2]), "the motion of one arm")


def check_session(rig: Rig, logs: Sequence[Log], on: Tool | None) -> None:
    """Refuse logs of one session that overlap, or are before the tool that they stand on."""
    if not rig.sensor.pool_offsets:
        return
    ordered = sorted((log for log in logs if log.reference is None), key=lambda log: int(log.time_ns[0]))
    for before, log in pairwise(ordered):
        lasts = 1e-9 * (int(before.time_ns[-1]) - int(log.time_ns[0]))
        if lasts > 0.0:
            found = f"a log that begins {lasts:.4g} s before another of its session ends"
            expected = "logs one after the other on one clock, or `sensor.pool_offsets: false`"
            raise InputError.at(log.path, "time", found, expected)
    if on is None:
        return
    for log in logs:
        first = int(log.time_ns[0])
        if first < on.offset_time_ns:
            found = f"{first} ns, before the offset of --on at {on.offset_time_ns} ns"
            expected = "a later log of the same clock, or `sensor.pool_offsets: false`: an offset of its own"
            raise InputError.at(log.path, "time", found, expected)


def _check_turns(rig: Rig, log: Log) -> None:
    """Refuse a direction of gravity that does not turn as the logged rate of turn says: d/dt g = -Omega x g.

    The share of -Omega x g that is found in the change of g is 1 whatever the sensor; 0 where the attitude is
    frozen, 1/57.3 where Omega is in degrees.
    """
    if log.twist is None or log.gravity is None or rig.motion.source != "twist":
        return
    omega, g, dt = log.twist[:-1, 3:], log.gravity, np.diff(log.time)
    expected = -np.cross(0.5 * (omega + log.twist[1:, 3:]), 0.5 * (g[1:] + g[:-1])) * dt[:, None]
    known = np.isfinite(expected).all(axis=1) & (dt < _NEXT)
    noise = float(np.max(rig.motion.noise_array[3:]))
    if not known.any() or np.sqrt(np.mean(omega[known] ** 2)) < _CLEARLY * noise:
        return
    size = max(float(np.linalg.norm(rig.gravity_array)), 1e-9)
    change, expected = np.diff(g, axis=0)[known] / size, expected[known] / size
    path = float(np.linalg.norm(expected, axis=1).sum())
    if path < _FAR:
        return
    if float(np.linalg.norm(change, axis=1).sum()) < _FROZEN * path:
        found = f"a direction of gravity that stays while wx wy wz turn by {path:.3g} rad"
        raise InputError.at(log.path, "attitude", found, "the attitude of every row (frozen?)")
    share = float(np.sum(change * expected) / np.sum(expected**2))
    left = float(np.sum((change - share * expected) ** 2) / np.sum(change**2))
    if _DEGREES[0] < share < _DEGREES[1] and left < _LIKE:
        found = f"{1.0 / share:.3g} times the attitude's rate of turn"
        raise InputError.at(log.path, "wx wy wz", found, "rad/s (degrees?)")
