"""A rig as the identification of an unknown tool reads it: payloads and `required` passed over."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.model.errors import InputError
from truewrench.model.files import read_yaml
from truewrench.model.rig import Rig
from truewrench.model.rig.strict import shown

UNKNOWN = "tool"  # name of the payload that stands for the tool nobody knows yet
GAIN_PRIOR = 0.02  # 1 sigma of every gain where neither a calibration nor `sensor.gain_prior` states one

TILT_PRIOR = float(np.radians(0.5))
"""[rad] 1 sigma of gravity's direction about two axes, where none is stated."""

_PLACEHOLDER = {"mass": 1.0, "center_of_mass": [0, 0, 0], "inertia": {"xx": 0.01, "yy": 0.01, "zz": 0.01}}
_MOTION = {"source": "twist", "of": "sensor", "noise": [1e-3] * 6}  # poses alone need no more


def tool_rig(data: Any, path: str | Path | None = None) -> Rig:
    """Validate settings for an unknown tool: one payload, a placeholder named `UNKNOWN`.

    A twist is that of the sensor's origin, stated or not: the point at an unknown centre of mass could not
    have been logged. `payloads`, `required` and `motion` may be absent; errors as of `Rig.from_mapping`.
    """
    if not isinstance(data, Mapping):
        raise InputError.at(path, "", shown(data), "a mapping with a sensor")
    motion = data.get("motion")
    if isinstance(motion, Mapping) and motion.get("of") == "com":
        expected = "`sensor`, or no `of`: the centre of mass of a tool that is not known cannot be logged"
        raise InputError.at(path, "motion.of", "`com`", expected)
    return Rig.from_mapping(_relaxed(data), path)


def load_tool_rig(path: str | Path) -> Rig:
    """Read and validate a rig file for an unknown tool."""
    data, _ = read_yaml(path)
    return tool_rig(data, path)


def _relaxed(data: Mapping[str, Any]) -> dict[str, Any]:
    out = {key: value for key, value in data.items() if key not in ("payloads", "required")}
    out["payloads"] = {UNKNOWN: _PLACEHOLDER}
    out.setdefault("motion", _MOTION)
    out.setdefault("gravity_tilt_prior", TILT_PRIOR)
    motion, sensor = out["motion"], out.get("sensor")
    if isinstance(motion, Mapping) and motion.get("source", "twist") == "twist":
        out["motion"] = {**motion, "of": "sensor"}
    if isinstance(sensor, Mapping) and "gain_prior" not in sensor:
        out["sensor"] = {**sensor, "gain_prior": GAIN_PRIOR}
    return out
