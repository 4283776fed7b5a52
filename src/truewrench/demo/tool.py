"""An unknown gripper on an arm: plan poses, record, identify, export, and feel a press in motion."""

import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from truewrench import robots
from truewrench.correction.contact.apply import apply_contact
from truewrench.correction.contact.log import contact as contact_of
from truewrench.correction.contact.run import ContactEvent
from truewrench.io.tables import read_log
from truewrench.model.arrays import Array
from truewrench.model.files import atomic_output
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import load_tool_rig
from truewrench.planning.tool.pictures import draw_tool_plan
from truewrench.planning.tool.plan import ToolPlan, plan_tool
from truewrench.report.figures.tool import body_figure, contact_figure
from truewrench.simulation.arm import ArmRun, simulate_arm, simulate_plan
from truewrench.simulation.effects import half_sine
from truewrench.tool.exports import TARGETS, write_tool_exports
from truewrench.tool.identify import Evidence, identify_tool
from truewrench.tool.model import Tool
from truewrench.tool.page import write_page
from truewrench.tool.parameters import COLUMNS, ELEMENTS, ROWS
from truewrench.tool.words import tool_summary

ARM = "panda_tool"
GRIPPER: dict[str, Any] = {
    "mass": 1.37,
    "center_of_mass": [0.004, -0.006, 0.085],
    "inertia": {"xx": 0.006, "yy": 0.0055, "zz": 0.0022, "xy": 0.0, "xz": 0.0, "yz": 0.0},
}
"""The gripper that nobody knows: 1.37 kg, its centre of mass 85 mm out of the flange."""

FINGERTIP = np.array([0.01, 0.0, 0.17])  # [m] where it is pressed, sensor axes
PRESS = np.array([3.0, -2.0, -8.0])  # [N] at the peak, sensor axes

_START, _SECONDS = 0.45, 1.5  # share of the record, and [s], of the press
_FLANGE = np.array([0.0, 0.0, 0.03, 0.0, 0.0, np.pi / 4.0])
_HOUSING = np.array([0.25, 0.0, 0.0, -0.015])
_PAUSE = 20.0  # [s] between the records


@dataclass(frozen=True, slots=True)
class Size:
    """How much is done."""

    poses: int = 8  # that are planned
    dwell: float = 2.5  # at each [s]
    record: float = 10.0  # length of the record with the press [s]


def run_tool(
    output: Path,
    seed: int = 0,
    progress: Callable[[str, float | None], None] | None = None,
    size: Size = Size(),
) -> dict[str, Any]:
    """Run the whole way of a tool, and write every file, picture and a page into a folder.

    Rig and URDF are copied into it. Returns `outputs`: the files; `figures`: numbers by name; `verdict`;
    `text`: for a person.
    """
    tell = progress or (lambda phase, share: None)
    output.mkdir(parents=True, exist_ok=True)
    rig, real = _rigs(output, seed, size)
    tell("poses", None)
    plan = plan_tool(rig, poses=size.poses, dwell=size.dwell)
    files = [output / "rig.yaml", *plan.write(output / "plan.csv")]
    pictures = draw_tool_plan(plan, output / "plan.csv")
    tell("the arm moves", None)
    run = simulate_plan(real, files[1], seed=seed)
    files += run.write(output / "poses.csv")
    tell("identification", None)
    evidence: list[Evidence] = []
    tool = identify_tool(
        rig, read_log(output / "poses.csv", rig), flange=_FLANGE, housing=_HOUSING, evidence=evidence.append
    )
    tool.write_yaml(output / "tool.yaml")
    write_page(output / "tool.html", tool, evidence[0])
    files += [output / "tool.yaml", output / "tool.html", *write_tool_exports(tool, list(TARGETS), output)]
    tell("a press", None)
    pressed, true = _pressed(real, run, seed)
    files += pressed.write(output / "press.csv")
    applied = apply_contact(tool, output / "press.csv", output / "contact.csv")
    files.append(output / "contact.csv")
    tell("figures", None)
    figures = _figures(plan, run, tool, applied.events, size)
    pictures += [output / "tool.png", output / "contact.png"]
    _draw_body(pictures[-2], plan, run, tool)
    _draw_contact(pictures[-1], rig, output / "press.csv", tool, true, applied.events, figures)
    verdict = {"usable": plan.feasible and tool.verdict.usable,
               "reasons": [*plan.violations, *tool.verdict.reasons]}  # fmt: skip
    outputs = [str(file) for file in [*files, *pictures]]
    return {"outputs": outputs, "figures": figures, "verdict": verdict, "text": _text(plan, tool, figures)}


