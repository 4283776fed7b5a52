"""How late the sensor is against a reference that moves, undone at the reference.

Sensor and reference are rarely stamped alike, and either may be filtered. To second order

    raw(t) = C [w(t - l) + (k - l^2 / 2) w''(t - l)] + b,    l = s + r (t - t_m)

with s how late the sensor is, r by how much clocks run apart, and k = s^2 / 2 for a clock, s^2 for a filter
of the sensor, 0 for one of the reference (docs/method.md, M22a). Residuals last, so that the covariance of
s, k and r is that of the scores of parts of the log; what it makes uncertain of the gain is kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline

from truewrench.model.arrays import Array, Mask
from truewrench.model.log import Log
from truewrench.model.motion.smooth import DEGREE, segments, uniform_spline
from truewrench.model.repeats import SAMPLED
from truewrench.model.rig import Rig

TOLD = 6.0  # sigma of s, or of r, from which on they are undone
FEWEST, SHORTEST = 200, 20  # rows of a reference that is sampled, and of a stretch of it
SPACINGS = (0.2, 0.1, 0.05)  # [s] of a smooth reference's knots: the widest that leave, in the median,
FOLLOWS = 1.1  # times its noise, or what the finest leave: a median of 1,000 samples scatters by 4%
FURTHEST, GRID = 0.25, 0.01  # [s] that a sensor is late at most, and steps in which that is sought
MOST = 20_000  # rows that are looked at
PARTS = 20  # of a log, by whose scores residuals last
FREEDOM = 4.0  # of Student's t, by which rows are weighted
ROUNDS, SETTLED = 30, 0.01  # at most, and sigma of a step


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceClock:
    """What was undone at a reference."""

    late: float  # s [s]
    late_std: float  # its 1 sigma
    rate: float  # r; 0 where none is told
    moved: Array  # (N, 6, p) of w by s, k (and r) in each row of the log [N, N m, per s, s^2, 1]
    covariance: Array  # (p, p) of these


def with_reference_on_time(rig: Rig, log: Log) -> tuple[Log, ReferenceClock | None]:
    """The log with its reference as it was when the sensor was read.

    A reference with stamps of its own comes to rows with both sides. Tables, short logs and those whose
    sensor is not told to be late come back as they are.
    """
    if log.reference is None or rig.reference_noise is None:
        return log, None
    log = _on_common_rows(rig, log)
    assert log.reference is not None
    rows = np.flatnonzero(np.isfinite(np.column_stack([log.raw, log.reference])).all(axis=1))
    sampled = _sampled(log.time[rows], log.reference[rows], np.array(rig.reference_noise))
    if not sampled:
        return log, None
    thinned = rows[:: -(-rows.size // MOST)]
    record = _Record(log.time[thinned], log.raw[thinned] / rig.sensor.channel_scale, sampled)
    found = record.solved()
    if found is None:
        return log, None
    p, P = found
    moved, inside = record.moved(p, log.time, nearest=True)
    use = np.flatnonzero(np.diag(P) > 0.0)
    by = np.where(inside[:, None, None], moved[..., 1 + use], 0.0)
    clock = ReferenceClock(float(p[0]), float(np.sqrt(P[0, 0])), float(p[2]), by, P[np.ix_(use, use)])
    return replace(log, reference=np.where(inside[:, None], moved[..., 0], np.nan)), clock


def _on_common_rows(rig: Rig, log: Log) -> Log:
    """Where hardly a row has both sides, the faster side at the stamps of the slower."""
    assert log.reference is not None
    sensed, told = (np.flatnonzero(np.isfinite(x).all(axis=1)) for x in (log.raw, log.reference))
    fewer = min(sensed.size, told.size)
    if fewer < FEWEST or 2 * np.intersect1d(sensed, told).size >= fewer:
        return log
    slower = told.size <= sensed.size
    rows, known = (told, sensed) if slower else (sensed, told)
    values = log.raw if slower else log.reference
    noise = rig.sensor.noise_array if slower else np.array(rig.reference_noise)
    moved = np.full_like(values, np.nan)
    for piece in _sampled(log.time[known], values[known], noise):
        inside = rows[piece.holds(log.time[rows])]
        moved[inside] = piece.nearest(log.time[inside])
    note = "sensor and reference have stamps of their own: {} taken at those of {}"
    if slower:
        return replace(log, raw=moved, notes=(*log.notes, note.format("raw_*", "ref_*")))
    return replace(log, reference=moved, notes=(*log.notes, note.format("ref_*", "raw_*")))


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """A stretch of samples: without its noise, and what that is."""

    time: Array
    smooth: BSpline
    noise: Array

    def holds(self, time: Array) -> Mask:
        return np.asarray((time >= self.time[0]) & (time <= self.time[-1]))

    def nearest(self, then: Array) -> Array:
        """The nearest sample at times, moved as the smooth stretch moves: its noise stays white."""
        after = np.clip(np.searchsorted(self.time, then), 1, self.time.size - 1)
        near = after - (2.0 * then < self.time[after] + self.time[after - 1])
        return np.asarray(self.smooth(then) + self.noise[near])

    def between(self, then: Array) -> Array:
        """The same between two samples: continuous. What smooths, a filter as well, plays no part."""
        noise = np.column_stack([np.interp(then, self.time, x) for x in self.noise.T])
        return np.asarray(self.smooth(then) + noise)


def _sampled(time: Array, values: Array, noise: Array) -> tuple[_Piece, ...]:
    """Stretches of what is sampled, with noise of 1 sigma (M,); none of a table, or of a few rows."""
    found = []
    for at in segments(time) if time.size >= FEWEST else []:
        if at.stop - at.start < SHORTEST or np.median(np.diff(time[at])) > SAMPLED:
            continue
        smooth = _smoothed(time[at], values[at], noise)
        if smooth is not None:
            found.append(_Piece(time[at], smooth, values[at] - smooth(time[at])))
    return tuple(found)


def _smoothed(time: Array, values: Array, noise: Array) -> BSpline | None:
    period = float(np.median(np.diff(time)))
    found: list[tuple[Array, BSpline]] = []
    for spacing in SPACINGS:
        intervals = max(1, round((time[-1] - time[0]) / max(spacing, 3.0 * period)))
        try:
            spline = uniform_spline(time, values, intervals)
        except (ValueError, np.linalg.LinAlgError):  # hardly a sample between two knots
            continue
        freedom = max(1, time.size - intervals - DEGREE)
        left = np.median(np.abs(values - spline(time)), axis=0) / 0.6745
        found.append((left * np.sqrt(time.size / freedom), spline))
    # noise that finer knots follow would be taken for the second derivative
    enough = FOLLOWS * np.maximum(noise, found[-1][0]) if found else noise
    return next((spline for left, spline in found if (left <= enough).all()), None)


@dataclass(frozen=True, slots=True, eq=False)
class _Record:
    """Rows of a log whose reference is sampled; channels are fractions of R_i."""

    time: Array
    raw: Array
    reference: tuple[_Piece, ...]

    @property
    def middle(self) -> float:
        return 0.5 * float(self.time[0] + self.time[-1])

    def moved(self, p: Array, time: Array, nearest: bool = False) -> tuple[Array, Mask]:
        """(N, 6, 4) the reference that s, k, r have moved, by what they move it; and where it is known."""
        out, inside = np.zeros((time.size, 6, 4)), np.zeros(time.size, dtype=bool)
        since = time - self.middle
        then = time - p[0] - p[2] * since
        for piece in self.reference:
            here = piece.holds(time) & piece.holds(then)
            w = piece.nearest(then[here]) if nearest else piece.between(then[here])
            rate, second = (np.asarray(piece.smooth(then[here], nu=nu)) for nu in (1, 2))
            by_r = -since[here, None] * rate
            out[here] = np.stack([w + (p[1] - 0.5 * p[0] ** 2) * second, -rate, second, by_r], axis=2)
            inside |= here
        return out, inside

    def solved(self) -> tuple[Array, Array] | None:
        """s, k, r and their covariance, 0 of what is not told; None where neither s nor r is."""
        start = np.zeros(3)
        start[0] = min(np.arange(-FURTHEST, FURTHEST + 0.5 * GRID, GRID), key=self._left)
        start[1] = 0.5 * start[0] ** 2
        for free in ((0, 1, 2), (0, 1)):
            found = self._solved(start, list(free))
            if found is None:
                continue
            told = np.abs(found[0]) > TOLD * np.sqrt(np.diag(found[1]))
            if told[2] or (told[0] and 2 not in free):  # what is not free is 0
                return found
        return None

    def _left(self, late: float) -> float:
        """Log of the determinant of what gain and offset leave where the sensor is so late."""
        reference, then = np.full((self.time.size, 6), np.nan), self.time - late
        for piece in self.reference:
            here = piece.holds(self.time) & piece.holds(then)
            reference[here] = piece.between(then[here])
        inside = np.isfinite(reference[:, 0])
        if inside.sum() < FEWEST:
            return np.inf
        w, raw = (x - x.mean(axis=0) for x in (reference[inside], self.raw[inside]))
        left = raw - w @ np.linalg.lstsq(w.T @ w, w.T @ raw, rcond=None)[0]
        return float(np.log(np.mean(left**2, axis=0).clip(1e-300)).sum())

    def _solved(self, start: Array, free: Sequence[int]) -> tuple[Array, Array] | None:
        p, weight = start.copy(), np.ones(self.time.size)
        for _ in range(ROUNDS):
            bend = max(0.5 * p[0] ** 2, 1e-12)
            prior = np.diag([0.0, bend**-2.0, 0.0])  # k is 0 to s^2
            moved, inside = self.moved(p, self.time)
            if inside.sum() < FEWEST:
                return None
            score, information, weight = self._scores(moved[inside], inside, weight)
            pull = np.array([0.0, (bend - p[1]) * bend**-2.0, 0.0])
            at = np.ix_(free, free)
            A = (information.sum(axis=0) + prior)[at]
            if not np.isfinite(A).all() or not (np.diag(A) > 0.0).all():  # nothing that would move
                return None
            if np.linalg.matrix_rank(A / np.sqrt(np.outer(np.diag(A), np.diag(A)))) < len(free):
                return None
            inverse = np.linalg.inv(A)
            step = inverse @ (score.sum(axis=0) + pull)[list(free)]
            P = np.zeros((3, 3))
            P[at] = inverse @ (score.T @ score + prior)[at] @ inverse
            p[list(free)] += step
            if abs(p[0]) > 2.0 * FURTHEST:
                return None
            if (np.abs(step) < SETTLED * np.sqrt(np.diag(P)[list(free)])).all():
                return p, P
        return None

    def _scores(self, moved: Array, inside: Mask, weight: Array) -> tuple[Array, Array, Array]:
        """Of parts (PARTS, 3) and (PARTS, 3, 3), gain and offset eliminated; and new weights of the rows."""
        root = np.sqrt(weight[inside])
        X = np.column_stack([moved[..., 0], np.ones(len(moved))])
        Q, R = np.linalg.qr(root[:, None] * X)
        Y = root[:, None] * self.raw[inside]
        C = np.linalg.lstsq(R, Q.T @ Y, rcond=None)[0]  # (7, n); an axis may never have been loaded
        left = self.raw[inside] - X @ C
        variance = (1.4826 * np.median(np.abs(left), axis=0)) ** 2
        sigma = np.sqrt(np.maximum(variance, 1e-24))
        K, n = len(moved), len(sigma)
        by_clock = (root[:, None, None] * moved[..., 1:].transpose(0, 2, 1)).reshape(-1, 6) @ C[:6]
        D = by_clock.reshape(K, -1)
        D = ((D - Q @ (Q.T @ D)).reshape(K, 3, n)) / sigma
        r = root[:, None] * left / sigma
        parts = np.array_split(np.arange(len(moved)), PARTS)
        again = np.zeros(self.time.size)
        again[inside] = (FREEDOM + n) / (FREEDOM + np.sum((left / sigma) ** 2, axis=1))
        by_part = [D[at].transpose(1, 0, 2).reshape(3, -1) for at in parts]
        score = [of @ r[at].ravel() for of, at in zip(by_part, parts, strict=True)]
        return np.array(score), np.array([of @ of.T for of in by_part]), again
