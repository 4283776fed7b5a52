"""The motion behind a logged twist, from the twist alone: where it breaks, and splines through each piece."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from truewrench.model.arrays import Array, Mask

DEGREE = 5  # of the splines

_SAMPLES_PER_COEFFICIENT = 3.0
_GAP = 5.0  # nominal periods
SILENT = 0.3  # [s] six knots: shorter silences do not cut a record, METHOD 10.6


@dataclass(frozen=True, slots=True)
class SmoothTwist:
    """A twist fitted by one spline per component."""

    twist: Array  # (N, 6)
    acceleration: Array  # (N, 6) its component-wise derivative
    spacing: Array  # (6,) of the knots [s]


def segments(time: Array, shortest: float = 0.0) -> list[slice]:
    """Pieces of a record that no gap of more than five nominal (median) periods and so many s interrupts."""
    steps = np.diff(time)
    if steps.size == 0:
        return [slice(0, time.size)]
    ends = np.concatenate(
        [[0], np.flatnonzero(steps > max(_GAP * np.median(steps), shortest)) + 1, [time.size]]
    )
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def covered(known: Array, at: Array) -> Mask:
    """Whether times (N,) lie between samples of a stream, and in no gap of it."""
    inside = np.zeros(at.size, dtype=np.bool_)
    for piece in segments(known):
        inside |= (at >= known[piece.start]) & (at <= known[piece.stop - 1])
    return inside


def smooth_twist(time: Array, twist: Array, noise: Array) -> SmoothTwist:
    """Fit each component by the coarsest quintic spline whose residuals its noise (6,), 1 sigma, explains.

    The number of knot intervals grows by a third from one to about three samples per coefficient; the first
    whose chi-square per degree of freedom is within three standard deviations of 1 is taken, else the last.
    Times (N,), N >= 8, are strictly increasing, without gaps [s].
    """
    fits = [_fit(time, y, sigma) for y, sigma in zip(twist.T, noise, strict=True)]
    return SmoothTwist(
        np.column_stack([spline(time) for spline, _ in fits]),
        np.column_stack([spline(time, nu=1) for spline, _ in fits]),
        np.array([(time[-1] - time[0]) / intervals for _, intervals in fits]),
    )


def uniform_knots(time: Array, intervals: int) -> Array:
    """Knots of a spline on as many equal intervals, (intervals + 1 + 2 * DEGREE,)."""
    inner = np.linspace(time[0], time[-1], intervals + 1)[1:-1]
    return np.concatenate([np.full(DEGREE + 1, time[0]), inner, np.full(DEGREE + 1, time[-1])])


def uniform_spline(time: Array, values: Array, intervals: int) -> BSpline:
    """The least-squares spline through samples on equal intervals."""
    knots = uniform_knots(time, intervals)
    try:  # up to ten times faster than QR and, on equal intervals, as accurate
        return make_lsq_spline(time, values, knots, k=DEGREE, method="norm-eq")
    except np.linalg.LinAlgError:  # intervals without samples
        return make_lsq_spline(time, values, knots, k=DEGREE, method="qr")


def _fit(time: Array, values: Array, sigma: float) -> tuple[BSpline, int]:
    finest = max(1, int(time.size / _SAMPLES_PER_COEFFICIENT) - DEGREE)
    intervals = 1
    while True:
        spline = uniform_spline(time, values, intervals)
        freedom = time.size - intervals - DEGREE
        chi_square = float(np.sum(((values - spline(time)) / sigma) ** 2) / freedom)
        if intervals == finest or chi_square < 1.0 + 3.0 * np.sqrt(2.0 / freedom):
            return spline, intervals
        intervals = min(finest, max(intervals + 1, int(np.ceil(intervals * 4 / 3))))
