"""Imperfect hardware is what docs/imperfections.md says: each kind as an outsider measures it on a log."""

from __future__ import annotations

import numpy as np
import pytest
from imperfect_cases import EVERYTHING, GROUND, Array, normalised_gain, rig_of, swing, true_load, twins

from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.simulation.effects import LowPass, dahl, play
from truewrench.simulation.free_body import default_trajectory, simulate, wrench_on_sensor


@pytest.mark.parametrize("gravity", [[0, 0, 0], GROUND])
def test_perfect_hardware_gives_the_bits_of_gain_offset_and_noise_alone(gravity: list[float]) -> None:
    """Generators and formula are those from before there were imperfections."""
    run = simulate(rig_of(gravity=gravity), seed=5)
    rig, log, truth = rig_of({}, gravity=gravity), run.log, run.truth
    time, rng = log.time_ns * 1e-9, np.random.default_rng([5, 1])
    at = np.zeros((time.size, 3)) if log.gravity is None else log.gravity
    motion = default_trajectory(rig)
    nu, a = motion.twist(time), motion.acceleration(time)
    wrench = wrench_on_sensor(truth.payloads["table_1"], np.array([0.2, 0, 0]), nu, a, at)
    departure = rig.sensor.gain_prior * np.random.default_rng([5, 0]).standard_normal((6, 6))
    gain = np.eye(6) + departure * rig.sensor.channel_scale[:, None] / rig.sensor.range_array
    noise = rig.sensor.noise_array * rng.standard_normal((time.size, 6))
    assert np.array_equal(truth.gain, gain)
    assert np.array_equal(log.raw, wrench @ gain.T + truth.offset + noise)
    assert log.twist is not None
    assert np.array_equal(log.twist, nu + rig.motion.noise_array * rng.standard_normal((time.size, 6)))
    assert truth.imperfections == {}
    assert np.array_equal(simulate(rig, seed=5).log.raw, log.raw)


def test_sizes_of_zero_are_no_imperfection() -> None:
    nothing = {
        kind: {**value, "size": 0} if isinstance(value, dict) else 0
        for kind, value in EVERYTHING.items()
        if kind not in ("noise", "velocity_filter", "sensor_filter")
    }
    _, run, _, off = twins(nothing, gravity=GROUND)
    np.testing.assert_allclose(off, 0.0, atol=1e-12)
    assert set(run.truth.imperfections) == set(nothing)


def test_play_lags_by_its_size_on_the_way_up_and_down() -> None:
    size = 2e-3
    rig, run, time, off = twins({"hysteresis": {"size": size}})
    load = true_load(rig, run, time) @ normalised_gain(rig, run).T
    assert np.abs(off).max() <= size * (1 + 1e-9)
    swung = 0
    for channel in range(6):
        x, d = load[:, channel], off[:, channel]
        rise = np.array([x[i] - x[max(0, i - 5) : i + 1].min() for i in range(x.size)])
        fall = np.array([x[max(0, i - 5) : i + 1].max() - x[i] for i in range(x.size)])
        # a turn may lie just before a sample: what goes on in its direction has not turned
        goes_on = np.append(np.diff(x), 0.0)
        monotone_up = (rise > 2.5 * size) & (fall == 0.0) & (goes_on > 0.0)
        monotone_down = (fall > 2.5 * size) & (rise == 0.0) & (goes_on < 0.0)
        np.testing.assert_allclose(d[monotone_up & ~monotone_down], -size, rtol=1e-6)
        np.testing.assert_allclose(d[monotone_down & ~monotone_up], size, rtol=1e-6)
        swung += int(monotone_up.any() and monotone_down.any())
    assert swung >= 3


def test_play_does_not_move_within_its_gap() -> None:
    load = 0.9e-3 * np.sin(np.linspace(0, 20, 1000))[:, None]
    np.testing.assert_array_equal(play(load, 1e-3), np.zeros((1000, 1)))


