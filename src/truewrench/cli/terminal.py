"""What a command leaves on the terminal: words, or one JSON object, and why it failed."""

import dataclasses
import json
import math
import sys
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from truewrench.cli.common import Outcome

_LINES = 15  # of why a command failed


class _Words(Console):
    """Of which a reader that goes away is told to `main`, which knows the status."""

    def on_broken_pipe(self) -> None:
        """Not the end of the program with status 1, which it is by default."""
        raise BrokenPipeError


def show_outcome(outcome: Outcome, as_json: bool) -> None:
    """Print what a command did."""
    if as_json:
        _print_json(outcome.status, outcome.verdict, outcome.outputs, outcome.figures)
    else:
        from truewrench.report.summary import show

        to = sys.stderr if outcome.aside else sys.stdout
        # a pipe has no width: do not break lines for it
        show(_Words(file=to, highlight=False, width=None if to.isatty() else 160), outcome.words())
        for output in outcome.outputs:
            print(f"wrote {output}", file=to)
    sys.stdout.flush()


def fail(reasons: Sequence[str], status: int, as_json: bool, error: BaseException | None) -> int:
    """Print why a command failed, with the traceback of an error if one is given; the status is returned."""
    if error is not None:
        traceback.print_exception(error)
    from truewrench.model.rig.strict import printable

    # no reason: the command line was empty, and help has been printed
    lines = [printable(line) for reason in filter(None, reasons) for line in reason.split("\n")]
    if len(lines) > _LINES:
        lines[_LINES - 1 :] = [f"and {len(lines) - _LINES + 1} more"]
    for line in lines:
        print(f"truewrench: {line}", file=sys.stderr)  # noqa: T201
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
