"""CSV: a header line, commas, one row a line."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
import pyarrow.csv as pacsv

from truewrench.io.cells import Column, numbers, to_nanoseconds
from truewrench.io.table import ACCELERATION, GRAVITY, SPECIFIC_FORCE, TWIST, Chunk, Table
from truewrench.model.calibration import AXES
from truewrench.model.errors import InputError

_BLOCK = 4 << 20  # bytes read at once
_HEADER = 1 << 20  # bytes of a header
_END = 1 << 18  # bytes of a file's end that tell whether its last line is whole
_TELLING = 50  # cells with a number that tell how long one is


class CsvChunk(Chunk):
    """Lines and their parsed cells, as text."""

    def __init__(
        self, table: CsvTable, lines: list[bytes], numbering: Sequence[int], first_row: int, cells: pa.Table
    ) -> None:
        self.rows = len(lines)
        self.lines = lines
        """Each row as it stands in the file, without its line end."""
        self._table = table
        self._numbering = numbering
        self._first_row = first_row
        self._cells = cells

    def column(self, name: str) -> Column:
        """The cells of one column, as text."""
        cells = self._cells.column(name).combine_chunks()
        return Column(self._table.path, name, cells, self._row_words)

    def _row_words(self, i: int) -> str:
        return f"row {self._first_row + i + 1} (line {self._numbering[i]})"

    def batch(self) -> pa.RecordBatch:
        """Times and columns of this package as numbers, all others as the text they are."""
        arrays = []
        for name in self._table.names:
            column = self.column(name)
            if name == "time_ns":
                arrays.append(pa.array(to_nanoseconds(column, per_second=False)))
            elif name in NUMERIC or name.startswith("raw_"):
                arrays.append(pa.array(numbers(column)[0], from_pandas=True))
            else:
                arrays.append(column.cells)
        return pa.RecordBatch.from_arrays(arrays, list(self._table.names))


NUMERIC = frozenset(
    ["time_s", *TWIST, *GRAVITY, *ACCELERATION, *SPECIFIC_FORCE, "temperature"]
    + [f"base_{name}" for name in (*TWIST, "qw", "qx", "qy", "qz")]
    + [f"ref_{name}" for name in AXES]
)
"""Columns that hold numbers in any log, besides raw_0, raw_1, ..."""


class CsvTable(Table):
    """A CSV file; reading it costs one block of memory."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            line, names = _read_header(path, file)
        self.newline = b"\r\n" if line.endswith(b"\r\n") else b"\n"
        self.header = line.rstrip(b"\r\n")  # as it stands in the file
        super().__init__(path, names)

    def blocks(self, names: Sequence[str] | None) -> Iterator[CsvChunk]:
        """Blocks of whole lines; blank lines are skipped."""
        with self.path.open("rb") as file:
            _check_end(self.path, file)
            file.seek(0)
            _read_header(self.path, file)
            line, row = 2, 0
            rest = b""
            while block := file.read(_BLOCK):
                whole, newline, rest = (rest + block).rpartition(b"\n")
                if newline:
                    lines = whole.split(b"\n")
                    chunk = self._parse(lines, line, row, names)
                    line, row = line + len(lines), row + chunk.rows
                    yield chunk
            if rest.strip():
                yield self._parse([rest], line, row, names)

    def _parse(self, lines: list[bytes], line: int, row: int, names: Sequence[str] | None) -> CsvChunk:
        numbering: Sequence[int] = range(line, line + len(lines))
        lines = [text.removesuffix(b"\r") for text in lines]
        if not all(lines):
            numbering = [number for number, text in zip(numbering, lines, strict=True) if text.strip()]
            lines = [text for text in lines if text.strip()]
        block = b"\n".join(lines)
        self._check_lines(block, lines, numbering)

        cells = self._read(block, numbering, row, names) if lines else self._no_cells()
        return CsvChunk(self, lines, numbering, row, cells)

    def _no_cells(self) -> pa.Table:
        return pa.table({name: pa.array([], pa.string()) for name in self.names})

    def _read(
        self, block: bytes, numbering: Sequence[int], row: int, names: Sequence[str] | None
    ) -> pa.Table:
        ragged: list[pacsv.InvalidRow] = []

        def refuse(invalid: pacsv.InvalidRow) -> str:
            ragged.append(invalid)
            return "error"

        try:
            return pacsv.read_csv(
                pa.BufferReader(block),
                # one thread: only so does Arrow count the rows that it refuses
                read_options=pacsv.ReadOptions(column_names=self.names, use_threads=False),
                parse_options=pacsv.ParseOptions(invalid_row_handler=refuse),
                convert_options=pacsv.ConvertOptions(
                    column_types=dict.fromkeys(self.names, pa.string()),
                    include_columns=None if names is None else list(names),
                    null_values=[],
                    strings_can_be_null=False,
                ),
            )
        except pa.ArrowInvalid as error:
            if not ragged:
                place = f"lines {numbering[0]} to {numbering[-1]}"
                raise InputError.at(self.path, place, f"unreadable text ({error})", "UTF-8 text") from None
        i = ragged[0].number - 1
        place = f"row {row + i + 1} (line {numbering[i]})"
        found = f"{ragged[0].actual_columns} cells"
        raise InputError.at(self.path, place, found, f"{len(self.names)}, as in the header")

    def _check_lines(self, block: bytes, lines: list[bytes], numbering: Sequence[int]) -> None:
        """What Arrow would take for other line ends than those counted here."""
        if b"\r" not in block and b'"' not in block:
            return
        for number, text in zip(numbering, lines, strict=True):
            if b"\r" in text:
                raise InputError.at(self.path, f"line {number}", "a carriage return within", "one row a line")
            if text.count(b'"') % 2:
                raise InputError.at(self.path, f"line {number}", "an unclosed quote", "one row a line")


