"""Samples of one stream in order of time, on disk while they are many."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from typing import IO

import numpy as np
import numpy.typing as npt

from truewrench.errors import InputError

__all__ = ["Spool"]

_ROWS = 1 << 14  # read at once


def _unnamed() -> IO[bytes]:
    """A file that is gone when it is closed, or forgotten."""
    return tempfile.TemporaryFile(prefix="truewrench-")


class Spool:
    """Rows of a time stamp and numbers, in a temporary file without a name.

    Attributes:
        width: how many numbers a row has.
        rows: how many there are.
        repeated: rows left out because an earlier one has their stamp; final after `finish`.
        late: rows that came with an earlier stamp than one before them.
        first, last: the earliest and the latest stamp [ns].
        rate: rows a second, from the median of the first periods; 0 while there is none.
        all_nan: whether no row has a number.
    """

    def __init__(self, width: int) -> None:
        self.width = width
        self._row = np.dtype([("time", "<i8"), ("values", "<f8", (width,))])
        self._file = _unnamed()
        self.rows = self.repeated = self.late = 0
        self.first = self.last = 0
        self.rate = 0.0
        self.all_nan = True

    def append(self, time: npt.NDArray[np.int64], values: npt.NDArray[np.float64]) -> None:
        """Add rows with stamps (N,) and numbers (N, width)."""
        if not len(time):
            return
        before = np.concatenate([time[:1] if not self.rows else [self.last], time[:-1]])
        late = int((time < np.maximum.accumulate(before)).sum())
        self.late += late
        if self.rows and not late and time[0] == self.last:
            self.repeated, time, values = self.repeated + 1, time[1:], values[1:]
        if not late and len(time):
            new = np.concatenate([[True], np.diff(time) > 0])
            self.repeated += int((~new).sum())
            time, values = time[new], values[new]
        if not len(time):
            return
        self.first = int(time.min()) if not self.rows else min(self.first, int(time.min()))
        self.last = int(time.max()) if not self.rows else max(self.last, int(time.max()))
        self.all_nan &= bool(np.isnan(values).all())
        if not self.rate and len(time) > 1:
            period = float(np.median(np.abs(np.diff(time))))
            self.rate = 1e9 / period if period else 0.0
        self.rows += len(time)
        self._write(self._file, self._joined(time, values))

    def finish(self) -> None:
        """Bring the rows into order of time, if they are not; of equal stamps the first stays."""
        if not self.late:
            self._file.flush()
            return
        self._file.flush()
        rows = np.memmap(self._file, self._row, "r", shape=(self.rows,))
        order = np.argsort(rows["time"], kind="stable")
        time = rows["time"][order]
        order = order[np.concatenate([[True], np.diff(time) > 0])]
        self.repeated += self.rows - len(order)
        target = _unnamed()
        for start in range(0, len(order), _ROWS):
            self._write(target, np.asarray(rows[order[start : start + _ROWS]]))
        target.flush()
        del rows
        self._file.close()
        self._file, self.rows = target, len(order)

    def blocks(self) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]]:
        """Stamps (N,) and numbers (N, width) in order of time, block by block."""
        size = self._row.itemsize
        for start in range(0, self.rows, _ROWS):
            count = min(_ROWS, self.rows - start)
            rows = np.frombuffer(os.pread(self._file.fileno(), count * size, start * size), self._row)
            yield rows["time"].astype(np.int64), rows["values"].astype(np.float64)

    def _joined(self, time: npt.NDArray[np.int64], values: npt.NDArray[np.float64]) -> npt.NDArray[np.void]:
        rows = np.empty(len(time), self._row)
        rows["time"], rows["values"] = time, values
        return rows

    @staticmethod
    def _write(file: IO[bytes], rows: npt.NDArray[np.void]) -> None:
        try:
            file.write(rows.tobytes())
        except OSError as error:
            folder = tempfile.gettempdir()
            raise InputError(f"{folder}: no room for the samples of a recording: {error.strerror}") from error
