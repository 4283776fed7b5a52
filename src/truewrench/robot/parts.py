"""Joints of one arm as logs have them: parts sampled at times of their own, turns that begin anew."""

from dataclasses import replace

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of, turning

_POINTS = 4  # of a cubic
MOVES, SAMPLED = 0.02, 0.1  # [rad, m] that is a motion, [s] between rows at most: others are poses
_APART = 1.0  # [s] between rows of which nobody says that the joint went on


def unwrapped(rig: Rig, log: Log) -> Log:
    """The log with angles that go on where they were logged within one turn, as from 180 to -180 deg.

    The arm is where it was: only a spline through the angles sees the difference. Across a pause a joint may
    have gone by half a turn and more.
    """
    if rig.motion.source != "joints" or log.position is None:
        return log
    robot, position, notes = robot_of(rig), log.position.copy(), []
    if position.shape[1] != robot.n:
        return log  # which is told where the joints are read
    for k in np.flatnonzero(turning(robot)):
        name = robot.joints[k]
        rows = np.flatnonzero(np.isfinite(position[:, k]))
        turns = 0
        for run in np.split(rows, np.flatnonzero(np.diff(log.time[rows]) >= _APART) + 1):
            angle = position[run, k]
            position[run, k] = np.unwrap(angle)
            turns += int(np.count_nonzero(np.abs(np.diff(position[run, k] - angle)) > np.pi))
        if turns:
            notes.append(f"q_{name} was logged within one turn: it goes on across {turns} jumps of 360 deg")
    if _not_filled(log.time, position, log.velocity):
        notes.append("dq_* say that nothing moves where q_* do: the driver does not fill them; left out")
        return replace(log, position=position, velocity=None, notes=(*log.notes, *notes))
    return replace(log, position=position, notes=(*log.notes, *notes))


def _not_filled(time: Array, position: Array, velocity: Array | None) -> bool:
    """Whether all velocities (N, n) are one and the same while positions (N, n) move between near rows."""
    if velocity is None:
        return False
    rows, known = np.isfinite(velocity).all(axis=1), np.flatnonzero(np.isfinite(position).all(axis=1))
    if not rows.any() or np.ptp(velocity[rows], axis=0).any():
        return False
    runs = np.split(known, np.flatnonzero(np.diff(time[known]) > SAMPLED) + 1)
    return any(np.ptp(position[run], axis=0).max(initial=0.0) > MOVES for run in runs if run.size > _POINTS)


def together(rig: Rig, log: Log) -> Log:
    """The log with its joints on rows that all of them have, and a note where some were interpolated."""
    if rig.motion.source != "joints":
        return log
    position, of_positions = _together(rig, log.time, log.position, "positions")
    velocity, of_velocities = _together(rig, log.time, log.velocity, "velocities")
    notes = (*log.notes, *of_positions, *of_velocities)
    return replace(log, position=position, velocity=velocity, notes=notes)


def _together(rig: Rig, time: Array, joints: Array | None, what: str) -> tuple[Array | None, list[str]]:
    if joints is None:
        return None, []
    joints, parts = on_common_rows(time, joints)
    if len(parts) == 1:
        return joints, []
    names = robot_of(rig).joints
    slowest, *others = (", ".join(names[k] for k in part) for part in parts)
    return joints, [
        f"the {what} of {'; '.join(others)} were interpolated at the times of {slowest}: parts of the arm "
        "were sampled at times of their own"
    ]


def on_common_rows(time: Array, joints: Array) -> tuple[Array, list[list[int]]]:
    """Joints (N, n) on the rows of the slowest part, where most rows have samples of a part of the arm alone.

    The others are interpolated by a cubic through the four samples around each row, in no gap of them. Its
    noise is at most that of a sample, and rows of a slower part never share what one sample of a faster one
    says: no information is made up. Given back, too, are the columns of each part, the slowest first; one
    part where nothing was done.
    """
    finite = np.isfinite(joints)
    complete = int(finite.all(axis=1).sum())
    parts = _parts(finite)
    if len(parts) == 1 or 2 * complete >= int(finite.any(axis=1).sum()):
        return joints, [list(range(joints.shape[1]))]
    rows = [np.flatnonzero(finite[:, part].all(axis=1)) for part in parts]
    order = sorted(range(len(parts)), key=lambda k: rows[k].size)
    parts, rows = [parts[k] for k in order], [rows[k] for k in order]
    out = np.full_like(joints, np.nan)
    for part, known in zip(parts, rows, strict=True):
        out[rows[0][:, None], part] = _interpolated(time[known], joints[known][:, part], time[rows[0]])
    return out, parts


def _parts(finite: Mask) -> list[list[int]]:
    """Columns that mostly have their samples together."""
    parts: list[list[int]] = []
    for column in range(finite.shape[1]):
        for part in parts:
            both = int((finite[:, column] & finite[:, part[0]]).sum())
            if 2 * both > min(int(finite[:, column].sum()), int(finite[:, part[0]].sum())):
                part.append(column)
                break
        else:
            parts.append([column])
    return parts


def _interpolated(time: Array, values: Array, at: Array) -> Array:
    """(M, n) at times (M,), NaN outside the samples and in their gaps."""
    out = np.full((at.size, values.shape[1]), np.nan)
    for piece in segments(time) if time.size else ():
        known, here = time[piece], values[piece]
        inside = np.flatnonzero((at >= known[0]) & (at <= known[-1]))
        if known.size < _POINTS or not inside.size:
            continue
        first = np.clip(np.searchsorted(known, at[inside], side="right") - 2, 0, known.size - _POINTS)
        around = first[:, None] + np.arange(_POINTS)
        nodes = known[around]
        weights = np.ones((inside.size, _POINTS))
        for i in range(_POINTS):
            for j in range(_POINTS):
                if i != j:
                    weights[:, i] *= (at[inside] - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
        out[inside] = np.einsum("mk,mkn->mn", weights, here[around])
    return out
