"""Gain and offsets from windows of motion: the `map` and `online` estimators of the core (docs/method.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.estimate.clock_information import ClockInformation, with_untold_clock
from truewrench.estimate.curvature import PAYLOAD, Curvature, enlarged
from truewrench.estimate.priors import common_prior
from truewrench.estimate.sources import Sources
from truewrench.estimate.streams import Part, noise_behind_filter, parts_of, recorded
from truewrench.estimate.window_estimate import OffsetPath, PayloadDeparture, WindowEstimate
from truewrench.log import Log
from truewrench.rig import Rig

__all__ = ["estimate_windows", "with_clock"]

Array = NDArray[np.float64]


def estimate_windows(
    rig: Rig,
    logs: Sequence[Log],
    method: Literal["map", "online"] = "map",
    settings: _core.EstimatorSettings | None = None,
    start: WindowEstimate | None = None,
) -> WindowEstimate:
    """Estimate one gain, and per log an offset and a time offset; payloads within their uncertainty.

    Args:
        rig: sensor, payloads and motion.
        logs: with the twist, and gravity where it acts.
        method: of the core.
        settings: of the core.
        start: of `map`, where to begin: another estimate of these logs, or of nearly the same ones.

    Raises:
        InputError: for a log without a twist or without gravity where gravity acts.
    """
    sensor = rig.sensor
    n, scale, span = sensor.n, sensor.channel_scale, sensor.range_array
    nominal = sensor.nominal_gain_array * span / scale[:, None]
    parts = parts_of(rig, logs)
    prior = common_prior(rig, logs, parts, nominal)
    layout = prior.layout
    generator = _untold_clock(rig, logs, parts)
    streams = [recorded(rig, part) for part in parts]
    asked = prior if generator is None else common_prior(with_clock(rig, 0.0), logs, parts, nominal)
    to_gain = scale[:, None] / span  # SI gain per normalised gain
    estimate = _core.estimate(
        method,
        [part for part, _ in streams],
        scale,
        noise_behind_filter(rig, logs) * sensor.noise_array / scale,
        sensor.sign / span,
        asked,
        settings or _core.EstimatorSettings(),
        _start(start, parts, asked.layout, sensor.time_offset_prior),
    )
    units = np.append(to_gain.ravel(), scale)
    normalised = nominal
    covariance = np.diag(
        np.append(np.full(6 * n, sensor.gain_prior), sensor.offset_prior_array / scale) ** 2.0
    )
    offsets, offsets_std = np.zeros((len(logs), n)), np.tile(sensor.offset_prior_array, (len(logs), 1))
    clocks = np.zeros(len(logs))
    clocks_std = np.full(len(logs), sensor.time_offset_prior)
    payloads: dict[str, PayloadDeparture] = {}
    slope = np.zeros(n) if layout.temperature else None
    of_log = np.array([part.log for part in parts])
    last = [int(np.flatnonzero(of_log == k)[-1]) for k in range(len(logs))]
    sources = None
    if estimate.solved:
        means = [estimate.mean[k] for k in last]
        covariances = [estimate.covariance[k] for k in last]
        if generator is not None:
            means[0], covariances[0] = with_untold_clock(
                generator, means[0], covariances[0], nominal, sensor.gain_prior, sensor.time_offset_prior
            )
        normalised = means[-1][: 6 * n].reshape(n, 6)
        stds = [np.sqrt(np.diag(c)) for c in covariances]
        curvatures = _curvatures(rig, logs, layout, means, covariances)
        moments = _second_moments(curvatures, logs, layout, stds[-1])
        kept = _kept(layout)
        if layout.offset:
            o = slice(layout.offset_begin, layout.offset_begin + n)
            offsets = np.array([m[o] for m in means]) * scale
            bent = np.array([np.diag(moment)[6 * n :] for moment in moments])
            # what an offset walks from the middle of its part to the end of the log
            walked = np.outer([0.5 * parts[k].duration for k in last], sensor.offset_walk_array**2.0)
            offsets_std = np.sqrt((np.array([std[o] for std in stds]) ** 2 + bent) * scale**2.0 + walked)
        covariance = np.zeros((7 * n, 7 * n))
        covariance[: kept.size, : kept.size] = covariances[-1][np.ix_(kept, kept)] + moments[-1]
        if layout.offset:
            covariance[6 * n :, 6 * n :] += np.diag(walked[-1] / scale**2.0)
        if layout.temperature:
            slope = means[-1][layout.temperature_begin : layout.temperature_begin + n] * scale
        if layout.time_offset:
            clocks = np.array([m[layout.time_offset_begin] for m in means])
            clocks_std = np.array([std[layout.time_offset_begin] for std in stds])
        if layout.payload:
            p = slice(layout.payload_begin, layout.payload_begin + PAYLOAD)
            for log, mean, std in zip(logs, means, stds, strict=True):
                payloads[log.payload] = PayloadDeparture(mean[p], std[p])
        bent_gain = np.diag(moments[-1])[: 6 * n]
        sources = _sources(prior, sensor.gain_prior, covariances[-1], bent_gain, curvatures[-1])
    history_std = np.array([h.sigma[: 6 * n] for h in estimate.history]).reshape(-1, 6 * n)
    if generator is not None and estimate.solved:  # which no window's own sigma contains
        by_clock = covariances[-1][layout.time_offset_begin, : 6 * n] / stds[-1][layout.time_offset_begin]
        history_std = np.hypot(history_std, by_clock)
    windows, history = estimate.windows, estimate.history  # copies: in terms of logs, not of their parts
    for window in windows:
        window.log = parts[window.log].log
    for entry in history:
        entry.log = parts[entry.log].log
    return WindowEstimate(
        gain=normalised * to_gain,
        covariance=covariance * units[:, None] * units,
        normalised_covariance=covariance,
        offsets=offsets,
        offsets_std=offsets_std,
        time_offsets=clocks,
        time_offsets_std=clocks_std,
        payloads=payloads,
        offset_temperature=slope,
        sources=sources,
        solved=estimate.solved,
        converged=estimate.converged,
        windows=tuple(windows),
        history_time=np.array([h.time for h in history]),
        history_log=np.array([h.log for h in history], dtype=np.int64),
        history_gain=np.array([h.mean[: 6 * n].reshape(n, 6) for h in history]).reshape(-1, n, 6) * to_gain,
        history_std=history_std.reshape(-1, n, 6) * to_gain,
        wrench=_joined(estimate.wrench, of_log),
        wrench_rows=_rows_of_logs(parts, [rows for _, rows in streams], logs),
        left_out=_joined([np.asarray(rows, dtype=bool).ravel() for rows in estimate.left_out], of_log),
        motion_left_out=tuple(
            sum(sum(estimate.motion_left_out[k]) for k in np.flatnonzero(of_log == log))
            for log in range(len(logs))
        ),
        clock_untold=generator is not None,
        knot_dependence=estimate.knot_dependence,
        window_dependence=estimate.window_dependence,
        beginning=_beginning(estimate) if estimate.solved else None,
        offset_path=tuple(_path(parts, estimate, layout, scale, k) for k in range(len(logs))),
        iterations=estimate.iterations,
    )


def _beginning(estimate: _core.Estimate) -> _core.Start:
    """What an estimate says, per part of every log."""
    found = _core.Start()
    found.mean, found.covariance, found.spacing = estimate.mean, estimate.covariance, estimate.spacing
    return found


def _start(
    found: WindowEstimate | None, parts: Sequence[Part], layout: _core.ParameterLayout, clock_prior: float
) -> _core.Start | None:
    """Where to begin with every part of a log, None without an estimate of the same parameters but the clock.

    Logs that are now in other parts begin at the end of what they were.
    """
    beginning = None if found is None else found.beginning
    if found is None or beginning is None:
        return None
    before = np.repeat(np.arange(len(found.offset_path)), [len(path.offset) for path in found.offset_path])
    now = np.array([part.log for part in parts])
    at = range(len(parts)) if np.array_equal(before, now) else np.searchsorted(before, now, side="right") - 1
    means = [beginning.mean[k] for k in at]
    covariances = [beginning.covariance[k] for k in at]
    if layout.time_offset and means[0].size + 1 == layout.size:  # it was held before
        clock = layout.time_offset_begin
        means = [np.insert(mean, clock, 0.0) for mean in means]
        covariances = [np.insert(np.insert(c, clock, 0.0, axis=0), clock, 0.0, axis=1) for c in covariances]
        for covariance in covariances:
            covariance[clock, clock] = clock_prior**2.0
    if means[0].size != layout.size:
        return None
    start = _core.Start()
    start.mean, start.covariance = means, covariances
    start.spacing = [beginning.spacing[k] for k in at]
    return start


def _path(
    parts: Sequence[Part], estimate: _core.Estimate, layout: _core.ParameterLayout, scale: Array, log: int
) -> OffsetPath:
    of_log = [k for k, part in enumerate(parts) if part.log == log]
    offset = np.zeros((len(of_log), layout.channels))
    if layout.offset and estimate.solved:
        o = slice(layout.offset_begin, layout.offset_begin + layout.channels)
        offset = np.array([estimate.mean[k][o] for k in of_log]) * scale
    middle = np.array([parts[k].middle - 1e-9 * parts[k].origin_ns for k in of_log])
    half = 0.5 * np.array([parts[k].duration for k in of_log])
    return OffsetPath(middle - half, middle + half, offset)


def _untold_clock(rig: Rig, logs: Sequence[Log], parts: Sequence[Part]) -> Array | None:
    """What a change of time does to the wrench, where one log's motion does not tell it from the gain's."""
    if not rig.sensor.time_offset_prior > 0.0 or len(logs) > 1 or len(parts) > 1:
        return None
    found = ClockInformation.of(rig.sensor, logs[0], rig.sensor.nominal_gain_array)
    return None if found is None else found.generator


def with_clock(rig: Rig, prior: float) -> Rig:
    """The rig with another 1 sigma of its time offset [s]; 0 holds it."""
    sensor = rig.sensor.model_copy(update={"time_offset_prior": prior})
    return rig.model_copy(update={"sensor": sensor})


def _kept(layout: _core.ParameterLayout) -> NDArray[np.int64]:
    """Where gain and offset are among the common parameters."""
    n = layout.channels
    offset = (
        np.arange(layout.offset_begin, layout.offset_begin + n) if layout.offset else np.zeros(0, np.int64)
    )
    return np.append(np.arange(6 * n), offset)


def _curvatures(
    rig: Rig,
    logs: Sequence[Log],
    layout: _core.ParameterLayout,
    means: Sequence[Array],
    covariances: Sequence[Array],
) -> list[Curvature | None]:
    """Per log, None where its payload is exact."""
    kept, first, found = _kept(layout), layout.payload_begin, list[Curvature | None]()
    for log, mean, covariance in zip(logs, means, covariances, strict=True):
        spec = rig.payloads[log.payload]
        if spec.exact or not np.isfinite(covariance).all():
            found.append(None)
            continue
        at = np.append(kept, np.arange(first, first + PAYLOAD))
        gain, mass = mean[: 6 * layout.channels].reshape(-1, 6), spec.mass * (1.0 + mean[first])
        found.append(Curvature.of(gain, covariance[np.ix_(at, at)], mass, spec.mass, spec.inertia_matrix))
    return found


def _second_moments(
    curvatures: Sequence[Curvature | None], logs: Sequence[Log], layout: _core.ParameterLayout, std: Array
) -> list[Array]:
    """Per log, of gain and offset: by its own payload, and of the gain no less than by any other."""
    gains, size = 6 * layout.channels, _kept(layout).size
    own = [np.zeros((size, size)) if c is None else c.second_moment() for c in curvatures]
    by_payload = {log.payload: moment[:gains, :gains] for log, moment in zip(logs, own, strict=True)}
    found = []
    for log, moment in zip(logs, own, strict=True):
        for payload, other in by_payload.items():
            if payload != log.payload:
                moment = enlarged(moment, other, std[:gains])
        found.append(moment)
    return found


def _sources(
    prior: _core.CommonPrior,
    gain_prior: float,
    covariance: Array,
    bent: Array,
    curvature: Curvature | None,
) -> Sources:
    """Of the last log: noise, its payload and its clock; the clocks of the others count as noise."""
    layout = prior.layout
    first, clock = layout.payload_begin, layout.time_offset_begin
    sigma = np.asarray(prior.information) ** -0.5
    groups: dict[str, list[int]] = {}
    if layout.payload:
        groups["mass"] = [first]
        groups["center_of_mass"] = list(range(first + 1, first + 4))
        groups["inertia"] = list(range(first + 4, first + PAYLOAD))
        sigma[first : first + PAYLOAD] = prior.payload_information[prior.payload_of[-1]] ** -0.5
    alone = {
        name: np.diag(curvature.alone([k - first for k in at]))[: bent.size]
        for name, at in groups.items()
        if curvature is not None
    }
    if layout.time_offset:
        groups["timing"] = [clock]
    found = Sources.of(covariance, 6 * layout.channels, groups, sigma, gain_prior)
    return replace(found, bent=bent, bent_alone=alone)


def _joined(arrays: Sequence[Any], of_log: NDArray[np.int64]) -> tuple[Any, ...]:
    """Per log, the arrays of its parts one after the other."""
    return tuple(
        np.concatenate([arrays[int(k)] for k in np.flatnonzero(of_log == log)]) for log in np.unique(of_log)
    )


def _rows_of_logs(
    parts: Sequence[Part], rows: Sequence[NDArray[np.int64]], logs: Sequence[Log]
) -> tuple[NDArray[np.int64], ...]:
    """Per log, its rows that the sensor's streams were made of."""
    out: list[list[NDArray[np.int64]]] = [[] for _ in logs]
    for part, chosen in zip(parts, rows, strict=True):
        first = int(np.searchsorted(logs[part.log].time_ns, part.rows.time_ns[0]))
        out[part.log].append(chosen + first)
    return tuple(np.concatenate(found) for found in out)
