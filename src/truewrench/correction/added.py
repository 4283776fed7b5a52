"""A log written again with columns after its own, in constant memory."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv

from truewrench.io.csv_table import CsvChunk, CsvTable
from truewrench.io.output import is_parquet, write_batches, write_lines
from truewrench.io.table import Chunk, Table
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError

Added = Iterator[tuple[Chunk, Array]]  # chunks in their order, with their cells (rows, columns); NaN is empty


def check_added(output: str | Path, table: Table, columns: Sequence[str] = ()) -> None:
    """Refuse an output that is the log itself, and a log that has one of the columns already."""
    if Path(output).exists() and Path(output).samefile(table.path):
        raise InputError.at(output, "", "the log itself", "another file to write")
    for name in columns:
        if name in table.names:
            expected = "a log without it"
            raise InputError.at(table.path, f"column `{name}`", "a column to be written", expected)


def write_added(
    output: str | Path,
    table: Table,
    columns: Sequence[str],
    read: list[str],
    added: Callable[[list[str] | None], Added],
) -> None:
    """Write a table with columns after its own, from CSV to CSV to the letter.

    `added` is given the columns to read: `read` where lines are written as they are, None for all.
    """
    if isinstance(table, CsvTable) and not is_parquet(output):
        write_lines(output, _lines(table, columns, added(read)))
    else:
        write_batches(output, _batches(columns, added(None)))


def _lines(table: CsvTable, columns: Sequence[str], added: Added) -> Iterator[bytes]:
    yield table.header + b"," + ",".join(columns).encode() + table.newline
    for chunk, cells in added:
        assert isinstance(chunk, CsvChunk)
        batch = pa.RecordBatch.from_arrays([pa.array(x, from_pandas=True) for x in cells.T], list(columns))
        sink = pa.BufferOutputStream()
        pacsv.write_csv(batch, sink, pacsv.WriteOptions(include_header=False))
        new = sink.getvalue().to_pybytes().splitlines()
        yield b"".join(a + b"," + b + table.newline for a, b in zip(chunk.lines, new, strict=True))


def _batches(columns: Sequence[str], added: Added) -> Iterator[pa.RecordBatch]:
    for chunk, cells in added:
        batch = chunk.batch()
        for name, column in zip(columns, cells.T, strict=True):
            batch = batch.append_column(name, pa.array(column, from_pandas=True))
        yield batch
