"""Samples of one stream in order of time, on disk while they are many."""

import os
import tempfile
from collections.abc import Iterator
from typing import IO

import numpy as np
import numpy.typing as npt

from truewrench.io.recordings.cadence import Cadence
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError

_ROWS = 1 << 14  # read at once


def _unnamed() -> IO[bytes]:
    """A file that is gone when it is closed, or forgotten."""
    return tempfile.TemporaryFile(prefix="truewrench-")


class Spool:
    """Rows of a time stamp and numbers, in a temporary file without a name."""

    def __init__(self, width: int) -> None:
        self.width = width  # how many numbers a row has
        self._row = np.dtype([("time", "<i8"), ("values", "<f8", (width,))])
        self._file = _unnamed()  # in order of time,
        self._late = _unnamed()  # and those that came late
        self.rows = 0
        self.repeated = 0  # rows left out because an earlier one has their stamp; final after `finish`
        self._cadence = Cadence()
        self.all_nan = True  # whether no row has a number

    @property
    def late(self) -> int:
        """Rows that came with an earlier stamp than one before them."""
        return self._cadence.late

    @property
    def first(self) -> int:
        """The earliest stamp [ns]."""
        return self._cadence.first

    @property
    def last(self) -> int:
        """The latest stamp [ns]."""
        return self._cadence.last

    @property
    def rate(self) -> float:
        """Rows a second, pauses left out; 0 while there is none."""
        return self._cadence.rate

    def append(self, time: Integers, values: Array) -> None:
        """Add rows with stamps (N,) and numbers (N, width)."""
        if not len(time):
            return
        earlier = self._cadence.add(time)
        late = time < earlier
        self.repeated += int((time == earlier).sum())
        if late.any():
            self._write(self._late, self._joined(time[late], values[late]))
        self.all_nan &= bool(np.isnan(values).all())
        new = time > earlier
        self.rows += int(new.sum())
        self._write(self._file, self._joined(time[new], values[new]))

    def finish(self) -> None:
        """Bring late rows to their places; of equal stamps the first that came stays."""
        self._file.flush()
        if not self.late:
            return
        self._late.flush()
        late = np.memmap(self._late, self._row, "r", shape=(self.late,))
        time, first = np.unique(late["time"], return_index=True)
        target, before, rows = _unnamed(), 0, 0
        for block in self._rows():
            after = int(np.searchsorted(time, block["time"][-1], side="right"))
            new = first[before:after][~np.isin(time[before:after], block["time"])]
            merged = np.concatenate([block, late[new]])
            self._write(target, merged[np.argsort(merged["time"])])
            before, rows = after, rows + len(merged)
        self.repeated += self.rows + self.late - rows
        target.flush()
        del late
        self._file.close()
        self._late.close()
        self._file, self.rows = target, rows

    def blocks(self) -> Iterator[tuple[Integers, Array]]:
        """Stamps (N,) and numbers (N, width) in order of time, block by block."""
        for rows in self._rows():
            yield rows["time"].astype(np.int64), rows["values"].astype(np.float64)

    def _rows(self) -> Iterator[npt.NDArray[np.void]]:
        size = self._row.itemsize
        for start in range(0, self.rows, _ROWS):
            count = min(_ROWS, self.rows - start)
            yield np.frombuffer(os.pread(self._file.fileno(), count * size, start * size), self._row)

    def _joined(self, time: Integers, values: Array) -> npt.NDArray[np.void]:
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
