"""Parquet: typed columns, null where a stream has no sample."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from truewrench.io.cells import Column
from truewrench.io.table import Chunk, Table
from truewrench.model.errors import InputError

_ROWS = 1 << 15  # read at once


class _ParquetChunk(Chunk):
    def __init__(self, table: ParquetTable, batch: pa.RecordBatch, first_row: int) -> None:
        self.rows = batch.num_rows
        self._table = table
        self._batch = batch
        self._first_row = first_row

    def column(self, name: str) -> Column:
        cells = self._batch.column(self._batch.schema.get_field_index(name))
        if pa.types.is_dictionary(cells.type):
            cells = cells.dictionary_decode()
        return Column(self._table.path, name, cells, lambda i: f"row {self._first_row + i + 1}")

    def batch(self) -> pa.RecordBatch:
        return self._batch


class ParquetTable(Table):
    """A Parquet file; reading it costs a batch of rows and a page of each column."""

    def __init__(self, path: Path) -> None:
        self._file = self._open(path)
        super().__init__(path, self._file.schema_arrow.names)

    @staticmethod
    def _open(path: Path) -> pq.ParquetFile:
        try:
            # Mapped: Arrow's buffered streams hold on to the small pages that they have passed.
            return pq.ParquetFile(path, memory_map=True, pre_buffer=False)
        except (pa.ArrowException, OSError) as error:
            raise InputError.at(path, "", f"a broken file ({error})", "Parquet") from error

    def blocks(self, names: Sequence[str] | None) -> Iterator[Chunk]:
        """Batches of rows."""
        row = 0
        columns = None if names is None else list(names)
        batches = self._file.iter_batches(batch_size=_ROWS, columns=columns, use_threads=False)
        while True:
            try:
                batch = next(batches, None)
            except (pa.ArrowException, OSError) as error:
                raise InputError.at(self.path, f"after row {row}", f"a fault ({error})", "Parquet") from error
            if batch is None:
                return
            yield _ParquetChunk(self, batch, row)
            row += batch.num_rows
