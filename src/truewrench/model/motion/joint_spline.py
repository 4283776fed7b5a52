"""Splines through joint positions and velocities together, on the coarsest knots that both accept."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.sparse import csr_array, diags_array

from truewrench.model.arrays import Array
from truewrench.model.motion.trajectory_joint import JointCurves

_DEGREE = 5
_SAMPLES_PER_COEFFICIENT = 3.0
_FINER = 1.3  # from one spacing to the next
_STIFFNESS = 1e-12  # of what no sample determines, relative to the largest element


@dataclass(frozen=True, slots=True)
class JointSpline(JointCurves):
    """Quintic splines of n joints, `spacing` [s] from knot to knot."""

    spacing: float

    def shifted(self, by: Array) -> JointSpline:
        """The same motion from other positions: plus (n,)."""
        return JointSpline(BSpline(self.spline.t, self.spline.c + by, _DEGREE), self.spacing)

    @property
    def begin(self) -> float:
        """First time [s]."""
        return float(self.spline.t[0])

    @property
    def end(self) -> float:
        """Last time [s]."""
        return float(self.spline.t[-1])


def fit_joints(
    positions: tuple[Array, Array, Array],
    velocities: tuple[Array, Array],
    sigma_position: Array,
    sigma_velocity: Array,
    wider: float = 1.0,
) -> JointSpline:
    """Fit positions and velocities, each at its own times and over its sigma (n,).

    Positions are times (N,), values (N, n) and weights (N,) of 1 over their share of sigma, velocities times
    (M,) and values (M, n). N or M may be 0; without positions the spline is known but for a constant, and
    starts at zero. Its knots are `wider` than the coarsest whose residuals the noise explains: that which is
    stated, or where no knots make it so, that of the finest knots' residuals.
    """
    time_q, _, _ = positions
    time_qd, _ = velocities
    ends = [t[[0, -1]] for t in (time_q, time_qd) if t.size]
    begin, end = float(min(e[0] for e in ends)), float(max(e[1] for e in ends))
    samples = max(time_q.size, time_qd.size)
    finest = max(1, int(samples / _SAMPLES_PER_COEFFICIENT) - _DEGREE)
    coarsest = min(finest, max(1, int((end - begin) / 4.0)))

    @cache  # the ladder is climbed twice where noise is larger than stated
    def fit(intervals: int) -> tuple[BSpline, Array, float]:
        return _fit(positions, velocities, sigma_position, sigma_velocity, begin, end, intervals)

    intervals, level = coarsest, np.ones(sigma_position.size)
    while True:
        spline, squares, freedom = fit(intervals)
        if np.all(squares < level * (freedom + 3.0 * np.sqrt(2.0 * freedom))):
            break
        if intervals == finest:  # noise larger than stated, which finer knots would follow: judged by itself
            intervals, level = coarsest, np.maximum(1.0, squares / freedom)
            continue
        intervals = min(finest, int(np.ceil(intervals * _FINER)))
    if wider > 1.0 and intervals > 1:
        intervals = max(1, round(intervals / wider))
        spline, _, _ = fit(intervals)
    return JointSpline(spline, (end - begin) / intervals)


def _fit(
    positions: tuple[Array, Array, Array],
    velocities: tuple[Array, Array],
    sigma_position: Array,
    sigma_velocity: Array,
    begin: float,
    end: float,
    intervals: int,
) -> tuple[BSpline, Array, float]:
    """The spline on uniform knots, the squares (n,) of its residuals over their noise, and their freedom."""
    time_q, q, weight = positions
    time_qd, qd = velocities
    breakpoints = np.linspace(begin, end, intervals + 1)
    knots = np.concatenate([np.full(_DEGREE, begin), breakpoints, np.full(_DEGREE, end)])
    size, joints = intervals + _DEGREE, sigma_position.size
    of_q = _values(time_q, knots)
    of_qd = _slopes(time_qd, knots)
    by_q, by_qd = of_q.T @ diags_array(weight**2) @ of_q, of_qd.T @ of_qd
    coefficients = np.empty((size, joints))
    for j in range(joints):
        a, b = sigma_position[j] ** -2.0, sigma_velocity[j] ** -2.0
        normal = a * by_q + b * by_qd
        band = np.zeros((_DEGREE + 1, size))
        for k in range(_DEGREE + 1):
            band[k, : size - k] = normal.diagonal(-k)
        band[0] += _STIFFNESS * band[0].max()
        if time_q.size == 0:
            band[0, 0] += band[0].max()
        right = a * (of_q.T @ (weight**2 * q[:, j])) + b * (of_qd.T @ qd[:, j])
        coefficients[:, j] = solveh_banded(band, right, lower=True)
    squares = np.sum((weight[:, None] * (q - of_q @ coefficients) / sigma_position) ** 2, axis=0)
    squares += np.sum(((qd - of_qd @ coefficients) / sigma_velocity) ** 2, axis=0)
    freedom = max(1.0, float(np.count_nonzero(weight == 1.0) + time_qd.size - size))
    return BSpline(knots, coefficients, _DEGREE), squares, freedom


def _values(time: Array, knots: Array) -> csr_array:
    """(N, coefficients) of the basis functions."""
    if time.size == 0:
        return csr_array((0, knots.size - _DEGREE - 1))
    return csr_array(BSpline.design_matrix(time, knots, _DEGREE))


def _slopes(time: Array, knots: Array) -> csr_array:
    """(N, coefficients) of their derivatives."""
    size = knots.size - _DEGREE - 1
    if time.size == 0:
        return csr_array((0, size))
    lower = csr_array(BSpline.design_matrix(time, knots[1:-1], _DEGREE - 1))
    per_step = _DEGREE / (knots[_DEGREE + 1 : -1] - knots[1 : -_DEGREE - 1])
    difference = diags_array(np.array([-per_step, per_step]), offsets=[0, 1], shape=(size - 1, size))
    return csr_array(lower @ difference)
