"""The recipe in use for unknown tools: exact gain, one offset a log, ten linear parameters, formal sigma."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.tool.motion import measured_motions, regressor
from truewrench.tool.parameters import symmetric

Array = NDArray[np.float64]
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
STEP = 1e-6


def recipe(rig: Rig, logs: Sequence[Log], *, moving: bool) -> tuple[Array, Array]:
    """Mass, centre of mass, inertia about it, last offset of the wrench (16,), and their formal 1 sigma.

    Args:
        rig: its nominal gain is believed.
        logs: rows at rest, or motions whose velocities are differentiated; each has an offset of its own.
        moving: whether inertia is asked for; else its place holds NaN.
    """
    back = np.linalg.pinv(rig.sensor.nominal_gain_array)
    noise = np.sqrt((back**2) @ rig.sensor.noise_array**2)
    A, y = [], []
    for k, log in enumerate(reversed(logs)):
        at_rest = log.twist is not None and not np.nan_to_num(log.twist).any()
        for rows, nu, a, g in [_still(log)] if at_rest else measured_motions(rig, log):
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
    P[np.ix_(kept, kept)] = np.linalg.inv(information) * (left @ left / (read.size - kept.size))
    scale = np.maximum(np.abs(x), 1e-3)
    by = np.column_stack(
        [
            (_body(x + STEP * s * e) - _body(x - STEP * s * e)) / (2.0 * STEP * s)
            for s, e in zip(scale, np.eye(size), strict=True)
        ]
    )
    sigma = np.sqrt(np.diag(by @ P @ by.T))
    out = _body(x)
    if not moving:
        out[4:10] = sigma[4:10] = np.nan
    return out, sigma


def _still(log: Log) -> tuple[NDArray[np.int64], Array, Array, Array]:
    assert log.gravity is not None
    nothing = np.zeros((len(log.raw), 6))
    return np.arange(len(log.raw)), nothing, nothing, log.gravity


def _body(x: Array) -> Array:
    mass, center = x[0], x[1:4] / x[0]
    about = symmetric(x[4:10]) - mass * (center @ center * np.eye(3) - np.outer(center, center))
    return np.concatenate([[mass], center, [about[i, j] for i, j in PAIRS], x[10:16]])
