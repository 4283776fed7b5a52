"""Claims about least squares on simulated logs, whose wrench is not the core's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rigs import changed, two_payloads

from truewrench.estimation.least_squares import least_squares
from truewrench.model.errors import UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments, smooth_twist
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate


def rig_of(**changes: Any) -> Rig:
    quieter = {"noise": [0.1, 0.1, 0.1, 0.01, 0.01, 0.01]}
    rig = changed(
        two_payloads("table_1"), sensor=quieter, motion={"noise": [1e-4] * 6}, plan={"duration": 10}
    )
    return Rig.from_mapping(changed(rig, **changes))


def normalised_error(rig: Rig, gain: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return (gain - truth) * rig.sensor.range_array / rig.sensor.channel_scale[:, None]


QUIET = {"sensor": {"noise": [1e-9] * 6}, "motion": {"noise": [1e-9] * 6}}


@pytest.mark.parametrize("feels", ["payload_on_sensor", "sensor_on_payload"])
@pytest.mark.parametrize("of", ["com", "sensor"])
def test_noise_free_log_gives_gain_and_offset_back(feels: str, of: str) -> None:
    rig = rig_of(
        sensor={**QUIET["sensor"], "feels": feels},
        motion={**QUIET["motion"], "of": of},
        gravity=[0, 0, -9.81],
    )
    run = simulate(rig)
    estimate = least_squares(rig, [run.log], smooth="spline")
    np.testing.assert_allclose(normalised_error(rig, estimate.gain, run.truth.gain), 0, atol=1e-6)
    np.testing.assert_allclose(estimate.offsets[-1], run.truth.offset, atol=1e-4)


def test_pooled_logs_share_a_gain_and_keep_their_offsets() -> None:
    rig = rig_of(**QUIET)
    first = simulate(rig, payload="table_1", seed=1)
    fixed = {"gain": first.truth.gain.tolist(), "offset": "random"}
    second = simulate(rig_of(**QUIET | {"simulate": fixed}), payload="small", seed=2)
    estimate = least_squares(rig, [first.log, second.log], smooth="spline")
    np.testing.assert_allclose(normalised_error(rig, estimate.gain, first.truth.gain), 0, atol=1e-6)
    np.testing.assert_allclose(estimate.offsets, [first.truth.offset, second.truth.offset], atol=1e-4)


def test_plain_differences_shrink_the_gain_and_a_spline_does_not() -> None:
    rig = rig_of(motion={"noise": [4e-3] * 6}, simulate={"gain": "nominal"})
    run = simulate(rig)
    plain, spline = least_squares(rig, [run.log]), least_squares(rig, [run.log], smooth="spline")
    assert np.mean(np.diag(plain.gain)) < 0.95
    assert np.abs(normalised_error(rig, spline.gain, np.eye(6))).max() < 0.06


def test_claimed_covariance_is_honest_when_the_sensor_noise_dominates() -> None:
    rig = rig_of(sensor={"noise": [5, 5, 5, 0.5, 0.5, 0.5]}, motion={"noise": [1e-5] * 6})
    scores = []
    for seed in range(30):
        run = simulate(rig, seed=seed)
        estimate = least_squares(rig, [run.log], smooth="spline")
        truth, found = run.truth, estimate
        error = np.concatenate([(found.gain - truth.gain).ravel(), found.offsets[-1] - truth.offset])
        scores.append(error @ np.linalg.solve(estimate.covariance, error) / 42)
        assert np.all(np.abs(estimate.chi_square - 1) < 0.2)
    assert np.mean(scores) == pytest.approx(1.0, abs=0.12)


def test_channels_without_an_offset_have_none() -> None:
    rig = rig_of(sensor={"offset_prior": [0, 0, 0, 1, 1, 1]}, simulate={"offset": "none"})
    estimate = least_squares(rig, [simulate(rig).log])
    np.testing.assert_array_equal(estimate.offsets[-1, :3], 0)
    np.testing.assert_array_equal(estimate.covariance[36:39], 0)
    assert np.all(np.diag(estimate.covariance)[39:] > 0)


def test_more_channels_than_axes_are_calibrated_directly() -> None:
    rng = np.random.default_rng(5)
    nominal = rng.normal(size=(8, 6)) / np.array([500, 500, 500, 50, 50, 50])
    sensor = {"channels": [f"g{i}" for i in range(8)], "noise": [1e-4] * 8, "nominal_gain": nominal.tolist()}
    rig = rig_of(sensor=sensor)
    run = simulate(rig)
    estimate = least_squares(rig, [run.log], smooth="spline")
    assert estimate.covariance.shape == (56, 56)
    assert np.abs(normalised_error(rig, estimate.gain, run.truth.gain)).max() < 0.01


def test_directions_without_excitation_keep_nominal_gain_and_prior_variance() -> None:
    rig = rig_of(**QUIET | {"gravity": [0, 0, -9.81]})
    run = simulate(rig)
    still = replace(
        run.log, twist=np.zeros((1000, 6)), gravity=np.tile([0, 0, -9.81], (1000, 1)), raw=np.ones((1000, 6))
    )
    estimate = least_squares(rig, [still])
    np.testing.assert_allclose(estimate.gain[:, [0, 1, 3, 5]], np.eye(6)[:, [0, 1, 3, 5]], atol=1e-9)
    assert np.sqrt(estimate.covariance[0, 0]) == pytest.approx(0.2)


def test_a_gap_is_not_differentiated_across() -> None:
    run = simulate(rig_of(**QUIET))
    log = run.log
    keep = np.r_[0:400, 700:1000]
    assert log.twist is not None
    gapped = Log(None, log.payload, "", log.time_ns[keep], log.raw[keep], log.twist[keep])
    assert segments(gapped.time) == [slice(0, 400), slice(400, 700)]
    estimate = least_squares(rig_of(**QUIET), [gapped])
    assert estimate.samples.tolist() == [696]
    rig = rig_of()
    assert np.abs(normalised_error(rig, estimate.gain, run.truth.gain)).max() < 6e-3


def test_streams_of_different_rates_are_refused() -> None:
    rig = rig_of(simulate={"rate": 100, "sensor_rate": 250})
    with pytest.raises(UnsupportedError, match="one rate"):
        least_squares(rig, [simulate(rig).log])


def test_spline_is_as_coarse_as_each_component_allows() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(1000) / 100
    clean = np.column_stack([np.sin(2 * np.pi * f * time) for f in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)])
    measured = clean + 1e-3 * rng.standard_normal(clean.shape)
    fit = smooth_twist(time, measured, np.full(6, 1e-3))
    assert np.all(np.diff(fit.spacing) <= 0)
    assert np.all(np.abs(1e6 * np.mean((measured - fit.twist) ** 2, axis=0) - 1) < 0.15)
    slope = np.column_stack(
        [2 * np.pi * f * np.cos(2 * np.pi * f * time) for f in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)]
    )
    differences = np.gradient(clean + 1e-3 * rng.standard_normal(clean.shape), time, axis=0)
    assert np.all((fit.acceleration - slope)[20:-20].std(0) < 0.3 * (differences - slope)[20:-20].std(0))


def test_knots_of_a_spline_do_not_follow_noise_that_is_larger_than_stated() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(1000) / 100
    clean = np.column_stack([np.sin(2 * np.pi * f * time) for f in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)])
    measured = clean + 1e-3 * rng.standard_normal(clean.shape)
    stated, truth = (smooth_twist(time, measured, np.full(6, sigma)) for sigma in (7e-4, 1e-3))
    assert np.all(stated.spacing > 0.5 * truth.spacing)
    np.testing.assert_allclose(stated.factor, 1 / 0.7, rtol=0.1)
    np.testing.assert_array_equal(truth.factor, 1.0)


def test_a_spline_takes_the_noise_of_each_sample() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(1000) / 100
    noise = np.outer(1e-3 * np.exp(np.sin(time)), np.ones(6))
    measured = np.sin(time)[:, None] + noise * rng.standard_normal(noise.shape)
    early = slice(0, 300)  # noisier than the whole
    own, mean = (
        smooth_twist(time[early], measured[early], sigma)
        for sigma in (noise[early], np.sqrt((noise**2).mean(axis=0)))
    )
    np.testing.assert_array_equal(own.factor, 1.0)
    assert np.all(mean.factor > 1.1)
    np.testing.assert_array_equal(own.spacing, mean.spacing)