def test_dahl_friction_saturates_over_three_percent_of_range_and_turns_round_with_the_load() -> None:
    size = 5e-3
    up = np.linspace(0.0, 0.03, 50)[:, None]
    assert dahl(up, size)[-1, 0] == pytest.approx(size * (1 - np.exp(-1)), rel=1e-9)
    cycle = np.concatenate(
        [np.linspace(0, 0.3, 400), np.linspace(0.3, -0.3, 800), np.linspace(-0.3, 0.3, 800)]
    )
    friction = dahl(cycle[:, None], size)[:, 0]
    falling, rising = friction[400:1200], friction[1200:]
    middle = 400  # the load passes zero
    assert rising[middle] == pytest.approx(size, rel=1e-3)
    assert falling[middle] == pytest.approx(-size, rel=1e-3)
    coarse = dahl(cycle[::8, None], size)[:, 0]
    np.testing.assert_allclose(coarse, friction[::8], atol=0.05 * size)


def test_dahl_hysteresis_of_a_log_is_the_friction_of_its_load() -> None:
    rig, run, time, off = twins({"hysteresis": {"size": 3e-3, "form": "dahl"}})
    fine = np.arange(0.0, 8.0, 1e-4)
    load = true_load(rig, run, fine) @ normalised_gain(rig, run).T
    expected = dahl(load, 3e-3)[np.rint(time * 1e4).astype(int)]
    np.testing.assert_allclose(off, expected, atol=2e-5)
    assert run.truth.imperfections["hysteresis"] == {"size": 3e-3, "form": "dahl"}


def test_nonlinearity_is_all_products_of_the_load_with_the_square_of_the_own_axis_one() -> None:
    rig, run, time, off = twins({"nonlinearity": 5e-3})
    told = run.truth.imperfections["nonlinearity"]
    coefficients, (j, k) = np.array(told["coefficients"]), np.triu_indices(6)
    w = true_load(rig, run, time)
    np.testing.assert_allclose(off, 5e-3 * (w[:, j] * w[:, k]) @ coefficients.T, rtol=1e-3, atol=1e-9)
    own = {axis: int(np.flatnonzero((j == axis) & (k == axis))[0]) for axis in range(6)}
    assert [coefficients[axis, own[axis]] for axis in range(6)] == [1.0] * 6
    others = []
    for seed in range(40):
        drawn = simulate(rig, swing(0.5, 0.1), seed=seed).truth.imperfections["nonlinearity"]["coefficients"]
        values = np.array(drawn)
        others.append([values[:, j != k].std(), values[0, own[1]], values[3, own[2]]])
    mixed, *squares = np.array(others).T
    assert mixed.mean() == pytest.approx(0.3 * np.sqrt(2), rel=0.05)  # w_j w_l and w_l w_j
    assert np.concatenate(squares).std() == pytest.approx(0.3, rel=0.25)


def test_cable_pulls_with_its_size_on_every_axis_and_by_the_pose_alone() -> None:
    size = 1e-3
    amplitude = np.full((2, 6), 0.2)
    frequency = np.repeat([[0.5], [1.0]], 6, axis=1)
    motion = HarmonicTwist(amplitude, frequency, np.arange(12.0).reshape(2, 6), 8.0)  # repeats after 2 s
    rig, run, time, off = twins({"cable": size}, motion)
    force = off @ np.linalg.inv(normalised_gain(rig, run)).T
    np.testing.assert_allclose(np.sqrt(np.mean(force**2, axis=0)), size, rtol=5e-3)
    np.testing.assert_allclose(force.mean(axis=0), 0.0, atol=5e-3 * size)
    np.testing.assert_allclose(force[time < 2.0 - 1e-9], force[(time >= 2.0 - 1e-9) & (time < 4.0 - 1e-9)],
                               atol=1e-3 * size)  # fmt: skip
    told = run.truth.imperfections["cable"]
    rate = 2.0 * np.pi * frequency
    angle = rate * time[:, None, None] + np.arange(12.0).reshape(2, 6)
    pose = -(amplitude / rate * np.cos(angle)).sum(axis=1)
    np.testing.assert_allclose(pose.std(axis=0), told["pose_std"], rtol=5e-3)
    linear = (pose - pose.mean(axis=0)) / told["pose_std"] @ np.array(told["linear"]).T
    rest = force - linear
    share = rest.std(axis=0) / linear.std(axis=0)
    np.testing.assert_allclose(share, 0.5, rtol=0.02)  # half as much periodic and quadratic


