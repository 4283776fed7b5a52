"""Commands about logs as they are."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from truewrench.cli.common import (
    DebugOption,
    JsonOption,
    Outcome,
)

__all__ = ["inspect"]


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
