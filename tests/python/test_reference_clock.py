"""A sensor that is late against a reference that moves is found, and undone; the gain's sigma is honest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import truewrench as tw
from truewrench.estimation.reference_clock import with_reference_on_time
from truewrench.model.log import Log
from truewrench.model.rig import Rig

Array = np.ndarray[Any, np.dtype[np.float64]]

RATE, SECONDS, NOISE = 250.0, 20.0, 1e-3
RIG = Rig.from_mapping(
    {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": "payload_on_sensor",
            "noise": [NOISE] * 6,
            "range": [1.0] * 6,
            "gain_prior": 0.3,
        },
        "reference_noise": [NOISE] * 6,
        "required": 0.05,
    }
)


class Moving:
    """A wrench of four frequencies an axis at any time, and the gain and offset that read it."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.hertz = self.rng.uniform(0.1, 1.2, (4, 6))
        self.phase = self.rng.uniform(0.0, 6.28, (4, 6))
        self.gain = np.eye(6) + 0.2 * self.rng.standard_normal((6, 6))
        self.offset = 0.05 * self.rng.standard_normal(6)
        self.time = np.arange(round(RATE * SECONDS)) / RATE

    def wrench(self, time: Array) -> Array:
        return np.asarray(0.1 * np.sin(6.2832 * self.hertz * time[:, None, None] + self.phase).sum(axis=1))

    def noisy(self, values: Array) -> Array:
        return np.asarray(values + NOISE * self.rng.standard_normal(values.shape))

    def log(self, late: Array | float = 0.0) -> Log:
        """Sensor read so much [s] before its stamp."""
        raw = self.noisy(self.wrench(self.time - late) @ self.gain.T + self.offset)
        stamps = np.rint(1e9 * self.time).astype(np.int64)
        return Log(None, "default", "", stamps, raw, reference=self.noisy(self.wrench(self.time)))

    def nees(self, calibration: tw.Calibration) -> float:
        """Of the gain, over 36."""
        error = (calibration.gain - self.gain).ravel()
        return float(error @ np.linalg.solve(calibration.covariance[:36, :36], error)) / 36.0


def one_pole(values: Array, hertz: float) -> Array:
    share = 1.0 - np.exp(-2.0 * np.pi * hertz / RATE)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values - values[0], axis=0) + values[0])


def test_what_is_on_time_comes_back_as_it_is() -> None:
    for seed in range(30):
        log = Moving(seed).log()
        assert with_reference_on_time(RIG, log) == (log, None)


@pytest.mark.parametrize("late", [-0.02, 0.0017, 0.0063, 0.05])
def test_a_late_sensor_is_found_and_its_gain_is_honest(late: float) -> None:
    scores = []
    for seed in range(2):
        case = Moving(seed)
        log = case.log(late)
        clock = with_reference_on_time(RIG, log)[1]
        assert clock is not None
        assert abs(clock.late - late) < 4.0 * clock.late_std
        assert clock.late_std < 1e-4
        calibration = tw.calibrate(RIG, log, held_out=False)
        assert calibration.verdict.usable
        scores.append(case.nees(calibration))
    assert np.mean(scores) < 1.8  # as chi-square with 72 degrees of freedom, at 5 sigma
    words = "sensor is" if late > 0.0 else "reference is"
    assert any(words in one.evidence and "late against the" in one.evidence for one in calibration.assumed)


@pytest.mark.parametrize("whose", ["sensor", "reference"])
def test_a_filter_is_no_mere_delay(whose: str) -> None:
    """Of 8 ms: with w'' of a delay, gains would be off by 0.1%, 10 sigma."""
    scores, delays = [], []
    for seed in range(2):
        case = Moving(seed)
        log = case.log()
        if whose == "sensor":
            log = replace(
                log, raw=case.noisy(one_pole(case.wrench(case.time), 20.0) @ case.gain.T + case.offset)
            )
        else:
            log = replace(log, reference=case.noisy(one_pole(case.wrench(case.time), 20.0)))
        clock = with_reference_on_time(RIG, log)[1]
        assert clock is not None
        delays.append(clock.late)
        scores.append(case.nees(tw.calibrate(RIG, log, held_out=False)))
    tau = 1.0 / (2.0 * np.pi * 20.0) - 0.5 / RATE  # of the recursion
    assert np.mean(delays) == pytest.approx(tau if whose == "sensor" else -tau, abs=5e-4)
    assert np.mean(scores) < 2.0


