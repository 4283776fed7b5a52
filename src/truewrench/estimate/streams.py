"""The streams of a log as the core reads them, in parts where the offset walks (docs/method.md, "Drift")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.errors import InputError
from truewrench.estimate.joints import add_tracked_motion
from truewrench.log import Log
from truewrench.motion.smooth import smooth_twist
from truewrench.motion_noise import twist_noise
from truewrench.payload import core_payload
from truewrench.rig import Rig
from truewrench.split import rows_of
from truewrench.temperature import temperature_at

__all__ = ["Part", "links", "noise_behind_filter", "parts_of", "recorded", "unfiltered"]

Array = NDArray[np.float64]

SHORTEST_PART = 1.0  # [s], or this share of the log if that is less: what a jump in mid-part costs
LEAST_SHARE = 1.0 / 24.0
MOST_PARTS = 200  # of one log
DAY = 86400.0
_SAME = 1e-7  # [s] 1 sigma, between parts of one log, that stands for the same clock


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Consecutive rows of a log with an offset of their own.

    Attributes:
        log: index of the log.
        rows: the part of it.
        origin_ns: the log's first time stamp.
        middle: time of the middle of the part [s, on the log's own clock].
        duration: of the part [s].
    """

    log: int
    rows: Log
    origin_ns: int
    middle: float
    duration: float


def parts_of(rig: Rig, logs: Sequence[Log]) -> list[Part]:
    """Every log in parts over which its offset walks less than the part's own noise, cut where it jumps."""
    walk = rig.sensor.offset_walk_array
    parts = []
    for k, log in enumerate(logs):
        time, origin = log.time, int(log.time_ns[0])
        count = 1
        if walk.any():
            period = float(np.median(np.diff(time)))
            moving = walk > 0.0
            longest = float((rig.sensor.noise_array[moving] * np.sqrt(period) / walk[moving]).min())
            shortest = min(SHORTEST_PART, LEAST_SHARE * float(time[-1]))
            count = int(np.clip(time[-1] / max(longest, shortest), 1, MOST_PARTS))
        edges = np.linspace(0.0, time[-1], count + 1)
        edges[-1] = np.inf
        jumps = 1e-9 * (np.array(log.offset_jumps_ns, dtype=np.int64) - origin)
        edges = np.union1d(edges, jumps[(jumps > 0.0) & (jumps < time[-1])])
        for begin, end in pairwise(edges):
            chosen = (time >= begin) & (time < end)
            if np.count_nonzero(chosen) < 2:
                continue
            rows = log if chosen.all() else rows_of(log, chosen)
            first, last = time[chosen][[0, -1]]
            middle = 0.5 * float(first + last) + 1e-9 * origin
            parts.append(Part(k, rows, origin, middle, float(last - first)))
    return parts


def links(rig: Rig, parts: Sequence[Part], layout: _core.ParameterLayout) -> list[Array]:
    """Per part, 1 / variance of the step of its own parameters from the part before (n + ... as the layout).

    Offsets walk inside a log and start anew with the next; gains walk on through all of them.
    """
    sensor = rig.sensor
    found = [np.zeros(0)]
    for before, part in pairwise(parts):
        step = abs(part.middle - before.middle)
        link = np.zeros(layout.size)
        if sensor.gain_walk > 0.0:
            link[: 6 * sensor.n] = 1.0 / (sensor.gain_walk**2.0 * max(step, 1e-3) / DAY)
        if part.log == before.log:
            if layout.offset:
                variance = sensor.offset_walk_array**2.0 * max(step, 1e-9)
                if any(before.middle < 1e-9 * jump <= part.middle for jump in part.rows.offset_jumps_ns):
                    variance = variance + sensor.offset_prior_array**2.0
                normalised = (
                    np.maximum(variance, (1e-12 * sensor.channel_scale) ** 2.0) / sensor.channel_scale**2.0
                )
                o = slice(layout.offset_begin, layout.offset_begin + sensor.n)
                link[o] = 1.0 / normalised
            if layout.time_offset:
                link[layout.time_offset_begin] = _SAME**-2.0
        found.append(link if link.any() else np.zeros(0))
    return found


def recorded(rig: Rig, part: Part) -> tuple[_core.RecordedLog, NDArray[np.int64]]:
    """The streams of a part, each on the rows where it has samples, and the rows of the sensor."""
    log = part.rows
    if log.twist is None:
        raise InputError.at(log.path, "", "no twist columns", "vx vy vz wx wy wz")
    spec = rig.payloads[log.payload]
    streams = _core.RecordedLog()
    streams.payload = core_payload(spec)
    if rig.motion.of == "com":
        streams.point = spec.center_of_mass_array
    time = np.asarray((log.time_ns - part.origin_ns) * 1e-9, dtype=np.float64)
    if log.tracking is not None:
        add_tracked_motion(streams, rig, log, part.origin_ns, time)
    else:
        moving = np.isfinite(log.twist).any(axis=1)
        streams.add_motion(0, time[moving], np.ascontiguousarray(log.twist[moving]), rig.motion.noise_array)
    noise = np.array(rig.motion.acceleration_noise or ())
    if log.tracking is None or log.tracking.reference is None:
        if log.acceleration is not None and noise.size == 6:
            known = np.isfinite(log.acceleration).any(axis=1)
            streams.add_motion(1, time[known], np.ascontiguousarray(log.acceleration[known]), noise)
        if log.specific_force is not None and noise.size == 3:
            _add_specific_force(streams, rig, log, time, noise)
    raw, delay = log.raw, 0.0
    if rig.sensor.lowpass_hz is not None:
        raw, delay = unfiltered(log.raw, time, rig.sensor.lowpass_hz)
    rows = np.flatnonzero(np.isfinite(raw).any(axis=1))
    if log.gravity is not None:
        known = np.isfinite(log.gravity).all(axis=1)
        if np.count_nonzero(known) < 2:
            found = f"{np.count_nonzero(known)} complete rows"
            raise InputError.at(log.path, "gx gy gz", found, "at least 2")
        if log.tracking is None or log.tracking.reference is None:
            streams.set_gravity(time[known], np.ascontiguousarray(log.gravity[known]))
        # gravity is interpolated, never extrapolated
        first, last = time[known][[0, -1]]
        rows = rows[(time[rows] >= first) & (time[rows] <= last)]
    elif rig.in_gravity:
        raise InputError.at(log.path, "", "no gravity columns", "gx gy gz, which a twist in gravity needs")
    warm = temperature_at(log, log.time_ns[rows]) if rig.temperature.prior > 0.0 else None
    streams.set_wrench(
        time[rows] - delay,
        np.ascontiguousarray(raw[rows]),
        None if warm is None else warm - rig.temperature.reference,
    )
    return streams, rows


