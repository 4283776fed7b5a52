"""Samples of a stream come back in order of time, however they came."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truewrench.io.recordings import spool as module
from truewrench.io.recordings.spool import Spool


@given(st.lists(st.lists(st.integers(0, 30), max_size=12), max_size=8), st.integers(1, 5))
def test_rows_are_in_order_and_of_equal_stamps_the_first_stays(batches: list[list[int]], rows: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_ROWS", rows)
        spool, first, came = Spool(1), dict[int, int](), 0
        for batch in batches:
            numbers = np.arange(came, came + len(batch), dtype=np.float64)
            spool.append(np.array(batch, dtype=np.int64), numbers[:, None])
            for stamp, number in zip(batch, numbers, strict=True):
                first.setdefault(stamp, int(number))
            came += len(batch)
        spool.finish()
        blocks = list(spool.blocks())
    found = [(int(t), int(v[0])) for time, values in blocks for t, v in zip(time, values, strict=True)]
    assert found == sorted(first.items())
    assert spool.rows == len(first)
    assert spool.repeated == came - len(first)
    if first:
        assert (spool.first, spool.last) == (min(first), max(first))
    stamps = [stamp for batch in batches for stamp in batch]
    assert spool.late == sum(t < max(stamps[:k]) for k, t in enumerate(stamps) if k)


def test_what_has_no_number_anywhere_says_so() -> None:
    spool = Spool(2)
    spool.append(np.array([3, 1]), np.full((2, 2), np.nan))
    assert spool.all_nan
    spool.append(np.array([2]), np.array([[np.nan, 1.0]]))
    assert not spool.all_nan
