"""Joint logs as motions of the sensor: a reference that the encoders follow, and how far they are from it.

What joints measure is a pose, and the wrench needs its derivatives: nothing is differenced. A smooth
reference is fitted to encoders and tachometers, and the estimators find the displacement of the sensor from
it, together with the gain (docs/method.md, "Joints").
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline, make_interp_spline

from truewrench import _core
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.log import Log, Reference, Tracking
from truewrench.model.motion.joint_spline import JointSpline, fit_joints
from truewrench.model.motion.smooth import covered, segments
from truewrench.model.rig import Rig
from truewrench.robot.arm import Robot, robot_of
from truewrench.robot.base_path import BasePath
from truewrench.robot.chain import SensorMotion, chain_of, sensor_motion
from truewrench.robot.parts import together, unwrapped
from truewrench.robot.pauses import Pauses

_FEWEST = 16  # rows of a joint stream that a motion can be made of
_WIDER = 2.0  # knots of the reference, in units of the coarsest that the encoders accept (docs/method.md)
_SITES = 8.0  # knots of its twist in one of those
_FALLS = 2  # and samples of its gravity, between which the core interpolates cubically, in one of these
_EXACT = 1e-6  # variance of a direction that no joint moves, relative to the others'
_LOOSE = 100.0  # sigma of what is put into a gap, in units of the encoders'
_ANCHORS = 0.25  # [s] between the rows at which integrated velocities tell a position, but
_APART = 4  # rows at least: these samples have no noise that could be judged


def tracked(rig: Rig, logs: Sequence[Log]) -> list[Log]:
    """Logs with their tracking, where the rig has joints and a log has none yet, and is no log of twists."""
    if rig.motion.source == "joints":
        return [track(rig, log) if log.tracking is None else log for log in logs]
    for log in logs:
        if log.tracking is not None:
            raise InputError.at(rig.path, "motion.source", "`twist`", "`joints`, with which the log was read")
    return list(logs)


def track(rig: Rig, log: Log, *, exact_positions: bool = False) -> Log:
    """The log of a joint rig with the twist, the gravity and the tracking of its sensor.

    With `motion.position_noise` encoders and tachometers are followed together; without it, or if they are
    `exact_positions`, logged positions are exact, and velocities alone are measurements; without logged
    positions these are integrated. A log with a wrench known from elsewhere needs no joints. InputError:
    streams leave the motion undetermined.
    """
    if log.position is None and log.velocity is None:
        if log.reference is not None:
            return log
        raise InputError.at(log.path, "", "no joints", "positions `q_*` or velocities `dq_*`")
    robot = robot_of(rig)
    for name, values in (("position", log.position), ("velocity", log.velocity)):
        if values is not None and values.shape[1] != robot.n:
            expected = f"{robot.n}: {', '.join(robot.joints)}"
            raise InputError.at(log.path, name, f"{values.shape[1]} joints", expected)
    log = unwrapped(rig, log)
    pauses = Pauses.of(log)
    short = pauses.without(log) if pauses else log
    base = BasePath.of(rig, short)
    position, velocity = base.within(short, log.position), base.within(short, log.velocity)
    within = together(rig, replace(short, position=position, velocity=velocity))
    if log.position is None:
        found = _integrated(rig, robot, base, within)
    elif rig.motion.position_noise is not None and not exact_positions:
        found = _encoders(rig, robot, base, within)
    else:
        found = _exact_positions(rig, robot, base, within)
    tracking = found.tracking
    if pauses and tracking is not None and tracking.reference is not None:
        tracking = replace(tracking, reference=pauses.within(tracking.reference))
    return replace(
        found, time_ns=log.time_ns, tracking=tracking, position=log.position, velocity=log.velocity
    )


def measured_twists(rig: Rig, log: Log) -> Log:
    """The log of a joint rig with the twist that its tachometers measure, through the manipulator Jacobian.

    Encoders tell pose and gravity only: a twist of theirs would be a difference of samples. InputError: there
    are no joint velocities, or neither positions nor `motion.initial_position`.
    """
    if log.velocity is None or rig.motion.noise is None:
        found = "no column dq_*" if log.velocity is None else "no `motion.noise`"
        expected = "joint velocities and their noise: of positions alone `map` makes a calibration"
        raise InputError.at(log.path, "dq_*", found, expected)
    return track(rig, log, exact_positions=True)


def with_twist(rig: Rig, log: Log) -> Log:
    """The log with a twist, by what takes least time: of joints that of the tachometers, where there are any.

    It is that of `track` where those have samples, which fits a reference beside it.
    """
    told = log.position is not None and log.velocity is not None and rig.motion.noise is not None
    if rig.motion.source == "joints" and log.tracking is None and told:
        return measured_twists(rig, log)
    return tracked(rig, [log])[0]


def _encoders(rig: Rig, robot: Robot, base: BasePath, log: Log) -> Log:
    positions, velocities = _rows(log, log.position, "q_*"), None
    if log.velocity is not None and rig.motion.noise is not None:
        velocities = _rows(log, log.velocity, "dq_*")
    time_q, q = _without_gaps(log.time[positions], _of(log.position, positions))
    weight_q = np.where(np.isin(time_q, log.time[positions]), 1.0, 1.0 / _LOOSE)
    rates = (np.zeros(0), np.zeros((0, robot.n)))
    if velocities is not None:
        rates = (log.time[velocities], _of(log.velocity, velocities))
    fit = fit_joints(
        (time_q, q, weight_q),
        rates,
        np.array(rig.motion.position_noise),
        rig.motion.noise_array if velocities is not None else np.ones(robot.n),
        wider=_WIDER,
    )
    moved = _on_rows(log, positions, _of(log.position, positions) - fit.position(log.time[positions]))
    return _about(rig, robot, base, log, fit, moved, velocities)


def _integrated(rig: Rig, robot: Robot, base: BasePath, log: Log) -> Log:
    """Velocities alone: positions are their integral, and walk away from the truth with their noise.

    What is known of a position after a time t is sigma sqrt(t dt). Its error is one for the whole log: a few
    rows say so, which together are given no more information than one of them has.
    """
    if rig.motion.initial_position is None:
        raise InputError.at(
            rig.path, "motion.initial_position", "nothing", "joint positions: the log has none"
        )
    if rig.motion.noise is None:
        expected = "1 sigma of the velocities: the log has no positions"
        raise InputError.at(rig.path, "motion.noise", "nothing", expected)
    rows = _rows(log, log.velocity, "dq_*")
    time, sigma = log.time[rows], rig.motion.noise_array
    nothing = (np.zeros(0), np.zeros((0, robot.n)), np.zeros(0))
    fit = fit_joints(nothing, (time, _of(log.velocity, rows)), np.ones(robot.n), sigma, wider=_WIDER)
    fit = fit.shifted(np.array(rig.motion.initial_position) - fit.position(time[:1])[0])
    period = float(np.median(np.diff(time)))
    walked = np.sqrt(period * (time - time[0] + period))[:, None] * sigma
    departure = _of(log.velocity, rows) - fit.velocity(time)
    moved = _on_rows(log, rows, cumulative_trapezoid(departure, time, axis=0, initial=0))
    found = _about(rig, robot, base, log, fit, moved, rows)
    assert found.tracking is not None
    chosen = np.arange(0, rows.size, max(_APART, round(_ANCHORS / period)))
    known = _on_rows(log, rows[chosen], np.sqrt(chosen.size) * walked[chosen])
    return replace(found, tracking=replace(found.tracking, position_sigma=known))


def _about(
    rig: Rig,
    robot: Robot,
    base: BasePath,
    log: Log,
    fit: JointSpline,
    moved: Array,
    velocities: Integers | None,
) -> Log:
    """The log about a reference, from which positions depart by `moved` (N, n)."""
    chain = chain_of(robot)
    reference = _reference(rig, chain, base, log, fit)
    rows = np.flatnonzero(np.isfinite(moved).all(axis=1))
    if velocities is not None:
        rows = np.union1d(rows, velocities)
    time = log.time[rows]
    at, rate = fit.position(time), fit.velocity(time)
    about = sensor_motion(chain, base, time, at, rate)
    twist, qd, faster = about.twist, rate, None
    if velocities is not None:
        told = np.searchsorted(rows, velocities)
        qd = rate.copy()
        qd[told] = _of(log.velocity, velocities)
        faster = _on_rows(log, velocities, qd[told] - rate[told])
    measured = sensor_motion(chain, base, time, at + np.nan_to_num(moved[rows]), qd)
    if velocities is not None:
        twist = np.full_like(twist, np.nan)
        twist[told] = measured.twist[told]
    return replace(
        log,
        twist=_on_rows(log, rows, twist),
        gravity=None if not rig.in_gravity else _on_rows(log, rows, _fall(rig, measured)),
        tracking=Tracking(
            jacobian=_on_rows(log, rows, about.jacobian),
            jacobian_rate=_on_rows(log, rows, about.jacobian_rate),
            position_departure=moved,
            velocity_departure=faster,
            reference=reference,
        ),
    )


def _exact_positions(rig: Rig, robot: Robot, base: BasePath, log: Log) -> Log:
    """Positions are exact, and velocities alone are measurements."""
    if log.velocity is None:
        expected = "joint velocities, where position_noise is not given"
        raise InputError.at(log.path, "header", "no column dq_*", expected)
    rows, known = _rows(log, log.velocity, "dq_*"), _rows(log, log.position, "q_*")
    rows = rows[covered(log.time[known], log.time[rows])]
    time, q = log.time[rows], _of(log.position, rows)
    if not np.isin(rows, known).all():
        q = np.asarray(CubicSpline(log.time[known], _of(log.position, known), axis=0)(time))
    moving = sensor_motion(chain_of(robot), base, time, q, _of(log.velocity, rows))
    return replace(
        log,
        twist=_on_rows(log, rows, moving.twist),
        gravity=None if not rig.in_gravity else _on_rows(log, rows, _fall(rig, moving)),
        tracking=Tracking(jacobian=_on_rows(log, rows, moving.jacobian)),
    )


def _reference(rig: Rig, chain: _core.Chain, base: BasePath, log: Log, fit: JointSpline) -> Reference:
    count = max(1, int(np.ceil((fit.end - fit.begin) / fit.spacing * _WIDER * _SITES)))
    breakpoints = np.linspace(fit.begin, fit.end, count + 1)
    knots = np.concatenate([np.full(5, fit.begin), breakpoints, np.full(5, fit.end)])
    sites = np.array([knots[k + 1 : k + 6].mean() for k in range(count + 5)])  # Greville's
    sites[[0, -1]] = fit.begin, fit.end
    moving = sensor_motion(chain, base, sites, fit.position(sites), fit.velocity(sites))
    time = np.linspace(fit.begin, fit.end, _FALLS * count + 1)
    fall = None
    if rig.in_gravity:
        fall = _fall(rig, sensor_motion(chain, base, time, fit.position(time), fit.velocity(time)))
    return Reference(
        origin_ns=int(log.time_ns[0]),
        breakpoints=breakpoints,
        twist=np.ascontiguousarray(make_interp_spline(sites, moving.twist, k=5, t=knots).c),
        spacing=fit.spacing,
        gravity_time=time,
        gravity=fall,
    )


def _fall(rig: Rig, moving: SensorMotion) -> Array:
    """Free fall (N, 3) in sensor axes."""
    return np.asarray(moving.R_sensor_inertial @ rig.gravity_array)


def _rows(log: Log, values: Array | None, columns: str) -> Integers:
    """Rows with all joints of a stream."""
    assert values is not None
    finite = np.isfinite(values)
    rows = np.flatnonzero(finite.all(axis=1))
    partial = int(np.count_nonzero(finite.any(axis=1))) - rows.size
    if rows.size < max(_FEWEST, partial):
        found = f"{rows.size} rows with all joints, {partial} with some of them"
        raise InputError.at(
            log.path, columns, found, f"at least {_FEWEST} rows with all joints, and most of them"
        )
    return rows


def _of(values: Array | None, rows: Integers) -> Array:
    assert values is not None
    return values[rows]


def _on_rows(log: Log, rows: Integers, values: Array) -> Array:
    """Values of some rows of a log, NaN in the others."""
    out: Array = np.full((len(log.time_ns), *values.shape[1:]), np.nan)
    out[rows] = values
    return out


def _without_gaps(time: Array, values: Array) -> tuple[Array, Array]:
    """Samples with straight lines through the gaps, for a reference that is defined there, too."""
    pieces = segments(time)
    if len(pieces) == 1:
        return time, values
    period = float(np.median(np.diff(time)))
    times, rows = [time], [values]
    for before, after in pairwise(pieces):
        a, b = before.stop - 1, after.start
        inside = np.linspace(time[a], time[b], 1 + int((time[b] - time[a]) / period))[1:-1]
        share = ((inside - time[a]) / (time[b] - time[a]))[:, None]
        times.append(inside)
        rows.append(values[a] + share * (values[b] - values[a]))
    order = np.argsort(np.concatenate(times), kind="stable")
    return np.concatenate(times)[order], np.concatenate(rows)[order]


@dataclass(frozen=True, slots=True, eq=False)
class TrackedStream:
    """What joints measured of the sensor's motion."""

    order: int  # which derivative of the coordinates: of the twist, or of the displacement from the reference
    rows: Integers  # (M,) of the log
    value: Array  # (M, 6)
    covariance: Array  # (M, 6, 6)
    # (M, 6, 6) of the derivative of the order below, which is added; None for zero
    coupling: Array | None = None