def test_drift_settles_within_eight_seconds_and_keeps_its_course() -> None:
    _, run, time, off = twins({"drift": 1e-3}, plan={"duration": 20})
    end = np.array(run.truth.imperfections["drift"]["end"])
    np.testing.assert_allclose(off, np.outer(1 - np.exp(-time / 8.0), end), atol=1e-8)
    ends = [
        simulate(rig_of({"drift": 1e-3}), swing(0.5, 0.1), seed=s).truth.imperfections["drift"]["end"]
        for s in range(60)
    ]
    assert np.std(ends) == pytest.approx(1e-3, rel=0.12)


def test_random_walk_spreads_with_the_root_of_time() -> None:
    size = 1e-3
    _, run, time, off = twins({"random_walk": size}, plan={"duration": 60})
    for lag in (10, 100):
        steps = off[lag::lag] - off[:-lag:lag]
        assert steps.std() == pytest.approx(size * np.sqrt(time[lag] - time[0]), rel=0.15)
    np.testing.assert_allclose(off[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(off[-1], run.truth.imperfections["random_walk"]["end"], atol=5 * size * 0.1)


def test_vibration_has_its_frequency_and_its_mean_amplitude() -> None:
    rig, run, time, off = twins(
        {"vibration": {"size": 5e-3, "hz": 23.0}}, plan={"duration": 20}, simulate={"sensor_rate": 400}
    )
    force = off @ np.linalg.inv(normalised_gain(rig, run)).T
    spectrum = np.abs(np.fft.rfft(force, axis=0)) ** 2
    hz = np.fft.rfftfreq(time.size, 1 / 400)
    near = np.abs(hz - 23.0) < 1.0
    assert spectrum[near].sum() > 0.99 * spectrum[1:].sum()
    # a sine of amplitude 1 + 0.5 sin: mean square (1 + 0.125) / 2
    np.testing.assert_allclose(np.sqrt(np.mean(force**2, axis=0)), 5e-3 * np.sqrt(1.125 / 2), rtol=0.05)
    drawn = [
        simulate(rig_of({"vibration": {"size": 1e-3}}), swing(0.5, 0.1), seed=s).truth.imperfections
        for s in range(20)
    ]
    frequencies = [imperfections["vibration"]["hz"] for imperfections in drawn]
    assert 12 <= min(frequencies) < 20 < 32 < max(frequencies) <= 40


def test_contact_is_one_half_sine_of_the_stated_peak() -> None:
    stated = {"size": 0.1, "start": 2.005, "duration": 1.0}
    rig, run, time, off = twins({"contact": stated})
    direction = np.array(run.truth.imperfections["contact"]["direction"])
    assert np.abs(direction).max() == 1.0
    force = off @ np.linalg.inv(normalised_gain(rig, run)).T
    shape = np.where((time > 2.005) & (time < 3.005), np.sin(np.pi * (time - 2.005)), 0.0)
    np.testing.assert_allclose(force, 0.1 * np.outer(shape, direction), atol=1e-5)


def test_contact_and_step_happen_within_the_record_where_nothing_is_stated() -> None:
    rig = rig_of({"contact": {"size": 0.1}, "step": {"size": 0.01}})
    told = [simulate(rig, swing(0.5, 6.0), seed=s).truth.imperfections for s in range(40)]
    starts = np.array([t["contact"]["start"] for t in told])
    lengths = np.array([t["contact"]["duration"] for t in told])
    steps = np.array([t["step"]["time"] for t in told])
    assert starts.min() >= 0.9
    assert (starts + lengths).max() <= 5.1 + 1e-9
    assert 0.2 <= lengths.min() < 0.4 < 1.2 < lengths.max() <= 2.0
    assert 0.9 <= steps.min() < 2.0 < 4.0 < steps.max() <= 5.1


def test_step_comes_at_its_time_with_its_size_and_stays() -> None:
    _, run, time, off = twins({"step": {"size": 1e-2, "time": 3.005}})
    direction = np.array(run.truth.imperfections["step"]["direction"])
    assert np.abs(direction).max() == 1.0
    np.testing.assert_allclose(off[time < 3.005], 0.0, atol=1e-12)
    np.testing.assert_allclose(off[time > 3.005], np.tile(1e-2 * direction, (499, 1)), rtol=1e-9)


def test_spikes_hit_their_share_of_the_samples_in_all_channels() -> None:
    _, run, _, off = twins({"spikes": {"size": 0.1}}, plan={"duration": 60})
    hit = np.abs(off).max(axis=1) > 1e-12
    assert hit.sum() == run.truth.imperfections["spikes"]["samples"]
    assert hit.mean() == pytest.approx(0.01, rel=0.4)
    assert (np.abs(off[hit]) > 0).all()
    assert off[hit].std() == pytest.approx(0.1, rel=0.15)


def response(low_pass: LowPass, hz: float) -> complex:
    """Of the filter in continuous time."""
    s = 1j * hz / low_pass.hz
    return complex(1 / (1 + s) if low_pass.order == 1 else 1 / (1 + np.sqrt(2) * s + s**2))


def phasor(time: Array, signal: Array, hz: float) -> Array:
    """Complex amplitude (d,) of a signal (N, d) of one frequency, after its first second."""
    t, late = time[time > 1.0], signal[time > 1.0]
    angle = 2 * np.pi * hz * t
    found = np.linalg.lstsq(np.stack([np.cos(angle), np.sin(angle), np.ones_like(t)], 1), late, rcond=None)[0]
    return np.asarray(found[0] - 1j * found[1])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("hz", [1.5, 8.0])
def test_filters_have_the_response_of_their_order(order: int, hz: float) -> None:
    """Translation alone: the wrench then has the one frequency of the motion."""
    amplitude = np.array([[0.2, 0.1, 0.15, 0.0, 0.0, 0.0]])
    motion = HarmonicTwist(amplitude, np.full((1, 6), hz), np.zeros((1, 6)), 6.0)
    for kind in ("sensor_filter", "velocity_filter"):
        filtered = {kind: {"hz": 12.0, "order": order}, "noise": 0}
        run, ideal = (
            simulate(rig_of(i, simulate={"rate": 500, "sensor_rate": 500, "payload": "nominal"}), motion)
            for i in (filtered, {"noise": 0})
        )
        assert run.log.twist is not None
        assert ideal.log.twist is not None
        time = run.log.time_ns * 1e-9
        pairs = {
            "sensor_filter": (run.log.raw, ideal.log.raw),
            "velocity_filter": (run.log.twist, ideal.log.twist),
        }
        for other, (signal, reference) in pairs.items():
            expected = response(LowPass(12.0, order), hz) if other == kind else 1.0
            found = phasor(time, signal, hz)[:3] / phasor(time, reference, hz)[:3]
            np.testing.assert_allclose(found, expected, atol=2e-3)


def test_filters_start_without_a_transient() -> None:
    slow = LowPass(10.0, 2)
    t = np.linspace(0, 2, 2001)
    signal = np.stack([np.sin(2 * np.pi * 0.4 * t + 0.7), 3.0 * t - 1.0], axis=1)
    late = np.stack([np.sin(2 * np.pi * 0.4 * (t - slow.delay) + 0.7), 3.0 * (t - slow.delay) - 1.0], axis=1)
    np.testing.assert_allclose(slow.of_motion(signal, 1000.0), late, atol=3e-3)


def test_noise_of_the_sensor_passes_its_filter() -> None:
    still = swing(0.5, 100.0, amplitude=0.0)
    run = simulate(rig_of({"sensor_filter": {"hz": 10.0}}), still)
    noise = (run.log.raw - run.truth.offset) / rig_of().sensor.noise_array
    keeps = np.exp(-2 * np.pi * 10.0 / 100.0)  # of a value held for a sample, after one more
    np.testing.assert_allclose(noise.std(axis=0), np.sqrt((1 - keeps) / (1 + keeps)), rtol=0.05)
    for channel in noise.T:
        assert np.corrcoef(channel[1:], channel[:-1])[0, 1] == pytest.approx(keeps, abs=0.05)


def test_jitter_is_white_and_each_stream_has_its_own() -> None:
    size = 2e-3
    run, twin = (
        simulate(rig_of({"noise": 0, **imperfect}, plan={"duration": 20}))
        for imperfect in ({"jitter": size}, {})
    )
    assert run.log.twist is not None
    assert twin.log.twist is not None
    time = run.log.time_ns * 1e-9
    moved = []
    for signal, ideal in ((run.log.raw, twin.log.raw), (run.log.twist, twin.log.twist)):
        rate = np.gradient(ideal, time, axis=0)
        off, scale = signal - ideal, np.abs(rate).max(axis=0)
        moved.append(np.sum(off * rate / scale**2, axis=1) / np.sum((rate / scale) ** 2, axis=1))
    for delay in moved:
        assert delay.std() == pytest.approx(size, rel=0.05)
        assert abs(np.corrcoef(delay[1:], delay[:-1])[0, 1]) < 0.08
    assert abs(np.corrcoef(*moved)[0, 1]) < 0.08


def test_logged_motion_comes_in_steps_of_its_noise() -> None:
    rig, run, _, off = twins({"quantisation": 10})
    assert run.log.twist is not None
    steps = run.log.twist / (10 * rig.motion.noise_array)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.unique(np.round(steps[:, 0])).size > 10
    np.testing.assert_array_equal(off, 0.0)


def test_noise_is_a_factor_on_both_streams() -> None:
    quiet, run = (simulate(rig_of({"noise": factor}, plan={"duration": 40})) for factor in (0, 2.5))
    assert run.log.twist is not None
    assert quiet.log.twist is not None
    rig = rig_of()
    np.testing.assert_allclose(
        (run.log.raw - quiet.log.raw).std(axis=0), 2.5 * rig.sensor.noise_array, rtol=0.06
    )
    np.testing.assert_allclose(
        (run.log.twist - quiet.log.twist).std(axis=0), 2.5 * rig.motion.noise_array, rtol=0.06
    )


def test_tilted_gravity_pulls_aslant_while_the_log_says_plumb() -> None:
    gravity = [0.3, -0.4, -9.8]
    still = swing(0.5, 1.0, amplitude=0.0)
    run = simulate(rig_of({"gravity_tilt": 0.01, "noise": 0}, gravity=gravity), still)
    told = run.truth.imperfections["gravity_tilt"]
    acting = np.array(told["gravity"])
    assert np.linalg.norm(acting) == pytest.approx(np.linalg.norm(gravity), rel=1e-12)
    cosine = acting @ gravity / np.linalg.norm(gravity) ** 2
    assert np.arccos(cosine) == pytest.approx(0.01, rel=1e-6)
    assert told["angle"] == pytest.approx(0.01, rel=1e-12)
    assert run.log.gravity is not None
    np.testing.assert_allclose(run.log.gravity, np.tile(gravity, (100, 1)), atol=1e-12)
    force = ((run.log.raw - run.truth.offset) @ np.linalg.inv(run.truth.gain).T)[:, :3]
    np.testing.assert_allclose(force, np.tile(50.0 * acting, (100, 1)), rtol=1e-9)


def test_random_tilt_has_the_spread_of_its_prior_about_two_axes() -> None:
    rig = rig_of({"gravity_tilt": "random"}, gravity=GROUND, gravity_tilt_prior=2e-3)
    still = swing(0.5, 0.05, amplitude=0.0)
    pulls = [simulate(rig, still, seed=s).truth.imperfections["gravity_tilt"]["gravity"] for s in range(300)]
    np.testing.assert_allclose(np.std(pulls, axis=0)[:2] / 9.81, 2e-3, rtol=0.15)
