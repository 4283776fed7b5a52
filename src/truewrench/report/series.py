"""Residuals of a calibration over time: corrected wrench minus what it is held against, log by log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.calibration import Calibration
from truewrench.errors import InputError
from truewrench.estimate.reference import ReferenceEstimate
from truewrench.estimate.streams import noise_behind_filter, unfiltered
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.evidence import Evidence
from truewrench.log import Log
from truewrench.split import held_out
from truewrench.temperature import at_reference_temperature
from truewrench.validation.residuals import residuals

__all__ = ["Record", "Series", "record_of"]

Array = NDArray[np.float64]

_MOST = 8_000  # rows of a log whose motion is estimated anew, in stretches spread over it
_GAP = 0.02  # of the record, between two logs on one axis


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One log.

    Attributes:
        time: (M,) [s from the log's first row].
        wrench: (M, 6) that the corrected one is held against [N, N m]; NaN where there is none.
        raw: (M, n) channels, as before a filter and at the reference temperature.
        residual: (M, 6) corrected minus `wrench`; NaN likewise.
        sigma: (M, 6) or (6,) of it by the stated noise.
        lagged: (H + 1, 6) the part of its covariance in time that is not white, at 0, 1, ... rows.
        begin: of the log on the common time axis [s].
        duration: of the log [s].
        rejected: (begin, end) of stretches of motion that did not fit [s from the log's first row].
    """

    time: Array
    wrench: Array
    raw: Array
    residual: Array
    sigma: Array
    lagged: Array
    begin: float
    duration: float
    rejected: tuple[tuple[float, float], ...] = ()

    @property
    def normalised(self) -> Array:
        """(M, 6) residuals in units of their sigma."""
        return self.residual / self.sigma


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """All logs, one after the other.

    Attributes:
        logs: those that have residuals, and those that have none.
        against: what the corrected wrench is held against, in words.
        fitted: whether the motion behind it was fitted to the sensor, too.
        part: words for the rows that are shown, where these are not all.
        none_because: why no log has residuals, empty where one has.
    """

    logs: tuple[Series, ...]
    against: str
    fitted: bool = False
    part: str = ""
    none_because: str = ""

    @property
    def end(self) -> float:
        """Of the common time axis [s]."""
        return max((series.begin + series.duration for series in self.logs), default=0.0)


def record_of(calibration: Calibration, evidence: Evidence) -> Record:
    """Residuals of every log of a calibration."""
    begins = _begins(evidence.logs)
    if not np.isfinite(calibration.inverse).all():
        return Record((), "", none_because="the gain has no inverse, so no wrench can be corrected with it")
    estimate = evidence.estimate
    part, fitted = "", False
    if isinstance(estimate, WindowEstimate) and calibration.estimator == "map":
        against = "the payload's wrench by the motion that was fitted to sensor and motion together"
        fitted = True
        found = [_of_windows(calibration, log, k, estimate, b) for k, (log, b) in enumerate(begins)]
    elif isinstance(estimate, ReferenceEstimate):
        against = "the reference wrench of the log"
        found = [_of_reference(calibration, log, k, estimate, b) for k, (log, b) in enumerate(begins)]
    else:
        against = "the payload's wrench by a motion that the velocities alone give"
        if max(len(log.time_ns) for log in evidence.logs) > _MOST:
            part = f"stretches that hold about {_MOST} rows of every log"
        logs = evidence.logs
        if isinstance(estimate, WindowEstimate):  # `online`, whose motion is by the gain known at its time
            logs = tuple(estimate.undisturbed(log, k) for k, log in enumerate(logs))
        found = [_of_motion(calibration, log, b) for log, b in _begins(logs)]
    if not any(np.isfinite(series.residual).any() for series in found):
        why = "no stretch of the record has both all raw channels and a motion that fits"
        return Record(tuple(found), against, fitted, part, why)
    return Record(tuple(found), against, fitted, part)


def _begins(logs: Sequence[Log]) -> list[tuple[Log, float]]:
    durations = np.array([float(log.time[-1]) for log in logs])
    ends = np.cumsum(durations + _GAP * durations.sum())
    return list(zip(logs, np.append(0.0, ends[:-1]).tolist(), strict=True))


