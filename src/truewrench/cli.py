"""The command line: parse, call, print, exit status.

0 done and usable; 1 internal fault; 2 bad input, settings or an unsupported combination, nothing written;
3 a result is written but is not to be used as it stands.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from truewrench.errors import InputError

if TYPE_CHECKING:
    from truewrench.arm_simulation import ArmRun
    from truewrench.calibration import Calibration
    from truewrench.simulate import SimulatedRun

__all__ = ["app", "main"]

app = typer.Typer(
    name="truewrench",
    help="Recalibrate a robot's six-axis force/torque sensor in place, from the motion of a known payload.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


_INTERRUPTED = 130  # what a shell says of a program that Ctrl-C ended


@dataclass(frozen=True)
class Outcome:
    """What a command did: files, figures and verdict for programs, words for people."""

    outputs: Sequence[str | Path] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    verdict: Mapping[str, Any] | None = None
    words: Callable[[], Iterator[RenderableType]] = lambda: iter(())

    @property
    def status(self) -> int:
        """3 when a verdict forbids the use of what was written."""
        return 0 if self.verdict is None or self.verdict["usable"] else 3


# Read by `main` from the command line itself, so that they hold for errors in its other options, too.
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show where in the program a fault arose.")]
RigArgument = Annotated[Path, typer.Argument(metavar="RIG", help="YAML file of sensor, payloads and motion.")]
OutputFolderOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the results.")
]
OutputLogOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="FILE", help="CSV, or Parquet by its name.")
]
LogsArgument = Annotated[list[str], typer.Argument(metavar="LOG...", help="CSV or Parquet; LOG@PAYLOAD.")]


def _version(wanted: bool) -> None:
    if wanted:
        print(version("truewrench"))  # noqa: T201
        raise typer.Exit


@app.callback()
def _root(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def demo(
    output: OutputFolderOption,
    arm: Annotated[
        str | None, typer.Option(metavar="ROBOT", help="A packaged arm, or a rig: plan, MuJoCo, calibrate.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of gain and noise.")] = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Run the case of the paper, or a whole arm, from motion to pictures."""
    _check_folder(output)
    with _progress() as update:
        if arm is not None:
            from truewrench.demo_arm import run_arm

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


@app.command()
def calibrate(
    rig: RigArgument,
    logs: LogsArgument,
    output: OutputFolderOption,
    estimator: Annotated[
        Literal["map", "online", "ekf", "ls"], typer.Option(help="map, online; ekf and ls are references.")
    ] = "map",
    published: Annotated[bool, typer.Option("--published", help="ekf: start from P = I in SI.")] = False,
    smooth: Annotated[Literal["spline"] | None, typer.Option(help="ls: differentiate a spline.")] = None,
    window: Annotated[float | None, typer.Option(min=0.0, help="Length of a window of motion [s].")] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="No effect on the result.")] = None,
    process_density: Annotated[float | None, typer.Option(min=0.0, help="ekf: of the acceleration.")] = None,
    rescale_noise: Annotated[
        bool, typer.Option("--rescale-noise", help="Take the noise of sensor and motion from the residuals.")
    ] = False,
    held_out: Annotated[
        bool,
        typer.Option("--held-out/--no-held-out", help="Compare with the nominal gain on unseen data."),
    ] = True,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Calibrate gain and offset from one or more logs."""
    from truewrench.io.tables import read_log
    from truewrench.pipeline import calibrate as run
    from truewrench.rig import load_rig
    from truewrench.summary import calibration_summary

    _check_folder(output)
    settings = load_rig(rig)
    with _progress() as update:
        records = [read_log(log, settings) for log in logs]
        calibration = run(
            settings,
            records,
            estimator,
            window=window,
            threads=threads,
            held_out=held_out,
            rescale_noise=rescale_noise,
            published=published,
            smooth=smooth,
            process_density=process_density,
            progress=update,
        )
    target = output / "calibration.yaml"
    calibration.write_yaml(target)
    for record in records:
        _report_left_out(record.path, record.dropped_rows, record.nan_counts)
    return Outcome(
        outputs=[target],
        verdict=_verdict(calibration),
        figures={
            "gain": calibration.gain,
            "gain_std": calibration.gain_std,
            "offset": calibration.offset,
            "offset_std": calibration.offset_std,
            "bound": calibration.bound,
            "improvement": calibration.improvement,
            "fit": calibration.figures,
            "timings": calibration.timings,
            "dropped_rows": {str(record.path): record.dropped_rows for record in records},
            "nan_counts": {str(record.path): record.nan_counts for record in records},
        },
        words=lambda: calibration_summary(calibration),
    )


@app.command()
def validate(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="A calibration.yaml.")],
    rig: RigArgument,
    logs: LogsArgument,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder of validation.yaml.")
    ] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Judge a calibration by logs it was not made with: is it better than the nominal gain?"""
    from truewrench.calibration import load_calibration
    from truewrench.io.tables import read_log
    from truewrench.rig import load_rig
    from truewrench.summary import validation_summary
    from truewrench.validation import validate as run

    if output is not None:
        _check_folder(output)
    loaded, settings = load_calibration(calibration), load_rig(rig)
    with _progress() as update:
        records = [read_log(log, settings) for log in logs]
        update("validating", None)
        validation = run(loaded, settings, records)
    for record in records:
        _report_left_out(record.path, record.dropped_rows, record.nan_counts)
    outputs = [] if output is None else [output / "validation.yaml"]
    for target in outputs:
        validation.write_yaml(target)
    figures = validation.to_mapping()
    return Outcome(
        outputs=outputs,
        verdict=figures.pop("verdict"),
        figures=figures,
        words=lambda: validation_summary(validation),
    )


