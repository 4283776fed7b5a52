"""What departures from the model look like: regressors, scored in one currency (METHOD 10.7).

Time, pose, products of the wrench, the sign of its rate and a friction's state, its rates, g and Omega x g,
and what is fast. All are projected off (w, 1), which gain and offset have taken already. The currency is
-2 log L: what is slow is asked how far it falls beside a random walk, which resembles whatever is slow.
It changes no estimate, no verdict.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.fft import dst
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicHermiteSpline

from truewrench.estimation.estimate import Estimate, LogRows
from truewrench.model.arrays import Array, Integers
from truewrench.model.log import Log
from truewrench.model.rig import Rig

BIN = 0.05  # [s] slow departures are averaged over: tolerance
LONGEST = 200.0  # [s] that are asked at once, for the memory of it: tolerance
COSINES = 4  # over the length of what is asked at once, that a drifting offset is made of
FRICTION = (0.003, 0.01, 0.03)  # fractions of range over which friction saturates: tolerance
FEWEST = 24  # bins, or samples, from which on a record is asked: tolerance
CROWDED = 0.5  # regressors per value, from which on they explain anything: tolerance
WALKS = np.concatenate([[0.0], 10.0 ** np.arange(-4.0, 4.0)])  # variance of steps, in the noise's: tolerance
# Of a walk's own fall what counts for drift: then first in 111 of 117 drifts and walks (beside white noise
# alone in 52), in 16 of 83 cables and nonlinear sensors (4), in no hysteresis of 60 (1).
WALK = 10.0
FAST = 10.0  # [Hz] vibration is sought above
PEAK = 5.0  # half of chi-square above the largest of white noise: 1 record in 150
# Medians of a squared residual at which it is bounded, as bursts of jerk are large in a few rows. Jitter is
# then said of 2 of 30 records that stop and go (10 without the bound), and of 32 (33) of 40 with jitter.
FAR = 2.0
GROWS = 4.0  # sigma beyond which noise is said to grow with a rate: none of 96 records without jitter
STEPS = 3.0  # sigma: a motion that is logged in larger steps is coarse


@dataclass(frozen=True, slots=True)
class Looks:
    """One kind of departure that the record looks like."""

    kind: str  # one of `KINDS`
    score: float  # fall of -2 log L, of all channels and logs; of single rows, of chi-square
    words: str = ""  # what was seen, for a person
    value: float = 0.0  # how large it is: fraction of range, of jitter [s], of a step of the motion SI


def slow_looks(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[Looks, ...]:
    """What the slow departures look like, likeliest first; empty where they look like nothing."""
    falls: dict[str, Array] = {}
    for rows, log in zip(estimate.rows, logs, strict=True):
        for binned in _binned(rows, estimate, rig, log):
            for kind, fall in _falls(*binned).items():
                falls[kind] = falls.get(kind, np.zeros(2)) + fall
    scores = {kind: float(fall[0]) for kind, fall in falls.items()}
    first = max(scores, key=lambda kind: scores[kind], default="drift")
    # two at once: a walk takes more beside the first than the first beside it
    if first != "drift" and falls[first][1] > scores[first] > scores["drift"]:
        scores["drift"] = float(np.nextafter(scores[first], 0.0))
    found = [Looks(kind, score) for kind, score in scores.items() if score > 0.0]
    return tuple(sorted(found, key=lambda looks: -looks.score))


def _binned(
    rows: LogRows, estimate: Estimate, rig: Rig, log: Log
) -> Iterator[tuple[Array, Array, Mapping[str, Array]]]:
    """Departure (M, n), w with 1 (M, 7), and regressors (M, p) or (M, n, p), of every piece."""
    span, scale = rig.sensor.range_array, rig.sensor.channel_scale
    normalised = estimate.gain * span / scale[:, None]
    for at in _pieces(rows):
        t, w = rows.time[at], rows.wrench[at] / span
        if t.size < FEWEST or not np.isfinite(w).all():
            continue
        y = rows.residual[at] + rows.discrepancy[at]
        y[rows.masked[at]] = np.nan
        use = np.flatnonzero(np.isfinite(y).all(axis=1))
        bins = ((t[use] - t[0]) / BIN).astype(np.int64)
        begins = np.flatnonzero(np.diff(bins, prepend=-1))
        if begins.size < FEWEST:
            continue
        mean = partial(_mean, use=use, begins=begins)
        felt = w @ normalised.T
        rate = np.gradient(felt, t, axis=0)
        pose = cumulative_trapezoid(rows.twist[at], t, axis=0, initial=0)
        pose -= pose.mean(axis=0)
        x = np.pi * (t - t[0]) / max(t[-1] - t[0], 1e-9)
        columns = {
            "drift": mean(np.cos(np.outer(x, np.arange(1, COSINES + 1)))),
            "cable": mean(pose),
            "cable, bent": np.concatenate([mean(pose), _products(pose, mean)], axis=1),
            "nonlinearity": _products(w, mean),
            "hysteresis": np.stack(
                [mean(np.sign(rate)), *(mean(_friction(felt / over)) for over in FRICTION)], axis=2
            ),
            "filter": np.stack([mean(rate), mean(np.gradient(rate, t, axis=0))], axis=2),
        }
        if log.gravity is not None:
            g = log.gravity[rows.rows[at]]
            if np.isfinite(g).all():
                turned = np.cross(rows.twist[at, 3:], g)
                columns["gravity"] = np.concatenate([mean(g), mean(turned)], axis=1)
        yield mean(y), np.column_stack([mean(w), np.ones(begins.size)]), columns


def _pieces(rows: LogRows) -> Iterator[Integers]:
    """Rows of every stretch, of long ones of parts."""
    for stretch in np.unique(rows.stretch):
        at = np.flatnonzero(rows.stretch == stretch)
        yield from np.array_split(at, max(1, int(np.ceil(np.ptp(rows.time[at]) / LONGEST))))


def _mean(values: Array, use: Integers, begins: Integers) -> Array:
    """Used rows of values (K, ...) averaged over bins that begin at these of them."""
    count = np.diff(begins, append=use.size)
    total = np.add.reduceat(values[use], begins, axis=0)
    return np.asarray(total / count.reshape(-1, *[1] * (values.ndim - 1)))


def _falls(y: Array, known: Array, columns: Mapping[str, Array]) -> dict[str, Array]:
    """How far -2 log L of all channels falls: by a kind beside noise and a walk, and by a walk beside it."""
    basis, values = _basis(known), len(y) - known.shape[1]
    y = y - basis @ (basis.T @ y)
    energy = np.sum(y**2, axis=0)
    at = np.flatnonzero(energy > 0.0)
    power = 4.0 * np.sin(0.5 * np.pi * np.arange(1, len(y)) / len(y)) ** 2  # of white noise, differenced
    root = np.sqrt(WALKS[:, None] + power)
    w, changes = _changes(known[:, :-1]), _changes(y)
    walk = _misfit(w, changes, root)
    found: dict[str, Array] = {}
    for kind, x in columns.items():
        fall = np.zeros(2)
        for of in [at] if x.ndim == 2 else at[:, None]:
            X = x if x.ndim == 2 else x[:, of[0]]
            size = np.linalg.norm(X - X.mean(axis=0), axis=0)
            X = X[:, size > 1e-12] / size[size > 1e-12]
            added = _basis(X - basis @ (basis.T @ X), 1e-4)
            p = added.shape[1]
            if not 0 < p <= CROWDED * values:
                continue
            beside = _misfit(np.column_stack([w, _changes(added)]), changes[:, of], root)
            # coefficients as large as the departure a priori
            by_kind = walk[:, of].min(axis=0) - beside.min(axis=0) - p * np.log(energy[of] / p)
            fall += np.maximum(by_kind, 0.0).sum(), (beside[0] - beside.min(axis=0)).sum()
        name = kind.split(",")[0]
        if name not in found or fall[0] > found[name][0]:
            found[name] = fall
    found["drift"][0] += min(float((walk[0] - walk.min(axis=0))[at].sum()), WALK)
    return found


def _changes(x: Array) -> Array:
    """Differences of (M, k) along sines, (M - 1, k): of white noise and of a walk they are independent."""
    return np.asarray(dst(np.diff(x, axis=0), type=1, axis=0, norm="ortho"))


def _misfit(Z: Array, y: Array, root: Array) -> Array:
    """-2 log L (G, n) of y (M, n), sigma by root (G, M), with coefficients of Z (M, p) and the size out."""
    freedom, out = len(y) - Z.shape[1], np.empty((len(root), y.shape[1]))
    for g, sigma in enumerate(root[:, :, None]):  # one by one, for the memory of it
        Q, R = np.linalg.qr(Z / sigma)
        whitened = y / sigma
        left = np.sum(whitened**2, axis=0) - np.sum((Q.T @ whitened) ** 2, axis=0)
        volume = 2.0 * np.log(sigma).sum() + 2.0 * np.log(np.abs(np.diag(R)) + 1e-300).sum()
        out[g] = freedom * np.log(np.maximum(left, 1e-300) / freedom) + volume
    return out


def _basis(columns: Array, least: float = 1e-10) -> Array:
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > least * max(float(size.max(initial=0.0)), 1e-300)])


def _products(x: Array, mean: Callable[[Array], Array]) -> Array:
    pairs = [(i, j) for i in range(x.shape[1]) for j in range(i, x.shape[1])]
    return np.stack([mean(x[:, i] * x[:, j]) for i, j in pairs], axis=1)


def _friction(felt: Array) -> Array:
    """State (N, n) of Dahl's friction over unit distance: z + dx - |dx| z, many parts of a record at once."""
    step = np.clip(np.diff(felt, axis=0, prepend=felt[:1]), -1.0, 1.0)
    length = int(np.ceil(len(felt) ** 0.5))
    parts = -(-len(felt) // length)
    dx: Array = np.zeros((parts, length, felt.shape[1]))
    dx.reshape(-1, felt.shape[1])[: len(felt)] = step
    state, left = np.zeros_like(dx), np.ones_like(dx)  # from rest; and what is left of a state before
    z, kept = np.zeros_like(dx[:, 0]), np.ones_like(dx[:, 0])
    for k in range(length):
        z, kept = z + dx[:, k] - np.abs(dx[:, k]) * z, kept * (1.0 - np.abs(dx[:, k]))
        state[:, k], left[:, k] = z, kept
    for part in range(1, parts):
        state[part] += left[part] * state[part - 1, -1]
    return np.asarray(state.reshape(-1, felt.shape[1])[: len(felt)])


def fast_looks(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[Looks, ...]:
    """What the fast departures look like beside noise, likeliest first; empty where they look like noise."""
    best: dict[str, Looks] = {}
    for k, (rows, log) in enumerate(zip(estimate.rows, logs, strict=True)):
        late = estimate.clocks[k][0].late if estimate.clocks[k] else 0.0
        for looks in (*_vibration(rows), _jitter(rows, estimate, rig, log, late), *_resolution(rig, log)):
            if looks.score > 0.0 and (looks.kind not in best or looks.score > best[looks.kind].score):
                best[looks.kind] = looks
    return tuple(sorted(best.values(), key=lambda looks: -looks.score))


def _vibration(rows: LogRows) -> Iterator[Looks]:
    """The highest peak of the residuals' spectrum above `FAST`; of a selection none: it would be folded."""
    if rows.every > 1:
        return
    for stretch in np.unique(rows.stretch):
        at = rows.stretch == stretch
        t, r = rows.time[at], np.where(rows.masked[at, None], 0.0, np.nan_to_num(rows.residual[at]))
        if t.size < 4 * FEWEST:
            continue
        frequency = np.fft.rfftfreq(t.size, max(float(np.median(np.diff(t))), 1e-9))
        power = np.abs(np.fft.rfft(r - r.mean(axis=0), axis=0)[frequency > FAST]) ** 2
        if len(power) < FEWEST:
            continue
        middle = np.median(power, axis=0) / np.log(2.0)  # of white noise: its mean
        middle = np.maximum(middle, 1e-300)  # a stretch that is masked whole
        over = np.sum(power / middle, axis=1) - r.shape[1]  # over all channels
        peak = int(np.argmax(over))
        # half a chi-square; chance: the largest of so many, in channels that may all have the same noise
        chance = r.shape[1] * (np.log(len(over)) + PEAK)
        i = int(np.argmax(power[peak] / middle))
        size = 2.0 * np.sqrt(power[peak, i]) / t.size
        hz = float(frequency[frequency > FAST][peak])
        words = f"a peak of {100 * size:.2g}% of range at {hz:.3g} Hz in the residuals"
        yield Looks("vibration", 2.0 * float(over[peak] - chance), words, float(size))


def _jitter(rows: LogRows, estimate: Estimate, rig: Rig, log: Log, late: float) -> Looks:
    """Whether noise grows with the rate of what is measured, as it does where the stamps are noisy."""
    t, fit = rows.time, rows.rows
    pairs: list[tuple[Array, Array]] = []
    for stretch in np.unique(rows.stretch):
        at = np.flatnonzero(rows.stretch == stretch)
        if at.size < FEWEST:
            continue
        felt = rows.wrench[at] @ estimate.gain.T / rig.sensor.channel_scale
        r = np.where(rows.masked[at, None], np.nan, rows.residual[at])
        pairs.append((r, np.gradient(felt, t[at], axis=0)))
        if log.twist is not None and rig.motion.source == "twist":
            a, later = rows.acceleration[at], t[at] + late
            moves = zip(rows.twist[at].T, a.T, strict=True)
            expected = np.column_stack([CubicHermiteSpline(t[at], v, dv)(later) for v, dv in moves])
            inside = (later >= t[at][0]) & (later <= t[at][-1])
            pairs.append((np.where(inside[:, None], log.twist[fit[at]] - expected, np.nan), a))
    z, slopes = 0.0, []
    for residual, rate in pairs:
        for r, x in zip(residual.T, rate.T**2, strict=True):
            use = np.isfinite(r) & np.isfinite(x)
            if use.sum() < FEWEST or not np.var(r[use]) > 0.0 or not np.var(x[use]) > 0.0:
                continue
            square, x = r[use] ** 2, x[use] - x[use].mean()
            bounded = np.minimum(square, FAR * np.median(square))
            z += float(bounded @ x / np.sqrt(np.var(bounded) * np.sum(x**2)))
            slopes.append(max(float(square @ x / np.sum(x**2)), 0.0))  # var r = sigma^2 + tau^2 rate^2
    z /= max(len(slopes), 1) ** 0.5
    tau = float(np.sqrt(np.median(slopes))) if slopes else 0.0
    words = f"noise that grows with the rate of what is measured ({z:.1f} sigma)"
    return Looks("jitter", float(np.sign(z) * z**2 - GROWS**2), words, tau)


def _resolution(rig: Rig, log: Log) -> Iterator[Looks]:
    """Whether the motion was logged in steps that are coarse beside its noise."""
    stated = np.asarray(rig.motion.noise)
    values = {"twist": log.twist, "joints": log.velocity}.get(rig.motion.source)
    if values is None or values.shape[1] != stated.size:
        return
    for column, sigma in zip(values.T, stated, strict=True):
        known = column[np.isfinite(column)]
        levels = np.unique(known)
        if known.size < 4 * FEWEST or not 2 < levels.size < 0.5 * known.size:
            continue
        step = float(np.median(np.diff(levels)))
        if step > STEPS * sigma:
            words = f"motion in steps of {step:.2g}, {step / sigma:.2g} sigma of its noise"
            yield Looks("resolution", known.size * float(np.log(known.size / levels.size)), words, step)
