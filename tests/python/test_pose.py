"""Claims about what a motion can hide: forces that follow the pose, and delays."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

from truewrench._core import pose_share, with_pose
from truewrench.estimation.pose import blind_to, delay_share

Array = NDArray[np.float64]

MASS, CENTER, INERTIA = 50.0, np.array([0.2, 0.0, 0.0]), np.diag([1.5, 1.5, 0.4])
RANGE = np.array([500.0] * 3 + [50.0] * 3)
TIME = np.arange(800) / 100
FREQUENCIES = np.array([0.15, 0.3, 0.45, 0.65, 0.85, 1.1])


def felt(twist: Array, acceleration: Array) -> Array:
    """Wrench over the range of a free body whose centre of mass moves so."""
    v, w, a, alpha = twist[:, :3], twist[:, 3:], acceleration[:, :3], acceleration[:, 3:]
    force = -MASS * (a + np.cross(w, v))
    about_center = alpha @ INERTIA + np.cross(w, w @ INERTIA)
    return np.hstack([force, np.cross(CENTER, force) - about_center]) / RANGE


def sines(amplitude: Array, frequency: Array, phase: Array) -> tuple[Array, Array]:
    """Twist (N, 6) and its derivative of sums of sines (K, 6)."""
    rate = 2 * np.pi * frequency
    angle = rate * TIME[:, None, None] + phase
    return (amplitude * np.sin(angle)).sum(axis=1), (amplitude * rate * np.cos(angle)).sum(axis=1)


def motion(seed: int, *, several: bool) -> tuple[Array, Array]:
    """Twist and normalised wrench: six frequencies on every axis, or one on each."""
    rng = np.random.default_rng(seed)
    if several:
        frequency, size = np.tile(FREQUENCIES[:, None], 6), 0.25 * rng.uniform(0.2, 0.7, (6, 6))
    else:
        frequency = rng.permutation(FREQUENCIES)[None]
        size = 0.25 * np.sqrt(6) * rng.uniform(0.3, 0.6, (1, 6))
    twist, acceleration = sines(size, frequency, rng.uniform(0, 2 * np.pi, size.shape))
    return twist, felt(twist, acceleration)


def integral(twist: Array) -> Array:
    """Pose by Simpson's rule, component by component."""
    return cumulative_simpson(twist, x=TIME, axis=0, initial=0.0)


def placed(twist: Array) -> Array:
    """Place and vector part of the turn in the axes of the mean attitude: sums of small steps."""
    places, turns = [np.zeros(3)], [Rotation.identity()]
    for before, after in pairwise(twist):
        turns.append(turns[-1] * Rotation.from_rotvec(0.005 * (before + after)[3:]))
        places.append(places[-1] + 0.005 * (turns[-2].apply(before[:3]) + turns[-1].apply(after[:3])))
    turned = Rotation.concatenate(turns)
    mean = turned.mean().inv()
    from_mean = (mean * turned).as_quat()
    return np.hstack([mean.apply(np.array(places)), 2 * from_mean[:, :3] * from_mean[:, 3:]])


def dense_share(pose: Array, wrench: Array) -> float:
    """Mean R^2 by ordinary least squares of the components of a pose."""
    columns = np.column_stack([wrench, np.ones(len(wrench))])
    found = []
    for x in pose.T:
        rest = x - columns @ np.linalg.lstsq(columns, x, rcond=None)[0]
        found.append(1.0 - np.sum(rest**2) / np.sum((x - x.mean()) ** 2))
    return float(np.mean(found))


@pytest.mark.parametrize("several", [False, True])
def test_share_of_the_pose_is_that_of_ordinary_regressions(several: bool) -> None:
    twist, wrench = motion(3, several=several)
    found = pose_share(TIME, twist, wrench)
    assert pytest.approx(dense_share(integral(twist), wrench), abs=2e-3) == found.A
    np.testing.assert_allclose(found.ww, wrench.T @ wrench / len(wrench), rtol=1e-12)


def test_one_frequency_an_axis_hides_its_pose_and_six_do_not() -> None:
    for seed in range(6):
        assert pose_share(TIME, *motion(seed, several=False)).A > 0.97
        assert 0.25 < pose_share(TIME, *motion(seed, several=True)).A < 0.55


def test_share_does_not_depend_on_units_or_on_where_the_body_began() -> None:
    twist, wrench = motion(1, several=True)
    found = pose_share(TIME, twist, wrench)
    scaled = pose_share(
        TIME, twist * np.array([1000.0] * 3 + [57.3 / 60] * 3), wrench * np.arange(1, 7) + 3.0
    )
    assert pytest.approx(found.A, rel=1e-9) == scaled.A


def test_components_that_do_not_move_are_left_out() -> None:
    twist, wrench = motion(1, several=True)
    twist[:, 4] = 0.0
    expected = dense_share(np.delete(integral(twist), 4, axis=1), wrench)
    assert pytest.approx(expected, abs=2e-3) == pose_share(TIME, twist, wrench).A


def test_at_rest_the_pose_is_the_wrench() -> None:
    assert pose_share(TIME, np.zeros((TIME.size, 6)), np.ones((TIME.size, 6))).A == 1.0


@pytest.mark.parametrize("size", [3.0, 6.0, 12.0])
def test_pose_of_a_body_that_turns_far_is_its_place_and_its_turn(size: float) -> None:
    twist, wrench = motion(4, several=True)
    twist[:, 3:] *= size
    expected = dense_share(placed(twist), wrench)
    assert pytest.approx(expected, abs=1e-9) == pose_share(TIME, twist, wrench).A
    # by components it would be another
    assert abs(dense_share(integral(twist), wrench) - expected) > 0.01


