"""Recalibrate a robot's six-axis force/torque sensor in place, from the motion of a known payload.

import truewrench as tw
rig = tw.load_rig("rig.yaml")
log = tw.read_log("run.csv", rig)
calibration = tw.calibrate(rig, log)
wrench = calibration.wrench(log.raw)  # (N, 6)
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from truewrench import model

if TYPE_CHECKING:
    from truewrench import robots
    from truewrench.calibrating.pipeline import calibrate
    from truewrench.estimation.evidence import Evidence
    from truewrench.io.exports import write_exports
    from truewrench.io.tables import read_log
    from truewrench.judging.validation import Validation, validate
    from truewrench.model.calibration import Calibration, Verdict, load_calibration
    from truewrench.model.errors import InputError, TruewrenchError, UnsupportedError
    from truewrench.model.log import Log
    from truewrench.model.rig import Rig, load_rig
    from truewrench.model.rig.ati_cal import AtiCalibration, read_ati_cal
    from truewrench.model.rig.tool_rig import load_tool_rig
    from truewrench.planning.planner import plan
    from truewrench.planning.result import Plan
    from truewrench.report.page import write_report
    from truewrench.simulation.arm import simulate_arm
    from truewrench.simulation.free_body import simulate
    from truewrench.simulation.truth import read_truth
    from truewrench.tool.identify import identify_tool
    from truewrench.tool.model import Tool
    from truewrench.tool.reading import read_tool

__version__ = version("truewrench")

_MODULES = {"robots"}  # `tw.robots.path(NAME)`: the file of a packaged arm

_HOMES = {
    "AtiCalibration": "model.rig.ati_cal",
    "Calibration": "model.calibration",
    "Evidence": "estimation.evidence",
    "InputError": "model.errors",
    "Log": "model.log",
    "Plan": "planning.result",
    "Rig": "model.rig",
    "Tool": "tool.model",
    "TruewrenchError": "model.errors",
    "UnsupportedError": "model.errors",
    "Validation": "judging.validation",
    "Verdict": "model.calibration",
    "calibrate": "calibrating.pipeline",
    "identify_tool": "tool.identify",
    "load_calibration": "model.calibration",
    "load_rig": "model.rig",
    "load_tool_rig": "model.rig.tool_rig",
    "plan": "planning.planner",
    "read_ati_cal": "model.rig.ati_cal",
    "read_log": "io.tables",
    "read_tool": "tool.reading",
    "read_truth": "simulation.truth",
    "simulate": "simulation.free_body",
    "simulate_arm": "simulation.arm",
    "validate": "judging.validation",
    "write_exports": "io.exports",
    "write_report": "report.page",
}

__all__ = [
    "AtiCalibration",
    "Calibration",
    "Evidence",
    "InputError",
    "Log",
    "Plan",
    "Rig",
    "Tool",
    "TruewrenchError",
    "UnsupportedError",
    "Validation",
    "Verdict",
    "__version__",
    "calibrate",
    "identify_tool",
    "load_calibration",
    "load_rig",
    "load_tool_rig",
    "plan",
    "read_ati_cal",
    "read_log",
    "read_tool",
    "read_truth",
    "robots",
    "simulate",
    "simulate_arm",
    "validate",
    "write_exports",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """Import a public name on its first use: `import truewrench` alone loads neither SciPy nor the core."""
    if name in _MODULES:  # the import sets the attribute
        return import_module(f"{__name__}.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def _contact(*arguments: Any, **options: Any) -> Any:
    return import_module(f"{__name__}.correction.contact.log").contact(*arguments, **options)


model.contact = _contact
