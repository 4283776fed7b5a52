"""Arms that come with the package: URDF files without meshes, and a rig for each (docs/robots.md)."""

import difflib
from pathlib import Path

from truewrench.model.errors import InputError

NAMES = ("ssrms", "spdm", "panda", "panda_ground", "ur10", "ur10_ground")
"""Rigs of arms that carry a known payload, for calibrations,"""

TOOL_RIGS = ("panda_tool", "fr3_tool", "ur10_tool", "ur3e_tool", "ur5e_tool", "ur10e_tool")
"""and of arms in the laboratory that carry nobody knows what."""


def path(name: str) -> Path:
    """The rig file of a packaged arm; its URDF lies beside it.

    Raises:
        InputError: there is no such arm; the nearest is named.
    """
    known = NAMES + TOOL_RIGS
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise InputError(f"no packaged arm `{name}` (nearest: `{near}`), expected one of: {', '.join(known)}")
    return Path(__file__).parent / f"{name}.yaml"
