"""The cells of one column as numbers: text read exactly, every fault reported with its row.

Three things a cell can be: a number; empty (text without characters, or null), which means that the
stream has no sample; NaN, which is left out and counted.
"""

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError

_LARGEST_SECONDS = 9_000_000_000  # int64 nanoseconds end at 9.22e9 s
_UNITS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}  # [ns] of Arrow's timestamps


@dataclass(frozen=True, slots=True)
class Column:
    """Consecutive cells of one column, and where they stand."""

    file: Path
    name: str
    cells: pa.Array
    row_words: Callable[[int], str]
    """What a person calls a cell's row: `row 12 (line 13)`."""

    def error(self, i: int, found: str, expected: str) -> InputError:
        """The error of cell `i`."""
        return InputError.at(self.file, f"{self.row_words(i)}, column `{self.name}`", found, expected)


def numbers(column: Column) -> tuple[Array, int]:
    """Finite numbers (N,), NaN where there is none, and how many cells held NaN, empty ones not counted.

    Text and infinities are an InputError.
    """
    cells = column.cells
    values = _cast_text(column) if _is_text(cells) else _cast_numeric(column)
    result: Array = values.to_numpy(zero_copy_only=False)
    if np.isinf(result).any():
        i = int(np.flatnonzero(np.isinf(result))[0])
        raise column.error(i, repr(cells[i].as_py()), "a finite number, an empty cell or NaN")
    return result, int(np.isnan(result).sum()) - values.null_count


def _is_text(cells: pa.Array) -> bool:
    return bool(pa.types.is_string(cells.type) or pa.types.is_large_string(cells.type))


def _stripped(cells: pa.Array) -> pa.Array:
    """Without surrounding blanks, empty text as null."""
    text = pc.utf8_trim_whitespace(cells)
    return pc.if_else(pc.equal(text, ""), pa.scalar(None, text.type), text)


def _cast_text(column: Column) -> pa.Array:
    text = _stripped(column.cells)
    try:
        return pc.cast(text, pa.float64())
    except pa.ArrowInvalid:  # one cell is not a number, or spelt as Arrow does not know it ("+1.0")
        return pa.array([_to_float(column, i, cell) for i, cell in enumerate(text.to_pylist())], pa.float64())


def _to_float(column: Column, i: int, cell: str | None) -> float | None:
    if cell is None:
        return None
    try:
        if "_" in cell:
            raise ValueError
        return float(cell)
    except ValueError:
        expected = "a number, an empty cell or NaN"
        raise column.error(i, f"the text {cell!r}", expected) from None


def _cast_numeric(column: Column) -> pa.Array:
    kind = column.cells.type
    types = pa.types
    if not any(of(kind) for of in (types.is_integer, types.is_floating, types.is_decimal, types.is_null)):
        raise InputError.at(column.file, f"column `{column.name}`", f"values of type {kind}", "numbers")
    return pc.cast(column.cells, pa.float64(), safe=False)


def to_nanoseconds(column: Column, per_second: bool) -> Integers:
    """Time stamps as integer nanoseconds, rounded to the nearest, of cells in seconds or nanoseconds.

    A cell that is empty, NaN or no time, or does not fit into 64 bits, is an InputError.
    """
    cells = column.cells
    kind = cells.type
    if _is_text(cells):
        cells = _stripped(cells)
    if cells.null_count:
        i = int(np.flatnonzero(pc.is_null(cells).to_numpy(zero_copy_only=False))[0])
        raise column.error(i, "an empty cell", "a time in every row")
    if _is_text(cells):
        return _text_to_nanoseconds(column, cells, per_second)
    unit, words = (1_000_000_000 if per_second else 1), ""
    if pa.types.is_timestamp(kind) and not per_second:
        cells, unit, words = cells.cast(pa.int64()), _UNITS[kind.unit], f" {kind.unit}"
    elif not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise InputError.at(column.file, f"column `{column.name}`", f"values of type {kind}", "numbers")
    values: npt.NDArray[Any] = cells.to_numpy(zero_copy_only=False)
    whole = values.dtype.kind in "iu"
    limit = _LARGEST_SECONDS if per_second else (2**63 - 1) // unit if whole else 2.0**53
    fits = (values >= -limit) & (values <= limit)  # False for NaN
    if not per_second and not whole:
        fits &= values == np.rint(values)
        words = " in a column of floats, of 53 bits"
    if not fits.all():
        i = int(np.flatnonzero(~fits)[0])
        raise column.error(i, f"{values[i].item()!r}{words}", _expected_time(per_second))
    if not per_second or whole:
        stamps: Integers = values.astype(np.int64) * unit
        return stamps
    floor = np.floor(values)
    stamps = floor.astype(np.int64) * 1_000_000_000 + np.rint((values - floor) * 1e9).astype(np.int64)
    return stamps


def _expected_time(per_second: bool) -> str:
    return "seconds, at most 9e9 in size" if per_second else "whole nanoseconds that a 64-bit integer holds"


def _text_to_nanoseconds(column: Column, text: pa.Array, per_second: bool) -> Integers:
    plain = _plain_seconds(text) if per_second else _plain_integers(text)
    if plain is not None:
        return plain
    stamps = [_exact(column, i, cell, per_second) for i, cell in enumerate(text.to_pylist())]
    return np.array(stamps, dtype=np.int64)


def _plain_integers(text: pa.Array) -> Integers | None:
    try:
        result: Integers = pc.cast(text, pa.int64()).to_numpy(zero_copy_only=False)
    except pa.ArrowInvalid:
        return None
    return result


def _plain_seconds(text: pa.Array) -> Integers | None:
    """Digits with at most a point, which is nearly every file; None when a cell is spelt otherwise."""
    parts = pc.extract_regex(text, r"^(?P<sign>[+-]?)(?P<whole>[0-9]{1,9}|[1-8][0-9]{9})(?P<rest>\.[0-9]*)?$")
    if parts.null_count:
        return None
    sign, whole, rest = parts.flatten()
    digits = pc.utf8_rpad(pc.utf8_slice_codeunits(rest, 1, 11), 10, "0")
    seconds = pc.cast(whole, pa.int64()).to_numpy(zero_copy_only=False)
    tenths = pc.cast(digits, pa.int64()).to_numpy(zero_copy_only=False)  # of a nanosecond
    magnitude = seconds * 1_000_000_000 + (tenths + 5) // 10
    negative = pc.equal(sign, "-").to_numpy(zero_copy_only=False)
    result: Integers = np.where(negative, -magnitude, magnitude)
    return result


def _exact(column: Column, i: int, cell: str, per_second: bool) -> int:
    try:
        if "_" in cell:
            raise InvalidOperation
        time = Decimal(cell)
    except InvalidOperation:
        raise column.error(i, f"the text {cell!r}", _expected_time(per_second)) from None
    if not time.is_finite() or abs(time) > (_LARGEST_SECONDS if per_second else 2**63 - 1):
        raise column.error(i, cell, _expected_time(per_second))
    if not per_second and time != time.to_integral_value():
        raise column.error(i, cell, _expected_time(per_second))
    return int((time * 1_000_000_000 if per_second else time).to_integral_value())
