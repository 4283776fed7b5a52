"""What an accelerometer at the sensor's origin tells of a twist's derivative there.

It reads f = vdot + Omega x v - g (METHOD 10.6, as of an IMU). Beside a measured twist Omega x v is known far
better than f, so that vdot = f - Omega x v + g is a measurement of the motion's derivative.
"""

from dataclasses import replace

import numpy as np

from truewrench import _core
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.motion.smooth import DEGREE, segments, uniform_spline
from truewrench.model.motion.spatial import at_point

MOST_LENT = 0.5
"""Of the noise of v, that the lever of Omega's may add where a twist is taken to the sensor: that both are
independent is then wrong by a tenth."""


def noise_at_sensor(noise: Array, point: Array) -> Array | None:
    """1 sigma (6,) of a twist that is taken from a point to the sensor's origin.

    `noise` (6,) is that of [v, Omega] at the point, (3,) from the sensor's origin [m]. None where Omega's
    noise would have too large a part in that of v.
    """
    x, y, z = noise[3:] ** 2
    a, b, c = point**2
    lent = np.array([c * y + b * z, c * x + a * z, b * x + a * y])
    if (lent > MOST_LENT**2 * noise[:3] ** 2).any():
        return None
    return np.concatenate([np.sqrt(noise[:3] ** 2 + lent), noise[3:]])


def at_sensor(log: Log, point: Array) -> Log:
    """The log with its twist, if any, of a point (3,) from the sensor's origin [m], taken to that origin."""
    return log if log.twist is None else replace(log, twist=at_point(log.twist, -point))


def told_acceleration(log: Log, fall: Array) -> Array:
    """(N, 3) vdot of the sensor's origin in sensor axes [m/s^2], NaN where nothing tells it.

    The log has the twist of that origin and specific force, in rows of their own or the same; `fall` (N, 3)
    is the acceleration of free fall in sensor axes, NaN where it is not known.
    """
    assert log.twist is not None
    assert log.specific_force is not None
    out: Array = np.full((len(log.time_ns), 3), np.nan)
    rows = np.flatnonzero(np.isfinite(log.twist).all(axis=1))
    time = log.time[rows]
    for piece in segments(time):
        t, twist = time[piece], log.twist[rows[piece]]
        if t.size <= DEGREE + 1:
            continue
        intervals = int((t[-1] - t[0]) / _core.coarsest_spacing(float(np.median(np.diff(t)))))
        if intervals < 1 or t.size < intervals + DEGREE + 1:
            continue
        at = np.flatnonzero((log.time >= t[0]) & (log.time <= t[-1]))
        smooth = np.column_stack([uniform_spline(t, y, intervals)(log.time[at]) for y in twist.T])
        v, omega = smooth[:, :3], smooth[:, 3:]
        out[at] = log.specific_force[at] - np.cross(omega, v) + fall[at]
    return out
