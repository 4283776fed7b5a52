"""What the window estimators say of gain, offsets and all that they share (docs/method.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.estimate.sources import Sources
from truewrench.log import Log

__all__ = ["GROUPS", "OffsetPath", "PayloadDeparture", "WindowEstimate"]

Array = NDArray[np.float64]

GROUPS = ("force", "moment", "v", "Omega")
"""Residuals that are judged apart; with other than six channels the first holds them all, the second none."""


@dataclass(frozen=True, slots=True)
class PayloadDeparture:
    """What the data say of a payload, as departures from what was stated.

    Attributes:
        mean: (10,) mass, relative; centre of mass [m]; xx yy zz xy xz yz of the inertia, relative to
            sqrt(I_ii I_jj).
        std: (10,) 1 sigma.
    """

    mean: Array
    std: Array


@dataclass(frozen=True, slots=True)
class OffsetPath:
    """The offset of one log in each of the parts over which it is constant.

    Attributes:
        begin: (P,) of the parts [s from the log's first row].
        end: (P,) [s].
        offset: (P, n) [raw units].
    """

    begin: Array
    end: Array
    offset: Array

    def at(self, time: Array) -> Array:
        """(N, n) at times (N,) [s from the log's first row]."""
        part = np.searchsorted(self.begin, time, side="right") - 1
        return np.asarray(self.offset[np.clip(part, 0, None)])


@dataclass(frozen=True, slots=True)
class WindowEstimate:
    """What the windows say of the common parameters, in SI and raw units.

    Attributes:
        gain: (n, 6).
        covariance: (7n, 7n) of [gain row by row, offset of the last log].
        normalised_covariance: the same, gain_ij range_j / scale_i and offset_i / scale_i.
        offsets: (L, n), one per log.
        offsets_std: (L, n).
        time_offsets: (L,) [s], t_motion = t_sensor + time_offset.
        time_offsets_std: (L,).
        payloads: departures from what is stated, per payload that is not exact.
        sources: what the uncertainty of the gain is made of, None when nothing could be solved.
        offset_temperature: (n,) slope of the offset per K, None without a temperature column or prior.
        solved: whether any window left information and the sums could be solved.
        converged: whether the iterations ended below their tolerance.
        windows: one report per window.
        history_time: (W,) end of each window of `online` [s from the start of its log].
        history_log: (W,) which log it belongs to.
        history_gain: (W, n, 6) the gain after it.
        history_std: (W, n, 6).
        wrench: per log, the payload's wrench (M, 6) that the fitted motion predicts, SI, with the rig's
            sign; NaN where no window fits and where a sample was left out.
        wrench_rows: per log, the (M,) rows of the log it belongs to.
        left_out: per log, (M,) whether the sensor's sample was left out as a disturbance.
        motion_left_out: per log, how many samples of the motion were.
        clock_untold: whether the motion does not tell the time offset from the gain: it is known from priors.
        knot_dependence: standard normal deviate of the gain against that of halved knots.
        window_dependence: and against that of doubled windows.
        beginning: for another estimate of these logs, None when nothing could be solved.
        offset_path: per log, how its offset moved; one entry where it is constant.
        iterations: Gauss-Newton steps.
    """

    gain: Array
    covariance: Array
    normalised_covariance: Array
    offsets: Array
    offsets_std: Array
    time_offsets: Array
    time_offsets_std: Array
    payloads: dict[str, PayloadDeparture]
    sources: Sources | None
    offset_temperature: Array | None
    solved: bool
    converged: bool
    windows: tuple[_core.WindowReport, ...]
    history_time: Array
    history_log: NDArray[np.int64]
    history_gain: Array
    history_std: Array
    wrench: tuple[Array, ...]
    wrench_rows: tuple[NDArray[np.int64], ...]
    left_out: tuple[NDArray[np.bool_], ...]
    motion_left_out: tuple[int, ...]
    clock_untold: bool
    knot_dependence: float
    window_dependence: float
    beginning: _core.Start | None
    offset_path: tuple[OffsetPath, ...]
    iterations: int

    @property
    def contributions(self) -> dict[str, Array]:
        """1 sigma of the normalised gain (n, 6) that each source alone accounts for."""
        return {} if self.sources is None else self.sources.sigma()

    def undisturbed(self, log: Log, k: int) -> Log:
        """The k-th log without the sensor's samples that were left out as disturbances."""
        raw = log.raw.copy()
        raw[self.wrench_rows[k][self.left_out[k]]] = np.nan
        return replace(log, raw=raw)
