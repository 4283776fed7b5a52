"""A recording as a table: its streams over the union of their stamps, empty cells where one has no sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from truewrench.io.cells import Column
from truewrench.io.recordings.reader import open_recording, sha256_of
from truewrench.io.recordings.selection import Selection, select
from truewrench.io.recordings.spool import Spool
from truewrench.io.table import Chunk, Table
from truewrench.model.arrays import Array, Integers
from truewrench.model.rig import Rig


class _RecordingChunk(Chunk):
    def __init__(self, table: RecordingTable, time: Integers, parts: dict[int, tuple[Integers, Array]]):
        self.rows = len(time)
        self._table = table
        self._time = time
        self._parts = parts  # per stream: the rows in which it has samples, and these

    def column(self, name: str) -> Column:
        return Column(self._table.path, name, self._cells(name), lambda i: f"stamp {self._time[i]} ns")

    def batch(self) -> pa.RecordBatch:
        names = list(self._table.names)
        return pa.RecordBatch.from_arrays([self._cells(name) for name in names], names)

    def _cells(self, name: str) -> pa.Array:
        if name == "time_ns":
            return pa.array(self._time)
        stream, j = self._table.places[name]
        values, empty = np.zeros(self.rows), np.ones(self.rows, dtype=bool)
        rows, samples = self._parts[stream]
        values[rows], empty[rows] = samples[:, j], False
        return pa.array(values, mask=empty)


class RecordingTable(Table):
    """What a rig needs of a recording: its sensor, motion and `recording` say which topics are read.

    Reading it costs a batch of messages of each topic; their numbers wait in temporary files. Unless `whole`,
    motion that cannot be read is left out, and a note says so. InputError: the recording is broken, or does
    not tell which topics are meant.
    """

    def __init__(
        self, path: Path, rig: Rig, *, whole: bool = True, progress: Callable[[int], object] | None = None
    ) -> None:
        with open_recording(path) as recording:
            selection: Selection = select(recording, rig, whole, progress)
        self._streams = selection.streams
        self.places = selection.places  # of the columns: number of the stream, and position in it
        super().__init__(path, ["time_ns", *self.places])
        self.notes = selection.notes

    def sha256(self) -> str:
        """Of the file, or of the folder as `sha256sum * | sha256sum` would give it."""
        return sha256_of(self.path)

    def blocks(self, names: Sequence[str] | None) -> Iterator[Chunk]:
        """Rows in order of time; with `names`, those in which one of these columns has a sample."""
        wanted = [name for name in (self.places if names is None else names) if name in self.places]
        needed = sorted({self.places[name][0] for name in wanted})
        for time, parts in _merged({k: self._streams[k].spool for k in needed}):
            yield _RecordingChunk(self, time, parts)


def _merged(spools: dict[int, Spool]) -> Iterator[tuple[Integers, dict[int, tuple[Integers, Array]]]]:
    """The union of the stamps, block by block; per stream its rows among them and its samples."""
    sources = {k: spool.blocks() for k, spool in spools.items()}
    ahead: dict[int, tuple[Integers, Array]] = {}
    empty = {k: np.empty((0, spool.width)) for k, spool in spools.items()}
    while True:
        for k in [k for k in sources if k not in ahead or not len(ahead[k][0])]:
            block = next(sources[k], None)
            if block is None:
                del sources[k]
                ahead.pop(k, None)
            else:
                ahead[k] = block
        if not ahead:
            return
        horizon = min(int(time[-1]) for time, _ in ahead.values())
        taken: dict[int, tuple[Integers, Array]] = {}
        for k, (time, values) in ahead.items():
            n = int(np.searchsorted(time, horizon, side="right"))
            taken[k] = (time[:n], values[:n])
            ahead[k] = (time[n:], values[n:])
        union = np.unique(np.concatenate([time for time, _ in taken.values()]))
        nothing = np.empty(0, dtype=np.int64)
        parts = {
            k: (np.searchsorted(union, taken[k][0]), taken[k][1]) if k in taken else (nothing, empty[k])
            for k in spools
        }
        yield union, parts
