"""A calibration from motion: estimate, compare, judge, and put together what is said about it."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from truewrench import _core
from truewrench.calibrating.hopeless import hopeless, plain_gain
from truewrench.calibrating.pooled import Pooled, estimate_pooled, moving_logs
from truewrench.calibrating.unknown_bodies import (
    known_logs,
    known_payload,
    notes_on_bodies,
    scale_unknown,
    with_first_guess,
)
from truewrench.estimation.assembly import assemble_motion, log_notes, motion_figures
from truewrench.estimation.clock_rate import clock_rates, with_rate, with_weight_told
from truewrench.estimation.colour import without_filters
from truewrench.estimation.estimate import Estimate, undisturbed
from truewrench.estimation.estimator import unsolved
from truewrench.estimation.evidence import Evidence
from truewrench.estimation.far_clock import set_within, with_clock_set
from truewrench.estimation.vibration import without_vibrations
from truewrench.judging import Comparisons, findings, judge, setup_errors
from truewrench.judging.validation.comparison import (
    BLOCKS,
    SHARE,
    Comparison,
    compare_held_out,
    compare_in_sample,
    compare_on,
)
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration, Verdict
from truewrench.model.channels import still_motion
from truewrench.model.log import Log, log_name
from truewrench.model.rig import Rig
from truewrench.robot.compensation import restamped, with_weight_on_time

_RATES = 3  # times that clocks are set
_SHORT = 120.0  # [s] in which 100 ppm are 12 ms, a step of what is asked

Progress = Callable[[str, float | None], None]
Show = Callable[[Evidence], None]


def calibrate_from_motion(
    rig: Rig,
    logs: Sequence[Log],
    estimator: Literal["map", "online"],
    threads: int | None,
    held_out: bool,
    report: Progress,
    show: Show,
) -> Calibration:
    """The calibration from logs of which at least one moves; arguments as of `calibrate`."""
    clock = [time.perf_counter()]
    online = estimator == "online"
    places, logged = moving_logs(rig, logs), logs
    logs = [
        without_filters(rig, without_vibrations(rig, restamped(rig, log, partial(with_clock_set, rig))))
        if k in places
        else log
        for k, log in enumerate(logs)
    ]
    moving = [logs[k] for k in places]
    stated, rig = rig, with_first_guess(rig, moving)
    known = known_logs(rig, moving)
    refused = hopeless(rig, moving, known)
    if refused:
        pooled = Pooled(unsolved(rig, logs), places)
    else:
        logs, pooled = with_weight_on_time(
            rig, logs, lambda weighed: _at_one_rate(rig, weighed, threads or 0, online), _time_offsets
        )
    estimate = pooled.estimate
    clock.append(time.perf_counter())
    provisional = assemble_motion(rig, logs, estimator, estimate, Verdict(True))

    compared: Comparison | str = "not asked for"
    if not estimate.solved:
        compared = "nothing of the record could be fitted"
    elif not estimate.follows:
        compared = "the record does not follow its motion"
    elif not estimate.parts_agree:
        compared = "the parts of the record disagree"
    elif held_out and not known:
        compared = "no payload is known, by which the gains could be compared"
    elif held_out:
        report("comparing", None)
        compared = _compare_on_unseen(rig, logs, pooled, estimator, threads or 0)
    if isinstance(compared, str):
        compared = compare_in_sample(rig, logs, estimate, provisional.inverse, compared)
    clock.append(time.perf_counter())
    report("judging", None)
    worse = [*scale_unknown(rig, logs), *pooled.worse(rig, logs, held_out)]
    if estimate.solved and (not estimate.parts_agree or estimate.masked_share() > _core.MOST_LOST):
        worse += _set_within(rig, logs, places)
    comparisons = replace(_comparisons(estimate, compared, rig, worse, known, refused), logged=tuple(logged))
    judgement = judge(estimate, comparisons, rig, logs)
    assumed = (*findings(estimate, rig, logs), *pooled.assumed())
    clock.append(time.perf_counter())
    show(Evidence(tuple(logs), estimate))
    return replace(
        provisional,
        rig=stated,
        logs=pooled.reports(logs, provisional.logs),
        verdict=judgement.verdict,
        axes=judgement.axes,
        assumed=assumed,
        improvement=compared.improvement,
        figures={
            **motion_figures(rig, estimate),
            **pooled.figures(),
            "held_out": compared.figures,
            "notes": [
                *log_notes(logs),
                *estimate.notes,
                *_gates(rig),
                *still_motion(moving),
                *judgement.notes,
                *notes_on_bodies(rig, logs, estimate.payloads),
            ],
        },
        timings=dict(zip(("estimate", "compare", "judge"), np.diff(clock).tolist(), strict=True)),
    )


def _compare_on_unseen(
    rig: Rig, logs: Sequence[Log], pooled: Pooled, estimator: Literal["map", "online"], threads: int
) -> Comparison | str:
    """With a part held out, of the logs that move with a known payload."""
    known = [k for k in pooled.moving if known_payload(rig, logs[k])]

    def assembled(of: Sequence[Log], again: Estimate) -> Calibration | None:
        return assemble_motion(rig, of, estimator, again, Verdict(True)) if again.solved else None

    if pooled.parts is not None:
        parts = pooled.parts
        out = parts.held_out([pooled.moving.index(k) for k in known], SHARE, BLOCKS)
        if not out:
            return "too few parts of the record follow their motion to hold one out"
        share = sum(parts.parts[i].samples for i in out) / sum(part.samples for part in parts.parts)
        without = assembled(parts.logs, parts.estimate(out))
        return compare_on(rig, [parts.unseen(parts.parts[i]) for i in out], without, share)

    def without_the_part(kept: Sequence[Log]) -> Calibration | None:
        of = [*kept, *(log for k, log in enumerate(logs) if k not in known)]
        again = estimate_pooled(rig, of, threads=threads, online=estimator == "online")
        return assembled(of, again.estimate)

    found = pooled.estimate
    left_out = {k: found.rows[k].rows[found.rows[k].masked] for k in known}
    whole = [undisturbed(logs[k], left_out[k], found.steps[k]) for k in known]
    return compare_held_out(rig, whole, without_the_part)


def _set_within(rig: Rig, logs: Sequence[Log], places: Sequence[int]) -> list[str]:
    """Logs in which a clock was set, in words; not long ones: where clocks run apart, their ends do."""
    short = [k for k in places if logs[k].time[-1] < _SHORT]
    by = {k: later for k in short if (later := set_within(rig, logs[k])) != 0.0}
    return [
        f"the sensor's clock was set within {log_name(logs, k)}: at its end it is {1e3 * abs(later):.0f} ms "
        f"{'later' if later > 0.0 else 'earlier'} than at its beginning; cut the log there"
        for k, later in by.items()
    ]


def _time_offsets(found: tuple[Sequence[Log], Pooled]) -> tuple[Array, Array]:
    """Of the logs as they are estimated from, and their 1 sigma."""
    estimate = found[1].estimate
    late = np.array([clocks[0].late if clocks else 0.0 for clocks in estimate.clocks])
    return -late, estimate.time_offsets_std


def _at_one_rate(rig: Rig, logs: Sequence[Log], threads: int, online: bool) -> tuple[Sequence[Log], Pooled]:
    """The estimate, anew while clocks are found to run at different rates, and its logs."""
    logs, pooled = _brought_together(rig, logs, threads, online)
    return logs, replace(pooled, estimate=with_weight_told(rig, logs, pooled.estimate))


def _brought_together(
    rig: Rig, logs: Sequence[Log], threads: int, online: bool
) -> tuple[Sequence[Log], Pooled]:
    pooled = estimate_pooled(rig, logs, threads=threads, online=online)
    if pooled.parts is not None:  # which have set them
        told = dict(zip(pooled.moving, pooled.parts.logs, strict=True))
        return [told.get(k, log) for k, log in enumerate(logs)], pooled
    before = np.zeros(len(logs))
    for _ in range(_RATES):
        rates = clock_rates(rig, logs, pooled.estimate)
        if not rates.any():
            break
        # what is left falls by the same share each time, as the motion follows the other
        share = np.divide(rates, before, out=np.zeros_like(rates), where=before != 0.0)
        before = rates / (1.0 - np.clip(share, 0.0, 0.8))
        changed = [
            restamped(rig, log, partial(with_rate, rate=r)) if r != 0.0 else log
            for log, r in zip(logs, before, strict=True)
        ]
        again = estimate_pooled(rig, changed, threads=threads, online=online)
        # errors of a fast tumbling under a precise sensor look like one: 2 of 600 clean records
        if not again.estimate.solved or again.estimate.deviance > pooled.estimate.deviance:
            break
        logs, pooled = changed, again
    return logs, pooled


def _comparisons(
    estimate: Estimate,
    compared: Comparison,
    rig: Rig,
    worse: Sequence[str],
    known: Sequence[Log],
    refused: Sequence[str],
) -> Comparisons:
    held_out = any(axis.held_out for axis in compared.improvement.values())
    return Comparisons(
        worse=(*compared.reasons, *worse),
        not_held_out="" if held_out else str(compared.figures.get("none_because", "nothing was compared")),
        # of bodies that nobody knows, nothing tells a wrong unit from a wrong mass
        setup=setup_errors(estimate, rig, known, partial(plain_gain, rig, known))
        if estimate.solved and known
        else (),
        hopeless=tuple(refused),
    )


def _gates(rig: Rig) -> list[str]:
    """What is worth saying of fractions of range that look like per cent."""
    asked = rig.required_array
    largest = {
        "required": float(np.max(asked[np.isfinite(asked)], initial=0.0)),
        "sensor.gain_prior": rig.sensor.gain_prior,
    }
    return [
        f"`{key}` is {value:g}, and so {100.0 * value:g}% of range: 0.02 is 2%"
        for key, value in largest.items()
        if value >= 1.0
    ]
