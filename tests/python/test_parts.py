"""Long records part by part: the same as at once, in less memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from record_cases import light_rig

import truewrench as tw
from truewrench import _core
from truewrench.estimation import parts as in_parts
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.estimation.parts import InParts, is_long
from truewrench.estimation.record import recorded_logs
from truewrench.estimation.together import Shared, Told
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of

Array = np.ndarray[Any, np.dtype[np.float64]]

PART = 40.0
SECONDS = 240.0


def record(seed: int = 0, seconds: float = SECONDS, **sensor: Any) -> tuple[Rig, Log, Array]:
    """A record of six frequencies an axis at 100 Hz, and the true gain."""
    rig = light_rig(seconds=seconds, rate=100, **sensor)
    rng = np.random.default_rng(seed)
    frequency = np.sort(rng.uniform(0.1, 1.2, (6, 6)), axis=0)
    size, phase = 0.25 * rng.uniform(0.2, 0.7, (6, 6)), rng.uniform(0, 2 * np.pi, (6, 6))
    run = tw.simulate(rig, HarmonicTwist(size, frequency, phase, seconds), seed=seed)
    return rig, run.log, run.truth.gain


def sigma(found: Estimate) -> Array:
    return np.sqrt(np.diag(found.covariance)[:36])


def z(found: Estimate, gain: Array) -> Array:
    return np.asarray((found.gain - gain).ravel() / sigma(found))


def late_by(log: Log, ppm: float) -> Log:
    """The sensor's stamps by a clock that runs faster, at rows of their own."""
    stamps = log.time_ns + np.rint(1e-6 * ppm * (log.time_ns - log.time_ns[0])).astype(np.int64)
    union = np.union1d(stamps, log.time_ns + 7)
    raw, twist = (np.full((union.size, 6), np.nan) for _ in range(2))
    raw[np.searchsorted(union, stamps)] = log.raw
    twist[np.searchsorted(union, log.time_ns + 7)] = log.twist
    return replace(log, time_ns=union, raw=raw, twist=twist)


@pytest.mark.parametrize("seed", range(3))
def test_parts_say_together_what_the_whole_says(seed: int) -> None:
    """Though gain and centre of mass make up for each other, and each part has another mixture of them."""
    rig, log, gain = record(seed, discrepancy=0)
    whole, together = estimate(rig, [log]), InParts(rig, [log], seconds=PART).estimate()
    assert np.sqrt(np.mean(((together.gain - whole.gain).ravel() / sigma(whole)) ** 2)) < 0.2
    assert np.all(np.abs(sigma(together) / sigma(whole) - 1.0) < 0.03)
    assert sigma(together).mean() > 0.998 * sigma(whole).mean()  # an offset for each part tells no more
    assert np.abs(z(together, gain)).max() < 4.0
    assert min(together.p_halves, together.p_quarters) > 1e-3
    assert together.rows[0].samples == whole.rows[0].samples
    assert together.clocks[0][0].late == pytest.approx(
        whole.clocks[0][0].late, abs=3 * whole.clocks[0][0].std
    )
    assert together.clocks[0][0].std == pytest.approx(whole.clocks[0][0].std, rel=0.3)
    for name in ("force", "moment", "velocities v"):
        factor = [next(f.factor for f in found.noise[0] if f.what == name) for found in (whole, together)]
        assert factor[0] == pytest.approx(factor[1], rel=0.01)


def test_how_many_parts_are_in_hand_at_a_time_changes_no_bit() -> None:
    rig, log, _ = record(7, seconds=120.0)
    one, many = (InParts(rig, [log, log], threads, seconds=PART).estimate() for threads in (1, 3))
    assert np.array_equal(one.gain, many.gain)
    assert np.array_equal(one.covariance, many.covariance)
    assert np.array_equal(one.rows[1].residual, many.rows[1].residual)


def test_a_rate_that_makes_the_parts_less_likely_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, log, _ = record(3, seconds=120.0)
    monkeypatch.setattr(in_parts, "_rate", lambda *_: 3e-4)
    parts = InParts(rig, [log], seconds=PART)
    assert parts.logs[0].clock_rate == 0.0
    assert parts.estimate().solved