@app.command()
def apply(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="A calibration.yaml.")],
    log: Annotated[str, typer.Argument(metavar="LOG", help="CSV or Parquet.")],
    output: OutputLogOption,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Write a log with the true wrench and its 1 sigma added."""
    from truewrench.apply import apply as run
    from truewrench.calibration import load_calibration

    loaded = load_calibration(calibration)
    with _progress() as update:
        done = run(loaded, log, output, progress=lambda rows: update(f"{rows} rows", None))
    return Outcome(
        outputs=[output],
        verdict=_verdict(loaded),
        figures={"rows": done.rows, "corrected": done.corrected},
        words=lambda: iter(
            [
                f"{output}: {done.corrected} of {done.rows} rows with the true wrench",
                *(f"not to be used as it stands: {reason}" for reason in loaded.verdict.reasons),
            ]
        ),
    )


@app.command()
def inspect(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="CSV or Parquet.")],
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Show what is in a log: streams, rates, gaps, ranges."""
    from truewrench.inspect_log import inspect_log
    from truewrench.summary import log_summary

    content = inspect_log(log)
    return Outcome(figures=dataclasses.asdict(content), words=lambda: log_summary(content))


@app.command()
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
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Plan a motion that calibrates well within the rig's limits, and say what it promises."""
    from truewrench.planning.planner import plan as run
    from truewrench.planning.words import plan_words
    from truewrench.rig import load_rig

    settings = load_rig(rig)
    with _progress() as update:
        planned = run(settings, method, criterion=criterion, payload=payload, progress=update)
    figures = planned.to_mapping()
    return Outcome(
        outputs=planned.write(output),
        verdict=figures.pop("verdict"),
        figures=figures,
        words=lambda: plan_words(planned),
    )


@app.command()
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
    from truewrench.rig import load_rig

    settings = load_rig(rig)
    simulated: ArmRun | SimulatedRun
    if settings.motion.source == "joints":
        from truewrench.arm_simulation import simulate_plan

        simulated = simulate_plan(settings, plan, payload=payload, seed=seed)
    else:
        from truewrench.io.plans import read_plan
        from truewrench.simulate import simulate as run

        simulated = run(settings, None if plan is None else read_plan(plan), payload=payload, seed=seed)
    log, truth = simulated.write(output)
    rows = len(simulated.log.time_ns)
    return Outcome(
        outputs=[log, truth],
        figures={"rows": rows, "duration": float(simulated.log.time[-1]), **simulated.figures()},
        words=lambda: iter([f"{rows} rows with `{simulated.log.payload}`, and what they were made with"]),
    )