def _rigs(output: Path, seed: int, size: Size) -> tuple[Rig, Rig]:
    """The rig as its owner has it, without payloads, and the one that the arm is simulated with."""
    source = robots.path(ARM)
    data = yaml.safe_load(source.read_text(encoding="utf-8"))
    urdf = source.with_name(data["motion"]["robot"]["urdf"])
    shutil.copyfile(urdf, output / urdf.name)
    data["simulate"] = {"rate": 50, "sensor_rate": 100, "seed": seed}
    data["plan"]["duration"] = size.record
    with atomic_output(output / "rig.yaml") as temporary:
        temporary.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    real = {**data, "payloads": {"gripper": GRIPPER}}
    real["simulate"] = {**data["simulate"], "imperfections": {"random_walk": 1e-4}}
    return load_tool_rig(output / "rig.yaml"), Rig.from_mapping(real, output / "rig.yaml")


def _pressed(real: Rig, run: ArmRun, seed: int) -> tuple[ArmRun, Array]:
    """A later record of the same sensor, in motion, and the wrench (N, 6) that someone pressed with."""
    walked = np.array(run.truth.imperfections["random_walk"]["end"]) * real.sensor.channel_scale
    data = real.to_mapping()
    data["simulate"] |= {"gain": run.truth.gain.tolist(), "offset": (run.truth.offset + walked).tolist()}
    moved = simulate_arm(Rig.from_mapping(data, real.path), seed=seed + 1)
    log, duration = moved.log, moved.trajectory.duration
    push = half_sine(log.time, _START * duration, _SECONDS)[:, None]
    true = real.sensor.sign * push * np.concatenate([PRESS, np.cross(FINGERTIP, PRESS)])
    later = int(run.log.time_ns[-1]) + round(_PAUSE * 1e9)
    log = replace(log, raw=log.raw + true @ run.truth.gain.T, time_ns=log.time_ns + later)
    return replace(moved, log=log), true


def _truth(run: ArmRun) -> tuple[float, Array, Array]:
    body = run.truth.payloads["gripper"]
    return body.mass, body.center_of_mass, body.inertia[ROWS, COLUMNS]


def _figures(
    plan: ToolPlan, run: ArmRun, tool: Tool, events: tuple[ContactEvent, ...], size: Size
) -> dict[str, Any]:
    mass, center, _ = _truth(run)
    found = plan.prediction
    longest = max(events, key=lambda event: event.end_ns - event.begin_ns, default=None)
    return {
        "mass": tool.mass,
        "mass_std": tool.mass_std,
        "mass_error": tool.mass - mass,
        "mass_std_promised": None if found is None else found.mass_std,
        "center_of_mass_error": (tool.center_of_mass - center).tolist(),
        "center_of_mass_std": tool.center_of_mass_std.tolist(),
        "held_out_force": tool.held_out.force,
        "recipe_held_out_force": tool.held_out.recipe_force,
        "events": len(events),
        "peak_force": None if longest is None else longest.peak_force,
        "pressed_with": float(np.linalg.norm(PRESS)),
        "point": None if longest is None else list(longest.point),
        "poses": size.poses,
    }


