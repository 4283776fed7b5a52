"""Streams of a motion that contradict each other or themselves: no motion is all of them."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid

from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of
from truewrench.robot.attitude import free_fall
from truewrench.robot.parts import MOVES, SAMPLED

SPAN = 0.25  # [s] over which the way of a joint is compared: far above its noise, below a turn of its motion
FOLLOWS = 0.9  # correlation of both ways, from which on their ratio says something, and
APART = 0.5  # below which, at any lag within LAG, they are of different motions
RATIO = 2.0  # of both ways, either way round: a unit
LAG = 0.5  # [s] more than any driver holds one stream back
JUMP = 5e-3  # [rad, m] at least, and
AHEAD = 0.05  # [s] at the joint's speed: what a stamp may be off, and
NOISE = 20.0  # sigma of what a row departs by
JOINT = {
    "rates rest": "its velocities hardly move where its positions do",
    "values rest": "its positions hardly move where its velocities do",
    "against": "its positions move against its velocities: the sign of one of them is turned",
    "unit": (
        "its positions move {:.3g} times as far as its velocities say: degrees, another unit, or stamps at "
        "another rate"
    ),
    "apart": "its positions and velocities tell different motions (correlation {:.2f}): columns swapped?",
}
GRAVITY = {
    "rates rest": "",  # of poses
    "values rest": "wx wy wz turn where the direction of gravity hardly does",
    "against": (
        "wx wy wz turn the other way than the direction of gravity: their sign, or an attitude from root to "
        "sensor, not sensor to root"
    ),
    "unit": "wx wy wz turn otherwise than the direction of gravity, which goes {:.3g} times as far: degrees?",
    "apart": (
        "wx wy wz and the direction of gravity tell different turns (correlation {:.2f}): axes, or the "
        "order of qw ... qz?"
    ),
}
COUNTS = 3.0  # of the encoder, and
NEAR = 5  # rows within which a stray one comes back


def joint_faults(rig: Rig, logs: Sequence[Log]) -> list[str]:
    """What no motion of the arm explains, in words; empty where joints are not logged.

    A position that jumps and stays away, where velocities say that the joint has not moved so far; velocities
    that tell another motion than the positions, its opposite, or one in another unit. Of 192 sound joint logs
    of benchmarks/imperfect.py and 120 of six arms, quantised up to 0.01 rad, none is suspected. Positions are
    without turns that begin anew (`robot.parts.unwrapped`).
    """
    if rig.motion.source != "joints":
        return []
    found = []
    for k, log in enumerate(logs):
        if log.position is None or log.velocity is None:
            continue
        where = f" in log {k + 1}" if len(logs) > 1 else ""
        for j, name in enumerate(robot_of(rig).joints):
            words = _of_joint(log, j)
            if words:
                found.append(f"joint {name}{where}: {words}")
    return found


def gravity_faults(rig: Rig, logs: Sequence[Log]) -> list[str]:
    """How the direction of gravity contradicts a logged twist, in words: d/dt g = -Omega x g.

    Of 200 logs with two imperfections each, of clocks up to 0.1 s apart, none is suspected.
    """
    found = []
    for k, log in enumerate(logs if rig.motion.source == "twist" and rig.in_gravity else ()):
        fall = log.gravity if log.attitude is None else free_fall(rig, log.attitude)
        if fall is None or log.twist is None:
            continue
        rows = np.flatnonzero(np.isfinite(fall).all(axis=1))
        known = np.flatnonzero(np.isfinite(log.twist[:, 3:]).all(axis=1))
        if min(rows.size, known.size) < 4 * NEAR or np.median(np.diff(log.time[rows])) > SAMPLED:
            continue
        size = np.linalg.norm(fall[rows], axis=1, keepdims=True)
        down = fall[rows] / np.where(size > 0.0, size, 1.0)
        time, omega = log.time[known], log.twist[known, 3:]
        then = np.column_stack([np.interp(time, log.time[rows], axis) for axis in down.T])
        rate = -np.cross(omega, then)
        words = _disagree(log.time[rows], down, [_Path(time, axis) for axis in rate.T], GRAVITY)
        if words:
            found.append(f"log {k + 1}: {words}" if len(logs) > 1 else words)
    return found


def _of_joint(log: Log, j: int) -> str:
    assert log.position is not None
    assert log.velocity is not None
    rows = np.flatnonzero(np.isfinite(log.position[:, j]))
    known = np.flatnonzero(np.isfinite(log.velocity[:, j]))
    if min(rows.size, known.size) < 4 * NEAR or np.median(np.diff(log.time[rows])) > SAMPLED:
        return ""
    time, q = log.time[rows], log.position[rows, j]
    went = _Path(log.time[known], log.velocity[known, j])
    return _disagree(time, q[:, None], [went]) or _jump(time, q, went)


class _Path:
    """The way of a joint by its velocities: their integral, known between their first and last."""

    def __init__(self, time: Array, velocity: Array) -> None:
        step = np.diff(time)
        self.time = time
        self.way = cumulative_trapezoid(velocity, time, initial=0)
        self.gaps = np.append(0, np.cumsum(step > NEAR * np.median(step)))

    def between(self, begin: Array, end: Array) -> Array:
        """Way from one time to the other, NaN across gaps and outside."""
        way = np.interp(end, self.time, self.way) - np.interp(begin, self.time, self.way)
        first, last = np.searchsorted(self.time, begin, "right") - 1, np.searchsorted(self.time, end)
        inside = (first >= 0) & (last < self.time.size)
        first, last = np.clip(first, 0, None), np.clip(last, None, self.time.size - 1)
        return np.where(inside & (self.gaps[first] == self.gaps[last]), way, np.nan)


def _disagree(time: Array, values: Array, paths: Sequence[_Path], words: Mapping[str, str] = JOINT) -> str:
    """How values (N, k) and their rates, k paths, tell different motions, in these words."""
    span = max(1, round(SPAN / float(np.median(np.diff(time)))))
    if len(values) <= 2 * span:
        return ""
    begin, end = time[:-span], time[span:]
    way = values[span:] - values[:-span]
    together = end - begin < 2.0 * SPAN  # no gap of the values

    def compared(lag: float) -> tuple[float, float, float]:
        by_rate = np.column_stack([path.between(begin + lag, end + lag) for path in paths])
        use = together & np.isfinite(by_rate).all(axis=1)
        if np.count_nonzero(use) < 2 * span:
            return 0.0, 0.0, 0.0
        a, b = way[use], by_rate[use]
        return float(np.mean(a * a)), float(np.mean(b * b)), float(np.mean(a * b))

    a2, b2, ab = compared(0.0)
    if max(a2, b2) < MOVES**2:
        return ""
    if min(a2, b2) < 1e-4 * max(a2, b2):
        return words["rates rest" if b2 < a2 else "values rest"]
    if a2 < MOVES**2 or b2 < MOVES**2:
        return ""
    r, ratio = ab / np.sqrt(a2 * b2), np.sqrt(a2 / b2)
    if r < -FOLLOWS:
        return words["against"]
    if abs(r) > FOLLOWS and not 1.0 / RATIO < ratio < RATIO:
        return words["unit"].format(ratio)
    if abs(r) > APART:
        return ""
    every = [compared(lag) for lag in np.linspace(-LAG, LAG, 41)]
    if any(abs(x) > APART * np.sqrt(a * b) for a, b, x in every if a > 0.0 and b > 0.0):
        return ""
    return words["apart"].format(r)


def _jump(time: Array, q: Array, went: _Path) -> str:
    """The largest jump that stays."""
    step, move = np.diff(time), np.diff(q)
    rate = move / step  # of neighbours, whose steps may be longer where samples are lost
    speed = np.abs(rate)
    depart = move - step * np.append(np.append(np.nan, 0.5 * (rate[2:] + rate[:-2])), np.nan)
    by_velocity = move - went.between(time[:-1], time[1:])  # both have to say so
    depart = np.where(np.abs(by_velocity) < np.abs(depart), by_velocity, depart)
    known = np.isfinite(depart) & (step <= NEAR * np.median(step))
    if np.count_nonzero(known) < 4 * NEAR:
        return ""
    depart = np.where(known, depart, 0.0)
    size = np.abs(depart)
    noise = float(np.median(size[known])) / 0.6745
    count = float(np.min(np.abs(move[move != 0.0]), initial=np.inf))  # or the least of its noise
    if not np.isfinite(count):
        return ""
    for k in np.argsort(-size)[:NEAR]:
        near = slice(max(k - NEAR, 0), k + NEAR + 1)
        if not known[near].all():
            continue
        stays = abs(float(depart[near].sum()))
        around = np.delete(speed[near], min(k, NEAR))
        ahead = AHEAD * float(np.median(around))
        if stays > max(JUMP, NOISE * noise, COUNTS * count, ahead, 0.5 * size[k]):
            return (
                f"its position jumps by {stays:.2g} rad or m at {time[k + 1]:.4g} s and stays there: an "
                "encoder that slipped, or two runs in one log"
            )
    return ""
