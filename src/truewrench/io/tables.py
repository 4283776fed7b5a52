"""Logs as tables, CSV or Parquet (docs/formats.md)."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from os.path import exists  # False, and no error, of a name that no file can have
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from truewrench.io.cells import numbers, to_nanoseconds
from truewrench.io.csv_table import CsvTable
from truewrench.io.joints import check_attitude, joint_groups
from truewrench.io.output import write_batches
from truewrench.io.parquet_table import ParquetTable
from truewrench.io.recordings.reader import is_recording
from truewrench.io.stamps import with_even_stamps
from truewrench.io.table import (
    ACCELERATION,
    ANGULAR_VELOCITY,
    AT_REST,
    ATTITUDE,
    GRAVITY,
    REFERENCE,
    SPECIFIC_FORCE,
    TWIST,
    Chunk,
    Table,
)
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.files import is_special
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.attitude import free_fall
from truewrench.robot.track import track

_SAME_NS = 1_000_000  # [ns] that two columns of the time may be apart


def open_table(
    path: str | Path, rig: Rig | None = None, *, whole: bool = True, max_rows: int | None = None
) -> Table:
    """A table file or a recording, its format recognised by its first bytes.

    A recording, the file or the folder of rosbag2, is read by the rig; unless `whole`, motion that cannot be
    read from it is left out, and no error. More than `max_rows` are refused, by default more than `MOST_ROWS`
    or `MOST_BYTES`.
    """
    table = _opened(Path(path), rig, whole)
    table.max_rows = max_rows
    return table


def _opened(path: Path, rig: Rig | None, whole: bool) -> Table:
    if re.match(r"[a-z][a-z0-9+]+:/", str(path)) and not exists(path):
        raise InputError.at(path, "", "an address", "a file: download it first")
    if is_special(path):
        raise InputError.at(path, "", "a device or a pipe", "a file, which is read more than once")
    if exists(path) and is_recording(path):
        if rig is None:
            raise InputError.at(path, "", "a recording", "a table: CSV or Parquet")
        from truewrench.io.recordings.table import RecordingTable

        return RecordingTable(path, rig, whole=whole)
    try:
        with path.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    return ParquetTable(path) if magic == b"PAR1" else CsvTable(path)


def named_payload(source: str | Path, rig: Rig) -> tuple[Path, str | None]:
    """`LOG@PAYLOAD` as path and payload; None when it ends in no payload of the rig."""
    text = str(source)
    for name in sorted(rig.payloads, key=len, reverse=True):
        if text.endswith(f"@{name}") and len(text) > len(name) + 1:
            return Path(text[: -len(name) - 1]), name
    return Path(text), None


def split_payload(source: str | Path, rig: Rig) -> tuple[Path, str]:
    """`LOG@PAYLOAD` as path and payload; without a payload, the rig's `default` or only one.

    InputError: the rig has several payloads, none of them `default`, and none is named.
    """
    path, named = named_payload(source, rig)
    if named is not None:
        return path, named
    text, known = str(source), ", ".join(rig.payloads)
    if "@" in path.name and not exists(path):
        name = path.name.rpartition("@")[2]
        raise InputError.at(text, "", f"no such file, and no payload `{name}` in the rig", f"one of: {known}")
    if "default" in rig.payloads or not rig.payloads:  # which known wrenches do not need
        return path, "default"
    if len(rig.payloads) == 1:
        return path, next(iter(rig.payloads))
    raise InputError.at(text, "", "no payload named", f"`{text}@PAYLOAD` with PAYLOAD one of: {known}")


def raw_columns(table: Table, n: int) -> tuple[str, ...]:
    """The names raw_0 ... raw_{n-1}, after checking that the table has exactly these."""
    names = tuple(f"raw_{i}" for i in range(n))
    require(table, names)
    for name in table.names:
        if re.fullmatch(r"raw_\d+", name) and name not in names:
            expected = f"the {n} channels of the rig, raw_0 to raw_{n - 1}"
            raise InputError.at(table.path, f"column `{name}`", "one raw channel too many", expected)
    return names


def require(table: Table, names: Iterable[str], unless: str = "") -> None:
    """Check that columns are present; those that are not are named with the nearest one present.

    `unless` says what else would do.
    """
    missing = [name for name in names if name not in table.names]
    if missing:
        near = {name: difflib.get_close_matches(name, _alike(name, table), 1, 0.0)[0] for name in missing}
        found = ", ".join(f"no column `{name}` (nearest: `{close}`)" for name, close in near.items())
        raise InputError.at(table.path, "header", found, f"every required column{unless}")


def _alike(name: str, table: Table) -> Sequence[str]:
    """The columns of the same stream, `q_*` for `q_elbow`, or all where there is none."""
    stream = name.partition("_")[0]
    return [other for other in table.names if other.partition("_")[0] == stream] or table.names


class TimeReader:
    """Time stamps of consecutive chunks, checked to increase strictly over the whole table."""

    def __init__(self, table: Table) -> None:
        if "time_ns" not in table.names and "time_s" not in table.names:
            near = difflib.get_close_matches("time_ns", table.names, n=1, cutoff=0.0)[0]
            expected = "a column `time_ns` or `time_s`"
            raise InputError.at(table.path, "header", f"no time (nearest column: `{near}`)", expected)
        self.name = "time_ns" if "time_ns" in table.names else "time_s"
        self._also = "time_s" if self.name == "time_ns" and "time_s" in table.names else None
        self.columns = (self.name, *([] if self._also is None else [self._also]))  # that it reads
        self._apart: int | None = None  # of the two, at the first row [ns]
        self._last: int | None = None

    def read(self, chunk: Chunk) -> Integers:
        """(rows,) stamps of a chunk [ns]."""
        column = chunk.column(self.name)
        time = to_nanoseconds(column, per_second=self.name == "time_s")
        if not len(time):
            return time
        before = np.concatenate([time[:1] - 1 if self._last is None else [self._last], time[:-1]])
        if (time <= before).any():
            i = int(np.flatnonzero(time <= before)[0])
            raise column.error(i, f"{time[i]} ns after {before[i]} ns", "time that strictly increases")
        self._last = int(time[-1])
        if self._also is not None:
            self._check_other(chunk, time)
        return time

    def _check_other(self, chunk: Chunk, time: Integers) -> None:
        column = chunk.column(str(self._also))
        apart = time - to_nanoseconds(column, per_second=True)
        self._apart = int(apart[0]) if self._apart is None else self._apart
        off = np.flatnonzero(np.abs(apart - self._apart) > _SAME_NS)
        if off.size:
            i = int(off[0])
            found = f"{1e-9 * (apart[i] - self._apart):.6g} s less since the first row than `time_ns`"
            raise column.error(i, found, "the same time in both, or one of them")


def read_log(source: str | Path, rig: Rig, *, max_rows: int | None = None) -> Log:
    """Read a log.

    The motion is required, of a twist rig in gravity its direction too, unless there are reference columns.
    Where the direction of gravity is told by the attitude alone, `Log.gravity` comes from it.

    Args:
        source: path of a CSV or Parquet file or of a recording, or `path@payload`.
        rig: says how many raw channels there are and whether gravity acts; of a recording, its topics too.
        max_rows: that are read; None: 2^25, and 4 GB of numbers. A log of more is refused.

    Raises:
        InputError: naming file, row and column, what was found and what was expected.
    """
    path, payload = split_payload(source, rig)
    if exists(path) and is_recording(path):
        rig.check_motion("which a recording is read by")
    table = open_table(path, rig, max_rows=max_rows)
    groups = _groups(table, rig)
    time_ns, columns, nan_counts = read_columns(table, [name for names in groups.values() for name in names])
    if len(time_ns) < 2:
        found = "no row" if len(time_ns) == 0 else "one row"
        raise InputError.at(path, "", found, "at least two rows below the header")
    kept, said = np.zeros(len(time_ns), dtype=np.bool_), []
    for name, values in columns.items():
        there = ~np.isnan(values)
        if there.any():
            said.append(name)
        kept |= there
    # a channel that is silent beside others is for the verdict
    any_channel = not set(groups["raw"]).isdisjoint(said)
    for name in columns:
        if name not in said and not (any_channel and name in groups["raw"]):
            raise InputError.at(path, f"column `{name}`", "not one number", "a number in at least one row")
    if kept.sum() < 2:
        raise InputError.at(path, "", "a measurement in one row only", "at least two rows with measurements")
    if not kept.all():
        time_ns, columns = time_ns[kept], {name: values[kept] for name, values in columns.items()}
    time_ns, columns, in_packets = with_even_stamps(time_ns, columns)
    # an hour at 1 kHz is 0.4 GB: the columns go as they are put together
    arrays: dict[str, Any] = {
        group: np.stack([columns.pop(name) for name in names], axis=1) for group, names in groups.items()
    }
    for group in ("attitude", "base_attitude"):
        if group in arrays:
            check_attitude(arrays[group], groups[group], path, time_ns)
    if "attitude" in arrays and "gravity" not in arrays and rig.in_gravity:
        arrays["gravity"] = free_fall(rig, arrays["attitude"])
    if "temperature" in arrays:
        arrays["temperature"] = arrays["temperature"][:, 0]
    log = Log(
        path=path,
        payload=payload,
        sha256=table.sha256(),
        time_ns=time_ns,
        **arrays,
        nan_counts={name: count for name, count in nan_counts.items() if count},
        dropped_rows=int((~kept).sum()),
        notes=(*table.notes, *in_packets),
    )
    return track(rig, log) if rig.motion.source == "joints" else log


def _groups(table: Table, rig: Rig) -> dict[str, tuple[str, ...]]:
    """The columns of a log that this rig can use, by field of `Log`, all of them present."""
    referenced = any(name in table.names for name in REFERENCE)  # which makes up for motion
    if not referenced:
        rig.check_motion(f"or ref_* columns in {table.path}")
    groups = {"raw": raw_columns(table, rig.sensor.n)}
    optional = {
        "acceleration": ACCELERATION,
        "specific_force": SPECIFIC_FORCE,
        "temperature": ("temperature",),
        "reference": REFERENCE,
    }
    source, weighed = rig.motion.source, rig.sensor.subtracted is not None
    fall = {"gravity": GRAVITY, "attitude": ATTITUDE}
    told = any(name in table.names for names in fall.values() for name in names)
    if source != "joints":
        twist = {"twist": TWIST}
        imu = {"angular_velocity": ANGULAR_VELOCITY, "specific_force": SPECIFIC_FORCE}
        motion = twist if source == "twist" else imu
        optional |= motion | fall
        if not referenced:
            groups |= motion
        if not told and (weighed or (source == "twist" and rig.in_gravity and not referenced)):
            groups["gravity"] = GRAVITY  # whose absence is told
    elif not referenced or (weighed and not told):
        groups |= joint_groups(table, rig)
    else:
        optional |= fall if weighed else {}
    groups |= {group: names for group, names in optional.items() if set(names).intersection(table.names)}
    for names in groups.values():
        poses = told and names is TWIST and not set(TWIST).intersection(table.names)
        require(table, names, f"; {AT_REST}" if poses else "")
    return groups


def write_table(path: str | Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write columns of equal length as CSV, or Parquet where the name ends so; NaN becomes an empty cell."""
    arrays = {name: pa.array(values, from_pandas=True) for name, values in columns.items()}
    batch = pa.RecordBatch.from_pydict(arrays)
    write_batches(path, [batch])


def read_columns(table: Table, names: Sequence[str]) -> tuple[Integers, dict[str, Array], dict[str, int]]:
    """Stamps, every column, and how many of its cells are NaN."""
    reader, rows = TimeReader(table), 0
    time_ns: Integers = np.empty(0, dtype=np.int64)
    columns = {name: np.empty(0) for name in names}
    nan_counts = dict.fromkeys(names, 0)
    for chunk in table.chunks([*reader.columns, *names]):
        end = rows + chunk.rows
        if end > len(time_ns):  # one array a column throughout: small ones would leave the memory in pieces
            time_ns = _longer(time_ns, end)
            columns = {name: _longer(columns.pop(name), end) for name in names}
        time_ns[rows:end] = reader.read(chunk)
        for name, values in columns.items():
            values[rows:end], count = numbers(chunk.column(name))
            nan_counts[name] += count
        rows = end
    return time_ns[:rows], {name: values[:rows] for name, values in columns.items()}, nan_counts


def _longer(values: npt.NDArray[Any], least: int) -> npt.NDArray[Any]:
    """The same with room for at least so many rows, and for twice as many as there are."""
    out = np.empty(max(least, 2 * len(values)), dtype=values.dtype)
    out[: len(values)] = values
    return out
