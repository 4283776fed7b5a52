"""The weight that a driver has subtracted from the channels, added back (`sensor.compensated`)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.motion.smooth import segments
from truewrench.robot.attitude import free_fall


def uncompensated(rig: Rig, logs: Sequence[Log]) -> list[Log]:
    """Logs whose channels hold the whole wrench, the subtracted weight among it, as estimation needs them.

    A driver subtracts in units of the wrench, after it has applied the matrix that it believes in, and from
    what the body stated in `sensor.compensated` weighs at rest:

        raw += nominal_gain @ w,     w = feels * m [g; c x g]                    (METHOD 3 without motion)

    with g in sensor axes at the sensor's stamp, interpolated between the rows that tell it. How late the
    driver was with its own g is not known. Samples at which g is not known (before its first row, after its
    last, in a gap) become NaN, and a note says how many; that nothing tells it anywhere is an InputError.
    Logs that are given stay as they are, and come back without `sensor.compensated`; those of joints have
    their tracking. Call it once.
    """
    if rig.sensor.subtracted is None:
        return list(logs)
    return [_with_weight(rig, log) for log in logs]


def _with_weight(rig: Rig, log: Log) -> Log:
    sensor, body = rig.sensor, rig.sensor.subtracted
    assert body is not None
    fall = _fall_at_rows(rig, log)
    weight = np.column_stack([body.mass * fall, body.mass * np.cross(np.array(body.center_of_mass), fall)])
    raw = log.raw + sensor.sign * weight @ sensor.nominal_gain_array.T
    sensed = np.isfinite(log.raw).any(axis=1)
    lost = int(np.count_nonzero(sensed & ~np.isfinite(raw).any(axis=1)))
    if lost and lost == np.count_nonzero(sensed):
        expected = "gravity at the times of the sensor's samples, which `sensor.compensated` needs"
        raise InputError.at(log.path, "", "no direction of gravity at any of them", expected)
    note = f"{lost} samples of the sensor left out: no gravity is known then (sensor.compensated needs it)"
    return replace(log, raw=raw, notes=(*log.notes, note) if lost else log.notes)


def _fall_at_rows(rig: Rig, log: Log) -> Array:
    """Free fall (N, 3) in sensor axes at every row, NaN where it is told neither there nor around it."""
    told = log.gravity
    if told is None and log.attitude is not None:
        told = free_fall(rig, log.attitude)
    if told is None:
        expected = "gx gy gz, qw qx qy qz or joints, which `sensor.compensated` needs"
        raise InputError.at(log.path, "", "nothing that tells the direction of gravity", expected)
    known = np.flatnonzero(np.isfinite(told).all(axis=1))
    fall: Array = np.full_like(told, np.nan)
    fall[known] = told[known]
    for piece in segments(log.time[known]):
        rows = known[piece]
        between = np.arange(rows[0], rows[-1] + 1) if rows.size > 1 else rows[:0]
        between = between[np.isnan(fall[between, 0])]
        if between.size:
            path = make_interp_spline(log.time[rows], told[rows], k=min(3, rows.size - 1))
            fall[between] = path(log.time[between])
    return fall
