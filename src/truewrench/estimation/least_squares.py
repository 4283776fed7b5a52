"""Least squares on a differentiated twist ([A00] 9-11): the simple competitor of the window estimator.

The model ``raw = C w + b`` is linear in the gain once the wrench is taken for known. It is not: the noise of
the twist enters w through the differentiation, and noise in a regressor shrinks the gain. `smooth="spline"`
removes most of that noise beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from truewrench.estimation.assumptions import assumed_gain_prior, assumed_offset_prior
from truewrench.estimation.motion_noise import twist_noise
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments, smooth_twist
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig

_SHORTEST = 8  # rows that a piece of the record must have to be differentiated
_INCOMPLETE = 0.1  # share of rows that may lack a stream


@dataclass(frozen=True, slots=True)
class LeastSquaresEstimate:
    """Gain and offsets by least squares, in SI and raw units."""

    gain: Array  # (n, 6)
    covariance: Array  # (7n, 7n) of [gain row by row, offset of the last log]: that of the sensor noise alone
    offsets: Array  # (L, n), one per log
    chi_square: Array  # (n,) residual chi-square per degree of freedom of each channel
    samples: Integers  # (L,) rows used of each log


def least_squares(
    rig: Rig, logs: Sequence[Log], smooth: Literal["spline"] | None = None
) -> LeastSquaresEstimate:
    """Estimate one gain and an offset per log by weighted least squares with an orthogonal factorisation.

    Directions of the gain that the motion does not excite keep their nominal value and prior variance.
    Payloads are taken for exact; rows have raw channels and twist together, and streams of different rates
    are not supported. The twist is derived by central differences, or by splines fitted to it beforehand.
    """
    sensor = rig.sensor
    parts = [_regressors(rig, log, smooth) for log in logs]
    samples = np.array([len(wrench) for wrench, _ in parts])
    wrench = np.concatenate([w for w, _ in parts]) / sensor.range_array
    nominal = sensor.nominal_gain_array / sensor.gain_unit
    departure = np.concatenate([raw for _, raw in parts]) / sensor.channel_scale - wrench @ nominal.T
    log_of = (
        np.zeros(len(wrench), dtype=np.int64)
        if sensor.pool_offsets
        else np.repeat(np.arange(len(logs)), samples)
    )
    ones = (log_of[:, None] == np.arange(log_of[-1] + 1)).astype(np.float64)

    n, offset_prior = sensor.n, assumed_offset_prior(rig)
    gain, offsets = nominal.copy(), np.zeros((n, ones.shape[1]))
    covariance, chi_square = np.zeros((7 * n, 7 * n)), np.empty(n)
    for with_offset in (True, False):
        channels = np.flatnonzero((offset_prior > 0.0) == with_offset)
        if channels.size == 0:
            continue
        design = np.column_stack([wrench, ones]) if with_offset else wrench
        q, r = np.linalg.qr(design)
        u, s, vt = np.linalg.svd(r)  # of fewer rows than columns vt has more directions than s values
        seen = np.arange(len(vt)) < np.count_nonzero(s > s[0] * 1e-12)
        u, s = u[:, : seen.sum()], s[: seen.sum()]
        solution = vt[seen].T @ ((u.T @ (q.T @ departure[:, channels])) / s[:, None])
        residual = departure[:, channels] - design @ solution
        for k, i in enumerate(channels):
            sigma = sensor.noise_array[i] / sensor.channel_scale[i]
            prior = np.full(design.shape[1], assumed_gain_prior(rig))
            prior[6:] = offset_prior[i]
            unseen = vt[~seen].T @ vt[~seen]
            of_row = (vt[seen].T * (sigma / s) ** 2) @ vt[seen] + unseen @ np.diag(prior**2) @ unseen
            gain[i] += solution[:6, k]
            chi_square[i] = np.sum((residual[:, k] / sigma) ** 2) / max(1, len(design) - seen.sum())
            where = 6 * i + np.arange(6)
            if with_offset:
                offsets[i] = solution[6:, k]
                of_row = np.delete(np.delete(of_row, slice(6, -1), 0), slice(6, -1), 1)
                where = np.append(where, 6 * n + i)
            covariance[np.ix_(where, where)] = of_row
    unit = sensor.gain_unit
    units = np.concatenate([unit.ravel(), sensor.channel_scale])
    in_si = (offsets * sensor.channel_scale[:, None]).T
    return LeastSquaresEstimate(
        gain=gain * unit,
        covariance=covariance * units[:, None] * units,
        offsets=np.broadcast_to(in_si, (len(logs), n)).copy(),
        chi_square=chi_square,
        samples=samples,
    )


def _regressors(rig: Rig, log: Log, smooth: str | None) -> tuple[Array, Array]:
    """Wrench (N, 6) with the sign of the rig and raw channels (N, n) of one log."""
    time, raw, twist, gravity = _complete_rows(log)
    wrenches, raws = [], []
    for piece in segments(time):
        t, nu, g = time[piece], twist[piece], gravity[piece]
        if t.size < _SHORTEST:
            continue
        if smooth == "spline":
            fit = smooth_twist(t, nu, twist_noise(rig, log))
            nu, a, inside = fit.twist, fit.acceleration, slice(None)
        else:
            a, inside = np.gradient(nu, t, axis=0), slice(1, -1)  # the ends have no central difference
        wrenches.append(payload_wrench(rig, log.payload, nu[inside], a[inside], g[inside]))
        raws.append(raw[piece][inside])
    if not wrenches:
        raise InputError.at(
            log.path, "", "no stretch of complete rows", f"at least {_SHORTEST} rows in a row"
        )
    return np.concatenate(wrenches), np.concatenate(raws)


def _complete_rows(log: Log) -> tuple[Array, Array, Array, Array]:
    if log.twist is None:
        raise InputError.at(log.path, "", "no twist columns", "vx vy vz wx wy wz")
    gravity = np.zeros((len(log.raw), 3)) if log.gravity is None else log.gravity
    complete = np.isfinite(np.column_stack([log.raw, log.twist, gravity])).all(axis=1)
    if np.count_nonzero(~complete) > _INCOMPLETE * complete.size:
        found = (
            f"{np.count_nonzero(~complete)} of {complete.size} rows without raw channels, twist or gravity"
        )
        raise UnsupportedError.at(log.path, "", found, "streams of one rate: `ls` does not merge streams")
    return log.time[complete], log.raw[complete], log.twist[complete], gravity[complete]