def tracked_streams(rig: Rig, log: Log) -> list[TrackedStream]:
    """The measurements of a log with tracking, with the noise that a rig states.

    Without a reference the twist J qd is a measurement with the covariance J Sigma J^T ([A00] 26). About one,
    encoders measure the displacement xi = J (q - q_ref), and tachometers

        J (qd - qd_ref) + Jdot (E - J^# J) (q - q_ref) = dxi/dt - Jdot J^# xi,

    J^# being the inverse that the noise of the encoders weighs. What of q moves no sensor is no part of xi,
    but as the encoders tell it. Their stream is the first, but for velocities alone.
    """
    tracking, sigma = log.tracking, rig.motion.noise_array
    assert tracking is not None
    assert log.twist is not None
    if tracking.reference is None:
        rows = np.flatnonzero(np.isfinite(log.twist).all(axis=1))
        return [TrackedStream(0, rows, log.twist[rows], _covariance(tracking.jacobian[rows], sigma))]
    assert tracking.position_departure is not None
    known, told = tracking.position_sigma, np.isfinite(tracking.position_departure).all(axis=1)
    rows = np.flatnonzero(told if known is None else told & np.isfinite(known).all(axis=1))
    J = tracking.jacobian[rows]
    sigma_q = np.ones(J.shape[2]) if known is not None else np.array(rig.motion.position_noise)
    covariance = _covariance(J if known is None else J * known[rows][:, None], sigma_q)
    streams = [TrackedStream(0, rows, _times(J, tracking.position_departure[rows]), covariance)]
    if tracking.velocity_departure is None:
        return streams
    assert tracking.jacobian_rate is not None
    rows = np.flatnonzero(np.isfinite(tracking.velocity_departure).all(axis=1))
    J, J_rate = tracking.jacobian[rows], tracking.jacobian_rate[rows]
    weighted = np.einsum("j,kij->kji", sigma_q**2, J)  # Sigma J^T
    inverse = weighted @ np.linalg.inv(_covariance(J, sigma_q))
    unseen = J_rate @ (np.eye(sigma_q.size) - inverse @ J)  # Jdot (E - J^# J)
    at = log.time[told]
    q = np.column_stack([np.interp(log.time[rows], at, x) for x in tracking.position_departure[told].T])
    faster = _times(J, tracking.velocity_departure[rows]) + _times(unseen, q)
    covariance = _covariance(J, sigma)
    if known is None:
        covariance += np.einsum("kij,j,klj->kil", unseen, sigma_q**2, unseen)
    streams.append(TrackedStream(1, rows, faster, covariance, np.ascontiguousarray(-J_rate @ inverse)))
    return streams if known is None else streams[::-1]


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("kij,kj->ki", matrices, vectors))


def _covariance(J: Array, sigma: Array) -> Array:
    """J Sigma J^T (N, 6, 6), of full rank also where the joints cannot move the sensor in some direction."""
    covariance = np.einsum("kij,j,klj->kil", J, sigma**2, J)
    floor = _EXACT * np.trace(covariance, axis1=1, axis2=2) / 6.0
    return np.ascontiguousarray(covariance + floor[:, None, None] * np.eye(6))