def test_clocks_that_run_apart() -> None:
    case = Moving(1)
    late = 0.004 + 3e-4 * (case.time - 0.5 * SECONDS)
    clock = with_reference_on_time(RIG, case.log(late))[1]
    assert clock is not None
    assert clock.late == pytest.approx(0.004, abs=2e-4)
    assert clock.rate == pytest.approx(3e-4, rel=0.1)
    calibration = tw.calibrate(RIG, case.log(late), held_out=False)
    assert case.nees(calibration) < 2.0
    assert any("ppm" in one.evidence for one in calibration.assumed)


def test_streams_with_stamps_of_their_own() -> None:
    case = Moving(2)
    at = case.time + 0.0013
    stamps = np.rint(1e9 * np.sort(np.concatenate([case.time, at]))).astype(np.int64)
    raw, reference = np.full((stamps.size, 6), np.nan), np.full((stamps.size, 6), np.nan)
    raw[1::2] = case.noisy(case.wrench(at) @ case.gain.T + case.offset)
    reference[::2] = case.noisy(case.wrench(case.time))
    log = Log(None, "default", "", stamps, raw, reference=reference)
    calibration = tw.calibrate(RIG, log, held_out=False)
    assert calibration.verdict.usable
    assert case.nees(calibration) < 2.0
    assert any("stamps of their own" in note for note in calibration.figures["notes"])


def test_a_reference_that_a_driver_holds_is_no_reference_in_between() -> None:
    case = Moving(3)
    log = case.log()
    assert log.reference is not None
    held = np.repeat(log.reference[::10], 10, axis=0)
    calibration = tw.calibrate(RIG, replace(log, reference=held), held_out=False)
    assert case.nees(calibration) < 2.0
    assert calibration.logs[0].used == len(held) // 10


def test_each_log_has_a_clock_of_its_own() -> None:
    early, late = Moving(4), Moving(5)
    late.gain = early.gain
    calibration = tw.calibrate(RIG, [early.log(-0.003), late.log(0.011)], held_out=False)
    assert early.nees(calibration) < 2.0
    told = [one.value for one in calibration.assumed if "late against" in one.evidence]
    assert told == pytest.approx([-0.003, 0.011], abs=3e-4)


def test_an_offset_that_one_channel_alone_has() -> None:
    case = Moving(10)
    case.offset[1:] = 0.0
    rig = RIG.to_mapping()
    rig["sensor"]["offset_prior"] = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert case.nees(tw.calibrate(Rig.from_mapping(rig), case.log(0.005), held_out=False)) < 2.0


def test_ramps_between_loads_are_followed() -> None:
    case = Moving(6)
    loads = case.rng.uniform(-0.3, 0.3, (12, 6))
    corners = np.sort(np.concatenate([2.0 * np.arange(1, 11), 2.0 * np.arange(1, 11) - 0.3, [0.0, SECONDS]]))

    def wrench(time: Array) -> Array:
        held = np.repeat(loads[: corners.size // 2], 2, axis=0)
        return np.column_stack([np.interp(time, corners, x) for x in held.T])

    case.wrench = wrench  # type: ignore[method-assign]
    clock = with_reference_on_time(RIG, case.log(0.008))[1]
    assert clock is not None
    assert abs(clock.late - 0.008) < 4.0 * clock.late_std + 1e-4
    assert case.nees(tw.calibrate(RIG, case.log(0.008), held_out=False)) < 2.0


def test_a_calibration_is_validated_on_a_late_log_without_a_word_of_motion() -> None:
    case = Moving(8)
    calibration = tw.calibrate(RIG, case.log(0.004), held_out=False)
    other = Moving(9)
    other.gain = case.gain
    found = tw.validate(calibration, RIG, other.log(-0.007))
    assert found.verdict.usable, found.verdict.reasons
    for axis in found.axes.values():
        assert axis.nis == pytest.approx(1.0, abs=0.1)


def test_a_table_of_loads_is_left_alone() -> None:
    rng = np.random.default_rng(7)
    w = rng.uniform(-0.5, 0.5, (300, 6))
    stamps = (30_000_000_000 * np.arange(300)).astype(np.int64)
    log = Log(None, "default", "", stamps, w + NOISE * rng.standard_normal(w.shape), reference=w)
    assert with_reference_on_time(RIG, log) == (log, None)
