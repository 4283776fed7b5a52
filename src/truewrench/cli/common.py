"""What all commands share: options, what they return, checks and progress."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.files import is_special

if TYPE_CHECKING:
    from truewrench.model.log import Log
    from truewrench.model.rig import Rig


@dataclass(frozen=True)
class Outcome:
    """What a command did: files, figures and verdict for programs, words for people."""

    outputs: Sequence[str | Path] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    verdict: Mapping[str, Any] | None = None
    words: Callable[[], Iterator[RenderableType]] = lambda: iter(())
    aside: bool = False
    """Whether the words go to standard error, since standard output has been a stream of data."""

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
MaxRowsOption = Annotated[
    int | None,
    typer.Option("--max-rows", metavar="N", min=1, help="Of a log; 2^25, and 4 GB, by default."),
]
LogsArgument = Annotated[
    list[str], typer.Argument(metavar="LOG...", help="CSV, Parquet or a recording; LOG@PAYLOAD.")
]


def check_folder(path: Path, *, write: bool = False) -> None:
    """Refuse a file where results want a folder, before any work is done.

    Whether it can be written is tried, too, where results that cannot be had again depend on it.
    """
    if os.path.exists(path) and not path.is_dir():
        raise InputError.at(path, "", "a file", "a folder, or a name that is free")
    _check_parents(path)
    if write:
        there = next(place for place in (path, *path.absolute().parents) if place.exists())
        try:
            tempfile.TemporaryFile(dir=there).close()
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


TABLE_NAMES = ("", ".csv", ".txt", ".parquet", ".pq")


def _check_parents(path: Path) -> None:
    """Refuse a path below a file."""
    there = next(place for place in path.absolute().parents if os.path.exists(place))
    if not there.is_dir():
        raise InputError.at(path, "", f"a path below the file {there.name}", "one below a folder")


def check_output(
    output: Path, *inputs: Path | str | None, table: bool = True, recording: bool = False
) -> None:
    """Refuse to write a file over an input of the same command, before any work is done.

    Refused are also a folder, a device, and for a `table` the name of anything else, unless FILE.mcap becomes
    a `recording`. An input that does not exist is told by whoever reads it.
    """
    exists = os.path.exists  # False, and no error, of a name that no file can have
    if exists(output) and output.is_dir():
        raise InputError.at(output, "", "a folder", "a file to write")
    if is_special(output):
        raise InputError.at(output, "", "a device or a pipe", "a file to write")
    _check_parents(output)
    for given in inputs:
        if given is not None and exists(output) and exists(given) and output.samefile(given):
            raise InputError.at(output, "", "an input of the command itself", "another file to write")
    suffix = output.suffix.lower()
    if table and suffix not in TABLE_NAMES and not (recording and suffix == ".mcap"):
        expected = "a name in .csv, .parquet or .mcap" if recording else "a name in .csv or .parquet"
        of_recording = suffix in (".bag", ".db3", ".mcap")
        found = "the name of a recording for a table" if of_recording else f"a name in {suffix}"
        raise InputError.at(output, "", found, expected)


def check_distinct(logs: Sequence[Log]) -> None:
    """Refuse one file given twice: as two logs it would seem to tell more than it does."""
    first: dict[str, int] = {}
    for number, log in enumerate(logs, start=1):
        same = first.setdefault(log.sha256, number)
        if log.sha256 and same != number:
            found = f"the same content as log {same}, {logs[same - 1].path}"
            raise InputError.at(log.path, f"log {number}", found, "every log once")


def with_wrench_topic(rig: Rig, log: str, topic: str) -> Rig:
    """The rig with another topic of the sensor; refused for a log that is a table."""
    from truewrench.io.recordings.reader import is_recording
    from truewrench.io.tables import named_payload

    path = named_payload(log, rig)[0]
    if os.path.exists(path) and not is_recording(path):
        raise UnsupportedError.at(path, "--wrench-topic", "a table", "this option with a recording only")
    return rig.model_copy(update={"recording": rig.recording.model_copy(update={"wrench_topic": topic})})


def report_left_out(log: Log) -> None:
    """Say on standard error what of a log is not used, and what is worth a look."""
    if log.dropped_rows:
        print(f"{log.path}: {log.dropped_rows} rows without any measurement left out", file=sys.stderr)  # noqa: T201
    for column, count in log.nan_counts.items():
        print(f"{log.path}: column `{column}`: {count} NaN left out", file=sys.stderr)  # noqa: T201
    report_notes(log.path, log.notes)


def report_notes(path: Path | str | None, notes: Sequence[str]) -> None:
    """Say on standard error what is worth a look in a log."""
    for note in notes:
        print(f"{path}: {note}", file=sys.stderr)  # noqa: T201


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float | None], None]]:
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
