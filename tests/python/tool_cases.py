"""Tools for tests: made up ones, and logs of poses and motions of a known body."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench.rig.tool_rig import tool_rig
from truewrench.tool.model import Body, HeldOut, Tool, ToolVerdict, Unknown
from truewrench.tool.parameters import Layout, inertia_of

Array = NDArray[np.float64]

SENSOR: dict[str, Any] = {
    "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
    "feels": "payload_on_sensor",
    "noise": [0.1, 0.1, 0.1, 0.005, 0.005, 0.005],
    "range": [100, 100, 100, 10, 10, 10],
}


def a_rig(**changes: Any) -> dict[str, Any]:
    """A rig without payloads, in gravity."""
    sensor = {**SENSOR, **changes.pop("sensor", {})}
    return {"sensor": sensor, "gravity": [0, 0, -9.81], **changes}


def a_tool(seed: int = 0) -> Tool:
    """A tool whose numbers agree with each other, and mean nothing."""
    rng, layout = np.random.default_rng(seed), Layout(6)
    root = rng.normal(size=(layout.size, layout.size)) * 0.01
    covariance = root @ root.T
    covariance = 0.5 * (covariance + covariance.T)
    std = np.sqrt(np.diag(covariance))
    mass, S = 2.0, np.array([0.004, 0.003, 0.002, 1e-4, -2e-4, 3e-4])
    return Tool(
        mass=mass,
        mass_std=mass * std[layout.log_mass],
        center_of_mass=np.array([0.01, -0.02, 0.09]),
        center_of_mass_std=std[layout.center_of_mass],
        inertia=inertia_of(mass, S),
        inertia_std=np.full(6, 1e-4),
        determined={"mass": True, "center_of_mass": (True,) * 3, "inertia": (True, True, False) * 2},
        offset=rng.normal(size=6),
        offset_std=std[layout.offset],
        offset_time_ns=123_456_789_012,
        offset_walk=np.full(6, 1e-3),
        pose_repeatability=np.full(6, 2e-3),
        mounting=np.array([0.01, -0.02, 0.03]),
        mounting_std=std[layout.mounting],
        tilt=np.array([1e-3, -2e-3]),
        tilt_std=std[layout.tilt],
        gain=np.eye(6) + 0.01 * rng.normal(size=(6, 6)),
        covariance=covariance,
        exported=Body(mass, np.array([0.01, -0.02, 0.09]), inertia_of(mass, S)),
        verdict=ToolVerdict(True, (), (Unknown("inertia", "words"),), ("weigh it",)),
        rig=tool_rig(a_rig()),
        held_out=HeldOut(0.1, 0.01, 0.5, 0.05),
        logs=({"path": "poses.csv", "sha256": "", "poses": 12},),
        figures={"chi_square": 1.0},
        version="0",
        created="2026-01-01T00:00:00+00:00",
    )
