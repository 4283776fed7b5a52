"""Tables written batch by batch, CSV or Parquet by their name."""

from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from truewrench.model.errors import InputError
from truewrench.model.files import atomic_output


def is_parquet(path: str | Path) -> bool:
    """Whether a file of this name is written as Parquet."""
    return Path(path).suffix.lower() in (".parquet", ".pq")


def write_batches(path: str | Path, batches: Iterable[pa.RecordBatch]) -> None:
    """Write one or more batches of one schema; the file appears whole or not at all.

    InputError: it cannot be written, or a column is of a type that its format does not hold.
    """
    with atomic_output(path) as temporary:
        rest = iter(batches)
        first = next(rest)
        _check_types(path, first.schema)
        with _writer(path, temporary, first.schema) as writer:
            for batch in chain([first], rest):
                try:
                    writer.write_batch(batch)
                except pa.ArrowException as error:
                    raise InputError(f"{path}: cannot be written: {error}") from error


def _check_types(path: str | Path, schema: pa.Schema) -> None:
    for field in schema:
        try:
            _writer(path, pa.BufferOutputStream(), pa.schema([field]))
        except pa.ArrowException as error:
            found, expected = f"values of type {field.type}", "numbers or text, or a file named .parquet"
            raise InputError.at(path, f"column `{field.name}`", found, expected) from error


def _writer(
    path: str | Path, sink: Path | pa.NativeFile, schema: pa.Schema
) -> pq.ParquetWriter | pacsv.CSVWriter:
    if is_parquet(path):
        return pq.ParquetWriter(sink, schema)
    plain = not any(set(name) & set(',"\r\n') for name in schema.names)
    options = pacsv.WriteOptions(quoting_header="none" if plain else "needed")
    return pacsv.CSVWriter(sink, schema, write_options=options)


def write_lines(path: str | Path, blocks: Iterable[bytes]) -> None:
    """Write blocks of whole lines; the file appears whole or not at all."""
    with atomic_output(path) as temporary, temporary.open("wb") as file:
        for block in blocks:
            file.write(block)
