"""What logs of motion say of a tool, by the estimator of calibrations about a broad body.

The estimator's posterior, less the priors that it was given, is what the logs alone say of gain, body,
offsets and gravity (clock, filters, quadratic terms and slow errors integrated out with their own priors).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truewrench import _core
from truewrench.estimation.assumptions import Assumptions, statement
from truewrench.estimation.record import recorded
from truewrench.estimation.static_poses import Move
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments
from truewrench.model.motion.spatial import cross
from truewrench.model.rig import Rig
from truewrench.tool.bodies import nearest_physical
from truewrench.tool.model_rows import MotionInformation, about_center
from truewrench.tool.parameters import COLUMNS, ROWS, inertia_of, second_moments, symmetric

_LOG_MASS, _CENTER, _GYRATION = 1.0, 0.1, 0.01  # 1 sigma of the broad body: 1, [m], [m^2] times the mass
_LEAST_GAIN = 1e-4  # 1 sigma of the gains that the estimator is given at least, normalised
_EXACT = 1e-9  # variance of a direction in units of its parts' priors, at most, of which nothing can be told
_TOLD = 1e-6  # information of a direction in units of its prior: below, it is rounding
_WINDOW = 0.15  # [s] of the derivative for the start
_GAP = 0.1  # [s] across which a stream is read on the rows of another, for the start: tolerance


@dataclass(frozen=True, slots=True, eq=False)
class MotionFit:
    """What the estimator found in the logs of motion."""

    information: MotionInformation  # on gain, body, offsets, their slope and tilt
    body: Array  # (10,) log m, c, inertia at its estimate
    time_offset: tuple[float, float]  # of the last log's clock as it is logged, and its 1 sigma [s]
    masked: float  # share of the samples that were left out as contacts and outliers
    noise: Array  # (n,) that was found of each channel, over the stated, in the log where it is largest
    factors: tuple[float, ...]  # of the noise that was found, of channels and of motion, over the stated
    slow: float  # the largest slow error that was found, fraction of range
    follows: float  # the size of what residuals show to depart slowly (10.9), fraction of range
    agreement: float  # p of halves, and of quarters, of the record telling the same (10.11)
    found: object  # the estimator's own answer


def motion_information(
    rig: Rig,
    moves: Sequence[Move],
    gain: Array,
    gain_std: Array,
    body: Array,
    tilt_std: float,
    *,
    walk: float,
    threads: int = 0,
    linear_there: bool = False,
    of_log: bool = False,
) -> MotionFit | None:
    """Run the estimator about a gain and a body; None where it finds nothing that could be solved.

    With `linear_there` its sizes are its own, and what it says is linear about this gain and body, as what
    parts say that are to be compared: a gain of moments and an inertia are a product. `of_log`: with another
    log's, so that the tilt of a root frame that is this log's alone is integrated out.

    The rig is that of `settings_of`, the gain (n, 6) in raw units, mounting within; the body (10,) log m, c,
    inertia; 1 sigma of gravity's tilt in rad. Moves of one log have one clock; `walk` is the rate of the
    offset in moves where it walks, fraction of range per sqrt(s).
    """
    scale, span = rig.sensor.channel_scale, rig.sensor.range_array
    units = (scale[:, None] / span).ravel()
    assumed = Assumptions.of(rig, [move.record for move in moves])
    mass = float(np.exp(body[0]))
    sigma = float(np.sqrt(np.mean((gain_std.ravel() / units) ** 2)))
    assumed = replace(
        assumed,
        nominal=gain * span / scale[:, None],
        pool_offsets=False,  # one of each move, whose own information is taken
        gain_prior=max(sigma, _LEAST_GAIN),
        body_prior=(np.array([_LOG_MASS, *[_CENTER] * 3, *[_GYRATION * mass] * 6]),),
        tilt_prior=tilt_std if rig.in_gravity and rig.motion.source != "imu" else 0.0,
    )
    shared = statement(assumed)
    streams = []
    for move in moves:
        record = recorded(rig, assumed, move.record)
        record.payload = _physical(body)
        if move.knots.size:
            record.offset_knots, record.offset_walk = move.knots.tolist(), walk
        streams.append(record)
    settings = _core.Settings()
    settings.threads, settings.discrepancy = threads, assumed.discrepancy
    found = _core.estimate(shared, streams, settings)
    if found.status != _core.Status.ok:
        return None
    P, stated = np.asarray(found.covariance), streams[0].payload
    if linear_there:
        fit, gains, at = found.fit, slice(0, 6 * rig.sensor.n), found.fit.columns(0).body_in_theta
        theta = np.array(fit.theta)
        theta[gains], theta[at : at + 10] = np.asarray(fit.mean)[gains], body - _of_payload(stated)
        fit.theta = theta
        fit.predict()
        if not (fit.linearise() and fit.solve(frozen=True)):
            return None
        P = np.asarray(fit.covariance)
    alone = of_log and any(len(stream.own_roots) for stream in streams)
    return _taken(rig, moves, found, P, stated, units, assumed.tilt_prior > 0.0 and not alone)


def _taken(
    rig: Rig,
    moves: Sequence[Move],
    found: _core.Estimate,
    P: Array,
    stated: _core.Payload,
    units: Array,
    tilts: bool,
) -> MotionFit:
    fit, n, scale = found.fit, rig.sensor.n, rig.sensor.channel_scale
    # where the last linearisation has its top: steps end early along what the data hardly tell
    theta = np.asarray(fit.theta) + np.asarray(fit.step)
    prior, mean = np.asarray(fit.prior), np.asarray(fit.mean)
    columns = [fit.columns(k) for k in range(len(moves))]
    rows = [np.eye(theta.size)[: 6 * n] * units[:, None]]
    at = np.array(columns[0].at)
    body = columns[0].body_in_theta + np.arange(10)
    rows.append(np.eye(theta.size)[body])
    for move, c in zip(moves, columns, strict=True):
        for j, knot in enumerate(move.knots if move.knots.size else [np.inf]):
            steps = [at for at, time in zip(c.steps, c.step_times, strict=True) if time <= knot]
            pick = np.zeros((n, theta.size))
            for b in (c.b, *c.ramps[:j], *steps):
                pick[np.arange(n), np.array(c.at)[b : b + n]] += 1.0
            rows.append(pick * scale[:, None])
    if columns[0].slope >= 0:
        rows.append(np.eye(theta.size)[at[columns[0].slope :][:n]] * scale[:, None])
    # a tool has the tilt of one root frame: where each log has its own, they are integrated out
    one = len({tuple(c.at[c.tilt : c.tilt + 2]) for c in columns}) == 1 and len(columns[0].roots) < 2
    tilt = columns[0].tilt if tilts and one else -1
    if tilt >= 0:
        rows.append(np.eye(theta.size)[at[tilt : tilt + 2]])
    pick = np.vstack(rows)
    Pi = (pick * prior) @ pick.T
    own = pick @ P @ pick.T
    size = len(pick) + (0 if tilt >= 0 else 2)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    # in units of the prior, where directions that nothing was learnt of are told from rounding
    root = np.sqrt(np.diag(Pi))
    own, Pi, away = own / np.outer(root, root), Pi / np.outer(root, root), pick @ (theta - mean) / root
    values, vectors = np.linalg.eigh(Pi)
    # offsets that are stated as none, at knots after a step that was found, differ by nothing: no part of y
    free = vectors[:, values > _EXACT] if values[0] <= _EXACT else np.eye(len(Pi))
    own, Pi = free.T @ own @ free, free.T @ Pi @ free
    data = free @ (np.linalg.inv(own) - np.linalg.inv(Pi)) @ free.T
    values, vectors = np.linalg.eigh(0.5 * (data + data.T))
    told = vectors[:, values > _TOLD]
    pull = told @ (told.T @ free @ np.linalg.solve(Pi, free.T @ away))
    data = (told * values[values > _TOLD]) @ told.T
    added = np.zeros_like(data)
    gains, inertia = slice(0, 6 * n), slice(6 * n + 4, 6 * n + 10)
    added[gains, gains] = (np.asarray(found.added) + _follows_pose(rig, found)) * np.outer(units, units)
    added[inertia, inertia] = _taken_for_acceleration(fit, body[4:])
    data, pull = _widened(data, pull, added / np.outer(root, root))
    count = len(pick)
    information[:count, :count] = data / np.outer(root, root)
    gradient[:count] = pull / root
    y = np.append(pick @ np.asarray(fit.theta), np.zeros(size - count))
    y[6 * n : 6 * n + 10] += _of_payload(stated)
    # offsets at knots are sums of priors of mean zero: the gradient above holds for them, too
    at_center, by_y = about_center(y, n)
    step = pick @ np.asarray(fit.step)
    at_center += by_y[:, :count] @ step  # in which the step was linear
    y[:count] += step
    back = np.linalg.inv(by_y)
    clock = columns[-1].clock[0]
    s = np.array(columns[-1].at)[clock]
    masked = [np.asarray(fit.rows(k)["masked"]).ravel() > 0.0 for k in range(len(moves))]
    return MotionFit(
        MotionInformation(at_center, back.T @ information @ back, back.T @ gradient),
        y[6 * n : 6 * n + 10],
        (-float(theta[s]) - moves[-1].record.advance(), float(np.sqrt(P[s, s]))),
        float(np.mean(np.concatenate(masked))) if masked else 0.0,
        np.max([_noise_found(fit, k, move.record, n) for k, move in enumerate(moves)], axis=0),
        tuple(
            float(f)
            for k in range(len(moves))
            for group in (fit.sizes(k).raw_factor, *fit.sizes(k).motion_factor)
            for f in group
        ),
        max(
            (
                float(np.max(fit.sizes(k).delta))
                for k in range(len(moves))
                if fit.sizes(k).form not in (_core.Form.none, _core.Form.bridge)
            ),
            default=0.0,
        ),
        0.0 if rig.sensor.discrepancy == 0 else float(np.sqrt(np.max(found.discrepancy2, initial=0.0))),
        float(np.min([found.halves.p, found.quarters.p])),
        found,
    )


def _noise_found(fit: _core.Fit, k: int, log: Log, n: int) -> Array:
    """(n,) factor on the stated noise of each channel: forces and moments of six, else all at once."""
    factors = np.asarray(fit.sizes(k).raw_factor) / log.calmed.get("raw", 1.0)
    return np.repeat(factors, n // len(factors))


def _follows_pose(rig: Rig, found: _core.Estimate) -> Array:
    """(6n, 6n) of the gain, by (10.10), whatever its prior: what the gain cannot take the body does."""
    stated = rig.sensor.discrepancy
    if stated == 0:
        return np.zeros((6 * rig.sensor.n, 6 * rig.sensor.n))
    f2 = np.maximum(np.asarray(found.discrepancy2), 0.0 if stated == "auto" else stated**2)
    return np.asarray(np.kron(np.diag(f2), found.pose.unit_covariance))


def _taken_for_acceleration(fit: _core.Fit, places: Integers) -> Array:
    """(6, 6) b b^T, b = P d log |H_xx| / d inertia / 2: what an inertia at the best motion may be off by.

    Where the sensor's rows tell the angular acceleration as well as the motion's own rows do, as of slow arms
    whose positions alone are logged, the motion follows the sensor's noise, and the inertia for more; what
    the likelihood (10.7) has against that is log |H_xx|, at most. Of 24 ordinary tools 0.01 to 0.5 sigma, of
    such arms 1 to 20: in each of 9 runs an inertia that nothing told was 3 to 4.5 sigma off, now 0.4.
    """
    b = 0.5 * np.asarray(fit.P)[np.ix_(places, places)] @ fit.slope_of_determinant(places.tolist())
    return np.outer(b, b)


def _widened(data: Array, pull: Array, added: Array) -> tuple[Array, Array]:
    """Information and gradient where what logs show departs from gain and body by more than their noise.

    `added` is the covariance of that, by slow errors and poses (10.9, 10.10) of the gain, which moves the
    body with it: (data^-1 + B B^T)^-1 by Woodbury's identity, for data that may be singular. What the data
    are most likely at stays: the gradient, which is data times the way there, shrinks with them.
    """
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    keep = values > 1e-18
    if not keep.any():
        return data, pull
    B = vectors[:, keep] * np.sqrt(values[keep])
    inner = np.eye(B.shape[1]) + B.T @ data @ B
    out: Array = data - data @ B @ np.linalg.solve(inner, B.T @ data)
    return 0.5 * (out + out.T), pull - data @ B @ np.linalg.solve(inner, B.T @ pull)


def _physical(body: Array) -> _core.Payload:
    """The nearest physical body, as the core takes it."""
    mass = float(np.exp(body[0]))
    S = second_moments(mass, body[4:])
    numbers = np.concatenate([body[:4], S])
    spread = np.diag(np.array([1.0, *[0.1] * 3, *[0.01] * 6]) ** 2)
    near, _ = nearest_physical(numbers, spread)
    return _core.Payload(mass, near[1:4], symmetric(inertia_of(mass, near[4:])))


def _of_payload(stated: _core.Payload) -> Array:
    """(10,) log m, c, inertia."""
    inertia = np.asarray(stated.inertia)[ROWS, COLUMNS]
    return np.concatenate([[np.log(stated.mass)], np.asarray(stated.center_of_mass), inertia])


def body_start(rig: Rig, logs: Sequence[Log], gain: Array) -> Array:
    """(10,) log m, c, inertia by least squares on differentiated velocities, at a gain taken as exact.

    InputError: the logs are too short to be differentiated.
    """
    A, b = [], []
    back = np.linalg.pinv(gain)
    for k, log in enumerate(logs):
        for rows, nu, a, g in measured_motions(rig, log):
            w = rig.sensor.sign * on_rows(log, log.raw, rows) @ back.T
            know = np.isfinite(np.column_stack([w, g])).all(axis=1)
            if know.sum() < 3:
                continue
            Y = regressor(nu[know], a[know], g[know])
            offset = np.zeros((len(Y), 6, 6 * len(logs)))
            offset[:, :, 6 * k : 6 * k + 6] = np.eye(6)
            weight = (1.0 / rig.sensor.range_array)[:, None]
            A.append((np.concatenate([Y, offset], axis=2) * weight).reshape(-1, 10 + 6 * len(logs)))
            b.append((w[know] * weight.T).ravel())
    if not A:
        raise InputError.at(logs[0].path, "", "too little motion to be differentiated", "a second of it")
    x = np.linalg.lstsq(np.vstack(A), np.concatenate(b), rcond=1e-10)[0]
    mass = float(np.clip(x[0], 0.02, 1e5))
    center = x[1:4] / mass if x[0] > 0.02 else np.zeros(3)
    center = np.clip(center, -1.0, 1.0)
    about = symmetric(x[4:10]) - mass * (center @ center * np.eye(3) - np.outer(center, center))
    S = second_moments(mass, about[ROWS, COLUMNS])
    spread = np.diag(np.array([1.0, *[0.1] * 3, *[0.01] * 6]) ** 2)
    near, _ = nearest_physical(np.concatenate([[np.log(mass)], center, S]), spread)
    return np.concatenate([near[:4], inertia_of(mass, np.clip(near[4:], -0.25, 0.25))])


def on_rows(log: Log, values: Array, rows: Integers) -> Array:
    """Values (N, k) at some rows; where a stream has rows of its own, on a line between those on both sides.

    NaN across more than `_GAP`. For starts: the estimator reads every stream at its own stamps.
    """
    out = values[rows].copy()
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    lacking = ~np.isfinite(out).all(axis=1)
    if not lacking.any() or known.size < 2:
        return out
    time, at = log.time[known], log.time[rows[lacking]]
    after = np.clip(np.searchsorted(time, at), 1, known.size - 1)
    before, step = after - 1, time[after] - time[after - 1]
    share = (at - time[before]) / step
    line = (1.0 - share)[:, None] * values[known[before]] + share[:, None] * values[known[after]]
    line[(share < 0.0) | (share > 1.0) | (step > _GAP)] = np.nan
    out[lacking] = line
    return out


def measured_motions(rig: Rig, log: Log) -> list[tuple[Integers, Array, Array, Array]]:
    """Rows, twist of the sensor's origin, its derivative and free fall there, piece by piece."""
    out: list[tuple[Integers, Array, Array, Array]] = []
    if log.tracking is not None and log.tracking.reference is not None:
        since: Array = np.asarray((log.time_ns - log.tracking.reference.origin_ns) * 1e-9, np.float64)
        nu, a, g = log.tracking.reference.motion(since)
        rows = np.flatnonzero(np.isfinite(log.raw).all(axis=1))
        return [(rows, nu[rows], a[rows], g[rows])]
    imu = rig.motion.source == "imu"
    values = log.angular_velocity if imu else log.twist
    if values is None:
        return out
    from scipy.signal import savgol_filter  # brings scipy.stats: half a second

    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    force = np.zeros((len(rows), 3))
    if imu:
        assert log.specific_force is not None
        force = on_rows(log, log.specific_force, rows)
        known = np.isfinite(force).all(axis=1)
        rows, force = rows[known], force[known]
    fall = np.zeros((len(log.time), 3)) if log.gravity is None or imu else log.gravity
    for piece in segments(log.time[rows]):
        at = rows[piece]
        if at.size < 7:
            continue
        period = float(np.median(np.diff(log.time[at])))
        window = min(2 * max(2, round(0.5 * _WINDOW / period)) + 1, (at.size - 1) // 2 * 2 + 1)
        smooth = savgol_filter(values[at], window, 3, axis=0)
        rate = savgol_filter(values[at], window, 3, deriv=1, delta=period, axis=0)
        if imu:
            felt = savgol_filter(force[piece], window, 3, axis=0)
            zero = np.zeros_like(felt)
            out.append((at, np.column_stack([zero, smooth]), np.column_stack([felt, rate]), zero))
        else:
            out.append((at, smooth, rate, on_rows(log, fall, at)))
    return out


def regressor(nu: Array, a: Array, g: Array) -> Array:
    """Y (N, 6, 10): w = Y (m, m c, inertia about the sensor's origin), `payload_on_sensor`."""
    v, omega, alpha = nu[:, :3], nu[:, 3:], a[:, 3:]
    force = a[:, :3] + cross(omega, v) - g
    Y = np.zeros((len(nu), 6, 10))
    Y[:, :3, 0] = -force
    for k, e in enumerate(np.eye(3)):
        Y[:, :3, 1 + k] = -(cross(alpha, e) + cross(omega, cross(omega, e)))
        Y[:, 3:, 1 + k] = -cross(e, force)
    for k, element in enumerate(np.eye(6)):
        unit = symmetric(element)
        Y[:, 3:, 4 + k] = -(alpha @ unit + cross(omega, omega @ unit))
    return Y
