"""Samples of a stream come back in order of time, however they came, and their rate is known."""

from __future__ import annotations

import numpy as np
import pytest
from bags import MS, START
from hypothesis import given
from hypothesis import strategies as st

from truewrench.io.recordings import spool as module
from truewrench.io.recordings.cadence import Cadence
from truewrench.io.recordings.spool import Spool
from truewrench.model.arrays import Integers


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


def cadence(stamps: Integers, batch: int = 4096) -> Cadence:
    found = Cadence()
    for start in range(0, len(stamps), batch):
        found.add(stamps[start : start + batch])
    return found


def packets(size: int, count: int) -> Integers:
    """1 kHz that arrives in packets of a size, within 20 us each."""
    return (START + MS * size * np.arange(count)[:, None] + 20_000 * np.arange(size)).ravel()


@pytest.mark.parametrize(("size", "count"), [(7, 5), (7, 1500), (25, 20), (60, 1000)])
def test_rate_does_not_depend_on_packets(size: int, count: int) -> None:
    stamps = packets(size, count)
    found = cadence(stamps)
    assert found.rate == pytest.approx(1000, rel=1 / (count - 1))
    assert found.pauses == 0
    assert found.jitter > 1.0
    paused = cadence(np.append(stamps, stamps + stamps[-1] - START + 3600 * 1000 * MS))
    assert paused.rate == pytest.approx(1000, rel=1 / (count - 1))
    assert paused.pauses == 1


def test_pauses_wrong_stamps_and_a_clock_that_was_set_leave_the_rate() -> None:
    even = START + MS * np.arange(10_000)
    stamps = even.copy()
    stamps[3000:] += 400 * MS
    stamps[5000:] -= 3600 * 1000 * MS
    stamps[7000] = 0
    found = cadence(stamps)
    assert found.rate == pytest.approx(1000, rel=1e-6)
    assert found.jitter == pytest.approx(0, abs=1e-6)
    assert found.pauses == 1
    assert cadence(even[::-1]).rate == pytest.approx(1000)
    assert cadence(np.random.default_rng(0).permutation(even)).rate == pytest.approx(1000)


def test_rate_of_few_samples_is_that_over_all_their_time() -> None:
    burst = START + np.array([0, 190, *range(191, 200)]) * MS + np.arange(11) * 7
    assert cadence(burst).rate == pytest.approx(10 / 0.199, rel=1e-6)


def test_rate_is_none_while_no_time_passes() -> None:
    for stamps in ([], [START], [START] * 50):
        assert cadence(np.array(stamps, dtype=np.int64)).rate == 0.0
    assert cadence(np.array([START, START + 20 * MS])).rate == pytest.approx(50)


@given(st.lists(st.integers(0, 10**12), max_size=60), st.integers(1, 7))
def test_cadence_does_not_depend_on_the_batches(stamps: list[int], batch: int) -> None:
    whole, parts = (cadence(np.array(stamps, dtype=np.int64), size) for size in (100, batch))
    for name in ("samples", "late", "repeated", "first", "last", "pauses", "rate"):
        assert getattr(parts, name) == pytest.approx(getattr(whole, name), rel=1e-12)
