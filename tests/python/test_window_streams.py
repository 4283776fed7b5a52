"""What `map` and `online` make of streams with gaps, of different rates, and of more than velocities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from window_cases import FITTED, GRAVITY, METHODS, Method, honest, nees, rig_of

from truewrench.errors import InputError
from truewrench.estimate.windows import estimate_windows
from truewrench.log import Log
from truewrench.simulation.free_body import simulate


@METHODS
@pytest.mark.parametrize(("rate", "sensor_rate"), [(100, 400), (400, 100), (125, 90)])
def test_streams_of_different_rates_share_a_table(method: Method, rate: float, sensor_rate: float) -> None:
    rig = rig_of(simulate={"rate": rate, "sensor_rate": sensor_rate}, gravity=GRAVITY)
    scores = []
    for seed in range(4):
        run = simulate(rig, seed=seed)
        assert np.isnan(run.log.raw).any() or np.isnan(np.asarray(run.log.twist)).any()
        scores.append(nees(rig, estimate_windows(rig, [run.log], method), [run]))
    assert honest(scores, 42)


@METHODS
def test_missing_cells_leave_out_their_own_residuals(method: Method) -> None:
    rig = rig_of()
    draw = np.random.default_rng(7)
    scores = []
    for seed in range(4):
        run = simulate(rig, seed=seed)
        raw, twist = run.log.raw.copy(), np.array(run.log.twist)
        raw[draw.random(raw.shape) < 0.05] = np.nan
        twist[draw.random(twist.shape) < 0.05] = np.nan
        raw[200:203] = np.nan
        twist[300:303] = np.nan
        log = replace(run.log, raw=raw, twist=twist)
        estimate = estimate_windows(rig, [log], method)
        assert np.isfinite(estimate.gain).all()
        scores.append(nees(rig, estimate, [run]))
    assert honest(scores, 42)


def without_rows(log: Log, first: int, last: int) -> Log:
    keep = np.ones(len(log.time_ns), dtype=bool)
    keep[first:last] = False
    return replace(log, time_ns=log.time_ns[keep], raw=log.raw[keep], twist=np.asarray(log.twist)[keep])


@METHODS
@pytest.mark.parametrize(("lost", "spanned"), [(3, True), (6, False), (150, False)])
def test_no_window_spans_a_gap_of_more_than_five_periods(method: Method, lost: int, spanned: bool) -> None:
    rig = rig_of()
    run = simulate(rig, seed=8)
    estimate = estimate_windows(rig, [without_rows(run.log, 250, 250 + lost)], method)
    middle = 2.5 + 0.005 * lost
    assert any(w.begin < middle < w.end for w in estimate.windows) == spanned
    assert nees(rig, estimate, [run]) < 2.0


def test_a_gap_in_one_stream_alone_breaks_the_windows_too() -> None:
    rig = rig_of()
    run = simulate(rig, seed=8)
    raw = run.log.raw.copy()
    raw[300:350] = np.nan
    estimate = estimate_windows(rig, [replace(run.log, raw=raw)])
    assert not any(w.begin < 3.2 < w.end for w in estimate.windows)
    assert nees(rig, estimate, [run]) < 2.0


def test_logged_accelerations_are_fused_where_their_noise_is_stated() -> None:
    noise = {"acceleration_noise": [1e-2] * 6}
    rig = rig_of()
    run = simulate(rig, seed=12)
    draw = np.random.default_rng(0)
    acceleration = run.trajectory.acceleration(run.log.time) + 1e-2 * draw.normal(size=(600, 6))
    log = replace(run.log, acceleration=acceleration)
    without, fused = estimate_windows(rig, [log]), estimate_windows(rig_of(motion=noise), [log])
    plain = estimate_windows(rig, [run.log])
    np.testing.assert_array_equal(without.gain, plain.gain)
    assert np.trace(fused.normalised_covariance[:36, :36]) < 0.95 * np.trace(
        plain.normalised_covariance[:36, :36]
    )
    assert nees(rig, fused, [run]) < 2.0


def test_a_log_of_a_few_samples_leaves_the_prior() -> None:
    rig = rig_of()
    log = simulate(rig, seed=13).log
    few = without_rows(log, 5, len(log.time_ns))
    for method in ("map", "online"):
        estimate = estimate_windows(rig, [few], method)
        assert not any(w.status == FITTED for w in estimate.windows)
        np.testing.assert_allclose(estimate.gain, np.eye(6), atol=1e-9)


def test_a_log_in_gravity_needs_its_direction() -> None:
    rig = rig_of(gravity=GRAVITY)
    log = simulate(rig, seed=14).log
    with pytest.raises(InputError, match="gx gy gz"):
        estimate_windows(rig, [replace(log, gravity=None)])
    with pytest.raises(InputError, match="vx vy vz"):
        estimate_windows(rig, [replace(log, twist=None)])


def test_gravity_logged_at_a_lower_rate_is_interpolated() -> None:
    rig = rig_of(gravity=GRAVITY)
    run = simulate(rig, seed=15)
    gravity = np.array(run.log.gravity)
    gravity[np.arange(len(gravity)) % 5 != 0] = np.nan
    estimate = estimate_windows(rig, [replace(run.log, gravity=gravity)])
    full = estimate_windows(rig, [run.log])
    std = np.sqrt(np.diag(full.covariance)[:36]).reshape(6, 6)
    assert np.abs((estimate.gain - full.gain) / std).max() < 1.0
