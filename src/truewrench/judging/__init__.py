"""Judgement, apart from the estimate (METHOD 10.7): one function decides whether it may be used."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truewrench import _core
from truewrench.estimation.estimate import AGREE, Estimate, odd_log
from truewrench.estimation.undetermined import undetermined_directions
from truewrench.judging.advice import Disturbed, advice
from truewrench.judging.blind import blind_to
from truewrench.judging.setup_odds import Suspicion, gross_errors, setup_errors
from truewrench.judging.words import (
    CHANNELS,
    MOST,
    findings,
    kinds_of_disagreement,
    kinds_of_disturbances,
    likeliest_fast,
    listed,
    looks_fast,
    looks_slow,
    motion_scatter,
    of_references,
    plural,
    scatter,
    slow_found,
    slow_stands,
)
from truewrench.model.arrays import Array, Mask
from truewrench.model.calibration_parts import AXES, Undetermined, Verdict
from truewrench.model.channels import channel_faults, still_bases, still_motion
from truewrench.model.log import Log, log_name
from truewrench.model.rig import Rig

__all__ = [
    "Comparisons",
    "Judgement",
    "Suspicion",
    "blind_to",
    "findings",
    "gross_errors",
    "judge",
    "of_references",
    "setup_errors",
]

CONDITION = 100.0  # of the normalised gain, beyond which it is told: words only
SURE = 20.0  # nats of the odds of a set-up error: the order of words only
SINGULAR = 1e12  # that only rounding keeps from infinity: tolerance
QUIET = 0.1  # times the stated noise, below which what is refused may have been smoothed: words only
CHANGED, PARTWAY = 25.0, 3.0  # nats of halves against chance, times those of quarters: words only
LOUD = 2.0  # times the stated noise, from which on a motion stream is the one that departs: words only


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Held-out comparison, or why there is none, and suspected set-up errors."""

    worse: tuple[str, ...] = ()  # why, by that, the new gain should not replace the nominal one, in words
    # why nothing was held out, in words; empty where something was. It is always told.
    not_held_out: str = ""
    setup: tuple[Suspicion, ...] = ()  # `setup_errors` of the estimate
    hopeless: tuple[str, ...] = ()  # why nothing was estimated, in words: `joint_faults`, `gross_errors`
    # as they were read, where the estimate is of logs without filters: an undone filter leaves no rail as it
    # was, and makes one of coarse readings
    logged: Sequence[Log] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What is decided on an estimate."""

    verdict: Verdict  # usable, reasons, undetermined directions, and what the record could not have shown
    # which wrench axes may be used: the gains of all channels to it are as accurate as `required`, and
    # nothing but the accuracy of other axes speaks against the result. An axis that is not asked for is not
    # vouched for.
    axes: Mapping[str, bool]
    notes: tuple[str, ...] = ()  # what decides nothing and has to be said


def judge(estimate: Estimate, comparisons: Comparisons, rig: Rig, logs: Sequence[Log]) -> Judgement:
    """Whether an estimate may be used, on which axes, and every reason why not.

    Usable: solved, resolved, some gain determined; at most 20% of the raw output explained by no motion;
    every required gain as accurate as `required`, (10.9) and (10.10) within; no set-up test fails, no channel
    is dead or at a rail; at most 20% masked; the parts of the record agree, and data that were held out do
    not say that the nominal gain is better.
    """
    n = rig.sensor.n
    required = rig.required_array
    faults = channel_faults(rig, comparisons.logged or logs)
    silent = sorted({fault.channel for fault in faults if fault.silent})
    undetermined = _undetermined(estimate, rig, silent)
    reasons = [fault.words for fault in faults]
    unexplained = _unexplained(estimate, rig, logs)
    of_record: list[str] = []
    named: list[str] = []  # kinds, over all reasons
    if comparisons.hopeless:
        reasons += comparisons.hopeless
    elif unexplained or not estimate.solved:  # what else was found is no more than what nothing explains
        reasons += still_motion(logs) or unexplained or _unsolved(estimate, logs)
    else:
        of_record = _of_record(estimate, rig, logs, named)
        reasons += of_record
        if len(undetermined) == 6 * n:
            reasons += still_motion(logs) or [_nothing_learnt(estimate)]
        elif not _determined(estimate, n).any():
            reasons.append(_nothing_told(estimate, rig, logs, named))
    if estimate.solved and not silent:  # whose gains look like any mistake
        suspicions = _suspicions(estimate, comparisons, rig, logs, named, alone=not of_record)
        # a mistake that is sure comes before what it does to the record; none is beside something slow which
        # the fit is without, as always that of `online`: it makes payloads of itself
        told = slow_stands(estimate) or not slow_found(estimate)
        sure = bool(comparisons.setup) and comparisons.setup[0].log_odds > SURE and told
        reasons = [*suspicions, *reasons] if sure else [*reasons, *suspicions]
    reasons += comparisons.worse
    std = _std(estimate, n)
    std[silent] = 0.0  # no further reason is needed
    accurate = np.array([bool(np.all(std[:, j] <= required[j])) for j in range(6)])
    axes = dict(zip(AXES, (accurate & np.isfinite(required) & (not reasons)).tolist(), strict=True))
    if not accurate.all() and estimate.solved and not unexplained and len(undetermined) < 6 * n:
        reasons.append(_accuracy(estimate, rig, logs, std, required, accurate, named))
    if reasons and estimate.solved:
        reasons = [*_smoothed(estimate, logs), *reasons]
    verdict = Verdict(not reasons, tuple(reasons), undetermined, blind_to(estimate, rig))
    return Judgement(verdict, axes, tuple(_notes(estimate, comparisons, rig, logs)))


def _std(estimate: Estimate, n: int) -> Array:
    """(n, 6) 1 sigma of the normalised gain; what is not a number is not known."""
    variance = np.diag(estimate.normalised_covariance)[: 6 * n]
    known = np.where(np.isfinite(variance) & (variance >= 0.0), variance, np.inf)
    return np.asarray(np.sqrt(known)).reshape(n, 6)


def _determined(estimate: Estimate, n: int) -> Mask:
    """(n, 6) of which gains the data tell more than their prior, as `Calibration.gain_determined`."""
    prior = np.asarray(estimate.gain_prior)[: 6 * n].reshape(n, 6)
    return np.asarray(_std(estimate, n) <= _core.UNDETERMINED * prior)


def _undetermined(estimate: Estimate, rig: Rig, silent: Sequence[int]) -> tuple[Undetermined, ...]:
    """The directions, those of channels with a signal first."""
    n = rig.sensor.n
    heard, dead = [], []
    for u in undetermined_directions(estimate.before_pose, estimate.gain_prior, rig.sensor.channels):
        size = np.abs(u.direction.reshape(n, 6)).max(axis=1)
        if np.delete(size, silent).max(initial=0.0) > 0.1:
            heard.append(u)
        else:
            name = rig.sensor.channels[int(np.argmax(size))]
            dead.append(replace(u, words=f"gains of {name}, which has no signal"))
    return (*heard, *dead)


def _unsolved(estimate: Estimate, logs: Sequence[Log]) -> list[str]:
    """Why nothing could be solved."""
    dropped = [
        f"{log_name(logs, k)}, of {logs[k].time.max(initial=0.0):.3g} s, has no stretch that tells a motion "
        f"({count} shorter than 12 knots; are its stamps of that unit?)"
        for k, count in enumerate(estimate.dropped)
        if count
    ]
    return dropped or [
        "the record could not be solved: it holds no stretch in which the sensor and its motion were both "
        "logged long enough, in all of them hardly anything moved, or what it shows is orders of magnitude "
        "from what is stated of its noise"
    ]


def _unexplained(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> list[str]:
    """Which logs do not follow their motion."""
    return [
        f"the raw output of {log_name(logs, int(k))} does not follow its motion: "
        f"{100 * estimate.unexplained[k]:.0f}% of what it does is explained by no motion of the payload (is "
        "the motion that of another run? are the clocks far apart? does something else push? was it tared?); "
        f"{_largest_departure(estimate, rig, logs)}"
        for k in np.flatnonzero(estimate.unexplained > _core.MOST_LOST)
    ]


def _largest_departure(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> str:
    """Of a channel at its worst sample, or of a motion stream that is noisier than the sensor is."""
    sensor = rig.sensor
    noise = sensor.noise_array / sensor.channel_scale
    worst, words = 0.0, "no departure stands out"
    for k, rows in enumerate(estimate.rows):
        y = np.abs(np.nan_to_num(rows.residual + rows.discrepancy, nan=0.0, posinf=0.0, neginf=0.0))
        if y.size == 0:
            continue
        row, i = np.unravel_index(int(np.argmax(y / noise)), y.shape)
        if y[row, i] / noise[i] > worst:
            worst = float(y[row, i] / noise[i])
            words = (
                f"largest departure: channel {sensor.channels[i]}, {100 * y[row, i]:.2g}% of range at"
                f" {rows.time[row]:.4g} s of {log_name(logs, k)}, {worst:.2g} x its sigma"
            )
    factors = [(found.factor, found.what, k) for k, of in enumerate(estimate.noise) for found in of]
    sensed = max((f for f, what, _ in factors if what in CHANNELS and np.isfinite(f)), default=1.0)
    moved = max(((f, w, k) for f, w, k in factors if w not in CHANNELS and np.isfinite(f)), default=None)
    if moved is not None and moved[0] > max(LOUD, sensed):
        words = (
            f"largest departure: the motion, {moved[1]} of {log_name(logs, moved[2])} scatter "
            f"{moved[0]:.2g} times as stated all along"
        )
    return words


def _smoothed(estimate: Estimate, logs: Sequence[Log]) -> list[str]:
    """Of a record that is refused, the noise that it should have and has not."""
    factors = [(found.factor, found.what, k) for k, of in enumerate(estimate.noise) for found in of]
    factor, what, k = min(factors, default=(1.0, "", 0))
    if not factor < QUIET:
        return []
    return [
        f"noise of the {plural(what)} of {log_name(logs, k)} is {factor:.2g} x the stated: smoothed after it "
        "was sampled (a long mean, filtfilt)? Log it as it was sampled, or state the noise that it has"
    ]


def _suspicions(
    estimate: Estimate,
    comparisons: Comparisons,
    rig: Rig,
    logs: Sequence[Log],
    named: list[str],
    *,
    alone: bool,
) -> list[str]:
    """Mistakes of the set-up; where they alone speak, what else may look like one."""
    out = [suspicion.words for suspicion in comparisons.setup]
    if out and alone and slow_found(estimate):
        kinds = _named(looks_slow(estimate, rig, logs), named)
        out[0] += f"; or a slow disturbance that looks like one: {kinds}"
    return out


def _nothing_learnt(estimate: Estimate) -> str:
    nothing = "nothing was learnt: no direction of the gain is known better than before; "
    swing = 0.0
    if np.isfinite(estimate.ww).all():
        swing = float(np.sqrt(np.maximum(np.diag(estimate.ww), 0.0)).max(initial=0.0))
    if swing == 0.0:  # of poses and references, which are known by what changes from one to the next
        return nothing + "the wrench was nearly the same in all of it"
    return f"{nothing}the payload's wrench is {100 * swing:.2g}% of range (RMS of its largest axis)"


def _nothing_told(estimate: Estimate, rig: Rig, logs: Sequence[Log], named: list[str]) -> str:
    if not slow_found(estimate):
        return "nothing was told of any gain: none is known to half of what was believed of it before"
    return (
        "nothing was told of any gain: beside what may follow the pose "
        f"({_named(looks_slow(estimate, rig, logs), named)}) none is known to half of what was believed of "
        "it before"
    )


def _of_record(estimate: Estimate, rig: Rig, logs: Sequence[Log], named: list[str]) -> list[str]:
    """What of the record speaks against the result: unresolved, masked, in disagreement; a singular gain."""
    reasons = []
    for k in np.flatnonzero(estimate.unresolved):
        reasons.append(
            f"the motion of {log_name(logs, int(k))} is not resolved: a knot a sample still fits better "
            f"({_named(looks_fast(estimate, rig, logs), named)}); {_largest_departure(estimate, rig, logs)}"
        )
    share = estimate.masked_share()
    if share > _core.MOST_LOST:
        kinds = _named(kinds_of_disturbances(estimate, rig, logs), named)
        reasons.append(
            f"{100 * share:.0f}% of the sensor's samples were left out as {kinds}: too many to trust it;"
            f" {_largest_departure(estimate, rig, logs)}"
        )
    p = {
        "halves": estimate.p_halves,
        "quarters 1 + 3 and 2 + 4": estimate.p_quarters,
        odd_log(estimate.p_logs, logs): estimate.p_worst_log,
    }
    parts = [f"{name}, p = {value:.1g}" for name, value in p.items() if not value >= AGREE]  # NaN, too
    if parts:
        changed = ", or sensor or payload changed between logs" if not estimate.p_worst_log >= AGREE else ""
        partway = (
            "the payload slipped or the sensor changed partway, or " if _changed_partway(estimate) else ""
        )
        reasons.append(
            f"parts of the record disagree on the gain ({'; '.join(parts)}): {partway}something does not fit "
            f"the model ({_named(kinds_of_disagreement(estimate, rig, logs), named)}){changed}; "
            f"{_largest_departure(estimate, rig, logs)}"
        )
    if not _condition(estimate, rig) < SINGULAR:
        reasons.append("the gain is singular: some wrench leaves no trace in the channels")
    return reasons


def _changed_partway(estimate: Estimate) -> bool:
    """Whether halves differ by far more than quarters in turn, which a change has both sides of.

    Of 32 records with a slip, or a step of the gain, in their middle 28; of 56 with cables, hysteresis,
    drift, links that are off or foreign velocities 3.
    """
    halves, quarters = (
        -float(np.log(max(p, np.finfo(np.float64).tiny))) for p in (estimate.p_halves, estimate.p_quarters)
    )
    return halves > CHANGED and halves > PARTWAY * quarters


def _named(kinds: Sequence[str], named: list[str]) -> str:
    """As many of these kinds, likeliest first, as leave three over all reasons; the first in any case."""
    named += [kind for kind in kinds if kind not in named][: max(0, MOST - len(named))]
    return listed([kind for kind in kinds if kind in named] or kinds[:1])


def _condition(estimate: Estimate, rig: Rig) -> float:
    sensor = rig.sensor
    if not np.isfinite(estimate.gain).all():
        return float("inf")
    gain = np.ascontiguousarray(estimate.gain)
    posed = _core.conditioning(gain, sensor.noise_array, sensor.nominal_gain_array, sensor.range_array)
    return float(posed.condition_number)


def _accuracy(
    estimate: Estimate,
    rig: Rig,
    logs: Sequence[Log],
    std: Array,
    required: Array,
    accurate: Mask,
    named: list[str],
) -> str:
    i, j = np.unravel_index(int(np.argmax(np.where(np.isfinite(required), std / required, 0.0))), std.shape)
    failed = [axis for axis, fine in zip(AXES, accurate, strict=True) if not fine]
    others = f" (of {', '.join(failed)}, this is the worst)" if len(failed) > 1 else ""
    by_reference = bool(logs) and all(log.reference is not None for log in logs)
    payload = logs[-1].payload if logs else None
    disturbed = _disturbed(estimate, rig, logs, named)
    return (
        f"accuracy: the gain of {rig.sensor.channels[i]} on {AXES[j]} has a sigma of {std[i, j]:.3g} of "
        f"range, more than the required {required[j]:.3g}{others}; "
        f"{advice(estimate, rig, required, payload, disturbed, by_reference)}"
    )


def _disturbed(estimate: Estimate, rig: Rig, logs: Sequence[Log], named: list[str]) -> Disturbed:
    """What costs accuracy beyond what was stated; at most three kinds, as of all reasons."""
    factor, of_motion = scatter(estimate), motion_scatter(estimate, rig, logs)
    noisy, moves = factor > _core.NOISE_TOLD, of_motion > _core.NOISE_TOLD
    slow = _if_room(looks_slow(estimate, rig, logs)[: MOST - noisy], named)
    kinds = (*likeliest_fast(estimate, rig, logs), "noise") if noisy or moves else ()
    words, others = "", []
    if noisy:
        words = f", {factor:.2g} times the stated{_if_room(kinds, named)}"
    if moves:
        others.append(f"the scatter of the motion, {of_motion:.2g} times the stated{_if_room(kinds, named)}")
    if any(log.vibrations for log in logs):
        others.append(f"what shakes the sensor alone{_if_room(('vibration',), named)}")
    disturbs = f"what disturbs it slowly{slow}"
    return Disturbed(disturbs, slow_found(estimate), slow_stands(estimate), words, tuple(others))


def _if_room(kinds: Sequence[str], named: list[str]) -> str:
    """` (cable or drift)`; nothing where as many others are named."""
    room = len(named) < MOST or not set(kinds).isdisjoint(named)
    return f" ({_named(kinds, named)})" if room else ""


def _notes(estimate: Estimate, comparisons: Comparisons, rig: Rig, logs: Sequence[Log]) -> list[str]:
    notes = still_bases(logs)
    if comparisons.not_held_out:
        notes.append(f"not compared on data held out: {comparisons.not_held_out}")
    if estimate.solved and not estimate.converged:
        notes.append(f"the last fit still moved a little after {estimate.iterations} steps")
    condition = _condition(estimate, rig)
    if CONDITION < condition < SINGULAR:
        notes.append(f"the gain is ill-conditioned: {condition:.3g} in units of range")
    for k, count in enumerate(estimate.dropped):
        if count and estimate.solved:
            notes.append(
                f"stretches of {log_name(logs, k)} shorter than 12 knots, which were dropped: {count}"
            )
    words = Counter(u.words for u in _undetermined(estimate, rig, ()))
    if words and estimate.solved:
        named = "; ".join(word if count == 1 else f"{word} ({count})" for word, count in words.items())
        notes.append(
            f"{words.total()} of {6 * rig.sensor.n} directions of the gain are not determined: {named}"
        )
    return notes
