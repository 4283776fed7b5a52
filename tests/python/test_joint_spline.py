"""Splines through encoders and tachometers, against dense least squares and known motions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline

from truewrench.model.motion.joint_spline import JointSpline, fit_joints

Array = np.ndarray[Any, np.dtype[np.float64]]

SIGMA_Q, SIGMA_QD = np.array([1e-4, 3e-4]), np.array([2e-3, 1e-3])
FREQUENCY, PHASE = np.array([0.4, 0.25]), np.array([0.3, 1.1])


def swing(time: Array, order: int = 0, frequency: Array = FREQUENCY) -> Array:
    """Two joints, or a derivative of theirs."""
    omega = 2.0 * np.pi * frequency
    return 0.5 * omega**order * np.sin(omega * time[:, None] + PHASE + 0.5 * np.pi * order)


def samples(seed: int, end: float = 8.0) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Encoders at 100 Hz, tachometers at 60 Hz that begin later."""
    rng = np.random.default_rng(seed)
    time_q, time_qd = np.arange(0.0, end, 0.01), np.arange(0.4, end, 1.0 / 60.0)
    q = swing(time_q) + SIGMA_Q * rng.standard_normal((time_q.size, 2))
    qd = swing(time_qd, 1) + SIGMA_QD * rng.standard_normal((time_qd.size, 2))
    return (time_q, q, np.ones(time_q.size)), (time_qd, qd)


def test_fit_is_weighted_least_squares_of_both_streams() -> None:
    positions, velocities = samples(0)
    found = fit_joints(positions, velocities, SIGMA_Q, SIGMA_QD)
    knots = found.spline.t
    size = knots.size - 6
    basis = BSpline(knots, np.eye(size), 5)
    values, slopes = basis(positions[0]), basis(velocities[0], nu=1)
    for j in range(2):
        rows = np.vstack([values / SIGMA_Q[j], slopes / SIGMA_QD[j]])
        right = np.concatenate([positions[1][:, j] / SIGMA_Q[j], velocities[1][:, j] / SIGMA_QD[j]])
        expected = np.linalg.lstsq(rows, right)[0]
        np.testing.assert_allclose(found.spline.c[:, j], expected, atol=1e-8)


@pytest.mark.parametrize("streams", ["both", "positions", "velocities"])
def test_residuals_are_as_large_as_the_noise(streams: str) -> None:
    for seed in range(5):
        positions, velocities = samples(seed)
        if streams == "positions":
            velocities = (np.zeros(0), np.zeros((0, 2)))
        if streams == "velocities":
            positions = (np.zeros(0), np.zeros((0, 2)), np.zeros(0))
        found = fit_joints(positions, velocities, SIGMA_Q, SIGMA_QD)
        u = np.vstack(
            [
                (positions[1] - found.position(positions[0])) / SIGMA_Q,
                (velocities[1] - found.velocity(velocities[0])) / SIGMA_QD,
            ]
        )
        freedom = len(u) - len(found.spline.c)
        chi_square = np.sum(u**2, axis=0) / freedom
        np.testing.assert_allclose(chi_square, 1.0, atol=4.0 * np.sqrt(2.0 / freedom))


def test_knots_follow_the_speed_of_the_motion_and_not_of_the_samples() -> None:
    time = np.arange(0.0, 12.0, 0.01)
    rng = np.random.default_rng(3)

    def spacing(frequency: float, every: int = 1) -> float:
        t = time[::every]
        q = swing(t, frequency=np.full(2, frequency)) + 1e-4 * rng.standard_normal((t.size, 2))
        nothing = (np.zeros(0), np.zeros((0, 2)))
        return fit_joints((t, q, np.ones(t.size)), nothing, np.full(2, 1e-4), np.ones(2)).spacing

    slow, fast = spacing(0.2), spacing(0.8)
    assert 3.0 < slow / fast < 5.0
    assert spacing(0.8, every=4) == pytest.approx(fast, rel=0.4)


def test_wider_knots_are_as_much_wider() -> None:
    one, two = (fit_joints(*samples(1), SIGMA_Q, SIGMA_QD, wider=w).spacing for w in (1.0, 2.0))
    assert two == pytest.approx(2.0 * one, rel=0.06)


@pytest.mark.parametrize("factor", [0.1, 1.0 / 3.0])
def test_noise_stated_too_small_is_not_followed(factor: float) -> None:
    right = fit_joints(*samples(2), SIGMA_Q, SIGMA_QD)
    found = fit_joints(*samples(2), factor * SIGMA_Q, factor * SIGMA_QD)
    assert found.spacing == pytest.approx(right.spacing, rel=0.4)


def test_velocities_alone_are_integrated_from_zero() -> None:
    time = np.arange(0.0, 6.0, 0.01)
    nothing = (np.zeros(0), np.zeros((0, 2)), np.zeros(0))
    found = fit_joints(nothing, (time, swing(time, 1)), np.ones(2), SIGMA_QD)
    np.testing.assert_allclose(found.position(time[:1]), 0.0, atol=1e-9)
    start = swing(time[:1])
    moved = found.shifted(start[0])
    assert isinstance(moved, JointSpline)
    np.testing.assert_allclose(moved.position(time), swing(time), atol=3e-4)
    np.testing.assert_allclose(moved.velocity(time), found.velocity(time), atol=1e-12)
    np.testing.assert_allclose(moved.acceleration(time), found.acceleration(time), atol=1e-10)


def test_samples_without_weight_do_not_pull() -> None:
    (time, q, weight), velocities = samples(4)
    spoilt, light = q.copy(), weight.copy()
    spoilt[300:330] += 0.05
    light[300:330] = 1e-6
    found = fit_joints((time, spoilt, light), velocities, SIGMA_Q, SIGMA_QD)
    np.testing.assert_allclose(found.position(time), swing(time), atol=5e-4)
