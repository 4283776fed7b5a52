"""Commands that try out everything at once."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from truewrench.cli.common import (
    DebugOption,
    JsonOption,
    Outcome,
    OutputFolderOption,
    RigArgument,
    check_folder,
    progress_bar,
)
from truewrench.model.errors import InputError


def demo(
    output: OutputFolderOption,
    arm: Annotated[
        str | None, typer.Option(metavar="ROBOT", help="A packaged arm, or a rig: plan, MuJoCo, calibrate.")
    ] = None,
    tool: Annotated[
        bool, typer.Option("--tool", help="An unknown gripper: poses, identification, a press.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of gain and noise.")] = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Run the case of the paper, a whole arm, or an unknown gripper, from motion to pictures."""
    check_folder(output)
    if tool and arm is not None:
        raise InputError.at(None, "--tool", "--arm beside it", "one of them: the gripper is on a Panda")
    with progress_bar() as update:
        if tool:
            from truewrench.demo.tool import run_tool

            result = run_tool(output, seed=seed, progress=update)
        elif arm is not None:
            from truewrench.demo.arm import run_arm

            result = run_arm(arm, output, seed=seed, progress=update)
        else:
            from truewrench.demo import run

            result = run(output, seed=seed, progress=lambda phase: update(phase, None))
    return Outcome(
        outputs=result["outputs"],
        figures=result["figures"],
        verdict=result.get("verdict"),
        words=lambda: iter([result["text"]]),
    )


def campaign(
    rig: RigArgument,
    trials: Annotated[int, typer.Option(min=1, help="Simulated calibrations.")],
    output: OutputFolderOption,
    plan: Annotated[Path | None, typer.Argument(metavar="[PLAN]", help="Table of the motion.")] = None,
    estimator: Annotated[
        Literal["map", "online", "ekf", "ls"], typer.Option(help="map, online; ekf and ls are references.")
    ] = "map",
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn.")] = 0,
    processes: Annotated[int | None, typer.Option(min=1, help="All cores; no effect on the rows.")] = None,
    restart: Annotated[bool, typer.Option("--restart", help="Drop another campaign in DIR.")] = False,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Simulate and calibrate many times: accuracy, honesty, time. A rerun goes on where it stood."""
    from truewrench.campaign.run import campaign as run
    from truewrench.campaign.statistics import campaign_words
    from truewrench.campaign.trial import Planned
    from truewrench.io.plans import read_joint_plan, read_plan
    from truewrench.model.rig import load_rig

    check_folder(output)
    settings = load_rig(rig)
    trajectory: Planned | None = None
    if plan is not None and settings.motion.source == "joints":
        from truewrench.robot.arm import robot_of

        trajectory = read_joint_plan(plan, robot_of(settings).joints)
    elif plan is not None:
        trajectory = read_plan(plan)
    with progress_bar() as update:
        result = run(
            settings,
            trials,
            output,
            estimator,
            seed,
            processes,
            update,
            trajectory=trajectory,
            restart=restart,
        )
    return Outcome(
        outputs=result.outputs,
        verdict=result.summary["verdict"],
        figures=result.summary,
        words=lambda: campaign_words(result),
    )
