"""Bodies as ten numbers: one made of several, what it weighs, and its nearest physical one."""

from collections.abc import Callable
from typing import Any

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.motion.spatial import cross, cross_matrix
from truewrench.tool.parameters import COLUMNS, ROWS, channel_turn, symmetric

_THINNEST = 1e-8  # [m^2] of second moments: simulators refuse a body without any
_UNIT = np.array([symmetric(element) for element in np.eye(6)])
_CLOSE = 1e-7  # of a squared distance in units of sigma, and of one above 1 its share: tolerance
_STEP = 1e-30  # of the complex step


def _one(bodies: Any) -> Any:
    """(..., 10) (log m, c, S) of all bodies (..., B, 10) of the same; any number type."""
    masses = np.exp(bodies[..., 0])
    mass = masses.sum(axis=-1)[..., None]
    center = (masses[..., None] * bodies[..., 1:4]).sum(axis=-2) / mass
    away = bodies[..., 1:4] - center[..., None, :]
    moments = (masses[..., None] * (bodies[..., 4:] + away[..., ROWS] * away[..., COLUMNS])).sum(axis=-2)
    return np.concatenate([np.log(mass), center, moments / mass], axis=-1)


def _total(bodies: Any) -> Any:
    """The same as (log m, c, inertia)."""
    one = _one(bodies)
    moments = np.exp(one[..., :1]) * one[..., 4:]
    inertia = moments[..., :3].sum(axis=-1)[..., None] * (ROWS == COLUMNS) - moments
    return np.concatenate([one[..., :4], inertia], axis=-1)


def one_body(bodies: Array) -> tuple[Array, Array]:
    """One rigid body made of B, as (log m, c, S) (10,), and its derivative (10, 10 B).

    The bodies (B, 10) are log mass, centre of mass, S about it, in the order of `ELEMENTS`.
    """
    return _with_derivative(_one, bodies)


def total_body(bodies: Array) -> tuple[Array, Array]:
    """The same as (log m, c, inertia about c)."""
    return _with_derivative(_total, bodies)


def _with_derivative(of: Callable[[Any], Any], bodies: Array) -> tuple[Array, Array]:
    steps = 1j * _STEP * np.eye(bodies.size).reshape(-1, *bodies.shape)  # complex: exact to rounding
    return np.asarray(of(bodies), dtype=np.float64), of(bodies + steps).imag.T / _STEP


def inertia_std(body: Array, P: Array) -> Array:
    """1 sigma (6,) of the inertia's elements about the centre of mass, of (log m, c, S) (10,)."""
    _, J = total_body(body.reshape(1, 10))
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J[4:], P, J[4:]), 0.0)))


def weight(mass: float, center: Array, fall: Array) -> Array:
    """Wrench (T, 6) = m [g; c x g] at rest of free fall (T, 3) in sensor axes, `payload_on_sensor`."""
    out: Array = mass * np.column_stack([fall, cross(center, fall)])
    return out


def nearest_physical(body: Array, covariance: Array) -> tuple[Array, float]:
    """The body with positive second moments nearest to (10,) (log m, c, S), and its squared distance.

    Nearest in the metric of the covariance (10, 10): where S has to give way, mass and centre of mass follow
    as far as they are correlated with it. A body is physical if and only if its pseudo-inertia is positive
    semidefinite, which for m > 0 is S >= 0.
    """
    S, P = body[4:], covariance[4:, 4:]
    values, vectors = np.linalg.eigh(symmetric(S))
    if values[0] >= _THINNEST:
        return body.copy(), 0.0
    scale = np.sqrt(np.diag(P))
    eigen, basis = np.linalg.eigh(P / np.outer(scale, scale))
    white = (basis / np.sqrt(np.maximum(eigen, 1e-9))).T / scale
    clipped = (vectors * np.maximum(values, 1e-6)) @ vectors.T
    step = _least_change(S, white, clipped[ROWS, COLUMNS]) - S
    out = body.copy()
    out[:4] += covariance[:4, 4:] @ (white.T @ (white @ step))
    out[4:] += step
    return out, float(np.sum((white @ step) ** 2))


def _least_change(S: Array, white: Array, inside: Array) -> Array:
    """Second moments (6,), none below `_THINNEST`, for which |white (x - S)| is least, from some `inside`.

    A convex problem: Newton's steps with a barrier, - mu log det (Nesterov and Nemirovskii 1994).
    """
    Q, x = white.T @ white, inside
    mu = 1.0 + 0.5 * float((x - S) @ Q @ (x - S))
    while mu > _CLOSE * max(1.0, float((x - S) @ Q @ (x - S))):
        mu *= 0.1
        for _ in range(50):
            felt = np.linalg.solve(symmetric(x) - _THINNEST * np.eye(3), _UNIT)  # (6, 3, 3)
            pull = mu * np.trace(felt, axis1=1, axis2=2) - Q @ (x - S)
            move = np.linalg.solve(Q + mu * np.einsum("kij,lji->kl", felt, felt), pull)
            decrement = np.sqrt(max(float(pull @ move), 0.0) / mu)
            x = x + move / (1.0 + decrement)
            if decrement < 0.1:
                break
    return x


def joined(
    mass: float, center: Array, inertia: Array, other_mass: float, other_center: Array
) -> tuple[float, Array, Array]:
    """A body (mass, c, inertia (3, 3) about c) with a point mass added."""
    if other_mass == 0.0:
        return mass, center, inertia
    whole = mass + other_mass
    middle: Array = (mass * center + other_mass * other_center) / whole
    out = inertia.copy()
    for m, at in ((mass, center - middle), (other_mass, other_center - middle)):
        out -= m * cross_matrix(at[None])[0] @ cross_matrix(at[None])[0]
    return whole, middle, out


def flange_body(center: Array, inertia: Array, flange: Array) -> tuple[Array, Array]:
    """Centre of mass (3,) [m] and inertia about it (3, 3) in flange axes of those in sensor axes.

    The flange (6,) is x, y, z, roll, pitch, yaw of the sensor frame on it [m, rad]; fixed axes.
    """
    R = channel_turn(flange[3:])[0].T
    return flange[:3] + R @ center, R @ inertia @ R.T


def flange_wrench(wrench: Array, flange: Array) -> Array:
    """(6,) at the flange's origin, along its axes, of a wrench (6,) at the sensor's; `flange` as above."""
    R = channel_turn(flange[3:])[0].T
    force, moment = R @ wrench[:3], R @ wrench[3:]
    return np.concatenate([force, moment + cross(flange[:3], force)])