def _of_windows(calibration: Calibration, log: Log, k: int, estimate: WindowEstimate, begin: float) -> Series:
    rig, inverse = calibration.rig, calibration.inverse
    rows, wrench = estimate.wrench_rows[k], estimate.wrench[k]
    felt = log
    if rig.sensor.lowpass_hz is not None:
        felt = replace(log, raw=unfiltered(log.raw, log.time, rig.sensor.lowpass_hz)[0])
    raw = at_reference_temperature(calibration.offset_temperature, rig, felt).raw[rows]
    noise = noise_behind_filter(rig, [log]) * rig.sensor.noise_array
    noise = noise * np.sqrt(1.0 - _leverage(estimate, rig.sensor.n))  # the motion follows some of it
    return Series(
        time=log.time[rows],
        wrench=wrench,
        raw=raw,
        residual=(raw - estimate.offset_path[k].at(log.time[rows])) @ inverse.T - wrench,
        sigma=np.sqrt(inverse**2 @ noise**2),
        lagged=np.zeros((1, 6)),
        begin=begin,
        duration=float(log.time[-1]),
        rejected=tuple(
            (w.begin, w.end) for w in estimate.windows if w.log == k and w.status != _core.WindowStatus.fitted
        ),
    )


def _of_reference(
    calibration: Calibration, log: Log, k: int, estimate: ReferenceEstimate, begin: float
) -> Series:
    rig, inverse = calibration.rig, calibration.inverse
    assert log.reference is not None
    assert rig.reference_noise is not None
    wrench = np.full_like(log.reference, np.nan)
    rows = estimate.rows[k]
    wrench[rows] = log.reference[rows]
    raw = at_reference_temperature(calibration.offset_temperature, rig, log).raw
    used = sum(rows.size for rows in estimate.rows)
    left = float(np.mean(estimate.freedom)) / max(
        1, used
    )  # of a channel's noise: gain and offsets follow the rest
    return Series(
        time=log.time,
        wrench=wrench,
        raw=raw,
        residual=(raw - estimate.offsets[k]) @ inverse.T - wrench,
        sigma=np.sqrt(left * (inverse**2 @ rig.sensor.noise_array**2 + np.array(rig.reference_noise) ** 2)),
        lagged=np.zeros((1, 6)),
        begin=begin,
        duration=float(log.time[-1]),
    )


def _of_motion(calibration: Calibration, log: Log, begin: float) -> Series:
    """For estimators that keep no motion."""
    n = calibration.rig.sensor.n
    shown = log
    if len(log.time_ns) > _MOST:
        stretches = held_out([log], _MOST / len(log.time_ns))[1]
        shown = stretches[0] if stretches else log
    first = float((shown.time_ns[0] - log.time_ns[0]) * 1e-9)
    try:
        found = residuals(calibration, calibration.rig, shown)
    except InputError:  # too short, or no motion: the report says so
        none = np.zeros((0, 6))
        empty = np.zeros((0, n))
        return Series(
            np.zeros(0), none, empty, none, np.ones(6), np.zeros((1, 6)), begin, float(log.time[-1])
        )
    breaks = list(found.begin)[1:]

    def broken(values: Array) -> Array:
        """With a NaN between stretches, so that nothing is drawn across them."""
        return np.insert(values, breaks, np.nan, axis=0)

    compensated = at_reference_temperature(calibration.offset_temperature, calibration.rig, shown)
    return Series(
        time=broken(shown.time[found.rows]) + first,
        wrench=broken(found.wrench),
        raw=broken(compensated.raw[found.rows]),
        residual=broken(found.new),
        sigma=broken(np.sqrt(found.noise)),
        lagged=found.lagged,
        begin=begin,
        duration=float(log.time[-1]),
    )


def _leverage(estimate: WindowEstimate, n: int) -> Array:
    """(n,) share of each channel's noise that the fitted motion takes up."""
    leverage, count = np.zeros(n), np.full(n, 1e-9)
    for window in estimate.windows:
        if window.status != _core.WindowStatus.fitted:
            continue
        for i, component in enumerate(window.components[:n]):
            leverage[i] += component.all.leverage
            count[i] += component.all.count
    return np.asarray(np.clip(leverage / count, 0.0, 0.9))
