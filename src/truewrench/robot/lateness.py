"""Joint velocities that a filter, or a driver, makes later than the positions beside them."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from truewrench.model.arrays import Array, Integers
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments

WINDOW = 0.2  # [s] over which velocities are integrated and positions differenced: tolerance
SURE = 5.0  # sigma of the lateness, from which on it is undone
STEPS = 3  # of Gauss and Newton: tolerance


def in_step(log: Log) -> tuple[Log, float]:
    """The log with positions as late as its velocities, and by what these are later [s]; 0 where unsure.

    What the tachometers measure of the twist takes pose and gravity from the positions, at one clock.
    """
    if log.position is None or log.velocity is None:
        return log, 0.0
    tau, moved = 0.0, log
    for _ in range(STEPS):
        more, sigma = _lateness(moved)
        if not abs(tau + more) > SURE * sigma:
            return log, 0.0
        tau += more
        moved = replace(log, position=_later(log.time, log.position, tau))
    return moved, tau


def _lateness(log: Log) -> tuple[float, float]:
    """By what velocities are later than positions [s], and 1 sigma; sigma is infinite where nothing tells.

    int dq dt - (q(t + W) - q(t)) = -tau (dq(t + W) - dq(t)), of all joints and windows; these overlap.
    """
    assert log.position is not None
    assert log.velocity is not None
    rows = np.flatnonzero(np.isfinite(log.velocity).all(axis=1) & np.isfinite(log.position).all(axis=1))
    time = log.time[rows]
    xx = xd = dd = 0.0
    count, overlap = 0, 1.0
    for piece in segments(time) if rows.size > 1 else []:
        t, dq, q = time[piece], log.velocity[rows[piece]], log.position[rows[piece]]
        m = max(2, round(WINDOW / float(np.median(np.diff(t))))) if t.size >= 4 else t.size
        if t.size <= m:
            continue
        steps = 0.5 * (dq[1:] + dq[:-1]) * np.diff(t)[:, None]
        travelled = np.vstack([np.zeros((1, q.shape[1])), np.cumsum(steps, axis=0)])
        D = travelled[m:] - travelled[:-m] - (q[m:] - q[:-m])
        X = -(dq[m:] - dq[:-m])
        xx, xd, dd = xx + float(np.sum(X * X)), xd + float(np.sum(X * D)), dd + float(np.sum(D * D))
        count, overlap = count + D.size, max(overlap, float(m))
    if not xx > 0.0 or count <= overlap:
        return 0.0, np.inf
    left = max(dd - xd**2 / xx, 0.0) / count
    return xd / xx, float(np.sqrt(overlap * left / xx))


def _later(time: Array, position: Array, tau: float) -> Array:
    """Positions (N, n) at times that are tau earlier; NaN where that is not within a gap-free piece."""
    known: Integers = np.flatnonzero(np.isfinite(position).all(axis=1))
    out = np.full_like(position, np.nan)
    for piece in segments(time[known]):
        rows = known[piece]
        if rows.size < 4:
            continue
        at = time[rows] - tau
        inside = (at >= time[rows[0]]) & (at <= time[rows[-1]])
        out[rows[inside]] = CubicSpline(time[rows], position[rows], axis=0)(at[inside])
    return out
