"""Commands about logs as they are."""

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from truewrench.cli.common import (
    DebugOption,
    JsonOption,
    MaxRowsOption,
    Outcome,
    progress_bar,
    report_notes,
)


def inspect(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="CSV, Parquet, or a recording.")],
    max_rows: MaxRowsOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Show what is in a log: streams, rates, gaps, ranges; of a recording, its topics too."""
    from truewrench.inspection.log import inspect_log
    from truewrench.inspection.words import log_summary
    from truewrench.io.recordings.reader import is_recording

    if log.exists() and is_recording(log):
        return _inspect_recording(log)
    content = inspect_log(log, max_rows=max_rows)
    return Outcome(figures=dataclasses.asdict(content), words=lambda: log_summary(content))


def _inspect_recording(log: Path) -> Outcome:
    from truewrench.inspection.recording import inspect_recording
    from truewrench.inspection.words import recording_summary

    with progress_bar() as update:
        content = inspect_recording(log, lambda messages: update(f"{messages} messages", None))
    report_notes(log, content.notes)
    return Outcome(figures=dataclasses.asdict(content), words=lambda: recording_summary(content))
