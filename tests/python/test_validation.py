"""A validation tells better from worse and honest from boastful, on logs whose wrench is not the core's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import truewrench as tw
from truewrench.estimation.inertial import InertialMotion
from truewrench.judging.validation import Validation, validate
from truewrench.judging.validation.residuals import residuals
from truewrench.model.calibration import AXES, Calibration, LogReport, Verdict
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import Body
from truewrench.model.rig import Rig
from truewrench.model.split import held_out
from truewrench.simulation.free_body import simulate, wrench_on_sensor

SPAN = np.array([500.0, 500, 500, 50, 50, 50])
CLAIMED = 0.002  # normalised sigma of every gain


def rig_of(**changes: Any) -> Rig:
    settings: dict[str, Any] = {
        "sensor": {
            "channels": list(AXES),
            "feels": "payload_on_sensor",
            "noise": [0.2] * 3 + [0.02] * 3,
            "range": SPAN.tolist(),
            "time_offset_prior": 0,
        },
        "payloads": {
            name: {
                "mass": mass,
                "center_of_mass": [0.2, 0, 0],
                "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
                "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
            }
            for name, mass in (("default", 50), ("other", 20))
        },
        "motion": {"noise": [2e-4] * 6},
        "plan": {"duration": 10},
    }
    for section, values in changes.items():
        settings[section] = {**settings.get(section, {}), **values} if isinstance(values, dict) else values
    return Rig.from_mapping(settings)


def gain_of(rng: np.random.Generator, departure: float = 0.15) -> np.ndarray:
    return (np.eye(6) + departure * rng.standard_normal((6, 6))) * SPAN[:, None] / SPAN


def calibrated(rig: Rig, gain: np.ndarray, claimed: float = CLAIMED, **changes: Any) -> Calibration:
    std = claimed * SPAN[:, None] / SPAN
    offset = np.zeros(6)
    return Calibration(
        gain=gain, gain_std=std, offset=offset, offset_std=np.ones(6), inverse=np.linalg.inv(gain),
        covariance=np.diag(np.append(std.ravel(), np.ones(6)) ** 2), verdict=Verdict(True),
        logs=(LogReport(None, "", "default", offset, np.ones(6)),), rig=rig, estimator="map", **changes,
    )  # fmt: skip


def log_of(rig: Rig, gain: np.ndarray, seed: int = 0, **simulate_: Any) -> Log:
    payload = simulate_.pop("payload_name", "default")
    options = {"gain": gain.tolist(), **simulate_}
    changed = Rig.from_mapping({**rig.to_mapping(), "simulate": options})
    return simulate(changed, payload=payload, seed=seed).log


def test_an_offset_that_follows_temperature_is_no_fault_of_the_gain() -> None:
    rig = rig_of(temperature={"reference": 20, "prior": 1e-3})
    gain = gain_of(np.random.default_rng(3))
    log = log_of(rig, gain)
    slope = np.array([0.2, -0.1, 0.3, 0.02, 0.01, -0.02])
    temperature = 20.0 + 8.0 * log.time / log.time[-1]
    temperature[1::3] = np.nan  # read less often than the sensor
    drift = np.outer(20.0 + 8.0 * log.time / log.time[-1] - 20.0, slope)
    warm = replace(log, raw=log.raw + drift, temperature=temperature)
    as_if_cold, known, unknown = (
        validate(calibrated(rig, gain, offset_temperature=follows), rig, record)
        for follows, record in ((None, log), (slope, warm), (None, warm))
    )
    assert known.verdict.usable
    for name, axis in known.axes.items():
        assert axis.nis == pytest.approx(as_if_cold.axes[name].nis, rel=1e-9)
    assert not unknown.verdict.usable


def within_claim(rng: np.random.Generator, gain: np.ndarray) -> np.ndarray:
    return gain + CLAIMED * rng.standard_normal((6, 6)) * SPAN[:, None] / SPAN


@pytest.fixture(scope="module")
def good() -> Validation:
    rig, rng = rig_of(), np.random.default_rng(0)
    gain = gain_of(rng)
    return validate(calibrated(rig, within_claim(rng, gain)), rig, log_of(rig, gain))


def test_right_gain_is_better_on_every_axis_and_its_sigma_honest(good: Validation) -> None:
    assert good.verdict.usable, good.verdict.reasons
    assert all(axis.better is True for axis in good.axes.values())
    for axis in good.axes.values():
        assert axis.ratio_low < axis.ratio < axis.ratio_high < 0.9
        assert abs(axis.nis - 1.0) < 4.0 * axis.nis_std + 0.05
        assert axis.coverage == pytest.approx(0.95, abs=0.1)  # one error of the gain for all samples
    assert good.held_out
    assert good.tared


@pytest.mark.parametrize("seed", range(3))
def test_accurate_sensor_is_not_blamed_for_noisy_velocities(seed: int) -> None:
    """A motion a little too smooth hides in 1 mm/s of noise, and its force is many times 0.02 N."""
    changes = {"noise": [0.02] * 3 + [0.002] * 3}
    rig, rng = rig_of(sensor=changes, motion={"noise": [1e-3] * 6}), np.random.default_rng(30 + seed)
    gain = gain_of(rng)
    log = log_of(rig, gain, seed, rate=900, sensor_rate=900)
    half = {name: getattr(log, name)[:2700] for name in ("time_ns", "raw", "twist")}
    found = validate(calibrated(rig, gain, 1e-6), rig, replace(log, **half))
    assert found.verdict.usable, found.verdict.reasons
    assert max(axis.nis for axis in found.axes.values()) < 2.0


def test_wrong_gain_is_worse_on_the_axes_named() -> None:
    rig, rng = rig_of(), np.random.default_rng(1)
    truth = gain_of(rng, 0.02)
    wrong = truth.copy()
    wrong[2, 2] *= 1.4
    found = validate(calibrated(rig, wrong), rig, log_of(rig, truth))
    assert not found.verdict.usable
    assert found.axes["fz"].better is False
    assert not found.axes["fz"].keep
    assert found.axes["fx"].keep
    assert any("fz is worse than with the nominal gain" in reason for reason in found.verdict.reasons)
    assert any("fz is larger than its claimed sigma" in reason for reason in found.verdict.reasons)
    assert found.axes["fx"].better is True


def test_noise_that_the_right_gain_turns_up_is_no_loss() -> None:
    """A channel at 0.7 of its nominal sensitivity, loads below its noise: the true wrench is read noisier."""
    rig, truth = rig_of(sensor={"noise": [200.0] * 3 + [20.0] * 3}), np.diag([0.7, 1, 1, 1, 1, 1.0])
    found = validate(calibrated(rig, truth), rig, log_of(rig, truth))
    assert found.axes["fx"].ratio_low > 1.1
    assert found.axes["fx"].better == "unsure"
    assert found.verdict.usable, found.verdict.reasons


def test_equal_gains_are_unsure_and_do_no_harm() -> None:
    rig = rig_of()
    found = validate(calibrated(rig, np.eye(6), 1e-5), rig, log_of(rig, np.eye(6)))
    assert found.verdict.usable, found.verdict.reasons
    assert {axis.better for axis in found.axes.values()} == {"unsure"}


@pytest.mark.parametrize(("factor", "word"), [(0.5, "larger"), (2.0, "smaller")])
def test_noise_stated_wrongly_contradicts_the_claim(factor: float, word: str) -> None:
    rig, rng = rig_of(), np.random.default_rng(2)
    gain = gain_of(rng, 0.02)  # little noise of force channels in moments
    misstated = rig_of(sensor={"noise": [0.2 * factor] * 3 + [0.02] * 3})
    found = validate(calibrated(misstated, gain, 1e-5), misstated, log_of(rig, gain))
    assert [reason.split(" is ")[1].split(" ")[0] for reason in found.verdict.reasons] == [word] * 3
    assert all("f" in reason for reason in found.verdict.reasons)


def test_gain_error_beyond_a_boastful_sigma_is_seen() -> None:
    rig, rng = rig_of(), np.random.default_rng(3)
    gain = gain_of(rng)
    found = validate(calibrated(rig, gain + 0.02 * SPAN[:, None] / SPAN, 1e-4), rig, log_of(rig, gain))
    assert any("larger than its claimed sigma" in reason for reason in found.verdict.reasons)


@pytest.mark.parametrize("seed", range(3))
def test_residuals_that_are_not_normal_leave_their_limits(seed: int) -> None:
    """Noise of the stated variance, but a seventh of the samples holds most of it."""
    rig, rng = rig_of(motion={"noise": [1e-5] * 6}), np.random.default_rng(20 + seed)
    log = log_of(rig, np.eye(6))
    clean = log_of(rig_of(sensor={"noise": [1e-9] * 6}, motion={"noise": [1e-5] * 6}), np.eye(6))
    noise = rig.sensor.noise_array * rng.standard_normal(log.raw.shape) * 0.4
    far = rng.random(len(noise)) < 1 / 7
    noise[far, 2] = 0.2 * rng.choice([-2.5, 2.5], np.count_nonzero(far))
    noise[:, [0, 1, 3, 4, 5]] /= 0.4
    found = validate(calibrated(rig, np.eye(6), 1e-5), rig, replace(log, raw=clean.raw + noise))
    assert found.axes["fz"].nis == pytest.approx(0.16 * 6 / 7 + 2.5**2 / 7, abs=0.25)
    (reason,) = found.verdict.reasons
    assert "% of the residuals of fz lie within 95 % limits" in reason
    assert [name for name, axis in found.axes.items() if not axis.keep] == ["fz"]


def test_calibration_that_is_not_usable_stays_so_whatever_the_residuals() -> None:
    rig, rng = rig_of(), np.random.default_rng(0)
    gain = gain_of(rng)
    spoilt = replace(calibrated(rig, gain), verdict=Verdict(False, ("the estimate did not converge",)))
    found = validate(spoilt, rig, log_of(rig, gain))
    assert all(axis.keep for axis in found.axes.values())
    assert found.verdict.reasons == (
        "the calibration itself is not to be used as it stands: the estimate did not converge",
    )


def test_filtered_sensor_is_not_white() -> None:
    rig, rng = rig_of(), np.random.default_rng(4)
    gain = gain_of(rng)
    log = log_of(rig, gain)
    clean = log_of(rig_of(sensor={"noise": [1e-9] * 6}), gain)  # the same offset: drawn from the same seed
    noise = log.raw - clean.raw
    for k in range(1, len(noise)):
        noise[k] = 0.6 * noise[k - 1] + 0.8 * noise[k]  # the same variance, correlated
    found = validate(calibrated(rig, gain), rig, replace(log, raw=clean.raw + noise))
    assert sum("is not white" in reason for reason in found.verdict.reasons) == 6
    assert not any("larger" in reason for reason in found.verdict.reasons)


def test_constant_and_clock_of_a_log_are_its_own() -> None:
    rig, rng = rig_of(sensor={"time_offset_prior": 5e-3}), np.random.default_rng(5)
    gain = gain_of(rng)
    log = log_of(rig, gain, offset=[30.0] * 6, time_offset=4e-3)
    found = validate(calibrated(rig, gain), rig, log)
    assert found.verdict.usable, found.verdict.reasons
    assert found.time_offsets[0] == pytest.approx(4e-3, abs=3e-4)


def test_another_payload_speaks_with_its_own_uncertainty() -> None:
    rig, rng = rig_of(), np.random.default_rng(6)
    gain = gain_of(rng)
    stated = rig.to_mapping()
    stated["payloads"]["other"]["mass"] = 20.4  # 2% more than simulated
    calibration = calibrated(rig, gain, 1e-4)
    log = log_of(rig, gain, payload_name="other")
    exact = validate(calibration, Rig.from_mapping(stated), log)
    assert not exact.payload_seen
    assert any("larger" in reason for reason in exact.verdict.reasons)
    stated["payloads"]["other"]["uncertainty"] = {"mass": 0.02, "center_of_mass": 0, "inertia": 0}
    known = validate(calibration, Rig.from_mapping(stated), log)
    assert known.verdict.usable, known.verdict.reasons


@pytest.mark.parametrize("of", ["com", "sensor"])
def test_an_uncertain_centre_of_mass_leaves_the_logged_point_where_it_is(of: str) -> None:
    """The columns of a payload beside differences of a wrench that is not ours."""
    settings = rig_of(motion={"noise": [2e-4] * 6, "of": of}).to_mapping()
    settings["payloads"]["other"]["uncertainty"] = {"mass": 0, "center_of_mass": 5e-3, "inertia": 0}
    rig = Rig.from_mapping(settings)
    gain = gain_of(np.random.default_rng(6))
    log = log_of(rig, gain, payload_name="other")
    found = residuals(calibrated(rig, gain, 1e-4), rig, log)
    spec = rig.payloads["other"]
    point = spec.center_of_mass_array if of == "com" else np.zeros(3)
    twist = log.twist[found.rows]
    acceleration = np.gradient(log.twist, log.time, axis=0)[found.rows]
    for axis in range(3):
        step = 5e-3 * np.eye(3)[axis]
        high, low = (
            wrench_on_sensor(
                Body(spec.mass, spec.center_of_mass_array + sign * step, spec.inertia_matrix),
                point, twist, acceleration, np.zeros((len(twist), 3)),
            )
            for sign in (1.0, -1.0)
        )  # fmt: skip
        expected = (high - low) / 2.0
        column = 5e-3 * found.by_payload[:, :, 1 + axis]
        expected -= expected.mean(axis=0) - column.mean(axis=0)
        assert np.abs(np.abs(column) - np.abs(expected)).max() < 0.05 * np.abs(expected).max()


@pytest.mark.parametrize("of", ["com", "sensor"])
def test_claimed_variance_of_the_inertial_wrench_is_that_of_its_error(of: str) -> None:
    rig = rig_of(motion={"noise": [1e-3] * 6, "of": of}, gravity=[0, 0, -9.81])
    spec = rig.payloads["default"]
    body = Body(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)
    point = body.center_of_mass if of == "com" else np.zeros(3)
    normalised = []
    for seed in range(4):
        run = simulate(rig, seed=seed)
        (chunk,) = InertialMotion(rig, run.log).wrench(0.0, 20)
        assert run.log.gravity is not None
        t = run.log.time[chunk.rows]
        truth = wrench_on_sensor(
            body, point, run.trajectory.twist(t), run.trajectory.acceleration(t), run.log.gravity[chunk.rows]
        )
        normalised.append((chunk.wrench - truth) ** 2 / chunk.variance)
        np.testing.assert_allclose(chunk.covariance[:, 0], chunk.variance[chunk.lagged], rtol=1e-9)
        np.testing.assert_allclose(
            chunk.rate[20:-20],
            np.gradient(chunk.wrench, t, axis=0)[20:-20],
            atol=0.05 * np.abs(chunk.rate).max(),
        )
    assert np.mean(normalised, axis=(0, 1)) == pytest.approx(np.ones(6), abs=0.4)


def test_held_out_rows_are_blocks_of_time_and_every_row_is_in_one_part() -> None:
    rig = rig_of(plan={"duration": 60})
    log = simulate(rig).log
    (kept,), (out,) = held_out([log], fraction=0.2)
    assert np.array_equal(np.sort(np.concatenate([kept.time_ns, out.time_ns])), log.time_ns)
    assert len(out.time_ns) == pytest.approx(0.2 * len(log.time_ns), rel=0.01)
    assert np.count_nonzero(np.diff(out.time_ns) > 20_000_000) == 3  # four blocks
    short = simulate(rig_of(plan={"duration": 5})).log
    assert held_out([short], fraction=0.2) == ([short], [])
    with pytest.raises(InputError, match="fraction"):
        held_out([log], fraction=1.5)


def test_logs_that_were_calibrated_with_are_not_held_out() -> None:
    rig, gain = rig_of(), np.eye(6)
    log = replace(log_of(rig, gain), sha256="ab")
    report = LogReport(None, "ab", "default", np.zeros(6), np.ones(6))
    found = validate(replace(calibrated(rig, gain), logs=(report,)), rig, log)
    assert not found.held_out
    assert not any(axis.held_out for axis in found.improvement.values())


def test_what_cannot_be_compared_is_refused() -> None:
    rig = rig_of()
    calibration = calibrated(rig, np.eye(6))
    log = log_of(rig, np.eye(6))
    with pytest.raises(InputError, match="feels"):
        validate(calibration, rig_of(sensor={"feels": "sensor_on_payload"}), log)
    with pytest.raises(InputError, match="no twist"):
        validate(calibration, rig, replace(log, twist=None))
    silent, short = log.raw.copy(), log.raw.copy()
    silent[:, 2], short[20:] = np.nan, np.nan
    for raw, message in ((silent, "column `raw_2`: found not one number"), (short, "no stretch")):
        with pytest.raises(InputError, match=message):
            validate(calibration, rig, replace(log, raw=raw))
    with pytest.raises(InputError, match="no log"):
        validate(calibration, rig, [])
    flat = validate(replace(calibration, inverse=np.full((6, 6), np.nan)), rig, log)
    assert flat.verdict.reasons == ("the gain of the calibration has no inverse",)


def test_a_cell_that_is_no_sample_of_a_channel_is_left_out() -> None:
    rig, gain = rig_of(), gain_of(np.random.default_rng(3))
    log = log_of(rig, gain)
    raw = log.raw.copy()
    raw[np.flatnonzero(np.isfinite(raw[:, 0]))[200], 0] = 65535.0
    found = validate(calibrated(rig, gain), rig, replace(log, raw=raw))
    assert found.verdict.usable, found.verdict.reasons


@pytest.mark.parametrize("name", ["raw", "twist"])
def test_numbers_that_cannot_be_counted_with_are_named(name: str) -> None:
    rig, gain = rig_of(), gain_of(np.random.default_rng(3))
    log = log_of(rig, gain)
    huge = replace(log, **{name: 1e200 * getattr(log, name)})
    with pytest.raises(InputError, match=f"{name}: found .*, expected numbers of at most 1e\\+100"):
        validate(calibrated(rig, gain), rig, huge)


def test_known_wrenches_need_no_payload() -> None:
    """A calibration by motion is judged by a rig that states none."""
    gain = gain_of(np.random.default_rng(3))
    settings = rig_of().to_mapping() | {"reference_noise": (1e-3 * SPAN).tolist()}
    rig = Rig.from_mapping({key: value for key, value in settings.items() if key != "payloads"})
    rng = np.random.default_rng(4)
    w = 0.3 * SPAN * rng.standard_normal((400, 6))
    raw = w @ gain.T + rng.standard_normal((400, 6)) * rig.sensor.noise_array
    reference = w + 1e-3 * SPAN * rng.standard_normal((400, 6))
    log = Log(None, "default", "", np.arange(400) * 10**7, raw, reference=reference)
    found = validate(calibrated(rig_of(), gain), rig, log)
    assert found.verdict.usable, found.verdict.reasons
    assert not found.payload_seen


def test_two_logs_are_pooled_and_the_result_is_written(good: Validation, tmp_path: Path) -> None:
    rig, rng = rig_of(), np.random.default_rng(7)
    gain = gain_of(rng)
    logs = [log_of(rig, gain, seed) for seed in (1, 2)]
    found = tw.validate(calibrated(rig, gain), rig, logs)
    assert isinstance(found, tw.Validation)
    assert found.samples > 1.5 * good.samples
    found.write_yaml(tmp_path / "validation.yaml")
    written = yaml.safe_load((tmp_path / "validation.yaml").read_text())
    assert written["format"] == "truewrench-validation/1"
    assert written["verdict"] == {"usable": True, "reasons": []}
    assert list(written["axes"]) == list(AXES)
    assert written["axes"]["fx"]["better"] is True
    assert len(written["logs"]) == 2