def test_a_part_put_away_says_the_same_when_it_is_taken_up() -> None:
    rig, log, _ = record(seconds=40.0)
    assumed, statement, (streams,) = recorded_logs(rig, [log])
    settings = _core.Settings()
    settings.discrepancy = assumed.discrepancy
    found = _core.estimate(statement, [streams], settings)
    theta, covariance = np.array(found.fit.theta), np.array(found.covariance)
    first = int(np.array(found.fit.columns(0).at)[found.fit.columns(0).b])
    part = _core.put_away(found)
    assert part.settle(streams, theta[:first])
    std = np.sqrt(np.diag(covariance))
    assert np.abs((part.theta - theta) / std).max() < 0.05
    assert np.allclose(part.covariance / np.outer(std, std), covariance / np.outer(std, std), atol=1e-3)
    _, _, (other,) = recorded_logs(rig, [rows_of(log, slice(0, 3000))])
    assert not part.settle(other, theta[:first])


def test_information_adds_as_in_one_regression() -> None:
    """Linear fits with parameters of their own, against all of them at once."""
    rng = np.random.default_rng(1)
    gains, u, own, count = 6, 3, 2, 5  # n = 1: six gains
    size = gains + u + own
    prior = np.concatenate([np.full(gains, 0.09), np.full(u, 0.01), np.full(own, 4.0)])
    truth = rng.standard_normal(gains + u) * np.sqrt(prior[: gains + u])
    normal, pull = np.zeros((gains + u + own * count,) * 2), np.zeros(gains + u + own * count)
    fits = []
    for k in range(count):
        X = rng.standard_normal((30, size))
        X[:, 2] = X[:, 1] if k < 4 else X[:, 2]  # not told apart by most
        y = X @ np.append(truth, 2.0 * rng.standard_normal(own)) + rng.standard_normal(30)
        P = np.linalg.inv(X.T @ X + np.diag(1.0 / prior))
        fits.append(
            Told(
                {j: j for j in range(gains + u)},
                gains + u,
                slice(gains, gains + u),
                P @ X.T @ y,
                np.zeros(size),
                prior,
                P,
                np.zeros((gains, gains)),
            )
        )
        places = [*range(gains + u), *(gains + u + own * k + j for j in range(own))]
        normal[np.ix_(places, places)] += X.T @ X
        pull[places] += X.T @ y
    shared = Shared(fits)
    beforehand = np.concatenate(
        [np.full(gains, 0.09), np.full(u, shared.departure), np.full(own * count, 4.0)]
    )
    P = np.linalg.inv(normal + np.diag(1.0 / beforehand))
    assert np.allclose(shared.mean, (P @ pull)[: gains + u], atol=1e-9)
    assert np.allclose(shared.covariance, P[: gains + u, : gains + u], atol=1e-9)
    mean, covariance, (place,) = shared.with_own(fits[-1:])
    last = [*range(gains + u), *range(len(P) - own, len(P))]
    assert np.allclose(mean[place], (P @ pull)[last], atol=1e-9)
    assert np.allclose(covariance[np.ix_(place, place)], P[np.ix_(last, last)], atol=1e-9)

    def cost(variance: float) -> float:
        """-2 log likelihood of the size of u, all else integrated out."""
        D = beforehand.copy()
        D[gains : gains + u] = variance
        A = normal + np.diag(1.0 / D)
        return float(np.linalg.slogdet(A)[1] + np.log(D).sum() - pull @ np.linalg.solve(A, pull))

    assert cost(shared.departure) < min(cost(1.2 * shared.departure), cost(shared.departure / 1.2))
    assert np.allclose(shared.weights(gains).sum(axis=0), 1.0)
    assert 1e-3 < shared.agreement(np.arange(count) < 2, gains) <= 1.0


