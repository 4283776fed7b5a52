"""A calibration from static poses alone: what the payload weighs, in many directions of gravity.

    raw = C w(payload, gravity) + b + walk(t) + e

The model is that of an unknown tool (docs/tool.md) about a payload that is known: gain, body, offset and the
direction of gravity with their priors, and an offset that walks, its rate found. The logs of one payload are
solved together; what they tell of gain and gravity is the prior of the next. At rest the moment is c x force:
one payload tells the gains of force as far as those of the moment are known, several tell both (METHOD 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truewrench.calibrating.known_wrench import BLOCKS, FOLDS, FREEDOM, improvement_by_axis, worse_on_rows
from truewrench.calibrating.unknown_bodies import known_logs, scale_unknown
from truewrench.estimation.estimate import Estimate, PayloadDeparture, without_motion
from truewrench.judging import Comparisons, Judgement, judge, setup_errors
from truewrench.judging.validation.comparison import Comparison
from truewrench.model.calibration import BlindTo, LogReport
from truewrench.model.errors import UnsupportedError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.tool.bodies import weight
from truewrench.tool.judge import WORST_WALK, misfit_of_poses
from truewrench.tool.model_rows import Problem
from truewrench.tool.parameters import Layout, second_moments
from truewrench.tool.poses import Poses, split_poses, stands_still
from truewrench.tool.prior import S_STD, Prior
from truewrench.tool.solve import WALK, Solution, solve

__all__ = ["StillEstimate", "compare_still", "estimate_still", "judge_still", "only_still", "still_reports"]

Array = NDArray[np.float64]

FEWEST = 10  # poses, of which a fifth is held out at a time
_EXACT = 1e-9  # of a unit: 1 sigma that holds a parameter
_CABLE = 1e-3  # fraction of range: a force that follows the pose, of which the effect is told


@dataclass(frozen=True, slots=True, eq=False)
class StillEstimate:
    """What the poses say.

    Attributes:
        estimate: gain, offsets and payloads, as every estimate has them.
        poses: of all logs.
        solutions: by payload, in the order in which they were solved.
    """

    estimate: Estimate
    poses: Poses
    solutions: dict[str, Solution]


def only_still(rig: Rig, logs: Sequence[Log]) -> bool:
    """Whether all logs are static poses in gravity, and nothing in them is a motion."""
    return rig.in_gravity and all(stands_still(rig, log) for log in logs)


def estimate_still(rig: Rig, logs: Sequence[Log]) -> StillEstimate:
    """Gain, offsets, payloads and the direction of gravity from static poses.

    Args:
        rig: sensor and payloads, those with an uncertainty within it.
        logs: of `only_still`.

    Raises:
        InputError: for a pose whose direction of gravity nothing tells.
        UnsupportedError: for one offset that all logs share.
    """
    if rig.sensor.pool_offsets and len(logs) > 1:
        raise UnsupportedError.at(
            rig.path, "sensor.pool_offsets", "true", "false: static poses have an offset of each log"
        )
    split = split_poses(rig, logs)
    solutions = _solved(rig, logs, split.poses, split.end_ns)
    return StillEstimate(_as_estimate(rig, logs, solutions), split.poses, solutions)


def _solved(
    rig: Rig,
    logs: Sequence[Log],
    poses: Poses,
    end_ns: Sequence[int],
    sizes: dict[str, Array] | None = None,
) -> dict[str, Solution]:
    """Payload by payload, that of the last log at the end."""
    layout = Layout(rig.sensor.n)
    names = list(dict.fromkeys(log.payload for log in reversed(logs)))[::-1]
    shared = _shared(layout)
    mean, P = _shared_prior(rig)
    out = {}
    for name in names:
        own = [k for k, log in enumerate(logs) if log.payload == name]
        prior = _prior(rig, name, mean, P)
        chosen = np.flatnonzero(np.isin(poses.log, own))
        part = replace(poses.of(chosen), log=np.searchsorted(own, poses.log[chosen]))
        problem = Problem(rig, prior, part, [end_ns[k] for k in own])
        start = None if rig.payloads[name].unknown else problem.prior_of_all()[0]
        found = solve(problem, start, None if sizes is None else sizes[name])
        found = replace(found, covariance=_bent(found))
        mean, P = found.x[shared], found.covariance[np.ix_(shared, shared)]
        out[name] = found
    return out


def _bent(found: Solution) -> Array:
    """The covariance with what is uncertain in gain of moment times centre of mass, second order within it.

    At rest a channel feels (C_f + C_m [c]) f. Where C_m is not told, an error of c turns it into one of C_f
    that no derivative at the estimate shows: dC_m [dc].
    """
    layout, P = found.problem.vector.layout, found.covariance.copy()
    n, center = layout.n, P[layout.center_of_mass, layout.center_of_mass]
    gains = P[layout.gain, layout.gain].reshape(n, 6, n, 6)
    variance = float(np.trace(center)) / 3.0
    for i in range(n):
        for j in range(n):
            moment = gains[i, 3:, j, 3:]
            both = variance * (np.trace(moment) * np.eye(3) - moment.T)
            P[6 * i : 6 * i + 3, 6 * j : 6 * j + 3] += both
    return 0.5 * (P + P.T)


def _shared(layout: Layout) -> NDArray[np.int64]:
    """Places of the gain and of gravity's tilt."""
    gain, tilt = np.arange(layout.gain.stop), np.arange(layout.tilt.start, layout.tilt.stop)
    return np.concatenate([gain, tilt])


