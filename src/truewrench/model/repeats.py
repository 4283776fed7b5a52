"""Values that are no measurements: repeats of a stream slower than its rows or hung, lines, marks, glitches.

Lines are what a table holds whose maker brought a slower stream to these rows by linear interpolation.
Taken for a measurement, a held value is late by up to its period, and its noise counts several times, as that
of lines between samples does. Of a coarse reading channels repeat one by one; of a held one all do, and then
all change. What hung goes on with a jump.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.log import Log

SAMPLED = 0.1  # [s] that a value of a sampled reference stays; loads that are held or noted stay for longer

_TOGETHER = 0.9  # share of the columns that change where any does: words for "all"
_HELD = 0.2  # share of the values that are held, from which on the stream is slower than its rows
_FEWEST = 20  # changes that tell it
_LONGEST = 3.0  # times as long as the others: what repeats longer is at rest, or hangs
# Of 320 sound records of twists and arms none is said to hang; of as many that did for 5, 10, 25 and 100 rows
# 80, 94, 99 and 100% are told.
_HUNG = 4  # repeats from which on a stream may hang, and
_JUMP = 3.0  # times as large as any other change of a column, with which it then goes on
# Of white noise 5e-4 of the rows are on the lines of all of three columns, 3e-7 of six.
_IN_LINE = 0.1  # of the rms change of slope, up to which a row is on the line through its neighbours
_REGULAR = 0.8  # share of the lines that begin as regularly as samples, from which on they were interpolated
_MARK = 50.0  # times the range of 98% of a column, by which what is no value stands off the rows around it
# Of 240 records of benchmarks/imperfect.py and 400 of healthy.py no cell is said to be a glitch.
_GLITCH = 5.0  # times what rows usually change by, by which a glitch stands off the rows around it,
_USUAL = 97.0  # per cent of the changes, which are as large at most, and half of so many
_AROUND = 17  # about the row,
_MOST_GLITCHES = 0.02  # and the share of the rows, beyond which it is a stream's own way
_RESTS = 0.1  # share of the other rows that repeat, from which on repeats are a stream's own way

_STREAMS = {
    "raw": "raw channels",
    "twist": "vx ... wz",
    "angular_velocity": "wx wy wz",
    "specific_force": "accel_*",
    "position": "q_*",
    "velocity": "dq_*",
    "gravity": "gx gy gz",
    "attitude": "qw ... qz",
    "base_twist": "base_vx ... base_wz",
    "base_attitude": "base_qw ... base_qz",
    "reference": "ref_*",
}


def without_repeats(log: Log) -> Log:
    """The log with NaN in place of values that were held, stream by stream, and a note that says so."""
    changed: dict[str, Any] = {}
    notes: list[str] = []
    followed = () if log.tracking is None else ("twist", "gravity")  # of joints, whose notes say it
    logged = {name: values for name in _STREAMS if (values := getattr(log, name)) is not None}
    for name in [name for name in logged if name not in ("raw", "reference")]:  # whose outliers are found
        for find, why in (
            (_marks, "left out as a driver's mark for no sample"),
            (_glitches, "left out as a glitch"),
        ):
            alone = find(logged[name])
            if alone.any():
                worst = float(max(logged[name][alone], key=abs))
                changed[name] = logged[name] = np.where(alone, np.nan, logged[name])
                count = f"{np.count_nonzero(alone)} cells such as {worst:.6g}"
                notes.append(f"{_STREAMS[name]}: {count}, alone, {why}")
    streams = {name: _Stream(values) for name, values in logged.items()}
    for name, stream in streams.items():
        held = stream.held()
        if name == "reference" and not 1e-9 * stream.usual(log.time_ns) <= SAMPLED:
            held = held[:0]
        why = "repeat the row before in every column: left out as held by the driver"
        if not held.size and name != "reference":
            held = stream.interpolated(log.time)
            why = "lie on lines between others in every column: left out as interpolated"
        if held.size:
            changed[name] = stream.values.copy()
            changed[name][held] = np.nan
        if held.size and name not in followed:
            count = f"{held.size} of {stream.rows.size} rows"
            notes.append(f"{_STREAMS[name]}: {count} {why}, no measurements")
    for name in ("base_twist", "base_attitude", "reference"):  # they stay as they are for long
        streams.pop(name, None)
    for name, hung in _hung_streams(streams, log.time_ns).items():
        changed[name] = changed.get(name, streams[name].values).copy()
        changed[name][hung] = np.nan
        first, last = (int(log.time_ns[k] - log.time_ns[0]) / 1e9 for k in (hung[0], hung[-1]))
        notes.append(
            f"{_STREAMS[name]}: {hung.size} rows from {first:.4g} to {last:.4g} s repeat the row "
            "before and then jump: left out as of a stream that hung"
        )
    return replace(log, **changed, notes=(*log.notes, *notes)) if changed else log


def without_marks(log: Log) -> Log:
    """The log without cells of its channels, alone, by which a driver marks that it has no sample."""
    marks = _marks(log.raw)
    return replace(log, raw=np.where(marks, np.nan, log.raw)) if marks.any() else log


def _marks(values: Array) -> Mask:
    """Cells (N, n) that stand off the two rows before and after as nothing else in their column does."""
    return _alone(values, _far)


def _glitches(values: Array) -> Mask:
    """Cells (N, n) that stand off the rows on both sides by far more than rows change, there and in all."""
    out = _alone(values, _fast)
    out[:, out.sum(axis=0) > _MOST_GLITCHES * np.isfinite(values).sum(axis=0)] = False
    return out


def _alone(values: Array, limit: Callable[[Array], Array]) -> Mask:
    """Cells (N, n) that are further from the median of five rows than the limit (M,) of their column's M."""
    out: Mask = np.zeros(values.shape, dtype=np.bool_)
    for column, of in zip(values.T, out.T, strict=True):
        rows = np.flatnonzero(np.isfinite(column))
        if rows.size > _FEWEST:
            x = column[rows]
            of[rows] = np.abs(x - median_filter(x, 5, mode="nearest")) > limit(x)
    return out


