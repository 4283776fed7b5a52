"""Logs as the new estimator reads them; simulations with truth judge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import HONEST, G, RigOf, arm_with, base_log, estimate, masked, nees, rig_with

from truewrench import _core
from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation.assumptions import Assumptions
from truewrench.estimation.record import recorded_logs
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import Trajectory, attitude
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.simulation.free_body import simulate
from truewrench.simulation.truth import Truth

# What is assumed


def test_assumptions_are_fractions_of_each_channels_range(settings: dict[str, Any]) -> None:
    gain = np.diag([2.0, 2.0, 2.0, 10.0, 10.0, 10.0])
    gain[0, 3] = 4.0
    sensor = {"nominal_gain": gain.tolist(), "feels": "sensor_on_payload", "discrepancy": 0.002}
    rig = rig_with(settings, sensor=sensor, gravity=G)
    assumed = Assumptions.of(rig, [])
    assert assumed.channel_scale[0] == 2.0 * 500 + 4.0 * 50
    assert assumed.nominal[0, 3] == pytest.approx(4.0 * 50 / 1200)
    np.testing.assert_allclose(np.abs(assumed.nominal).sum(axis=1), 1.0)
    np.testing.assert_allclose(assumed.noise * assumed.channel_scale, rig.sensor.noise)
    np.testing.assert_allclose(assumed.offset_prior, 0.1)
    assert (assumed.sign, assumed.discrepancy) == (-1, 0.002)
    assert (assumed.clock_mean, assumed.kappa_mean, assumed.gamma_mean) == (0.0, 0.5, 0.5)
    root = np.sqrt([1.5, 1.5, 0.4])
    inertia = 1e-2 * np.array([1.5, 1.5, 0.4, root[0] * root[1], root[0] * root[2], root[1] * root[2]])
    np.testing.assert_allclose(assumed.body_prior[0], [1e-3, 5e-4, 5e-4, 5e-4, *inertia])
    np.testing.assert_array_equal(assumed.range, [500.0, 500.0, 500.0, 50.0, 50.0, 50.0])
    assert assumed.position_noise is None


def test_stated_filter_moves_the_means_of_the_clock(settings: dict[str, Any]) -> None:
    rig = rig_with(settings, sensor={"lowpass_hz": 40.0})
    assumed, statement, (streams,) = recorded_logs(rig, [simulate(rig_with(settings)).log])
    assert assumed.clock_mean == pytest.approx(1.0 / (2.0 * np.pi * 40.0))
    assert (assumed.kappa_mean, statement.gamma_mean) == (0.0, 1.0)
    assert streams.motion[0].clock_mean == assumed.clock_mean


def test_tilt_is_assumed_where_gravity_acts_and_auto_is_found(settings: dict[str, Any]) -> None:
    sensor = {"discrepancy": "auto"}
    orbit = rig_with(settings, sensor=sensor, gravity_tilt_prior=1e-3)
    ground = rig_with(settings, sensor=sensor, gravity_tilt_prior=1e-3, gravity=G)
    assert [Assumptions.of(rig, []).tilt_prior for rig in (orbit, ground)] == [0.0, 1e-3]
    assert Assumptions.of(orbit, []).discrepancy == -1.0


def test_slope_needs_temperatures_in_every_log(settings: dict[str, Any]) -> None:
    rig = rig_with(settings, temperature={"prior": 1e-3})
    log = simulate(rig).log
    warm = replace(log, temperature=np.where(np.arange(len(log.time_ns)) % 2, 30.0, np.nan))
    assert Assumptions.of(rig, [log]).slope_prior == 0.0
    _, _, (streams,) = recorded_logs(rig, [warm])
    np.testing.assert_allclose(np.ravel(streams.temperature), 5.0)
    with pytest.raises(InputError, match="temperature: found no such column"):
        Assumptions.of(rig, [warm, log])


# Twists


@pytest.mark.parametrize("feels", ["payload_on_sensor", "sensor_on_payload"])
def test_twist_log_in_gravity_gives_the_gain_within_its_sigma(settings: dict[str, Any], feels: str) -> None:
    rig = rig_with(settings, gravity=G, sensor={"feels": feels}, motion={"of": "sensor"})
    run = simulate(rig)
    found = estimate(rig, run.log)
    assert nees(found, rig, run.truth) < HONEST
    late = np.asarray(found.fit.theta)[found.fit.columns(0).at[found.fit.columns(0).clock[0]]]
    assert late == pytest.approx(-run.truth.time_offset, abs=5e-4)


def test_streams_of_several_rates_need_no_resampling(settings: dict[str, Any]) -> None:
    rig = rig_with(settings, gravity=G, simulate={"rate": 250, "sensor_rate": 100})
    run = simulate(rig)
    assert nees(estimate(rig, run.log), rig, run.truth) < HONEST


def test_eight_channels(settings: dict[str, Any]) -> None:
    gain = np.vstack([np.eye(6), [[0.5, 0.5, 0, 0, 0, 2.0], [0, 0.5, -0.5, 3.0, 0, 0]]])
    sensor = {
        "channels": [f"g{i}" for i in range(8)],
        "noise": [0.5] * 3 + [0.05] * 3 + [0.4] * 2,
        "nominal_gain": gain.tolist(),
    }
    rig = rig_with(settings, sensor=sensor)
    run = simulate(rig)
    assert nees(estimate(rig, run.log), rig, run.truth) < HONEST


@pytest.mark.parametrize(
    ("walk", "knots", "status"),
    [
        (np.nan, [0.0, 1.0], _core.Status.not_finite),
        (-1e-4, [0.0, 1.0], _core.Status.not_positive),
        (1e-4, [], _core.Status.wrong_size),
        (0.0, [1.0], _core.Status.wrong_size),
        (1e-4, [1.0, 1.0], _core.Status.not_increasing),
    ],
)
def test_a_walk_of_the_offset_that_makes_no_sense_is_told_by_a_status(
    settings: dict[str, Any], walk: float, knots: list[float], status: _core.Status
) -> None:
    rig = rig_with(settings)
    _, statement, (log,) = recorded_logs(rig, [simulate(rig).log])
    log.offset_knots, log.offset_walk = knots, walk
    assert _core.estimate(statement, [log], _core.Settings()).status == status


def test_missing_cells_and_a_gap_leave_out_their_residuals(settings: dict[str, Any]) -> None:
    rig = rig_with(settings, gravity=G, plan={"duration": 12})
    run = simulate(rig)
    rng = np.random.default_rng(0)
    raw, twist = run.log.raw.copy(), run.log.twist.copy()  # type: ignore[union-attr]
    raw[rng.random(raw.shape) < 0.05] = np.nan
    twist[rng.random(twist.shape) < 0.05] = np.nan
    gap = (run.log.time > 5.0) & (run.log.time < 6.0)
    raw[gap] = twist[gap] = np.nan
    log = replace(run.log, raw=raw, twist=twist)
    found = estimate(rig, log)
    assert nees(found, rig, run.truth) < HONEST
    assert len(found.fit.pieces(0)) == 2
    assert masked(found) < 0.01 * raw.shape[0]
    rows = np.asarray(found.fit.rows(0)["source"]).ravel()
    assert not gap[rows].any()
    np.testing.assert_allclose(np.asarray(found.fit.rows(0)["time"]).ravel(), log.time[rows])


def test_two_payloads_in_two_logs_share_the_gain(settings: dict[str, Any]) -> None:
    small = {**settings["payloads"]["default"], "mass": 20, "center_of_mass": [0, 0.1, 0.1]}
    rig = rig_with(settings, payloads={"small": small}, plan={"duration": 5}, simulate={"gain": "nominal"})
    runs = [simulate(rig, payload=name, seed=k) for k, name in enumerate(("default", "small"))]
    _, statement, streams = recorded_logs(rig, [run.log for run in runs])
    assert [s.body for s in streams] == [0, 1]
    assert len(statement.body_prior) == 2
    found = estimate(rig, *(run.log for run in runs))
    assert nees(found, rig, runs[0].truth) < HONEST


def test_logged_accelerations_are_a_stream_of_their_own(settings: dict[str, Any]) -> None:
    rig = rig_with(settings, motion={"acceleration_noise": [1e-2] * 6}, simulate={"time_offset": 0})
    run = simulate(rig)
    rng = np.random.default_rng(5)
    at = run.trajectory.acceleration(run.log.time)
    log = replace(run.log, acceleration=at + 1e-2 * rng.standard_normal(at.shape))
    _, _, (streams,) = recorded_logs(rig, [log])
    assert [m.derivative for m in streams.motion] == [0, 1]
    found = estimate(rig, log)
    assert nees(found, rig, run.truth) < HONEST
    np.testing.assert_allclose(np.asarray(found.fit.sizes(0).motion_factor[1]), 1.0, atol=0.1)


def test_samples_without_a_direction_of_gravity_are_left_out_and_told(settings: dict[str, Any]) -> None:
    rig = rig_with(settings, gravity=G, simulate={"time_offset": 0})
    log = simulate(rig).log
    gravity = log.gravity.copy()  # type: ignore[union-attr]
    gravity[:100], gravity[300:350] = np.nan, np.nan
    known = replace(log, gravity=gravity)
    notes: list[str] = []
    _, _, (streams,) = recorded_logs(rig, [known], notes=notes)
    words = "150 samples of the sensor left out: the direction of gravity is not known then"
    assert notes == [f"{known.path}: {words}"]
    assert np.isnan(streams.raw).all(axis=1).sum() == 150
    assert np.isfinite(streams.R_sensor_root).all()
    assert any(words in note for note in calibrate(rig, known).figures["notes"])


def test_attitude_between_two_rows_follows_the_turn(settings: dict[str, Any]) -> None:
    rig = rig_with(settings, gravity=G, simulate={"rate": 50, "sensor_rate": 200, "time_offset": 0})
    run = simulate(rig)
    assert run.log.gravity is not None
    told = np.isfinite(run.log.twist).all(axis=1)  # type: ignore[arg-type]
    slow = replace(run.log, gravity=np.where(told[:, None], run.log.gravity, np.nan))
    _, _, (streams,) = recorded_logs(rig, [slow])
    inside = np.isfinite(streams.raw).all(axis=1)
    fall = np.asarray(streams.R_sensor_root).reshape(-1, 3, 3) @ rig.gravity_array
    np.testing.assert_allclose(fall[inside], run.log.gravity[inside], atol=1e-4)


# IMU


def imu_log(settings: dict[str, Any], gravity: list[float], **options: Any) -> tuple[Rig, Log, Truth]:
    """What an IMU with constant errors reads where a twist log was simulated."""
    sigma_a, sigma_w = 1e-2, 1e-3
    twists = rig_with(settings, gravity=gravity, motion={"of": "sensor"}, simulate={"rate": 200} | options)
    run = simulate(twists)
    path: Trajectory = run.trajectory
    time, rng = run.log.time, np.random.default_rng(3)
    nu, a = path.twist(time), path.acceleration(time)
    fall = np.asarray(twists.gravity_array @ attitude(path, time))
    force = a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - fall
    read = np.column_stack([force, nu[:, 3:]]) + rng.normal(size=6) * ([0.05] * 3 + [0.005] * 3)
    read += rng.normal(size=read.shape) * ([sigma_a] * 3 + [sigma_w] * 3)
    read[~np.isfinite(run.log.twist).all(axis=1)] = np.nan  # type: ignore[arg-type]
    imu = {"source": "imu", "noise": [sigma_w] * 3, "acceleration_noise": [sigma_a] * 3}
    rig = Rig.from_mapping(twists.to_mapping() | {"motion": imu})
    log = replace(run.log, twist=None, gravity=None, angular_velocity=read[:, 3:], specific_force=read[:, :3])
    return rig, log, run.truth


@pytest.mark.parametrize("gravity", [[0, 0, 0], G])
def test_imu_log_gives_the_gain_within_its_sigma(settings: dict[str, Any], gravity: list[float]) -> None:
    rig, log, truth = imu_log(settings, gravity)
    found = estimate(rig, log)
    assert nees(found, rig, truth) < HONEST
    columns, theta = found.fit.columns(0), np.asarray(found.fit.theta)
    assert Assumptions.of(rig, [log]).tilt_prior == 0.0
    assert theta[columns.at[columns.clock[1]]] == pytest.approx(-truth.time_offset, abs=1e-3)


def test_imu_axes_are_two_streams_with_errors_of_their_own(settings: dict[str, Any]) -> None:
    rig, log, _ = imu_log(settings, G)
    _, _, (streams,) = recorded_logs(rig, [log])
    force, omega = streams.motion
    assert np.isnan(force.value[:, 3:]).all()
    assert np.isnan(omega.value[:, :3]).all()
    np.testing.assert_array_equal(np.ravel(force.bias_prior), [0.05] * 3 + [1e-9] * 3)
    np.testing.assert_array_equal(np.ravel(omega.bias_prior), [1e-9] * 3 + [0.005] * 3)


# Refusals


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"twist": None}, "found no motion, expected vx vy vz wx wy wz"),
        ({"gravity": None}, "found no gravity, expected gx gy gz or qw qx qy qz"),
        ({"raw": np.full((801, 6), np.nan)}, r"raw_\*: found no samples of the sensor"),
    ],
)
def test_log_that_lacks_a_stream_is_refused(
    settings: dict[str, Any], columns: dict[str, Any], message: str
) -> None:
    rig = rig_with(settings, gravity=G, simulate={"time_offset": 0})
    with pytest.raises(InputError, match=message):
        recorded_logs(rig, [replace(simulate(rig).log, **columns)])


@pytest.mark.parametrize("rows", [1, 2, 3, 12])
def test_few_rows_are_told_by_the_estimator(settings: dict[str, Any], arm_rig: RigOf, rows: int) -> None:
    twists = rig_with(settings, simulate={"time_offset": 0})
    arm = arm_with(arm_rig, "panda")
    imu, of_imu, _ = imu_log(settings, G, time_offset=0)
    for rig, log in (
        (twists, simulate(twists).log),
        (imu, of_imu),
        (arm, replace(base_log(arm, np.arange(0.0, 1.0, 0.01), 7), base_twist=None, base_attitude=None)),
    ):
        assert estimate(rig, rows_of(log, np.arange(len(log.time_ns)) < rows)).status != _core.Status.ok


def test_log_of_no_rows_is_refused(settings: dict[str, Any]) -> None:
    rig = rig_with(settings)
    none = Log(None, "default", "", np.zeros(0, np.int64), np.zeros((0, 6)), twist=np.zeros((0, 6)))
    with pytest.raises(InputError, match="no samples of the sensor"):
        recorded_logs(rig, [none])
