"""A calibration from reference wrenches: its verdict, and nominal against new gain on rows held out."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from truewrench import _core
from truewrench.estimation.assembly import log_report
from truewrench.estimation.assumptions import assumed_gain_prior
from truewrench.estimation.estimate import (
    AGREE,
    Estimate,
    odd_log,
    without_motion,
    worst_of_halves,
    worst_of_logs,
)
from truewrench.estimation.known_wrench import KnownWrenchEstimate, estimate_from_known_wrench
from truewrench.judging import Comparisons, Judgement, judge, setup_errors
from truewrench.judging.validation import CHANGE, LOSS
from truewrench.judging.validation.comparison import Comparison
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration import AXES, AxisImprovement, LogReport
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log, log_name
from truewrench.model.rig import Rig
from truewrench.model.temperature import at_reference_temperature

FOLDS = 5  # each row is held out once
BLOCKS = 4 * FOLDS  # stretches of a log, held out in turns: rows of one load are alike, so they go together
FEWEST = 2 * FOLDS  # rows
FREEDOM = 3.0  # rows or plateaus beyond what the unknowns of a channel follow
DEVIATE_OF_BLOCKS = 3.0  # of the mean difference of squares between the blocks: better or worse, not chance


def wrench_is_known(rig: Rig, logs: Sequence[Log], estimator: str) -> bool:
    """Whether the logs hold reference wrenches, and so need no motion.

    Refused: a rig that does not say how noisy they are, logs some of which lack them, and estimators that do
    not know them.
    """
    without = [log for log in logs if log.reference is None]
    if len(without) == len(logs):
        return False
    if rig.reference_noise is None:
        expected = "six numbers, 1 sigma of ref_fx ... ref_mz, which the log has"
        raise InputError.at(rig.path, "reference_noise", "nothing", expected)
    if without:
        raise InputError.at(
            without[0].path, "", "no ref_* columns", "ref_fx ... ref_mz, as in the other logs"
        )
    if estimator != "map":
        expected = "`map` for logs with ref_* columns"
        raise UnsupportedError.at(None, "estimator", f"`{estimator}`", expected)
    return True


def differing(
    logs: Sequence[Log], p: tuple[Array, Array], between: str, halves: str, within: str
) -> list[str]:
    """Reasons, where one log, or a half of one, tells another gain than the rest by (10.11).

    By `p`, of logs (L,) and of halves (L,); in words what happened `between` logs, how halves are called, and
    what happened `within`.
    """
    reasons = []
    of_logs, of_halves = worst_of_logs(p[0]), worst_of_halves(p[1])
    if not of_logs >= AGREE:  # NaN, too
        names = odd_log(p[0], logs)
        reasons.append(f"{names} tell different gains (p = {of_logs:.1g}): {between}")
    if not of_halves >= AGREE:
        name = log_name(logs, int(np.argmin(p[1])))
        reasons.append(f"{halves} {name} tell different gains (p = {of_halves:.1g}): {within}")
    return reasons


def judge_known_wrench(
    rig: Rig,
    logs: Sequence[Log],
    estimate: KnownWrenchEstimate,
    compared: Comparison,
    p: tuple[Array, Array],
) -> Judgement:
    """The verdict on what reference wrenches say of the gain: of the one function that decides.

    `p`: how likely chance makes each log differ as much from the others (L,), and its second half from the
    first (L,).
    """
    reasons = []
    if not estimate.converged:
        reasons.append("the estimate did not converge")
    if estimate.contradicting:
        total = sum(rows.size for rows in estimate.rows)
        reasons.append(
            f"{estimate.contradicting} of {total} rows contradict the others by more than the stated noise: "
            "too many to be left out as outliers"
        )
    between, within = "sensor or reference changed between logs", "sensor or reference changed"
    reasons += differing(logs, p, between, "the first and the second half of", within)
    if min(estimate.spare) < FREEDOM:
        rows = "plateaus" if any(found.stepped for found in estimate.errors) else "rows"
        reasons.append(
            f"too few {rows} for their residuals to show a mistake: a few more than unknowns are needed"
        )
    held_out = any(axis.held_out for axis in compared.improvement.values())
    gain = _as_estimate(rig, estimate)
    return judge(
        gain,
        Comparisons(
            worse=(*reasons, *compared.reasons),
            not_held_out="" if held_out else str(compared.figures.get("none_because", "")),
            setup=setup_errors(gain, rig, logs),
        ),
        rig,
        logs,
    )


def _as_estimate(rig: Rig, found: KnownWrenchEstimate) -> Estimate:
    """What is judged of it: gain and covariance; there is no motion, and nothing follows a pose."""
    n, count = rig.sensor.n, len(found.offsets)
    return without_motion(
        n,
        count,
        solved=True,
        gain=found.gain,
        covariance=found.covariance,
        normalised_covariance=found.normalised_covariance,
        before_pose=found.normalised_covariance[: 6 * n, : 6 * n],
        gain_prior=np.full(6 * n, assumed_gain_prior(rig)),
        offsets=found.offsets,
        offsets_std=found.offsets_std,
        offset_temperature=found.offset_temperature,
        slope_covariance=found.slope_covariance,
        converged=True,
        iterations=found.iterations,
        fits=1,
    )


def compare_known_wrench(
    rig: Rig, logs: Sequence[Log], estimate: KnownWrenchEstimate, held_out: bool
) -> Comparison:
    """Corrected against reference wrench, by the nominal gain (tared) and by the new one.

    If `held_out`, a fifth of the rows at a time is compared with what the others estimate.
    """
    blocks = [_blocks(len(log.raw), rows) for log, rows in zip(logs, estimate.rows, strict=True)]
    why = "not asked for"
    if held_out and min(rows.size for rows in estimate.rows) < FEWEST:
        held_out, why = False, f"fewer than {FEWEST} rows in a log"
    old, new, block_of = [], [], []
    for fold in range(FOLDS if held_out else 1):
        fitted = estimate
        if held_out:
            left = [
                replace(log, raw=np.where((block % FOLDS == fold)[:, None], np.nan, log.raw))
                for log, block in zip(logs, blocks, strict=True)
            ]
            fitted = estimate_from_known_wrench(rig, left, estimate.errors)
        for k, (log, block) in enumerate(zip(logs, blocks, strict=True)):
            out = (block % FOLDS == fold) & (block >= 0) if held_out else block >= 0
            before, after = _errors(rig, log, fitted, k, np.flatnonzero(out))
            old.append(before)
            new.append(after)
            block_of.append(k * BLOCKS + block[out])
    figures: dict[str, Any] = {"samples": sum(map(len, new)), "folds": FOLDS} if held_out else {}
    if not held_out:
        figures["none_because"] = why
    squares = np.concatenate(old) ** 2, np.concatenate(new) ** 2
    if not np.isfinite(squares).all():
        return Comparison({}, (), figures)
    improvement = improvement_by_axis(*squares, np.concatenate(block_of), held_out)
    worse = worse_on_rows(improvement, rig.required_array) if held_out else ()
    return Comparison(improvement, worse, figures)


def worse_on_rows(improvement: Mapping[str, AxisImprovement], required: Array) -> tuple[str, ...]:
    """Axes on which rows that were held out speak for the nominal gain, in words; of those asked for (6,)."""
    return tuple(
        f"on rows that were held out, {name} is worse than with the nominal gain: an error of {axis.new:.3g} "
        f"instead of {axis.nominal:.3g}"
        for (name, axis), asked in zip(improvement.items(), np.isfinite(required), strict=True)
        if axis.better is False and asked
    )


def known_wrench_figures(rig: Rig, logs: Sequence[Log], estimate: KnownWrenchEstimate) -> dict[str, Any]:
    """What the calibration rests on."""
    sensor = rig.sensor
    posed = _core.conditioning(
        estimate.gain, sensor.noise_array, sensor.nominal_gain_array, sensor.range_array
    )
    chi_square = (estimate.sum_of_squares / estimate.freedom).tolist()
    return {
        "rows": sum(rows.size for rows in estimate.rows),
        "notes": _notes(rig, estimate),
        "chi_square": dict(zip(sensor.channels, chi_square, strict=True)),
        "condition_number": posed.condition_number,
        "departure_norm": posed.departure_norm,
        "iterations": estimate.iterations,
        "outliers": [
            {"log": k, "row": int(row) + 1, "time": float(log.time[row])}
            for k, (log, rows) in enumerate(zip(logs, estimate.outliers, strict=True))
            for row in rows
        ],
    }


def known_wrench_reports(logs: Sequence[Log], estimate: KnownWrenchEstimate) -> list[LogReport]:
    """What each log contributed."""
    reports = []
    for k, log in enumerate(logs):
        masked = {
            "incomplete rows": int(estimate.incomplete[k]),
            "between plateaus": int(estimate.between[k]),
            "contradict the other rows": estimate.outliers[k].size,
        }
        masked = {reason: count for reason, count in masked.items() if count}
        offset, std = estimate.offsets[k], estimate.offsets_std[k]
        reports.append(log_report(log, offset, std, estimate.rows[k].size, masked=masked))
    return reports


def _notes(rig: Rig, estimate: KnownWrenchEstimate) -> list[str]:
    """What was found of errors that last: of which channel, how large, for how long."""
    notes = []
    for found in estimate.errors:
        if not found.last:
            continue
        total = np.sqrt(np.diag(estimate.row_noise[found.logs[0]])) / rig.sensor.channel_scale
        listed = [
            f"{name} {100 * sigma * np.sqrt(s.lasting / (s.white + s.lasting)):.2g}% for {s.time:.2g} s"
            for name, sigma, s in zip(rig.sensor.channels, total, found.sizes, strict=True)
            if s.lasting > 0.0
        ]
        low, high = (float(np.sqrt(limit([s.white for s in found.sizes]))) for limit in (min, max))
        where = f" (log {', '.join(str(k + 1) for k in found.logs)})" if len(estimate.errors) > 1 else ""
        beyond = ", beyond each plateau" if found.stepped else ""
        notes.append(
            f"errors of sensor and reference last{beyond}{where}, 1 sigma in fractions of range: "
            f"{', '.join(listed)}; the white noise beside them is {low:.2g} to {high:.2g} x the stated one; "
            "sigma rests on these sizes"
        )
    return notes


def _blocks(size: int, rows: Integers) -> Integers:
    """(size,) which block each row belongs to, -1 for rows that are not used."""
    blocks = np.full(size, -1, dtype=np.int64)
    blocks[rows] = np.arange(rows.size) * min(BLOCKS, rows.size) // max(1, rows.size)
    return blocks


def _errors(rig: Rig, log: Log, fitted: KnownWrenchEstimate, k: int, out: Integers) -> tuple[Array, Array]:
    """Corrected minus reference wrench of rows, with the nominal and with the fitted gain, (M, 6) each."""
    assert log.reference is not None
    sensor = rig.sensor
    nominal = _core.generalised_inverse(sensor.nominal_gain_array, sensor.noise_array)
    try:
        inverse = _core.generalised_inverse(np.ascontiguousarray(fitted.gain), sensor.noise_array)
    except ValueError:
        inverse = np.full((6, sensor.n), np.nan)
    before = log.raw @ nominal.T - log.reference
    if sensor.offset_prior_array.any():
        before = before - before[fitted.rows[k]].mean(axis=0)
    raw = at_reference_temperature(fitted.offset_temperature, rig, log).raw[out]
    return before[out], (raw - fitted.offsets[k]) @ inverse.T - log.reference[out]


def improvement_by_axis(
    old: Array, new: Array, blocks: Integers, held_out: bool
) -> Mapping[str, AxisImprovement]:
    """Squared errors (M, 6) compared per axis; the scatter between blocks says what chance alone does."""
    order = np.unique(blocks, return_inverse=True)[1]
    count = np.bincount(order)
    difference = np.array([np.bincount(order, column) / count for column in (old - new).T])  # (6, B)
    chance = difference.std(axis=1) / np.sqrt(max(1, count.size - 1))
    improvement = {}
    for axis, b, a, mean, limit in zip(
        AXES,
        np.sqrt(old.mean(axis=0)),
        np.sqrt(new.mean(axis=0)),
        difference.mean(axis=1),
        DEVIATE_OF_BLOCKS * chance,
        strict=True,
    ):
        better: Literal[True, False, "unsure"] = "unsure"
        if abs(mean) > limit and not b / (1.0 + CHANGE) <= a <= b * (1.0 + LOSS):
            better = bool(a < b)
        improvement[axis] = AxisImprovement(float(b), float(a), held_out, better)
    return improvement
