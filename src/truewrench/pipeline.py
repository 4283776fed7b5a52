"""From rig and logs to a calibration: estimate, judge, and put together what is said about it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.arm.track import tracked
from truewrench.assembly import assemble, assemble_windows, window_figures
from truewrench.calibration import Bound, Calibration, LogReport, Verdict
from truewrench.compensation import uncompensated
from truewrench.errors import InputError, UnsupportedError
from truewrench.estimate.attempts import Attempts
from truewrench.estimate.clock import clock_doubts, delay_excluded
from truewrench.estimate.ekf import estimate_ekf
from truewrench.estimate.fits import ENOUGH, fitted_share, mostly_unexplained
from truewrench.estimate.least_squares import least_squares
from truewrench.estimate.moving_offset import end_notes, jump_notes
from truewrench.estimate.noise import hidden_delay, noise_figures, noise_notes
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.estimation.bound import oracle_rms
from truewrench.estimation.known_wrench import estimate_from_known_wrench
from truewrench.evidence import Evidence
from truewrench.known_wrench import (
    compare_known_wrench,
    judge_known_wrench,
    known_wrench_figures,
    known_wrench_reports,
    wrench_is_known,
)
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.validation.comparison import Comparison, compare_held_out, compare_in_sample
from truewrench.verdict import judge_reference, judge_windows
from truewrench.verdict.silence import still_bases, still_twists

__all__ = ["calibrate"]

Array = NDArray[np.float64]
EstimatorName = Literal["map", "online", "ekf", "ls"]
Progress = Callable[[str, float | None], None]
Show = Callable[[Evidence], None]


def calibrate(
    rig: Rig,
    logs: Log | Sequence[Log],
    estimator: EstimatorName = "map",
    *,
    window: float | None = None,
    threads: int | None = None,
    held_out: bool = True,
    rescale_noise: bool = False,
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
        window: shortest window of motion [s]; the default is the core's.
        threads: of the window estimators, all by default; no effect on the result.
        held_out: compare nominal and new gain on a part of the record that a second run of the estimator
            does not see; without it they are compared on what was fitted, in half the time.
        rescale_noise: take the noise of sensor and motion from the residuals, where it was not well known.
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
    if window is not None and not window > 0.0:
        raise InputError.at(None, "window", f"{window:g} s", "a positive length")
    _check_supported(rig, estimator)
    _check_options(
        estimator,
        window=window,
        rescale_noise=rescale_noise,
        published=published,
        smooth=smooth,
        process_density=process_density,
    )
    report = progress or (lambda phase, share: None)
    show = evidence or (lambda found: None)
    started = time.perf_counter()
    records = uncompensated(rig, tracked(rig, records))
    if wrench_is_known(rig, records, estimator):
        if window is not None:
            raise UnsupportedError.at(None, "window", f"{window:g} s", "nothing for logs with ref_* columns")
        return _from_known_wrench(rig, records, held_out, report, show)
    _check_motion(rig, estimator)
    report(f"estimating ({estimator})", None)
    if estimator == "map" or estimator == "online":
        return _from_windows(rig, records, estimator, window, threads, held_out, rescale_noise, report, show)
    return _from_reference(rig, records, estimator, published, smooth, process_density, started, show)


def _from_windows(
    rig: Rig,
    logs: Sequence[Log],
    estimator: Literal["map", "online"],
    window: float | None,
    threads: int | None,
    held_out: bool,
    rescale_noise: bool,
    report: Progress,
    show: Show,
) -> Calibration:
    settings = _core.EstimatorSettings()
    settings.window = settings.window if window is None else window
    settings.threads = threads or 0
    clock = [time.perf_counter()]
    attempts = Attempts(logs, estimator, settings)
    found = attempts.explain(rig, rescale_noise)
    estimate, noise = found.estimate, found.noise
    logs = attempts.logs  # cut where their offsets jump
    clock.append(time.perf_counter())
    report("judging", None)

    delay = hidden_delay(rig, noise, logs)
    if not mostly_unexplained(estimate.windows) and fitted_share(estimate.windows) < ENOUGH:
        delay = 0.0  # the colour is that of what disturbs some windows
    if delay > 0.0 and delay_excluded(found.as_found, delay, attempts.quick):
        delay = 0.0
    verdict = judge_windows(rig, estimate, logs, noise, delay, found.moving)
    poor = noise.resized or found.moving is not None or mostly_unexplained(estimate.windows)
    if verdict.usable or poor:  # a delay spoils a good sensor's fit
        begun = partial(attempts.begun_at, estimate)
        doubts = clock_doubts(found.rig if noise.resized else found.as_found, logs, begun)
        verdict = replace(verdict, usable=verdict.usable and not doubts, reasons=(*verdict.reasons, *doubts))
    calibration = assemble_windows(rig, logs, estimator, estimate, verdict)
    clock.append(time.perf_counter())

    def without_the_part(kept: Sequence[Log]) -> Calibration | None:
        again = attempts.without(kept, found.as_found, estimate)
        return assemble_windows(rig, kept, estimator, again, Verdict(True)) if again.solved else None

    compared: Comparison | str = "not asked for"
    if not estimate.solved or np.isnan(np.concatenate(estimate.wrench)).all():
        compared = "no window of motion fits"
    elif held_out:
        report("comparing", None)
        undisturbed = [estimate.undisturbed(log, k) for k, log in enumerate(logs)]
        compared = compare_held_out(rig, undisturbed, without_the_part)
    if isinstance(compared, str):
        compared = compare_in_sample(rig, logs, estimate, calibration.inverse, compared)
    clock.append(time.perf_counter())
    show(Evidence(tuple(logs), estimate))
    reasons = (*verdict.reasons, *compared.reasons)
    return replace(
        calibration,
        verdict=replace(verdict, usable=not reasons, reasons=reasons),
        improvement=compared.improvement,
        figures={
            **window_figures(rig, estimate),
            "noise": noise_figures(rig, noise),
            "held_out": compared.figures,
            "notes": [
                *_log_notes(logs),
                *still_twists(logs),
                *still_bases(logs),
                *noise_notes(rig, noise),
                *_clock_notes(estimate),
                *jump_notes(rig, attempts.jumps),
                *end_notes(logs, estimate),
            ],
        },
        timings=dict(zip(("estimate", "judge", "compare"), np.diff(clock).tolist(), strict=True)),
    )


def _from_known_wrench(
    rig: Rig, logs: Sequence[Log], held_out: bool, report: Progress, show: Show
) -> Calibration:
    report("estimating (reference wrenches)", None)
    clock = [time.perf_counter()]
    estimate = estimate_from_known_wrench(rig, logs)
    clock.append(time.perf_counter())
    report("judging", None)
    verdict = judge_known_wrench(rig, logs, estimate)
    clock.append(time.perf_counter())
    compared = compare_known_wrench(rig, logs, estimate, held_out)
    clock.append(time.perf_counter())
    show(Evidence(tuple(logs), estimate))
    reasons = (*verdict.reasons, *compared.reasons)
    stated = np.diag(estimate.normalised_covariance)[: 6 * rig.sensor.n]
    wrenches = [
        np.zeros((0, 6)) if log.reference is None else log.reference[rows]
        for log, rows in zip(logs, estimate.rows, strict=True)
    ]
    return assemble(
        rig,
        "reference",
        estimate.gain,
        estimate.covariance,
        replace(verdict, usable=not reasons, reasons=reasons),
        known_wrench_reports(rig, logs, estimate),
        assumed=estimate.findings,
        offset_temperature=estimate.offset_temperature,
        time_offset_std=rig.sensor.time_offset_prior,  # rows are synchronous: nothing was learnt of it
        improvement=compared.improvement,
        bound=Bound(oracle_rms(rig, wrenches), float(np.sqrt(stated.mean()))),
        figures={**known_wrench_figures(rig, logs, estimate), "held_out": compared.figures},
        timings=dict(zip(("estimate", "judge", "compare"), np.diff(clock).tolist(), strict=True)),
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
        LogReport(
            log.path,
            log.sha256,
            log.payload,
            offset,
            offset_std,
            used=int(used),
            dropped_rows=log.dropped_rows,
            nan_counts=log.nan_counts,
        )
        for log, offset, used in zip(logs, offsets, samples, strict=True)
    ]
    return assemble(
        rig,
        estimator,
        gain,
        covariance,
        judge_reference(rig, gain),
        reports,
        figures=figures,
        timings={"estimate": time.perf_counter() - started},
    )


def _clock_notes(estimate: WindowEstimate) -> list[str]:
    if not estimate.clock_untold:
        return []
    return [
        "in this motion a change of time looks like a change of the gain: nothing was learnt of the time "
        f"offset, and sigma contains what its prior leaves ({1e3 * estimate.time_offsets_std[-1]:.2g} ms)"
    ]


def _log_notes(logs: Sequence[Log]) -> list[str]:
    return [f"{log.path}: {note}" for log in logs for note in log.notes]


def _check_supported(rig: Rig, estimator: EstimatorName) -> None:
    def refuse(key: str, found: str, expected: str) -> InputError:
        return UnsupportedError.at(rig.path, key, found, expected)

    if estimator == "map" or estimator == "online":
        return
    sensor = rig.sensor
    if sensor.lowpass_hz is not None:
        found = f"{sensor.lowpass_hz:g}"
        raise refuse("sensor.lowpass_hz", found, f"null: `{estimator}` knows no filtered sensor")
    for key, walk in (("offset_walk", sensor.offset_walk_array.max()), ("gain_walk", sensor.gain_walk)):
        if walk > 0.0:
            raise refuse(f"sensor.{key}", f"{walk:g}", f"0: `{estimator}` knows no drift")


def _check_motion(rig: Rig, estimator: EstimatorName) -> None:
    """Refuse what only logs with a wrench known from elsewhere can be calibrated with."""
    if rig.motion.source == "imu":
        expected = f"`twist` or `joints`: `{estimator}` knows no motion of an IMU"
        raise UnsupportedError.at(rig.path, "motion.source", "`imu`", expected)


def _check_options(estimator: EstimatorName, **options: Any) -> None:
    belongs = {
        "window": ("map", "online"),
        "rescale_noise": ("map", "online"),
        "published": ("ekf",),
        "process_density": ("ekf",),
        "smooth": ("ls",),
    }
    for name, value in options.items():
        if value and estimator not in belongs[name]:
            raise UnsupportedError.at(
                None,
                name,
                f"with estimator `{estimator}`",
                f"this option with `{'` or `'.join(belongs[name])}` only",
            )
