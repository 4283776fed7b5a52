"""Gain, offsets and sigma of `map` and `online` on simulated logs, whose wrench is not the core's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from window_cases import FITTED, GRAVITY, METHODS, Method, error, honest, nees, rig_of, uncertain_rig

from truewrench import _core
from truewrench.errors import InputError
from truewrench.estimate.fits import mostly_unexplained
from truewrench.estimate.windows import estimate_windows
from truewrench.estimation.bound import bound
from truewrench.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate


@METHODS
@pytest.mark.parametrize(("gravity", "seeds"), [([0, 0, 0], 16), (GRAVITY, 8)])
def test_sigma_is_honest_and_near_the_bound(method: Method, gravity: list[float], seeds: int) -> None:
    rig = rig_of(gravity=gravity, gravity_tilt_prior=0, plan={"duration": 10})  # the windows know of none
    scores, squares = [], []
    for seed in range(seeds):
        run = simulate(rig, seed=seed)
        estimate = estimate_windows(rig, [run.log], method)
        assert estimate.converged
        assert all(w.status == FITTED for w in estimate.windows)
        scores.append(nees(rig, estimate, [run]))
        squares.append(np.mean(error(rig, estimate, [run])[:36] ** 2))
    assert honest(scores, 42)
    assert max(scores) < 2.5
    limit = bound(rig, [run.log], run.truth.gain)
    assert limit.oracle_rms < limit.rms
    assert np.sqrt(np.mean(squares)) < 1.2 * limit.rms
    assert np.sqrt(np.mean(squares)) > 0.85 * limit.rms
    stated = np.sqrt(np.mean(np.diag(estimate.normalised_covariance)[:36]))
    assert stated == pytest.approx(limit.rms, rel=0.15)


@METHODS
def test_sigma_contains_what_is_uncertain_of_payload_and_clock(method: Method) -> None:
    rig = uncertain_rig(gravity=GRAVITY)
    scores, clocks = [], []
    for seed in range(10):
        run = simulate(rig, seed=seed)
        estimate = estimate_windows(rig, [run.log], method)
        assert estimate.converged
        scores.append(nees(rig, estimate, [run]))
        clocks.append((estimate.time_offsets[0] - run.truth.time_offset) / estimate.time_offsets_std[0])
        assert estimate.time_offsets_std[0] < 5e-4
    assert honest(scores, 42)
    assert np.mean(np.square(clocks)) < 2.5


@METHODS
def test_sigma_contains_the_curve_on_which_an_uncertain_payload_moves_the_gain(method: Method) -> None:
    loose = {"mass": 0.01, "center_of_mass": 0.002, "inertia": 0.05}  # the gain: to 1e-4 in some directions
    rig = uncertain_rig(loose, gravity=GRAVITY)
    scores = []
    for seed in range(8):
        run = simulate(rig, seed=seed)
        scores.append(nees(rig, estimate_windows(rig, [run.log], method), [run]))
    assert 0.7 < np.mean(scores) < 1.1  # first order: 4
    assert max(scores) < chi2.isf(1e-8, 42) / 42


def test_sources_of_uncertainty_add_up_and_grow_with_what_is_stated() -> None:
    rig = uncertain_rig()
    estimate = estimate_windows(rig, [simulate(rig, seed=3).log])
    total = np.diag(estimate.normalised_covariance)[:36].reshape(6, 6)
    parts = estimate.contributions
    assert set(parts) == {"noise", "mass", "center_of_mass", "inertia", "timing"}
    np.testing.assert_allclose(sum(part**2 for part in parts.values()), total, rtol=0.3, atol=1e-7)
    exact = estimate_windows(
        rig_of(plan={"duration": 10}), [simulate(rig_of(plan={"duration": 10}), seed=3).log]
    )
    assert set(exact.contributions) == {"noise"}


def test_offset_that_follows_temperature_is_told_apart() -> None:
    rig = rig_of(temperature={"reference": 20, "prior": 1e-3})
    run = simulate(rig, seed=1)
    slope = np.array([0.2, -0.1, 0.3, 0.02, 0.01, -0.02])
    temperature = 20.0 + 8.0 * run.log.time / run.log.time[-1]
    warm = replace(run.log, temperature=temperature, raw=run.log.raw + np.outer(temperature - 20.0, slope))
    estimate = estimate_windows(rig, [warm])
    assert estimate.offset_temperature is not None
    np.testing.assert_allclose(estimate.offset_temperature, slope, atol=0.05 * 0.5)
    assert nees(rig, estimate, [run]) < 2.0
    with pytest.raises(InputError, match="temperature"):
        estimate_windows(rig, [warm, run.log])
    with pytest.raises(InputError, match="a column without a reading"):
        estimate_windows(rig, [replace(warm, temperature=np.full(len(temperature), np.nan))])


def test_covariance_in_si_is_the_normalised_one_in_other_units() -> None:
    rig = rig_of()
    estimate = estimate_windows(rig, [simulate(rig, seed=1).log])
    std = np.sqrt(np.diag(estimate.normalised_covariance))
    scale, span = rig.sensor.channel_scale, rig.sensor.range_array
    found = np.sqrt(np.diag(estimate.covariance))
    np.testing.assert_allclose(found[:36].reshape(6, 6), std[:36].reshape(6, 6) * scale[:, None] / span)
    np.testing.assert_allclose(found[36:], std[36:] * scale)
    np.testing.assert_allclose(found[36:], estimate.offsets_std[-1])


@pytest.mark.parametrize(("of", "feels"), [("sensor", "payload_on_sensor"), ("sensor", "sensor_on_payload")])
def test_a_twist_logged_at_the_sensor_is_as_honest(of: str, feels: str) -> None:
    rig = rig_of(gravity=GRAVITY, motion={"of": of}, sensor={"feels": feels})
    runs = [simulate(rig, seed=seed, payload="small") for seed in range(6)]
    scores = [nees(rig, estimate_windows(rig, [run.log]), [run]) for run in runs]
    assert honest(scores, 42)


def test_the_same_motion_of_sensor_or_centre_of_mass_gives_the_same_gain() -> None:
    """Without noise in the twist: v_S = v_C - Omega x c."""
    rig = rig_of(motion={"noise": [1e-5] * 6})
    run = simulate(rig, seed=2)
    assert run.log.twist is not None
    exact = run.trajectory.twist(run.log.time)
    shifted = exact.copy()
    shifted[:, :3] -= np.cross(exact[:, 3:], rig.payloads["table_1"].center_of_mass_array)
    of_mass = estimate_windows(rig, [replace(run.log, twist=exact)])
    at_sensor = rig_of(motion={"noise": [1e-5] * 6, "of": "sensor"})
    of_sensor = estimate_windows(at_sensor, [replace(run.log, twist=shifted)])
    std = np.sqrt(np.diag(of_mass.covariance)[:36]).reshape(6, 6)
    assert np.abs((of_mass.gain - of_sensor.gain) / std).max() < 0.3
    wrong = estimate_windows(rig, [replace(run.log, twist=shifted)])
    assert np.abs((wrong.gain - run.truth.gain) / std).max() > 10.0


@METHODS
def test_the_opposite_sign_of_sensor_and_samples_is_the_same_sensor(method: Method) -> None:
    rig, opposite = rig_of(), rig_of(sensor={"feels": "sensor_on_payload"})
    log = simulate(rig, seed=3).log
    one = estimate_windows(rig, [log], method)
    other = estimate_windows(opposite, [replace(log, raw=-log.raw)], method)
    np.testing.assert_allclose(one.gain, other.gain, atol=1e-9)
    np.testing.assert_allclose(one.offsets, -other.offsets, atol=1e-7)
    np.testing.assert_allclose(one.wrench[0], -other.wrench[0], atol=1e-6)


def test_units_of_the_channels_do_not_matter() -> None:
    """Millivolts, of another sensitivity in each channel, are the same calibration in other units."""
    rig = rig_of()
    log = simulate(rig, seed=4).log
    unit = np.array([1e-3, 2.0, 5e3, 0.7, 1e2, 1e-2])
    other = rig_of(
        sensor={"nominal_gain": np.diag(unit).tolist(), "noise": (rig.sensor.noise_array * unit).tolist()}
    )
    one, scaled = estimate_windows(rig, [log]), estimate_windows(other, [replace(log, raw=log.raw * unit)])
    np.testing.assert_allclose(scaled.gain / unit[:, None], one.gain, atol=1e-8)
    np.testing.assert_allclose(scaled.offsets / unit, one.offsets, atol=1e-6)
    np.testing.assert_allclose(scaled.normalised_covariance, one.normalised_covariance, rtol=1e-5, atol=1e-12)


@METHODS
def test_eight_gauges_around_their_nominal_gain(method: Method) -> None:
    nominal = np.random.default_rng(5).normal(size=(8, 6)) * [0.01] * 6 / [1, 1, 1, 0.1, 0.1, 0.1]
    scale = np.abs(nominal) @ [500, 500, 500, 50, 50, 50]
    rig = rig_of(
        sensor={
            "channels": [f"gauge_{i}" for i in range(8)],
            "nominal_gain": nominal.tolist(),
            "noise": (1e-3 * scale).tolist(),
            "gain_prior": 0.1,
        }
    )
    scores = []
    for seed in range(6):
        run = simulate(rig, seed=seed)
        estimate = estimate_windows(rig, [run.log], method)
        assert estimate.gain.shape == (8, 6)
        assert estimate.offsets.shape == (1, 8)
        assert estimate.covariance.shape == (56, 56)
        scores.append(nees(rig, estimate, [run]))
    assert honest(scores, 56)


def pooled_runs(rig: Rig, payloads: Sequence[str], seed: int = 0) -> list[SimulatedRun]:
    """Logs of one sensor, each with an offset and a noise of its own."""
    gain = simulate(rig, seed=seed).truth.gain.tolist()
    settings = rig.to_mapping()
    fixed = Rig.from_mapping({**settings, "simulate": {**settings["simulate"], "gain": gain}})
    return [simulate(fixed, payload=name, seed=100 * seed + k) for k, name in enumerate(payloads)]


@METHODS
def test_pooled_logs_recover_every_offset_and_tighten_the_gain(method: Method) -> None:
    rig = rig_of()
    runs = pooled_runs(rig, ["table_1"] * 3)
    estimate = estimate_windows(rig, [run.log for run in runs], method)
    truth = np.array([run.truth.offset for run in runs])
    assert np.ptp(truth, axis=0).min() > 10 * estimate.offsets_std.max(axis=0).min()
    assert np.abs((estimate.offsets - truth) / estimate.offsets_std).max() < 4.5
    assert nees(rig, estimate, runs) < 2.0
    alone = estimate_windows(rig, [runs[0].log], method)
    ratio = np.diag(alone.covariance)[:36] / np.diag(estimate.covariance)[:36]
    assert np.median(ratio) == pytest.approx(3.0, rel=0.15)


def test_every_log_is_taken_with_its_own_payload() -> None:
    rig = rig_of(gravity=GRAVITY)
    scores = []
    for seed in range(4):
        runs = pooled_runs(rig, ["table_1", "small"], seed)
        scores.append(nees(rig, estimate_windows(rig, [run.log for run in runs]), runs))
    assert honest(scores, 42)
    swapped = [replace(runs[0].log, payload="small"), replace(runs[1].log, payload="table_1")]
    wrong = estimate_windows(rig, swapped)
    assert mostly_unexplained(wrong.windows) or nees(rig, wrong, runs) > 100.0


def test_one_offset_for_all_logs_is_known_better_than_one_each() -> None:
    each, one = rig_of(), rig_of(sensor={"pool_offsets": True})
    runs = pooled_runs(each, ["table_1"] * 2)
    second = replace(runs[1].log, raw=runs[1].log.raw - runs[1].truth.offset + runs[0].truth.offset)
    logs = [runs[0].log, second]
    pooled, apart = estimate_windows(one, logs), estimate_windows(each, logs)
    np.testing.assert_array_equal(pooled.offsets[0], pooled.offsets[1])
    np.testing.assert_array_less(pooled.offsets_std, apart.offsets_std)
    assert np.abs((pooled.offsets[0] - runs[0].truth.offset) / pooled.offsets_std[0]).max() < 4.0


def test_a_sensor_without_offset_has_none() -> None:
    rig = rig_of(sensor={"offset_prior": 0}, simulate={"offset": "none"})
    run = simulate(rig, seed=6)
    estimate = estimate_windows(rig, [run.log])
    assert not estimate.offsets.any()
    assert not estimate.offsets_std.any()
    d = error(rig, estimate, [run])[:36]
    assert d @ np.linalg.solve(estimate.normalised_covariance[:36, :36], d) / 36 < 2.0


def test_a_channel_with_an_exact_offset_keeps_it() -> None:
    rig = rig_of(sensor={"offset_prior": [50, 50, 50, 5, 5, 0]})
    run = simulate(rig, seed=6)
    assert run.truth.offset[5] == 0.0
    estimate = estimate_windows(rig, [run.log])
    assert abs(estimate.offsets[0, 5]) < 1e-6
    assert nees(rig, estimate, [run]) < 2.0


@METHODS
def test_threads_do_not_change_a_bit(method: Method) -> None:
    rig = rig_of(gravity=GRAVITY)
    logs = [run.log for run in pooled_runs(rig, ["table_1", "small"])]
    results = []
    for threads in (1, 2):
        settings = _core.EstimatorSettings()
        settings.threads = threads
        results.append(estimate_windows(rig, logs, method, settings))
    for name in ("gain", "covariance", "offsets"):
        np.testing.assert_array_equal(getattr(results[0], name), getattr(results[1], name))
    for one, two in zip(results[0].wrench, results[1].wrench, strict=True):
        np.testing.assert_array_equal(one, two)


def test_online_history_ends_at_the_result_and_only_gets_surer() -> None:
    rig = rig_of()
    estimate = estimate_windows(rig, [simulate(rig, seed=9).log], "online")
    assert np.all(np.diff(estimate.history_time) > 0)
    np.testing.assert_allclose(estimate.history_gain[-1], estimate.gain, rtol=0.05, atol=0.01)
    assert np.all(np.diff(estimate.history_std, axis=0) <= 1e-9)


def test_wrench_of_the_fit_is_that_of_the_motion() -> None:
    rig = rig_of(gravity=GRAVITY, sensor={"feels": "sensor_on_payload"})
    run = simulate(rig, seed=10)
    estimate = estimate_windows(rig, [run.log])
    rows, wrench = estimate.wrench_rows[0], estimate.wrench[0]
    assert np.isfinite(wrench).all()
    # What the true sensor reads, less its noise.
    readings = (run.log.raw[rows] - run.truth.offset) @ np.linalg.inv(run.truth.gain).T
    rms = np.sqrt(np.mean((readings - wrench) ** 2, axis=0))
    noise = np.sqrt(np.diag(np.linalg.inv(run.truth.gain) @ np.diag(rig.sensor.noise_array**2)
                            @ np.linalg.inv(run.truth.gain).T))  # fmt: skip
    np.testing.assert_array_less(rms, 1.2 * noise)
