"""Claims about logs that are not as the model has them: contacts, coloured noise, drift, filters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

import truewrench as tw
from truewrench.estimate.noise import measured_noise
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.estimate.windows import estimate_windows
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate
from truewrench.split import rows_of

Array = NDArray[np.float64]

NOISE = np.array([0.5, 0.5, 0.5, 0.05, 0.05, 0.05])


def rig_of(rate: int = 100, **sensor: Any) -> Rig:
    exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    motion = {k: sensor.pop(k) for k in ("acceleration_noise",) if k in sensor}
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": sensor.pop("noise", NOISE.tolist()),
                "range": [500, 500, 500, 50, 50, 50],
                "gain_prior": 0.2,
                "time_offset_prior": sensor.pop("time_offset_prior", 0),
                **sensor,
            },
            "payloads": {
                "table_1": {
                    "mass": 50,
                    "center_of_mass": [0.2, 0, 0],
                    "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
                    "uncertainty": exact,
                }
            },
            "motion": {"of": "com", "noise": [1e-3] * 6, **motion},
            "required": 1.0,
            "plan": {"duration": 10},
            "simulate": {"rate": rate, "sensor_rate": rate},
        }
    )


def gain_error(rig: Rig, gain: Array, run: SimulatedRun) -> Array:
    sensor = rig.sensor
    return ((gain - run.truth.gain) * sensor.range_array / sensor.channel_scale[:, None]).ravel()


def gain_nees(rig: Rig, estimate: WindowEstimate, run: SimulatedRun) -> float:
    d = gain_error(rig, estimate.gain, run)
    return float(d @ np.linalg.solve(estimate.normalised_covariance[:36, :36], d) / 36)


def pushed(log: Log, size: float, begin: float, length: float) -> tuple[Log, NDArray[np.bool_]]:
    """The log with `size` times its noise on every channel for a while."""
    during = (log.time >= begin) & (log.time < begin + length)
    raw = log.raw.copy()
    raw[during] += size * NOISE * np.array([1, -1, 1, -1, 1, -1])
    return replace(log, raw=raw), during


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_a_contact_is_left_out_and_named_and_leaves_the_gain_honest(estimator: Any) -> None:
    rig = rig_of(200)
    scores, found, clean = [], 0, []
    for seed in range(4):
        run = simulate(rig, seed=seed)
        log, during = pushed(run.log, 3.0, 2.0 + seed, 0.05)
        calibration = tw.calibrate(rig, log, estimator, held_out=False)
        assert calibration.verdict.usable, calibration.verdict.reasons
        report = calibration.logs[0]
        left_out = np.zeros(len(log.time), dtype=bool)
        for begin, end in report.disturbances:
            left_out |= (log.time >= begin) & (log.time <= end)
        assert left_out.sum() == report.masked.get("disturbance of the sensor", 0)
        assert report.used + left_out.sum() + sum(report.rejected.values()) == len(log.time)
        found += bool(left_out[during].mean() > 0.5)
        clean.append(left_out[~during].mean())
        d = gain_error(rig, calibration.gain, run)
        span = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
        unit = np.append(span.ravel(), 1.0 / rig.sensor.channel_scale)
        covariance = calibration.covariance * unit[:, None] * unit
        scores.append(d @ np.linalg.solve(covariance[:36, :36], d) / 36)
    assert found == 4
    assert max(clean) < 0.01
    assert 0.7 < np.mean(scores) < 1.35


def test_a_long_push_in_the_first_window_costs_its_own_time_only() -> None:
    rig = rig_of()
    run = simulate(rig, seed=3)
    log, during = pushed(run.log, 40.0, 0.0, 0.8)
    estimate = estimate_windows(rig, [log], "map")
    assert gain_nees(rig, estimate, run) < 1.7
    used = np.isfinite(estimate.wrench[0]).all(axis=1)
    assert used[~during].mean() > 0.9


def test_spikes_of_the_velocities_are_left_out() -> None:
    rig = rig_of()
    run = simulate(rig, seed=4)
    twist = run.log.twist
    assert twist is not None
    spiked = twist.copy()
    spiked[[150, 450, 750], [0, 4, 2]] += 0.05  # 50 sigma
    estimate = estimate_windows(rig, [replace(run.log, twist=spiked)], "map")
    assert estimate.motion_left_out[0] >= 3
    assert np.isfinite(estimate.wrench[0]).all(axis=1).mean() > 0.97
    assert gain_nees(rig, estimate, run) < 1.7


def test_clean_logs_lose_next_to_nothing() -> None:
    rig = rig_of()
    lost = [estimate_windows(rig, [simulate(rig, seed=s).log]).left_out[0].mean() for s in range(8)]
    assert np.mean(lost) < 0.002


def coloured(rng: np.random.Generator, samples: int, rho: float) -> Array:
    """First-order autoregressive noise (samples, 6) of unit variance."""
    white = rng.normal(size=(samples + 1000, 6)) * np.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0)[1000:])


def test_white_noise_is_measured_as_it_is() -> None:
    rig = rig_of()
    for seed in range(4):
        noise = measured_noise(rig, estimate_windows(rig, [simulate(rig, seed=seed).log]).windows)
        np.testing.assert_allclose(noise.estimated, noise.given, rtol=0.1)
        assert (noise.colour == 1.0).all()


@pytest.mark.parametrize("rho", [0.6, 0.9])
def test_coloured_noise_is_seen_and_paid_for(rho: float) -> None:
    rig = rig_of(noise=(np.sqrt(2.0) * NOISE).tolist(), time_offset_prior=0.01)
    scores, ignored = [], []
    for seed in range(3):
        quiet = simulate(rig_of(), seed=seed)
        extra = coloured(np.random.default_rng(seed), len(quiet.log.raw), rho) * NOISE
        log = replace(quiet.log, raw=quiet.log.raw + extra)
        calibration = tw.calibrate(rig, log, held_out=False)
        if not calibration.verdict.usable:
            continue
        d = gain_error(rig, calibration.gain, quiet)
        span = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
        covariance = calibration.covariance[:36, :36] * span.ravel()[:, None] * span.ravel()
        scores.append(d @ np.linalg.solve(covariance, d) / 36)
        ignored.append(gain_nees(rig, estimate_windows(rig, [log], "online"), quiet))
        assert any("coloured" in note for note in calibration.figures["notes"])
    assert len(scores) >= 2
    assert np.mean(scores) < 1.8
    if rho == 0.9:
        assert np.mean(ignored) > 2.0 * np.mean(scores)


@pytest.mark.parametrize("factor", [0.3, 0.77, 2.0])
def test_misstated_noise_is_refused_and_rescaled_on_request(factor: float) -> None:
    run = simulate(rig_of(), seed=7)
    rig = rig_of(noise=(factor * NOISE).tolist())
    refused = tw.calibrate(rig, run.log, held_out=False)
    assert not refused.verdict.usable
    assert all("--rescale-noise" in reason for reason in refused.verdict.reasons)
    taken = tw.calibrate(rig, run.log, held_out=False, rescale_noise=True)
    assert taken.verdict.usable, taken.verdict.reasons
    right = tw.calibrate(rig_of(), run.log, held_out=False)
    np.testing.assert_allclose(taken.gain_std, right.gain_std, rtol=0.15)
    assert np.abs((refused.gain - right.gain) / right.gain_std).max() < 1.0
    for found in (refused, taken):
        for name, sigma in zip(rig.sensor.channels, NOISE, strict=True):
            assert found.figures["noise"][name]["estimated"] == pytest.approx(sigma, rel=0.1)


def walked(log: Log, density: Array, rng: np.random.Generator) -> tuple[Log, Array]:
    steps = rng.normal(size=log.raw.shape) * np.sqrt(np.diff(log.time, prepend=0.0))[:, None] * density
    offset = np.cumsum(steps, axis=0)
    return replace(log, raw=log.raw + offset), offset


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_a_walking_offset_is_followed(estimator: Any) -> None:
    density = 0.05 * NOISE
    rig = rig_of(offset_walk=density.tolist())
    scores, ends = [], []
    for seed in range(6):
        run = simulate(rig, seed=seed)
        log, offset = walked(run.log, density, np.random.default_rng(seed))
        estimate = estimate_windows(rig, [log], estimator)
        scores.append(gain_nees(rig, estimate, run))
        ends.append(((estimate.offsets[0] - run.truth.offset - offset[-1]) / estimate.offsets_std[0]) ** 2)
    assert 0.6 < np.mean(scores) < 1.45
    assert np.mean(ends) < 1.8


def test_a_gain_that_walks_from_week_to_week_is_followed() -> None:
    week = 7 * 86_400
    walk = 0.004  # per sqrt(day)
    rig = rig_of(gain_walk=walk)
    rng = np.random.default_rng(1)
    scores, still = [], []
    for seed in range(4):
        runs: list[SimulatedRun] = []
        logs: list[Log] = []
        change = np.zeros((6, 6))
        for k in range(3):
            run = simulate(rig, seed=100 + seed)  # the same truth to begin with
            if k > 0:
                change = change + walk * np.sqrt(7.0) * rng.normal(size=(6, 6))
            wrench = (run.log.raw - run.truth.offset) @ np.linalg.inv(run.truth.gain).T
            to_si = rig.sensor.channel_scale[:, None] / rig.sensor.range_array
            gain = run.truth.gain + change * to_si
            raw = wrench @ gain.T + run.truth.offset
            logs.append(replace(run.log, raw=raw, time_ns=run.log.time_ns + k * week * 1_000_000_000))
            runs.append(replace(run, truth=replace(run.truth, gain=gain)))
        estimate = estimate_windows(rig, logs, "online")
        scores.append(gain_nees(rig, estimate, runs[-1]))
        still.append(gain_nees(rig, estimate_windows(rig_of(), logs, "online"), runs[-1]))
    assert np.mean(scores) < 1.5
    assert np.mean(still) > 3.0


def true_motion(rig: Rig, seed: int) -> tuple[Array, Array]:
    """Twist and its derivative, without noise, at the times of a simulated log."""
    still = rig.model_copy(update={"motion": rig.motion.model_copy(update={"noise": (1e-12,) * 6})})
    log = simulate(still, seed=seed).log
    assert log.twist is not None
    return log.twist, np.asarray(make_interp_spline(log.time, log.twist, k=7).derivative()(log.time))


def test_an_accelerometer_at_the_sensor_is_fused_and_improves_the_gain() -> None:
    accel = 5e-3
    rig, with_accel = (
        rig_of(noise=(0.04 * NOISE).tolist()),
        rig_of(noise=(0.04 * NOISE).tolist(), acceleration_noise=[accel] * 3),
    )
    c = np.array([0.2, 0.0, 0.0])
    scores, gains = [], []
    for seed in range(5):
        run = simulate(rig, seed=seed)
        twist, rate = true_motion(rig, seed)
        v, omega = twist[:, :3], twist[:, 3:]
        at_sensor = rate[:, :3] - np.cross(rate[:, 3:], c) + np.cross(omega, v - np.cross(omega, c))
        noisy = at_sensor + accel * np.random.default_rng(seed).normal(size=at_sensor.shape)
        estimate = estimate_windows(with_accel, [replace(run.log, specific_force=noisy)])
        scores.append(gain_nees(with_accel, estimate, run))
        plain = estimate_windows(rig, [run.log])
        gains.append(
            np.trace(plain.normalised_covariance[:36, :36])
            / np.trace(estimate.normalised_covariance[:36, :36])
        )
    assert 0.6 < np.mean(scores) < 1.45
    assert np.mean(gains) > 1.5


@pytest.mark.parametrize("noise_behind", [False, True])
def test_a_known_low_pass_filter_is_undone(noise_behind: bool) -> None:
    corner, fine = 10.0, 40
    rig, unaware = rig_of(lowpass_hz=corner, time_offset_prior=1e-3), rig_of(time_offset_prior=0.05)
    scores, without = [], []
    for seed in range(4):
        run = simulate(rig_of(), seed=seed)
        log, rng = run.log, np.random.default_rng(seed)
        twist, rate = true_motion(rig_of(), seed)
        spec = rig.payloads["table_1"]
        clean = newton_euler(spec.mass, spec.center_of_mass_array, spec.inertia_matrix, twist, rate)
        raw = make_interp_spline(log.time, clean @ run.truth.gain.T + run.truth.offset, k=5)
        dense = np.linspace(0.0, log.time[-1], (len(log.time) - 1) * fine + 1)
        pole = np.exp(-2.0 * np.pi * corner * (dense[1] - dense[0]))

        def low(x: Array, pole: float = pole) -> Array:
            return np.asarray(lfilter([1.0 - pole], [1.0, -pole], x, axis=0))

        filtered = (low(raw(dense) - raw(0.0)) + raw(0.0))[::fine]
        noise = rng.normal(size=filtered.shape)
        if not noise_behind:
            through = low(rng.normal(size=(len(dense), 6)))
            noise = (through / through[len(dense) // 2 :].std(axis=0))[::fine]
        changed = rows_of(replace(log, raw=filtered + noise * NOISE), log.time > 0.5)
        scores.append(gain_nees(rig, estimate_windows(rig, [changed]), run))
        without.append(gain_nees(unaware, estimate_windows(unaware, [changed]), run))
    assert np.mean(scores) < 1.6
    assert np.mean(without) > 3.0 * np.mean(scores)


def newton_euler(mass: float, c: Array, inertia: Array, twist: Array, rate: Array) -> Array:
    """Newton and Euler, written out."""
    v, omega, vdot, alpha = twist[:, :3], twist[:, 3:], rate[:, :3], rate[:, 3:]
    force = mass * (vdot + np.cross(omega, v))
    moment = alpha @ inertia.T + np.cross(omega, omega @ inertia.T) + np.cross(c, force)
    return -np.column_stack([force, moment])


def test_the_parts_of_a_walking_log_are_reported_as_one_log() -> None:
    density = 0.05 * NOISE
    rig = rig_of(offset_walk=density.tolist())
    run = simulate(rig, seed=2)
    logs = [walked(run.log, density, np.random.default_rng(k))[0] for k in range(2)]
    estimate = estimate_windows(rig, logs)
    assert {w.log for w in estimate.windows} == {0, 1}
    assert len(estimate.windows) > 4
    assert len(estimate.offsets) == len(estimate.wrench) == len(estimate.left_out) == 2
    for log, rows, wrench in zip(logs, estimate.wrench_rows, estimate.wrench, strict=True):
        np.testing.assert_array_equal(rows, np.arange(len(log.time)))
        assert wrench.shape == (len(log.time), 6)


@pytest.mark.parametrize("pole", [0.9, 0.97])
def test_a_filter_that_the_rig_does_not_state_is_suspected_where_the_clock_is_said_to_be_exact(
    pole: float,
) -> None:
    run = simulate(rig_of(), seed=1)
    extra = coloured(np.random.default_rng(1), len(run.log.raw), pole) * NOISE
    first = run.log.raw[:1]
    filtered = np.asarray(lfilter([1.0 - pole], [1.0, -pole], run.log.raw - first, axis=0)) + first
    log = rows_of(replace(run.log, raw=filtered + extra), run.log.time > 1.0)
    calibration = tw.calibrate(rig_of(), log, held_out=False)
    assert not calibration.verdict.usable
    assert any("lowpass_hz" in reason or "time offset" in reason for reason in calibration.verdict.reasons), (
        calibration.verdict.reasons
    )


@pytest.mark.parametrize("rho", [0.5, 0.9])
def test_coloured_noise_without_a_delay_is_paid_for_and_not_refused(rho: float) -> None:
    rig, scores, usable = rig_of(), [], 0
    for seed in range(4):
        run = simulate(rig_of(noise=(1e-3 * NOISE).tolist()), seed=seed)
        noise = coloured(np.random.default_rng(seed), len(run.log.raw), rho) * NOISE
        calibration = tw.calibrate(rig, replace(run.log, raw=run.log.raw + noise), held_out=False)
        usable += calibration.verdict.usable
        error = (calibration.gain - run.truth.gain).ravel()
        scores.append(error @ np.linalg.solve(calibration.covariance[:36, :36], error) / 36.0)
    assert usable >= 3
    assert max(scores) < 2.93  # 1e-8 of chi-square


def test_a_simulated_walk_ends_at_the_offset_of_the_truth() -> None:
    density = 0.2 * NOISE
    rig, still = rig_of(offset_walk=density.tolist()), rig_of()
    walks = np.stack([simulate(rig, seed=s).log.raw - simulate(still, seed=s).log.raw for s in range(40)])
    np.testing.assert_allclose(walks[:, -1], 0.0, atol=1e-9)
    duration = simulate(still, seed=0).log.time[-1]
    assert np.mean((walks[:, 0] / density) ** 2) == pytest.approx(duration, rel=0.35)


@pytest.mark.parametrize("estimator", ["ekf", "ls"])
def test_reference_estimators_refuse_a_walk(estimator: Any) -> None:
    rig = rig_of(offset_walk=(0.1 * NOISE).tolist())
    with pytest.raises(tw.UnsupportedError, match="offset_walk"):
        tw.calibrate(rig, simulate(rig, seed=0).log, estimator)


def test_noise_that_is_a_little_larger_than_stated_is_paid_for() -> None:
    run = simulate(rig_of(200), seed=9)
    stated = tw.calibrate(rig_of(200, noise=(0.94 * NOISE).tolist()), run.log, held_out=False)
    assert stated.verdict.usable, stated.verdict.reasons
    right = tw.calibrate(rig_of(200), run.log, held_out=False)
    ratio = np.sqrt(np.mean(stated.gain_std**2) / np.mean(right.gain_std**2))
    assert ratio == pytest.approx(1.0, abs=0.04)  # and not 0.94


@pytest.mark.parametrize("late", ["sensor", "velocities"])
def test_a_delay_behind_the_back_of_an_exact_clock_is_suspected(late: str) -> None:
    rig = rig_of(noise=(0.2 * NOISE).tolist())
    run = simulate(rig, seed=3)
    assert tw.calibrate(rig, run.log, held_out=False).verdict.usable
    delay = 0.005 if late == "sensor" else -0.005
    twist = run.log.twist
    assert twist is not None
    moved = np.column_stack(
        [make_interp_spline(run.log.time, column, k=5)(run.log.time + delay) for column in twist.T]
    )
    inner = (run.log.time > 0.1) & (run.log.time < run.log.time[-1] - 0.1)
    log = rows_of(replace(run.log, twist=moved), inner)
    verdict = tw.calibrate(rig, log, held_out=False).verdict
    assert not verdict.usable
    assert any("time offset" in reason or "lowpass_hz" in reason for reason in verdict.reasons)