def _shared_prior(rig: Rig) -> tuple[Array, Array]:
    """Of the gain and of gravity's tilt: what all payloads share."""
    sensor = rig.sensor
    units = (sensor.channel_scale[:, None] / sensor.range_array).ravel()
    std = np.append(sensor.gain_prior * units, np.full(2, max(rig.gravity_tilt_prior, _EXACT)))
    return np.append(sensor.nominal_gain_array.ravel(), np.zeros(2)), np.diag(std**2)


def _prior(rig: Rig, name: str, shared: Array, P: Array) -> Prior:
    layout, spec = Layout(rig.sensor.n), rig.payloads[name]
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    at = _shared(layout)
    mean[at], covariance[np.ix_(at, at)] = shared, P
    mean[layout.log_mass] = np.log(spec.mass)
    mean[layout.center_of_mass] = spec.center_of_mass
    i = spec.inertia
    mean[layout.S] = second_moments(spec.mass, np.array([i.xx, i.yy, i.zz, i.xy, i.xz, i.yz]))
    std = np.zeros(layout.size)
    std[layout.log_mass] = spec.uncertainty.mass
    std[layout.center_of_mass] = spec.uncertainty.center_of_mass
    std[layout.S] = S_STD  # nothing of it is felt at rest
    std[layout.offset] = rig.sensor.offset_prior_array
    rest = np.arange(layout.gain.stop, layout.tilt.start)
    covariance[rest, rest] = np.maximum(std[rest], _EXACT) ** 2
    return Prior(mean, covariance, False, rig.sensor.gain_prior, {})


