"""A calibration is judged by what an IMU at the sensor reads: neither velocity nor gravity is needed."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tool_cases import a_rig, newton_euler, swing_log

import truewrench as tw
from truewrench.estimation.inertial import InertialMotion
from truewrench.judging.validation.residuals import residuals
from truewrench.model.calibration import AXES, Calibration
from truewrench.model.log import Log
from truewrench.model.rig import Rig

MASS, CENTER, INERTIA = 3.0, np.array([0.02, -0.01, 0.1]), np.diag([0.03, 0.028, 0.02])
BIAS = np.array([0.1, -0.1, 0.1, 0.01, -0.01, 0.01])  # 2 sigma of what an IMU may be off by


@pytest.fixture(scope="module")
def rig() -> Rig:
    settings: dict[str, Any] = a_rig(
        motion={"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}, required=0.5
    )
    inertia = dict(zip(("xx", "yy", "zz"), np.diag(INERTIA).tolist(), strict=True))
    settings["payloads"] = {"tool": {"mass": MASS, "center_of_mass": CENTER.tolist(), "inertia": inertia}}
    return Rig.from_mapping(settings)


def log_of(rig: Rig, seed: int, seconds: float = 12.0) -> Log:
    return swing_log(rig, MASS, CENTER, INERTIA, seconds=seconds, seed=seed)


@pytest.fixture(scope="module")
def calibration(rig: Rig) -> Calibration:
    return tw.calibrate(rig, log_of(rig, 1, 30.0))


def test_part_of_the_record_is_held_out(calibration: Calibration) -> None:
    assert calibration.verdict.usable
    assert all(calibration.improvement[name].held_out for name in AXES)
    nis = calibration.figures["held_out"]["nis"]
    assert np.array([nis[name] for name in AXES]) == pytest.approx(np.ones(6), abs=0.25)


def test_a_sound_gain_passes_whatever_the_biases(rig: Rig, calibration: Calibration) -> None:
    for seed in range(2, 6):
        log = log_of(rig, seed)
        assert log.specific_force is not None
        assert log.angular_velocity is not None
        biased = replace(
            log,
            specific_force=log.specific_force + BIAS[:3],
            angular_velocity=log.angular_velocity + BIAS[3:],
        )
        for one in (log, biased):
            found = tw.validate(calibration, rig, one)
            assert found.verdict.usable, found.verdict.reasons
            assert found.held_out
            assert found.tilts == (0.0,)


def test_an_axis_that_is_off_by_three_per_cent_is_told(rig: Rig, calibration: Calibration) -> None:
    for axis, name in enumerate(AXES[:3]):
        gain = calibration.gain.copy()
        gain[axis] *= 1.03
        off = replace(calibration, gain=gain, inverse=np.linalg.inv(gain))
        found = tw.validate(off, rig, log_of(rig, 7))
        assert not found.verdict.usable
        assert not found.axes[name].keep


def test_claimed_variance_of_the_wrench_is_that_of_its_error(rig: Rig) -> None:
    """Against Newton-Euler of the noise-free motion, of an IMU without biases."""
    normalised = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t = np.arange(1000) / 100.0
        phase, w = rng.uniform(0.0, 6.3, 6), 2.0 * np.pi * rng.uniform(0.3, 0.8, 6)
        nu, a = np.sin(w * t[:, None] + phase), w * np.cos(w * t[:, None] + phase)
        fall = np.tile([0.0, 0.0, -9.81], (len(t), 1))  # of some attitude: the specific force holds it
        truth = rig.sensor.sign * newton_euler(MASS, CENTER, INERTIA, nu, a, fall)
        force = a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - fall
        log = Log(
            None, "tool", "", (t * 1e9).astype(np.int64), truth,
            specific_force=force + rng.normal(size=force.shape) * 1e-2,
            angular_velocity=nu[:, 3:] + rng.normal(size=force.shape) * 1e-3,
        )  # fmt: skip
        (chunk,) = InertialMotion(rig, log).wrench(0.0, 20)
        normalised.append((chunk.wrench - truth[chunk.rows]) ** 2 / chunk.variance)
        np.testing.assert_allclose(chunk.covariance[:, 0], chunk.variance[chunk.lagged], rtol=1e-9)
    assert np.mean(normalised, axis=(0, 1)) == pytest.approx(np.ones(6), abs=0.3)


def test_a_gyroscope_may_be_biased_as_far_as_its_prior_says(rig: Rig, calibration: Calibration) -> None:
    log = log_of(rig, 9)
    assert log.angular_velocity is not None
    turned = replace(log, angular_velocity=log.angular_velocity + np.array([0.3, -0.2, 0.2]))

    def rms(one: Log, prior: float) -> float:
        stated = rig.model_copy(update={"motion": rig.motion.model_copy(update={"gyro_bias_prior": prior})})
        new = residuals(calibration, stated, one).new / rig.sensor.noise_array
        return float(np.sqrt(np.mean(new**2)))

    as_read = rms(log, 0.0)
    assert rms(turned, 0.0) > 1.5 * as_read
    assert rms(turned, 1.0) == pytest.approx(as_read, rel=0.02)


def test_accelerometer_and_gyroscope_may_have_rows_of_their_own(rig: Rig, calibration: Calibration) -> None:
    log = log_of(rig, 10, 16.0)
    assert log.specific_force is not None
    assert log.angular_velocity is not None
    force, omega = log.specific_force.copy(), log.angular_velocity.copy()
    force[::2], omega[1::2] = np.nan, np.nan
    omega[600:700] = np.nan  # and gaps
    found = tw.validate(calibration, rig, replace(log, specific_force=force, angular_velocity=omega))
    assert found.verdict.usable, found.verdict.reasons
    assert found.samples > 500
    assert np.mean([axis.nis for axis in found.axes.values()]) == pytest.approx(1.0, abs=0.1)


def test_a_log_without_the_columns_is_refused(rig: Rig, calibration: Calibration) -> None:
    bare = replace(log_of(rig, 2), specific_force=None, angular_velocity=None)
    with pytest.raises(tw.InputError, match="accel_x accel_y accel_z wx wy wz"):
        tw.validate(calibration, rig, bare)
