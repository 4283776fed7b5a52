"""The recursive filter as published ([A00] 18-26), kept as a reference for the window estimator.

It takes one row at a time into a gain that it still has to learn, together with the motion. With an accurate
sensor it locks onto a wrong gain (docs/method.md): its result is to be compared with, not used.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truewrench import _core
from truewrench.estimation.assumptions import assumed_gain_prior, assumed_offset_prior
from truewrench.estimation.motion_noise import twist_covariance
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.payload import core_payload
from truewrench.model.rig import Rig

_ONE_SIDED = 0.1  # share of the rows that may lack raw channels or twist: dropouts, not another rate


@dataclass(frozen=True, slots=True)
class EkfEstimate:
    """What the filter says after the last row of the last log, in SI and raw units."""

    gain: Array  # (6, 6)
    covariance: Array  # (42, 42) of [gain row by row, offset of the last log]
    offsets: Array  # (L, 6), one per log
    samples: Integers  # (L,) rows with a sample of either stream
    history_time: Array  # (M,) since the first row of its log [s]
    history_log: Integers  # (M,) which log it belongs to
    history_gain: Array  # (M, 6, 6) the gain after that row
    nis: Array  # (N,) innovation^T S^-1 innovation of every row of every log
    degrees_of_freedom: Integers  # (N,) samples of each row, the expectation of `nis`


def estimate_ekf(
    rig: Rig,
    logs: Sequence[Log],
    *,
    published: bool = False,
    process_density: float | Sequence[float] | None = None,
    acceleration_prior: float | None = None,
    history_every: int = 1,
) -> EkfEstimate:
    """Run the filter over the logs, one after the other: the gain goes on, motion and offset start afresh.

    Logs hold raw channels and twist in the same rows; some rows may lack one of them. Payloads are taken for
    exact; a prior on the offset adds it to the state. As `published`, it starts from C = I and P = I in SI
    units, and not from the rig's priors; `process_density` of the derivative of the acceleration, one or per
    axis, is the paper's tuning parameter; `acceleration_prior` is 1 sigma of the acceleration at the start of
    a log [m/s^2, rad/s^2]. `history_every`: rows between two entries of the history.
    """
    _refuse_unsupported(rig)
    settings = _settings(rig, published)
    if process_density is not None:
        settings.process_density = np.broadcast_to(np.asarray(process_density, dtype=np.float64), 6).copy()
    if acceleration_prior is not None:
        settings.acceleration_variance = np.full(6, acceleration_prior**2)
    with_offset = bool(rig.sensor.offset_prior_array.any())

    records: list[_core.EkfRecord] = []
    offsets = np.zeros((len(logs), 6))
    for k, log in enumerate(logs):
        if k > 0:
            _carry_over(rig, records[-1], settings)
        records.append(_run(rig, log, settings, with_offset, history_every))
        if with_offset:
            offsets[k] = records[-1].state[48:]
    if rig.sensor.pool_offsets:
        offsets[:] = offsets[-1]
    last = records[-1]
    covariance = np.zeros((42, 42))
    parameters = last.state.size - 12
    covariance[:parameters, :parameters] = last.covariance[12:, 12:]
    return EkfEstimate(
        gain=last.state[12:48].reshape(6, 6).copy(),
        covariance=covariance,
        offsets=offsets,
        samples=np.array([np.count_nonzero(r.degrees_of_freedom) for r in records], dtype=np.int64),
        history_time=np.concatenate([log.time[r.history_row] for log, r in zip(logs, records, strict=True)]),
        history_log=np.repeat(np.arange(len(logs)), [r.history_row.size for r in records]),
        history_gain=np.concatenate([r.history_gain for r in records]).reshape(-1, 6, 6),
        nis=np.concatenate([r.nis for r in records]),
        degrees_of_freedom=np.concatenate([r.degrees_of_freedom for r in records]),
    )


def _refuse_unsupported(rig: Rig) -> None:
    if rig.sensor.n != 6:
        expected = "6: the published filter knows no other"
        raise UnsupportedError.at(rig.path, "sensor.channels", f"{rig.sensor.n} channels", expected)


def _settings(rig: Rig, published: bool) -> _core.EkfSettings:
    sensor, settings = rig.sensor, _core.EkfSettings()
    settings.feels = getattr(_core.Feels, sensor.feels)
    settings.raw_covariance = np.diag(sensor.noise_array**2)
    covariance = settings.parameter_covariance.copy()
    if not published:
        settings.gain = sensor.nominal_gain_array
        prior = assumed_gain_prior(rig) * sensor.gain_unit
        covariance[:36, :36] = np.diag(prior.ravel() ** 2)
    covariance[36:, 36:] = np.diag((assumed_offset_prior(rig) * sensor.channel_scale) ** 2)
    settings.parameter_covariance = covariance
    return settings


def _carry_over(rig: Rig, before: _core.EkfRecord, settings: _core.EkfSettings) -> None:
    """Starts the next log with what the filter knows of the gain, and of a pooled offset."""
    known = before.state.size - 12 if rig.sensor.pool_offsets else 36
    covariance = np.zeros((42, 42))
    covariance[36:, 36:] = np.diag((assumed_offset_prior(rig) * rig.sensor.channel_scale) ** 2)
    covariance[:known, :known] = before.covariance[12 : 12 + known, 12 : 12 + known]
    settings.parameter_covariance = covariance
    settings.gain = before.state[12:48].reshape(6, 6)
    if known > 36:
        settings.offset = before.state[48:]


def _run(
    rig: Rig, log: Log, settings: _core.EkfSettings, with_offset: bool, history_every: int
) -> _core.EkfRecord:
    if log.twist is None:
        raise InputError.at(log.path, "", "no twist columns", "vx vy vz wx wy wz")
    if log.gravity is None and rig.in_gravity:
        raise InputError.at(log.path, "", "no gravity columns", "gx gy gz: the rig is in gravity")
    sensed, moved = (np.isfinite(stream).any(axis=1) for stream in (log.raw, log.twist))
    apart, rows = np.count_nonzero(sensed ^ moved), np.count_nonzero(sensed | moved)
    if sensed.any() and moved.any() and apart > _ONE_SIDED * rows:
        found = f"{apart} of {rows} rows with raw channels or twist alone"
        raise UnsupportedError.at(log.path, "", found, "streams of one rate: `ekf` does not merge streams")
    gravity = np.zeros((len(log.raw), 3)) if log.gravity is None else log.gravity
    known = np.isfinite(gravity).all(axis=1, keepdims=True)
    if np.any(np.isfinite(log.raw) & ~known):
        raise UnsupportedError.at(
            log.path, "column `gx`", "rows with raw channels and without gravity", "both in the same rows"
        )
    spec = rig.payloads[log.payload]
    # v_C = v_S + Omega x c: from the logged point to the centre of mass
    lever = spec.center_of_mass_array if rig.motion.of == "sensor" else np.zeros(3)
    shift = _core.twist_shift(lever)
    settings.twist_covariance = shift @ twist_covariance(rig, log) @ shift.T
    record = _core.ekf_run(
        core_payload(spec),
        settings,
        with_offset,
        log.time_ns,
        log.raw,
        np.ascontiguousarray(log.twist @ shift.T),
        np.where(known, gravity, 0.0),
        history_every,
    )
    if record.status != _core.Status.ok:
        raise InputError.at(log.path, f"row {record.rows_done + 1}", record.status.words, "a row to filter")
    return record
