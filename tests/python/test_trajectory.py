"""Claims about the motions: [A00] 12-17 and what the open-loop wrench design does to a free body."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from truewrench.model.motion.trajectory import (
    Body,
    HarmonicTwist,
    SplineTwist,
    WrenchMotion,
    WrenchSinusoids,
    attitude,
    excitation_alpha,
    integrate_wrench,
    rotation_matrix,
)

TABLE_1 = Body(50.0, np.array([0.2, 0.0, 0.0]), np.diag([1.5, 1.5, 0.4]))


@pytest.fixture(scope="module")
def spin_up() -> WrenchMotion:
    wrench = WrenchSinusoids.of([10, 10, 10], [2, 2, 2], [3, 5, 7], 10.0)
    return integrate_wrench(wrench, TABLE_1, 10.0)


def rnea(body: Body, twist: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Wrench of the payload on the sensor by Pinocchio, for twists of the centre of mass; no gravity."""
    model = pin.Model()
    model.gravity.linear[:] = 0.0
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "sensor")
    model.appendBodyToJoint(
        joint, pin.Inertia(body.mass, body.center_of_mass, body.inertia), pin.SE3.Identity()
    )
    data = model.createData()

    def at_sensor(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[:3] + np.cross(body.center_of_mass, x[3:]), x[3:]])

    q = pin.neutral(model)
    return np.array(
        [
            -pin.rnea(model, data, q, at_sensor(n), at_sensor(a))
            for n, a in zip(twist, acceleration, strict=True)
        ]
    )


def test_wrench_sinusoids_excite_all_six_axes_evenly() -> None:
    wrench = WrenchSinusoids.of([10, 20, 30], [1, 2, 3], [3, 5, 7], 8.0)
    time = np.linspace(0.0, 8.0, 4001)
    w = wrench.wrench(time)
    integral = np.trapezoid(w[:, :, None] * w[:, None, :], time, axis=0)
    size = np.array([10.0, 20.0, 30.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(integral, 4.0 * np.diag(size**2), atol=1e-9)  # [A00] 14: tau / 2
    assert excitation_alpha(time, w) == pytest.approx(4.0 * 1.0**2)


def test_equal_frequencies_are_refused() -> None:
    with pytest.raises(ValueError, match="distinct"):
        WrenchSinusoids.of([1, 1, 1], [1, 1, 1], [3, 3, 7], 10.0)


def test_motion_under_wrench_is_inverted_by_pinocchio_rnea(spin_up: WrenchMotion) -> None:
    time = np.linspace(0.0, 10.0, 201)
    wrench = rnea(TABLE_1, spin_up.twist(time), spin_up.acceleration(time))
    np.testing.assert_allclose(wrench, spin_up.wrench.wrench(time), atol=1e-10)


def test_motion_under_wrench_has_its_acceleration_as_derivative(spin_up: WrenchMotion) -> None:
    time, h = np.linspace(0.1, 9.9, 50), 1e-4
    slope = (spin_up.twist(time + h) - spin_up.twist(time - h)) / (2 * h)
    np.testing.assert_allclose(slope, spin_up.acceleration(time), atol=1e-6)


def test_open_loop_wrench_spins_the_payload_up_and_carries_it_away(spin_up: WrenchMotion) -> None:
    time = np.linspace(0.0, 10.0, 2001)
    position, quaternion = spin_up.pose(time)
    sensor = position - rotation_matrix(quaternion) @ TABLE_1.center_of_mass
    assert 4.0 < np.linalg.norm(spin_up.twist(time)[:, 3:], axis=1).max() < 4.5
    assert np.linalg.norm(sensor - sensor[0], axis=1).max() == pytest.approx(4.60, abs=0.01)


def test_free_body_conserves_momentum_in_the_inertial_frame() -> None:
    none = WrenchSinusoids.of([0, 0, 0], [0, 0, 0], [1, 2, 3], 5.0)
    motion = integrate_wrench(none, TABLE_1, 5.0, np.array([0.1, -0.2, 0.3, 1.0, -2.0, 0.5]))
    time = np.linspace(0.0, 5.0, 40)
    position, quaternion = motion.pose(time)
    r = rotation_matrix(quaternion)
    twist = motion.twist(time)
    linear = np.einsum("nij,nj->ni", r, twist[:, :3])
    angular = np.einsum("nij,jk,nk->ni", r, TABLE_1.inertia, twist[:, 3:])
    np.testing.assert_allclose(linear, np.tile([0.1, -0.2, 0.3], (40, 1)), atol=1e-9)
    np.testing.assert_allclose(angular, np.tile([1.5, -3.0, 0.2], (40, 1)), atol=1e-9)
    np.testing.assert_allclose(position, time[:, None] * linear, atol=1e-9)


def test_attitude_of_a_constant_rate_is_the_exponential_map() -> None:
    omega = np.array([0.0, 0.0, 0.0, 0.4, -0.3, 0.2])
    quarter = np.full((1, 6), 0.25)  # a sine of frequency 0 and phase pi/2 is constant
    motion = HarmonicTwist(omega[None, :], 0.0 * quarter, 2 * np.pi * quarter, 3.0)
    time = np.array([0.0, 0.7, 3.0])
    expected = np.array([pin.exp3(omega[3:] * t) for t in time])
    np.testing.assert_allclose(attitude(motion, time), expected, atol=1e-10)


def test_attitude_of_a_fast_motion_is_that_of_tiny_steps() -> None:
    rng = np.random.default_rng(4)
    frequency, phase = rng.uniform(1.0, 10.0, (6, 6)), rng.uniform(0.0, 6.0, (6, 6))
    motion = HarmonicTwist(6.0 * rng.normal(size=(6, 6)), frequency, phase, 1.0)
    h = 2e-5
    R = [np.eye(3)]
    for omega in motion.twist(h * (np.arange(50_000) + 0.5))[:, 3:]:
        R.append(R[-1] @ pin.exp3(h * omega))
    time = np.array([1.0, 0.0, 0.37])
    np.testing.assert_allclose(attitude(motion, time), [R[50_000], R[0], R[18_500]], atol=1e-7)


def test_harmonic_twist_has_its_acceleration_as_derivative() -> None:
    rng = np.random.default_rng(0)
    motion = HarmonicTwist(
        rng.normal(size=(3, 6)), rng.uniform(0.1, 2, (3, 6)), rng.uniform(0, 6, (3, 6)), 4.0
    )
    time, h = np.linspace(0.0, 4.0, 30), 1e-6
    slope = (motion.twist(time + h) - motion.twist(time - h)) / (2 * h)
    np.testing.assert_allclose(slope, motion.acceleration(time), atol=1e-7)


def test_planned_twist_passes_through_its_rows() -> None:
    time = 3.0 + np.arange(0.0, 4.0, 0.025)
    twist = np.sin(2 * np.pi * 0.5 * time)[:, None] * np.arange(1.0, 7.0)
    motion = SplineTwist.through(time, twist)
    assert motion.duration == pytest.approx(3.975)
    np.testing.assert_allclose(motion.twist(time - 3.0), twist, atol=1e-12)
    slope = np.pi * np.cos(2 * np.pi * 0.5 * time)[:, None] * np.arange(1.0, 7.0)
    np.testing.assert_allclose(motion.acceleration(time - 3.0), slope, atol=1e-4)
