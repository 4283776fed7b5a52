"""From a calibration or a rig, and logs, to a tool."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from truewrench.estimation.far_clock import with_clock_set
from truewrench.estimation.logged_otherwise import logged_otherwise
from truewrench.estimation.static_poses import Split, split_poses
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.repeats import without_repeats
from truewrench.model.rig import Rig
from truewrench.robot.compensation import uncompensated, with_weight_on_time
from truewrench.robot.parts import unwrapped
from truewrench.robot.track import tracked
from truewrench.tool.agreement import agreement_of_halves, agreement_of_logs
from truewrench.tool.bodies import inertia_std, joined, nearest_physical
from truewrench.tool.checks import check_known, check_logs, check_options, check_session
from truewrench.tool.following import beside_poses
from truewrench.tool.held_out import held_out
from truewrench.tool.judge import Judged, judge, misfit_of_motion
from truewrench.tool.model import Body, Tool
from truewrench.tool.model_rows import Problem
from truewrench.tool.motion import MotionFit, body_start, motion_information
from truewrench.tool.parameters import COLUMNS, ROWS, inertia_of, second_moments
from truewrench.tool.prior import make_prior, settings_of, widening, with_known_wrenches
from truewrench.tool.setup import mistakes_of_motion
from truewrench.tool.shaking import sample_noise, vibrations
from truewrench.tool.solve import Solution, solve

Progress = Callable[[str, float | None], None]

DETERMINED = 0.5  # of the prior's sigma: what is less certain than that the data did not tell

_ROUNDS = 6  # of the estimator of motion: about a linear start, then about what was found
_SETTLED = 0.1  # sigma that the mass may still move, and the gains, RMS


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a tool rests on, for a page.

    Attributes:
        solution: estimate and residuals of the poses.
        motion: what the estimator of motion found, None without motion.
        held_out: residuals in poses that were not fitted, by kind.
    """

    solution: Solution
    motion: MotionFit | None
    held_out: Mapping[str, Any]


def identify_tool(
    rig_or_calibration: Rig | Calibration,
    logs: Log | Sequence[Log],
    *,
    known: Mapping[str, tuple[float, float]] | None = None,
    mounting_sigma: float | None = None,
    tilt_sigma: float | None = None,
    flange: npt.ArrayLike | None = None,
    housing: npt.ArrayLike | None = None,
    on: Tool | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    evidence: Callable[[Evidence], None] | None = None,
) -> Tool:
    """Identify an unknown tool: body, offset, mounting and gain of the sensor, with their joint uncertainty.

    Args:
        rig_or_calibration: of the sensor; a calibration's covariance of the gain is the prior, a rig's
            `gain_prior`, 2% where it states none.
        logs: static poses, motion, or both; logs with `ref_*` tell the gain.
        known: what is known of the tool, value and 1 sigma by name: `mass`, `center_of_mass.x`, `inertia.xx`.
        mounting_sigma: [rad] 1 sigma of each angle between the channels' axes and the sensor frame; 3 deg by
            default, 0 with a calibration, whose gain contains it.
        tilt_sigma: [rad] 1 sigma of gravity's direction; 0.5 deg unless the rig states one.
        flange: x, y, z, roll, pitch, yaw of the sensor frame on the flange [m, rad], for exports.
        housing: mass and centre of mass of the sensor's housing, sensor axes [kg, m], for exports.
        on: a tool identified before, on which the unknown body (a workpiece) sits. Its offset is that of the
            logs, too, where the rig says `sensor.pool_offsets`; else they have one of their own.
        threads: of the estimator of motion.
        progress: called with a phase and the share of it that is done, if known.
        evidence: called once with what the result rests on.

    Raises:
        InputError: for logs that tell nothing of a tool, or do not fit the rig.
    """
    records = [logs] if isinstance(logs, Log) else list(logs)
    if not records:
        raise InputError.at(None, "", "no log", "at least one")
    report = progress or (lambda phase, share: None)
    check_options(flange, housing, {"mounting-sigma": mounting_sigma, "tilt-sigma": tilt_sigma})
    rig = settings_of(rig_or_calibration)
    records = [replace(log, payload=next(iter(rig.payloads))) for log in records]
    for log in records:
        log.check_sizes(raw=False)  # whose range is looked at
    records = [without_repeats(unwrapped(rig, log)) for log in records]
    check_known(known or {})
    check_logs(rig, records)
    check_session(rig, records, on)
    for log in records:
        if log.reference is None and (words := logged_otherwise(rig, log)):
            raise InputError(f"{log.path}: {words}")
    if rig.sensor.subtracted is not None:
        records = tracked(rig, records)
        late = [with_clock_set(rig, log).clock_set for log in records]
        records = uncompensated(rig, records, -np.array(late))
    weighed = [log for log in records if log.reference is not None]
    records = [log for log in records if log.reference is None]
    if not records:
        raise InputError.at(weighed[0].path, "ref_*", "known wrenches alone", "a log that carries the tool")
    if rig.sensor.pool_offsets:  # of one session: the last offset is the latest
        records.sort(key=lambda log: int(log.time_ns[-1]))
    prior = make_prior(
        rig_or_calibration, rig, mounting_sigma=mounting_sigma, tilt_sigma=tilt_sigma, on=on, known=known
    )
    prior = with_known_wrenches(rig, prior, weighed)
    report("estimating", None)

    def estimated(whole: Sequence[Log]) -> tuple[Split, Problem, Solution, MotionFit | None]:
        split = split_poses(rig, whole)
        if not len(split.poses) and not split.moves:
            expected = "rows of zero twist seconds apart, dwells of 1.5 s, or two seconds of motion"
            raise InputError.at(records[0].path, "", "neither poses nor motion", expected)
        return split, *_solved(Problem(rig, prior, split.poses, split.end_ns, split.moves), threads)

    with threadpool_limits(1, "blas"):  # of small matrices: on two cores threads take 15 times as long
        found = with_weight_on_time(rig, records, estimated, lambda found: _time_offsets(found[-1]))
        split, problem, solution, motion = found
        own = solution.covariance * widening(prior.gain_std) + beside_poses(solution)
        solution = replace(solution, covariance=own)
        report("holding poses out", None)
        left = held_out(problem, solution)
    judged = judge(
        rig,
        solution,
        motion,
        left,
        logs=records,
        determined=_determined(solution),
        p_logs=agreement_of_logs(solution, threads or 0),
        p_halves=agreement_of_halves(solution, threads or 0),
    )
    if on is not None and not on.verdict.usable:  # whose gain is the prior here: nothing would contradict it
        why = " ".join(on.verdict.reasons)
        reasons = (f"The tool that it sits on is not to be used: {why}", *judged.verdict.reasons)
        judged = replace(judged, verdict=replace(judged.verdict, usable=False, reasons=reasons))
    if evidence is not None:
        evidence(Evidence(solution, motion, left.details))
    return _tool(rig, solution, motion, judged, left.figures, flange, housing, records, split.end_ns, on)


