"""Commands about the motion: plan it, follow it, simulate it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from truewrench.cli.common import (
    DebugOption,
    JsonOption,
    Outcome,
    OutputLogOption,
    RigArgument,
    check_output,
    progress_bar,
)
from truewrench.model.errors import InputError

if TYPE_CHECKING:
    from truewrench.simulation.arm import ArmRun
    from truewrench.simulation.free_body import SimulatedRun


def plan(
    rig: RigArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="PLAN", help="CSV, or Parquet by its name.")
    ],
    method: Annotated[
        Literal["optimal", "wrench"], typer.Option(help="wrench: sinusoidal forces and moments.")
    ] = "optimal",
    criterion: Annotated[
        Literal["A", "D"], typer.Option(help="A: RMS sigma of the gains; D: volume of their region.")
    ] = "A",
    payload: Annotated[str | None, typer.Option(help="Payload carried; the first of the rig.")] = None,
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Motion, limits, promise and path as PNG.")
    ] = True,
    tool: Annotated[bool, typer.Option("--tool", help="What determines an unknown tool: poses.")] = False,
    motion: Annotated[
        bool, typer.Option("--motion", help="With --tool: a motion, which tells inertia.")
    ] = False,
    poses: Annotated[int | None, typer.Option(help="With --tool: how many; 12 unless stated.")] = None,
    dwell: Annotated[float | None, typer.Option(help="With --tool: seconds at each pose; 3.")] = None,
    cone: Annotated[
        float | None, typer.Option(help="With --tool: largest tilt of gravity from the start, degrees; 180.")
    ] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Plan a motion that calibrates well within the rig's limits, and say what it promises.

    With --tool: poses, or a motion, that determine an unknown tool.
    """
    check_output(output, rig)
    check_output(output.with_name(f"{output.name}.plan.yaml"), rig, table=False)
    options = {"--motion": motion or None, "--poses": poses, "--dwell": dwell, "--cone": cone}
    if tool:
        if method != "optimal" or criterion != "A":
            raise InputError.at(
                None, "--tool", "--method or --criterion", "neither: poses are not searched for"
            )
        for option in ("--poses", "--dwell", "--cone"):
            if motion and options[option] is not None:
                raise InputError.at(None, option, "it beside --motion", "poses, which it belongs to")
        from truewrench.cli.tools import plan_for_tool

        return plan_for_tool(rig, output, payload, motion, poses, dwell, cone, pictures)
    for option, value in options.items():
        if value is not None:
            raise InputError.at(None, option, "it without --tool", "--tool, which it belongs to")
    if method == "wrench" and criterion != "A":
        raise InputError.at(
            None, "--criterion", f"`{criterion}`", "none: sines of the wrench are not searched by it"
        )
    from truewrench.model.rig import load_rig
    from truewrench.planning.planner import plan as run
    from truewrench.planning.words import plan_words

    settings = load_rig(rig)
    settings.check_motion("which a plan is made for")
    with progress_bar() as update:
        planned = run(settings, method, criterion=criterion, payload=payload, progress=update)
    figures = planned.to_mapping()
    outputs = planned.write(output)
    if pictures:
        from truewrench.planning.pictures import draw_plan

        outputs += draw_plan(planned, output)
    return Outcome(
        outputs=outputs,
        verdict=figures.pop("verdict"),
        figures=figures,
        words=lambda: plan_words(planned),
    )


def follow(
    rig: RigArgument,
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Table of the planned twist, vx ... wz.")],
    output: OutputLogOption,
    of: Annotated[
        Literal["com", "sensor"], typer.Option(help="The point that the plan moves: mass or sensor.")
    ] = "com",
    payload: Annotated[str | None, typer.Option(help="Payload carried; the first of the rig.")] = None,
    rate: Annotated[float, typer.Option(min=1.0, max=1e6, help="Commands a second.")] = 100.0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Turn a planned twist into motions of an arm's joints, within their limits."""
    from truewrench.model.rig import load_rig
    from truewrench.planning.follow import follow_plan

    check_output(output, rig, plan)
    settings = load_rig(rig)
    settings.check_motion("which is to follow the plan")
    done = follow_plan(settings, plan, of=of, payload=payload, rate=rate)
    reasons = done.reasons
    return Outcome(
        outputs=done.write(output),
        verdict={"usable": not reasons, "reasons": reasons},
        figures={"linear_error": done.linear, "angular_error": done.angular},
        words=lambda: iter(
            [
                f"the sensor follows to {done.motion.position_error.max():.1e} m",
                *(f"not to be used as it stands: {reason}" for reason in reasons),
            ]
        ),
    )


def simulate(
    rig: RigArgument,
    output: OutputLogOption,
    plan: Annotated[Path | None, typer.Argument(metavar="[PLAN]", help="Table of the motion.")] = None,
    payload: Annotated[str | None, typer.Option(help="Payload carried; the first of the rig.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the rig's `simulate.seed`.")] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Simulate a log, and write its truth beside it."""
    from truewrench.model.rig import load_rig

    check_output(output, rig, plan)
    check_output(output.with_name(f"{output.name}.truth.yaml"), rig, plan, table=False)
    settings = load_rig(rig)
    simulated: ArmRun | SimulatedRun
    if settings.motion.source == "joints":
        from truewrench.simulation.arm import simulate_plan

        simulated = simulate_plan(settings, plan, payload=payload, seed=seed)
    else:
        from truewrench.io.plans import read_plan
        from truewrench.simulation.free_body import simulate as run

        simulated = run(settings, None if plan is None else read_plan(plan), payload=payload, seed=seed)
    log, truth = simulated.write(output)
    rows, imperfect = len(simulated.log.time_ns), list(simulated.truth.imperfections)
    said = [f"{rows} rows with `{simulated.log.payload}`, and what they were made with"]
    said += [f"on imperfect hardware: {', '.join(imperfect)}"] if imperfect else []
    figures = {"rows": rows, "duration": float(simulated.log.time[-1]), **simulated.figures()}
    return Outcome(
        outputs=[log, truth],
        figures=figures | ({"imperfections": imperfect} if imperfect else {}),
        words=lambda: iter(said),
    )
