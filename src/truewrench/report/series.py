"""Residuals of a calibration over time: corrected wrench minus what it is held against, log by log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from truewrench.estimation.estimate import Estimate
from truewrench.estimation.evidence import Evidence
from truewrench.estimation.known_wrench import KnownWrenchEstimate
from truewrench.judging.validation.residuals import residuals
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.split import held_out
from truewrench.model.temperature import at_reference_temperature

Span = tuple[float, float]

_MOST = 8_000  # rows of a log whose motion is estimated anew, in stretches spread over it
_GAP = 0.02  # of the record, between two logs on one axis
_LEAST_LEFT = 0.3  # of a channel's noise, where a fit is said to follow the rest


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One log; without residuals all arrays over samples are empty."""

    begin: float  # of the log on the common time axis [s]
    duration: float  # of the log [s]
    time: Array  # (M,) [s from the log's first row]
    wrench: Array  # (M, 6) that the corrected one is held against [N, N m]; NaN where there is none
    measured: Array  # (M, 6) the corrected wrench, samples that were left out among them
    residual: Array  # (M, 6) measured minus `wrench`, less `discrepancy`; NaN where there is none or left out
    channels: Array  # (M, n) what a fit leaves of the raw channels, likewise; without a fit empty
    sigma: Array  # (M, 6) or (6,) of `residual` by the noise, as found where the estimator finds it
    noise: Array  # (n,) of a sample of a channel, likewise
    left: Array  # (n,) share of its variance that a fit leaves in the residuals
    # (M, 6) slow disturbance that the fit holds [N, N m]; None where it holds none
    discrepancy: Array | None = None
    left_out: tuple[Span, ...] = ()  # (begin, end) of samples left out [s from the log's first row]
    # (begin, end) of samples outside of every stretch that could be estimated from
    outside: tuple[Span, ...] = ()
    steps: tuple[float, ...] = ()  # when the offset stepped

    @property
    def normalised(self) -> Array:
        """(M, 6) residuals in units of their sigma."""
        return self.residual / self.sigma


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """All logs, one after the other."""

    logs: tuple[Series, ...]  # those that have residuals, and those that have none
    # `fit` where the motion was fitted to the sensor, too, `reference` where the wrench is known,
    # `velocities` where these alone give the motion, whose noise is not white then
    source: Literal["fit", "reference", "velocities"] = "fit"
    part: str = ""  # words for the rows that are shown, where these are not all
    none_because: str = ""  # why no log has residuals, empty where one has

    @property
    def against(self) -> str:
        """What the corrected wrench is held against, in words."""
        return {
            "fit": "the payload's wrench by the motion that was fitted to sensor and motion together",
            "reference": "the reference wrench of the log",
            "velocities": "the payload's wrench by a motion that the velocities alone give",
        }[self.source]

    @property
    def end(self) -> float:
        """Of the common time axis [s]."""
        return max((series.begin + series.duration for series in self.logs), default=0.0)

    def spans(self, kind: str) -> list[Span]:
        """`left_out` or `outside` of all logs, on the common time axis."""
        return [(s.begin + a, s.begin + b) for s in self.logs for a, b in getattr(s, kind)]


def groups_of(n: int) -> dict[str, slice]:
    """Channels whose noise is found together."""
    return {"force": slice(0, 3), "moment": slice(3, 6)} if n == 6 else {"channels": slice(0, n)}


def record_of(calibration: Calibration, evidence: Evidence) -> Record:
    """Residuals of every log of a calibration."""
    logs, estimate = evidence.logs, evidence.estimate
    placed = [
        replace(empty, left_out=report.disturbances)
        for empty, report in zip(_placed(logs), calibration.logs, strict=True)
    ]
    if not np.isfinite(calibration.inverse).all():
        why = "the gain has no inverse, so no wrench can be corrected with it"
        return Record(tuple(placed), none_because=why)
    source: Literal["fit", "reference", "velocities"] = "velocities"
    part, found = "", []
    for k, (empty, log) in enumerate(zip(placed, logs, strict=True)):
        if isinstance(estimate, Estimate):
            source = "fit"
            found.append(_of_estimate(calibration, empty, log, k, estimate))
            if (every := estimate.rows[k].every) > 1:
                part = f"one of {every} samples"
        elif isinstance(estimate, KnownWrenchEstimate):
            source = "reference"
            found.append(_of_known_wrench(calibration, empty, log, k, estimate))
        else:
            found.append(_of_motion(calibration, empty, log))
            if len(log.time_ns) > _MOST:
                part = f"stretches that hold about {_MOST} rows of every log"
    why = ""
    if not any(np.isfinite(series.residual).any() for series in found):
        why = "no stretch of the record has both all raw channels and a motion that fits"
    return Record(tuple(found), source, part, why)