def _time_offsets(motion: MotionFit | None) -> tuple[Array, Array]:
    """One for all logs, and its 1 sigma [s]; at rest none is felt."""
    at, std = (0.0, 0.0) if motion is None else motion.time_offset
    return np.array([at]), np.array([std])


def _solved(problem: Problem, threads: int | None) -> tuple[Problem, Solution, MotionFit | None]:
    logs = [move.record for move in problem.moves]
    if not logs:
        return problem, solve(problem), None
    rig, layout = problem.rig, problem.vector.layout
    still = solve(problem) if len(problem.poses) else None
    gain = problem.prior.mean[layout.gain].reshape(-1, 6)
    gain_std, tilt_std = problem.priors_of_motion
    body, x = body_start(rig, logs, gain), None if still is None else still.x
    motion = None
    solution = still
    misfit = False
    for turn in range(_ROUNDS):
        walk = 0.0 if solution is None else solution.rate  # without poses no log has a walk
        found = motion_information(
            rig, problem.moves, gain, gain_std, body, tilt_std, walk=walk, threads=threads or 0
        )
        if found is None:
            break
        motion = found
        problem = replace(problem, motion=found.information)
        if x is None:
            x = _start_from(problem, found.body)
        solution = solve(problem, x)
        moved = (solution.x - x)[: layout.log_mass + 1]
        x = solution.x
        gain, body = problem.motion_of(x)
        sigma = np.sqrt(np.diag(solution.covariance))[: layout.log_mass + 1]
        by = np.abs(moved / sigma)
        again, misfit = misfit, bool(misfit_of_motion(motion))
        if misfit and (again or mistakes_of_motion(rig, logs, problem.prior.gain_std)):
            # refused: further rounds would take minutes to fit what cannot be; of 96 tools on imperfect
            # hardware (benchmarks/imperfect_tools.py, seed 70) none is lost
            break
        if turn > 0 and max(float(np.sqrt(np.mean(by**2))), by[-1]) < _SETTLED:
            break
    if solution is None:
        raise InputError.at(
            logs[0].path, "", "a motion that could not be fitted", "a longer, livelier record"
        )
    return problem, solution, motion


def _start_from(problem: Problem, body: Array) -> Array:
    """The prior's mean, but for the body that the motion found."""
    x, v = problem.prior_of_all()[0], problem.vector
    mass = float(np.exp(body[0]))
    if not v.on:
        x[v.layout.body] = np.concatenate([body[:4], second_moments(mass, body[4:])])
        return x
    first = float(np.exp(x[v.before.start]))
    rest = max(mass - first, 0.05)
    center = (mass * body[1:4] - first * x[v.before.start + 1 : v.before.start + 4]) / rest
    x[v.layout.log_mass], x[v.layout.center_of_mass] = np.log(rest), np.clip(center, -1.0, 1.0)
    return x


