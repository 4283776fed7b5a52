"""Values that a driver holds until the next one: a stream that is slower than the rows that it is logged in.

A repeat is no measurement: taken for one, a held value is late by up to its period, and its noise counts
several times. Of a coarse reading channels repeat one by one; of a held one all do, and then all change.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench.model.log import Log

__all__ = ["without_repeats"]

Array = NDArray[np.float64]

_TOGETHER = 0.9  # share of the columns that change where any does: words for "all"
_HELD = 0.2  # share of the values that are held, from which on the stream is slower than its rows
_FEWEST = 20  # changes that tell it
_LONGEST = 3.0  # times as long as the others: what repeats longer is at rest, or a sensor that hangs

_STREAMS = {
    "raw": "raw channels",
    "twist": "vx ... wz",
    "angular_velocity": "wx wy wz",
    "specific_force": "accel_*",
    "position": "q_*",
    "velocity": "dq_*",
}


def without_repeats(log: Log) -> Log:
    """The log with NaN in place of values that were held, stream by stream, and a note that says so."""
    changed: dict[str, Any] = {}
    notes = []
    for name, words in _STREAMS.items():
        values: Array | None = getattr(log, name)
        if values is None:
            continue
        held = _held(values)
        if held.size:
            known = int(np.isfinite(values).all(axis=1).sum())
            changed[name] = values.copy()
            changed[name][held] = np.nan
            notes.append(
                f"{words}: {held.size} of {known} rows repeat the row before in every column: left out as "
                "held by the driver, no measurements"
            )
    return replace(log, **changed, notes=(*log.notes, *notes)) if changed else log


def _held(values: Array) -> NDArray[np.int64]:
    """Rows of values (N, n) that repeat the row before because their stream is slower than the rows."""
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    if rows.size <= _FEWEST:
        return rows[:0]
    known = values[rows]
    alive = (known[1:] != known[:-1]).any(axis=0)
    same = known[1:, alive] == known[:-1, alive]
    repeats = np.append(False, same.all(axis=1))
    fresh = np.flatnonzero(~repeats)
    if not alive.any() or fresh.size <= _FEWEST or (~same[~repeats[1:]]).mean() < _TOGETHER:
        return rows[:0]
    lengths = np.diff(np.append(fresh, rows.size))
    usual = lengths <= _LONGEST * max(1.0, float(np.median(lengths)))
    if np.mean(lengths[usual] > 1) < _HELD:
        return rows[:0]
    kept = np.repeat(usual, lengths)
    return rows[repeats & kept]
