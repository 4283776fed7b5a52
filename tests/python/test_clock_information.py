"""What a log tells of its time offset, and gains whose clock it does not tell."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from truewrench.estimate.clock import clock_overclaimed
from truewrench.estimate.clock_information import ClockInformation, with_untold_clock
from truewrench.estimate.windows import estimate_windows
from truewrench.log import Log
from truewrench.motion.trajectory import Body, WrenchSinusoids, integrate_wrench
from truewrench.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate

Array = NDArray[np.float64]

MASS, CENTER = 0.7, np.array([-0.012, 0.015, 0.004])
INERTIA = np.diag([1.2e-3, 0.8e-3, 0.95e-3])
RANGE = np.array([10.0] * 3 + [0.1] * 3)
NOISE = np.array([1e-3] * 3 + [1e-5] * 3)
DURATION, RATE = 4.0, 1000.0
HARMONICS = np.array([5, 7, 9])
OMEGA = 2.0 * np.pi * HARMONICS / DURATION


def rig_of(time_offset_prior: float, **sensor: Any) -> Rig:
    """A body that tumbles freely: forces are the sines of three frequencies, moments their cosines."""
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": NOISE.tolist(),
                "range": RANGE.tolist(),
                "gain_prior": 0.1,
                "offset_prior": 0,
                "time_offset_prior": time_offset_prior,
                **sensor,
            },
            "payloads": {
                "default": {
                    "mass": MASS,
                    "center_of_mass": CENTER.tolist(),
                    "inertia": dict(zip(("xx", "yy", "zz"), np.diag(INERTIA).tolist(), strict=True)),
                    "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
                }
            },
            "motion": {"source": "twist", "of": "com", "noise": [6e-4] * 6},
            "simulate": {"rate": RATE, "sensor_rate": RATE, "gain": "random", "time_offset": "random"},
        }
    )


def tumbling(rig: Rig, seed: int) -> SimulatedRun:
    sinusoids = WrenchSinusoids.of(0.3 * MASS * OMEGA, 3e-4 * OMEGA, HARMONICS, DURATION)
    return simulate(rig, integrate_wrench(sinusoids, Body(MASS, CENTER, INERTIA), DURATION), seed=seed)


def log_of(wrench: Array, gain: Array, rng: np.random.Generator) -> Log:
    time_ns = np.round(1e9 / RATE * np.arange(len(wrench))).astype(np.int64)
    raw = wrench @ gain.T + NOISE * rng.standard_normal(wrench.shape)
    return Log(None, "default", "", time_ns, raw)


def test_the_sine_and_the_cosine_of_every_frequency_tell_nothing_of_the_clock() -> None:
    found = [
        ClockInformation.of(rig_of(prior).sensor, tumbling(rig_of(prior), 0).log, np.eye(6))
        for prior in (1e-3, 5e-3)
    ]
    for information, prior in zip(found, (1e-3, 5e-3), strict=True):
        assert information is not None
        assert information.generator is not None
        frequencies = np.sort(np.abs(np.linalg.eigvals(information.generator).imag))
        np.testing.assert_allclose(frequencies, np.repeat(OMEGA, 2), rtol=0.02)
        # the prior of the gain: its elements move by 0.1 when the clock does by 0.1 / |A|
        change = np.linalg.norm(information.generator) / 0.1
        assert information.of_priors == pytest.approx(prior**-2.0 + change**2)
        assert information.of_data < information.of_priors


@pytest.mark.parametrize("channels", [6, 8])
def test_sines_alone_tell_the_clock_as_well_as_the_noise_lets_them(channels: int) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(20_000) / RATE
    omega = 2.0 * np.pi * np.array([0.4, 0.7, 1.1, 1.3, 1.7, 1.9])
    phase = rng.uniform(0.0, 2.0 * np.pi, 6)
    wrench = 0.2 * RANGE * np.sin(t[:, None] * omega + phase)
    gain = np.vstack([np.eye(6), 0.5 * np.ones((2, 6)) / RANGE])[:channels]
    noise = np.append(NOISE, [1e-3] * 2)[:channels]
    settings: dict[str, Any] = {"noise": noise.tolist()}
    if channels > 6:
        settings |= {"channels": [f"g{k}" for k in range(8)], "nominal_gain": gain.tolist()}
    sensor = rig_of(1e-2, **settings).sensor
    time_ns = np.round(1e9 * t).astype(np.int64)
    raw = wrench @ gain.T + noise * rng.standard_normal((t.size, channels))
    log = Log(None, "default", "", time_ns, raw)
    found = ClockInformation.of(sensor, log, gain)
    rate = (0.2 * RANGE * omega * np.cos(t[:, None] * omega + phase)) @ gain.T / noise
    assert found is not None
    assert found.generator is None
    assert found.of_data == pytest.approx(np.sum(rate**2), rel=0.1)


def test_a_log_at_rest_or_too_short_says_nothing() -> None:
    rng = np.random.default_rng(2)
    sensor = rig_of(1e-3).sensor
    assert ClockInformation.of(sensor, log_of(np.ones((4000, 6)), np.eye(6), rng), np.eye(6)) is None
    assert ClockInformation.of(sensor, log_of(np.ones((100, 6)), np.eye(6), rng), np.eye(6)) is None


def test_joint_posterior_is_that_of_integration_over_the_clock() -> None:
    rng = np.random.default_rng(3)
    generator = np.kron(np.diag(OMEGA), [[0.0, 1.0], [-1.0, 0.0]])
    nominal = np.eye(6)
    held = nominal + 0.03 * rng.standard_normal((6, 6))
    prior, gain_prior, sigma = 2e-3, 0.1, 1e-4
    mean, covariance = with_untold_clock(
        generator, held.ravel(), sigma**2 * np.eye(36), nominal, gain_prior, prior
    )
    tau = prior * np.linspace(-6.0, 6.0, 4001)
    gains = np.array([expm(-x * generator) @ held for x in tau])
    exponent = -0.5 * ((gains - nominal) ** 2).sum(axis=(1, 2)) / gain_prior**2 - 0.5 * (tau / prior) ** 2
    weight = np.exp(exponent - exponent.max())
    weight /= weight.sum()
    expected = weight @ tau
    spread = np.sqrt(weight @ (tau - expected) ** 2)
    assert mean[-1] == pytest.approx(expected, abs=0.05 * spread)
    assert np.sqrt(covariance[-1, -1]) == pytest.approx(spread, rel=0.03)
    along = (weight * (tau - expected)) @ (gains.reshape(-1, 36) - weight @ gains.reshape(-1, 36))
    np.testing.assert_allclose(covariance[-1, :36], along, atol=0.03 * np.abs(along).max())
    np.testing.assert_allclose(mean[:36].reshape(6, 6), expm(-mean[-1] * generator) @ held)


@pytest.mark.parametrize("method", ["online", "map"])
def test_errors_of_tumbling_bodies_are_as_large_as_they_say(method: Any) -> None:
    rig = rig_of(1e-3)
    scores, offsets = [], []
    for seed in range(12):
        simulated = tumbling(rig, seed)
        found = estimate_windows(rig, [simulated.log], method)
        assert found.clock_untold
        error = (found.gain - simulated.truth.gain).ravel()
        scores.append(error @ np.linalg.solve(found.covariance[:36, :36], error))
        offsets.append((found.time_offsets[0] - simulated.truth.time_offset) / found.time_offsets_std[0])
    assert max(scores) < 105.0  # 1e-8 of chi-square
    assert 0.75 < np.mean(scores) / 36.0 < 1.25
    assert np.max(np.abs(offsets)) < 4.0


def test_a_clock_claimed_better_than_it_can_be_known_is_refused() -> None:
    rig = rig_of(5e-3)
    simulated = tumbling(rig, 0)
    found = estimate_windows(rig, [simulated.log])
    assert clock_overclaimed(rig, [simulated.log], found) == []
    bold = replace(found, time_offsets_std=np.array([1e-4]))
    (said,) = clock_overclaimed(rig, [simulated.log], bold)
    assert "claimed to 0.1 ms" in said
    assert clock_overclaimed(rig, [simulated.log] * 2, bold) == []
