"""A calibration from static poses alone: what the payload weighs, in many directions of gravity.

    raw = C w(payload, gravity) + b + walk(t) + e

The model is that of an unknown tool (docs/tool.md) about a payload that is known: gain, body, offset and the
direction of gravity with their priors, and an offset that walks, its rate found. The logs of one payload are
solved together; what they tell of gain and gravity, and what motion told before them, is the prior of the
next. At rest the moment is c x force: one payload tells the gains of force as far as those of the moment are
known, several tell both (METHOD 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truewrench.calibrating.known_wrench import (
    BLOCKS,
    FOLDS,
    FREEDOM,
    differing,
    improvement_by_axis,
    worse_on_rows,
)
from truewrench.calibrating.pose_following import Following, following
from truewrench.calibrating.reference_body import Known
from truewrench.calibrating.unknown_bodies import known_logs, scale_unknown
from truewrench.estimation.assembly import log_report
from truewrench.estimation.assumptions import assumed_gain_prior
from truewrench.estimation.estimate import Estimate, of_joint, without_motion
from truewrench.estimation.static_poses import APART, WALK, Poses, split_poses, stands_still
from truewrench.estimation.unknowns import horizontal_axes
from truewrench.judging import Comparisons, Judgement, judge, setup_errors
from truewrench.judging.validation.comparison import Comparison
from truewrench.model.arrays import Array
from truewrench.model.calibration import BlindTo, LogReport
from truewrench.model.errors import UnsupportedError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.attitude import own_roots
from truewrench.tool.bodies import weight
from truewrench.tool.following import weights
from truewrench.tool.judge import WORST_WALK, misfit_of_poses
from truewrench.tool.parameters import Layout
from truewrench.tool.solve import Solution, solve

FEWEST = 10  # poses, of which a fifth is held out at a time
_CABLE = 1e-3  # fraction of range: a force that follows the pose, of which the effect is told


@dataclass(frozen=True, slots=True, eq=False)
class StillEstimate:
    """What the poses say."""

    estimate: Estimate  # gain, offsets and payloads, as every estimate has them
    poses: Poses  # of all logs
    solutions: dict[str, Solution]  # by payload, in the order in which they were solved
    before: Known  # what was known of gain, tilt and bodies before the poses
    known: Known  # the same and the offsets `pose offset K` after them
    unturned: int  # poses of which nothing tells how they are turned about gravity, where it may be tilted
    hidden: Following  # what may have followed the pose

    @property
    def sizes(self) -> dict[str, Array]:
        """Logarithms of the walk's rate and of the repeatability, by payload."""
        return {name: np.log([s.rate, s.repeatability]) for name, s in self.solutions.items()}


def only_still(rig: Rig, logs: Sequence[Log]) -> bool:
    """Whether all logs are static poses in gravity, and nothing in them is a motion."""
    return rig.in_gravity and all(stands_still(rig, log) for log in logs)


def estimate_still(
    rig: Rig, logs: Sequence[Log], before: Known | None = None, sizes: dict[str, Array] | None = None
) -> StillEstimate:
    """Gain, offsets, payloads and the direction of gravity from static poses, the logs those of `only_still`.

    `before` is what other logs told, by default what the rig states; `sizes`, `StillEstimate.sizes` that
    hold, are found unless given. Refused: a pose whose direction of gravity nothing tells, and an offset
    shared by all.
    """
    if rig.sensor.pool_offsets and (len(logs) > 1 or before is not None):
        raise UnsupportedError.at(
            rig.path, "sensor.pool_offsets", "true", "false: static poses have an offset of each log"
        )
    split = split_poses(rig, logs)
    (poses, unturned), begin = _tilted(rig, logs, split.poses), before or Known.stated(rig)
    solutions, known = _solved(rig, logs, poses, split.end_ns, begin, sizes)
    estimate = _as_estimate(rig, logs, solutions, known)
    hidden = following(rig, [*solutions.values()], _gain_covariance(rig, begin), estimate.before_pose)
    estimate = hidden.beside(rig, estimate, range(len(logs)))
    return StillEstimate(estimate, poses, solutions, begin, known, unturned, hidden)


def _gain_covariance(rig: Rig, known: Known) -> Array:
    """(6n, 6n), normalised."""
    unit = rig.sensor.gain_unit.ravel()
    return np.asarray(known.plain(rig).of(["gain"])[1] / np.outer(unit, unit))


