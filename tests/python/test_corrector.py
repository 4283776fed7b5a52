"""Raw channels to the true wrench with its uncertainty."""

import numpy as np
import pytest

from truewrench import _core


def random_calibration(
    rng: np.random.Generator, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    gain = np.vstack([np.eye(6), rng.normal(size=(n - 6, 6))]) + 0.2 * rng.normal(size=(n, 6))
    root = 1e-3 * rng.normal(size=(7 * n, 7 * n))
    return gain, rng.normal(size=n), rng.uniform(0.01, 0.1, n), root @ root.T


@pytest.mark.parametrize("n", [6, 9])
def test_wrench_is_recovered_from_what_the_sensor_reads(n: int) -> None:
    rng = np.random.default_rng(n)
    gain, offset, noise, covariance = random_calibration(rng, n)
    wrench = rng.normal(size=(100, 6)) * 10
    found, _ = _core.Corrector(gain, offset, noise, covariance).correct(wrench @ gain.T + offset)
    np.testing.assert_allclose(found, wrench, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("n", [6, 9])
def test_covariance_is_that_of_the_linearised_error(n: int) -> None:
    # d(wrench) = G^+ (e - [dG, db] [w; 1]), written out with Kronecker products.
    rng = np.random.default_rng(10 + n)
    gain, offset, noise, covariance = random_calibration(rng, n)
    corrector = _core.Corrector(gain, offset, noise, covariance)
    wrench = rng.normal(size=(5, 6)) * 3
    _, std = corrector.correct(wrench @ gain.T + offset)
    weighted = gain / noise[:, None]
    inverse = np.linalg.solve(weighted.T @ weighted, weighted.T) / noise
    for w, sigma in zip(wrench, std, strict=True):
        jacobian = np.hstack([np.kron(np.eye(n), w), np.eye(n)])
        expected = inverse @ (np.diag(noise**2) + jacobian @ covariance @ jacobian.T) @ inverse.T
        np.testing.assert_allclose(corrector.covariance(w), expected, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(sigma, np.sqrt(np.diag(expected)), rtol=1e-9)


def test_sigma_is_the_scatter_over_calibrations_and_noise() -> None:
    rng = np.random.default_rng(7)
    gain, offset, noise, covariance = random_calibration(rng, 6)
    wrench = np.array([5.0, -3, 8, 1, 2, -4])
    errors = []
    for departure in rng.multivariate_normal(np.zeros(42), covariance, 20_000):
        believed, zero = gain + departure[:36].reshape(6, 6), offset + departure[36:]
        raw = gain @ wrench + offset + noise * rng.normal(size=6)
        errors.append(np.linalg.solve(believed, raw - zero) - wrench)
    _, std = _core.Corrector(gain, offset, noise, covariance).correct((gain @ wrench + offset)[None])
    np.testing.assert_allclose(np.std(errors, axis=0), std[0], rtol=0.03)


def test_sigma_contains_what_channels_depart_from_linear_and_a_slow_disturbance() -> None:
    rng = np.random.default_rng(9)
    gain, offset, noise, covariance = random_calibration(rng, 8)
    bent, slow = 0.01 * rng.random(8), rng.random(8)
    wrench = np.array([5.0, -3, 8, 1, 2, -4])
    weighted = gain / noise[:, None]
    inverse = np.linalg.solve(weighted.T @ weighted, weighted.T) / noise  # d has no part in the weights
    J = np.hstack([np.kron(np.eye(8), wrench), np.eye(8)])
    beside = noise**2 + slow**2 + (bent * (gain @ wrench) ** 2) ** 2
    expected = inverse @ (np.diag(beside) + J @ covariance @ J.T) @ inverse.T
    corrector = _core.Corrector(gain, offset, noise, covariance, bent, slow)
    _, std = corrector.correct((gain @ wrench + offset)[None])
    np.testing.assert_allclose(std[0], np.sqrt(np.diag(expected)), rtol=1e-9)
    np.testing.assert_allclose(corrector.covariance(wrench), expected, rtol=1e-9, atol=1e-12)


def test_missing_channel_leaves_no_wrench() -> None:
    rng = np.random.default_rng(8)
    corrector = _core.Corrector(*random_calibration(rng, 6))
    raw = rng.normal(size=(3, 6))
    raw[1, 2] = np.nan
    wrench, std = corrector.correct(raw)
    assert np.isnan(wrench[1]).all()
    assert np.isnan(std[1]).all()
    assert np.isfinite(wrench[[0, 2]]).all()


def test_unusable_calibrations_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot be inverted"):
        _core.Corrector(np.ones((6, 6)), np.zeros(6), np.ones(6), np.zeros((42, 42)))
    with pytest.raises(ValueError, match="array lengths disagree"):
        _core.Corrector(np.eye(6), np.zeros(6), np.ones(6), np.zeros((36, 36)))


def test_without_a_calibration_nothing_is_corrected() -> None:
    corrector = _core.Corrector()
    assert corrector.status == _core.Status.not_configured
    assert corrector.status.words == "there is no calibration"
    with pytest.raises(ValueError, match="there is no calibration"):
        corrector.correct(np.zeros((3, 6)))
    with pytest.raises(ValueError, match="there is no calibration"):
        corrector.covariance(np.zeros(6))


@pytest.mark.parametrize("n", [6, 9])
def test_corrector_with_a_calibration_says_so(n: int) -> None:
    corrector = _core.Corrector(*random_calibration(np.random.default_rng(n), n))
    assert corrector.status == _core.Status.ok
