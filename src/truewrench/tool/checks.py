"""Logs and statements that cannot be right, refused before anything is estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from truewrench.errors import InputError
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.tool.parameters import ELEMENTS

__all__ = ["KNOWN", "check_known", "check_logs"]

KNOWN = ("mass", *(f"center_of_mass.{axis}" for axis in "xyz"), *(f"inertia.{name}" for name in ELEMENTS))
"""What may be stated of a tool."""

_OTHER_GRAVITY = 0.02  # of its size: no drift of an accelerometer, but another planet or unit
_TURNS = 4.0 * np.pi  # [rad] no joint of an arm is beyond
_FASTEST = 40.0  # [rad/s]


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


def check_logs(rig: Rig, logs: Sequence[Log]) -> None:
    """Refuse units of degrees, and free fall of another size than the rig's."""
    stated = float(np.linalg.norm(rig.gravity_array))
    if stated == 0.0 and not any(log.twist is not None or log.position is not None for log in logs):
        raise InputError.at(rig.path, "gravity", "0", "gravity, which poses need")
    for log in logs:
        if log.gravity is not None and log.attitude is None and rig.motion.source != "joints":
            size = float(np.nanmedian(np.linalg.norm(log.gravity, axis=1)))
            if abs(size - stated) > _OTHER_GRAVITY * max(stated, 1.0):
                expected = f"{stated:.4g} m/s^2, the size of the rig's `gravity`"
                raise InputError.at(log.path, "gx gy gz", f"free fall of {size:.4g} m/s^2", expected)
        turned = None if log.position is None else np.nanmax(np.abs(log.position), initial=0.0)
        if turned is not None and turned > _TURNS and rig.motion.source == "joints":
            raise InputError.at(log.path, "q_*", f"a joint at {turned:.4g}", "radians (degrees?)")
        omega = log.angular_velocity if log.twist is None else log.twist[:, 3:]
        fastest = 0.0 if omega is None else float(np.nanmax(np.abs(omega), initial=0.0))
        if fastest > _FASTEST:
            raise InputError.at(log.path, "wx wy wz", f"a turn of {fastest:.4g}", "rad/s (degrees?)")