def test_parts_that_another_sensor_wrote_disagree() -> None:
    rig, log, _ = record(1)
    raw = log.raw.copy()
    raw[len(raw) // 2 :] *= 1.01
    assert InParts(rig, [replace(log, raw=raw)], seconds=PART).estimate().p_halves < 1e-6
    of_two = InParts(rig, [log, replace(log, raw=1.01 * log.raw)], seconds=PART).estimate()
    assert of_two.p_worst_log < 1e-6
    assert InParts(rig, [log, record(2)[1]], seconds=PART).estimate().p_logs.shape == (2,)


def test_a_clock_that_runs_faster_is_set() -> None:
    """20 ppm: 2.4 ms at either end, that no part sees by itself; rows are those of the log as it was."""
    rig, log, gain = record(2)
    moved = late_by(log, 20.0)
    parts = InParts(rig, [moved], seconds=PART)
    assert parts.logs[0].clock_rate == pytest.approx(20e-6, rel=0.05)
    found = parts.estimate()
    assert np.abs(z(found, gain)).max() < 4.0
    assert found.clocks[0][0].late == pytest.approx(10e-6 * SECONDS, abs=1e-4)
    rows = found.rows[0]
    assert np.isfinite(moved.raw[rows.rows]).all()
    left = moved.raw[rows.rows] - rows.wrench @ found.gain.T
    assert np.all(left.std(axis=0) < 1.1 * rig.sensor.noise_array)


def test_a_part_that_follows_no_motion_is_left_out() -> None:
    rig, log, gain = record(3)
    raw = log.raw.copy()
    raw[4000:8000] = np.random.default_rng(0).uniform(-100, 100, (4000, 6))
    found = InParts(rig, [replace(log, raw=raw)], seconds=PART).estimate()
    assert found.solved
    assert np.abs(z(found, gain)).max() < 4.0
    assert found.masked_share() == pytest.approx(1 / 6, abs=0.02)
    assert any(event.end - event.begin > 0.8 * PART for event in found.events[0])
    assert found.unexplained[0] < _core.MOST_LOST
    raw[4000:16000] = np.random.default_rng(0).uniform(-100, 100, (12000, 6))
    lost = InParts(rig, [replace(log, raw=raw)], seconds=PART).estimate()
    assert lost.unexplained[0] > _core.MOST_LOST or lost.unresolved[0]


@pytest.mark.parametrize("known", [slice(0, 9_000), slice(9_000, None)])
def test_a_stream_that_only_some_parts_have(known: slice) -> None:
    """Accelerations that were logged for a while, up to the middle or from there on."""
    rig, log, gain = record(7)
    settings = rig.to_mapping()
    settings["motion"]["acceleration_noise"] = [0.05] * 6
    assert log.twist is not None
    told = np.full_like(log.twist, np.nan)
    rate = np.gradient(log.twist, log.time, axis=0)
    told[known] = rate[known] + 0.03 * np.random.default_rng(1).standard_normal(rate.shape)[known]
    found = InParts(Rig.from_mapping(settings), [replace(log, acceleration=told)], seconds=PART).estimate()
    assert np.abs(z(found, gain)).max() < 4.5
    assert len(found.clocks[0]) == (1 if known.stop else 2)


def test_parts_without_motion_are_passed_over() -> None:
    rig, log, gain = record(4)
    assert log.twist is not None
    twist = log.twist.copy()
    twist[:9000] = np.nan
    parts = InParts(rig, [replace(log, twist=twist)], seconds=PART)
    assert [part.begin for part in parts.parts] == pytest.approx([80.0, 120.0, 160.0, 200.0])
    assert np.abs(z(parts.estimate(), gain)).max() < 4.0
    with pytest.raises(InputError, match="no motion"):
        InParts(rig, [replace(log, twist=np.full_like(twist, np.nan))], seconds=PART)


def test_a_calibration_of_a_long_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tare in the middle, contacts, and a part held out that says that the gain is better."""
    rig, log, gain = record(5)
    raw = log.raw.copy()
    raw[9000:] += [2, -1, 0.5, 0.05, 0.1, -0.05]
    raw[15000:15080] += 5.0
    assert not is_long(rig, [log])
    monkeypatch.setattr(in_parts, "LONG", 200.0)
    monkeypatch.setattr(in_parts, "PART", PART)
    assert is_long(rig, [log])
    found = tw.calibrate(rig, replace(log, raw=raw))
    assert found.verdict.usable, found.verdict.reasons
    assert np.abs((found.gain - gain).ravel() / np.sqrt(np.diag(found.covariance)[:36])).max() < 4.0
    assert found.figures["held_out"]["share"] == pytest.approx(1 / 6, abs=0.02)
    assert all(axis.held_out and axis.better for axis in found.improvement.values())
    assert found.logs[0].used > 23_500
    assert sum(found.logs[0].masked.values()) >= 80
    words = " ".join(a.evidence for a in found.assumed)
    assert "steps by 2% of range at 90 s" in words


def test_a_temperature_that_some_parts_lack() -> None:
    """The slope of the offset stands before gravity's tilt, where there is one."""
    rig, _, gain = record(8, seconds=120.0)
    settings = rig.to_mapping()
    settings["gravity"], settings["gravity_tilt_prior"] = [0, 0, -9.81], 5e-3
    settings["simulate"] |= {"gain": gain.tolist()}
    settings["temperature"] = {"prior": 1e-3}
    rig = Rig.from_mapping(settings)
    rng = np.random.default_rng(3)
    size, frequency = rng.uniform(0.05, 0.1, (6, 6)), rng.uniform(0.1, 1, (6, 6))
    size[:, 3:] *= frequency[:, 3:]
    log = tw.simulate(rig, HarmonicTwist(size, frequency, rng.uniform(0, 6, (6, 6)), 120), seed=1).log
    warm = 25.0 + 2.0 * np.sin(0.1 * log.time)
    warm[: 1 + np.searchsorted(log.time, PART)] = np.nan
    slope = 1e-3 * rig.sensor.channel_scale
    raw = log.raw + np.nan_to_num(warm - 25.0)[:, None] * slope
    found = InParts(rig, [replace(log, temperature=warm, raw=raw)], seconds=PART).estimate()
    assert np.abs(z(found, gain)).max() < 4.0
    (tilt,) = found.tilts
    assert np.abs(tilt.angles).max() < 4e-3
    assert found.offset_temperature == pytest.approx(slope, rel=0.1)


def test_logs_with_payloads_and_offsets_of_their_own() -> None:
    rig, log, gain = record(6, seconds=120.0)
    other = rig.to_mapping()
    other["payloads"]["heavy"] = {**other["payloads"]["default"], "mass": 8}
    other["simulate"] |= {"gain": gain.tolist(), "seed": 7}
    both = Rig.from_mapping(other)
    rng = np.random.default_rng(9)
    motion = HarmonicTwist(
        rng.uniform(0.05, 0.1, (6, 6)), rng.uniform(0.1, 1, (6, 6)), rng.uniform(0, 6, (6, 6)), 120
    )
    logs = [log, tw.simulate(both, motion, payload="heavy").log]
    whole, together = estimate(both, logs), InParts(both, logs, seconds=PART).estimate()
    assert np.sqrt(np.mean(((together.gain - whole.gain).ravel() / sigma(whole)) ** 2)) < 0.5
    assert set(together.payloads) == {"default", "heavy"}
    assert np.all(np.abs(together.offsets - whole.offsets) < 5.0 * together.offsets_std)
    assert len(together.clocks) == len(together.rows) == 2


def arrays(thing: Any) -> Iterator[Array]:
    """All that a part holds, through its fields."""
    if isinstance(thing, np.ndarray):
        yield thing
    elif isinstance(thing, list | tuple | frozenset):
        for item in thing:
            yield from arrays(item)
    elif is_dataclass(thing):
        for field in fields(thing):
            yield from arrays(getattr(thing, field.name))
    elif isinstance(thing, SimpleNamespace):
        yield from arrays(list(vars(thing).values()))


def test_of_a_part_nothing_is_kept_that_keeps_its_record() -> None:
    """A view of an array of the core's keeps all streams alive: an hour took half as much again."""
    rig, log, _ = record()
    for part in InParts(rig, [log], seconds=PART).parts:
        held = list(arrays(part))
        assert len(held) > 20
        for array in held:
            while isinstance(array.base, np.ndarray):
                array = array.base
            assert array.base is None
