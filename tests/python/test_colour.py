"""Filtered noise: the filter is found by its spectrum and undone, and white noise is left as it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import light_rig
from scipy import signal
from scipy.ndimage import convolve1d, gaussian_filter1d
from scipy.signal import butter, lfilter

import truewrench as tw
from truewrench.estimation.colour import FEWEST, colour_of, without_filters
from truewrench.estimation.evenly import hann, welch
from truewrench.estimation.thinning import thinning_of
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.split import rows_of

Array = np.ndarray[Any, np.dtype[np.float64]]

RATE = 500.0  # [Hz]
NOISE = np.full(6, 1e-3)
SETTLED = 500  # samples after which a filter has forgotten where it began


def slow(time: Array, seed: int) -> Array:
    """Six motions of up to 2 Hz, a thousand times as large as the noise."""
    rng = np.random.default_rng(seed)
    f = rng.uniform(0.1, 2.0, (4, 6))
    return np.asarray(np.sum(np.sin(2 * np.pi * f * time[:, None, None] + 6.0 * rng.random((4, 6))), axis=1))


def samples(seed: int, count: int = 10_000) -> tuple[Array, Array, Array]:
    """Times, a motion, and it with white noise of 1e-3."""
    time = np.arange(count) / RATE
    clean = slow(time, seed)
    return time, clean, clean + 1e-3 * np.random.default_rng(seed + 1).standard_normal(clean.shape)


def one_pole(values: Array, hz: float) -> Array:
    """As `y += share * (x - y)` of a driver."""
    share = 1.0 - np.exp(-2.0 * np.pi * hz / RATE)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, axis=0))


@pytest.mark.parametrize("count", [FEWEST + 2, 1_500, 20_000])
def test_the_spectrum_is_scipys(count: int) -> None:
    values = samples(3, count)[2]
    expected = signal.welch(values, RATE, nperseg=FEWEST, axis=0, average="median")[1]
    np.testing.assert_allclose(welch(values, 1.0 / RATE, hann(FEWEST))[1:-1], expected[1:-1], rtol=1e-9)


def test_white_noise_is_left_as_it_is() -> None:
    for seed in range(40):
        time, _, noisy = samples(seed, 4_000)
        assert colour_of(time, noisy) is None


def starts_and_stops(seed: int, count: int = 15_000) -> Array:
    """Accelerations of quintic moves of 0.8 to 1.8 s with rests between, 300 times the noise."""
    rng = np.random.default_rng(seed)
    out = np.zeros((count, 6))
    begin = 0
    while begin < count:
        s = np.linspace(0.0, 1.0, int(RATE * rng.uniform(0.8, 1.8)))[:, None]
        move = (s - 3.0 * s**2 + 2.0 * s**3) * rng.uniform(-3.0, 3.0, 6)
        out[begin : begin + len(s)] += move[: count - begin]
        begin += len(s) + int(RATE * rng.uniform(0.2, 1.0))
    return out


def test_motions_that_start_and_stop_are_no_filter() -> None:
    found = 0
    for seed in range(40):
        moves = starts_and_stops(seed)
        noisy = moves + 1e-3 * np.random.default_rng(seed + 1).standard_normal(moves.shape)
        found += colour_of(np.arange(len(moves)) / RATE, noisy, NOISE) is not None
    assert found <= 1


@pytest.mark.parametrize("order", [1, 2])
def test_a_filter_is_found_beside_motions_that_start_and_stop(order: int) -> None:
    corners = []
    for seed in range(8):
        moves = starts_and_stops(seed)
        noisy = moves + 1e-3 * np.random.default_rng(seed + 1).standard_normal(moves.shape)
        filtered = lfilter(*butter(order, 40.0 / (0.5 * RATE)), noisy, axis=0)[SETTLED:]
        colour = colour_of(np.arange(len(filtered)) / RATE, filtered, NOISE)
        assert colour is not None
        corners.append(colour.corner * RATE)
    assert np.median(corners) == pytest.approx(40.0, rel=0.25)


def test_lines_steps_and_bursts_are_no_filter() -> None:
    time, _, noisy = samples(0)
    ripple = 0.01 * np.sin(2 * np.pi * 31.0 * time)[:, None]
    contact = np.where((time > 8.0) & (time < 8.4), 0.3, 0.0)[:, None]
    spikes = np.zeros_like(noisy)
    spikes[::211] = 0.1
    for disturbance in (ripple, contact, spikes):
        assert colour_of(time, noisy + disturbance) is None


def with_holes(
    seed: int, hz: float | None, rows: float, cells: float, late: float = 0.0
) -> tuple[Array, Array]:
    """Without this share of the rows and of the cells, filtered or not, stamps off by so many periods."""
    time, _, noisy = samples(seed, 6_000)
    rng = np.random.default_rng(seed + 2)
    values = noisy if hz is None else one_pole(noisy, hz)
    kept = rng.random(time.size) >= rows
    kept[:SETTLED] = False
    values = np.where(rng.random(values.shape) < cells, np.nan, values)
    return (time + late / RATE * rng.uniform(-1, 1, time.size))[kept], values[kept]


@pytest.mark.parametrize(
    ("rows", "cells", "late"),
    [(0.003, 0, 0), (0.01, 0, 0), (0.03, 0, 0.1), (0, 0.01, 0), (0, 0.03, 0), (0, 0, 0.3)],
)
def test_lost_rows_and_missing_cells_are_no_filter_and_hide_none(
    rows: float, cells: float, late: float
) -> None:
    white = [colour_of(*with_holes(seed, None, rows, cells, late)) for seed in range(12)]
    assert white == [None] * 12
    filtered = [colour_of(*with_holes(seed, 20.0, rows, cells, late)) for seed in range(12)]
    assert all(
        found is not None and found.corner * RATE == pytest.approx(20.0, rel=0.2) for found in filtered
    )


@pytest.mark.parametrize("length", [3, 5, 8, 16, 20])
def test_of_a_mean_of_samples_one_is_kept(length: int) -> None:
    time, _, noisy = samples(length)
    mean = lfilter(np.full(length, 1.0 / length), [1.0], noisy, axis=0)[SETTLED:]
    found = colour_of(time[SETTLED:], mean)
    assert found is not None
    assert found.step == length
    assert found.advance == 0.0
    kept = found.whitened(mean)
    assert np.array_equal(kept[::length], mean[::length])
    assert np.isnan(np.delete(kept, np.s_[::length], axis=0)).all()


@pytest.mark.parametrize("hz", [15.0, 25.0, 50.0, 90.0])
def test_one_pole_is_undone(hz: float) -> None:
    """What is left is the motion as it was, and white noise of the density before the filter."""
    time, clean, noisy = samples(int(hz), 30_000)
    found = colour_of(time[SETTLED:], one_pole(noisy, hz)[SETTLED:])
    assert found is not None
    pole = np.exp(-2.0 * np.pi * hz / RATE)
    growth = np.sqrt((1.0 + pole) / (1.0 - pole) / found.step)
    assert found.growth == pytest.approx(growth, rel=0.05)
    mean = 0.5 * (found.step - 1)  # by which those means are late, samples
    assert found.advance == pytest.approx(pole / (1.0 - pole) - mean, abs=0.02 * RATE / hz)
    undone = found.whitened(one_pole(clean, hz))[SETTLED:]
    rows = np.isfinite(undone[:, 0])
    late = slow(time[SETTLED:][rows] - mean / RATE, int(hz))
    assert np.abs(undone[rows] - late).max() < 2.5 / hz  # a tenth of what the filter takes


def filtered(log: Log, stream: str, order: int, hz: float) -> Log:
    b, a = butter(order, 2.0 * hz / RATE)
    values = lfilter(b, a, getattr(log, stream), axis=0)
    kept = slice(SETTLED, None)
    raw = log.raw if stream == "twist" else values
    twist = values if stream == "twist" else log.twist
    assert twist is not None
    return replace(log, time_ns=log.time_ns[kept], raw=raw[kept], twist=twist[kept])


@pytest.mark.parametrize(("stream", "sign"), [("raw", -1.0), ("twist", 1.0)])
@pytest.mark.parametrize(("order", "hz", "lost"), [(1, 20.0, 0.0), (2, 50.0, 0.0), (1, 20.0, 0.01)])
def test_filtered_records_are_honest_and_named(
    stream: str, sign: float, order: int, hz: float, lost: float
) -> None:
    """Their noise taken for white: NEES 1.9, one of eight usable, or ten times the time."""
    rig = light_rig(seconds=20, rate=RATE, discrepancy=0)
    errors, usable = [], 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        frequency = np.tile([[0.2], [0.37], [0.53], [0.71], [0.9], [1.1]], (1, 6))
        size, phase = 0.25 * rng.uniform(0.2, 0.7, (6, 6)), rng.uniform(0, 2 * np.pi, (6, 6))
        run = tw.simulate(rig, HarmonicTwist(size, frequency, phase, 20), seed=seed)
        log = filtered(run.log, stream, order, hz)
        log = rows_of(log, rng.random(len(log.time_ns)) >= lost)
        assert stream in without_filters(rig, log).whitened
        found = tw.calibrate(rig, log, held_out=False)
        error = (found.gain - run.truth.gain).ravel()
        errors.append(error @ np.linalg.solve(found.covariance[:36, :36], error) / 36.0)
        usable += found.verdict.usable
        assert any("filter" in assumed.what.split(":")[0] for assumed in found.assumed)
        delay = 1.0 / (2.0 * np.pi * hz) * (1.0 if order == 1 else np.sqrt(2.0))
        expected = run.truth.time_offset + sign * delay
        assert found.time_offset == pytest.approx(expected, abs=0.15 * delay)
    assert np.mean(errors) < 1.4
    assert usable >= 5


SMOOTHED = {
    "four poles of 8 Hz": lambda x: lfilter(*butter(4, 2.0 * 8.0 / RATE), x, axis=0),
    "two poles of 10 Hz, both ways": lambda x: signal.filtfilt(*butter(2, 2.0 * 10.0 / RATE), x, axis=0),
    "a mean of 0.1 s, centred": lambda x: convolve1d(x, np.full(51, 1.0 / 51.0), axis=0),
    "Savitzky and Golay's over 0.15 s": lambda x: signal.savgol_filter(x, 75, 3, axis=0),
    "Gauss's of 8 Hz": lambda x: gaussian_filter1d(x, 0.133 / 8.0 * RATE, axis=0),
}


@pytest.mark.parametrize("name", SMOOTHED)
def test_what_steep_filters_leave_is_thinned_to_white_noise(name: str) -> None:
    """Of one sample in D the noise is as good as white, and not much more than before."""
    for seed in range(4):
        time, clean, noisy = samples(seed, 15_000)
        found = colour_of(time[SETTLED:-SETTLED], SMOOTHED[name](noisy)[SETTLED:-SETTLED], NOISE)
        assert found is not None
        noise = SMOOTHED[name](noisy - clean)[SETTLED:-SETTLED]
        kept = found.whitened(noise)[:: found.step]
        neighbours = np.sum(kept[1:] * kept[:-1]) / np.sum(kept**2)
        assert abs(neighbours) < 0.3
        density = kept.var() * found.step / RATE  # of what was white: 1e-6 / RATE
        assert 0.7 < density / (1e-6 / RATE) < 1.6


def test_what_is_slow_is_not_thinned() -> None:
    """Walks and friction fall with frequency to the noise as it is stated, the density of a filter below."""
    for seed in range(20):
        time, _, noisy = samples(seed, 8_000)
        rng = np.random.default_rng(seed)
        walk = 3e-4 * rng.standard_normal(noisy.shape).cumsum(axis=0)
        steep = 2e-5 * rng.standard_normal(noisy.shape).cumsum(axis=0).cumsum(axis=0)
        play = 0.01 * np.clip(np.tanh(30.0 * np.gradient(slow(time, seed), time, axis=0)), -1.0, 1.0)
        for departure in (walk, steep, play):
            assert thinning_of(time, noisy + departure, NOISE) is None


@pytest.mark.parametrize("stream", ["raw", "twist"])
@pytest.mark.parametrize("name", SMOOTHED)
def test_smoothed_records_are_usable_and_honest(name: str, stream: str) -> None:
    """They were refused after up to 100 times a clean record's time; kappa tells what smoothing took."""
    rig = light_rig(seconds=20, rate=RATE, discrepancy=0)
    errors, usable = [], 0
    for seed in range(2):
        rng = np.random.default_rng(seed)
        frequency = np.tile([[0.2], [0.37], [0.53], [0.71], [0.9], [1.1]], (1, 6))
        size, phase = 0.25 * rng.uniform(0.2, 0.7, (6, 6)), rng.uniform(0, 2 * np.pi, (6, 6))
        run = tw.simulate(rig, HarmonicTwist(size, frequency, phase, 20), seed=seed)
        log = replace(run.log, **{stream: SMOOTHED[name](getattr(run.log, stream))})
        log = rows_of(log, np.arange(SETTLED, len(log.time_ns) - SETTLED))
        found = tw.calibrate(rig, log, held_out=False)
        error = (found.gain - run.truth.gain).ravel()
        errors.append(error @ np.linalg.solve(found.covariance[:36, :36], error) / 36.0)
        usable += found.verdict.usable
        assert any("filter" in assumed.what.split(":")[0] for assumed in found.assumed)
    assert np.mean(errors) < 1.4
    assert usable == 2


def test_smoothed_encoders_are_thinned_and_others_are_not() -> None:
    """A motion is 100,000 times as large as their noise, which steps of their resolution may be."""
    time = np.arange(12_000) / RATE
    for seed in range(6):
        rng = np.random.default_rng(seed)
        clean = slow(time, seed)
        noisy = clean + 1e-5 * rng.standard_normal(clean.shape)
        stated = np.full(6, 1e-5)
        coarse = np.round(clean / 3e-5) * 3e-5
        assert thinning_of(time, noisy, stated) is None
        assert thinning_of(time, coarse, stated) is None
        smoothed = SMOOTHED["two poles of 10 Hz, both ways"](noisy)
        found = thinning_of(time[SETTLED:-SETTLED], smoothed[SETTLED:-SETTLED], stated)
        assert found is not None
        assert 12.0 < RATE / found.step < 24.0  # its noise falls to half at 8 Hz