def _determined(solution: Solution) -> dict[str, Any]:
    v = solution.problem.vector
    place, x = v.layout.body, solution.x
    P, P0 = solution.covariance[place, place], solution.prior_covariance[place, place]
    sigma, before = np.sqrt(np.diag(P)), np.sqrt(np.diag(P0))
    mass = float(np.exp(x[place.start]))
    # of the prior the spread of the second moments alone, at the mass that was found
    prior_std = mass * np.sqrt(_S_PRIOR_TO_INERTIA @ before[4:] ** 2)
    inertia = inertia_std(x[place], P) < DETERMINED * prior_std
    return {
        "mass": bool(sigma[0] < DETERMINED * before[0]),
        "center_of_mass": tuple(bool(one) for one in sigma[1:4] < DETERMINED * before[1:4]),
        "inertia": tuple(bool(one) for one in inertia),
    }


_S_PRIOR_TO_INERTIA = np.block(
    [[1.0 - np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]]
)  # I_xx = m (S_yy + S_zz), I_xy = -m S_xy


def _tool(
    rig: Rig,
    solution: Solution,
    motion: MotionFit | None,
    judged: Judged,
    left: Any,
    flange: npt.ArrayLike | None,
    housing: npt.ArrayLike | None,
    logs: Sequence[Log],
    end_ns: Sequence[int],
    on: Tool | None,
) -> Tool:
    v = solution.problem.vector
    layout, n = v.layout, v.n
    size = v.before.stop  # theta, and after it what the tool sits on
    x, P = solution.x[:size], solution.covariance[:size, :size]
    P = 0.5 * (P + P.T)
    std = np.sqrt(np.diag(P))
    mass, body = float(np.exp(x[layout.log_mass])), x[layout.body]
    place = np.zeros(6) if flange is None else np.asarray(flange, dtype=np.float64)
    shell = np.zeros(4) if housing is None else np.asarray(housing, dtype=np.float64)
    scale = rig.sensor.channel_scale
    determined = _determined(solution)
    in_motion = (0.0,) if motion is None else (motion.follows, motion.slow)
    told = all(determined["inertia"]) and (on is None or not on.exported.inertia_assumed)
    tool = Tool(
        mass=mass,
        mass_std=mass * float(std[layout.log_mass]),
        center_of_mass=x[layout.center_of_mass].copy(),
        center_of_mass_std=std[layout.center_of_mass],
        inertia=inertia_of(mass, x[layout.S]),
        inertia_std=inertia_std(body, P[layout.body, layout.body]),
        determined=determined,
        offset=x[layout.offset].copy(),
        offset_std=std[layout.offset],
        offset_time_ns=int(end_ns[-1]),
        offset_walk=solution.rate * scale,
        pose_repeatability=max(solution.repeatability, *in_motion) * scale,
        sample_noise=sample_noise(solution.problem, motion),
        vibrations=vibrations(solution.problem),
        mounting=x[layout.mounting].copy(),
        mounting_std=std[layout.mounting],
        tilt=x[layout.tilt].copy(),
        tilt_std=std[layout.tilt],
        gain=x[layout.gain].reshape(n, 6).copy(),
        covariance=P,
        exported=Body(mass, body[1:4], inertia_of(mass, body[4:])),  # until what it sits on is added
        verdict=judged.verdict,
        rig=rig,
        below=None if on is None else x[v.before].copy(),
        held_out=left,
        flange=place,
        housing=shell,
        offset_temperature=solution.x[v.slope].copy() if v.warm else None,
        offset_temperature_covariance=solution.covariance[v.slope, np.r_[:size, v.slope]] if v.warm else None,
        time_offset=0.0 if motion is None else motion.time_offset[0],
        time_offset_std=rig.sensor.time_offset_prior if motion is None else motion.time_offset[1],
        logs=tuple(
            {
                "path": None if log.path is None else str(log.path),
                "sha256": log.sha256,
                "poses": int(np.count_nonzero(solution.problem.poses.log == k)),
                "moving": solution.problem.motion is not None
                and any(move.log == k for move in solution.problem.moves),
            }
            for k, log in enumerate(logs)
        ),
        figures=judged.figures,
        version=version("truewrench"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    carried, of_body = tool.whole, layout.body
    physical = exported_body(carried.theta[of_body], carried.covariance[of_body, of_body], told, shell)
    return replace(tool, exported=physical)


def exported_body(body: Array, P: Array, inertia: bool, housing: Array) -> Body:
    """The physical body that controllers are told, with the sensor's housing, sensor axes.

    The body (10,) is log m, c, S, with the covariance P; the inertia, where it was not determined, is that of
    a sphere of 2/5 m r^2, r = max(0.05 m, |c|); the housing (4,) is mass and centre of mass.
    """
    near = nearest_physical(body, P)[0] if inertia else body
    mass, center = float(np.exp(near[0])), near[1:4]
    if inertia:
        tensor = Body(mass, center, inertia_of(mass, near[4:])).inertia_matrix
    else:
        tensor = 0.4 * mass * max(0.05, float(np.linalg.norm(center))) ** 2 * np.eye(3)
    mass, center, tensor = joined(mass, center, tensor, float(housing[0]), housing[1:])
    return Body(mass, center.copy(), tensor[ROWS, COLUMNS], inertia_assumed=not inertia)
