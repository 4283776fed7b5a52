"""Laws that an estimate obeys whatever the record holds: permutation, units, sign, splitting, more data."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import light_rig

import truewrench as tw
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.model.payload import payload_wrench

BASE: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.1, 0.1, 0.1, 0.01, 0.01, 0.01],
        "range": [500, 500, 500, 50, 50, 50],
        "time_offset_prior": 1e-3,
        "discrepancy": 0,
    },
    "payloads": {
        "default": {
            "mass": 50,
            "center_of_mass": [0.2, 0, 0],
            "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4, "xy": 0, "xz": 0, "yz": 0},
        }
    },
    "motion": {"source": "twist", "of": "com", "noise": [1e-4] * 6},
    "plan": {"duration": 8},
    "simulate": {"rate": 100, "seed": 3, "payload": "random"},
}


def _rig(**sensor: Any) -> tw.Rig:
    return tw.Rig.from_mapping({**BASE, "sensor": {**BASE["sensor"], **sensor}})


@pytest.fixture(scope="module")
def run() -> Any:
    return tw.simulate(_rig())


@pytest.fixture(scope="module")
def plain(run: Any) -> Estimate:
    return estimate(_rig(), [run.log])


def _sigma(e: Estimate) -> np.ndarray:
    return np.sqrt(np.diag(e.normalised_covariance)[: 6 * len(e.gain)]).reshape(-1, 6)


def test_the_truth_lies_within_sigma(run: Any, plain: Estimate) -> None:
    rig = _rig()
    unit = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
    error = ((plain.gain - run.truth.gain) * unit).ravel()
    P = plain.normalised_covariance[:36, :36]
    assert error @ np.linalg.solve(P, error) / 36 < 1.8  # 99.8% of chi-square at 36 degrees


def test_permuting_channels_permutes_rows(run: Any, plain: Estimate) -> None:
    order = [4, 2, 0, 5, 1, 3]
    nominal = np.eye(6)[order].tolist()
    noise = [BASE["sensor"]["noise"][i] for i in order]
    channels = [BASE["sensor"]["channels"][i] for i in order]
    rig = _rig(channels=channels, noise=noise, nominal_gain=nominal)
    found = estimate(rig, [replace(run.log, raw=run.log.raw[:, order])])
    # six channels are grouped by place: the sizes of noise are found over other groups
    assert np.abs(found.gain - plain.gain[order])[:, :3].max() < 0.1 * (_sigma(plain) * 1.0).max()
    assert np.allclose(_sigma(found), _sigma(plain)[order], rtol=0.05)


def test_other_units_of_the_channels_change_nothing(run: Any, plain: Estimate) -> None:
    factor = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
    noise = (factor * BASE["sensor"]["noise"]).tolist()
    rig = _rig(noise=noise, nominal_gain=np.diag(factor).tolist())
    found = estimate(rig, [replace(run.log, raw=run.log.raw * factor)])
    assert np.allclose(found.gain / factor[:, None], plain.gain, rtol=1e-7, atol=1e-9)
    assert np.allclose(_sigma(found), _sigma(plain), rtol=1e-6)


def test_the_opposite_sign_convention_reverses_the_gain(run: Any, plain: Estimate) -> None:
    rig = _rig(feels="sensor_on_payload", nominal_gain=(-np.eye(6)).tolist())
    found = estimate(rig, [run.log])
    assert np.allclose(found.gain, -plain.gain, rtol=1e-7, atol=1e-9)


def test_a_log_in_two_pieces_with_one_offset_says_the_same(run: Any, plain: Estimate) -> None:
    half = len(run.log.time_ns) // 2

    def piece(rows: slice) -> Any:
        log = run.log
        return replace(log, time_ns=log.time_ns[rows], raw=log.raw[rows], twist=log.twist[rows])

    rig = _rig(pool_offsets=True)
    found = estimate(rig, [piece(slice(0, half)), piece(slice(half, None))])
    unit = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
    # the cut costs the motion at its ends, and each piece finds its own sizes and clock
    assert np.abs((found.gain - plain.gain) * unit / _sigma(plain)).max() < 1.0
    assert (_sigma(found) / _sigma(plain)).max() < 1.3


def test_more_data_never_raise_sigma(run: Any, plain: Estimate) -> None:
    longer = tw.simulate(tw.Rig.from_mapping({**BASE, "plan": {"duration": 16}}))
    found = estimate(_rig(), [longer.log])
    assert np.median(_sigma(found) / _sigma(plain)) < 0.95


def test_any_number_of_threads_gives_the_same_bits(run: Any) -> None:
    log = run.log
    gap = np.ones(len(log.time_ns), dtype=bool)
    gap[350:420] = False
    cut = replace(log, time_ns=log.time_ns[gap], raw=log.raw[gap], twist=log.twist[gap])
    one, two = (estimate(_rig(), [cut], threads=threads) for threads in (1, 2))
    assert np.array_equal(one.gain, two.gain)
    assert np.array_equal(one.covariance, two.covariance)


@pytest.mark.parametrize("estimator", ["map", "online", "ekf", "ls"])
@pytest.mark.parametrize("rows", range(13))
def test_a_record_of_a_few_rows_is_refused_with_a_reason(run: Any, rows: int, estimator: Any) -> None:
    log = run.log
    short = replace(log, time_ns=log.time_ns[:rows], raw=log.raw[:rows], twist=log.twist[:rows])
    try:
        found = tw.calibrate(_rig(), short, estimator)
    except tw.InputError:
        return  # status 2
    assert not found.verdict.usable
    assert found.verdict.reasons


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_a_log_too_short_beside_a_long_one_is_named(run: Any, estimator: Any) -> None:
    log = run.log
    short = replace(log, time_ns=log.time_ns[:10], raw=log.raw[:10], twist=log.twist[:10])
    for logs in ([log, short], [short, log]):
        verdict = tw.calibrate(_rig(), logs, estimator).verdict
        assert not verdict.usable
        assert "shorter than 12 knots" in verdict.reasons[0]


@pytest.mark.parametrize("prior", [1e-12, 1e200])
def test_any_gain_prior_ends_in_a_verdict(run: Any, prior: float) -> None:
    found = tw.calibrate(_rig(gain_prior=prior), run.log, held_out=False)
    assert found.verdict.usable or found.verdict.reasons


@pytest.mark.parametrize("rest", [2.5, 6.0])
def test_online_waits_for_the_motion(rest: float) -> None:
    """An arm rests before it starts: sizes found at rest took its motion for noise of the velocities."""
    rig = light_rig(seconds=10, rate=100, discrepancy=0, time_offset_prior=5e-3)
    run = tw.simulate(rig)
    rng, rate = np.random.default_rng(0), 100.0
    time = np.arange(round((rest + 9.0) * rate)) / rate
    u = np.clip((time - rest) / 2.0, 0.0, 1.0)
    speed = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)  # of the simulated motion: from rest to as it was in 2 s
    at = np.cumsum(speed) / rate
    nu, a = run.trajectory.twist(at), run.trajectory.acceleration(at)
    acceleration = a * speed[:, None] ** 2 + nu * np.gradient(speed, time)[:, None]
    twist, none = nu * speed[:, None], np.zeros((time.size, 3))
    raw = (
        payload_wrench(rig, next(iter(rig.payloads)), twist, acceleration, none) @ run.truth.gain.T
        + run.truth.offset
    )
    log = replace(
        run.log,
        time_ns=np.round(time * 1e9).astype(np.int64),
        raw=raw + rng.normal(size=raw.shape) * rig.sensor.noise_array,
        twist=twist + rng.normal(size=twist.shape) * rig.motion.noise_array,
    )
    whole, live = (estimate(rig, [log], online=online) for online in (False, True))
    assert (_sigma(live) / _sigma(whole)).max() < 1.2
    unit = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
    error = ((live.gain - run.truth.gain) * unit).ravel()
    assert error @ np.linalg.solve(live.normalised_covariance[:36, :36], error) / 36.0 < 1.8
