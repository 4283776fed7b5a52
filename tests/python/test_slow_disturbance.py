"""What a slow disturbance costs, and what of it the mask leaves in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from imperfect_cases import rig_of

from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

SECONDS = 12.0
NOISE = {"sensor": {"noise": [0.02] * 3 + [0.002] * 3}}


def record(seed: int, rate: float, imperfections: dict[str, Any] | None) -> tuple[Rig, Log]:
    """Six frequencies an axis, on orbit."""
    rng = np.random.default_rng(seed)
    amplitude = 0.25 * rng.uniform(0.2, 0.7, (6, 6))
    frequency = np.tile(np.array([0.15, 0.3, 0.45, 0.65, 0.85, 1.1])[:, None], (1, 6))
    motion = HarmonicTwist(amplitude, frequency, rng.uniform(0, 2 * np.pi, (6, 6)), SECONDS)
    rig = rig_of(imperfections, plan={"duration": SECONDS}, simulate={"rate": rate}, **NOISE)
    return rig, simulate(rig, motion, seed=seed).log


def period(found: Estimate, rig: Rig) -> float:
    """1 / mean frequency of the wrench, weighted by its power [s]."""
    w = found.rows[0].wrench / rig.sensor.range_array
    power = (np.abs(np.fft.rfft(w - w.mean(0), axis=0)) ** 2 / np.var(w, axis=0)).sum(1)
    dt = float(np.median(np.diff(found.rows[0].time)))
    return float(power.sum() / (np.fft.rfftfreq(len(w), dt) @ power))


def test_what_is_slower_than_the_motion_counts_over_a_period_of_it() -> None:
    """Matern 3/2: E (d(t + T) - d(t))^2 = 2 delta^2 (1 - rho(T))."""
    rig, log = record(5, 100.0, {"drift": 5e-4})
    found = estimate(rig, [log])
    force = found.slow[0][0]
    assert force.form == "matern"
    x = period(found, rig) / force.tau
    assert x < 0.5
    counted = force.size * np.sqrt(2.0 * (1.0 - (1.0 + x) * np.exp(-x)))
    assert found.discrepancy[:3] == pytest.approx(counted, rel=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_lasts_no_longer_than_its_record_and_its_fit_ends(seed: int) -> None:
    """A correlation time beyond the record is told by nothing in it."""
    rig, log = record(seed, 100.0, {"drift": 5e-4})
    found = estimate(rig, [log])
    assert found.converged
    assert 0.5 * SECONDS < found.slow[0][0].tau <= SECONDS + 1e-9


def test_the_beginning_of_a_drift_is_left_in_and_a_long_push_is_not() -> None:
    rig, log = record(0, 400.0, {"drift": 8e-3})
    assert estimate(rig, [log]).masked_share() < 0.02
    rig, log = record(0, 400.0, None)
    push = np.where(np.abs(log.time - 6.0) < 1.75, 0.05 * np.cos((log.time - 6.0) * np.pi / 3.5), 0.0)
    pushed = replace(log, raw=log.raw + push[:, None] * rig.sensor.range_array * [1, 0, 0.5, 0, 1, 0])
    assert estimate(rig, [pushed]).masked_share() > 0.2
