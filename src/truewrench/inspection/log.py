"""What is in a log: streams, rates, gaps, ranges."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truewrench.io.cells import numbers
from truewrench.io.table import ACCELERATION, ANGULAR_VELOCITY, ATTITUDE, GRAVITY, TWIST, Table
from truewrench.io.tables import TimeReader, open_table
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError

GAP_PERIODS = 5.0  # a stream pauses where this many nominal periods pass without a sample

_STREAMS = (
    ("raw channels", r"raw_\d+"),
    ("twist", "|".join(TWIST)),
    ("joint positions", r"q_.+"),
    ("joint velocities", r"dq_.+"),
    ("gravity", "|".join(GRAVITY)),
    ("attitude", "|".join(ATTITUDE)),
    ("twist derivative", "|".join(ACCELERATION)),
    ("accelerometer", r"accel_[xyz]"),
    ("base", r"base_(v[xyz]|w[xyz]|q[wxyz])"),
    ("reference wrench", r"ref_[fm][xyz]"),
    ("temperature", r"temperature"),
)


@dataclass(frozen=True, slots=True)
class ColumnContent:
    """One column: its numbers and the cells that hold none; without numbers the range is NaN."""

    name: str
    smallest: float
    largest: float
    numbers: int
    empty: int
    nan: int


@dataclass(frozen=True, slots=True)
class Gap:
    """A pause of a stream: when it begins, from the first row, and how long it is [s]."""

    start: float
    duration: float


@dataclass(frozen=True, slots=True)
class Stream:
    """Columns that are sampled together."""

    name: str  # for a person
    columns: tuple[ColumnContent, ...]  # in the order of the file
    samples: int  # rows in which at least one of the columns has a number
    rate: float  # samples a second, from the median period; 0 with fewer than two samples
    jitter: float  # standard deviation of the period over its median
    gaps: tuple[Gap, ...]  # pauses of more than five nominal periods


@dataclass(frozen=True, slots=True)
class LogContent:
    """A whole log; `unknown` are columns that this package gives no meaning."""

    path: Path
    rows: int
    start_ns: int
    duration: float
    streams: tuple[Stream, ...]
    unknown: tuple[str, ...]


def inspect_log(path: str | Path, *, max_rows: int | None = None) -> LogContent:
    """Read a table once and say what is in it; no rig is needed. `max_rows` is that of `read_log`."""
    table = open_table(path, max_rows=max_rows)
    groups = {
        name: [column for column in table.names if re.fullmatch(pattern, column)]
        for name, pattern in _STREAMS
    }
    if set(groups["twist"]) <= set(ANGULAR_VELOCITY):  # an IMU's
        groups = {"angular velocity" if name == "twist" else name: names for name, names in groups.items()}
    time, counters = _read(table, groups)
    if not len(time):
        raise InputError.at(path, "", "no row", "at least one row below the header")
    known = {column for columns in groups.values() for column in columns} | {"time_ns", "time_s"}
    return LogContent(
        path=Path(path),
        rows=len(time),
        start_ns=int(time[0]),
        duration=float(time[-1] - time[0]) * 1e-9,
        streams=tuple(
            counters[name].stream(name, int(time[0])) for name, columns in groups.items() if columns
        ),
        unknown=tuple(name for name in table.names if name not in known),
    )


def _read(table: Table, groups: dict[str, list[str]]) -> tuple[Integers, dict[str, _StreamCounter]]:
    reader = TimeReader(table)
    counters = {name: _StreamCounter(columns) for name, columns in groups.items() if columns}
    times: list[Integers] = [np.empty(0, dtype=np.int64)]
    columns = [column for group in groups.values() for column in group]
    for chunk in table.chunks([*reader.columns, *columns]):
        time = reader.read(chunk)
        times.append(time)
        for counter in counters.values():
            cells = [numbers(chunk.column(name)) for name in counter.ranges.names]
            counter.add(time, np.column_stack([c[0] for c in cells]), [c[1] for c in cells])
    return np.concatenate(times), counters


class Ranges:
    """What one pass over the rows of some columns gathers of their numbers."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows = 0
        self._smallest = np.full(len(names), np.inf)
        self._largest = np.full(len(names), -np.inf)
        self._numbers = np.zeros(len(names), dtype=np.int64)
        self._nan = np.zeros(len(names), dtype=np.int64)

    def add(self, values: Array, nan_counts: Sequence[int] | None = None) -> None:
        """Some rows (N, columns); without a count of the cells that held NaN, none is empty."""
        numbers = (~np.isnan(values)).sum(axis=0)
        self._rows += len(values)
        self._smallest = np.fmin(self._smallest, np.fmin.reduce(values, axis=0, initial=np.inf))
        self._largest = np.fmax(self._largest, np.fmax.reduce(values, axis=0, initial=-np.inf))
        self._numbers += numbers
        self._nan += len(values) - numbers if nan_counts is None else np.asarray(nan_counts)

    def columns(self) -> tuple[ColumnContent, ...]:
        """What is said of each."""
        found = zip(self.names, self._smallest, self._largest, self._numbers, self._nan, strict=True)
        return tuple(
            ColumnContent(
                name=name,
                smallest=float(smallest) if count else np.nan,
                largest=float(largest) if count else np.nan,
                numbers=int(count),
                empty=self._rows - int(count + nan),
                nan=int(nan),
            )
            for name, smallest, largest, count, nan in found
        )


class _StreamCounter:
    """What one pass over the chunks gathers of a stream."""

    def __init__(self, names: Sequence[str]) -> None:
        self.ranges = Ranges(names)
        self._times: list[Integers] = []

    def add(self, time: Integers, values: Array, nan_counts: Sequence[int]) -> None:
        self._times.append(time[~np.isnan(values).all(axis=1)])
        self.ranges.add(values, nan_counts)

    def stream(self, name: str, start_ns: int) -> Stream:
        time = np.concatenate(self._times)
        period = np.diff(time)
        median = float(np.median(period)) if len(period) else 0.0
        pauses = np.flatnonzero(period > GAP_PERIODS * median)
        steady = period[period <= GAP_PERIODS * median]
        return Stream(
            name=name,
            columns=self.ranges.columns(),
            samples=len(time),
            rate=1e9 / median if median else 0.0,
            jitter=float(steady.std()) / median if median else 0.0,
            gaps=tuple(Gap(float(time[i] - start_ns) * 1e-9, float(period[i]) * 1e-9) for i in pauses),
        )
