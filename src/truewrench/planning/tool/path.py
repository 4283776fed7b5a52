"""Poses as a timed motion: dwell, move from rest to rest, dwell."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array
from truewrench.planning.limits import Limits
from truewrench.planning.tool.postures import Stand

# of s^4 (35 - 84 s + 70 s^2 - 20 s^3), at rest with its first three derivatives at both ends
_FASTEST = (2.1875, 7.5132, 52.5)
_SPARE = 0.9  # of velocity, acceleration and jerk
_SLOW = (1.0, 2.0, 20.0)  # [rad/s, m/s ...] where nothing is said
_ON_THE_WAY = 25  # postures of a move that are looked at
_SHORTEST = 0.5  # [s] of a move


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """A motion in N rows, and when it stands."""

    time: Array  # (N,) [s]
    position: Array  # (N, n) of the joints; of a twist the angle turned within the move
    velocity: Array  # (N, n), or the twist (N, 6)
    acceleration: Array  # (N, n), or the derivative of the twist
    dwells: Array  # (T, 2) begin and end of each pose [s]
    R_root_sensor: Array  # (T, 3, 3) of each pose


def _shape(s: Array) -> tuple[Array, Array, Array]:
    """How far a move is at a share s of its time, and the first two derivatives."""
    p = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    return p(s), p.deriv()(s), p.deriv(2)(s)


def _limits(limits: Limits) -> list[Array]:
    stated = (limits.velocity, limits.acceleration, limits.jerk)
    return [np.where(np.isfinite(of), _SPARE * of, slow) for of, slow in zip(stated, _SLOW, strict=True)]


def seconds_of(distance: Array, limits: Limits) -> float:
    """How long a move by distances (n,) takes within the limits of velocity, acceleration and jerk."""
    size = np.abs(distance)
    times = [
        (peak * size / most) ** (1.0 / order)
        for order, (peak, most) in enumerate(zip(_FASTEST, _limits(limits), strict=True), start=1)
    ]
    return max(_SHORTEST, float(np.max(times)))


def _free(stand: Stand, a: Array, b: Array) -> bool:
    share = np.linspace(0.0, 1.0, _ON_THE_WAY)[1:-1, None]
    return bool(stand.allowed(a + share * (b - a)).all())


def _way(stand: Stand, a: Array, b: Array) -> tuple[float, list[Array]]:
    """Seconds from one posture to another, and the postures on the way: straight, or by way of home."""
    if _free(stand, a, b):
        return seconds_of(b - a, stand.limits), [b]
    home = stand.home
    if _free(stand, a, home) and _free(stand, home, b):
        return seconds_of(home - a, stand.limits) + seconds_of(b - home, stand.limits), [home, b]
    return np.inf, []


def route(stand: Stand, options: list[Array]) -> tuple[list[list[Array]], list[int]]:
    """The quickest way from home through one posture of each of T options (K, n), in order, and home again.

    Given are the postures of every move, the last one of each being the pose and that of the last move home;
    and which poses were kept: one that no way leads to is left out.
    """
    costs, ends, kept = np.zeros(1), stand.home[None], []
    whole: list[list[list[Array]]] = [[]]
    for pose, postures in enumerate([*options, stand.home[None]]):
        best = np.full(len(postures), np.inf)
        found: list[list[list[Array]]] = [[] for _ in postures]
        for k, b in enumerate(postures):
            for j in np.argsort(costs):
                if costs[j] + _SHORTEST >= best[k]:
                    break
                seconds, way = _way(stand, ends[j], b)
                if costs[j] + seconds < best[k]:
                    best[k], found[k] = costs[j] + seconds, [*whole[j], way]
        if not np.isfinite(best).any():
            continue
        reached = np.isfinite(best)
        costs, ends = best[reached], postures[reached]
        whole = [way for way, one in zip(found, reached, strict=True) if one]
        if pose < len(options):
            kept.append(pose)
    return whole[int(np.argmin(costs))], kept


def joint_path(stand: Stand, moves: list[list[Array]], poses: int, dwell: float, rate: float) -> Timed:
    """Rows of the joints at a rate [Hz] that visit postures, by the moves of `route`.

    The first moves end in poses, so many as there are, at each of which they dwell [s].
    """
    step, at = 1.0 / rate, stand.home
    blocks: list[tuple[Array, Array, Array]] = [(at[None], 0.0 * at[None], 0.0 * at[None])]
    rows, dwells, stands = 1, [], []
    for k, way in enumerate(moves):
        for b in way:
            count = max(6, int(np.ceil(seconds_of(b - at, stand.limits) * rate)))
            p, v, a = (x[:, None] for x in _shape(np.arange(1, count + 1) / count))
            span = count * step
            blocks.append((at + p * (b - at), v * (b - at) / span, a * (b - at) / span**2))
            rows, at = rows + count, b
        if k < poses:
            count = max(1, round(dwell * rate))
            still = np.tile(at, (count, 1))
            blocks.append((still, 0.0 * still, 0.0 * still))
            dwells.append(((rows - 1) * step, (rows - 1 + count) * step))
            stands.append(at)
            rows += count
    position, velocity, acceleration = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    R = stand.robot.pose(np.array(stands))[0] if stands else np.empty((0, 3, 3))
    return Timed(_times(rows, step), position, velocity, acceleration, np.array(dwells).reshape(-1, 2), R)


def _times(rows: int, step: float) -> Array:
    return np.asarray(step * np.arange(rows), dtype=np.float64)


def twist_path(falls: Array, down: Array, limits: Limits, dwell: float, rate: float) -> Timed:
    """Rows of the twist of a sensor that turns on the spot, its axes at first those of the root.

    At a rate [Hz]. Gravity is along `falls` (T, 3) in the sensor, one a pose, where it dwells [s], and `down`
    (3,) in the root.
    """
    step, at = 1.0 / rate, Rotation.identity()
    turns = [_least_turn(down, fall) for fall in falls]
    blocks: list[Array] = [np.zeros((1, 13))]
    rows, dwells = 1, []
    for k, to in enumerate([*turns, Rotation.identity()]):
        vector = (at.inv() * to).as_rotvec()
        count = max(6, int(np.ceil(seconds_of(np.append(np.zeros(3), vector), limits) * rate)))
        p, v, a = (x[:, None] for x in _shape(np.arange(1, count + 1) / count))
        span, zero = count * step, np.zeros((count, 3))
        angle = float(np.linalg.norm(vector))
        blocks.append(np.hstack([p * angle, zero, v * vector / span, zero, a * vector / span**2]))
        rows, at = rows + count, to
        if k < len(turns):
            count = max(1, round(dwell * rate))
            blocks.append(np.zeros((count, 13)))
            dwells.append(((rows - 1) * step, (rows - 1 + count) * step))
            rows += count
    every = np.concatenate(blocks)
    R = Rotation.concatenate(turns).as_matrix() if len(turns) else np.empty((0, 3, 3))
    return Timed(
        _times(rows, step), every[:, :1], every[:, 1:7], every[:, 7:], np.array(dwells).reshape(-1, 2), R
    )


def _least_turn(down: Array, fall: Array) -> Rotation:
    """R_root_sensor of the least angle with R^T down = fall."""
    axis = np.cross(fall, down)
    size, cosine = float(np.linalg.norm(axis)), float(fall @ down)
    if size < 1e-12:
        side = np.cross(np.eye(3)[int(np.argmin(np.abs(down)))], down)
        return Rotation.from_rotvec((0.0 if cosine > 0.0 else np.pi) * side / np.linalg.norm(side))
    return Rotation.from_rotvec(np.arctan2(size, cosine) * axis / size)
