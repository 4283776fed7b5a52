"""Logs of unknown tools on packaged arms, which MuJoCo moves: planned poses, and a motion."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tool_draws import walk_of

from truewrench import robots
from truewrench.model.log import Log
from truewrench.model.rig import Rig, load_rig
from truewrench.model.rig.tool_rig import UNKNOWN, load_tool_rig, tool_rig
from truewrench.planning.tool.plan import plan_tool
from truewrench.robot.track import track
from truewrench.simulation.arm import simulate_plan
from truewrench.tool.parameters import ELEMENTS, Layout, channel_turn, inertia_of, tilted

Array = NDArray[np.float64]
ARMS = ("panda_ground", "ur10_ground", "ur3e_tool", "ur5e_tool", "ur10e_tool", "fr3_tool")
POSES, DWELL, SECONDS = 8, 2.5, 10.0
RATE = 100  # [Hz] of joints and sensor
PAUSE = 10**10  # [ns] between the logs
LAYOUT = Layout(6)


def rig_of(arm: str, gain_prior: float) -> Rig:
    """The arm's rig as the owner of an unknown tool has it; nothing pulls that a discrepancy stands for."""
    path = robots.path(arm)
    data = (load_tool_rig if arm.endswith("_tool") else load_rig)(path).to_mapping()
    data["sensor"] |= {"gain_prior": gain_prior, "discrepancy": 0}
    data["plan"]["duration"] = SECONDS
    data["simulate"] = {"rate": RATE, "sensor_rate": RATE}
    return tool_rig(data, path)


@cache
def planned(arm: Path) -> str:
    """The plan of poses of an arm, as text."""
    rig = rig_of(arm.stem, 0.02)
    with tempfile.TemporaryDirectory() as folder:
        path = plan_tool(rig, poses=POSES, dwell=DWELL).write(Path(folder) / "plan.csv")[0]
        return path.read_text(encoding="utf-8")


def logs(rng: np.random.Generator, rig: Rig, theta: Array, data: str) -> list[Log]:
    """Poses with the moves between them, or a motion, or both, of the tool that theta holds.

    Theta gets the offset at the end of the last.
    """
    kinds = ("poses", "motion") if data == "both" else (data,)
    real = _real(rng, rig, theta)
    out: list[Log] = []
    for kind in kinds:
        with tempfile.TemporaryDirectory() as folder:
            plan = Path(folder) / "plan.csv"
            if kind == "poses":
                assert rig.path is not None
                plan.write_text(planned(rig.path), encoding="utf-8")
            run = simulate_plan(real, plan if kind == "poses" else None, seed=int(rng.integers(2**31)))
        offset = rig.sensor.offset_prior_array * rng.normal(size=6)
        raw = run.log.raw + offset + _walk(rng, rig, run.log.time)
        begin = int(out[-1].time_ns[-1]) + PAUSE if out else 0
        log = replace(run.log, raw=raw, time_ns=run.log.time_ns + begin, payload=UNKNOWN)
        out.append(track(rig, replace(log, tracking=None, twist=None, gravity=None)))
        theta[LAYOUT.offset] = offset
    return out


def _walk(rng: np.random.Generator, rig: Rig, time: Array) -> Array:
    """(N, 6) of an offset, zero at the end [raw units]."""
    steps = rng.normal(size=(time.size, 6)) * np.sqrt(np.diff(time, prepend=time[0]))[:, None]
    walked = walk_of(rng) * rig.sensor.channel_scale * np.cumsum(steps, axis=0)
    return np.asarray(walked - walked[-1])


def _real(rng: np.random.Generator, rig: Rig, theta: Array) -> Rig:
    """The rig that is simulated: true body, gain in sensor axes, gravity and clock."""
    data, mass = rig.to_mapping(), float(np.exp(theta[LAYOUT.log_mass]))
    inertia = inertia_of(mass, theta[LAYOUT.S]).tolist()
    data["payloads"] = {
        "true": {
            "mass": mass,
            "center_of_mass": theta[LAYOUT.center_of_mass].tolist(),
            "inertia": dict(zip(ELEMENTS, inertia, strict=True)),
        }
    }
    R6 = np.kron(np.eye(2), channel_turn(theta[LAYOUT.mounting])[0])
    clock = rig.sensor.time_offset_prior * float(rng.normal())
    data["simulate"] |= {
        "offset": "none",
        "gain": (theta[LAYOUT.gain].reshape(6, 6) @ R6).tolist(),
        "time_offset": clock,
    }
    data["gravity"] = tilted(rig.gravity_array, theta[LAYOUT.tilt])[0].tolist()
    return Rig.from_mapping(data, rig.path)
