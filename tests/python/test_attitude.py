"""The attitude behind a log against the motion that it was simulated with."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truewrench.calibrating.pipeline import calibrate
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist, attitude
from truewrench.model.rig import Rig
from truewrench.robot.attitude import attitude_at, attitude_of, check_fall, free_fall

Array = NDArray[np.float64]

DOWN = np.array([0.0, 0.0, -9.81])
FREQUENCY = np.array([[0.5, 0.4, 0.3, 0.45, 0.6, 0.35]])
DURATION = 8.0
MOTION = HarmonicTwist(np.full((1, 6), 0.8), FREQUENCY, np.arange(6.0)[None], DURATION)


@pytest.fixture
def heavy(settings: dict[str, Any]) -> Rig:
    """A rig in gravity."""
    return Rig.from_mapping(settings | {"gravity": DOWN.tolist()})


def turned_log(start: Rotation, rate: float = 100.0) -> tuple[Log, Array]:
    """A log of the motion from some attitude, and its true R_sensor_root (N, 3, 3)."""
    time_ns = np.round(np.arange(0.0, DURATION, 1.0 / rate) * 1e9).astype(np.int64)
    time = time_ns * 1e-9
    R_root_sensor = start.as_matrix() @ attitude(MOTION, time)
    R_sensor_root = R_root_sensor.transpose(0, 2, 1)
    return (
        Log(
            None, "default", "", time_ns, np.zeros((len(time), 6)), MOTION.twist(time),
            gravity=R_sensor_root @ DOWN,
        ),
        R_sensor_root,
    )  # fmt: skip


def found(rig: Rig, log: Log) -> tuple[Array, Array]:
    told = attitude_of(rig, log)
    assert told is not None
    return told


def since_start(R_sensor_root: Array) -> Array:
    """The turn since the first row, in which no heading is left."""
    return np.asarray(R_sensor_root @ R_sensor_root[0].T)


def largest_angle(a: Array, b: Array) -> float:
    return float(Rotation.from_matrix(a @ b.transpose(0, 2, 1)).magnitude().max())


START = Rotation.from_rotvec([0.4, -1.1, 0.7])


def test_logged_quaternions_are_taken_as_they_are(heavy: Rig) -> None:
    log, truth = turned_log(START)
    quaternion = Rotation.from_matrix(truth.transpose(0, 2, 1)).as_quat()[:, [3, 0, 1, 2]]
    quaternion[1::2] *= -1.0  # the same attitude
    quaternion[7] = np.nan
    time, R = found(heavy, replace(log, attitude=quaternion, gravity=None))
    kept = np.arange(len(truth)) != 7
    np.testing.assert_array_equal(time, log.time[kept])
    np.testing.assert_allclose(R, truth[kept], atol=1e-12)
    fall = free_fall(heavy, quaternion)
    np.testing.assert_allclose(fall[kept], log.gravity[kept], atol=1e-11)
    assert np.isnan(fall[7]).all()


@pytest.mark.parametrize("start", [START, Rotation.identity(), Rotation.from_rotvec([np.pi, 0.0, 0.0])])
def test_gravity_and_angular_velocity_give_every_turn_of_the_sensor(heavy: Rig, start: Rotation) -> None:
    """At the worst beginning, gravity stands upside down in the sensor."""
    log, truth = turned_log(start)
    time, R = found(heavy, log)
    np.testing.assert_array_equal(time, log.time)
    assert largest_angle(since_start(R), since_start(truth)) < 1e-8
    np.testing.assert_allclose(
        np.einsum("kij,klj->kil", R, R), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12
    )


def test_heading_alone_is_unknown(heavy: Rig) -> None:
    """What is left between found and true attitude is one turn about the vertical."""
    log, truth = turned_log(START)
    heading = Rotation.from_matrix(truth.transpose(0, 2, 1) @ found(heavy, log)[1]).as_rotvec()
    np.testing.assert_allclose(heading, np.tile(heading[0], (len(heading), 1)), atol=1e-8)
    np.testing.assert_allclose(heading[:, :2], 0.0, atol=1e-8)


def test_gravity_stays_exact_whatever_the_gyroscope_says(heavy: Rig) -> None:
    log, _ = turned_log(START)
    assert log.twist is not None
    wrong = np.random.default_rng(1).normal(0.3, 0.1, size=log.twist.shape)
    _, R = found(heavy, replace(log, twist=log.twist + wrong))
    np.testing.assert_allclose(R @ DOWN, log.gravity, atol=1e-12)


def test_noise_of_the_rate_turns_the_heading_slowly(heavy: Rig) -> None:
    log, truth = turned_log(START)
    noise = np.zeros((len(truth), 6))
    noise[:, 3:] = np.random.default_rng(2).normal(scale=5e-3, size=(len(truth), 3))
    _, R = found(heavy, replace(log, twist=log.twist + noise))
    expected = 5e-3 * np.sqrt(DURATION / 100.0)  # a random walk
    assert largest_angle(since_start(R), since_start(truth)) < 4.0 * expected


def test_gyroscope_of_an_imu_serves_like_a_twist(heavy: Rig) -> None:
    log, _ = turned_log(START)
    assert log.twist is not None
    as_imu = replace(log, twist=None, angular_velocity=log.twist[:, 3:])
    np.testing.assert_array_equal(found(heavy, as_imu)[1], found(heavy, log)[1])


@pytest.mark.parametrize("every", [2, 25])
def test_gravity_may_have_stamps_of_its_own(heavy: Rig, every: int) -> None:
    """Rows of gravity alone between those of the twist, few of them or many."""
    log, truth = turned_log(START, 400.0)
    of_twist = np.arange(len(truth)) % 4 == 0
    of_gravity = np.arange(len(truth)) % every == 1
    assert log.twist is not None
    assert log.gravity is not None
    apart = replace(
        log,
        twist=np.where(of_twist[:, None], log.twist, np.nan),
        gravity=np.where(of_gravity[:, None], log.gravity, np.nan),
    )
    time, R = found(heavy, apart)
    np.testing.assert_array_equal(time, log.time[of_gravity])
    within = time <= log.time[of_twist][-1]
    assert largest_angle(since_start(R[within]), since_start(truth[of_gravity][within])) < 1e-8


def test_gap_of_the_rate_is_bridged_by_gravity(heavy: Rig) -> None:
    """Before and after, the turns are right; what the heading did in the gap is lost."""
    log, truth = turned_log(START)
    twist = np.array(log.twist)
    twist[300:400] = np.nan
    _, R = found(heavy, replace(log, twist=twist))
    for piece in (slice(0, 300), slice(400, None)):
        assert largest_angle(since_start(R[piece]), since_start(truth[piece])) < 1e-8
    np.testing.assert_allclose(R @ DOWN, log.gravity, atol=1e-12)


def test_poses_at_rest_need_no_rate(heavy: Rig) -> None:
    log, _ = turned_log(START, 2.0)
    _, R = found(heavy, replace(log, twist=None))
    np.testing.assert_allclose(R @ DOWN, log.gravity, atol=1e-12)


def test_nothing_tells_the_attitude_on_orbit(rig: Rig) -> None:
    log, truth = turned_log(START)
    assert attitude_of(rig, log) is None
    assert attitude_of(rig, replace(log, gravity=None)) is None
    quaternion = Rotation.from_matrix(truth.transpose(0, 2, 1)).as_quat()[:, [3, 0, 1, 2]]
    np.testing.assert_allclose(found(rig, replace(log, attitude=quaternion))[1], truth, atol=1e-12)


def test_attitude_between_rows_is_on_the_shortest_way(heavy: Rig) -> None:
    log, truth = turned_log(START)
    half = attitude_at(log.time[::2], truth[::2], log.time)
    assert largest_angle(half[:-1], truth[:-1]) < 1e-3
    np.testing.assert_allclose(half[::2], truth[::2], atol=1e-12)
    np.testing.assert_allclose(
        attitude_at(log.time, truth, np.array([-1.0, 99.0])), truth[[0, -1]], atol=1e-12
    )
    np.testing.assert_array_equal(attitude_at(log.time[:1], truth[:1], log.time[:3]), truth[[0, 0, 0]])


def test_a_rate_that_no_body_has_is_bad_input(heavy: Rig) -> None:
    log, _ = turned_log(START)
    assert log.twist is not None
    log.twist[7, 4] = 1e90
    with pytest.raises(InputError, match=r"wx wy wz: found 1e\+90 rad/s, expected an angular velocity"):
        attitude_of(heavy, log)


@pytest.mark.parametrize("size", [1.0 / 9.81, 0.9, 3.28])
def test_free_fall_of_another_size_is_bad_input(heavy: Rig, size: float) -> None:
    log, _ = turned_log(START)
    assert log.gravity is not None
    check_fall(heavy, log)
    other = replace(log, gravity=size * log.gravity)
    with pytest.raises(InputError, match=r"gx gy gz: found free fall of .* expected 9.81 m/s\^2"):
        calibrate(heavy, other)


def test_free_fall_that_an_attitude_contradicts_is_bad_input(heavy: Rig) -> None:
    log, R_sensor_root = turned_log(START)
    assert log.gravity is not None
    quaternion = Rotation.from_matrix(R_sensor_root.transpose(0, 2, 1)).as_quat()[:, [3, 0, 1, 2]]
    both = replace(log, attitude=quaternion)
    check_fall(heavy, both)
    with pytest.raises(InputError, match="found free fall 180 deg from that by qw qx qy qz"):
        check_fall(heavy, replace(both, gravity=-log.gravity))
    with pytest.raises(InputError, match=r"found free fall of 1 m/s\^2"):
        check_fall(heavy, replace(both, gravity=log.gravity / 9.81))
