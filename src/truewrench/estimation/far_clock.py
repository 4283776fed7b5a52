"""Clocks of sensor and motion that are far apart, brought together before an estimate.

Whatever body the sensor carries and whatever its gain, each channel is linear in what the motion tells,

    raw(t + s) = X(t) k + b,     X = [vdot + Omega x v - g, Omegadot, Omega_i Omega_j],

s being how late the sensor is; where a driver has subtracted a weight, g has columns of its own. The estimate
goes from s = 0 and finds some 30 ms; what is further away turns the wrench, and Gauss-Newton with it, to
another gain. So s is sought by these least squares, and undone at the sensor's stamps where it leaves a small
share of what s = 0 leaves; what is left of it is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truewrench.estimation.clock_rate import with_stamps
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments, uniform_spline
from truewrench.model.motion.spatial import cross
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.robot.compensation import weight_added
from truewrench.robot.track import with_twist

# [s] about a log's middle, of s (a quarter of those at most), of the steps in which it is sought; s and steps
# where more than a share is left, as where a logger was started by hand
SECONDS, FURTHEST, GRID = 8.0, 1.0, 0.01
AFAR, COARSE, AMISS = 10.0, 0.02, 5e-3
LEAST = 0.03  # [s] that an estimate finds by itself
KNOTS, FEWEST, MOST = 0.1, 100, 1000  # [s] of a spline; rows of motion
LOOKED_AT = 400  # rows of the sensor: thirteen columns follow none of them
MISFIT, SHARE = 4.0, 1e-4  # mean square left, over noise's and the raw output's: beyond both it is asked
BENT = 0.05  # [s] of s by which (10.4) goes on to bend: of 3 Hz; all of it biased kappa by 2 sigma
BETTER = 10.0  # times less must be left: set in none of 1,520 records on one clock (benchmarks/far_clocks.py)
ALIKE = 2.0  # times as much is left in another valley: tolerance
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def with_clock_set(rig: Rig, log: Log) -> Log:
    """The log with the sensor's stamps as early as they should be, to a sample; itself where they are."""
    with np.errstate(all="ignore"):  # whatever the cells hold
        late = _late(rig, log)
    if late == 0.0:
        return log
    sensed = np.flatnonzero(np.isfinite(log.raw).any(axis=1))
    period = int(np.median(np.diff(log.time_ns[sensed])))
    by = round(1e9 * late / period) * period  # rows that held sensor and motion go on to do so
    set_back = with_stamps(log, log.time_ns[sensed] - by)
    return replace(set_back, clock_set=log.clock_set + 1e-9 * by)


def bent(clock_set: float) -> float:
    """By which (10.4) bends beside what is left of s [s]."""
    return float(np.clip(clock_set, -BENT, BENT))