def noise_behind_filter(rig: Rig, logs: Sequence[Log]) -> float:
    """Factor of the noise of `recorded` channels over that of the logged ones: undoing a filter costs noise.

    Noise that went through the filter becomes white again; noise that came after it does not, and grows more.
    Which of the two a sensor has shows in third differences, which leave little of the motion.
    """
    if rig.sensor.lowpass_hz is None:
        return 1.0
    factors = []
    for log in logs:
        rows = np.isfinite(log.raw).any(axis=1)
        alpha = float(np.exp(-2.0 * np.pi * rig.sensor.lowpass_hz * np.median(np.diff(log.time[rows]))))
        third = np.diff(log.raw[rows], n=3, axis=0)
        third = third[np.isfinite(third).all(axis=1)]
        correlation = np.mean(third[1:] * third[:-1], axis=0) / np.mean(third**2, axis=0)
        weights = np.array([20.0, -15.0, 6.0, -1.0])  # autocovariance of third differences of white noise
        lagged = np.zeros(5)
        for lag in range(5):
            lags = np.abs(np.arange(-3, 4) - lag)
            lagged[lag] = np.sum(weights[np.abs(np.arange(-3, 4))] * alpha**lags)
        through, after = lagged[1] / lagged[0], weights[1] / weights[0]
        filtered = abs(np.median(correlation) - through) < abs(np.median(correlation) - after)
        factors.append(
            np.sqrt((1.0 + alpha) / (1.0 - alpha)) if filtered else np.sqrt(1.0 + alpha**2) / (1.0 - alpha)
        )
    return float(np.median(factors))


def unfiltered(raw: Array, time: Array, corner: float) -> tuple[Array, float]:
    """Channels before a first-order low-pass, and how far before its time stamp each sample then lies [s].

    x_k - alpha x_{k-1} is (1 - alpha) times the mean of the input over the last period, weighted by
    exp(-s / tau).
    """
    tau = 1.0 / (2.0 * np.pi * corner)
    rows = np.flatnonzero(np.isfinite(raw).any(axis=1))
    period = np.diff(time[rows])
    usual = float(np.median(period))
    alpha = np.exp(-period / tau)[:, None]
    behind = raw[rows]
    undone = np.full_like(raw, np.nan)
    undone[rows[1:]] = (behind[1:] - alpha * behind[:-1]) / (1.0 - alpha)
    undone[rows[1:][np.abs(period - usual) > 0.5 * usual]] = np.nan
    pole = float(np.exp(-usual / tau))
    return undone, tau - usual * pole / (1.0 - pole)


def _add_specific_force(streams: _core.RecordedLog, rig: Rig, log: Log, time: Array, noise: Array) -> None:
    """An accelerometer at the sensor origin: vdot_S + Omega x v_S - g, and vdot_S = vdot_P + p x Omegadot.

    Omega x v_S comes from the smoothed twist, and its noise counts as the accelerometer's.
    """
    if log.specific_force is None or log.twist is None:
        return
    whole = np.flatnonzero(np.isfinite(log.twist).all(axis=1))
    known = np.isfinite(log.specific_force).any(axis=1)
    if whole.size < 8 or not known.any():
        return
    of_nu = twist_noise(rig, log)
    smooth = smooth_twist(time[whole], log.twist[whole], of_nu).twist
    twist = np.column_stack([np.interp(time[known], time[whole], column) for column in smooth.T])
    p = np.array(rig.payloads[log.payload].center_of_mass_array if rig.motion.of == "com" else np.zeros(3))
    v, omega = twist[:, :3], twist[:, 3:]
    v_sensor = v - np.cross(omega, p)
    gravity = np.zeros((1, 3))
    if log.gravity is not None:
        seen = np.isfinite(log.gravity).all(axis=1)
        gravity = np.column_stack([np.interp(time[known], time[seen], g) for g in log.gravity[seen].T])
    value = np.full((int(known.sum()), 6), np.nan)
    value[:, :3] = log.specific_force[known] - np.cross(omega, v_sensor) + gravity
    of_v, of_omega = of_nu[:3].max(), of_nu[3:].max()
    of_twist = np.mean(omega**2) * of_v**2 + np.mean(v_sensor**2) * of_omega**2
    combination = np.eye(6)
    combination[:3, 3:] = [[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]]
    sigma = np.append(np.sqrt(noise**2.0 + 2.0 * of_twist), np.ones(3))
    streams.add_motion(1, time[known], value, sigma, combination)