def test_small_turns_have_the_same_share_by_either_pose() -> None:
    twist, wrench = motion(4, several=True)
    twist[:, 3:] *= 0.01
    arm = pose_share(TIME, twist, wrench, arm=True).A
    assert arm == pytest.approx(dense_share(placed(twist), wrench), abs=1e-9)
    assert arm == pytest.approx(pose_share(TIME, twist, wrench).A, abs=0.01)


# -- what it would move ----------------------------------------------------------------------------------


def test_force_that_follows_the_pose_moves_the_gain_by_what_is_said() -> None:
    """Cables of random stiffness, RMS 0.1 % of range in every channel, regressed as a calibration would."""
    twist, wrench = motion(5, several=True)
    found = pose_share(TIME, twist, wrench)
    effect = blind_to(found, delay_share(TIME, wrench))[0].effect
    pose = integral(twist)
    pose = (pose - pose.mean(axis=0)) / pose.std(axis=0)
    columns = np.column_stack([wrench, np.ones(TIME.size)])
    rng, moved = np.random.default_rng(0), []
    for _ in range(2000):
        force = pose @ rng.standard_normal(6)
        moved.append(np.linalg.lstsq(columns, 1e-3 * force / force.std(), rcond=None)[0][:6])
    largest = np.sqrt(np.mean(np.square(moved), axis=0)).max()
    assert 0.4 < largest / effect < 1.6  # A, a mean over components, stands for all of them


def test_a_force_moves_it_no_further_than_what_is_known_beforehand() -> None:
    twist, wrench = motion(5, several=True)
    pose, delay = pose_share(TIME, twist, wrench), delay_share(TIME, wrench)
    ceiling = 0.5 * blind_to(pose, delay)[0].effect
    assert blind_to(pose, delay, ceiling=ceiling)[0].effect == ceiling


def test_force_and_moment_in_quadrature_hide_a_delay() -> None:
    """The paper's wrench: f sine and n cosine of one frequency, so that dw/dt is another wrench."""
    k = 2 * np.pi * np.array([3, 5, 7]) / 8
    size = np.array([0.02, 0.03, 0.04])
    wrench = np.hstack([size * np.sin(k * TIME[:, None]), 2 * size * np.cos(k * TIME[:, None])])
    found = delay_share(TIME, wrench)
    assert found.share > 0.99
    pose = pose_share(TIME, np.gradient(wrench, TIME, axis=0), wrench)
    entry = next(e for e in blind_to(pose, found) if e.kind == "delay")
    # -m dw/dt: of the force by the moment k / 2 a second, of the moment by the force 2 k
    assert entry.effect == pytest.approx(1e-3 * 2 * k[2], rel=0.02)
    assert "leave no trace" in entry.words


def test_a_delay_that_the_data_show_is_not_named() -> None:
    t = TIME[:, None]
    wrench = 0.1 * np.sin(2 * np.pi * np.array([0.3, 0.51, 0.69, 0.39, 0.6, 0.87]) * t + np.arange(6))
    found = delay_share(TIME, wrench)
    assert found.share < 0.2
    pose = pose_share(TIME, wrench, wrench)
    assert [entry.kind for entry in blind_to(pose, found)] == ["cable"]


def test_delay_of_a_sensor_moves_the_gain_with_it() -> None:
    k = 2 * np.pi * np.array([3, 5, 7]) / 8
    wrench = 0.1 * np.hstack([np.sin(k * TIME[:, None]), np.cos(k * TIME[:, None])])
    pose, delay = pose_share(TIME, wrench, wrench), delay_share(TIME, wrench)
    gain = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 3.0])
    assert blind_to(pose, delay, gain=gain)[1].effect == pytest.approx(3 * blind_to(pose, delay)[1].effect)


# -- in the covariance -----------------------------------------------------------------------------------


def test_what_follows_the_pose_raises_no_variance_above_its_prior_and_narrows_nothing() -> None:
    twist, wrench = motion(0, several=False)
    pose = pose_share(TIME, twist, wrench)
    root = 1e-2 * np.random.default_rng(0).standard_normal((36, 36))
    covariance, prior = root @ root.T, np.full(36, 0.09)
    wider = with_pose(covariance, prior, pose, np.full(6, 0.05**2))
    assert (np.diag(wider) <= 0.09 + 1e-12).all()
    assert np.diag(wider).max() == pytest.approx(0.09)
    assert np.linalg.eigvalsh(wider - covariance)[0] > -1e-12


def test_where_nothing_follows_the_pose_the_covariance_stands() -> None:
    pose = pose_share(TIME, *motion(0, several=True))
    covariance = 1e-4 * np.eye(36)
    np.testing.assert_array_equal(with_pose(covariance, np.full(36, 0.09), pose, np.zeros(6)), covariance)


def test_added_variance_is_that_of_the_equation() -> None:
    pose = pose_share(TIME, *motion(0, several=True))
    size = 1e-4 * np.arange(1, 7)
    added = with_pose(np.zeros((36, 36)), np.full(36, 1.0), pose, size**2)
    for i in range(6):
        row = size[i] ** 2 * pose.A / (1 - pose.A) * np.linalg.inv(pose.ww) / 6
        np.testing.assert_allclose(added[6 * i : 6 * i + 6, 6 * i : 6 * i + 6], row, rtol=1e-6)
