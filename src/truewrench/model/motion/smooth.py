"""The motion behind a logged twist, from the twist alone: where it breaks, and splines through each piece."""

from dataclasses import dataclass, replace
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
    factor: Array  # (6,) on the stated noise that the residuals show, 1 where they show none


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
    """Fit each component by the coarsest quintic spline whose residuals its noise, 1 sigma, explains.

    The number of knot intervals grows by a third from one to about three samples per coefficient, until
    chi-square per degree of freedom is within three standard deviations of 1. Where it is above 1, or never
    there, the noise is larger than stated, and of the fits before the first is taken from which to the last
    chi-square falls by no more than chance.
    Times (N,), N >= 8, are strictly increasing, without gaps [s]; noise (6,), or (N, 6) of each sample.
    """
    sigmas = np.broadcast_to(noise, twist.shape)
    fits = [_fit(time, y, sigma) for y, sigma in zip(twist.T, sigmas.T, strict=True)]
    return SmoothTwist(
        np.column_stack([fit.spline(time) for fit in fits]),
        np.column_stack([fit.spline(time, nu=1) for fit in fits]),
        np.array([(time[-1] - time[0]) / fit.intervals for fit in fits]),
        np.array([fit.factor for fit in fits]),
    )


def uniform_knots(time: Array, intervals: int) -> Array:
    """Knots of a spline on as many equal intervals, (intervals + 1 + 2 * DEGREE,)."""
    inner = np.linspace(time[0], time[-1], intervals + 1)[1:-1]
    return np.concatenate([np.full(DEGREE + 1, time[0]), inner, np.full(DEGREE + 1, time[-1])])


def uniform_spline(time: Array, values: Array, intervals: int, sigma: Array | None = None) -> BSpline:
    """The least-squares spline through samples, of one sigma or of these (N,), on equal intervals."""
    knots = uniform_knots(time, intervals)
    w = None if sigma is None else 1.0 / sigma
    try:  # up to ten times faster than QR and, on equal intervals, as accurate
        return make_lsq_spline(time, values, knots, k=DEGREE, w=w, method="norm-eq")
    except np.linalg.LinAlgError:  # intervals without samples
        return make_lsq_spline(time, values, knots, k=DEGREE, w=w, method="qr")


@dataclass(frozen=True, slots=True)
class _Fit:
    spline: BSpline
    intervals: int
    factor: float = 1.0


def _fit(time: Array, values: Array, sigma: Array) -> _Fit:
    finest = max(1, int(time.size / _SAMPLES_PER_COEFFICIENT) - DEGREE)
    tried: list[tuple[float, _Fit]] = []  # squares over the stated noise
    intervals = 1
    while True:
        spline = uniform_spline(time, values, intervals, sigma)
        squares = float(np.sum(((values - spline(time)) / sigma) ** 2))
        freedom = time.size - intervals - DEGREE
        explained = squares / freedom < 1.0 + 3.0 * np.sqrt(2.0 / freedom)
        if explained or intervals == finest:
            break
        tried.append((squares, _Fit(spline, intervals)))
        intervals = min(finest, max(intervals + 1, int(np.ceil(intervals * 4 / 3))))
    level = max(1.0, squares / freedom)
    factor = 1.0 if explained else float(np.sqrt(level))
    for more, fit in tried:
        knots = intervals - fit.intervals
        if more - squares < level * (knots + 3.0 * np.sqrt(2.0 * knots)):
            return replace(fit, factor=factor)
    return _Fit(spline, intervals, factor)