def _draw_body(path: Path, plan: ToolPlan, run: ArmRun, tool: Tool) -> None:
    mass, center, inertia = _truth(run)
    found, largest = plan.prediction, float(np.abs(inertia).max())
    assert found is not None
    names = ["mass, of itself", *(f"centre of mass {a}, of 10 mm" for a in "xyz")]
    errors = [(tool.mass - mass) / mass, *((tool.center_of_mass - center) / 0.01)]
    stated = [tool.mass_std / mass, *(tool.center_of_mass_std / 0.01)]
    promised = [found.mass_std / found.mass, *(found.center_of_mass_std / 0.01)]
    told = [k for k in range(6) if tool.determined["inertia"][k]]
    names += [f"inertia {ELEMENTS[k]}, of the largest" for k in told]
    errors += [(tool.inertia[k] - inertia[k]) / largest for k in told]
    stated += [tool.inertia_std[k] / largest for k in told]
    promised += [np.nan] * len(told)
    worst = float(np.max(np.abs(errors) / np.array(stated)))
    caption = (
        f"The gripper as found against the truth: {tool.mass:.4g} kg, 1 sigma {tool.mass_std:.2g} kg, where "
        f"{mass:g} kg is true. Grey: what the plan promised of the poses alone; orange: what the record, its "
        f"moves included, states. The largest error is {worst:.1f} sigma. Mass and the sensor's force scale "
        "cannot be told apart: weigh the gripper once, and both are known. Conclusion: "
        + ("nothing in this run speaks against sigma." if worst < 3.5 else "sigma is too small.")
    )
    body_figure(path, names, np.array(errors), np.array(stated), np.array(promised), caption)


def _draw_contact(
    path: Path,
    rig: Rig,
    log_path: Path,
    tool: Tool,
    true: Array,
    events: tuple[ContactEvent, ...],
    figures: dict[str, Any],
) -> None:
    log = read_log(log_path, rig)
    found = contact_of(log, tool)
    rows = np.isfinite(found.wrench).all(axis=1) & np.isfinite(log.raw).all(axis=1)
    time = log.time[rows]
    wrench, std = found.wrench[rows], np.sqrt(np.diagonal(found.covariance[rows], axis1=1, axis2=2))
    read = log.raw[rows] @ np.linalg.pinv(rig.sensor.nominal_gain_array).T
    idle = ~(np.abs(true[rows]) > 0.0).any(axis=1)
    left = float(np.sqrt(np.mean(wrench[idle, :3] ** 2)))
    tared = read - read[0]
    before = float(np.sqrt(np.mean(tared[idle, :3] ** 2)))
    figures |= {"contact_free_force": left, "tared_free_force": before}
    at = "no contact was found"
    if figures["point"] is not None:
        at = (
            f"{len(events)} contact{'s' * (len(events) != 1)} found, at most {figures['peak_force']:.3g} N "
            f"along a line through ({_millimetres(figures['point'])}) mm"
        )
    caption = (
        f"The arm moves, and someone presses the gripper with up to {figures['pressed_with']:.3g} N at "
        f"({_millimetres(FINGERTIP)}) mm. Left: the sensor, only tared at the start, reads {before:.2g} N "
        "(RMS an axis) where nothing touches. Right: with gripper, offset and gain as identified it reads "
        f"{left:.2g} N there; {at}. Conclusion: a press of a newton can be told from the "
        "gripper's own weight and inertia in any pose."
    )
    contact_figure(path, time, wrench, std, true[rows], tared, caption)


def _millimetres(point: Iterable[float]) -> str:
    return ", ".join(f"{1e3 * x:.0f}" for x in point)


def _text(plan: ToolPlan, tool: Tool, figures: dict[str, Any]) -> str:
    found, lines = plan.prediction, []
    if found is not None:
        lines.append(
            f"{len(plan.fall)} poses in {plan.design.motion.duration:.3g} s promise a mass to "
            f"{100.0 * found.mass_std / found.mass:.2g} % (1 sigma)"
        )
    lines += [tool_summary(tool), f"true mass {GRIPPER['mass']:g} kg: error {figures['mass_error']:+.3g} kg"]
    if figures["point"] is not None:
        lines.append(
            f"pressed with {figures['pressed_with']:.3g} N: found {figures['peak_force']:.3g} N, along a "
            f"line through ({_millimetres(figures['point'])}) mm"
        )
    lines.append(
        f"force where nothing touches: {figures['tared_free_force']:.2g} N tared, "
        f"{figures['contact_free_force']:.2g} N with the tool"
    )
    return "\n".join(lines) + "\n"
