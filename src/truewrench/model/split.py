"""A part of the record held out of a calibration, to judge it by."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from truewrench.model.arrays import Mask
from truewrench.model.errors import InputError
from truewrench.model.log import Log, Tracking

SHORTEST = 100  # rows of a piece of a held-out log


def held_out(logs: Sequence[Log], fraction: float = 0.2, blocks: int = 4) -> tuple[list[Log], list[Log]]:
    """Split logs into a part to calibrate with and, one per log that was split, a part to validate by.

    Blocks of time are held out, not single rows: neighbours know too much of each other. They are spread over
    every log, so that what moves late is in both parts. A log too short to be split is calibrated with whole;
    there are fewer blocks where they would become shorter than 2 s or 200 rows.
    """
    if not 0.0 < fraction < 1.0:
        raise InputError.at(None, "fraction", f"{fraction:g}", "a number between 0 and 1")
    kept, out = [], []
    for log in logs:
        rows = np.arange(len(log.time_ns))
        duration = log.time[-1] if len(rows) else 0.0
        possible = int(min(fraction * duration / 2.0, fraction * len(rows) / 200.0))
        count = min(blocks, possible)
        if count == 0:
            kept.append(log)
            continue
        phase = log.time / duration * count % 1.0  # of each of `count` equal parts, the middle is held out
        chosen = np.abs(phase - 0.5) < 0.5 * fraction
        # a part has no hash: it is not the file
        kept.append(replace(rows_of(log, ~chosen), sha256=""))
        out.append(replace(rows_of(log, chosen), sha256="", nan_counts={}, dropped_rows=0))
    return kept, out


def between_jumps(log: Log) -> list[Log]:
    """A log cut where its offset begins anew, without what is shorter than a validation can use."""
    if not log.offset_jumps_ns:
        return [log]
    piece = np.searchsorted(np.array(log.offset_jumps_ns), log.time_ns, side="right")
    pieces = [rows_of(log, piece == k) for k in np.unique(piece) if np.count_nonzero(piece == k) >= SHORTEST]
    return [replace(part, offset_jumps_ns=()) for part in pieces]


def rows_of(log: Log, rows: Mask | slice) -> Log:
    """The log with some of its rows; views of those of a slice."""
    tracking = log.tracking
    if tracking is not None:
        tracking = replace(tracking, **_picked(tracking, rows))
    return replace(log, tracking=tracking, **_picked(log, rows))


def _picked(of: Log | Tracking, rows: Mask | slice) -> dict[str, Any]:
    """Its arrays, all of which have the rows of the log, with some of these."""
    arrays = {x.name: getattr(of, x.name) for x in fields(of)}
    return {name: x[rows] for name, x in arrays.items() if isinstance(x, np.ndarray)}
