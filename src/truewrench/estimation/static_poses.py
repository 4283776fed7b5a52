"""Static poses of a record: rows of zero twist seconds apart, and dwells found in a sampled log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from truewrench.estimation.colour import without_filters
from truewrench.estimation.far_clock import with_clock_set
from truewrench.estimation.vibration import without_vibrations
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.temperature import temperature_at
from truewrench.robot.arm import robot_of
from truewrench.robot.attitude import attitude_of
from truewrench.robot.parts import together

APART = 0.3  # [s] from both neighbours: a row by itself
SETTLE = 1.0  # [s] of a dwell that is left out: what the motion before it leaves
DWELL = 1.5  # [s] at least, settling included
SHORT = 0.5  # [s] of a dwell that begins with the log or after a gap, at least
STILL = 5.0  # sigma of the motion's noise, and
CREEP = 1e-3  # [m/s, rad/s] that is no motion; tolerance
MOVING = 2.0  # [s] of motion that are worth an estimate of their own
MOVE = 1.0  # [s] of motion between two dwells, at least
_MEAN = 0.1  # [s] of positions on either side of a row
_OVERLOAD = 100.0  # times its range, at rest: a unit, or a broken cell; tolerance
_AT_ONCE = 0.02  # [s] over which a contact wrench means: of what shakes a pose faster little is left
_SPREAD = 0.05  # [rad] of the attitudes of a pose about their mean, in the median: no noise
WALK = 1e-4  # of range per sqrt(s): how fast offsets walk between poses, by prior,
REPEATABILITY = 2e-4  # of range: how otherwise a pose comes back,
SIZE_SPREAD = 2.0  # and 1 sigma of the logarithm of either: data overrule it
FEWEST = 3  # dwells for which a sampled log is cut into dwells and motion


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """T static poses in the order of logs, and of time in each."""

    log: Integers  # (T,) which log
    time_ns: Integers  # (T,) stamps of their middles
    seconds: Array  # (T,) that each lasts
    raw: Array  # (T, n) means of the channels [raw units]
    variance: Array  # (T, n) of these means, by the noise of the samples and their own scatter
    R_sensor_root: Array  # (T, 3, 3) takes vectors of the root frame to sensor axes
    temperature: Array  # (T,) [degC], NaN where there is none
    shaking: Array  # (T, n) variance of means over `_AT_ONCE` within it, noise aside; NaN where none is told

    def __len__(self) -> int:
        return len(self.log)

    def of(self, chosen: Integers | Mask) -> Poses:
        """Some of them."""
        return Poses(*(getattr(self, x.name)[chosen] for x in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """What of a log is motion."""

    log: int  # which log
    record: Log  # the log without vibrations and filters, channels where it moves alone
    # [s] since its first row, where its poses tell how its offset walks: begin and end of each move in turn,
    # at which it has an offset of its own; empty: the log's
    knots: Array

    @property
    def knots_ns(self) -> Integers:
        """Stamps of the knots."""
        return int(self.record.time_ns[0]) + np.rint(1e9 * self.knots).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Logs as poses and motion."""

    poses: Poses  # of all logs
    moves: tuple[Move, ...]  # of the logs that move, in their order
    end_ns: tuple[int, ...]  # last stamp of each log


def split_poses(rig: Rig, logs: Sequence[Log]) -> Split:
    """What of each log stands still and what moves; together every sample is used at most once.

    InputError: nothing tells a pose's direction of gravity.
    """
    parts, moves = [], []
    for k, log in enumerate(with_clock_set(rig, together(rig, one)) for one in logs):
        pieces, kept, seconds = _cut(rig, log)
        parts.append(_poses(rig, k, log, pieces))
        white = without_filters(rig, without_vibrations(rig, log)) if kept.size else log
        if kept.size and (move := _move(k, white, kept, seconds, bool(pieces))) is not None:
            moves.append(move)
    joined = Poses(*(np.concatenate([getattr(part, x.name) for part in parts]) for x in fields(Poses)))
    return Split(joined, tuple(moves), tuple(int(log.time_ns[-1]) for log in logs))


