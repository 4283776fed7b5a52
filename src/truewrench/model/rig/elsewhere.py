"""A rig inside another file, whose folder its relative paths are then relative to."""

import os
from pathlib import Path
from typing import Any

from truewrench.model.rig import Rig


def within(mapping: dict[str, Any], rig: Rig, path: str | Path) -> dict[str, Any]:
    """The mapping of a rig, or part of it, as a file at `path` may hold it: its URDF is named from there.

    It is left as it is; without a file of the rig's own paths stay as they are.
    """
    robot, urdf = rig.motion.robot, rig.urdf_path
    if robot is None or urdf is None or rig.path is None or Path(robot.urdf).is_absolute():
        return mapping
    try:
        found = os.path.relpath(urdf.resolve(), Path(path).resolve().parent)
    except ValueError:  # another drive
        found = str(urdf.resolve())
    motion = {**mapping["motion"], "robot": {**mapping["motion"]["robot"], "urdf": Path(found).as_posix()}}
    return {**mapping, "motion": motion}
