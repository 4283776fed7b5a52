"""The recipe in use for unknown tools: exact gain, one offset a log, ten linear parameters, formal sigma."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.tool.motion import measured_motions, regressor
from truewrench.tool.parameters import symmetric

Array = NDArray[np.float64]
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Mass, mass times centre of mass, inertia at the sensor, offset of the last log, as wrenches (16,).

    Attributes:
        rig: its nominal gain is believed.
        x: (16,).
        P: (16, 16), formal.
    """

    rig: Rig
    x: Array
    P: Array

    def contact(self, raw: Array, nu: Array, a: Array, gravity: Array) -> tuple[Array, Array]:
        """Wrench (N, 6) that the tool does not account for, and its covariance (N, 6, 6)."""
        left, A = self._left(raw, nu, a, gravity)
        return left, A @ self.P @ A.transpose(0, 2, 1) + self._noise()

    def tared(self, raw: Array, nu: Array, a: Array, gravity: Array) -> tuple[Array, Array]:
        """The same of all rows but the first, less that of the first."""
        left, A = self._left(raw, nu, a, gravity)
        by = A[1:] - A[:1]
        return left[1:] - left[:1], by @ self.P @ by.transpose(0, 2, 1) + 2.0 * self._noise()

    def _left(self, raw: Array, nu: Array, a: Array, gravity: Array) -> tuple[Array, Array]:
        back, sign = np.linalg.pinv(self.rig.sensor.nominal_gain_array), self.rig.sensor.sign
        A = np.concatenate([regressor(nu, a, gravity), np.tile(np.eye(6), (len(raw), 1, 1))], axis=2)
        return sign * (sign * raw @ back.T - A @ self.x), A

    def _noise(self) -> Array:
        back = np.linalg.pinv(self.rig.sensor.nominal_gain_array)
        return np.asarray((back * self.rig.sensor.noise_array**2) @ back.T)

    def contact_of(self, log: Log) -> tuple[Array, Array]:
        """`contact` of the rows of a log whose motion is known; velocities are differentiated."""
        parts = [self.contact(log.raw[rows], nu, a, g) for rows, nu, a, g in _measured(self.rig, log)]
        wrenches, covariances = zip(*parts, strict=True)
        return np.concatenate(wrenches), np.concatenate(covariances)

    def body(self) -> tuple[Array, Array]:
        """Mass, centre of mass, inertia about it, offset (16,), and their 1 sigma."""
        scale = np.maximum(np.abs(self.x), 1e-3)
        by = np.column_stack(
            [
                (_body(self.x + STEP * s * e) - _body(self.x - STEP * s * e)) / (2.0 * STEP * s)
                for s, e in zip(scale, np.eye(16), strict=True)
            ]
        )
        return _body(self.x), np.sqrt(np.diag(by @ self.P @ by.T))


def fitted(rig: Rig, logs: Sequence[Log], *, moving: bool) -> Fitted:
    """Least squares.

    Args:
        rig: its nominal gain is believed.
        logs: rows at rest, or motions whose velocities are differentiated; each has an offset of its own.
        moving: whether inertia is asked for; else it is 0.
    """
    back = np.linalg.pinv(rig.sensor.nominal_gain_array)
    noise = np.sqrt((back**2) @ rig.sensor.noise_array**2)
    A, y = [], []
    for k, log in enumerate(reversed(logs)):
        for rows, nu, a, g in _measured(rig, log):
            know = np.isfinite(log.raw[rows]).all(axis=1)
            offset = np.zeros((int(know.sum()), 6, 6 * len(logs)))
            offset[:, :, 6 * k : 6 * k + 6] = np.eye(6)
            A.append(np.concatenate([regressor(nu[know], a[know], g[know]), offset], axis=2) / noise[:, None])
            y.append(rig.sensor.sign * log.raw[rows][know] @ back.T / noise)
    size = 10 + 6 * len(logs)
    rows, read = np.concatenate(A).reshape(-1, size), np.concatenate(y).ravel()
    kept = np.r_[0:size] if moving else np.r_[0:4, 10:size]
    x, P = np.zeros(size), np.zeros((size, size))
    x[kept] = np.linalg.lstsq(rows[:, kept], read, rcond=None)[0]
    left = read - rows @ x
    information = rows[:, kept].T @ rows[:, kept]
    P[np.ix_(kept, kept)] = np.linalg.pinv(information) * (left @ left / max(1, read.size - kept.size))
    return Fitted(rig, x[:16], P[:16, :16])


def recipe(rig: Rig, logs: Sequence[Log], *, moving: bool) -> tuple[Array, Array]:
    """Mass, centre of mass, inertia about it, last offset of the wrench (16,), and their formal 1 sigma.

    The arguments are those of `fitted`; where inertia is not asked for its place holds NaN.
    """
    out, sigma = fitted(rig, logs, moving=moving).body()
    if not moving:
        out[4:10] = sigma[4:10] = np.nan
    return out, sigma


def _measured(rig: Rig, log: Log) -> list[tuple[NDArray[np.int64], Array, Array, Array]]:
    at_rest = log.twist is not None and not np.nan_to_num(log.twist).any()
    return [_still(log)] if at_rest else list(measured_motions(rig, log))


def _still(log: Log) -> tuple[NDArray[np.int64], Array, Array, Array]:
    assert log.gravity is not None
    nothing = np.zeros((len(log.raw), 6))
    return np.arange(len(log.raw)), nothing, nothing, log.gravity


def _body(x: Array) -> Array:
    mass, center = x[0], x[1:4] / x[0]
    about = symmetric(x[4:10]) - mass * (center @ center * np.eye(3) - np.outer(center, center))
    return np.concatenate([[mass], center, [about[i, j] for i, j in PAIRS], x[10:16]])
