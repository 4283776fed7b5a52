"""Normalised squares over time: residuals over their noise, beside what chance alone allows (NIS)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from truewrench import _core
from truewrench.calibration import Calibration
from truewrench.estimate.ekf import EkfEstimate
from truewrench.estimate.reference import ReferenceEstimate
from truewrench.estimate.window_estimate import GROUPS, WindowEstimate
from truewrench.evidence import Evidence
from truewrench.report.series import Record

__all__ = ["CHANCE", "Consistency", "consistency"]

Array = NDArray[np.float64]

CHANCE = 0.01  # of a value outside its bounds where the noise is as stated
_MOST = 400  # values per stream
_STREAMS = {
    "force": "sensor, forces",
    "moment": "sensor, moments",
    "v": "motion, velocities",
    "Omega": "motion, angular velocities",
}


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """Of one stream.

    Attributes:
        name: of the stream.
        begin: (K,) of the stretches that the values belong to, on the common time axis [s].
        end: (K,).
        value: (K,) mean square; 1 is what the noise stands for.
        low: (K,) bounds between which chance keeps 99 of 100.
        high: (K,).
    """

    name: str
    begin: Array
    end: Array
    value: Array
    low: Array
    high: Array

    @property
    def outside(self) -> int:
        """How many values lie outside their bounds."""
        return int(np.count_nonzero((self.value < self.low) | (self.value > self.high)))


def consistency(calibration: Calibration, evidence: Evidence, record: Record) -> tuple[Consistency, ...]:
    """What can be told of each stream; empty where nothing was fitted."""
    estimate = evidence.estimate
    begins = [series.begin for series in record.logs] or [0.0] * len(evidence.logs)
    if isinstance(estimate, WindowEstimate):
        return _of_windows(estimate, begins, calibration.rig.sensor.n)
    if isinstance(estimate, EkfEstimate):
        stamps = [log.time + begin for log, begin in zip(evidence.logs, begins, strict=True)]
        return _in_blocks(
            "innovations", np.concatenate(stamps), estimate.nis, estimate.degrees_of_freedom.astype(float)
        )
    if isinstance(estimate, ReferenceEstimate):
        return _of_reference(calibration, evidence, estimate, record)
    return _of_residuals(record)


def _of_windows(estimate: WindowEstimate, begins: Sequence[float], n: int) -> tuple[Consistency, ...]:
    fitted = [w for w in estimate.windows if w.status == _core.WindowStatus.fitted]
    found = []
    for g, group in enumerate(GROUPS):
        name = "sensor, all channels" if group == "force" and n != 6 else _STREAMS[group]
        rows = [
            (
                w.begin + begins[w.log],
                w.end + begins[w.log],
                w.groups[g].sum_of_squares,
                w.groups[g].count - w.groups[g].leverage,
            )
            for w in fitted
            if w.groups[g].count - w.groups[g].leverage >= 1.0
        ]
        if rows:
            found.append(_bounded(name, *np.array(rows).T))
    return tuple(found)


def _of_reference(
    calibration: Calibration, evidence: Evidence, estimate: ReferenceEstimate, record: Record
) -> tuple[Consistency, ...]:
    """Raw minus what gain and reference give, both noisy: v^T S^-1 v with S = R + C D C^T."""
    rig = calibration.rig
    if not record.logs or rig.reference_noise is None:
        return ()
    C = estimate.gain
    S = np.diag(rig.sensor.noise_array**2) + C @ np.diag(np.array(rig.reference_noise) ** 2) @ C.T
    inverse = np.linalg.inv(S)
    stamps, squares = [], []
    for series, offset, rows in zip(record.logs, estimate.offsets, estimate.rows, strict=True):
        v = series.raw[rows] - series.wrench[rows] @ C.T - offset
        squares.append(np.einsum("ki,ij,kj->k", v, inverse, v))
        stamps.append(series.time[rows] + series.begin)
    total = np.concatenate(squares)
    left = float(np.sum(estimate.freedom)) / max(1, total.size)  # what the unknowns leave of each row's
    return _in_blocks("sensor and reference", np.concatenate(stamps), total, np.full(total.size, left))


def _of_residuals(record: Record) -> tuple[Consistency, ...]:
    """Residuals whose noise is correlated in time count as fewer."""
    stamps, squares, freedom = [], [], []
    for series in record.logs:
        u = series.normalised
        known = np.isfinite(u).all(axis=1)
        variance = np.nanmean(np.broadcast_to(series.sigma, u.shape) ** 2, axis=0) if known.any() else 1.0
        fewer = 1.0 + 2.0 * np.sum((series.lagged[1:] / variance) ** 2, axis=0)
        stamps.append(series.time[known] + series.begin)
        squares.append(np.sum(u[known] ** 2 / fewer, axis=1))
        freedom.append(np.full(int(known.sum()), float(np.sum(1.0 / fewer))))
    if not sum(map(len, stamps)):
        return ()
    return _in_blocks("corrected wrench", *(np.concatenate(x) for x in (stamps, squares, freedom)))


def _in_blocks(name: str, stamps: Array, squares: Array, freedom: Array) -> tuple[Consistency, ...]:
    used = freedom > 0.0
    return (_bounded(name, stamps[used], stamps[used], squares[used], freedom[used]),) if used.any() else ()


def _bounded(name: str, begin: Array, end: Array, squares: Array, freedom: Array) -> Consistency:
    """Sums over neighbours where there are too many to be drawn, and the bounds of their means."""
    starts = np.unique(np.linspace(0, len(begin), min(_MOST, len(begin)), endpoint=False).astype(int))
    last = np.append(starts[1:], len(begin)) - 1
    total, degrees = np.add.reduceat(squares, starts), np.add.reduceat(freedom, starts)
    low, high = (chi2.ppf(q, degrees) / degrees for q in (CHANCE / 2, 1.0 - CHANCE / 2))
    return Consistency(name, begin[starts], end[last], total / degrees, low, high)