@app.command()
def follow(
    rig: RigArgument,
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Table of the planned twist, vx ... wz.")],
    output: OutputLogOption,
    of: Annotated[
        Literal["com", "sensor"], typer.Option(help="The point that the plan moves: mass or sensor.")
    ] = "com",
    payload: Annotated[str | None, typer.Option(help="Payload carried; the first of the rig.")] = None,
    rate: Annotated[float, typer.Option(min=1.0, help="Commands a second [Hz].")] = 100.0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Turn a planned twist into motions of an arm's joints, within their limits."""
    from truewrench.follow import follow_plan
    from truewrench.rig import load_rig

    done = follow_plan(load_rig(rig), plan, of=of, payload=payload, rate=rate)
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


@app.command()
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
    from truewrench.campaign import campaign as run
    from truewrench.campaign_statistics import campaign_words
    from truewrench.io.plans import read_plan
    from truewrench.rig import load_rig

    _check_folder(output)
    settings = load_rig(rig)
    trajectory = None if plan is None else read_plan(plan)
    with _progress() as update:
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit with its status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    as_json, debug = "--json" in words, "--debug" in words
    try:
        outcome = typer.main.get_command(app).main(words, prog_name="truewrench", standalone_mode=False)
        if outcome == _INTERRUPTED:
            one_file = words[0] in ("calibrate", "validate", "apply")
            sys.exit(_fail([f"interrupted{': nothing was written' * one_file}"], _INTERRUPTED, as_json, None))
        if not isinstance(outcome, Outcome):  # --help, --version
            sys.exit(outcome)
        _print(outcome, as_json)
        status = outcome.status
    except (InputError, typer.TyperException) as error:
        reasons = error.problems if isinstance(error, InputError) else [error.format_message()]
        status = _fail(reasons, 2, as_json, error if debug else None)
    except KeyboardInterrupt:
        status = _fail(["interrupted"], _INTERRUPTED, as_json, None)
    except BrokenPipeError:  # the reader of our output has gone; its end is not our fault
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    except Exception as error:
        hint = "" if debug else " (--debug shows where)"
        reason = f"internal fault: {type(error).__name__}: {error}{hint}"
        status = _fail([reason], 1, as_json, error if debug else None)
    sys.exit(status)


def _print(outcome: Outcome, as_json: bool) -> None:
    if as_json:
        _print_json(outcome.status, outcome.verdict, outcome.outputs, outcome.figures)
    else:
        from truewrench.summary import show

        # a pipe has no width: do not break lines for it
        show(Console(highlight=False, width=None if sys.stdout.isatty() else 160), outcome.words())
        for output in outcome.outputs:
            print(f"wrote {output}")  # noqa: T201
    sys.stdout.flush()


def _fail(reasons: Sequence[str], status: int, as_json: bool, error: BaseException | None) -> int:
    if error is not None:
        traceback.print_exception(error)
    for reason in filter(None, reasons):  # no reason: the command line was empty, and help has been printed
        print(f"truewrench: {reason}", file=sys.stderr)  # noqa: T201
    if as_json:
        _print_json(status, {"usable": False, "reasons": list(reasons)}, [], {})
    return status


def _print_json(
    status: int, verdict: Mapping[str, Any] | None, outputs: Sequence[str | Path], figures: Mapping[str, Any]
) -> None:
    document = {"status": status, "verdict": verdict, "outputs": list(outputs), "figures": figures}
    print(json.dumps(_plain(document), allow_nan=False))  # noqa: T201


def _plain(value: Any) -> Any:
    """What JSON knows; a number that is not finite becomes null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def _verdict(calibration: Calibration) -> dict[str, Any]:
    verdict: dict[str, Any] = dataclasses.asdict(calibration.verdict)
    return verdict


def _check_folder(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise InputError.at(path, "", "a file", "a folder, or a name that is free")


def _report_left_out(path: Path | None, dropped_rows: int, nan_counts: Mapping[str, int]) -> None:
    if dropped_rows:
        print(f"{path}: {dropped_rows} rows without any measurement left out", file=sys.stderr)  # noqa: T201
    for column, count in nan_counts.items():
        print(f"{path}: column `{column}`: {count} NaN left out", file=sys.stderr)  # noqa: T201


@contextmanager
def _progress() -> Iterator[Callable[[str, float | None], None]]:
    """Calls with a phase and the share of it that is done, shown on a terminal only."""
    if not sys.stderr.isatty():
        yield lambda phase, share: None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda phase, share: bar.update(
            task, description=phase, completed=share or 0.0, total=None if share is None else 1.0
        )
