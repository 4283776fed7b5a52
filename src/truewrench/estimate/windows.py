"""Gain and offsets from windows of motion: the `map` and `online` estimators of the core (docs/method.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from truewrench import _core
from truewrench.errors import InputError
from truewrench.log import Log
from truewrench.payload import core_payload
from truewrench.rig import Rig

__all__ = ["GROUPS", "WindowEstimate", "estimate_windows"]

Array = NDArray[np.float64]

GROUPS = ("force", "moment", "v", "Omega")
"""Residuals that are judged apart; with other than six channels the first holds them all, the second none."""

_EXACT = 1e-9  # 1 sigma, normalised, that stands for a parameter without uncertainty


@dataclass(frozen=True, slots=True)
class WindowEstimate:
    """What the windows say of the common parameters, in SI and raw units.

    Attributes:
        gain: (n, 6).
        covariance: (7n, 7n) of [gain row by row, offset of the last log].
        normalised_covariance: the same, gain_ij range_j / scale_i and offset_i / scale_i.
        offsets: (L, n), one per log.
        offsets_std: (L, n).
        solved: whether any window left information and the sums could be solved.
        converged: whether the iterations ended below their tolerance.
        windows: one report per window.
        history_time: (W,) end of each window of `online` [s from the start of its log].
        history_log: (W,) which log it belongs to.
        history_gain: (W, n, 6) the gain after it.
        history_std: (W, n, 6).
        wrench: per log, the payload's wrench (M, 6) that the fitted motion predicts, SI, with the rig's
            sign; NaN where no window fits.
        wrench_rows: per log, the (M,) rows of the log it belongs to.
        knot_dependence: standard normal deviate of the gain against that of halved knots.
        window_dependence: and against that of doubled windows.
        iterations: Gauss-Newton steps.
    """

    gain: Array
    covariance: Array
    normalised_covariance: Array
    offsets: Array
    offsets_std: Array
    solved: bool
    converged: bool
    windows: tuple[_core.WindowReport, ...]
    history_time: Array
    history_log: NDArray[np.int64]
    history_gain: Array
    history_std: Array
    wrench: tuple[Array, ...]
    wrench_rows: tuple[NDArray[np.int64], ...]
    knot_dependence: float
    window_dependence: float
    iterations: int


def estimate_windows(
    rig: Rig,
    logs: Sequence[Log],
    method: Literal["map", "online"] = "map",
    settings: _core.EstimatorSettings | None = None,
) -> WindowEstimate:
    """Estimate one gain and an offset per log; payloads and clocks are taken for exact.

    Raises:
        InputError: for a log without a twist or without gravity where gravity acts.
    """
    sensor = rig.sensor
    n, scale, span = sensor.n, sensor.channel_scale, sensor.range_array
    nominal = sensor.nominal_gain_array * span / scale[:, None]
    offset_prior = sensor.offset_prior_array / scale
    with_offset = bool(offset_prior.any())
    mean, sigma = nominal.ravel(), np.full(6 * n, sensor.gain_prior)
    if with_offset:
        mean = np.append(mean, np.zeros(n))
        sigma = np.append(sigma, np.maximum(offset_prior, _EXACT))
    recorded = [_recorded(rig, log) for log in logs]
    estimate = _core.estimate(
        method,
        [log for log, _ in recorded],
        scale,
        sensor.noise_array / scale,
        sensor.sign / span,
        mean,
        sigma**-2.0,
        sensor.pool_offsets,
        settings or _core.EstimatorSettings(),
    )

    to_gain = scale[:, None] / span  # SI gain per normalised gain
    units = np.append(to_gain.ravel(), scale)
    prior_covariance = np.diag(np.append(np.full(6 * n, sensor.gain_prior), offset_prior) ** 2.0)
    offsets, offsets_std = np.zeros((len(logs), n)), np.tile(sensor.offset_prior_array, (len(logs), 1))
    normalised, covariance = nominal, prior_covariance
    if estimate.solved:
        normalised = estimate.mean[-1][: 6 * n].reshape(n, 6)
        covariance = np.zeros((7 * n, 7 * n))
        size = mean.size
        covariance[:size, :size] = estimate.covariance[-1]
        if with_offset:
            offsets = np.array([m[6 * n :] for m in estimate.mean]) * scale
            offsets_std = np.array([np.sqrt(np.diag(c)[6 * n :]) for c in estimate.covariance]) * scale
    history = estimate.history
    return WindowEstimate(
        gain=normalised * to_gain,
        covariance=covariance * units[:, None] * units,
        normalised_covariance=covariance,
        offsets=offsets,
        offsets_std=offsets_std,
        solved=estimate.solved,
        converged=estimate.converged,
        windows=tuple(estimate.windows),
        history_time=np.array([h.time for h in history]),
        history_log=np.array([h.log for h in history], dtype=np.int64),
        history_gain=np.array([h.mean[: 6 * n].reshape(n, 6) for h in history]).reshape(-1, n, 6) * to_gain,
        history_std=np.array([h.sigma[: 6 * n].reshape(n, 6) for h in history]).reshape(-1, n, 6) * to_gain,
        wrench=tuple(estimate.wrench),
        wrench_rows=tuple(rows for _, rows in recorded),
        knot_dependence=estimate.knot_dependence,
        window_dependence=estimate.window_dependence,
        iterations=estimate.iterations,
    )


def _recorded(rig: Rig, log: Log) -> tuple[_core.RecordedLog, NDArray[np.int64]]:
    """The streams of one log, each on the rows where it has samples, and the rows of the sensor."""
    if log.twist is None:
        raise InputError.at(log.path, "", "no twist columns", "vx vy vz wx wy wz")
    spec = rig.payloads[log.payload]
    recorded = _core.RecordedLog()
    recorded.payload = core_payload(spec)
    if rig.motion.of == "sensor":
        recorded.shift = _core.twist_shift(spec.center_of_mass_array)  # from the sensor to the centre of mass
    time = log.time
    moving = np.isfinite(log.twist).any(axis=1)
    recorded.add_motion(0, time[moving], np.ascontiguousarray(log.twist[moving]), rig.motion.noise_array)
    noise = np.array(rig.motion.acceleration_noise or ())
    if log.acceleration is not None and noise.size == 6:
        known = np.isfinite(log.acceleration).any(axis=1)
        recorded.add_motion(1, time[known], np.ascontiguousarray(log.acceleration[known]), noise)
    rows = np.flatnonzero(np.isfinite(log.raw).any(axis=1))
    gravity = None
    if log.gravity is not None:
        gravity, known = _gravity(log, time[rows])
        rows, gravity = rows[known], np.ascontiguousarray(gravity[known])
    elif rig.in_gravity:
        raise InputError.at(log.path, "", "no gravity columns", "gx gy gz, which a twist in gravity needs")
    recorded.set_wrench(time[rows], np.ascontiguousarray(log.raw[rows]), gravity)
    return recorded, rows


def _gravity(log: Log, at: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Gravity (N, 3) at the sensor's times, interpolated between its own, and where it is known."""
    assert log.gravity is not None
    rows = np.isfinite(log.gravity).all(axis=1)
    t, g = log.time[rows], log.gravity[rows]
    if t.size < 2:
        raise InputError.at(log.path, "gx gy gz", f"{t.size} complete rows", "at least 2")
    known = (at >= t[0]) & (at <= t[-1])
    values = np.asarray(PchipInterpolator(t, g, axis=0)(np.clip(at, t[0], t[-1])))
    return values, known