def stands_still(rig: Rig, log: Log) -> bool:
    """Whether a log is static poses, `FEWEST` and more, and no motion."""
    alone, dwells, _, seconds = _pieces(rig, together(rig, log))
    return float(seconds.sum()) < MOVING and len(alone) + len(dwells) >= FEWEST


def _pieces(rig: Rig, log: Log) -> tuple[list[Integers], list[Integers], Mask, Array]:
    """Poses that are rows, dwells, rows that are read and not alone, and seconds moved before each row."""
    time, sensed = log.time, np.isfinite(log.raw).all(axis=1)
    gap = np.diff(time[sensed])
    alone = np.zeros(len(time), dtype=bool)
    alone[sensed] = np.append(np.inf, gap) >= APART
    alone[sensed] &= np.append(gap, np.inf) >= APART
    still = _still(rig, log)
    rest = sensed & ~alone
    moves = rest & ~still
    since = np.zeros(len(time))
    since[sensed] = np.diff(time[sensed], prepend=time[sensed][:1])
    seconds = np.where(moves, np.minimum(since, APART), 0.0)
    pieces = [np.array([row]) for row in np.flatnonzero(alone & still)]
    return pieces, _dwells(time, rest & still, rest), rest, seconds


def _cut(rig: Rig, log: Log) -> tuple[list[Integers], Integers, Array]:
    """Rows of each pose, rows of what moves (none if too little does), and seconds moved before each row."""
    pieces, dwells, rest, seconds = _pieces(rig, log)
    moved = float(seconds.sum())
    if moved < MOVING or len(dwells) >= FEWEST:
        pieces += dwells
    else:
        dwells = []
    pieces.sort(key=lambda rows: int(rows[0]))
    for rows in dwells:
        rest[rows] = False
    return pieces, np.flatnonzero(rest & (moved >= MOVING)), seconds


def _move(k: int, log: Log, kept: Integers, seconds: Array, walks: bool) -> Move | None:
    """The motion of a log: all, or, where the offset walks, what goes on for `MOVE`; None: nothing does."""
    runs = [kept]
    if walks:
        runs = [run for run in _runs(log.time, kept) if seconds[run].sum() >= MOVE]
    if not runs:
        return None
    raw = np.full_like(log.raw, np.nan)
    rows = np.concatenate(runs)
    raw[rows] = log.raw[rows]
    knots = log.time[[row for run in runs for row in (run[0], run[-1])]] if walks else np.zeros(0)
    return Move(k, replace(log, raw=raw), knots)


def _runs(time: Array, rows: Integers) -> list[Integers]:
    """Rows, cut where nothing is for `APART`."""
    return np.split(rows, np.flatnonzero(np.diff(time[rows]) >= APART) + 1)


def _still(rig: Rig, log: Log) -> Mask:
    """Rows at which nothing moves, as far as the measurements of motion tell."""
    motion, values, bias = rig.motion, log.twist, 0.0
    if motion.source == "joints":
        values = log.velocity
        if values is None and log.position is not None:
            quiet = np.logical_not(_changing(log.time, log.position))
            return _between(log.time, _any(log.position), quiet)
    elif motion.source == "imu":
        values, bias = log.angular_velocity, STILL * (motion.gyro_bias_prior or 0.0)
    if values is None:
        return np.ones(len(log.time_ns), dtype=bool)
    limit = STILL * motion.noise_array + CREEP + bias if motion.noise is not None else 2.0 * CREEP
    fast = (np.abs(np.nan_to_num(values)) > limit).any(axis=1)
    return _between(log.time, _any(values), np.logical_not(fast))


def _any(values: Array) -> Mask:
    """Rows with a value: parts of an arm may have rows of their own."""
    return np.asarray(np.isfinite(values).any(axis=1))


def _between(time: Array, known: Mask, quiet: Mask) -> Mask:
    """Whether rows are still: those of the motion as they are, others where the motion's on both sides are.

    Of rows `APART` from any of the motion nothing tells that something moved.
    """
    rows = np.flatnonzero(known)
    if rows.size in (0, len(time)):
        return quiet
    out = quiet.copy()
    others = np.flatnonzero(~known)
    after = np.searchsorted(rows, others)
    for side in (after - 1, after):
        at = rows[np.clip(side, 0, rows.size - 1)]
        near = np.abs(time[at] - time[others]) < APART
        out[others] &= quiet[at] | ~near
    return out