def _far(column: Array) -> Array:
    low, high = np.percentile(column, [1.0, 99.0])
    return np.asarray(_MARK * (high - low if high > low else np.inf))


def _fast(column: Array) -> Array:
    """By what rows change there and in all; of coarse ones, which rarely change, no less than by a step."""
    change = np.abs(np.diff(column))
    if not change.any():
        return np.asarray(np.inf)
    usual = max(float(np.percentile(change, _USUAL)), float(np.median(change[change > 0.0])))
    there = median_filter(np.append(change, change[-1]), _AROUND, mode="nearest")
    return np.asarray(_GLITCH * np.maximum(usual, there))


class _Stream:
    """Values (N, n), and which of the rows that are there repeat the one before in all that ever change."""

    def __init__(self, values: Array) -> None:
        self.values = values
        self.rows = np.flatnonzero(np.isfinite(values).all(axis=1))
        there = values if self.rows.size == len(values) else values[self.rows]
        self.same = there[1:] == there[:-1]
        self.same = self.same[:, ~self.same.all(axis=0)]  # of columns that are alive
        self.repeats = np.append(False, self.same.all(axis=1) & (self.same.shape[1] > 0))[: self.rows.size]

    def runs(self) -> tuple[Integers, Integers]:
        """Where values begin, counted in rows, and how many rows each lasts; nothing where none repeats."""
        if self.rows.size <= _FEWEST or not self.repeats.any():
            return self.rows[:0], self.rows[:0]
        fresh = np.flatnonzero(~self.repeats)
        return fresh, np.diff(np.append(fresh, self.rows.size))

    def usual(self, time_ns: Integers) -> float:
        """How long a value stays, in the median [ns]."""
        fresh, _ = self.runs()
        return float(np.median(np.diff(time_ns[self.rows[fresh]]))) if fresh.size > 1 else np.inf

    def held(self) -> Integers:
        """Rows that repeat the row before because their stream is slower than the rows."""
        fresh, lengths = self.runs()
        if fresh.size <= _FEWEST or (~self.same[~self.repeats[1:]]).mean() < _TOGETHER:
            return self.rows[:0]
        usual = lengths <= _LONGEST * max(1.0, float(np.median(lengths)))
        if np.mean(lengths[usual] > 1) < _HELD:
            return self.rows[:0]
        kept: Mask = self.repeats & np.repeat(usual, lengths)
        return self.rows[kept]

    def interpolated(self, time: Array) -> Integers:
        """Rows on lines that begin as regularly as samples; of two beside a sample that is not there, one."""
        at = time[self.rows]
        if self.rows.size <= _FEWEST:
            return self.rows[:0]
        straight: Mask = np.ones(at.size - 2, dtype=np.bool_)
        for column in self.values.T:  # one by one, for the memory of an hour
            bend = np.abs(np.diff(np.diff(column[self.rows]) / np.diff(at)))
            size = np.hypot.reduce(bend) / np.sqrt(bend.size)  # squares may overflow
            straight &= bend <= _IN_LINE * size
        line = np.pad(straight, 1) & ~self.repeats
        begins = np.flatnonzero(line[1:] & ~line[:-1])
        if begins.size <= _FEWEST or line.mean() < _HELD or np.median(np.diff(at[begins])) > SAMPLED:
            return self.rows[:0]
        apart = np.diff(begins)
        if np.mean(np.abs(apart - np.median(apart)) <= 1) < _REGULAR:
            return self.rows[:0]
        row = np.arange(line.size)
        along, since = (row - np.maximum.accumulate(np.where(x, row, 0)) for x in (~line, line))
        # where a smooth motion is slow all is a line: there one row a sample stays, too
        drawn: Mask = line & (along % int(np.median(apart)) > 0) | (since % 2 == 0) & (since > 0)
        return self.rows[drawn]

    def hung(self, time_ns: Integers) -> Integers:
        """Rows that repeat the row before although what they measure went on."""
        fresh, lengths = self.runs()
        long = np.append(lengths[:-1] > _HUNG, [False] * (lengths.size > 0))  # and followed by another value
        others = np.repeat(lengths <= _HUNG, lengths)
        if not long.any() or others.sum() <= _FEWEST or self.repeats[others].mean() > _RESTS:
            return self.rows[:0]
        first = self.values[self.rows[:1]]
        change = np.abs(np.diff(self.values[self.rows], axis=0, prepend=first))  # with which a row comes
        after = np.append(fresh[1:], 0)[long]
        most = np.delete(change, after, axis=0).max(axis=0)
        step = np.diff(time_ns[self.rows], prepend=time_ns[self.rows[0]])
        at_once = step[after] <= _LONGEST * np.median(
            step
        )  # not the next of some poses, the way to it left out
        long[long] = at_once & (change[after] > _JUMP * most)[:, most > 0.0].any(axis=1)
        hung: Mask = self.repeats & np.repeat(long, lengths)
        return self.rows[hung]


def _hung_streams(streams: dict[str, _Stream], time_ns: Integers) -> dict[str, Integers]:
    """Rows in which streams hung; those of the motion all where one of them did and the other repeats too."""
    found = {name: stream.hung(time_ns) for name, stream in streams.items()}
    motion = [name for name in found if name != "raw"]
    if any(found[name].size for name in motion):
        stopped = np.unique(np.concatenate([found[name] for name in motion]))
        for name in motion:
            rows = streams[name].rows
            found[name] = rows[streams[name].repeats & np.isin(rows, stopped)]
    return {name: rows for name, rows in found.items() if rows.size}
