"""Tables written batch by batch, CSV or Parquet by their name."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from truewrench.files import atomic_output

__all__ = ["is_parquet", "write_batches", "write_lines"]


def is_parquet(path: str | Path) -> bool:
    """Whether a file of this name is written as Parquet."""
    return Path(path).suffix.lower() in (".parquet", ".pq")


def write_batches(path: str | Path, schema: pa.Schema, batches: Iterable[pa.RecordBatch]) -> None:
    """Write batches of one schema; the file appears whole or not at all."""
    with atomic_output(path) as temporary:
        if is_parquet(path):
            with pq.ParquetWriter(temporary, schema) as parquet:
                for batch in batches:
                    parquet.write_batch(batch)
        else:
            plain = not any(set(name) & set(',"\r\n') for name in schema.names)
            options = pacsv.WriteOptions(quoting_header="none" if plain else "needed")
            with pacsv.CSVWriter(temporary, schema, write_options=options) as writer:
                for batch in batches:
                    writer.write_batch(batch)


def write_lines(path: str | Path, blocks: Iterable[bytes]) -> None:
    """Write blocks of whole lines; the file appears whole or not at all."""
    with atomic_output(path) as temporary, temporary.open("wb") as file:
        for block in blocks:
            file.write(block)