def _read_header(path: Path, file: BinaryIO) -> tuple[bytes, list[str]]:
    line = file.readline(_HEADER + 1)
    if len(line) > _HEADER:
        raise InputError.at(
            path, "line 1", f"more than {_HEADER} bytes", "a header with the names of the columns"
        )
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        found = "a gzip file" if line.startswith(b"\x1f\x8b") else "bytes that are not text"
        raise InputError.at(path, "line 1", found, "a CSV header, or Parquet, unpacked") from None
    if not text.strip():
        found = "an empty line" if line else "an empty file"
        raise InputError.at(path, "line 1", found, "a header with the names of the columns")
    if "\r" in text.removesuffix("\n").removesuffix("\r"):
        raise InputError.at(path, "line 1", "a carriage return within", "one row a line")
    try:
        names = [name.strip() for name in next(csv.reader([text]))]
    except csv.Error as error:
        raise InputError.at(path, "line 1", str(error), "a header with the names of the columns") from None
    if text.startswith("#") or names[0].replace(".", "").isdigit():
        raise InputError.at(path, "line 1", f"{names[0][:60]!r}", "a header with the names of the columns")
    if len(names) == 1:
        raise InputError.at(path, "line 1", f"one column, {names[0][:60]!r}", "columns separated by commas")
    return line, names


def _check_end(path: Path, file: BinaryIO) -> None:
    """Refuse a last line that was cut off within its last cell; within another it has too few.

    Editors and programs leave out the last line end, too, so that its absence alone says nothing. But what is
    left of a number is shorter than any above it, or has fewer decimals, by two where theirs differ: a whole
    one is so once in many thousands. What cannot be told so has lost its last digits only, or is an integer
    among integers of any length.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _END))
    *lines, last = file.read().split(b"\n")
    cell, cells = _last_cell(last), [_last_cell(line) for line in lines[1:]]  # [0]: header, or a part
    numbers = [one for one in cells if one[-1:].isdigit()]
    # an end of line, words (`nan`, `true`), an empty cell that others have, too
    whole = last.endswith(b"\r") or cell.isalpha() or cell in cells
    if whole or not last.strip() or len(numbers) < _TELLING:
        return

    def short(measure: Callable[[bytes], int]) -> bool:
        sizes = [measure(number) for number in numbers]
        return measure(cell) < min(sizes) - (min(sizes) < max(sizes))

    if short(len) or short(_decimals):
        found = f"a line that ends within a number, `{cell.decode(errors='replace')}`"
        raise InputError.at(path, "last line", found, "a whole row, or a line end after it")


def _last_cell(line: bytes) -> bytes:
    """Without its sign."""
    return line.rpartition(b",")[2].strip().lstrip(b"+-")


def _decimals(cell: bytes) -> int:
    return len(cell.lower().partition(b"e")[0].partition(b".")[2])