def _tilted(rig: Rig, logs: Sequence[Log], poses: Poses) -> tuple[Poses, int]:
    """With gravity's tilt in poses of which nothing tells how they are turned about it; how many these are.

    Those are of logs without attitude, several or with gaps in their rates of turn. Of N, in each of which
    the tilt points anywhere, perhaps alike: var sum a_k e_k <= N sum a_k^2 var e_k (Cauchy-Schwarz), so with
    e the horizontal axes and C the nominal gain, var y += N tilt^2 sum (C w(R (e x g)))^2.
    """
    loose = []
    for k, log in enumerate(logs):
        known = np.ones(0, bool) if log.twist is None else np.isfinite(log.twist[:, 3:]).all(axis=1)
        followed = len(logs) == 1 and (np.diff(log.time[known]) < APART).all()
        loose += [k] * (len(own_roots(rig, log)) > 0 and not followed)
    count = np.count_nonzero(np.isin(poses.log, loose))
    variance, nominal = poses.variance.copy(), rig.gravity_tilt_prior * rig.sensor.nominal_gain_array
    for k in loose:
        own, spec = poses.log == k, rig.payloads[logs[k].payload]
        for axis in horizontal_axes(rig.gravity_array):
            fall = poses.R_sensor_root[own] @ np.cross(axis, rig.gravity_array)
            wrench = weight(spec.mass, spec.center_of_mass_array, fall)
            variance[own] += count * (wrench @ nominal.T) ** 2
    return replace(poses, variance=variance), int(count) if rig.gravity_tilt_prior > 0.0 else 0


def _solved(
    rig: Rig,
    logs: Sequence[Log],
    poses: Poses,
    end_ns: Sequence[int],
    known: Known,
    sizes: dict[str, Array] | None = None,
) -> tuple[dict[str, Solution], Known]:
    """Payload by payload, that of the last log at the end."""
    out = {}
    for name in list(dict.fromkeys(log.payload for log in reversed(logs)))[::-1]:
        own = [k for k, log in enumerate(logs) if log.payload == name]
        chosen = np.flatnonzero(np.isin(poses.log, own))
        part = replace(poses.of(chosen), log=np.searchsorted(own, poses.log[chosen]))
        problem, start = known.problem(rig, name, part, [end_ns[k] for k in own])
        free = rig.payloads[name].unknown and known.reference is None
        out[name] = solve(problem, None if free else start, None if sizes is None else sizes[name])
        known = known.told(name, out[name], [f"pose offset {k}" for k in own])
    return out, known


def _as_estimate(rig: Rig, logs: Sequence[Log], solutions: dict[str, Solution], known: Known) -> Estimate:
    n, count = rig.sensor.n, len(logs)
    last = list(solutions.values())[-1]
    v = last.problem.vector
    places = np.r_[v.layout.gain, v.offset(v.logs - 1), v.slope]
    told = of_joint(rig, known.plain(rig), [f"pose offset {k}" for k in range(count)], {"tilt": range(count)})
    told["slope_covariance"] = last.covariance[v.slope, places] if v.warm else None
    return without_motion(
        n,
        count,
        solved=True,
        **told,
        gain_prior=np.full(6 * n, assumed_gain_prior(rig)),
        offset_temperature=last.x[v.slope].copy() if v.warm else None,
        converged=True,
        iterations=max(found.steps for found in solutions.values()),
        fits=sum(len(found.problem.poses) for found in solutions.values()),
    )


def misfit_of_still(found: StillEstimate) -> list[str]:
    """Why the poses are no weight on a sensor whose offset walks as sensors' do."""
    reasons = []
    for name, solution in found.solutions.items():
        figures = {"freedom": solution.freedom, "chi_square": solution.chi_square}
        of = f"payload `{name}`: " if len(found.solutions) > 1 else ""
        reasons += [f"{of}{words}" for words in misfit_of_poses(solution, figures)]
        if solution.rate > WORST_WALK * WALK:
            reasons.append(
                f"{of}the offset wanders {solution.rate / WALK:.0f} times as fast as sensors do: drift, "
                "a cable that pulls, or a contact"
            )
    return reasons


def differing_poses(logs: Sequence[Log], p: tuple[Array, Array]) -> list[str]:
    """Reasons, where a log of poses, or its last ones, tell another gain: by p of logs and of halves (L,)."""
    between = "sensor or payload changed between logs"
    slipped = "the payload slipped, something hung on it, or the sensor changed"
    return differing(logs, p, between, "the first and the last poses of", slipped)