def _changing(time: Array, values: Array) -> Mask:
    """Rows about which values change, rows that stand alone aside.

    By means of `_MEAN` before and after a row, whose noise is that which second differences of rows show, or
    a step of the encoder.
    """
    out = np.zeros(len(time), dtype=bool)
    step = np.diff(time)
    if not (step < APART).any():
        return out
    count = max(1, round(_MEAN / float(np.median(step[step < APART]))))
    known = np.isfinite(values).all(axis=1)
    x, rows = values[known], np.flatnonzero(known)
    for piece in _runs(time[rows], np.arange(len(rows))):
        if piece.size < 2:
            continue
        n, at = min(count, piece.size // 2), x[piece]
        bend, move = np.abs(np.diff(at, n=2, axis=0)), np.abs(np.diff(at, axis=0))
        least = np.min(np.where(move > 0.0, move, np.inf), axis=0)
        noise = np.where(np.isfinite(least), least, 0.0) / np.sqrt(12.0)
        if piece.size > 2:
            noise = np.maximum(noise, np.median(bend, axis=0) / (0.6745 * np.sqrt(6.0)))
        sums = np.vstack([np.zeros((1, at.shape[1])), np.cumsum(at, axis=0)])
        lasts = (time[rows[piece[n:]]] - time[rows[piece[:-n]]])[: piece.size - 2 * n + 1, None]
        rate = (sums[2 * n :] - 2.0 * sums[n:-n] + sums[: -2 * n]) / n / lasts
        fast = (np.abs(rate) > CREEP + STILL * noise * np.sqrt(2.0 / n) / lasts).any(axis=1)
        at_row = np.clip(np.arange(piece.size) - n, 0, fast.size - 1)
        out[rows[piece]] = fast[at_row]
    return out


def _dwells(time: Array, still: Mask, known: Mask) -> list[Integers]:
    """Rows of each stretch of stillness, the settling at its start left out."""
    rows = np.flatnonzero(known)
    if rows.size < 2:
        return []
    quiet = still[rows]
    cut = (np.diff(time[rows]) >= APART) | (quiet[1:] != quiet[:-1])
    pieces = np.split(rows, np.flatnonzero(cut) + 1)
    begins = {int(rows[0]), *rows[1:][np.diff(time[rows]) >= APART].tolist()}  # after nothing, or a gap
    out = []
    for piece in pieces:
        if not still[piece[0]]:
            continue
        lasts = time[piece[-1]] - time[piece[0]]
        if lasts >= DWELL - 1e-9:
            out.append(piece[time[piece] >= time[piece[0]] + SETTLE])
        elif lasts >= SHORT and piece[0] in begins:  # logged at rest alone: nothing settles in it
            out.append(piece)
    return out


def _poses(rig: Rig, k: int, log: Log, pieces: Sequence[Integers]) -> Poses:
    n = rig.sensor.n
    warm = temperature_at(log, log.time_ns) if log.temperature is not None else None
    raw, variance, R = np.empty((len(pieces), n)), np.empty((len(pieces), n)), np.empty((len(pieces), 3, 3))
    stamps, temperature = np.empty(len(pieces), np.int64), np.full(len(pieces), np.nan)
    seconds, shaking = np.empty(len(pieces)), np.empty((len(pieces), n))
    turn = attitudes(rig, log) if pieces else None
    for i, rows in enumerate(pieces):
        raw[i] = log.raw[rows].mean(axis=0)
        over = np.abs(raw[i]) / rig.sensor.channel_scale
        place = f"row at {log.time[rows[0]]:g} s"
        if over.max() > _OVERLOAD:
            channel = rig.sensor.channels[int(np.argmax(over))]
            found = f"{channel} at {over.max():.3g} times its range"
            raise InputError.at(log.path, place, found, "a reading within its range: units of the log?")
        variance[i] = _of_mean(log.raw[rows], rig.sensor.noise_array)
        shaking[i] = _shaking(log.time[rows], log.raw[rows], rig.sensor.noise_array)
        stamps[i] = (int(log.time_ns[rows[0]]) + int(log.time_ns[rows[-1]])) // 2
        seconds[i] = log.time[rows[-1]] - log.time[rows[0]]
        assert turn is not None
        told = turn[_around(log.time, rows, np.isfinite(turn[:, 0, 0]))]
        if not len(told):
            expected = "gx gy gz, qw qx qy qz, joints or an IMU, which tell the direction of gravity"
            raise InputError.at(log.path, place, "a pose without attitude", expected)
        U, _, Vt = np.linalg.svd(told.mean(axis=0))
        R[i] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        spread = np.arccos(np.clip(0.5 * (np.einsum("kij,ij->k", told, R[i]) - 1.0), -1.0, 1.0))
        if np.median(spread) > _SPREAD:
            found = f"an attitude that turns, by {2.0 * spread.max():.2g} rad, while wx wy wz are 0"
            expected = "the rates of its turn, or poses seconds apart"
            raise InputError.at(log.path, place, found, expected)
        if warm is not None:
            temperature[i] = warm[rows].mean()
    return Poses(np.full(len(pieces), k), stamps, seconds, raw, variance, R, temperature, shaking)


def _around(time: Array, rows: Integers, known: Mask) -> Integers:
    """Rows that are known while others last; where none is, the nearest less than `APART` away."""
    inside = np.arange(rows[0], rows[-1] + 1)
    if known[inside].any():
        return inside[known[inside]]
    at = np.flatnonzero(known)
    away = np.abs(time[at] - time[rows[0]])
    return at[away == away.min(initial=np.inf)][:1] if away.min(initial=np.inf) < APART else at[:0]


def attitudes(rig: Rig, log: Log) -> Array:
    """R_sensor_root (N, 3, 3) of all rows, NaN where it is not told."""
    out = np.full((len(log.time_ns), 3, 3), np.nan)
    if rig.motion.source == "joints" and log.position is not None and log.base_attitude is None:
        known = np.isfinite(log.position).all(axis=1)
        out[known] = robot_of(rig).pose(log.position[known])[0].transpose(0, 2, 1)
        return out
    if rig.motion.source == "imu" and log.gravity is None and log.specific_force is not None:
        log = replace(log, gravity=-log.specific_force)  # at rest
    told = attitude_of(rig, log)
    if told is not None:
        out[np.searchsorted(log.time, told[0])] = told[1]
    return out


def _of_mean(samples: Array, noise: Array) -> Array:
    """Variance (n,) of the mean of samples (M, n): their scatter, as far as it lasts, and not below noise."""
    count = len(samples)
    least: Array = noise**2 / count
    if count < 8:
        return least
    x = samples - samples.mean(axis=0)
    at_once = np.mean(x**2, axis=0)
    lags = np.arange(1, min(count // 3, 200))
    lasting = np.zeros(len(noise))
    going = np.ones(len(noise), dtype=bool)
    for lag in lags:  # until correlation turns negative: what follows is its own noise
        rho = np.mean(x[lag:] * x[:-lag], axis=0) / np.maximum(at_once, 1e-300)
        going &= rho > 2.0 / np.sqrt(count)
        lasting += np.where(going, rho, 0.0)
        if not going.any():
            break
    return np.asarray(np.maximum(least, at_once * (1.0 + 2.0 * lasting) / count))


def _shaking(time: Array, samples: Array, noise: Array) -> Array:
    """Variance (n,) of means over `_AT_ONCE` of samples (M, n) about a line, less that of the noise."""
    many = max(1, round(_AT_ONCE / float(np.median(np.diff(time))))) if len(time) > 1 else 1
    count = len(time) // many
    if count < 8:
        return np.full(len(noise), np.nan)
    means = samples[: count * many].reshape(count, many, -1).mean(axis=1)
    line = np.column_stack([np.ones(count), np.linspace(-1.0, 1.0, count)])
    left = means - line @ np.linalg.lstsq(line, means, rcond=None)[0]
    return np.asarray((left**2).sum(axis=0) / (count - 2) - noise**2 / many)