def set_within(rig: Rig, log: Log) -> float:
    """How much later the sensor is at the end of a log than at its beginning [s], 0 where that is not told.

    Each end, with the clock of the other, has to leave `BETTER` times what it leaves with its own.
    """
    seconds = min(SECONDS, 0.4 * float(log.time[-1])) if len(log.time_ns) else 0.0
    ends = (log.time <= seconds, log.time >= log.time[-1:] - seconds)
    with np.errstate(all="ignore"):  # whatever the cells hold
        found = [
            one for rows in ends if (one := _Asked.of(rig, rows_of(log, rows), FURTHEST, GRID)) is not None
        ]
        if len(found) < len(ends):
            return 0.0
        count = min(one.lates.size for one in found)
        lefts = [one.lefts()[(one.lates.size - count) // 2 :][:count] for one in found]
    i, j = (int(np.argmin(left)) for left in lefts)
    inside = all(0 < k < count - 1 for k in (i, j))
    told = lefts[0][j] > BETTER * lefts[0][i] and lefts[1][i] > BETTER * lefts[1][j]
    return GRID * (j - i) if inside and told else 0.0


def _late(rig: Rig, log: Log) -> float:
    """How late the sensor is [s], 0 where that is not told."""
    asked = _Asked.of(rig, _middle(log, SECONDS), FURTHEST, GRID)
    if asked is None:
        return 0.0
    here, whole = asked.left(0.0), float(np.var(asked.raw, axis=0).mean())
    if not here > max(MISFIT, SHARE * whole):
        return 0.0
    found = asked.latest(here)
    if found == 0.0 and here > AMISS * whole:
        asked = _Asked.of(rig, _middle(log, SECONDS + 2.0 * AFAR), AFAR, COARSE)
        found = 0.0 if asked is None else asked.latest(asked.left(0.0))
    return found


def left_of_any_body(rig: Rig, log: Log) -> tuple[float, float] | None:
    """What no gain and no body explain of the raw output of a log, on the clock that it has.

    As a share of it, and as a mean square over the noise's; None where nothing tells the motion.
    """
    with np.errstate(all="ignore"):  # whatever the cells hold
        asked = _Asked.of(rig, log, 0.0, GRID)
        if asked is None:
            return None
        left, whole = asked.left(0.0), float(np.var(asked.raw, axis=0).mean())
    return (left / whole, left) if np.isfinite(left) and whole > 0.0 else None


def _middle(log: Log, seconds: float) -> Log:
    """So many seconds of a log."""
    rows = np.abs(log.time - 0.5 * log.time[-1:]) <= 0.5 * seconds
    return log if rows.all() else rows_of(log, rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """Samples of the sensor, the same for every s: a contact would stay outside of others."""

    time: Array  # (N,) [s]
    raw: Array  # (N, n) over the noise
    known: Array  # (K,) times of the motion [s]
    X: Array  # (K, 12 or 15)
    lates: Array  # s that are asked [s]

    @classmethod
    def of(cls, rig: Rig, log: Log, furthest: float, grid: float) -> _Asked | None:
        """None where there are too few samples, or nothing tells the motion."""
        read = log.raw if log.weight_offset is None else log.raw - weight_added(rig, log)
        rows = np.flatnonzero(np.isfinite(read).all(axis=1))
        found = _motion(rig, log) if rows.size >= FEWEST else None
        if found is None or not np.isfinite(found[1]).all():
            return None
        known, X = found
        furthest = min(furthest, 0.25 * float(log.time[rows[-1]] - log.time[rows[0]]))
        rows = rows[(log.time[rows] >= known[0] + furthest) & (log.time[rows] <= known[-1] - furthest)]
        rows = rows[:: max(1, -(-rows.size // LOOKED_AT))]
        if rows.size < FEWEST:
            return None
        steps = int(furthest / grid)
        return cls(
            log.time[rows],
            read[rows] / rig.sensor.noise_array,
            known,
            X / np.abs(X).max(axis=0).clip(1e-12),
            np.asarray(grid * np.arange(-steps, steps + 1), np.float64),
        )

    def left(self, late: float) -> float:
        """Mean square that X, so much later, and an offset leave."""
        moved = [np.interp(self.time - late, self.known, column) for column in self.X.T]
        Q = np.linalg.qr(np.column_stack([*moved, np.ones(self.time.size)]))[0]
        return float(np.mean((self.raw - Q @ (Q.T @ self.raw)) ** 2))

    def lefts(self) -> Array:
        """The same of all `lates`."""
        return np.array([self.left(late) for late in self.lates])

    def latest(self, here: float) -> float:
        """How late the sensor is, 0 where that is not told: `here` is left at no delay.

        Of a motion that repeats itself the valley next to none, all being alike.
        """
        lefts = self.lefts()
        lowest = 1 + np.flatnonzero((lefts[1:-1] <= lefts[:-2]) & (lefts[1:-1] <= lefts[2:]))
        alike = lowest[lefts[lowest] <= ALIKE * lefts.min()]
        if not alike.size:
            return 0.0
        k = alike[np.argmin(np.abs(self.lates[alike]))]
        told = here > BETTER * lefts[k] and abs(self.lates[k]) > LEAST
        return float(self.lates[k]) if told else 0.0


def _motion(rig: Rig, log: Log) -> tuple[Array, Array] | None:
    """Times (K,) and X (K, 12 or 15) at them, of the longest stretch; None where nothing tells it."""
    imu = rig.motion.source == "imu"
    try:
        log = with_twist(rig, log)
    except (InputError, np.linalg.LinAlgError):  # the estimate says what is wrong with it
        return None
    linear, turning = log.specific_force if imu else log.twist, log.angular_velocity
    if linear is None or (imu and turning is None) or (not imu and rig.in_gravity and log.gravity is None):
        return None
    subtracted = rig.sensor.subtracted is not None
    fall = log.gravity if rig.in_gravity and (subtracted or not imu) else None
    motion = np.column_stack([x for x in (linear, turning if imu else None, fall) if x is not None])
    known = np.flatnonzero(np.isfinite(motion).all(axis=1))
    known = known[:: max(1, -(-known.size // MOST))]
    # across a gap nothing is known
    rows = max((known[piece] for piece in segments(log.time[known])), key=len)
    if len(rows) < FEWEST:
        return None
    t = log.time[rows]
    intervals = max(1, round(min((t[-1] - t[0]) / KNOTS, rows.size / 3.0)))
    spline = uniform_spline(t, motion[rows, :6], intervals)
    nu, rate = spline(t), spline(t, nu=1)
    omega = nu[:, 3:]
    force = nu[:, :3] if imu else rate[:, :3] + cross(omega, nu[:, :3])
    products = np.column_stack([omega[:, i] * omega[:, j] for i, j in PAIRS])
    told = [force, rate[:, 3:], products]
    if fall is not None and subtracted:
        told.append(fall[rows])
    elif fall is not None:
        told[0] = force - fall[rows]
    return t, np.column_stack(told)
