"""The generalised inverse of a gain and how well it is posed."""

import numpy as np
import pytest

from truewrench import _core


@pytest.mark.parametrize("n", [6, 7, 12, 32])
def test_inverse_is_the_weighted_least_squares_solution(n: int) -> None:
    rng = np.random.default_rng(n)
    gain, noise = rng.normal(size=(n, 6)), rng.uniform(0.1, 3.0, n)
    raw = rng.normal(size=n)
    expected = np.linalg.lstsq(gain / noise[:, None], raw / noise, rcond=None)[0]
    np.testing.assert_allclose(_core.generalised_inverse(gain, noise) @ raw, expected, rtol=1e-10, atol=1e-12)


def test_inverse_survives_units_that_normal_equations_would_not() -> None:
    # Columns 1e7 apart: the square of the condition number is beyond double precision.
    rng = np.random.default_rng(3)
    gain = rng.normal(size=(8, 6)) * np.array([1, 1, 1, 1e7, 1e7, 1e7])
    inverse = _core.generalised_inverse(gain, np.ones(8))
    np.testing.assert_allclose(inverse @ gain, np.eye(6), atol=1e-6)
    np.testing.assert_allclose((inverse @ gain)[:3, :3], np.eye(3), atol=1e-12)


def test_no_unbiased_inverse_has_a_smaller_variance() -> None:
    rng = np.random.default_rng(4)
    gain, noise = rng.normal(size=(9, 6)), rng.uniform(0.1, 3.0, 9)
    best = _core.generalised_inverse(gain, noise)
    null = np.linalg.svd(gain.T)[2][6:]  # rows orthogonal to the columns of the gain
    for _ in range(20):
        other = best + 0.1 * rng.normal(size=(6, 3)) @ null
        np.testing.assert_allclose(other @ gain, np.eye(6), atol=1e-10)
        assert np.all(((other * noise) ** 2).sum(1) >= ((best * noise) ** 2).sum(1))


def test_singular_gain_is_refused() -> None:
    gain = np.eye(6)
    gain[5] = gain[4]
    with pytest.raises(ValueError, match="cannot be inverted"):
        _core.generalised_inverse(gain, np.ones(6))
    assert _core.conditioning(gain, np.ones(6), np.eye(6), np.ones(6)).condition_number > 1e15


def test_norm_condition_of_the_paper_is_counted_in_ranges() -> None:
    span = np.array([500.0, 500, 500, 50, 50, 50])
    gain = np.eye(6)
    gain[3, 0] = 0.05  # full force reads as half of full moment
    found = _core.conditioning(gain, np.ones(6), np.eye(6), span)
    assert found.departure_norm == pytest.approx(0.5)
    assert found.departure_below_one
    gain[3, 0] = 0.2
    found = _core.conditioning(gain, np.ones(6), np.eye(6), span)
    assert found.departure_norm == pytest.approx(2.0)
    assert not found.departure_below_one


def test_condition_number_does_not_depend_on_the_raw_unit() -> None:
    rng = np.random.default_rng(5)
    span = np.array([500.0, 500, 500, 50, 50, 50])
    nominal = np.eye(6)
    gain = nominal + 0.1 * rng.normal(size=(6, 6)) * span[:, None] / span
    reference = np.linalg.cond(gain * span / span[:, None])
    volts = rng.uniform(1e-6, 1e3, 6)[:, None]
    for unit in (np.ones((6, 1)), volts):
        found = _core.conditioning(gain * unit, np.ones(6), nominal * unit, span)
        assert found.condition_number == pytest.approx(reference, rel=1e-9)
        assert found.departure_norm == pytest.approx(
            np.linalg.norm(gain * span / span[:, None] - np.eye(6), 2), rel=1e-9
        )
