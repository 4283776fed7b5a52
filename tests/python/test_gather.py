"""Logs faster than 400 Hz: the rows that their samples are gathered into say what the samples say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from record_cases import light_rig

import truewrench as tw
from truewrench import _core
from truewrench.estimation.estimator import estimate
from truewrench.estimation.record import recorded_logs
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist

Array = NDArray[np.float64]

NOISE = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])


@pytest.fixture(scope="module")
def record() -> Any:
    """Rig and log of 10 s at 1 kHz, and the true gain."""
    rig = light_rig(seconds=10, rate=1000, discrepancy=0)
    run = tw.simulate(rig)
    return rig, run.log, run.truth


def test_they_say_what_a_fit_of_all_samples_says(record: Any) -> None:
    rig, log, _ = record
    _, statement, streams = recorded_logs(rig, [log])
    settings = _core.Settings()
    settings.threads = 1
    settings.discrepancy = 0.0
    found: Any = _core.estimate(statement, streams, settings)
    every: Any = _core.make_fit(statement, streams, [found.fit.spacing(0)], [[]])
    every.run()
    every.run()
    sigma = np.sqrt(np.diag(every.P)[:36])
    assert np.asarray(found.fit.rows(0)["masked"]).sum() == 0
    assert np.abs(found.fit.theta[:36] - every.theta[:36]).max() < 0.02 * sigma.max()
    np.testing.assert_allclose(np.sqrt(np.diag(found.fit.P)[:36]), sigma, rtol=5e-3)
    np.testing.assert_allclose(found.fit.sizes(0).raw_factor, every.sizes(0).raw_factor, rtol=3e-3)
    assert found.fit.deviance == pytest.approx(every.deviance, abs=5.0)


def test_residuals_are_those_of_every_sample(record: Any) -> None:
    rig, log, _ = record
    rows = estimate(rig, [log], threads=1).rows[0]
    np.testing.assert_array_equal(rows.rows, np.arange(len(log.raw)))
    assert rows.residual.std(axis=0) * rig.sensor.channel_scale == pytest.approx(NOISE, rel=0.05)


def test_spikes_are_left_out_and_their_neighbours_kept(record: Any) -> None:
    rig, log, _ = record
    draw = np.random.default_rng(3)
    spikes = draw.choice(len(log.raw), size=len(log.raw) // 100, replace=False)
    raw = np.array(log.raw)
    raw[spikes] += 30.0 * NOISE * draw.choice([-1.0, 1.0], size=(len(spikes), 6))
    masked = estimate(rig, [replace(log, raw=raw)], threads=1).rows[0].masked
    assert masked[spikes].all()
    assert masked.mean() < 0.012


def test_a_contact_is_left_out(record: Any) -> None:
    rig, log, truth = record
    raw, time = np.array(log.raw), np.asarray(log.time_ns) * 1e-9
    time -= time[0]
    pressed = (time > 4.0) & (time < 4.5)
    raw[pressed] += [20.0, -15.0, 30.0, 1.0, -2.0, 0.5]
    found = estimate(rig, [replace(log, raw=raw)], threads=1)
    masked = found.rows[0].masked
    assert masked[pressed].all()
    assert masked.mean() < 0.5 / 10.0 + 0.02
    apart = (found.gain - truth.gain).ravel()
    assert apart @ np.linalg.solve(found.covariance[:36, :36], apart) / 36 < 2.0


def test_a_silent_second_leaves_the_rest(record: Any) -> None:
    rig, log, _ = record
    kept = np.ones(len(log.raw), dtype=bool)
    kept[3000:4000] = False
    cut: Log = replace(
        log,
        time_ns=log.time_ns[kept],
        raw=log.raw[kept],
        twist=None if log.twist is None else log.twist[kept],
    )
    found = estimate(rig, [cut], threads=1)
    assert len(found.rows[0].rows) == 9000
    assert set(found.rows[0].stretch.tolist()) == {0, 1}


def test_what_they_cannot_follow_the_samples_themselves_resolve() -> None:
    """A body shaken at 20 Hz before a quiet sensor: no cubic of 20 ms takes that, and 1.6 kHz do."""
    rng = np.random.default_rng(0)
    frequency = np.tile(np.array([3.0, 7.0, 12.0, 20.0])[:, None], (1, 6))
    amplitude = 0.3 * rng.uniform(0.5, 1.0, (4, 6)) / frequency
    motion = HarmonicTwist(amplitude, frequency, rng.uniform(0.0, 2.0 * np.pi, (4, 6)), 3.0)
    rig = light_rig(seconds=3, rate=1600, discrepancy=0, noise=[5e-3] * 3 + [5e-4] * 3)
    run = tw.simulate(rig, motion)
    found = estimate(rig, [run.log], threads=1)
    assert not found.unresolved[0]
    error = (found.gain - run.truth.gain).ravel() * np.tile(rig.sensor.range_array, 6)
    error /= np.repeat(rig.sensor.channel_scale, 6)
    assert error @ np.linalg.solve(found.normalised_covariance[:36, :36], error) / 36.0 < 2.0
