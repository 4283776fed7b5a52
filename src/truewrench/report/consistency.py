"""Normalised squares over time: residuals over their noise, beside what chance alone allows (NIS)."""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from truewrench.estimation.ekf import EkfEstimate
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.evidence import Evidence
from truewrench.estimation.known_wrench import KnownWrenchEstimate
from truewrench.model.arrays import Array
from truewrench.report.series import Record, groups_of

CHANCE = 0.01  # of a value outside its bounds where the noise is as expected
_MOST = 150  # values per stream
_NAMES = {"force": "sensor, forces", "moment": "sensor, moments", "channels": "sensor, all channels"}


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """Of one stream."""

    name: str  # of the stream
    begin: Array  # (K,) of the blocks of time that the values belong to, on the common axis [s]
    end: Array  # (K,)
    value: Array  # (K,) mean square; 1 is what the noise stands for
    low: Array  # (K,) bounds between which chance keeps 99 of 100
    high: Array  # (K,)

    @property
    def outside(self) -> int:
        """How many values lie outside their bounds."""
        return int(np.count_nonzero((self.value < self.low) | (self.value > self.high)))


def consistency(evidence: Evidence, record: Record) -> tuple[Consistency, ...]:
    """What can be told of each stream; empty where nothing was fitted, or its noise is not white."""
    estimate = evidence.estimate
    begins = [series.begin for series in record.logs]
    if isinstance(estimate, Estimate):
        return _of_channels(record)
    if isinstance(estimate, EkfEstimate):
        stamps = [log.time + begin for log, begin in zip(evidence.logs, begins, strict=True)]
        freedom = estimate.degrees_of_freedom.astype(float)
        return _in_blocks("innovations", np.concatenate(stamps), estimate.nis, freedom)
    if isinstance(estimate, KnownWrenchEstimate):
        stamps = [
            log.time[rows] + begin
            for log, rows, begin in zip(evidence.logs, estimate.rows, begins, strict=True)
        ]
        squares = np.concatenate(estimate.squares)
        left = float(estimate.freedom.sum()) / max(1, squares.size)  # what the unknowns leave of each row's
        every = np.full(squares.size, left)
        return _in_blocks("sensor and reference", np.concatenate(stamps), squares, every)
    return ()


def _of_channels(record: Record) -> tuple[Consistency, ...]:
    """Residuals of a group of channels over the noise found, less what the fit follows of it."""
    found: list[Consistency] = []
    for group, channels in groups_of(record.logs[0].noise.size).items():
        stamps, squares, freedom = [], [], []
        for series in record.logs:
            u = (series.channels / series.noise)[:, channels]
            known = np.isfinite(u)
            stamps.append(series.time + series.begin)
            squares.append(np.nansum(u**2, axis=1))
            freedom.append(known @ series.left[channels])
        found += _in_blocks(_NAMES[group], *(np.concatenate(x) for x in (stamps, squares, freedom)))
    return tuple(found)


def _in_blocks(name: str, stamps: Array, squares: Array, freedom: Array) -> tuple[Consistency, ...]:
    """Sums over neighbours, and the bounds of their means; nothing where there are none."""
    stamps, squares, freedom = (x[freedom > 0.0] for x in (stamps, squares, freedom))
    if not stamps.size:
        return ()
    starts = np.unique(np.linspace(0, stamps.size, min(_MOST, stamps.size), endpoint=False).astype(int))
    last = np.append(starts[1:], stamps.size) - 1
    total, degrees = np.add.reduceat(squares, starts), np.add.reduceat(freedom, starts)
    low, high = (chdtri(degrees, q) / degrees for q in (1.0 - CHANCE / 2, CHANCE / 2))
    return (Consistency(name, stamps[starts], stamps[last], total / degrees, low, high),)