def _placed(logs: Sequence[Log]) -> list[Series]:
    """Nothing but where each log lies."""
    durations = np.array([float(log.time[-1]) for log in logs])
    begins = np.append(0.0, np.cumsum(durations + _GAP * durations.sum())[:-1])
    none, axes, one = np.zeros(0), np.zeros((0, 6)), np.ones(6)
    return [
        Series(begin, duration, none, axes, axes, axes, axes, one, one, one)
        for begin, duration in zip(begins.tolist(), durations.tolist(), strict=True)
    ]


def _of_estimate(calibration: Calibration, placed: Series, log: Log, k: int, estimate: Estimate) -> Series:
    rig, inverse, rows = calibration.rig, calibration.inverse, estimate.rows[k]
    scale = rig.sensor.channel_scale
    factor = {found.what: found.of_sample for found in estimate.noise[k]}
    noise, left = rig.sensor.noise_array.copy(), np.ones(rig.sensor.n)
    shown = np.where(rows.masked[:, None], np.nan, rows.residual) * scale
    for what, channels in groups_of(rig.sensor.n).items():
        noise[channels] *= factor.get(what, 1.0)
        squares = (shown[:, channels] / noise[channels]) ** 2
        if np.isfinite(squares).any():
            left[channels] = np.clip(np.nanmean(squares), _LEAST_LEFT, 1.0)
    slow = rows.discrepancy * scale
    outside = np.any(np.isfinite(log.raw), axis=1)
    for stretch in np.unique(rows.stretch):
        held = rows.rows[rows.stretch == stretch]
        outside[held[0] : held[-1] + 1] = False
    whole = replace(
        placed,
        time=rows.time,
        wrench=rows.wrench,
        measured=rows.wrench + (rows.residual * scale + slow) @ inverse.T,
        residual=shown @ inverse.T,
        discrepancy=slow @ inverse.T if slow.any() else None,
        channels=shown,
        sigma=np.sqrt(inverse**2 @ (left * noise**2)),
        noise=noise,
        left=left,
        outside=_runs(log.time, outside),
        steps=tuple(step.time for step in estimate.steps[k]),
    )
    return _broken(whole, np.flatnonzero(np.diff(rows.stretch)) + 1)


def _of_known_wrench(
    calibration: Calibration, placed: Series, log: Log, k: int, estimate: KnownWrenchEstimate
) -> Series:
    rig, inverse = calibration.rig, calibration.inverse
    assert log.reference is not None
    wrench = np.full_like(log.reference, np.nan)
    rows = estimate.rows[k]
    wrench[rows] = log.reference[rows]
    felt = at_reference_temperature(calibration.offset_temperature, rig, log).raw - estimate.offsets[k]
    measured = felt @ inverse.T
    left = float(estimate.freedom.mean()) / max(1, sum(rows.size for rows in estimate.rows))
    return replace(
        placed,
        time=log.time,
        wrench=wrench,
        measured=measured,
        residual=measured - wrench,
        sigma=np.sqrt(left * np.diag(inverse @ estimate.row_noise[k] @ inverse.T)),
        noise=np.sqrt(np.diag(estimate.row_noise[k])),
        left=np.full(rig.sensor.n, left),
        left_out=tuple((float(t), float(t)) for t in log.time[estimate.outliers[k]]),
    )


def _of_motion(calibration: Calibration, placed: Series, log: Log) -> Series:
    """For estimators that keep no motion."""
    rig, shown = calibration.rig, log
    if len(log.time_ns) > _MOST:
        stretches = held_out([log], _MOST / len(log.time_ns))[1]
        shown = stretches[0] if stretches else log
    first = float((shown.time_ns[0] - log.time_ns[0]) * 1e-9)
    try:
        found = residuals(calibration, rig, shown)
    except InputError:  # too short, or no motion: the report says so
        return placed
    whole = replace(
        placed,
        time=shown.time[found.rows] + first,
        wrench=found.wrench,
        measured=found.wrench + found.new,
        residual=found.new,
        sigma=np.sqrt(found.noise),
        noise=rig.sensor.noise_array,
    )
    return _broken(whole, np.array(found.begin[1:], dtype=np.int64))


def _broken(series: Series, breaks: Integers) -> Series:
    """With a NaN before these rows, so that nothing is drawn across them."""

    def cut(values: Array) -> Array:
        return np.insert(values, breaks, np.nan, axis=0)

    return replace(
        series,
        time=cut(series.time),
        wrench=cut(series.wrench),
        measured=cut(series.measured),
        residual=cut(series.residual),
        discrepancy=None if series.discrepancy is None else cut(series.discrepancy),
        channels=cut(series.channels) if len(series.channels) else series.channels,
        sigma=cut(series.sigma) if series.sigma.ndim == 2 else series.sigma,
    )


def _runs(time: Array, marked: Mask) -> tuple[Span, ...]:
    """Begin and end of every run of marked rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]])))
    return tuple((float(time[a]), float(time[b - 1])) for a, b in edges.reshape(-1, 2))