def _as_estimate(rig: Rig, logs: Sequence[Log], solutions: dict[str, Solution]) -> Estimate:
    sensor, n, count = rig.sensor, rig.sensor.n, len(logs)
    layout, last = Layout(n), list(solutions.values())[-1]
    scale = sensor.channel_scale
    units = np.append((scale[:, None] / sensor.range_array).ravel(), scale)
    gain, P_gain = last.x[layout.gain], last.covariance[layout.gain, layout.gain]
    offsets, offsets_std = np.zeros((count, n)), np.zeros((count, n))
    payloads = {}
    for name, found in solutions.items():
        spec = rig.payloads[name]
        own = [k for k, log in enumerate(logs) if log.payload == name]
        for j, k in enumerate(own):
            at = found.problem.vector.offset(j)
            offsets[k], variance = _updated(found, at, layout.gain, gain, P_gain)
            offsets_std[k] = np.sqrt(variance)
        if not spec.exact:
            body, variance = _updated(found, layout.body, layout.gain, gain, P_gain)
            mean, std = np.zeros(10), np.full(10, spec.uncertainty.inertia)
            mean[0] = np.exp(body[0]) / spec.mass - 1.0
            mean[1:4] = body[1:4] - spec.center_of_mass_array
            std[:4] = np.sqrt(variance[:4])
            payloads[name] = PayloadDeparture(mean, std)
    v = last.problem.vector
    pick = np.r_[np.arange(6 * n), np.arange(v.layout.offset.start, v.layout.offset.stop)]
    P = last.covariance[np.ix_(pick, pick)]
    normalised = P / np.outer(units, units)
    poses = sum(len(found.problem.poses) for found in solutions.values())
    return without_motion(
        n,
        count,
        solved=True,
        gain=gain.reshape(n, 6).copy(),
        covariance=P,
        normalised_covariance=normalised,
        before_pose=normalised[: 6 * n, : 6 * n],
        gain_prior=np.full(6 * n, sensor.gain_prior),
        offsets=offsets,
        offsets_std=offsets_std,
        payloads=payloads,
        tilt=last.x[layout.tilt].copy(),
        tilt_std=np.sqrt(np.diag(last.covariance)[layout.tilt]),
        offset_temperature=last.x[v.slope].copy() if v.warm else None,
        converged=True,
        iterations=max(found.steps for found in solutions.values()),
        fits=poses,
    )


def _updated(found: Solution, at: slice, gain: slice, mean: Array, P_gain: Array) -> tuple[Array, Array]:
    """Values and variances of a part of one payload's solution once others have told more of the gain."""
    P = found.covariance
    scale = np.sqrt(np.diag(P)[gain])
    K = np.linalg.solve(P[gain, gain] / np.outer(scale, scale), P[gain, at] / scale[:, None]).T / scale
    value = found.x[at] + K @ (mean - found.x[gain])
    variance = np.diag(P)[at] - np.einsum("ij,jk,ik->i", K, P[gain, gain] - P_gain, K)
    return value, np.maximum(variance, 0.0)


def judge_still(rig: Rig, logs: Sequence[Log], found: StillEstimate, compared: Comparison) -> Judgement:
    """The verdict on what static poses say of the gain: of the one function that decides."""
    known, reasons = known_logs(rig, logs), scale_unknown(rig, logs)
    for name, solution in found.solutions.items():
        figures = {"freedom": solution.freedom, "chi_square": solution.chi_square}
        of = f"payload `{name}`: " if len(found.solutions) > 1 else ""
        reasons += [f"{of}{words}" for words in misfit_of_poses(solution, figures)]
        if solution.rate > WORST_WALK * WALK:
            reasons.append(
                f"{of}the offset wanders {solution.rate / WALK:.0f} times as fast as sensors do: drift, "
                "a cable that pulls, or a contact"
            )
    spare = sum(len(s.problem.poses) - s.problem.vector.logs for s in found.solutions.values())
    if spare < FREEDOM + 3 * len(found.solutions):
        reasons.append(
            "too few poses for their residuals to show a mistake: a few more than unknowns are needed"
        )
    held_out = any(axis.held_out for axis in compared.improvement.values())
    judgement = judge(
        found.estimate,
        Comparisons(
            improvement=compared.improvement if held_out else {},
            worse=(*reasons, *compared.reasons),
            not_held_out="" if held_out else str(compared.figures.get("none_because", "")),
            setup=setup_errors(found.estimate, rig, known) if known else (),
        ),
        rig,
        logs,
    )
    return replace(judgement, verdict=replace(judgement.verdict, blind_to=_blind_to(rig, found)))


