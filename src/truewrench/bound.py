"""What a log allows at best: the Cramer-Rao bound on the gain (docs/method.md, "The bound")."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.linalg import cho_solve_banded, cholesky_banded

from truewrench.calibration import Bound
from truewrench.errors import InputError
from truewrench.log import Log
from truewrench.payload import payload_wrench
from truewrench.rig import Rig
from truewrench.smooth import segments, smooth_twist

__all__ = ["bound", "oracle_rms"]

Array = NDArray[np.float64]

_DEGREE = 5
_ACTIVE = _DEGREE + 1
_BLOCK = 6 * _ACTIVE  # coefficients that one sample sees
_SHORTEST = 8  # samples of a twist that a spline can follow


def bound(rig: Rig, logs: Sequence[Log], gain: Array) -> Bound:
    """RMS of the Cramer-Rao sigma of the normalised gains, with the rig's priors, payload and clocks exact.

    The motion is that of splines fitted to the twist, the truth is taken to be the estimate.

    Args:
        rig: sensor, payloads and motion noise.
        logs: the logs of the calibration.
        gain: estimated gain (n, 6).
    """
    sensor = rig.sensor
    normalised = gain * sensor.range_array / sensor.channel_scale[:, None]
    inferred: list[Array] = []
    wrenches: list[Array] = []
    for log in logs:
        pieces = _information(rig, log, normalised)
        inferred.append(sum((found for found, _ in pieces), np.zeros((7 * sensor.n, 7 * sensor.n))))
        wrenches.append(np.concatenate([wrench for _, wrench in pieces] or [np.zeros((0, 6))]))
    return Bound(oracle_rms=oracle_rms(rig, wrenches), rms=_rms(rig, inferred))


def oracle_rms(rig: Rig, wrenches: Sequence[Array]) -> float:
    """RMS of sigma_i^2 (W^T W)^-1 over the normalised gains: motion known, priors included.

    Args:
        rig: sensor noise and priors.
        wrenches: (M, 6) of every log, at its samples of the sensor; rows with NaN do not count.
    """
    sensor = rig.sensor
    known = []
    for wrench in wrenches:
        rows = wrench[np.isfinite(wrench).all(axis=1)] / sensor.range_array
        known.append(_known(rig, np.column_stack([rows, np.ones(len(rows))])))
    return _rms(rig, known)


def _known(rig: Rig, columns: Array) -> Array:
    noise = rig.sensor.noise_array / rig.sensor.channel_scale
    return np.asarray(np.kron(np.diag(noise**-2.0), columns.T @ columns))


def _rms(rig: Rig, information: Sequence[Array]) -> float:
    """RMS sigma of the normalised gains by the information (7n, 7n) of every log and the rig's priors."""
    sensor, n = rig.sensor, rig.sensor.n
    offset_prior = sensor.offset_prior_array / sensor.channel_scale
    pooled = 1 if sensor.pool_offsets else len(information)
    total = np.zeros((6 * n + n * pooled,) * 2)
    for k, of_log in enumerate(information):
        # rows of [gain, offset] of one channel together, sorted into all gains, then the offsets of every log
        first = 6 * n + n * (0 if sensor.pool_offsets else k)
        order = np.column_stack([np.arange(6 * n).reshape(n, 6), first + np.arange(n)]).ravel()
        total[np.ix_(order, order)] += of_log
    present = np.concatenate([np.ones(6 * n, dtype=bool), np.tile(offset_prior > 0.0, pooled)])
    prior = np.concatenate([np.full(6 * n, sensor.gain_prior), np.tile(offset_prior, pooled)])[present]
    covariance = np.linalg.inv(total[np.ix_(present, present)] + np.diag(prior**-2.0))
    return float(np.sqrt(np.mean(np.diag(covariance)[: 6 * n])))


def _information(rig: Rig, log: Log, gain: Array) -> list[tuple[Array, Array]]:
    """Of every unbroken piece: information on the rows of [gain, offset], and the wrench (N, 6)."""
    if log.twist is None:
        raise InputError.at(log.path, "", "no twist columns", "vx vy vz wx wy wz")
    moving, sensing = np.isfinite(log.twist).all(axis=1), np.isfinite(log.raw).all(axis=1)
    time, twist, stamps = log.time[moving], log.twist[moving], log.time[sensing]
    pieces = []
    for piece in segments(time):
        t = time[piece]
        inside = stamps[(stamps >= t[0]) & (stamps <= t[-1])]
        if t.size >= _SHORTEST and inside.size:
            spacing = smooth_twist(t, twist[piece], rig.motion.noise_array).spacing.min()
            pieces.append(_piece_information(rig, log, gain, t, twist[piece], inside, float(spacing)))
    return pieces


