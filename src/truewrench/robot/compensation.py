"""The weight that a driver has subtracted from the channels, added back (`sensor.compensated`)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.interpolate import make_interp_spline

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments
from truewrench.model.rig import Rig
from truewrench.robot.attitude import free_fall

Found = TypeVar("Found")

_ROUNDS = 4  # that a weight is added back anew, while
_MISSED = 0.5  # sigma of the time offset lie between where it was added and where that is found


def subtracted(rig: Rig, fall: Array) -> Array:
    """Channels (N, n) of the weight that the driver subtracts in free fall (N, 3), sensor axes; linear in it.

    Zeros without `sensor.compensated`.
    """
    sensor, body = rig.sensor, rig.sensor.subtracted
    if body is None:
        return np.zeros((len(fall), sensor.n))
    weight = np.hstack([body.mass * fall, body.mass * np.cross(np.array(body.center_of_mass), fall)])
    return np.asarray(sensor.sign * weight @ sensor.nominal_gain_array.T)


def uncompensated(rig: Rig, logs: Sequence[Log], time_offset: float | Array = 0.0) -> list[Log]:
    """Logs whose channels hold the whole wrench, the subtracted weight among it, as estimation needs them.

    A driver subtracts in units of the wrench, after it has applied the matrix that it believes in, and from
    what the body stated in `sensor.compensated` weighs at rest:

        raw += nominal_gain @ w,     w = feels * m [g; c x g]                    (METHOD 3 without motion)

    with g in sensor axes where the motion was at the sensor's stamp, t_motion = t_sensor + `time_offset` of
    all logs or one each [s], interpolated between the rows that tell it. How late the driver was with its
    own g is not known. Samples at which g is not known (before its first row, after its last, in a gap)
    become NaN, and a note says how many; that nothing tells it anywhere is an InputError. Logs that are given
    stay as they are; one that has the weight at another time offset gets it at this one. Those of joints
    have their tracking.
    """
    if rig.sensor.subtracted is None:
        return list(logs)
    offsets = np.broadcast_to(time_offset, len(logs)).tolist()
    return [_with_weight(rig, log, offset) for log, offset in zip(logs, offsets, strict=True)]


def weight_added(rig: Rig, log: Log) -> Array:
    """Channels (N, n) of the weight that a log with `weight_offset` has been given."""
    return subtracted(rig, _fall(rig, log, log.weight_offset or 0.0))


def restamped(rig: Rig, log: Log, moved: Callable[[Log], Log]) -> Log:
    """A log of which `moved` moves the sensor's stamps: its weight is that of the new ones."""
    if log.weight_offset is None:
        return moved(log)
    bare = replace(log, raw=log.raw - weight_added(rig, log), weight_offset=None)
    return _with_weight(rig, moved(bare), log.weight_offset)


def with_weight_on_time(
    rig: Rig,
    logs: Sequence[Log],
    estimated: Callable[[Sequence[Log]], Found],
    time_offsets: Callable[[Found], tuple[Array, Array]],
) -> Found:
    """An estimate, made anew while it finds the motion elsewhere than where a subtracted weight was added.

    Where little but weight moves, the time offset goes only a share of the way from that of the weight to the
    right one; the share is told by what a step has left. A step that misses by more than the one before it is
    not kept: where all that moves is weight nothing tells the share, and steps led out of the log. The time
    offsets of an estimate are one a log, with their 1 sigma [s].
    """
    found = estimated(logs)
    if rig.sensor.subtracted is None:
        return found
    at = np.array([log.weight_offset or 0.0 for log in logs])
    missed, share, kept = np.zeros_like(at), np.ones_like(at), found
    for turn in range(_ROUNDS):
        told, std = time_offsets(found)
        before, missed = missed, told - at
        if turn and missed @ missed > before @ before:
            return kept
        if (np.abs(missed) <= _MISSED * std).all():
            break
        left = np.divide(missed, before, out=np.zeros_like(at), where=before != 0.0)
        share *= 1.0 - np.clip(left, 0.0, 0.9)
        at, kept = at + missed / share, found
        found = estimated(uncompensated(rig, logs, at))
    return found


def _with_weight(rig: Rig, log: Log, time_offset: float) -> Log:
    if log.weight_offset == time_offset:
        return log
    raw = log.raw + subtracted(rig, _fall(rig, log, time_offset))
    if log.weight_offset is not None:
        raw -= weight_added(rig, log)
        return replace(log, raw=raw, weight_offset=time_offset)
    sensed = np.isfinite(log.raw).any(axis=1)
    lost = int(np.count_nonzero(sensed & ~np.isfinite(raw).any(axis=1)))
    if lost and lost == np.count_nonzero(sensed):
        expected = "gravity at the times of the sensor's samples, which `sensor.compensated` needs"
        raise InputError.at(log.path, "", "no direction of gravity at any of them", expected)
    note = f"{lost} samples of the sensor left out: no gravity is known then (sensor.compensated needs it)"
    notes = (*log.notes, note) if lost else log.notes
    return replace(log, raw=raw, weight_offset=time_offset, notes=notes)


def _fall(rig: Rig, log: Log, later: float) -> Array:
    """Free fall (N, 3) in sensor axes so much later than the rows, NaN where nothing tells it around."""
    told = log.gravity
    if told is None and log.attitude is not None:
        told = free_fall(rig, log.attitude)
    if told is None:
        expected = "gx gy gz, qw qx qy qz or joints, which `sensor.compensated` needs"
        raise InputError.at(log.path, "", "nothing that tells the direction of gravity", expected)
    known, at = np.flatnonzero(np.isfinite(told).all(axis=1)), log.time + later
    fall: Array = np.full_like(told, np.nan)
    for piece in segments(log.time[known]) if known.size else ():
        rows = known[piece]
        time = log.time[rows]
        inside = (at >= time[0]) & (at <= time[-1])
        if rows.size == 1:
            fall[inside] = told[rows[0]]
        elif inside.any():
            fall[inside] = make_interp_spline(time, told[rows], k=min(3, rows.size - 1))(at[inside])
    return fall
