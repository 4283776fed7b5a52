"""Gain and offsets from wrenches known from elsewhere, whose errors may last (METHOD 10.5).

Rows are not independent: sensor and reference disagree in the same way for seconds. How large such errors
are, and how long they last, is found (`wrench_errors`); the regression holds noise on both sides
(`wrench_regression`); its covariance contains what is not known of the sizes. docs/method.md, section 12.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truewrench.estimation.assumptions import assumed_gain_prior, assumed_offset_prior
from truewrench.estimation.lasting_errors import Spread, spread_of_sizes, whitened
from truewrench.estimation.reference_clock import ReferenceClock
from truewrench.estimation.wrench_errors import (
    Fit,
    FoundErrors,
    as_stated,
    findings_of,
    fit_with,
    fit_with_found,
    grouped_by,
    parts_of,
    residual_of,
)
from truewrench.estimation.wrench_regression import Problem
from truewrench.estimation.wrench_rows import Rows, rows_by_kind
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.calibration_parts import Assumed
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.temperature import temperature_at


@dataclass(frozen=True, slots=True, eq=False)
class KnownWrenchEstimate:
    """Gain and offsets by weighted total least squares, in SI and raw units."""

    gain: Array  # (n, 6)
    covariance: Array  # (7n, 7n) of [gain row by row, offset of the last log]
    normalised_covariance: Array  # the same, gain_ij range_j / scale_i and offset_i / scale_i
    offsets: Array  # (L, n), one per log
    offsets_std: Array  # (L, n)
    # (n,) slope of the offset per K, None without a temperature column or prior
    offset_temperature: Array | None
    slope_covariance: Array | None  # (n, 8n) of it with [gain row by row, offset of the last log, itself]
    converged: bool  # whether the iterations ended below their tolerance
    iterations: int  # how many
    rows: tuple[Integers, ...]  # per log, the rows with all channels and the whole reference that were used
    incomplete: Integers  # (L,) rows that lack a channel or a component of the reference
    # (L,) rows between plateaus, not used where errors last: what these do there is unknown
    between: Integers
    outliers: tuple[Integers, ...]  # per log, the rows that contradict all others and were left out
    contradicting: int  # rows that would have been, had they not been too many
    # per log, of each used row: whitened residuals squared and summed, n but for what is fitted
    squares: tuple[Array, ...]
    # (n,) of each channel's whitened residuals, over the stated noise unless errors last
    sum_of_squares: Array
    freedom: Array  # (n,) degrees of freedom of it
    spare: Array  # (n,) how many rows, or plateaus, there are beyond what they determine
    errors: tuple[FoundErrors, ...]  # what was found of the errors, per kind of log
    row_noise: Array  # (L, n, n) covariance of raw - gain ref - offset of a row of each log, raw units
    findings: tuple[Assumed, ...]  # what the estimate rests on beside the rig as stated


def estimate_from_known_wrench(
    rig: Rig,
    logs: Sequence[Log],
    errors: Sequence[FoundErrors] | None = None,
    clocks: Sequence[ReferenceClock | None] = (),
) -> KnownWrenchEstimate:
    """Estimate one gain, an offset per log and its slope with temperature from wrenches known from elsewhere.

    Rows are synchronous: raw channels and reference of a row belong together (`with_reference_on_time`, which
    made the `clocks`). Rows that contradict all others by more than chance are left out, one mis-noted
    weight, say. The rig's payloads and motion play no part. Sizes of `errors` may be those of an estimate
    with the same kinds of log; else they are found. InputError: a log without a row that has both sides;
    noise and range too far apart.
    """
    problem, complete, log_of = _problem(rig, logs)
    assert rig.reference_noise is not None
    kinds = rows_by_kind(
        [log.time for log in logs],
        [log.reference for log in logs if log.reference is not None],
        complete,
        np.array(rig.reference_noise),
    )
    stated = tuple(as_stated(rows, rig.sensor.n) for rows in kinds)
    try:
        fit = fit_with(problem, kinds, stated, np.ones(len(problem.raw), dtype=bool))
        if errors is None:
            fit = fit_with_found(problem, kinds, fit)
        elif any(found.found for found in errors):
            told = {found.stepped: found for found in errors}
            fit = fit_with(problem, kinds, tuple(told.get(s.stepped, s) for s in stated), fit.used)
    except np.linalg.LinAlgError as error:
        place = "sensor.range, sensor.noise, reference_noise"
        raise InputError.at(rig.path, place, str(error).lower(), "noise of 1e-12 to 1 of range") from error
    return _result(rig, logs, problem, complete, log_of, kinds, fit, clocks)


def _problem(rig: Rig, logs: Sequence[Log]) -> tuple[Problem, list[Integers], Integers]:
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
            celsius = temperature_at(log, log.time_ns)  # a slower stream: on lines between its readings
            if celsius is None:
                raise InputError.at(log.path, "temperature", "no such column", "one in every log")
            departure.append(celsius - rig.temperature.reference)
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
    std = np.full(mean.shape, assumed_gain_prior(rig))
    std[:, 6:] = assumed_offset_prior(rig)[:, None]
    if with_slope:
        slope = np.concatenate([t[rows] for t, rows in zip(departure, complete, strict=True)])
        columns = np.column_stack([columns, slope])
        std[:, -1] = rig.temperature.prior
    problem = Problem(
        np.concatenate(raw),
        np.concatenate(reference),
        columns,
        np.diag((sensor.noise_array / scale) ** 2),
        np.diag((np.array(rig.reference_noise) / span) ** 2),
        mean,
        std,
    )
    return problem, complete, log_of


def _result(
    rig: Rig,
    logs: Sequence[Log],
    problem: Problem,
    complete: Sequence[Integers],
    log_of: Integers,
    kinds: Sequence[Rows],
    fit: Fit,
    clocks: Sequence[ReferenceClock | None],
) -> KnownWrenchEstimate:
    """In SI and raw units."""
    sensor, solution = rig.sensor, fit.solution
    n, scale, span = sensor.n, sensor.channel_scale, sensor.range_array
    size = problem.mean.shape[1]
    spreads = _spreads(problem, kinds, fit)
    whole = _with_spreads(solution.covariance, spreads, np.diag(solution.noise), problem.exists)
    whole += _of_clocks(problem, solution.parameters, complete, span, clocks)
    offset_of = np.zeros(len(logs), dtype=np.int64) if sensor.pool_offsets else np.arange(len(logs))
    index = np.arange(n * size).reshape(n, size)
    kept = np.concatenate([index[:, :6].ravel(), index[:, 6 + offset_of[-1]]])
    normalised = whole[np.ix_(kept, kept)]
    units = np.append((scale[:, None] / span).ravel(), scale)
    std = np.sqrt(np.diag(whole)).reshape(n, size)
    with_slope = size > 6 + offset_of[-1] + 1
    squares, sums, places = _squares(problem, kinds, fit)
    between = np.ones(fit.used.size, dtype=bool)
    for own in grouped_by(kinds, fit.errors):
        between[own.index] = False
    taken = fit.used & ~between
    count = np.bincount(log_of[taken], minlength=len(logs))
    row_noise = np.empty((len(logs), n, n))
    for found in fit.errors:
        wider = np.sqrt([s.white + s.lasting for s in found.sizes]) * scale
        row_noise[list(found.logs)] = solution.noise * np.outer(wider, wider)
    rows = tuple(own[taken[log_of == k]] for k, own in enumerate(complete))
    outliers = tuple(own[~fit.used[log_of == k]] for k, own in enumerate(complete))
    slope, by_slope = index[:, -1], np.append(units, scale)
    return KnownWrenchEstimate(
        gain=solution.parameters[:, :6] * scale[:, None] / span,
        covariance=normalised * units[:, None] * units,
        normalised_covariance=normalised,
        offsets=(solution.parameters[:, 6 + offset_of] * scale[:, None]).T,
        offsets_std=(std[:, 6 + offset_of] * scale[:, None]).T,
        offset_temperature=solution.parameters[:, -1] * scale if with_slope else None,
        slope_covariance=whole[np.ix_(slope, np.append(kept, slope))] * np.outer(scale, by_slope)
        if with_slope
        else None,
        converged=solution.converged,
        iterations=solution.iterations,
        rows=rows,
        incomplete=np.array([len(log.raw) - len(own) for log, own in zip(logs, complete, strict=True)]),
        between=np.bincount(log_of[between], minlength=len(logs)),
        outliers=outliers,
        contradicting=fit.contradicting,
        squares=tuple(np.split(squares[taken], np.cumsum(count)[:-1])),
        sum_of_squares=sums,
        freedom=np.maximum(1.0, np.count_nonzero(taken) - solution.fitted),
        spare=places - solution.fitted,
        errors=fit.errors,
        row_noise=row_noise,
        findings=findings_of(rig.sensor.channels, solution.noise, fit.errors, spreads, outliers),
    )


def _spreads(problem: Problem, kinds: Sequence[Rows], fit: Fit) -> list[list[Spread]]:
    """Per kind of log and channel; empty where the noise is as stated."""
    solution, stated = fit.solution, np.diag(fit.solution.noise)
    n, size = problem.mean.shape
    exists = problem.exists.reshape(n, size)
    prior = problem.prior.reshape(n, size) * stated[:, None]
    grouped = grouped_by(kinds, fit.errors)
    parts = parts_of(problem, grouped, fit.errors, fit.used)
    products = np.array(
        [
            [E.T @ E for E in (whitened(part.chain, s, Z)[0] for s in part.sizes)]
            for part, Z in zip(parts, solution.designs, strict=True)
        ]
    )  # (kinds, n, size, size)
    found = []
    for k, (rows, part) in enumerate(zip(grouped, parts, strict=True)):
        mask = fit.used[rows.index]
        within = np.sum(rows.apart(residual_of(problem, rows, solution), mask) ** 2, axis=0) / stated
        found.append(
            [
                spread_of_sizes(
                    part.chain,
                    solution.designs[k][:, own],
                    solution.residuals[k][:, i] / np.sqrt(stated[i]),
                    float(within[i]),
                    part.sizes[i],
                    np.diag(prior[i, own]) + (products[:, i].sum(axis=0) - products[k, i])[np.ix_(own, own)],
                )
                for i, own in enumerate(exists)
            ]
            if fit.errors[k].found
            else []
        )
    return found


def _with_spreads(
    covariance: Array, spreads: Sequence[Sequence[Spread]], stated: Array, exists: Mask
) -> Array:
    """The covariance (n p, n p), and what not knowing the sizes of the errors adds to it."""
    whole, size = covariance.copy(), len(exists) // len(stated)
    for of_kind in spreads:
        for i, spread in enumerate(of_kind):
            own = i * size + np.flatnonzero(exists[i * size : (i + 1) * size])
            whole[np.ix_(own, own)] += stated[i] * spread.covariance
    return whole


def _of_clocks(
    problem: Problem,
    parameters: Array,
    complete: Sequence[Integers],
    span: Array,
    clocks: Sequence[ReferenceClock | None],
) -> Array:
    """Covariance (n p, n p) of what clocks leave uncertain: w moved by D moves C by -(X^T X)^-1 X^T D C^T."""
    whole = np.zeros((parameters.size, parameters.size))
    X = np.hstack([problem.reference, problem.columns])
    first = 0
    for clock, rows in zip(clocks, complete, strict=bool(clocks)):
        own = slice(first, first + rows.size)
        first += rows.size
        if clock is None:
            continue
        by = np.zeros((*parameters.shape, clock.covariance.shape[0]))
        for i, there in enumerate(problem.exists.reshape(parameters.shape)):
            Z = X[:, there]
            moved = np.einsum("kjc,j->kc", clock.moved[rows] / span[:, None], parameters[i, :6])
            by[i, there] = -np.linalg.solve(Z.T @ Z, Z[own].T @ moved)
        flat = by.reshape(parameters.size, -1)
        whole += flat @ clock.covariance @ flat.T
    return whole


def _squares(problem: Problem, kinds: Sequence[Rows], fit: Fit) -> tuple[Array, Array, int]:
    """Whitened squares (N,) of each row and (n,) of each channel; and the number of places."""
    solution = fit.solution
    stated = np.diag(solution.noise)
    squares, sums, places = np.zeros(len(problem.raw)), np.zeros(len(stated)), 0
    grouped = grouped_by(kinds, fit.errors)
    parts = parts_of(problem, grouped, fit.errors, fit.used)
    for kind, found, rows, part, v in zip(kinds, fit.errors, grouped, parts, solution.residuals, strict=True):
        mask = fit.used[rows.index]
        # of what was found, nobody knows how channels go together
        inverse = np.diag(1.0 / stated) if found.found else np.linalg.inv(solution.noise)
        E = np.column_stack(
            [whitened(part.chain, s, x[:, None])[0] for s, x in zip(part.sizes, v.T, strict=True)]
        )
        white = np.sqrt([s.white for s in part.sizes])
        within = rows.apart(residual_of(problem, rows, solution), mask) / white
        count = rows.count(mask)
        shared = np.zeros(count.size)
        shared[count > 0.0] = np.sum(E @ inverse * E, axis=1) / count[count > 0.0]
        squares[rows.index] = np.sum(within @ inverse * within, axis=1) + shared[rows.place]
        # white noise of another size than stated is held against the stated one
        size = 1.0 if found.last else np.array([s.white + s.lasting for s in part.sizes])
        sums += size * (np.sum(E**2, axis=0) + np.sum(within**2, axis=0)) / stated
        own = kind.together() if kind.stepped else rows.by_row()
        places += int(np.count_nonzero(own.count(fit.used[own.index])))
    return squares, sums, places
