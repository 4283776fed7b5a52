"""Known wrenches whose errors last: dense least squares, laws, chance, and what is left out and said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation import log_agreement
from truewrench.estimation.known_wrench import KnownWrenchEstimate, estimate_from_known_wrench
from truewrench.estimation.lasting_errors import ErrorSize
from truewrench.estimation.log_agreement import agreement_of_known_halves
from truewrench.estimation.reference_clock import ReferenceClock
from truewrench.estimation.wrench_errors import FoundErrors
from truewrench.model.log import Log
from truewrench.model.rig import Rig

Array = NDArray[np.float64]

SPAN = np.array([100.0, 100.0, 100.0, 10.0, 10.0, 10.0])
NOISE = 1e-3  # of sensor and reference, fraction of range
RATE = 25.0


def rig_of(reference: float = NOISE, span: Array = SPAN, **sensor: Any) -> Rig:
    body = {"mass": 1, "center_of_mass": [0, 0, 0], "inertia": {"xx": 1, "yy": 1, "zz": 1}}
    settings = {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": (NOISE * span).tolist(),
        "range": span.tolist(),
        "gain_prior": 0.2,
    }
    return Rig.from_mapping(
        {
            "sensor": settings | sensor,
            "payloads": {"default": body},
            "motion": {"noise": [1e-3] * 6},
            "reference_noise": (reference * span).tolist(),
        }
    )


def moving(draw: np.random.Generator, seconds: float = 30.0) -> tuple[Array, Array]:
    """Times [s], and wrenches in fractions of range: three frequencies an axis."""
    time = np.arange(round(seconds * RATE)) / RATE
    hertz, phase = draw.uniform(0.1, 1.0, (2, 3, 6)), draw.uniform(0.0, 6.3, (3, 6))
    return time, 0.2 * np.sin(2.0 * np.pi * hertz[0] * time[:, None, None] + phase).sum(axis=1)


def held(draw: np.random.Generator, loads: int = 40) -> tuple[Array, Array]:
    """Likewise; loads of two seconds, without a way between them."""
    time = np.arange(round(2.0 * loads * RATE)) / RATE
    return time, np.repeat(0.5 * draw.uniform(-1.0, 1.0, (loads, 6)), round(2.0 * RATE), axis=0)


def ornstein_uhlenbeck(draw: np.random.Generator, time: Array, lasts: float) -> Array:
    """(N, 6) by the Cholesky factor of the dense covariance."""
    K = np.exp(-np.abs(time[:, None] - time) / lasts)
    return np.asarray(np.linalg.cholesky(K + 1e-9 * np.eye(len(time))) @ draw.normal(size=(len(time), 6)))


def log_of(
    rig: Rig, time: Array, wrench: Array, gain: Array, offset: Array, errors: Array, draw: np.random.Generator
) -> Log:
    """Gain, offset, wrench and errors in fractions of range."""
    span, noise = rig.sensor.range_array, np.array(rig.reference_noise)
    raw = (wrench @ gain.T + offset + errors) * span + rig.sensor.noise_array * draw.normal(size=wrench.shape)
    reference = wrench * span + noise * draw.normal(size=wrench.shape)
    stamps = np.rint(time * 1e9).astype(np.int64)
    return Log(None, "default", "", stamps, raw, reference=reference)


def truth(draw: np.random.Generator) -> tuple[Array, Array]:
    return np.eye(6) + 0.2 * draw.normal(size=(6, 6)), 0.1 * draw.normal(size=6)


def example(kind: str, seed: int = 0, size: float = 5e-3, **rig: Any) -> tuple[Rig, Log, Array, Array]:
    """A log whose errors last for a second, or a plateau; with its gain and offset."""
    draw = np.random.default_rng(seed)
    time, wrench = moving(draw) if kind == "moving" else held(draw)
    made = rig_of(**rig)
    gain, offset = truth(draw)
    if kind == "moving":
        errors = size * ornstein_uhlenbeck(draw, time, 1.0)
    else:
        errors = size * np.repeat(draw.normal(size=(40, 6)), round(2.0 * RATE), axis=0)
    return made, log_of(made, time, wrench, gain, offset, errors, draw), gain, offset


def deviates(rig: Rig, found: KnownWrenchEstimate, gain: Array, offset: Array) -> Array:
    span = rig.sensor.range_array
    error = np.append((found.gain / span[:, None] * span - gain).ravel(), found.offsets[-1] / span - offset)
    return np.asarray(error / np.sqrt(np.diag(found.normalised_covariance)))


def test_given_sizes_the_estimate_is_dense_generalised_least_squares() -> None:
    """With an exact reference: channel by channel (Z^T V^-1 Z + Pi^-1)^-1, all matrices dense."""
    rig, log, _, _ = example("moving", reference=1e-9)
    assert log.reference is not None
    sizes = tuple(ErrorSize(1.0 + 0.1 * i, 20.0, 0.5 + 0.3 * i) for i in range(6))
    given = FoundErrors(False, (0,), sizes, np.zeros(6), True, True)
    found = estimate_from_known_wrench(rig, [log], [given])
    Z = np.column_stack([log.reference / SPAN, np.ones(len(log.raw))])
    apart = np.abs(log.time[:, None] - log.time)
    prior = np.append(np.full(6, 0.2**-2.0), 0.1**-2.0)
    for i, size in enumerate(sizes):
        T = size.white * np.eye(len(Z)) + size.lasting * np.exp(-apart / size.time)
        V = np.linalg.inv(T) / NOISE**2
        covariance = np.linalg.inv(Z.T @ V @ Z + np.diag(prior))
        start = np.append(np.eye(6)[i], 0.0)
        expected = covariance @ (Z.T @ V @ log.raw[:, i] / SPAN[i] + prior * start)
        got = np.append(found.gain[i] * SPAN / SPAN[i], found.offsets[0, i] / SPAN[i])
        sigma = np.sqrt(np.diag(covariance))
        # Z without the frequencies at which there is no wrench
        np.testing.assert_allclose(got, expected, atol=0.05 * sigma.max())
        own = [6 * i + j for j in range(6)] + [36 + i]
        ratio = np.sqrt(np.diag(found.normalised_covariance)[own]) / sigma
        assert ratio.min() > 0.99  # and what not knowing the sizes adds
        assert ratio.max() < 2.0


@pytest.mark.parametrize("kind", ["moving", "held"])
def test_errors_that_last_are_found(kind: str) -> None:
    rig, log, gain, offset = example(kind)
    found = estimate_from_known_wrench(rig, [log])
    (errors,) = found.errors
    assert errors.stepped == (kind == "held")
    assert errors.found
    assert errors.last
    stated = np.sqrt(NOISE**2 + NOISE**2 * np.sum(gain**2, axis=1))
    np.testing.assert_allclose(np.sqrt([s.white for s in errors.sizes]), 1.0, atol=0.12)
    np.testing.assert_allclose(np.sqrt([s.lasting for s in errors.sizes]) * stated, 5e-3, rtol=0.6)
    if kind == "moving":
        np.testing.assert_allclose(np.log([s.time for s in errors.sizes]), 0.0, atol=1.0)
    assert np.abs(deviates(rig, found, gain, offset)).max() < 4.5
    assert found.outliers[0].size == 0
    chi_square = found.sum_of_squares / found.freedom
    np.testing.assert_allclose(chi_square, 1.0, atol=0.1)
    said = [f for f in found.findings if f.what.startswith("drift, hysteresis or cable")]
    assert [f.where for f in said] == [f"channel {name}" for name in rig.sensor.channels]
    assert all(f.value == pytest.approx(5e-3, rel=0.6) and f.sigma and "last for" in f.evidence for f in said)
    total = sum(float(squares.sum()) for squares in found.squares)
    assert total / found.freedom.sum() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("kind", ["moving", "held"])
def test_intervals_hold_the_truth_where_errors_last(kind: str) -> None:
    """24 logs; as if rows were independent, few of them do."""
    z, white = [], []
    for seed in range(24):
        rig, log, gain, offset = example(kind, seed, size=3e-3)
        z.append(deviates(rig, estimate_from_known_wrench(rig, [log]), gain, offset))
        white.append(deviates(rig, estimate_from_known_wrench(rig, [log], ()), gain, offset))
    assert 0.91 < np.mean(np.abs(z) < 1.96) < 0.985
    assert np.abs(z).max() < 6.0
    assert np.mean(np.abs(white) < 1.96) < 0.6


def test_rows_as_stated_are_estimated_as_such() -> None:
    draw = np.random.default_rng(5)
    rig = rig_of()
    time, wrench = moving(draw)
    gain, offset = truth(draw)
    log = log_of(rig, time, wrench, gain, offset, np.zeros_like(wrench), draw)
    found, white = (estimate_from_known_wrench(rig, [log], errors) for errors in (None, ()))
    assert not found.errors[0].found
    np.testing.assert_array_equal(found.covariance, white.covariance)
    np.testing.assert_array_equal(found.gain, white.gain)
    assert found.findings == ()


def test_permuted_channels_permute_the_rows() -> None:
    rig, log, _, _ = example("moving")
    order = np.array([4, 0, 5, 2, 1, 3])
    names = [rig.sensor.channels[i] for i in order]
    nominal = np.eye(6)[order].tolist()
    noise = rig.sensor.noise_array[order].tolist()
    other = rig_of(channels=names, nominal_gain=nominal, noise=noise)
    found = estimate_from_known_wrench(rig, [log])
    permuted = estimate_from_known_wrench(other, [replace(log, raw=log.raw[:, order])])
    sigma = np.sqrt(np.diag(found.covariance))[:36].reshape(6, 6)
    assert np.abs((permuted.gain - found.gain[order]) / sigma[order]).max() < 1e-3
    theirs = np.sqrt(np.diag(permuted.covariance))[:36].reshape(6, 6)
    np.testing.assert_allclose(theirs, sigma[order], rtol=1e-3)


def test_other_units_change_nothing() -> None:
    rig, log, _, _ = example("held")
    assert log.reference is not None
    unit = np.array([1e3, 1e3, 1e3, 50.0, 50.0, 50.0])
    other = rig_of(span=unit * SPAN)
    found = estimate_from_known_wrench(rig, [log])
    scaled = estimate_from_known_wrench(
        other, [replace(log, raw=log.raw * unit, reference=log.reference * unit)]
    )
    np.testing.assert_allclose(scaled.gain * unit / unit[:, None], found.gain, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(
        scaled.normalised_covariance, found.normalised_covariance, rtol=1e-5, atol=1e-12
    )


@pytest.mark.parametrize("kind", ["moving", "held"])
def test_a_log_in_two_parts_says_the_same(kind: str) -> None:
    """But for what lasts across the cut: an offset is as good as the time that half a log tells."""
    rig, log, _, _ = example(kind, pool_offsets=True)
    assert log.reference is not None
    half = len(log.raw) // 2
    parts = [
        replace(log, raw=log.raw[rows], reference=log.reference[rows], time_ns=log.time_ns[rows])
        for rows in (slice(0, half), slice(half, None))
    ]
    whole, split = (estimate_from_known_wrench(rig, logs) for logs in ([log], parts))
    sigma = np.sqrt(np.diag(whole.covariance))
    assert np.abs((split.gain - whole.gain).ravel() / sigma[:36]).max() < 0.8
    ratio = np.sqrt(np.diag(split.covariance)) / sigma
    np.testing.assert_allclose(ratio[:36], 1.0, rtol=0.3)
    np.testing.assert_allclose(ratio[36:], 1.0, rtol=0.5)


def test_rows_that_are_missing_are_no_harm() -> None:
    rig, log, gain, offset = example("moving")
    draw = np.random.default_rng(1)
    raw = np.where(draw.random((len(log.raw), 1)) < 0.4, np.nan, log.raw)
    raw[200:300] = np.nan
    found, less = (estimate_from_known_wrench(rig, [replace(log, raw=x)]) for x in (log.raw, raw))
    times = np.log([[s.time for s in f.errors[0].sizes] for f in (found, less)])
    assert np.abs(times[0] - times[1]).mean() < 0.4
    assert np.abs(deviates(rig, less, gain, offset)).max() < 4.5
    assert less.incomplete[0] == np.count_nonzero(np.isnan(raw[:, 0]))


def test_logs_that_move_and_logs_that_stand_have_errors_of_their_own() -> None:
    rig, first, gain, offset = example("moving", seed=3)
    draw = np.random.default_rng(8)
    time, wrench = held(draw)
    second = log_of(rig, time, wrench, gain, offset, np.zeros_like(wrench), draw)
    found = estimate_from_known_wrench(rig, [first, second])
    assert [(e.stepped, e.logs, e.last) for e in found.errors] == [(False, (0,), True), (True, (1,), False)]
    assert np.abs(deviates(rig, found, gain, offset)).max() < 4.5
    assert len(found.squares) == 2
    assert found.row_noise[0, 0, 0] > 4.0 * found.row_noise[1, 0, 0]


@pytest.mark.parametrize("kind", ["moving", "held"])
def test_gross_errors_are_left_out_where_errors_last(kind: str) -> None:
    rig, log, gain, offset = example(kind, seed=2)
    assert log.reference is not None
    raw, reference = log.raw.copy(), log.reference.copy()
    if kind == "moving":
        wrong = np.array([50, 51, 300, 520])
        raw[wrong, 1] += 0.1 * SPAN[1]
    else:  # one load noted wrongly, and a glitch
        wrong = np.append(np.arange(400, 450), 777)
        reference[wrong[:-1], 2] += 0.1 * SPAN[2]
        raw[777, 4] += 0.1 * SPAN[4]
    found = estimate_from_known_wrench(rig, [replace(log, raw=raw, reference=reference)])
    np.testing.assert_array_equal(found.outliers[0], wrong)
    assert found.contradicting == 0
    assert np.abs(deviates(rig, found, gain, offset)).max() < 4.5


def test_rows_between_plateaus_are_not_used_where_errors_last() -> None:
    rig, log, _, _ = example("held")
    assert log.reference is not None
    raw, reference = log.raw.copy(), log.reference.copy()
    for k in range(1, 40):  # half a second from load to load
        way = np.linspace(0.0, 1.0, 14)[1:-1, None]
        rows = slice(50 * k, 50 * k + 12)
        for x in (raw, reference):
            x[rows] = x[50 * k - 1] * (1.0 - way) + x[50 * k + 12] * way
    found = estimate_from_known_wrench(rig, [replace(log, raw=raw, reference=reference)])
    assert 39 * 10 <= found.between[0] <= 39 * 12
    assert found.rows[0].size + found.between[0] == len(raw)


def test_outliers_that_are_few_are_not_too_many() -> None:
    """Rows that contradict the others in turns, one set as the other is left out, are out in the end."""
    rig, few, some = rig_of(), 0, 0
    for seed in range(60):
        draw = np.random.default_rng(seed)
        wrench = draw.uniform(-0.5, 0.5, (60, 6))
        errors = 2.0 * NOISE * draw.normal(size=wrench.shape)
        log = log_of(rig, 20.0 * np.arange(60), wrench, *truth(draw), errors, draw)
        found = estimate_from_known_wrench(rig, [log])
        few += 0 < found.contradicting <= 6
        some += found.outliers[0].size > 0
    assert few == 0
    assert some > 0


@pytest.mark.parametrize("kind", ["moving", "held"])
def test_a_gain_that_changes_within_a_log_is_told_by_its_halves(kind: str) -> None:
    """Errors that last would hold half a percent of range; sound logs agree by chance."""
    least = []
    for seed in range(4):
        rig, log, *_ = example(kind, seed, size=2e-3)
        found = estimate_from_known_wrench(rig, [log])
        least.append(agreement_of_known_halves(rig, [log], found, [None])[0])
        assert log.reference is not None
        change = 0.02 * np.random.default_rng(seed).normal(size=(6, 6)) * SPAN[:, None] / SPAN
        later = np.arange(len(log.raw)) >= len(log.raw) // 2
        raw = log.raw + later[:, None] * (log.reference @ change.T)
        reasons = calibrate(rig, replace(log, raw=raw)).verdict.reasons
        assert any("the first and the second half of the log tell different gains" in x for x in reasons)
    assert min(least) > 1e-3


def test_halves_of_a_log_have_the_clock_of_their_own_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, log, *_ = example("moving", 0, size=2e-3)
    found = estimate_from_known_wrench(rig, [log])
    moved = np.broadcast_to(log.time_ns[:, None, None] * 1e-9, (log.time.size, 6, 2))
    clock = ReferenceClock(0.0, 1e-4, 0.0, moved, 1e-8 * np.eye(2))
    seen = []

    def estimate(rig: Rig, logs: Any, errors: Any, clocks: Any) -> KnownWrenchEstimate:
        np.testing.assert_array_equal(clocks[0].moved[:, 0, 0], logs[0].time_ns * 1e-9)
        seen.append(logs[0].time_ns)
        return estimate_from_known_wrench(rig, logs, errors, clocks)

    monkeypatch.setattr(log_agreement, "estimate_from_known_wrench", estimate)
    agreement_of_known_halves(rig, [log], found, [clock])
    np.testing.assert_array_equal(np.concatenate(seen), log.time_ns)
