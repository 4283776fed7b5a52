"""Values that a driver repeats: of a stream that is slower than the rows that it is logged in, or that hung.

A repeat is no measurement: taken for one, a held value is late by up to its period, and its noise counts
several times. Of a coarse reading channels repeat one by one; of a held one all do, and then all change. What
hung goes on with a jump.
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
_LONGEST = 3.0  # times as long as the others: what repeats longer is at rest, or hangs
_HUNG = 4  # repeats from which on a stream may hang, and
_JUMP = 3.0  # times as large as any other change of a column, with which it then goes on
_RESTS = 0.1  # share of the other rows that repeat, from which on repeats are a stream's own way

_STREAMS = {
    "raw": "raw channels",
    "twist": "vx ... wz",
    "angular_velocity": "wx wy wz",
    "specific_force": "accel_*",
    "position": "q_*",
    "velocity": "dq_*",
}
_MOTION = ("twist", "angular_velocity", "specific_force", "position", "velocity", "gravity", "attitude")


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
    for name, hung in _hung_streams(log).items():
        changed[name] = changed.get(name, getattr(log, name)).copy()
        changed[name][hung] = np.nan
        first, last = (int(log.time_ns[k] - log.time_ns[0]) / 1e9 for k in (hung[0], hung[-1]))
        notes.append(
            f"{_STREAMS.get(name, name)}: {hung.size} rows from {first:.4g} to {last:.4g} s repeat the row "
            "before and then jump: left out as of a stream that hung"
        )
    return replace(log, **changed, notes=(*log.notes, *notes)) if changed else log


def _hung_streams(log: Log) -> dict[str, NDArray[np.int64]]:
    """Rows in which streams hung; those of the motion all where one of them did and the other repeats too."""
    found = {}
    for name in ("raw", *_MOTION):
        values = getattr(log, name)
        if values is not None:
            found[name] = _hung(values, log.time_ns)
    motion = [name for name in found if name != "raw"]
    if any(found[name].size for name in motion):
        stopped = np.unique(np.concatenate([found[name] for name in motion]))
        for name in motion:
            rows, repeats = _repeats(getattr(log, name))
            found[name] = rows[repeats & np.isin(rows, stopped)]
    return {name: rows for name, rows in found.items() if rows.size}


def _hung(values: Array, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of values (N, n) that repeat the row before although what they measure went on."""
    rows, repeats = _repeats(values)
    if rows.size <= _FEWEST:
        return rows[:0]
    fresh = np.flatnonzero(~repeats)
    lengths = np.diff(np.append(fresh, rows.size))
    others = np.repeat(lengths <= _HUNG, lengths)
    long = np.append(lengths[:-1] > _HUNG, False)  # and followed by another value
    if not long.any() or others.sum() <= _FEWEST or repeats[others].mean() > _RESTS:
        return rows[:0]
    change = np.abs(np.diff(values[rows], axis=0, prepend=values[rows[:1]]))  # with which a row comes
    after = np.append(fresh[1:], 0)[long]
    most = np.delete(change, after, axis=0).max(axis=0)
    step = np.diff(time_ns[rows], prepend=time_ns[rows[0]])
    at_once = step[after] <= _LONGEST * np.median(step)  # not the next of some poses, the way to it left out
    long[long] = at_once & (change[after] > _JUMP * most)[:, most > 0.0].any(axis=1)
    hung: NDArray[np.bool_] = repeats & np.repeat(long, lengths)
    return rows[hung]


def _repeats(values: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Rows of values (N, n) that are there; whether each repeats the one before in all that ever change."""
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    if rows.size < 2:
        return rows, np.zeros(rows.size, bool)
    same = values[rows[1:]] == values[rows[:-1]]
    alive = ~same.all(axis=0)
    return rows, np.append(False, same[:, alive].all(axis=1) & alive.any())


def _held(values: Array) -> NDArray[np.int64]:
    """Rows of values (N, n) that repeat the row before because their stream is slower than the rows."""
    rows, repeats = _repeats(values)
    if rows.size <= _FEWEST:
        return rows[:0]
    same = values[rows[1:]] == values[rows[:-1]]
    same = same[:, ~same.all(axis=0)]
    fresh = np.flatnonzero(~repeats)
    if not same.size or fresh.size <= _FEWEST or (~same[~repeats[1:]]).mean() < _TOGETHER:
        return rows[:0]
    lengths = np.diff(np.append(fresh, rows.size))
    usual = lengths <= _LONGEST * max(1.0, float(np.median(lengths)))
    if np.mean(lengths[usual] > 1) < _HELD:
        return rows[:0]
    kept = np.repeat(usual, lengths)
    return rows[repeats & kept]
