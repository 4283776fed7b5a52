"""Whether a tool may be used, and what to do next."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from truewrench import _core
from truewrench.estimation.estimate import AGREE, odd_log, worst_of_halves, worst_of_logs
from truewrench.estimation.static_poses import MOVING, REPEATABILITY, WALK, Poses
from truewrench.model.arrays import Array, Integers
from truewrench.model.channels import MOST_RANGES, channel_faults
from truewrench.model.log import Log, log_name
from truewrench.model.rig import Rig
from truewrench.tool.bodies import nearest_physical
from truewrench.tool.held_out import Left
from truewrench.tool.motion import MotionFit
from truewrench.tool.parts import ToolVerdict
from truewrench.tool.setup import mistakes, mistakes_of_motion
from truewrench.tool.solve import Solution, solve
from truewrench.tool.undetermined import directions_in, undetermined

CHANCE = 1e-6  # of a test of the set-up
WORST_WALK = 50.0  # times its start
SUSPECT_WALK = 20.0
FAR = 25.0  # squared distance to a physical body, 4.4 where all is well
LIGHT = 0.3  # 1 sigma of the mass, relative: beyond, no weight is felt
NOISE = 4.0  # found over stated, which people misstate by two
SLOW = 0.015  # fraction of range: worse than any cable that is guided
HELD = 1e-6  # [rad] 1 sigma of an angle that was held
SUSPECTS = 4  # poses, the least likely first, of which one may have been touched
FEWEST = 8  # poses, of which one can be spared
CALMER = 0.2  # of the walk's rate: what is left of it without that pose
HELD_OUT = 3.0  # squared errors over what was predicted


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """The verdict, and figures of the fit for people and programs."""

    verdict: ToolVerdict
    figures: Mapping[str, Any]


def judge(
    rig: Rig,
    solution: Solution,
    motion: MotionFit | None,
    left: Left,
    *,
    logs: Sequence[Log],
    determined: Mapping[str, Any],
    p_logs: Array,
    p_halves: Array,
) -> Judged:
    """Set-up tests, words and needs of one identification.

    `p_logs`, `p_halves` (L,): how likely chance makes each of the logs differ as much from the others, and
    its halves from each other.
    """
    moved = [move.record for move in solution.problem.moves]
    figures = (
        _figures(solution, motion, left)
        | _undone(moved)
        | {
            "logs_agree": worst_of_logs(p_logs),
            "halves_agree": worst_of_halves(p_halves) if np.isfinite(p_halves).all() else None,
        }
    )
    reasons, needed = _reasons(rig, solution, motion, left, figures, determined, moved)
    railed = [
        f"{fault.words[0].upper()}{fault.words[1:]}."
        for fault in channel_faults(rig, logs)
        if not fault.silent
    ]
    reasons = [*railed, *_beyond(rig, logs), *reasons, *_differing(p_logs, logs), *_slipped(p_halves, logs)]
    unknown, more = undetermined(rig, solution, motion, determined, figures)
    needs = dict.fromkeys([*_unused(solution, logs), *_whole(p_halves, logs), *needed, *more])
    verdict = ToolVerdict(not reasons, tuple(reasons), tuple(unknown), tuple(needs))
    return Judged(verdict, figures)


def _beyond(rig: Rig, logs: Sequence[Log]) -> list[str]:
    """Channels whose readings no sensor of this range has."""
    reached = [np.nanquantile(np.abs(log.raw), 0.99, axis=0) for log in logs if len(log.raw)]
    times = np.max(reached, axis=0, initial=0.0) / rig.sensor.channel_scale
    return [
        f"Channel {rig.sensor.channels[k]} reads {times[k]:.3g} times its range: the units of `raw_{k}`, "
        "`sensor.range` or `nominal_gain` are others."
        for k in np.flatnonzero(times > MOST_RANGES).tolist()
    ]


def _differing(p_logs: Array, logs: Sequence[Log]) -> list[str]:
    """Whether a log tells another tool, or another sensor, than the others."""
    p = worst_of_logs(p_logs)
    if p >= CHANCE:
        return []
    if not np.isfinite(p):
        return ["The logs could not be compared: the motion of one tells nothing by itself."]
    return [
        f"Logs tell different tools or sensors: {odd_log(p_logs, logs)} (p = {p:.1g}). The tool, its place "
        "on the sensor, or the sensor changed between them."
    ]


def _slipped(p_halves: Array, logs: Sequence[Log]) -> list[str]:
    """Whether a log begins with another tool than it ends with."""
    p_halves = np.where(np.isfinite(p_halves), p_halves, 1.0)
    p = worst_of_halves(p_halves)
    if p >= CHANCE:
        return []
    return [
        f"The first and the second half of {log_name(logs, int(np.argmin(p_halves)))} tell different tools "
        f"(p = {p:.1g}): the tool slipped, something hung on it, or the sensor changed."
    ]


def _whole(p_halves: Array, logs: Sequence[Log]) -> list[str]:
    """Logs whose halves could not be compared."""
    return [
        f"Whether {log_name(logs, k)} begins with the tool that it ends with is not known, as a half of its "
        "motion tells nothing by itself: move for longer at a time."
        for k in np.flatnonzero(~np.isfinite(p_halves)).tolist()
    ]


def _unused(solution: Solution, logs: Sequence[Log]) -> list[str]:
    """Logs of which nothing told anything."""
    told = {move.log for move in solution.problem.moves} | set(solution.problem.poses.log.tolist())
    return [
        f"Log anew what {log_name(logs, k)} is for: it holds neither a pose nor {MOVING:g} s of motion."
        for k in range(len(logs))
        if k not in told
    ]


def _figures(solution: Solution, motion: MotionFit | None, left: Left) -> dict[str, Any]:
    v = solution.problem.vector
    place = v.layout.gain
    scale = np.sqrt(np.diag(solution.prior_covariance)[place])
    z = (solution.x - solution.prior_mean)[place] / scale
    P0 = solution.prior_covariance[place, place] / np.outer(scale, scale)
    gain = float(z @ np.linalg.solve(P0 + 1e-9 * np.eye(len(z)), z))
    body = v.layout.body
    distance = nearest_physical(solution.x[body], solution.covariance[body, body])[1]
    directions, cone, _ = directions_in(solution)
    return {
        "poses": len(solution.problem.poses),
        "directions": directions,
        "cone_deg": float(np.degrees(cone)),
        "chi_square": solution.chi_square,
        "freedom": solution.freedom,
        "gain_departure": gain / len(z),
        "gain_worst": float(np.abs(z).max()),
        "physical_distance": distance,
        "offset_walk_over_start": solution.rate / WALK,
        "repeatability_over_start": solution.repeatability / REPEATABILITY,
        "steps": solution.steps,
        "masked": 0.0 if motion is None else motion.masked,
        "noise_found": [] if motion is None else list(motion.factors),
        "held_out": {kind: asdict(one) for kind, one in left.by_kind.items()},
        "held_out_ratio": dict(left.ratio),
    }


def _undone(logs: Sequence[Log]) -> dict[str, list[str]]:
    """What logs are read without, each said once."""
    filters = (found.words for log in logs for found in log.whitened.values())
    vibrations = (found.words for log in logs for found in log.vibrations)
    return {"filters": list(dict.fromkeys(filters)), "vibrations": list(dict.fromkeys(vibrations))}


def _believed(solution: Solution) -> float:
    """1 sigma of the gains to forces beforehand, RMS, fraction of range."""
    sensor = solution.problem.rig.sensor
    gain_std, _ = solution.problem.priors_of_motion
    of_range = gain_std / sensor.gain_unit
    return float(np.sqrt(np.mean(of_range[:3, :3] ** 2)))


def _reasons(
    rig: Rig,
    solution: Solution,
    motion: MotionFit | None,
    left: Left,
    figures: Mapping[str, Any],
    determined: Mapping[str, Any],
    logs: Sequence[Log],
) -> tuple[list[str], list[str]]:
    reasons, needed = [], []
    v, poses = solution.problem.vector, solution.problem.poses
    body = v.layout.log_mass
    relative = float(np.sqrt(solution.covariance[body, body]))
    light = not determined["mass"] or relative > LIGHT
    if light:
        believed = _believed(solution)  # weights are known no better than gains are
        loose = f" a gain that is believed to {100.0 * believed:.0f}%," if believed > 0.5 * LIGHT else ""
        reasons.append(
            f"No weight is felt beyond what is uncertain ({np.exp(solution.x[body]):.3g} kg, 1 sigma "
            f"{100.0 * relative:.0f}%):{loose} a weight already subtracted, or a tool lighter than the noise."
        )
        calibrate = "Calibrate the sensor first: `tool` takes a calibration in place of the rig."
        log = "Log the raw output, or state what the driver subtracts (`sensor.compensated`)."
        needed.append(calibrate if loose else log)
    elif not all(determined["center_of_mass"]):
        lacking = ", ".join(a for a, k in zip("xyz", determined["center_of_mass"], strict=True) if not k)
        reasons.append(f"The centre of mass along {lacking} is not determined.")
        needed.append("Turn the tool so that gravity points along other axes of the sensor.")
    if motion is None and figures["directions"] < 3:
        reasons.append(
            f"{len(poses)} poses in {figures['directions']} directions of gravity: three directions at least "
            "separate the weight from the offset."
        )
        needed.append(
            "At least 4 poses, better 12, in directions of gravity far apart, opposite ones in turn."
        )
    count = v.n * 6
    worst = chdtrc(1, figures["gain_worst"] ** 2) * count  # which all others together would hide
    if min(chdtrc(count, figures["gain_departure"] * count), worst) < CHANCE:
        reasons.append(
            f"The gains would have to be {figures['gain_worst']:.0f} of their stated sigma away: sign, "
            "axes or units of the log, or what is known of the tool, are not as stated."
        )
    reasons += [*_turns(solution), *_zeroed(solution)]
    reasons += [*misfit_of_poses(solution, figures), *misfit_of_motion(motion)]
    named: Sequence[str] = ()
    if reasons or figures["offset_walk_over_start"] > SUSPECT_WALK:
        named = mistakes(rig, poses, solution.problem.prior.gain_std)
        if not named and motion is not None:
            named = mistakes_of_motion(rig, logs, solution.problem.prior.gain_std)
        reasons = [*named, *(reason for reason in reasons if not (named and reason.startswith("The gains")))]
    if all(determined["inertia"]) and figures["physical_distance"] > FAR:
        reasons.append(
            f"No physical body is near what was found (squared distance {figures['physical_distance']:.0f}): "
            "sign, axes, units or the tool's rigidity are not as stated."
        )
    walks = figures["offset_walk_over_start"]
    if walks > SUSPECT_WALK and not named and (alone := _jump(solution)) is not None:
        said = _touched(poses, np.array([alone]))
        if said not in reasons:
            reasons.append(said)
    elif walks > WORST_WALK:
        reasons.append(
            f"The offset wanders {walks:.0f} times as fast as sensors do: drift, "
            "a cable that pulls, or a contact."
        )
        needed.append("Let the sensor warm up, guide the cables, and take the poses in half the time.")
    for kind, ratio in left.ratio.items():
        if ratio > HELD_OUT:
            reasons.append(f"Held-out poses ({kind}) depart {np.sqrt(ratio):.1f} times as far as predicted.")
    return reasons, needed


def _zeroed(solution: Solution) -> list[str]:
    """Whether an offset of one session has moved further than any walk goes."""
    problem = solution.problem
    scale, P = problem.rig.sensor.channel_scale, np.diag(solution.covariance)
    gaps, _ = problem.of_links(solution.x)
    session = problem.session_links()
    for link, gap in zip(session, gaps[: len(session)], strict=True):
        seconds = 1e-9 * abs(problem.end_ns[link.log] - link.time_ns)
        squares = gap**2 / (P[link.place] + (SUSPECT_WALK * WALK * scale) ** 2 * seconds)
        if chdtrc(len(gap), float(squares.sum())) < CHANCE:
            return [
                f"The offset is {np.sqrt(squares.max()):.0f} sigma from where the record before left it: the "
                "sensor was zeroed in between, or this is another session (`sensor.pool_offsets: false`)."
            ]
    return []


def misfit_of_motion(motion: MotionFit | None) -> list[str]:
    """Whether the motion fits a rigid body: its noise, what is slow in it, its parts, and all but a share."""
    if motion is None:
        return []
    out = []
    if max(motion.factors) > NOISE:
        out.append(
            f"The motion fits no rigid body: {max(motion.factors):.1f} times the stated noise is left; "
            "attitude, sign, axes or units of the log, or the noise, are not as stated."
        )
    if motion.slow > SLOW:
        out.append(
            f"{100 * motion.slow:.1f}% of range follows neither weight nor motion: attitude, sign or axes of "
            "the log are not as stated, or a cable pulls."
        )
    if not motion.agreement >= AGREE:  # NaN, too
        out.append(f"Parts of the motion tell different sensors (p = {motion.agreement:.1g}).")
    if motion.masked > _core.MOST_LOST:
        out.append(f"{100 * motion.masked:.0f}% of the motion was left out as contact or outliers.")
    return out


def misfit_of_poses(solution: Solution, figures: Mapping[str, Any]) -> list[str]:
    """Whether the poses fit the model: all of them, or all but one or two that something touched."""
    poses, n = solution.problem.poses, solution.problem.vector.n
    if not len(poses):
        return []
    freedom, total = figures["freedom"], figures["chi_square"] * figures["freedom"]
    touched = np.flatnonzero(chdtrc(n, solution.pose_chi_square) * len(poses) < CHANCE)
    bad = chdtrc(freedom, total) < CHANCE and figures["chi_square"] > 1.5
    if touched.size and touched.size <= max(1, len(poses) // 6):
        return [_touched(poses, touched)]
    if bad:
        return [
            f"The poses do not fit a weight (chi-square {figures['chi_square']:.3g} per reading): attitude, "
            "sign, axes or units of the log are not as stated."
        ]
    return []


def _turns(solution: Solution) -> list[str]:
    """Turns stated as small that came out large: of the channels, whose gains then fit, and of gravity."""
    layout, out = solution.problem.vector.layout, []
    for place, words in (
        (layout.mounting, "The channels would have to be turned by {} deg against the sensor frame: axes"),
        (layout.tilt, "Gravity would have to be {} deg off its stated direction: attitude, axes"),
    ):
        sigma = np.sqrt(np.diag(solution.prior_covariance)[place])
        if sigma.min() < HELD:
            continue
        turn = (solution.x - solution.prior_mean)[place]
        if chdtrc(turn.size, float(np.sum((turn / sigma) ** 2))) < CHANCE:
            said = words.format(f"{np.degrees(np.linalg.norm(turn)):.0f}")
            out.append(
                f"{said} or sign of the log are not as stated ({np.abs(turn / sigma).max():.0f} sigma)."
            )
    return out


def _touched(poses: Poses, which: Integers) -> str:
    when = ", ".join(f"{(poses.time_ns[k] - poses.time_ns[0]) * 1e-9:.4g} s" for k in which)
    return f"A contact during the poses, or a pose logged wrongly: {when} after the first."


def _jump(solution: Solution) -> int | None:
    """The pose without which the offset hardly walks, None where there is none: a walk swallows one touch.

    Of 60 touched by 5 N and 60 by 10 N the rate left was at most 0.13, of 120 that walk 15 and 30 times as
    fast as sensors do at least 0.67.
    """
    poses = solution.problem.poses
    if len(poses) < FEWEST:
        return None
    for k in np.argsort(-solution.pose_chi_square)[:SUSPECTS]:
        kept = poses.of(np.arange(len(poses)) != k)
        others = solve(replace(solution.problem, poses=kept), solution.x)
        if others.rate < CALMER * solution.rate:
            return int(k)
    return None
