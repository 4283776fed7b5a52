"""The command line: parse, call, print, exit status.

0 done and usable; 1 internal fault; 2 bad input, settings or an unsupported combination, nothing written;
3 a result is written but is not to be used as it stands.
"""

import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from truewrench.cli import calibrations, live, logs, motions, tools, trials
from truewrench.cli.common import Outcome
from truewrench.cli.terminal import fail, show_outcome
from truewrench.model.errors import InputError
from truewrench.model.files import NO_ROOM

app = typer.Typer(
    name="truewrench",
    help="Recalibrate a robot's six-axis force/torque sensor in place, from the motion of a known payload.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for _command in (
    trials.demo,
    motions.plan,
    motions.follow,
    motions.simulate,
    calibrations.calibrate,
    calibrations.validate,
    calibrations.apply,
    tools.tool,
    live.stream,
    logs.inspect,
    trials.campaign,
):
    app.command()(_command)

_INTERRUPTED = 130  # what a shell says of a program that Ctrl-C ended


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


def _open_streams() -> None:
    """Open standard streams that were closed, before a file takes the place of one."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, by default that of the process, and return its exit status."""
    _open_streams()
    words = list(sys.argv[1:] if arguments is None else arguments)
    as_json, debug = "--json" in words, "--debug" in words
    status = 0  # of a command whose reader goes away while it runs
    try:
        outcome = typer.main.get_command(app).main(words, prog_name="truewrench", standalone_mode=False)
        if outcome == _INTERRUPTED:
            one_file = words[0] in ("calibrate", "validate", "apply", "tool")
            return fail([f"interrupted{': nothing was written' * one_file}"], _INTERRUPTED, as_json, None)
        if not isinstance(outcome, Outcome):  # --help, --version
            return int(outcome or 0)
        status = outcome.status
        show_outcome(outcome, as_json)
    except (InputError, typer.TyperException) as error:
        reasons = error.problems if isinstance(error, InputError) else [error.format_message()]
        status = fail(reasons, 2, as_json, error if debug else None)
    except KeyboardInterrupt:
        status = fail(["interrupted"], _INTERRUPTED, as_json, None)
    except BrokenPipeError:  # the reader of our output has gone; its end is not our fault
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        # of standard output: files have an InputError
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return fail([f"standard output: cannot be written: {error.strerror}"], 2, False, None)
        hint = "" if debug else " (--debug shows where)"
        reason = f"internal fault: {type(error).__name__}: {error}{hint}"
        status = fail([reason], 1, as_json, error if debug else None)
    return status
