"""A calibration while its log still grows (docs/live.md).

On the way `online` (of joints: `map`) is run on the record so far, anew whenever that has grown by a quarter,
so that all runs together cost a few times the last; what is written at the end is `map` on the whole record.
"""

import shutil
import tempfile
from array import array
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation.evidence import Evidence
from truewrench.io.tables import read_log, write_table
from truewrench.live.progress import Progress
from truewrench.live.stamps import RESTART, BeganAgainError
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.files import atomic_output
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of

Columns = Mapping[str, npt.NDArray[Any]]

FIRST = 2.0  # [s] of record for a first estimate
GROWTH = 1.25  # of the record between two

CALIBRATION = "calibration.yaml"
"""File of the result,"""

RECORD = "record.parquet"
"""and of what it rests on."""


def payload_of(rig: Rig, named: str | None) -> str:
    """The payload that the arm carries: the one named, else the rig's `default` or only one."""
    rig.check_motion("which a live calibration needs")
    known = ", ".join(rig.payloads)
    if named is None and "default" not in rig.payloads and len(rig.payloads) > 1:
        raise InputError.at(rig.path, "--payload", "nothing", f"what the arm carries, one of: {known}")
    return rig.payload_named("default" if named is None and "default" in rig.payloads else named)


class _Stream:
    """Samples of the same columns."""

    def __init__(self) -> None:
        self.time = array("q")
        self.values = array("d")


class Record:
    """A log that grows: samples of several streams, each at its own times, and one table of them all."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, ...], _Stream] = {}

    def add(self, names: tuple[str, ...], time_ns: int, values: Iterable[float]) -> str:
        """One sample, its columns in order, NaN where one has none, after that of the same columns before.

        A single stamp from far ahead is left out again as the next comes; what is returned says so, else it
        is empty.
        """
        stream = self._streams.get(names)
        if stream is None:
            stream = self._streams[names] = _Stream()
        told = ""
        if len(stream.time) > 1 and stream.time[-2] < time_ns <= stream.time[-1] - RESTART:
            told = f"time: {stream.time[-1]} ns stands alone, far ahead of {time_ns} ns: left out"
            stream.time.pop()
            del stream.values[-len(names) :]
        if stream.time and time_ns <= stream.time[-1]:
            if time_ns <= stream.time[-1] - RESTART:
                back = 1e-9 * (stream.time[-1] - time_ns)
                raise BeganAgainError(f"time: stamps begin again, {back:.3g} s back")
            raise InputError(f"time: {time_ns} ns after {stream.time[-1]} ns, expected time that increases")
        stream.time.append(time_ns)
        stream.values.extend(values)
        return told

    @property
    def samples(self) -> int:
        """Of all streams together."""
        return sum(len(stream.time) for stream in self._streams.values())

    @property
    def seconds(self) -> float:
        """From the first sample to the last."""
        times = [stream.time for stream in self._streams.values()]
        return 1e-9 * (max(t[-1] for t in times) - min(t[0] for t in times)) if times else 0.0

    def columns(self) -> Columns:
        """A table by time, `time_ns` first; NaN where a stream has no sample."""
        streams = {
            names: (np.array(stream.time), np.array(stream.values).reshape(-1, len(names)))
            for names, stream in self._streams.items()
        }
        time = np.unique(np.concatenate([np.zeros(0, np.int64), *(time for time, _ in streams.values())]))
        table: dict[str, npt.NDArray[Any]] = {"time_ns": time}
        for names, (at, values) in streams.items():
            rows = np.searchsorted(time, at)
            for name, column in zip(names, values.T, strict=True):
                whole = table.setdefault(name, np.full(len(time), np.nan))
                whole[rows] = np.where(np.isnan(column), whole[rows], column)
        return table


class LiveCalibration:
    """A record that grows, and estimates on the way; a context that ends with the estimates in work."""

    def __init__(self, rig: Rig, payload: str) -> None:
        if rig.motion.source == "joints":
            robot_of(rig)  # a fault of the robot is told before the first sample
        self.rig = rig
        self.record = Record()  # to be fed
        self.evidence: list[Evidence] = []  # of the result, for a report on it
        self._payload = payload
        self._worker = ThreadPoolExecutor(1)
        self._running: Future[Progress] | None = None
        self._next = FIRST

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._worker.shutdown(wait=True, cancel_futures=True)

    def poll(self) -> Progress | None:
        """An estimate that has just been finished, if any; begins the next when it is due."""
        if self._running is not None:
            if not self._running.done():
                return None
            progress = self._running.result()
            self._running = None
            return progress
        seconds = self.record.seconds
        self._next = min(self._next, max(FIRST, GROWTH * seconds))  # a stamp from far ahead was left out
        if seconds >= self._next:
            self._next = GROWTH * seconds
            self._running = self._worker.submit(self._estimate, self.record.columns(), self.record.samples)
        return None

    def finish(self, folder: Path | None) -> Progress:
        """The calibration from the whole record, as `calibrate` makes it of a log.

        A folder gets the record, which the result names as its log, and `calibration.yaml`; without one
        neither is kept. After an InputError, no calibration can be made from the record, nothing is written.
        """
        if self._running is not None:
            self._running.cancel()
        columns = self.record.columns()
        if not len(columns["time_ns"]):
            raise InputError("no sample has arrived: there is nothing to calibrate from")
        target = None if folder is None else folder / RECORD
        with self._written(columns) as path:
            log = replace(self._read(path), path=target)
            calibration = calibrate(self.rig, log, "map", evidence=self.evidence.append)
            if target is not None:
                try:
                    with atomic_output(target) as whole:
                        shutil.copyfile(path, whole)
                except InputError as error:  # of what cannot be recorded again
                    kept = Path(tempfile.mkdtemp(prefix="truewrench-")) / RECORD
                    shutil.copyfile(path, kept)
                    raise InputError(f"{error}; the record is kept as {kept}") from error
                calibration.write_yaml(target.with_name(CALIBRATION))
        return self._progress(columns, self.record.samples, calibration, final=True)

    def _estimate(self, columns: Columns, samples: int) -> Progress:
        try:
            with self._written(columns) as path:
                log = replace(self._read(path), path=None)
            way: Literal["map", "online"] = "map" if self.rig.motion.source == "joints" else "online"
            found = calibrate(self.rig, log, way, threads=1, held_out=False)
        except InputError as error:
            return self._progress(columns, samples, reason=str(error))
        except Exception as error:  # no fault on the way may cost the record
            return self._progress(columns, samples, reason=f"internal fault: {type(error).__name__}: {error}")
        return self._progress(columns, samples, found)

    @contextmanager
    def _written(self, columns: Columns) -> Iterator[Path]:
        """The record as a file, which is how logs are read."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / RECORD
            write_table(path, columns)
            yield path

    def _read(self, path: Path) -> Log:
        try:
            return read_log(f"{path}@{self._payload}", self.rig)
        except InputError as error:
            raise InputError(str(error).replace(str(path), "the record so far")) from None

    @staticmethod
    def _progress(
        columns: Columns,
        samples: int,
        calibration: Calibration | None = None,
        reason: str = "",
        final: bool = False,
    ) -> Progress:
        first, last = columns["time_ns"][[0, -1]]
        return Progress(int(last), 1e-9 * float(last - first), samples, calibration, reason, final)
