"""Clocks of sensor and motion that are far apart, brought together before an estimate.

Whatever body the sensor carries and whatever its gain, each channel is linear in what the motion tells,

    raw(t + s) = X(t) k + b,     X = [vdot + Omega x v - g, Omegadot, Omega_i Omega_j],

s being how late the sensor is. The estimate goes from s = 0 and finds some 30 ms; what is further away turns
the wrench, and Gauss-Newton with it, to another gain. So s is sought by these least squares, and undone at
the sensor's stamps where it leaves a small share of what s = 0 leaves; what is left of it is estimated.
"""

from dataclasses import replace

import numpy as np

from truewrench.estimation.clock_rate import with_stamps
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments, uniform_spline
from truewrench.model.motion.spatial import cross
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.robot.track import with_twist

SECONDS, FURTHEST = 8.0, 1.0  # [s] of a log, from its middle, and of s, a quarter of those seconds at most
LEAST, GRID = 0.03, 0.01  # [s] that an estimate finds by itself, and steps in which s is sought
KNOTS, FEWEST, MOST = 0.1, 100, 1000  # [s] of a spline; rows of motion
LOOKED_AT = 400  # rows of the sensor: thirteen columns follow none of them
MISFIT, SHARE = 4.0, 1e-4  # mean square left, over noise's and the raw output's: beyond both it is asked
BENT = 0.05  # [s] of s by which (10.4) goes on to bend: of 3 Hz; all of it biased kappa by 2 sigma
BETTER = 10.0  # times less must be left: set in none of 1,360 records on one clock (benchmarks/far_clocks.py)

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def with_clock_set(rig: Rig, log: Log) -> Log:
    """The log with the sensor's stamps as early as they should be, to a sample; itself where they are."""
    middle = 0.5 * float(log.time[-1]) if len(log.time_ns) else 0.0
    rows = np.abs(log.time - middle) <= 0.5 * SECONDS
    with np.errstate(all="ignore"):  # whatever the cells hold
        late = _late(rig, log if rows.all() else rows_of(log, rows))
    if late == 0.0:
        return log
    sensed = np.flatnonzero(np.isfinite(log.raw).any(axis=1))
    period = int(np.median(np.diff(log.time_ns[sensed])))
    by = round(1e9 * late / period) * period  # rows that held sensor and motion go on to do so
    set_back = with_stamps(log, log.time_ns[sensed] - by)
    return replace(set_back, clock_set=log.clock_set + 1e-9 * by)


def bent(clock_set: float) -> float:
    """Whose square kappa of (10.4) multiplies beside that of what is left of s [s]."""
    return min(abs(clock_set), BENT)


def _late(rig: Rig, log: Log) -> float:
    """How late the sensor is [s], 0 where that is not told."""
    sensed = np.isfinite(log.raw).all(axis=1)
    if np.count_nonzero(sensed) < FEWEST:
        return 0.0
    found = _motion(rig, log)
    if found is None or not np.isfinite(found[1]).all():
        return 0.0
    known, X = found
    X = X / np.abs(X).max(axis=0).clip(1e-12)
    rows = np.flatnonzero(sensed)
    furthest = min(FURTHEST, 0.25 * float(log.time[rows[-1]] - log.time[rows[0]]))
    # the same samples for every s: a contact would stay outside of others
    rows = rows[(log.time[rows] >= known[0] + furthest) & (log.time[rows] <= known[-1] - furthest)]
    rows = rows[:: max(1, -(-rows.size // LOOKED_AT))]
    if rows.size < FEWEST:
        return 0.0
    time, raw = log.time[rows], log.raw[rows] / rig.sensor.noise_array

    def left(late: float) -> float:
        moved = [np.interp(time - late, known, column) for column in X.T]
        Q = np.linalg.qr(np.column_stack([*moved, np.ones(time.size)]))[0]
        return float(np.mean((raw - Q @ (Q.T @ raw)) ** 2))

    here = left(0.0)
    if not here > max(MISFIT, SHARE * float(np.var(raw, axis=0).mean())):
        return 0.0
    steps = int(furthest / GRID)
    lates = GRID * np.arange(-steps, steps + 1)
    all_left = np.array([left(late) for late in lates])
    k = int(np.argmin(all_left))
    told = 0 < k < lates.size - 1 and here > BETTER * all_left[k] and abs(lates[k]) > LEAST
    return float(lates[k]) if told else 0.0


def _motion(rig: Rig, log: Log) -> tuple[Array, Array] | None:
    """Times (K,) and X (K, 12) at them, by one smooth twist a stretch; None where nothing tells it."""
    imu = rig.motion.source == "imu"
    try:
        log = with_twist(rig, log)
    except (InputError, np.linalg.LinAlgError):  # the estimate says what is wrong with it
        return None
    linear, turning = log.specific_force if imu else log.twist, log.angular_velocity
    if linear is None or (imu and turning is None) or (not imu and rig.in_gravity and log.gravity is None):
        return None
    fall = None if imu or not rig.in_gravity else log.gravity
    motion = np.column_stack([x for x in (linear, turning if imu else None, fall) if x is not None])
    known = np.flatnonzero(np.isfinite(motion).all(axis=1))
    known = known[:: max(1, -(-known.size // MOST))]
    times, features = [], []
    for piece in segments(log.time[known]):
        rows = known[piece]
        if rows.size < FEWEST:
            continue
        t = log.time[rows]
        intervals = max(1, round(min((t[-1] - t[0]) / KNOTS, rows.size / 3.0)))
        spline = uniform_spline(t, motion[rows, :6], intervals)
        nu, rate = spline(t), spline(t, nu=1)
        omega = nu[:, 3:]
        force = nu[:, :3] if imu else rate[:, :3] + cross(omega, nu[:, :3])
        if fall is not None:
            force = force - fall[rows]
        products = np.column_stack([omega[:, i] * omega[:, j] for i, j in PAIRS])
        times.append(t)
        features.append(np.column_stack([force, rate[:, 3:], products]))
    return (np.concatenate(times), np.concatenate(features)) if times else None