def _blind_to(rig: Rig, found: StillEstimate) -> tuple[BlindTo, ...]:
    """A force that follows the pose as weight does: nothing at rest tells it from weight."""
    force = (
        np.vstack([_weights(rig, s)[:, :3] for s in found.solutions.values()]) / rig.sensor.range_array[:3]
    )
    swing = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(force.T, bias=True))[0], 1e-18)))
    effect = min(_CABLE / swing, rig.sensor.gain_prior)
    words = (
        f"a force of {100 * _CABLE:g}% of range that follows the pose (a cable) would move some gain by "
        f"{effect:.2g} and leave no trace: at rest it looks like weight"
    )
    return (BlindTo("cable", _CABLE, effect, words),)


def _weights(rig: Rig, solution: Solution) -> Array:
    """(T, 6) wrench of the payload as it was found, with the rig's sign."""
    layout, x = Layout(rig.sensor.n), solution.x
    fall = solution.problem.poses.R_sensor_root @ rig.gravity_array
    return rig.sensor.sign * weight(float(np.exp(x[layout.log_mass])), x[layout.center_of_mass], fall)


def compare_still(rig: Rig, logs: Sequence[Log], found: StillEstimate, held_out: bool) -> Comparison:
    """Corrected wrench against the payload's weight in poses that were held out, by nominal and new gain.

    The nominal gain has the mean of its errors in each log taken off.
    """
    poses, why = found.poses, "not asked for"
    if held_out and len(poses) < FEWEST:
        held_out, why = False, f"fewer than {FEWEST} poses"
    block = np.arange(len(poses)) * min(BLOCKS, len(poses)) // len(poses)
    sizes = {name: np.log([s.rate, s.repeatability]) for name, s in found.solutions.items()}
    w = np.zeros((len(poses), 6))
    for name in found.solutions:
        spec, own = rig.payloads[name], np.array([logs[k].payload == name for k in poses.log])
        fall = poses.R_sensor_root[own] @ rig.gravity_array
        mass, center = spec.mass, spec.center_of_mass_array
        if spec.unknown:  # the one that was found, whoever's gain it is held against
            layout, x = Layout(rig.sensor.n), found.solutions[name].x
            mass, center = float(np.exp(x[layout.log_mass])), x[layout.center_of_mass]
        w[own] = rig.sensor.sign * weight(mass, center, fall)
    old = poses.raw @ np.linalg.pinv(rig.sensor.nominal_gain_array).T - w
    new = np.full_like(old, np.nan)
    ends = [int(log.time_ns[-1]) for log in logs]
    for k in range(len(logs)):
        if rig.sensor.offset_prior_array.any():
            old[poses.log == k] -= old[poses.log == k].mean(axis=0)
    for fold in range(FOLDS if held_out else 1):
        out = block % FOLDS == fold if held_out else np.ones(len(poses), dtype=bool)
        fitted = found.estimate
        if held_out:
            kept = poses.of(~out)
            if np.setdiff1d(np.arange(len(logs)), kept.log).size:
                return Comparison({}, (), {"none_because": "a log of too few poses to hold some of them out"})
            fitted = _as_estimate(rig, logs, _solved(rig, logs, kept, ends, sizes))
        inverse = np.linalg.pinv(fitted.gain)
        new[out] = (poses.raw[out] - fitted.offsets[poses.log[out]]) @ inverse.T - w[out]
    figures = {"samples": len(poses), "folds": FOLDS} if held_out else {"none_because": why}
    improvement = improvement_by_axis(old**2, new**2, block, held_out)
    return Comparison(improvement, worse_on_rows(improvement) if held_out else (), figures)


def still_reports(logs: Sequence[Log], found: StillEstimate) -> list[LogReport]:
    """What each log contributed."""
    e = found.estimate
    return [
        LogReport(
            log.path,
            log.sha256,
            log.payload,
            e.offsets[k],
            e.offsets_std[k],
            used=int(np.count_nonzero(found.poses.log == k)),
            dropped_rows=log.dropped_rows,
            nan_counts=log.nan_counts,
        )
        for k, log in enumerate(logs)
    ]
