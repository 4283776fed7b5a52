"""The Cramer-Rao bound with all common parameters, for records of any length, without a line of the core.

As bound_oracle.py, with the payload and the clock uncertain as well, and with sums over samples replaced by
Gauss-Legendre integrals where a knot interval holds many samples: the cost does not grow with the rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from truewrench.model.motion.trajectory import Trajectory, attitude
from truewrench.model.rig import PayloadSpec, Rig

Array = NDArray[np.float64]

DEGREE = 5
ACTIVE = DEGREE + 1
CHUNK = 512  # knot intervals at a time
INERTIA = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def newton_euler(
    mass: Array | float, center: Array, inertia: Array, point: Array, nu: Array, a: Array, g: Array
) -> Array:
    """Wrench (N, 6) on the sensor at its origin, for the twist and its derivative (N, 6) of a body point."""
    v, omega, alpha = nu[:, :3], nu[:, 3:], a[:, 3:]
    r = center - point
    force = mass * (
        a[:, :3] + np.cross(omega, v) + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)) - g
    )
    moment = np.cross(center, force) + alpha @ inertia + np.cross(omega, omega @ inertia)
    return -np.hstack([force, moment])


@dataclass(frozen=True)
class _Body:
    """A payload as it is stated, and departures from it (10,)."""

    spec: PayloadSpec
    point: Array

    def wrench(self, nu: Array, a: Array, g: Array, departure: Array | None = None) -> Array:
        d = np.zeros(10) if departure is None else departure
        inertia = self.spec.inertia_matrix.copy()
        root = np.sqrt(np.diag(inertia))
        for k, (i, j) in enumerate(INERTIA):
            inertia[i, j] += d[4 + k] * root[i] * root[j]
            inertia[j, i] = inertia[i, j]
        mass, center = self.spec.mass * (1.0 + d[0]), self.spec.center_of_mass_array + d[1:4]
        return newton_euler(mass, center, inertia, self.point, nu, a, g)


@dataclass(frozen=True)
class Linearised:
    """What wrench and motion streams say about splines of d motion coordinates, near the truth.

    Attributes:
        precision: (3, d) of the measured coordinates, of their first and of their second derivatives: one
            over the variance of a sample of the motion's stream, 0 where there is none.
        at: normalised wrench (N, 6) with the rig's sign at times (N,), its derivatives by the coordinates and
            by their first two derivatives (3, N, 6, d), by the payload (N, 6, 10) and by time (N, 6).
    """

    precision: Array
    at: Callable[[Array], tuple[Array, Array, Array, Array]]


def bound(
    rig: Rig, trajectory: Trajectory, gain: Array, spacing: float, *, time_offset: float = 0.0
) -> Array:
    """Covariance (6n, 6n) that no estimator of the normalised gains can beat, the rig's priors included.

    The payload is taken where it is stated: its departure changes the bound to second order only.

    Args:
        rig: a twist rig with one payload; rates, noise, priors and uncertainties are its own.
        trajectory: the true motion of the logged point.
        gain: the true gain (n, 6), SI.
        spacing: of the knots that stand for the motion [s].
        time_offset: the true one.
    """
    spec = next(iter(rig.payloads.values()))
    body = _Body(spec, spec.center_of_mass_array if rig.motion.of == "com" else np.zeros(3))

    def at(t: Array) -> tuple[Array, Array, Array, Array]:
        w, by_nu, by_a, by_payload, by_time = _wrench(rig, body, trajectory, t)
        return w, np.stack([by_nu, by_a, np.zeros_like(by_nu)]), by_payload, by_time

    precision = np.zeros((3, 6))
    precision[0] = rig.motion.noise_array**-2.0
    return bound_of(rig, Linearised(precision, at), gain, trajectory.duration, spacing)


def bound_of(rig: Rig, linear: Linearised, gain: Array, duration: float, spacing: float) -> Array:
    """The same for any coordinates of the motion."""
    sensor = rig.sensor
    n, span, scale = sensor.n, sensor.range_array, sensor.channel_scale
    spec = next(iter(rig.payloads.values()))
    intervals = max(1, round(duration / spacing))
    h = duration / intervals
    d = linear.precision.shape[1]
    width = d * ACTIVE
    offset = bool(sensor.offset_prior_array.any())
    clock, payload = sensor.time_offset_prior > 0.0, not spec.exact
    size = 6 * n + n + 10 + 1
    band = np.zeros((width, d * (intervals + DEGREE)))
    cross = np.zeros((band.shape[1], size))
    known = np.zeros((size, size))
    normalised = gain * span / scale[:, None]
    weight = normalised * (scale / sensor.noise_array)[:, None]
    for first in range(0, intervals, CHUNK):
        chunk = np.arange(first, min(first + CHUNK, intervals))
        block = _motion_information(linear.precision, h, rig.simulate.rate, len(chunk))
        at, share, bases = _nodes(chunk, h, rig.simulate.sensor_rate)
        w, by_motion, by_payload, by_time = linear.at(at.ravel())
        by_x = np.einsum("oqm,okqpc->kqpmc", bases, by_motion.reshape(3, *at.shape, 6, d))
        root = np.sqrt(share)[None, :, None, None]
        J = root * np.einsum("ip,kqpb->kqib", weight, by_x.reshape(*at.shape, 6, width))
        J = J.reshape(len(chunk), -1, width)
        block = block + np.swapaxes(J, 1, 2) @ J
        T = np.zeros((*at.shape, n, size))
        for i in range(n):
            precision = scale[i] / sensor.noise_array[i]
            T[:, :, i, 6 * i : 6 * i + 6] = precision * w.reshape(*at.shape, 6)
            T[:, :, i, 6 * n + i] = precision
        T[..., 7 * n : 7 * n + 10] = np.einsum("ip,kqpd->kqid", weight, by_payload.reshape(*at.shape, 6, 10))
        T[..., 7 * n + 10] = np.einsum("ip,kqp->kqi", weight, by_time.reshape(*at.shape, 6))
        T = (root * T).reshape(len(chunk), -1, size)
        known += np.einsum("kra,krb->ab", T, T, optimize=True)
        mixed = np.swapaxes(J, 1, 2) @ T  # (k, width, size)
        for m in range(ACTIVE):
            rows = (d * (chunk[:, None] + m) + np.arange(d)).ravel()
            cross[rows] += mixed[:, d * m : d * m + d].reshape(-1, size)
        for row in range(width):
            for column in range(row + 1):
                band[row - column, d * chunk + column] += block[:, row, column]
    factor = cholesky_banded(band, lower=True)
    information = known - cross.T @ cho_solve_banded((factor, True), cross)
    u = spec.uncertainty
    prior = np.concatenate(
        [
            np.full(6 * n, sensor.gain_prior),
            sensor.offset_prior_array / scale,
            [u.mass] + [u.center_of_mass] * 3 + [u.inertia] * 6,
            [sensor.time_offset_prior],
        ]
    )
    kept = np.concatenate(
        [np.ones(6 * n, bool), np.full(n, offset), np.full(10, payload), np.full(1, clock)]
    ) & (prior > 0.0)
    information = information[np.ix_(kept, kept)] + np.diag(prior[kept] ** -2.0)
    unit = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(unit, unit)) / np.outer(unit, unit)
    return np.asarray(covariance[: 6 * n, : 6 * n])


def rms(covariance: Array) -> float:
    """RMS of the 1 sigma of the gains."""
    return float(np.sqrt(np.mean(np.diag(covariance))))


def _nodes(chunk: NDArray[np.int64], h: float, rate: float) -> tuple[Array, Array, Array]:
    """Times (k, q), samples that each stands for (q,), active splines and two derivatives there (3, q, 6)."""
    x, weights = np.polynomial.legendre.leggauss(ACTIVE)  # exact for products of two splines
    local = 0.5 * h * (x + 1.0)
    knots = h * np.arange(-DEGREE, DEGREE + 2)
    bases = np.empty((3, ACTIVE, ACTIVE))
    for m in range(ACTIVE):
        piece = BSpline.basis_element(knots[m : m + DEGREE + 2], extrapolate=False)
        for order in range(3):
            bases[order, :, m] = piece(local, nu=order)
    return chunk[:, None] * h + local, 0.5 * weights * h * rate, bases


def _motion_information(precision: Array, h: float, rate: float, count: int) -> Array:
    _, share, bases = _nodes(np.zeros(1, dtype=np.int64), h, rate)
    one = sum(
        np.kron((basis * share[:, None]).T @ basis, np.diag(of_order))
        for basis, of_order in zip(bases, precision, strict=True)
    )
    return np.broadcast_to(np.asarray(one), (count, *np.shape(one)))


def _wrench(
    rig: Rig, body: _Body, trajectory: Trajectory, t: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Normalised wrench (N, 6), and by twist, acceleration, payload and time, with the rig's sign."""
    unit = rig.sensor.sign / rig.sensor.range_array
    nu, a = trajectory.twist(t), trajectory.acceleration(t)
    g = np.zeros((t.size, 3))
    if rig.in_gravity:
        g = np.asarray(rig.gravity_array @ attitude(trajectory, t))
    w = body.wrench(nu, a, g)
    by_nu, by_a = np.empty((t.size, 6, 6)), np.empty((t.size, 6, 6))
    by_payload = np.empty((t.size, 6, 10))
    # quadratic in the twist and in the centre of mass, linear in the rest: differences are exact
    for c, e in enumerate(np.eye(6)):
        by_nu[:, :, c] = 0.5 * (body.wrench(nu + e, a, g) - body.wrench(nu - e, a, g))
        by_a[:, :, c] = body.wrench(nu, a + e, g) - w
    for c, e in enumerate(1e-2 * np.eye(10)):
        by_payload[:, :, c] = 50.0 * (body.wrench(nu, a, g, e) - body.wrench(nu, a, g, -e))
    e = 1e-4  # [s]
    later, sooner = t + e, np.maximum(t - e, 0.0)
    by_time = np.einsum(
        "nij,nj->ni", by_a, (trajectory.acceleration(later) - trajectory.acceleration(sooner))
    )
    by_time = by_time / (later - sooner)[:, None] + np.einsum("nij,nj->ni", by_nu, a)
    if rig.in_gravity:  # gdot = -Omega x g
        by_time += np.hstack(_by_gravity(body, np.cross(-nu[:, 3:], g)))
    return w * unit, by_nu * unit[:, None], by_a * unit[:, None], by_payload * unit[:, None], by_time * unit


def _by_gravity(body: _Body, rate: Array) -> tuple[Array, Array]:
    force = body.spec.mass * rate
    return force, np.cross(body.spec.center_of_mass_array, force)
