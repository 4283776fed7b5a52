"""Samples that travel in packets: their times are found again, and those of others are left alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from record_cases import estimate, light_rig, nees

import truewrench as tw
from truewrench.io.stamps import in_packets, with_even_stamps
from truewrench.io.tables import read_log, write_table
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist

Stamps = npt.NDArray[np.int64]

PERIOD = 1_000_000  # [ns]


def arrivals(
    time_ns: Stamps, size: int, rng: np.random.Generator, late: float = 0.3e6, phase: int = 0
) -> Stamps:
    """Stamps of receipt: packets leave with their last sample, and are late by an exponential time [ns]."""
    last = np.minimum((np.arange(time_ns.size) + phase) // size * size + size - 1 - phase, time_ns.size - 1)
    behind = rng.exponential(late, time_ns.size)[last].astype(np.int64)
    apart = 1_000 * np.arange(time_ns.size)  # in order, whatever was late
    return np.maximum.accumulate(time_ns[last] + behind - apart) + apart


@settings(max_examples=50, deadline=None)
@given(size=st.integers(2, 60), seed=st.integers(0, 10_000), phase=st.integers(0, 59))
def test_packets_give_back_the_times_of_their_samples(size: int, seed: int, phase: int) -> None:
    true = PERIOD * np.arange(4_000)
    found = in_packets(arrivals(true, size, np.random.default_rng(seed), phase=phase % size))
    assert found is not None
    error = found - true
    assert np.abs(error - np.median(error)).max() < 0.3e6  # the scatter of one delay


def test_a_lost_packet_moves_no_other() -> None:
    """Two of a hundred are lost; where that goes unnoticed, those near by move by less than two packets."""
    typical, worst = [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        size = int(rng.integers(4, 41))
        true = PERIOD * np.arange(4_000)
        lost = rng.uniform(size=4_000 // size + 1) < 0.02
        kept = ~lost[np.arange(4_000) // size]
        found = in_packets(arrivals(true, size, rng)[kept])
        assert found is not None
        error = np.abs(found - true[kept] - np.median(found - true[kept]))
        typical.append(np.quantile(error, 0.95))
        worst.append(error.max() / size / PERIOD)
    assert np.mean(np.array(typical) < 0.8e6) >= 0.97
    assert max(worst) < 2.0


@settings(max_examples=50, deadline=None)
@given(jitter=st.floats(0.0, 0.5), seed=st.integers(0, 10_000))
def test_stamps_that_scatter_are_left_alone(jitter: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(2_000) + (jitter * PERIOD * rng.standard_normal(2_000)).astype(np.int64)
    assert in_packets(np.unique(time)) is None


def test_dwells_are_no_packets() -> None:
    """A hundred samples in each of twenty poses, seconds apart."""
    assert in_packets((np.arange(100) * PERIOD + np.arange(20)[:, None] * 5_000_000_000).ravel()) is None


def test_two_publishers_are_two_streams() -> None:
    """Parts of an arm that are published one shortly after the other."""
    time = np.sort(np.concatenate([PERIOD * np.arange(500), PERIOD * np.arange(500) + 50_000]))
    columns = {"q_a": np.full(1_000, np.nan), "q_b": np.full(1_000, np.nan)}
    columns["q_a"][::2], columns["q_b"][1::2] = 1.0, 2.0
    stamps, out, notes = with_even_stamps(time, columns)
    assert notes == ()
    assert stamps is time
    assert out is columns


@pytest.mark.parametrize("of_motion", [False, True])
def test_packets_cost_the_gain_nothing(tmp_path: Path, of_motion: bool) -> None:
    """One or both streams in packets of 50 ms; as stamped, sigma is twice or four times as large."""
    rig = light_rig(seconds=20, rate=500, discrepancy=0)
    errors, sigma = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        frequency = np.tile([[0.2], [0.37], [0.53], [0.71], [0.9], [1.1]], (1, 6))
        size, phase = 0.25 * rng.uniform(0.2, 0.7, (6, 6)), rng.uniform(0, 2 * np.pi, (6, 6))
        run = tw.simulate(rig, HarmonicTwist(size, frequency, phase, 20), seed=seed)
        time = run.log.time_ns
        for packets in (False, True):
            raw = arrivals(time, 25, rng) if packets else time
            moved = arrivals(time, 25, rng, phase=12) if packets and of_motion else time + 7
            write_table(tmp_path / "log.csv", table(run.log, raw, moved))
            log = read_log(tmp_path / "log.csv", rig)
            assert len(log.notes) == packets * (1 + of_motion)
            found = estimate(rig, log)
            sigma.append(np.sqrt(np.trace(np.asarray(found.gain_covariance))))
            if packets:
                errors.append(nees(found, rig, run.truth))
    assert 0.75 < np.mean(errors) < 1.25
    assert np.mean(sigma[1::2]) < 1.1 * np.mean(sigma[::2])


def table(log: Log, raw: Stamps, moved: Stamps) -> dict[str, Any]:
    """Columns of a log whose sensor and motion have stamps of their own."""
    union = np.unique(np.concatenate([raw, moved]))
    columns: dict[str, Any] = {"time_ns": union}
    names = ([f"raw_{i}" for i in range(6)], ["vx", "vy", "vz", "wx", "wy", "wz"])
    for stamps, values, of in ((raw, log.raw, names[0]), (moved, log.twist, names[1])):
        for name, column in zip(of, values.T, strict=True):
            columns[name] = np.full(union.size, np.nan)
            columns[name][np.searchsorted(union, stamps)] = column
    return columns


def test_after_a_stall_samples_are_spread_over_it() -> None:
    """Now and then a logger sleeps, and stamps what has waited at once."""
    true = PERIOD * np.arange(4_000)
    stamps, rng = true.copy(), np.random.default_rng(3)
    for first in rng.choice(np.arange(50, 3_900, 60), 20, replace=False):
        count = int(rng.integers(6, 40))
        stamps[first : first + count] = true[first + count - 1] + 20_000 * np.arange(count) - 20_000 * count
    found = in_packets(stamps)
    assert found is not None
    assert np.abs(stamps - true).max() > 30e6
    assert np.abs(found - true).max() < 0.1e6
