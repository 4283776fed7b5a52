"""The wrench of a moving payload and its Jacobians, against independent mechanics."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from truewrench import _core

Array = NDArray[np.float64]


def random_payload(rng: np.random.Generator) -> _core.Payload:
    """Any centre of mass, and the inertia of four random point masses about it."""
    points, masses = rng.normal(size=(4, 3)), rng.uniform(0.1, 10.0, 4)
    points -= masses @ points / masses.sum()
    payload = _core.Payload()
    payload.mass = masses.sum()
    payload.center_of_mass = rng.normal(size=3)
    payload.inertia = sum(
        m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True)
    )
    return payload


def table_1(c: float = 0.2) -> _core.Payload:
    """The payload of Table 1 of [A00]."""
    payload = _core.Payload()
    payload.mass = 50.0
    payload.center_of_mass = np.array([c, 0.0, 0.0])
    payload.inertia = np.diag([1.5, 1.5, 0.4])
    return payload


def rnea(payload: _core.Payload, nu: Array, a: Array, gravity: Array) -> Array:
    """What Pinocchio says a free-flying body needs at the sensor origin, turned into its reaction."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    inertia = pin.Inertia(payload.mass, payload.center_of_mass, payload.inertia)
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.gravity.linear[:] = gravity
    at_sensor = pin.SE3(np.eye(3), -payload.center_of_mass)  # from the centre of mass to the sensor
    v = at_sensor.actInv(pin.Motion(nu)).vector
    vdot = at_sensor.actInv(pin.Motion(a)).vector
    return -pin.rnea(model, model.createData(), pin.neutral(model), v, vdot)


def test_wrench_matches_pinocchio_rnea_on_random_motions_payloads_and_gravities() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10_000):
        payload = random_payload(rng)
        nu, a, gravity = (
            rng.normal(size=(1, 6)) * 3,
            rng.normal(size=(1, 6)) * 5,
            rng.normal(size=(1, 3)) * 10,
        )
        expected = rnea(payload, nu[0], a[0], gravity[0])
        found = _core.payload_wrench(payload, nu, a, gravity)[0]
        assert np.linalg.norm(found - expected) <= 1e-12 * np.linalg.norm(expected)


def test_every_row_of_a_record_is_computed_alone() -> None:
    rng = np.random.default_rng(2)
    payload = random_payload(rng)
    nu, a, gravity = rng.normal(size=(50, 6)), rng.normal(size=(50, 6)), rng.normal(size=(50, 3))
    together = _core.payload_wrench(payload, nu, a, gravity)
    alone = [
        _core.payload_wrench(payload, nu[i : i + 1], a[i : i + 1], gravity[i : i + 1])[0] for i in range(50)
    ]
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("seed", range(20))
def test_jacobians_match_central_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    payload = random_payload(rng)
    nu, a, gravity = rng.normal(size=6), rng.normal(size=6), rng.normal(size=3) * 10
    by_a, by_nu = (j[0] for j in _core.payload_jacobians(payload, nu[None]))
    step = 1e-5
    for k in range(6):
        d = step * np.eye(6)[k]
        for jacobian, plus, minus in (
            (by_a, (nu, a + d), (nu, a - d)),
            (by_nu, (nu + d, a), (nu - d, a)),
        ):
            up, down = (
                _core.payload_wrench(payload, x[None], y[None], gravity[None])[0] for x, y in (plus, minus)
            )
            np.testing.assert_allclose(
                (up - down) / (2 * step), jacobian[:, k], rtol=0, atol=1e-6 * np.abs(jacobian).max()
            )


def test_jacobians_are_the_matrices_printed_in_the_paper() -> None:
    c, m = 0.2, 50.0
    ixx, iyy, izz = 1.5, 1.5, 0.4
    vx, vy, vz, ox, oy, oz = 0.3, -0.7, 1.1, 0.9, -1.3, 0.5
    by_a, by_nu = (j[0] for j in _core.payload_jacobians(table_1(c), np.array([[vx, vy, vz, ox, oy, oz]])))
    px, py, pz = (iyy - izz) / m, (izz - ixx) / m, (ixx - iyy) / m
    # [A00] 24, written out row by row
    printed_by_a = [
        [-m, 0, 0, 0, 0, 0],
        [0, -m, 0, 0, 0, 0],
        [0, 0, -m, 0, 0, 0],
        [0, 0, 0, -ixx, 0, 0],
        [0, 0, m * c, 0, -iyy, 0],
        [0, -m * c, 0, 0, 0, -izz],
    ]
    printed_by_nu = [
        [0, m * oz, -m * oy, 0, -m * vz, m * vy],
        [-m * oz, 0, m * ox, m * vz, 0, -m * vx],
        [m * oy, -m * ox, 0, -m * vy, m * vx, 0],
        [0, 0, 0, 0, m * px * oz, m * px * oy],
        [-m * c * oy, m * c * ox, 0, m * (c * vy + py * oz), -m * c * vx, m * py * ox],
        [-m * c * oz, 0, m * c * ox, m * (c * vz + pz * oy), m * pz * ox, -m * c * vx],
    ]
    np.testing.assert_allclose(by_a, printed_by_a, rtol=0, atol=1e-13)
    np.testing.assert_allclose(by_nu, printed_by_nu, rtol=0, atol=1e-13)


def test_a_payload_at_rest_weighs_on_the_sensor() -> None:
    # Reaction of a body hanging at rest: m g downwards, and the moment c x m g.
    payload = table_1()
    zero = np.zeros((1, 6))
    found = _core.payload_wrench(payload, zero, zero, np.array([[0.0, 0.0, -9.81]]))[0]
    np.testing.assert_allclose(found, [0, 0, -50 * 9.81, 0, 0.2 * 50 * 9.81, 0], atol=1e-12)


def test_wrong_shapes_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="gravity: expected 2 x 3, found 1 x 3"):
        _core.payload_wrench(table_1(), np.zeros((2, 6)), np.zeros((2, 6)), np.zeros((1, 3)))
