"""Whether parts of a record agree on the gain (10.11): by chance as often as p says, not where it changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import rig_with
from scipy.stats import binom

import truewrench as tw
from truewrench.estimation.estimator import estimate
from truewrench.judging import Comparisons, judge
from truewrench.model.log import Log
from truewrench.model.rig import Rig

Array = np.ndarray[Any, np.dtype[np.float64]]
HALVES, QUARTERS = "p_halves", "p_quarters"


def test_parts_of_sound_records_differ_by_chance(settings: dict[str, Any]) -> None:
    """Of 60 comparisons a tenth has p below 0.1, and not fewer than chance allows above 0.5."""
    rig = rig_with(settings)
    p = []
    for seed in range(30):
        found = estimate(rig, [tw.simulate(rig, seed=seed).log])
        p += [found.p_halves, found.p_quarters]
    assert np.count_nonzero(np.array(p) < 0.1) <= binom.ppf(0.9999, len(p), 0.1)
    # (10.9) in V makes p larger
    assert np.count_nonzero(np.array(p) > 0.5) >= binom.ppf(1e-4, len(p), 0.5)


@pytest.mark.parametrize(
    ("changed", "told", "not_told"),
    [(lambda place: place < 0.5, HALVES, QUARTERS), (lambda place: (4 * place) % 2 < 1, QUARTERS, HALVES)],
)
def test_a_gain_that_changes_within_a_record_is_told(
    settings: dict[str, Any], changed: Callable[[Array], Array], told: str, not_told: str
) -> None:
    """A channel reads 10% more in two quarters of the record: comparing them with the others tells it."""
    rig = rig_with(settings)
    log = tw.simulate(rig, seed=1).log
    raw = log.raw.copy()
    raw[changed(log.time / log.time[-1]), 0] *= 1.1
    found = estimate(rig, [replace(log, raw=raw)])
    assert getattr(found, told) < 1e-6
    assert getattr(found, not_told) > 100 * getattr(found, told)


def logs_of_one_sensor(settings: dict[str, Any], seed: int, count: int = 3) -> tuple[Rig, list[Log]]:
    """Records of one gain and payload, each with a motion and an offset of its own."""
    gain = (np.eye(6) + 0.1 * np.random.default_rng(seed).normal(size=(6, 6))).tolist()
    logs = []
    for k in range(count):
        simulate = {"payload": "nominal", "gain": gain}
        rig = rig_with(settings, simulate=simulate, plan={"duration": 8, "seed": count * seed + k})
        logs.append(tw.simulate(rig, seed=count * seed + k).log)
    return rig, logs


def loud(log: Log) -> Log:
    """One channel reads 2% more."""
    raw = log.raw.copy()
    raw[:, 0] *= 1.02
    return replace(log, raw=raw)


@pytest.mark.parametrize("online", [False, True])
def test_logs_of_one_sensor_differ_by_chance(settings: dict[str, Any], online: bool) -> None:
    """And have the noise that they have, whatever was known before each: nothing of them is left out."""
    p = []
    for seed in range(12):
        rig, logs = logs_of_one_sensor(settings, seed)
        found = estimate(rig, logs, online=online)
        p += found.p_logs.tolist()[1:]  # of three, two are independent
        assert found.masked_share() < 0.01
        factors = [f.factor for noise in found.noise for f in noise if f.what in ("force", "moment")]
        assert np.abs(np.log(factors)).max() < np.log(1.2)
    assert np.count_nonzero(np.array(p) < 0.1) <= binom.ppf(0.9999, len(p), 0.1)
    assert np.count_nonzero(np.array(p) > 0.5) >= binom.ppf(1e-4, len(p), 0.5)


@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize("count", [2, 3])
def test_a_log_of_another_gain_is_told_and_named(settings: dict[str, Any], online: bool, count: int) -> None:
    """2% on one channel, which no half of the logs shows, and no noise or slow disturbance explains away."""
    rig, logs = logs_of_one_sensor(settings, 1, count)
    for odd in range(1, count):
        pooled = [loud(log) if k == odd else log for k, log in enumerate(logs)]
        found = estimate(rig, pooled, online=online)
        assert found.p_worst_log < 1e-6
        assert not found.parts_agree
        reason = judge(found, Comparisons(), rig, pooled).verdict.reasons[0]
        assert "or sensor or payload changed between logs" in reason
        assert ("one log and the other" if count == 2 else f"log {odd + 1} and the others") in reason
    assert estimate(rig, logs, online=online).parts_agree


def test_a_payload_that_is_not_the_stated_one_is_told_by_the_other_log(settings: dict[str, Any]) -> None:
    """A log that carries 5% more than it says moves the gain like a sensor that changed."""
    rig, logs = logs_of_one_sensor(settings, 2, 2)
    body = rig.to_mapping()["payloads"]["default"]
    heavier = Rig.from_mapping(
        {**rig.to_mapping(), "payloads": {"default": {**body, "mass": 1.05 * body["mass"]}}}
    )
    other = tw.simulate(heavier, seed=9).log
    assert estimate(rig, [logs[0], other]).p_worst_log < 1e-6


def test_a_test_that_could_not_be_made_is_no_agreement(settings: dict[str, Any]) -> None:
    rig, logs = logs_of_one_sensor(settings, 3, 2)
    found = estimate(rig, logs)
    assert not replace(found, p_logs=np.array([np.nan, 1.0])).parts_agree
