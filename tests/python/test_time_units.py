"""Arrow's time stamps of every unit are nanoseconds, and those beyond 64 bits are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from truewrench.io.cells import Column, to_nanoseconds
from truewrench.model.errors import InputError

UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def column(values: list[int], unit: str) -> Column:
    cells = pa.array(values, pa.timestamp(unit, tz="UTC"))
    return Column(Path("log.parquet"), "time_ns", cells, lambda i: f"row {i + 1}")


@pytest.mark.parametrize("unit", UNITS)
def test_stamps_of_every_unit_are_nanoseconds(unit: str) -> None:
    last = (2**63 - 1) // UNITS[unit]
    found = to_nanoseconds(column([-3, 0, 7, last, -last], unit), per_second=False)
    np.testing.assert_array_equal(found, np.array([-3, 0, 7, last, -last]) * UNITS[unit])


@pytest.mark.parametrize("unit", ["s", "ms", "us"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_stamp_beyond_64_bits_is_named(unit: str, sign: int) -> None:
    beyond = sign * ((2**63 - 1) // UNITS[unit] + 1)
    expected = rf"^log\.parquet: row 2, column `time_ns`: found {beyond} {unit}, expected whole nanoseconds"
    with pytest.raises(InputError, match=expected):
        to_nanoseconds(column([0, beyond], unit), per_second=False)
