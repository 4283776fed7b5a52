"""The Cramer-Rao bound of an unknown tool at its truth, priors included, without a line of the core.

Readings are those of the benchmark's own Newton and Euler, differentiated by central differences; the twist
of a motion is a spline whose coefficients are inferred together with theta and eliminated (Schur complement);
the offset's walk is integrated out at its true rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix, hstack, identity, kron, vstack
from scipy.sparse.linalg import splu

from truewrench.model.rig import Rig
from truewrench.tool.parameters import Layout

Array = NDArray[np.float64]
Readings = Callable[[Array, Array, Array], Array]
"""Channels (N, n) of theta, a twist and its derivative (N, 6), at fixed attitudes."""

DEGREE = 5
SPACING = 0.05  # [s] of the knots that stand for the motion
STEP = 1e-4  # of a parameter's prior sigma, or of itself


@dataclass(frozen=True)
class Truth:
    """What one log was made with.

    Attributes:
        readings: its channels.
        time: (N,) [s].
        twist: (N, 6) the true one.
        rate: (N, 6) its derivative.
        walk: rate of the offset's walk, fraction of range per sqrt(s).
        repeatability: of a pose, fraction of range.
        moving: whether the twist is measured with noise; poses stand still, and it is known.
    """

    readings: Readings
    time: Array
    twist: Array
    rate: Array
    walk: float
    repeatability: float
    moving: bool


def bound(rig: Rig, prior: Array, theta: Array, logs: list[Truth]) -> Array:
    """Covariance of theta (p, p) that no unbiased estimate is below; offsets are those of the last log.

    Args:
        rig: noise and ranges.
        prior: (p, p) covariance of theta beforehand.
        theta: the true one, with the offset of the last log.
        logs: offsets of the others have the same prior, and are eliminated.
    """
    layout, n = Layout(rig.sensor.n), rig.sensor.n
    place = np.arange(layout.offset.start, layout.offset.stop)
    scale = np.sqrt(np.diag(prior))
    information = np.linalg.inv(prior / np.outer(scale, scale))
    for log in logs:
        one = _moving(rig, log, theta, scale) if log.moving else _still(rig, log, theta, scale)
        if log is not logs[-1]:
            other = one[np.ix_(place, place)] + np.eye(n)
            one -= one[:, place] @ np.linalg.solve(other, one[place])
        information += one
    return np.asarray(np.linalg.inv(information) * np.outer(scale, scale))


def _by_theta(log: Truth, theta: Array, scale: Array) -> Array:
    """(N, n, p) in units of the prior's sigma."""
    columns = []
    for k, size in enumerate(scale):
        step = np.zeros(theta.size)
        step[k] = STEP * size
        ends = [log.readings(theta + s * step, log.twist, log.rate) for s in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * STEP))
    return np.stack(columns, axis=-1)


def _still(rig: Rig, log: Truth, theta: Array, scale: Array) -> Array:
    J, away = _by_theta(log, theta, scale), log.time[-1] - log.time
    K, out = np.minimum(away[:, None], away), np.zeros((theta.size, theta.size))
    for i, (size, noise) in enumerate(zip(rig.sensor.channel_scale, rig.sensor.noise_array, strict=True)):
        V = (log.walk * size) ** 2 * K
        V[np.diag_indices_from(V)] += noise**2 + (log.repeatability * size) ** 2
        out += J[:, i].T @ cho_solve(cho_factor(V), J[:, i])
    return out


def _moving(rig: Rig, log: Truth, theta: Array, scale: Array) -> Array:
    time, noise = log.time, rig.sensor.noise_array
    intervals = max(1, round((time[-1] - time[0]) / SPACING))
    knots = time[0] + (time[-1] - time[0]) / intervals * np.arange(-DEGREE, intervals + DEGREE + 1)
    spline = BSpline(knots, np.eye(intervals + DEGREE), DEGREE)
    basis, slope = csr_matrix(spline(time)), csr_matrix(spline.derivative()(time))
    by_twist, by_rate = (np.empty((time.size, len(noise), 6)) for _ in range(2))
    for c, e in enumerate(0.5 * np.eye(6)):  # quadratic in the twist, linear in its derivative: exact
        by_twist[:, :, c] = log.readings(theta, log.twist + e, log.rate) - log.readings(
            theta, log.twist - e, log.rate
        )
        by_rate[:, :, c] = log.readings(theta, log.twist, log.rate + e) - log.readings(
            theta, log.twist, log.rate - e
        )
    rows = [
        hstack(
            [
                basis.multiply(by_twist[:, i, [c]] / noise[i]) + slope.multiply(by_rate[:, i, [c]] / noise[i])
                for c in range(6)
            ]
        )
        for i in range(len(noise))
    ]
    measured = kron(identity(6), basis).multiply(np.repeat(1.0 / rig.motion.noise_array, time.size)[:, None])
    of_motion = vstack([*rows, measured]).tocsc()
    J = _by_theta(log, theta, scale) / noise[:, None]
    of_theta = np.concatenate(
        [J.transpose(1, 0, 2).reshape(-1, theta.size), np.zeros((6 * time.size, theta.size))]
    )
    cross = of_motion.T @ of_theta
    return np.asarray(of_theta.T @ of_theta - cross.T @ splu((of_motion.T @ of_motion).tocsc()).solve(cross))
