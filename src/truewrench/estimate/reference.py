"""Gain and offsets from wrenches known from elsewhere: weighted total least squares (docs/method.md).

Raw channels and reference wrench are both noisy, `raw = C w + b + e` and `ref = w + d`, and every row has a
wrench w of its own. Row by row the likelihood is largest at

    w_k = ref_k + G v_k,    v_k = raw_k - C ref_k - b,    G = D C^T S^-1,    S = R + C D C^T

with R and D the covariances of e and d. At the truth v_k ~ N(0, S) is independent of that w_k, whose error
has the covariance Q = D - G C D. So regressing with w_k is unbiased where regressing with ref_k is not. What
the rows say of a direction of w in which they vary little more than by Q is mostly noise, though: the
regressor is w_k times the share of its scatter that is not noise, and the covariance of the estimate follows
from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.stats import chi2

from truewrench.errors import InputError
from truewrench.log import Log
from truewrench.rig import Rig

__all__ = ["MOST_OUTLIERS", "ReferenceEstimate", "estimate_from_reference"]

Array = NDArray[np.float64]

MOST_OUTLIERS = 0.1  # share of the rows that may be left out as outliers; of more, none is
_OUTLIER = 1e-3  # probability that any row of a record without outliers is taken for one
_CHANCE = 1e-3  # probability that noise alone is taken for a direction in which the wrench varies
_ITERATIONS = 100
_STEP = 1e-5  # of sigma, at which the iterations end
_ROUNDS = 20  # of leaving out rows and estimating again


@dataclass(frozen=True, slots=True)
class ReferenceEstimate:
    """Gain and offsets by weighted total least squares, in SI and raw units.

    Attributes:
        gain: (n, 6).
        covariance: (7n, 7n) of [gain row by row, offset of the last log].
        normalised_covariance: the same, gain_ij range_j / scale_i and offset_i / scale_i.
        offsets: (L, n), one per log.
        offsets_std: (L, n).
        offset_temperature: (n,) slope of the offset per K, None without a temperature column or prior.
        converged: whether the iterations ended below their tolerance.
        iterations: how many.
        rows: per log, the rows with all channels and the whole reference that were used.
        incomplete: (L,) rows that lack a channel, a component of the reference or the temperature.
        outliers: per log, the rows that contradict all others and were left out.
        contradicting: rows that would have been, had they not been too many.
        sum_of_squares: (n,) of each channel's residuals over their noise.
        freedom: (n,) degrees of freedom of it.
    """

    gain: Array
    covariance: Array
    normalised_covariance: Array
    offsets: Array
    offsets_std: Array
    offset_temperature: Array | None
    converged: bool
    iterations: int
    rows: tuple[NDArray[np.int64], ...]
    incomplete: NDArray[np.int64]
    outliers: tuple[NDArray[np.int64], ...]
    contradicting: int
    sum_of_squares: Array
    freedom: Array


@dataclass(frozen=True, slots=True)
class _Problem:
    """All logs in normalised units: channels over their scale, wrenches over their range."""

    raw: Array  # (N, n)
    reference: Array  # (N, 6)
    columns: Array  # (N, m) one per offset, then temperature: what multiplies the other parameters
    raw_noise: Array  # (n, n) R
    reference_noise: Array  # (6, 6) D
    mean: Array  # (n, 6 + m) prior of [C, offsets, slope]
    std: Array  # (n, 6 + m), 0 where a parameter does not exist


@dataclass(frozen=True, slots=True)
class _Solution:
    parameters: Array  # (n, 6 + m)
    covariance: Array  # of them, row by row
    residual: Array  # (N, n) v of all rows, used or not
    residual_noise: Array  # (n, n) S
    leverage: Array  # (N,) variance of the fitted row over that of its residual
    freedom: Array  # (n,)
    converged: bool
    iterations: int


def estimate_from_reference(rig: Rig, logs: Sequence[Log]) -> ReferenceEstimate:
    """Estimate one gain, an offset per log and its slope with temperature from wrenches known from elsewhere.

    Rows are synchronous: raw channels and reference of a row belong together, and a time offset is not
    estimated. Rows that contradict all others by more than chance are left out, one mis-noted weight, say.

    Args:
        rig: sensor with its priors, `reference_noise`; payloads and motion play no part.
        logs: with reference columns.

    Raises:
        InputError: for a log without a row that has both sides.
    """
    problem, complete, log_of = _problem(rig, logs)
    used = np.ones(len(problem.raw), dtype=bool)
    contradicting = 0
    solution = _solve(problem, used)
    for _ in range(_ROUNDS):
        kept = _consistent(solution, used)
        contradicting = int(np.count_nonzero(~kept))
        if contradicting > max(1, int(MOST_OUTLIERS * kept.size)):
            used[:] = True
            solution = _solve(problem, used)
            break
        if np.array_equal(kept, used):
            contradicting = 0
            break
        used = kept
        solution = _solve(problem, used)

    sensor = rig.sensor
    n, scale, span = sensor.n, sensor.channel_scale, sensor.range_array
    size = problem.mean.shape[1]
    offset_of = np.zeros(len(logs), dtype=np.int64) if sensor.pool_offsets else np.arange(len(logs))
    index = np.arange(n * size).reshape(n, size)
    kept_parameters = np.concatenate([index[:, :6].ravel(), index[:, 6 + offset_of[-1]]])
    normalised = solution.covariance[np.ix_(kept_parameters, kept_parameters)]
    units = np.append((scale[:, None] / span).ravel(), scale)
    std = np.sqrt(np.diag(solution.covariance)).reshape(n, size)
    with_slope = size > 6 + offset_of[-1] + 1
    v = solution.residual[used]
    return ReferenceEstimate(
        gain=solution.parameters[:, :6] * scale[:, None] / span,
        covariance=normalised * units[:, None] * units,
        normalised_covariance=normalised,
        offsets=(solution.parameters[:, 6 + offset_of] * scale[:, None]).T,
        offsets_std=(std[:, 6 + offset_of] * scale[:, None]).T,
        offset_temperature=solution.parameters[:, -1] * scale if with_slope else None,
        converged=solution.converged,
        iterations=solution.iterations,
        rows=tuple(rows[used[log_of == k]] for k, rows in enumerate(complete)),
        incomplete=np.array([len(log.raw) - len(rows) for log, rows in zip(logs, complete, strict=True)]),
        outliers=tuple(rows[~used[log_of == k]] for k, rows in enumerate(complete)),
        contradicting=contradicting,
        sum_of_squares=np.sum(v**2, axis=0) / np.diag(solution.residual_noise),
        freedom=solution.freedom,
    )


def _problem(rig: Rig, logs: Sequence[Log]) -> tuple[_Problem, list[NDArray[np.int64]], NDArray[np.int64]]:
    """The rows of all logs that have both sides, which rows of each log these are, and whose each row is."""
    sensor = rig.sensor
    scale, span = sensor.channel_scale, sensor.range_array
    with_slope = rig.temperature.prior > 0.0 and any(log.temperature is not None for log in logs)
    raw, reference, departure, complete = [], [], [], []
    for log in logs:
        if log.reference is None or rig.reference_noise is None:
            expected = "ref_fx ... ref_mz, and `reference_noise` in the rig"
            raise InputError.at(log.path, "", "no reference wrench", expected)
        needed = [log.raw, log.reference]
        if with_slope:
            if log.temperature is None:
                raise InputError.at(log.path, "temperature", "no such column", "one in every log")
            needed.append(log.temperature[:, None])
            departure.append(log.temperature - rig.temperature.reference)
        rows = np.flatnonzero(np.isfinite(np.column_stack(needed)).all(axis=1))
        if rows.size == 0:
            found = "no row with all raw channels and all of ref_fx ... ref_mz"
            raise InputError.at(log.path, "", found, "at least one")
        complete.append(rows)
        raw.append(log.raw[rows] / scale)
        reference.append(log.reference[rows] / span)
    count = [rows.size for rows in complete]
    log_of = np.repeat(np.arange(len(logs)), count)
    offset_of = np.zeros_like(log_of) if sensor.pool_offsets else log_of
    columns = (offset_of[:, None] == np.arange(offset_of[-1] + 1)).astype(np.float64)
    mean = np.zeros((sensor.n, 6 + columns.shape[1] + with_slope))
    mean[:, :6] = sensor.nominal_gain_array * span / scale[:, None]
    std = np.full(mean.shape, sensor.gain_prior)
    std[:, 6:] = (sensor.offset_prior_array / scale)[:, None]
    if with_slope:
        slope = np.concatenate([t[rows] for t, rows in zip(departure, complete, strict=True)])
        columns = np.column_stack([columns, slope])
        std[:, -1] = rig.temperature.prior
    problem = _Problem(
        np.concatenate(raw),
        np.concatenate(reference),
        columns,
        np.diag((sensor.noise_array / scale) ** 2),
        np.diag((np.array(rig.reference_noise) / span) ** 2),
        mean,
        std,
    )
    return problem, complete, log_of


def _solve(problem: _Problem, used: NDArray[np.bool_]) -> _Solution:
    """Iterate residual noise, regressors and parameters, each given the others."""
    raw, reference, columns = problem.raw[used], problem.reference[used], problem.columns[used]
    R, D = problem.raw_noise, problem.reference_noise
    n, size = problem.mean.shape
    exists = problem.std.ravel() > 0.0
    prior = np.where(exists, problem.std.ravel(), 1.0) ** -2.0
    parameters = problem.mean.copy()
    covariance = np.diag(problem.std.ravel() ** 2)
    Z = np.column_stack([reference, columns])  # to begin with, as if the reference were exact
    converged, iteration = False, 0
    while not converged and iteration < _ITERATIONS:
        C = parameters[:, :6]
        S = noise = R + C @ D @ C.T
        v = raw - np.column_stack([reference, columns]) @ parameters.T
        if iteration > 0:
            G = np.linalg.solve(S, C @ D).T
            Q = D - G @ C @ D
            # errors of the regressor, times what is not known of the gain
            noise = S + np.einsum("iajb,ab->ij", covariance.reshape(n, size, n, size)[:, :6, :, :6], Q)
            Z = np.column_stack([_without_noise(reference + v @ G.T, columns, Q), columns])
        inverse = np.linalg.inv(noise)
        weight = np.kron(inverse, Z.T @ Z)
        gradient = (inverse @ (v.T @ Z)).ravel() + prior * (problem.mean - parameters).ravel()
        information = (weight + np.diag(prior))[np.ix_(exists, exists)]
        inner = np.linalg.inv(information)
        covariance[np.ix_(exists, exists)] = 0.5 * (inner + inner.T)
        step = np.zeros(n * size)
        step[exists] = inner @ gradient[exists]
        parameters = parameters + step.reshape(n, size)
        sigma = np.sqrt(np.diag(inner))
        converged = iteration > 0 and bool(np.all(np.abs(step[exists]) <= _STEP * sigma))
        iteration += 1
    C = parameters[:, :6]
    fitted = (covariance @ weight).diagonal().reshape(n, size).sum(axis=1)
    every = np.column_stack([problem.reference, problem.columns])
    # rows that were left out have a leverage, too: how uncertain their prediction is
    within = np.linalg.pinv(Z.T @ Z, hermitian=True)
    return _Solution(
        parameters,
        covariance,
        problem.raw - every @ parameters.T,
        R + C @ D @ C.T,
        np.sum(every @ within * every, axis=1),
        np.maximum(1.0, len(raw) - fitted),
        converged,
        iteration,
    )


def _without_noise(wrench: Array, columns: Array, noise: Array) -> Array:
    """Each row's wrench (N, 6), its scatter reduced to the share that is not noise.

    In a direction whose scatter chance could have made of the noise alone, nothing is left of it: the gain
    to a wrench that does not vary cannot be told from the offset.
    """
    mean = columns @ np.linalg.lstsq(columns, wrench)[0]
    scatter = wrench - mean
    freedom = len(wrench) - columns.shape[1]
    if freedom < 1:
        return mean
    root = np.linalg.cholesky(noise)
    white = solve_triangular(root, scatter.T, lower=True)
    ratio, axes = np.linalg.eigh(white @ white.T / freedom)
    # largest eigenvalue by chance: Davidson and Szarek's bound
    chance = (1.0 + np.sqrt(6.0 / freedom) + np.sqrt(2.0 * np.log(1.0 / _CHANCE) / freedom)) ** 2
    share = np.where(ratio > chance, 1.0 - 1.0 / ratio, 0.0)
    kept: Array = (root @ (axes * share) @ (axes.T @ white)).T
    return mean + kept


def _consistent(solution: _Solution, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Rows whose residual is within its noise; as long as some is far outside, only the worst are not.

    One gross error bends the fit so that good rows lie outside, too: those are taken back once it is gone.
    """
    v = solution.residual
    squared = np.einsum("ki,ik->k", v, cho_solve(cho_factor(solution.residual_noise), v.T))
    spread = np.where(used, np.maximum(1.0 - solution.leverage, 0.01), 1.0 + solution.leverage)
    statistic = squared / spread
    limit = float(chi2.isf(_OUTLIER / len(v), v.shape[1]))
    return np.asarray(statistic <= max(limit, 0.25 * float(statistic[used].max())))