def _piece_information(
    rig: Rig, log: Log, gain: Array, time: Array, twist: Array, stamps: Array, spacing: float
) -> tuple[Array, Array]:
    n, sensor = rig.sensor.n, rig.sensor
    noise = sensor.noise_array / sensor.channel_scale
    intervals = max(1, round((time[-1] - time[0]) / spacing))
    knots = time[0] + (time[-1] - time[0]) / intervals * np.arange(-_DEGREE, intervals + _DEGREE + 1)
    basis, _ = _pieces_of(knots, time)
    at_stamps, slopes = _pieces_of(knots, stamps)
    spline = make_lsq_spline(time, twist, knots, k=_DEGREE)
    wrench, by_twist, by_acceleration = _wrench_and_jacobians(rig, log, stamps, spline)
    columns = np.column_stack([wrench, np.ones(stamps.size)])

    weight = gain / noise[:, None]
    band = np.zeros((_BLOCK, 6 * (intervals + _DEGREE)))
    cross = np.zeros((band.shape[1], n, 7))
    rows, cols = np.tril_indices(_BLOCK)
    edges = knots[_DEGREE : _DEGREE + intervals]
    twist_starts = np.append(np.searchsorted(time, edges), time.size)
    wrench_starts = np.append(np.searchsorted(stamps, edges), stamps.size)
    for i, ((a0, a1), (b0, b1)) in enumerate(
        zip(pairwise(twist_starts), pairwise(wrench_starts), strict=True)
    ):
        block = np.kron(basis[a0:a1].T @ basis[a0:a1], np.diag(rig.motion.noise_array**-2.0))
        by_coefficients = np.einsum("km,kpc->kpmc", at_stamps[b0:b1], by_twist[b0:b1])
        by_coefficients += np.einsum("km,kpc->kpmc", slopes[b0:b1], by_acceleration[b0:b1])
        j = weight @ by_coefficients.reshape(b1 - b0, 6, _BLOCK)
        flat = j.reshape(-1, _BLOCK)
        block += flat.T @ flat
        band[rows - cols, 6 * i + cols] += block[rows, cols]
        part = j.reshape(b1 - b0, n * _BLOCK).T @ columns[b0:b1]
        cross[6 * i : 6 * i + _BLOCK] += part.reshape(n, _BLOCK, 7).transpose(1, 0, 2)
    cross_flat = (cross / noise[None, :, None]).reshape(len(cross), 7 * n)
    factor = cholesky_banded(band, lower=True)
    inferred = _known(rig, columns) - cross_flat.T @ cho_solve_banded((factor, True), cross_flat)
    return np.asarray(inferred), wrench * sensor.range_array


def _pieces_of(knots: Array, at: Array) -> tuple[Array, Array]:
    """Values (N, 6) of the six quintic B-splines that are not zero at each time, and their slopes (N, 6)."""
    step = knots[1] - knots[0]
    values = BSpline.design_matrix(at, knots, _DEGREE).data.reshape(-1, _ACTIVE)
    lower = BSpline.design_matrix(at, knots[1:-1], _DEGREE - 1).data.reshape(-1, _DEGREE)
    slopes = (np.pad(lower, ((0, 0), (1, 0))) - np.pad(lower, ((0, 0), (0, 1)))) / step
    return values, slopes


def _wrench_and_jacobians(rig: Rig, log: Log, stamps: Array, spline: BSpline) -> tuple[Array, Array, Array]:
    """Normalised wrench (N, 6) and its Jacobians by twist and acceleration (N, 6, 6)."""
    gravity = np.zeros((stamps.size, 3))
    if log.gravity is not None:
        rows = np.isfinite(log.gravity).all(axis=1)
        gravity = np.column_stack([np.interp(stamps, log.time[rows], g) for g in log.gravity[rows].T])

    def wrench(nu: Array, a: Array) -> Array:
        return payload_wrench(rig, log.payload, nu, a, gravity) / rig.sensor.range_array

    nu, a = spline(stamps), spline(stamps, nu=1)
    by_twist, by_acceleration = np.empty((stamps.size, 6, 6)), np.empty((stamps.size, 6, 6))
    for c, step in enumerate(np.eye(6)):  # quadratic in nu, linear in a: central differences are exact
        by_twist[:, :, c] = 0.5 * (wrench(nu + step, a) - wrench(nu - step, a))
        by_acceleration[:, :, c] = 0.5 * (wrench(nu, a + step) - wrench(nu, a - step))
    return wrench(nu, a), by_twist, by_acceleration