def judge_still(
    rig: Rig, logs: Sequence[Log], found: StillEstimate, compared: Comparison, p: tuple[Array, Array]
) -> Judgement:
    """The verdict on what static poses say of the gain: of the one function that decides.

    `p`: how likely chance makes each log differ as much from the others (L,), and its last poses from the
    first (L,).
    """
    known, reasons = known_logs(rig, logs), [*scale_unknown(rig, logs), *misfit_of_still(found)]
    reasons += differing_poses(logs, p)
    spare = sum(len(s.problem.poses) - s.problem.vector.logs for s in found.solutions.values())
    if spare < FREEDOM + 3 * len(found.solutions):
        reasons.append(
            "too few poses for their residuals to show a mistake: a few more than unknowns are needed"
        )
    held_out = any(axis.held_out for axis in compared.improvement.values())
    judgement = judge(
        found.estimate,
        Comparisons(
            worse=(*reasons, *compared.reasons),
            not_held_out="" if held_out else str(compared.figures.get("none_because", "")),
            setup=setup_errors(found.estimate, rig, known) if known else (),
        ),
        rig,
        logs,
    )
    unturned: tuple[str, ...] = ()
    if found.unturned:
        unturned = (
            f"nothing tells how {found.unturned} poses are turned about gravity: wherever its tilt "
            "(`gravity_tilt_prior`) points in each, sigma covers it; log qw qx qy qz for a smaller one",
        )
    return replace(
        judgement,
        verdict=replace(judgement.verdict, blind_to=_blind_to(rig, found)),
        notes=(*judgement.notes, *unturned),
    )


def _blind_to(rig: Rig, found: StillEstimate) -> tuple[BlindTo, ...]:
    """A force that follows the pose as weight does: nothing at rest tells it from weight."""
    force = np.vstack([weights(rig, s)[:, :3] for s in found.solutions.values()]) / rig.sensor.range_array[:3]
    swing = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(force.T, bias=True))[0], 1e-18)))
    effect = min(_CABLE / swing, rig.sensor.gain_prior)
    words = (
        f"a force of {100 * _CABLE:g}% of range that follows the pose (a cable) would move some gain by "
        f"{effect:.2g} and leave no trace: at rest it looks like weight"
    )
    return (BlindTo("cable", _CABLE, effect, words),)


def compare_still(rig: Rig, logs: Sequence[Log], found: StillEstimate, held_out: bool) -> Comparison:
    """Corrected wrench against the payload's weight in poses that were held out, by nominal and new gain.

    Either gain has the mean of its errors in each log taken off: offsets walk whatever the gain.
    """
    poses, why = found.poses, "not asked for"
    if held_out and len(poses) < FEWEST:
        held_out, why = False, f"fewer than {FEWEST} poses"
    block = np.arange(len(poses)) * min(BLOCKS, len(poses)) // len(poses)
    w = np.zeros((len(poses), 6))
    for name in found.solutions:
        spec, own = rig.payloads[name], np.array([logs[k].payload == name for k in poses.log])
        fall = poses.R_sensor_root[own] @ rig.gravity_array
        mass, center = spec.mass, spec.center_of_mass_array
        if spec.unknown:  # the one that was found, whoever's gain it is held against
            layout, x = Layout(rig.sensor.n), found.solutions[name].x
            mass, center = float(np.exp(x[layout.log_mass])), x[layout.center_of_mass]
        w[own] = rig.sensor.sign * weight(mass, center, fall)

    def errors(gain: Array) -> Array:
        error = poses.raw @ np.linalg.pinv(gain).T - w
        for k in range(len(logs) if rig.sensor.offset_prior_array.any() else 0):
            error[poses.log == k] -= error[poses.log == k].mean(axis=0)
        return error

    old = errors(rig.sensor.nominal_gain_array)
    new = np.full_like(old, np.nan)
    ends = [int(log.time_ns[-1]) for log in logs]
    for fold in range(FOLDS if held_out else 1):
        out = block % FOLDS == fold if held_out else np.ones(len(poses), dtype=bool)
        fitted = found.estimate
        if held_out:
            kept = poses.of(~out)
            if np.setdiff1d(np.arange(len(logs)), kept.log).size:
                return Comparison({}, (), {"none_because": "a log of too few poses to hold some of them out"})
            fitted = _as_estimate(rig, logs, *_solved(rig, logs, kept, ends, found.before, found.sizes))
        new[out] = errors(fitted.gain)[out]
    figures = {"samples": len(poses), "folds": FOLDS} if held_out else {"none_because": why}
    improvement = improvement_by_axis(old**2, new**2, block, held_out)
    worse = worse_on_rows(improvement, rig.required_array) if held_out else ()
    return Comparison(improvement, worse, figures)


def still_figures(found: StillEstimate) -> dict[str, Any]:
    """What there is to say of the poses in calibration.yaml."""
    return {
        "poses": len(found.poses),
        "poses_unturned": found.unturned,
        "chi_square": {name: s.chi_square for name, s in found.solutions.items()},
        "offset_walk": {name: s.rate for name, s in found.solutions.items()},
        "pose_repeatability": {name: s.repeatability for name, s in found.solutions.items()},
    }


def still_reports(logs: Sequence[Log], found: StillEstimate) -> list[LogReport]:
    """What each log contributed."""
    e = found.estimate
    used = [int(np.count_nonzero(found.poses.log == k)) for k in range(len(logs))]
    return [log_report(*of) for of in zip(logs, e.offsets, e.offsets_std, used, strict=True)]
