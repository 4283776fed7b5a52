"""From rig and logs to a calibration: estimate, judge, and put together what is said about it."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from truewrench.calibrating.from_motion import Progress, Show, calibrate_from_motion
from truewrench.calibrating.known_wrench import (
    compare_known_wrench,
    judge_known_wrench,
    known_wrench_figures,
    known_wrench_reports,
    wrench_is_known,
)
from truewrench.calibrating.still_agreement import agreement_of_still
from truewrench.calibrating.still_poses import (
    compare_still,
    estimate_still,
    judge_still,
    only_still,
    still_figures,
    still_reports,
)
from truewrench.calibrating.unknown_bodies import (
    known_payload,
    notes_on_bodies,
)
from truewrench.estimation.assembly import assemble, assemble_motion, log_notes, log_report
from truewrench.estimation.bound import oracle_rms
from truewrench.estimation.ekf import estimate_ekf
from truewrench.estimation.evidence import Evidence
from truewrench.estimation.known_wrench import estimate_from_known_wrench
from truewrench.estimation.least_squares import least_squares
from truewrench.estimation.log_agreement import agreement_of_known_halves, agreement_of_known_wrenches
from truewrench.estimation.reference_clock import with_reference_on_time
from truewrench.judging import of_references
from truewrench.model.calibration import Bound, Calibration, Verdict
from truewrench.model.channels import motion_columns
from truewrench.model.errors import InputError, UnsupportedError, check_word
from truewrench.model.log import Log
from truewrench.model.repeats import without_repeats
from truewrench.model.rig import Rig
from truewrench.robot.attitude import check_fall
from truewrench.robot.compensation import uncompensated
from truewrench.robot.parts import unwrapped
from truewrench.robot.track import tracked

EstimatorName = Literal["map", "online", "ekf", "ls"]
_REFERENCES = ("ekf", "ls")


def calibrate(
    rig: Rig,
    logs: Log | Sequence[Log],
    estimator: EstimatorName = "map",
    *,
    threads: int | None = None,
    held_out: bool = True,
    published: bool = False,
    smooth: Literal["spline"] | None = None,
    process_density: float | None = None,
    progress: Progress | None = None,
    evidence: Callable[[Evidence], None] | None = None,
) -> Calibration:
    """Calibrate gain and offset of a rig's sensor from one log or several.

    Logs with reference wrenches need no motion: they are calibrated from by weighted total least squares.

    Args:
        rig: sensor, payloads and motion.
        logs: pooled into one gain, with an offset for each (or one for all: `sensor.pool_offsets`).
        estimator: `map`, `online`, or one of the references `ekf` and `ls`, whose verdict is never usable.
        threads: of `map` and `online`, all by default; no effect on the result.
        held_out: compare nominal and new gain on a part of the record that a second run of the estimator
            does not see; without it they are compared on what was fitted, in half the time.
        published: `ekf` starts from C = I and P = I in SI units.
        smooth: `ls` differentiates a spline and not the samples.
        process_density: of `ekf`.
        progress: called with a phase and the share of it that is done, if known.
        evidence: called once with what the calibration rests on, for a report.

    Raises:
        InputError: for logs that do not fit the rig.
        UnsupportedError: for settings that no estimator can honour yet.
    """
    records = [logs] if isinstance(logs, Log) else list(logs)
    if not records:
        raise InputError.at(None, "", "no log", "at least one")
    check_word("estimator", estimator, get_args(EstimatorName))
    check_word("smooth", smooth or "", ("", "spline"))
    if process_density is not None and not 0.0 <= process_density <= 1e12:
        raise InputError.at(None, "process_density", f"{process_density}", "a number from 0 to 1e12")
    for log in records:
        log.check_sizes(1e300, raw=False)  # differences overflow; what else is too large cannot be solved
        if rig.in_gravity and log.reference is None:
            check_fall(rig, log)
    if estimator not in _REFERENCES:  # `tracked` unwraps those of the others
        records = [without_repeats(unwrapped(rig, log)) for log in records]
    _check_sensor(rig, estimator)
    _check_options(
        estimator,
        published=published,
        smooth=smooth,
        process_density=process_density,
    )
    report = progress or (lambda phase, share: None)
    show = evidence or (lambda found: None)
    started = time.perf_counter()
    if estimator in _REFERENCES or rig.sensor.subtracted is not None:
        records = tracked(rig, records)
    records = uncompensated(rig, records)
    if wrench_is_known(rig, records, estimator):
        return _from_known_wrench(rig, records, held_out, report, show)
    rig.check_motion("or reference wrenches in the log")
    _check_motion(rig, records, estimator)
    if estimator == "map" and only_still(rig, records):
        return _from_still_poses(rig, records, held_out, report, show)
    report(f"estimating ({estimator})", None)
    if estimator == "map" or estimator == "online":
        return calibrate_from_motion(rig, records, estimator, threads, held_out, report, show)
    return _from_reference(rig, records, estimator, published, smooth, process_density, started, show)


def _from_known_wrench(
    rig: Rig, logs: Sequence[Log], held_out: bool, report: Progress, show: Show
) -> Calibration:
    report("estimating (reference wrenches)", None)
    for log in logs:
        log.check_channels()
    clock = [time.perf_counter()]
    on_time = [with_reference_on_time(rig, log) for log in logs]
    logs, clocks = [log for log, _ in on_time], [found for _, found in on_time]
    estimate = estimate_from_known_wrench(rig, logs, clocks=clocks)
    clock.append(time.perf_counter())
    report("comparing", None)
    compared = compare_known_wrench(rig, logs, estimate, held_out)
    clock.append(time.perf_counter())
    report("judging", None)
    p_logs = agreement_of_known_wrenches(rig, logs, estimate, clocks)
    p_halves = agreement_of_known_halves(rig, logs, estimate, clocks)
    judgement = judge_known_wrench(rig, logs, estimate, compared, (p_logs, p_halves))
    clock.append(time.perf_counter())
    show(Evidence(tuple(logs), estimate))
    stated = np.diag(estimate.normalised_covariance)[: 6 * rig.sensor.n]
    wrenches = [
        np.zeros((0, 6)) if log.reference is None else log.reference[rows]
        for log, rows in zip(logs, estimate.rows, strict=True)
    ]
    figures = known_wrench_figures(rig, logs, estimate)
    notes = [*log_notes(logs), *figures.pop("notes"), *judgement.notes]
    return assemble(
        rig,
        "reference",
        estimate.gain,
        estimate.covariance,
        judgement.verdict,
        known_wrench_reports(logs, estimate),
        offset_temperature=estimate.offset_temperature,
        offset_temperature_covariance=estimate.slope_covariance,
        time_offset_std=rig.sensor.time_offset_prior,  # of a motion: nothing was learnt of it
        axes=judgement.axes,
        assumed=(*of_references(logs, clocks), *estimate.findings),
        improvement=compared.improvement,
        bound=Bound(oracle_rms(rig, wrenches), float(np.sqrt(stated.mean()))),
        figures={
            **figures,
            "held_out": compared.figures,
            "notes": notes,
        },
        timings=dict(zip(("estimate", "compare", "judge"), np.diff(clock).tolist(), strict=True)),
    )


def _from_still_poses(
    rig: Rig, logs: Sequence[Log], held_out: bool, report: Progress, show: Show
) -> Calibration:
    report("estimating (static poses)", None)
    clock = [time.perf_counter()]
    found = estimate_still(rig, logs)
    estimate = found.estimate
    clock.append(time.perf_counter())
    report("comparing", None)
    compared = compare_still(rig, logs, found, held_out)
    clock.append(time.perf_counter())
    judgement = judge_still(rig, logs, found, compared, agreement_of_still(rig, logs, found))
    clock.append(time.perf_counter())
    show(Evidence(tuple(logs), estimate))
    provisional = assemble_motion(rig, logs, "map", estimate, judgement.verdict)
    return replace(
        provisional,
        logs=tuple(still_reports(logs, found)),
        time_offset_std=rig.sensor.time_offset_prior,  # at rest nothing tells it
        axes=judgement.axes,
        assumed=found.hidden.assumed(),
        improvement=compared.improvement,
        figures={
            **still_figures(found),
            "held_out": compared.figures,
            "notes": [
                *log_notes(logs),
                *judgement.notes,
                *notes_on_bodies(rig, logs, estimate.payloads),
            ],
        },
        timings=dict(zip(("estimate", "compare", "judge"), np.diff(clock).tolist(), strict=True)),
    )


def _from_reference(
    rig: Rig,
    logs: Sequence[Log],
    estimator: Literal["ekf", "ls"],
    published: bool,
    smooth: Literal["spline"] | None,
    process_density: float | None,
    started: float,
    show: Show,
) -> Calibration:
    figures: dict[str, Any] = {}
    if estimator == "ekf":
        ekf = estimate_ekf(rig, logs, published=published, process_density=process_density)
        show(Evidence(tuple(logs), ekf))
        gain, covariance, offsets, samples = ekf.gain, ekf.covariance, ekf.offsets, ekf.samples
        figures["nis"] = float(ekf.nis.sum() / max(1, int(ekf.degrees_of_freedom.sum())))
    else:
        ls = least_squares(rig, logs, smooth)
        show(Evidence(tuple(logs), ls))
        gain, covariance, offsets, samples = ls.gain, ls.covariance, ls.offsets, ls.samples
        figures["chi_square"] = ls.chi_square.tolist()
    n = rig.sensor.n
    offset_std = np.sqrt(np.diag(covariance)[6 * n :])
    reports = [
        log_report(log, offset, offset_std, int(used))
        for log, offset, used in zip(logs, offsets, samples, strict=True)
    ]
    return assemble(
        rig,
        estimator,
        gain,
        covariance,
        Verdict(False, ("reference estimator",)),
        reports,
        figures=figures,
        timings={"estimate": time.perf_counter() - started},
    )


def _check_sensor(rig: Rig, estimator: EstimatorName) -> None:
    """Refuse sensors that a reference does not know."""
    lowpass = rig.sensor.lowpass_hz
    if estimator in _REFERENCES and lowpass is not None:
        expected = f"null: `{estimator}` knows no filtered sensor"
        raise UnsupportedError.at(rig.path, "sensor.lowpass_hz", f"{lowpass:g}", expected)


def _check_motion(rig: Rig, logs: Sequence[Log], estimator: EstimatorName) -> None:
    """Refuse what was never measured, and motions and bodies that a reference does not know."""
    for log in logs if rig.motion.source != "joints" else ():
        for name, column in motion_columns(log):
            if not np.isfinite(column).any():
                expected = "a number in at least one row"
                raise InputError.at(log.path, f"column `{name}`", "not one number", expected)
    if estimator not in _REFERENCES:
        return
    if rig.motion.source == "imu":
        expected = f"`twist` or `joints`: `{estimator}` knows no motion of an IMU"
        raise UnsupportedError.at(rig.path, "motion.source", "`imu`", expected)
    fused = rig.motion.acceleration_noise is not None and any(log.acceleration is not None for log in logs)
    drifts = rig.temperature.prior != 0.0 and any(log.temperature is not None for log in logs)
    for key, unsupported, found, stated in (
        ("motion.acceleration_noise", fused, "a value, and accelerations in a log", "none"),
        ("temperature.prior", drifts, f"{rig.temperature.prior:g}, and temperatures in a log", "0"),
    ):
        if unsupported:
            raise UnsupportedError.at(rig.path, key, found, f"{stated}: `{estimator}` knows no other")
    for log in logs:
        if not known_payload(rig, log):
            expected = f"a known payload: `{estimator}` takes it as exact"
            raise UnsupportedError.at(rig.path, f"payloads.{log.payload}", "an unknown body", expected)


def _check_options(estimator: EstimatorName, **options: Any) -> None:
    belongs = {"published": "ekf", "process_density": "ekf", "smooth": "ls"}
    for name, value in options.items():
        if value and estimator != belongs[name]:
            expected = f"this option with `{belongs[name]}` only"
            raise UnsupportedError.at(None, name, f"with estimator `{estimator}`", expected)
