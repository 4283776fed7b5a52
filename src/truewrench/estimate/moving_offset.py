"""Offsets that move although the rig says that they do not (docs/method.md, "Drift")."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from truewrench.estimate.fits import ENOUGH, fitted_share
from truewrench.estimate.noise import with_noise_of_walk
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.log import Log
from truewrench.rig import Rig

__all__ = [
    "Jump",
    "Wandering",
    "end_notes",
    "jump_in",
    "jump_notes",
    "limit_of_jump",
    "log_cut_at",
    "offsets_may_move",
    "open_end",
    "still_moves",
    "untold",
    "wandering",
    "with_free_offsets",
]

Array = NDArray[np.float64]

SIGNIFICANT = 3e-6  # chance that noise explains as much as a jump does: chi-square of 36 in six channels,
FAINT = 3e-4  # or where the gain would hide the jump: 25, or more,
HIDDEN = 0.5  # if what it takes up of the jump is still less than this share of its NEES by chance
CHANCE = 4e-5  # and as much as the likeliest of all steps may, when the jump is taken out: 30
DOUBT = 20.0  # of the chi-square, what moving the jump may cost: between these times it lies,
LITTLE_KNOWN = 2.0  # up to so many times as much, as slow noise is above white noise,
VAGUE = 0.05  # or this share of it, for the wrench is not quite known
SHARPLY = 8  # rows between which a jump needs no parts of its own: the samples that are wrong are left out
PIECES = 6  # that the doubtful time is cut into, of
PIECE = 12  # rows at least: only the one with the jump is lost
END = 0.01  # share of the rows, or a PIECE if that is more: the shortest end of a log,
KNOWN = 0.25  # share of it that must be known
SHORT = 0.05  # share of the rows below which a piece between two cuts is too short to show anything
BLOCKS = 24  # as many as there are parts with free offsets: of their means the slow noise is taken,
LARGEST = 2  # of whose differences are not counted,
OF_WHITE = 0.70  # which leaves so much of white noise
ROUNDS = 3  # of the likeliest step and the noise without it
LARGEST_STEP = 3.0  # 1 sigma of the walk, in which its largest step must be
NAMED = 0.2  # of the largest jump in units of noise: what else jumps


@dataclass(frozen=True, slots=True, eq=False)
class Jump:
    """A change of the offset.

    Attributes:
        begin: it lies behind this time [s from the log's first row],
        likeliest: best here,
        end: and no later than this, the likeliest if they are but a few samples apart.
        change: (n,) [raw units].
        contested: contacts explain more of the log.
        faint: nearly as small as what noise alone may show.
    """

    begin: float
    likeliest: float
    end: float
    change: Array
    contested: bool = False
    faint: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Wandering:
    """Logs that fit with an offset that walks, and not with one that stays or jumps.

    Attributes:
        rig: which states the walk, and noise for what an offset walks within a part.
        estimate: with it.
    """

    rig: Rig
    estimate: WindowEstimate


def offsets_may_move(rig: Rig) -> bool:
    """Whether offsets are estimated log by log, so that one of its own in a part of a log can be."""
    return not rig.sensor.pool_offsets and bool(rig.sensor.offset_prior_array.any())


def with_free_offsets(rig: Rig, estimate: Callable[[Rig], WindowEstimate]) -> WindowEstimate | None:
    """The logs estimated with an offset of its own in every part, None where that does not fit either.

    Args:
        rig: with an offset for each log.
        estimate: on the logs, for a rig.
    """
    if not offsets_may_move(rig):
        return None
    free = rig.sensor.offset_prior_array  # per second: every part is as free as the first one
    found = estimate(_with_walk(rig, np.maximum(free, rig.sensor.offset_walk_array)))
    return found if found.solved and fitted_share(found.windows) >= ENOUGH else None


def untold(wrench: Array) -> NDArray[np.bool_]:
    """(M,) whether a wrench (M, 6) is not known."""
    return np.asarray(np.isnan(wrench).any(axis=1), dtype=np.bool_)


def open_end(wrench: Array) -> int:
    """How many of a log's last rows hardly tell anything, so that its offset may be another there.

    Args:
        wrench: (M, 6); NaN where it is not known, as where contacts were left out.
    """
    unknown = untold(wrench)
    rows = np.arange(1, len(wrench) + 1)
    hardly = np.flatnonzero(np.cumsum(unknown[::-1]) > (1.0 - KNOWN) * rows)
    count = int(rows[hardly[-1]]) if hardly.size else 0
    if count < max(PIECE, END * len(wrench)):
        return 0
    return count - int(np.argmax(unknown[-count:]))


def limit_of_jump(taken_up: Array, channels: int) -> Array:
    """Chi-square above which a step is a jump (docs/method.md, M15c).

    Args:
        taken_up: energy of a step that the gain takes up, over the energy that is seen.
        channels: of the sensor.
    """
    faint, significant = (float(chi2.isf(chance, channels)) for chance in (FAINT, SIGNIFICANT))
    return np.clip(HIDDEN * 6 * channels / np.maximum(taken_up, 1e-9), faint, significant)


def jump_in(
    log: Log,
    rows: NDArray[np.int64],
    wrench: Array,
    noise: Array,
    left_out: NDArray[np.bool_] | None = None,
    share: float = 1.0,
) -> Jump | None:
    """The jump of the offset that explains most of a log whose wrench is known.

    None where chance explains as much.

    Least squares of every channel on wrench, constant and a step, at every row that it can be at.

    Args:
        log: the whole of it.
        rows: (M,) of the log that the wrench belongs to.
        wrench: (M, 6) [N, N m]; NaN where it is not known.
        noise: (n,) 1 sigma of a sample.
        left_out: (M,) samples that contacts were found in, which `wrench` is known for none the less.
        share: of the rows that the gain is held by, in this log; 0 where the gain is not relied on.
    """
    time, y, regressors = _regression(log, rows, wrench, noise)
    if len(time) < 4 * PIECE:
        return None
    explained, sigma, free = _explained_by_a_step(y, regressors)
    best = int(np.argmax(explained))
    behind = np.arange(len(free), 0, -1)
    taken_up = share * (behind * (len(free) - behind) / len(free) / free - 1.0)
    if not np.any(explained > limit_of_jump(taken_up, y.shape[1])):
        return None
    contested, faint = False, bool(explained[best] < chi2.isf(SIGNIFICANT, y.shape[1]))
    if left_out is not None:
        _, kept, of_kept = _regression(log, rows, np.where(left_out[:, None], np.nan, wrench), noise)
        by_chance = (len(y) - len(kept)) * float(np.sum(sigma**-2.0))
        by_contacts = _misfit(y / sigma, regressors) - _misfit(kept / sigma, of_kept) - by_chance
        contested = bool(by_contacts > explained[best])
    # Also beyond times that are unlikely: what slow noise leaves of a small jump may have several peaks.
    doubt = DOUBT * min(LITTLE_KNOWN, float(np.max(sigma**2)))  # slow noise is measured on few means
    likely = np.flatnonzero(explained > max(0.0, explained[best] - max(doubt, VAGUE * explained[best])))
    first, last = int(likely[0]), int(likely[-1]) + 1
    step = np.arange(len(time)) >= best
    change = np.linalg.lstsq(np.column_stack([regressors, step]), y, rcond=None)[0][-1] * noise
    begin, likeliest, end = float(time[first - 1]), float(time[best]), float(time[last])
    before = float(time[best - 1])
    if last - first <= SHARPLY and likeliest - before <= SHARPLY * float(np.median(np.diff(time))):
        begin, end = before, likeliest
    return Jump(begin, likeliest, end, change, contested, faint)


def still_moves(log: Log, rows: NDArray[np.int64], wrench: Array, noise: Array) -> bool:
    """Whether a log that was cut where its offset jumps shows another step, as one that drifts would.

    Args:
        log: with the cut.
        rows: (M,) of the log that the wrench belongs to.
        wrench: (M, 6) of the estimate with the cut [N, N m]; NaN where it is not known.
        noise: (n,) 1 sigma of a sample.
    """
    time, y, regressors = _regression(log, rows, wrench, noise)
    limit = chi2.isf(CHANCE, y.shape[1])
    return len(time) >= 4 * PIECE and bool(_explained_by_a_step(y, regressors)[0].max() > limit)


def log_cut_at(log: Log, jump: Jump | None) -> Log:
    """The log with an offset that begins anew at a jump, and in every piece of the time that it may be in.

    Two pieces meet where a faint one is likeliest: it may lie anywhere, and in a long piece bends the gain.
    """
    if jump is None:
        return log
    inside = np.count_nonzero((log.time > jump.begin) & (log.time < jump.end))
    pieces = int(np.clip(inside / PIECE, 1, PIECES))
    edges = np.linspace(jump.begin, jump.end, pieces + 1)
    if jump.faint and pieces > 1:
        moved = edges.copy()
        moved[1 + np.argmin(np.abs(edges[1:-1] - jump.likeliest))] = jump.likeliest
        if np.diff(np.searchsorted(log.time, moved)).min() >= PIECE:
            edges = moved
    times = [jump.end] if inside <= SHARPLY else edges.tolist()
    return replace(log, offset_jumps_ns=tuple(int(log.time_ns[0]) + round(1e9 * time) for time in times))


def wandering(
    rig: Rig, logs: Sequence[Log], free: WindowEstimate, estimate: Callable[[Rig], WindowEstimate]
) -> Wandering | None:
    """The logs estimated with a random walk of the size that is seen, None where that does not fit.

    Args:
        rig: a walk that it states is not made smaller.
        logs: as recorded.
        free: estimate in which every part of the logs has an offset of its own.
        estimate: on the logs, for a rig.
    """
    rates = [
        np.diff(path.offset, axis=0) / np.sqrt(np.diff(0.5 * (path.begin + path.end)))[:, None]
        for path in free.offset_path
        if len(path.offset) > 1
    ]
    if not rates:
        return None
    steps = np.concatenate(rates)
    walk = np.maximum(np.sqrt(np.mean(steps**2.0, axis=0)), np.abs(steps).max(axis=0) / LARGEST_STEP)
    sized = with_noise_of_walk(_with_walk(rig, np.maximum(walk, rig.sensor.offset_walk_array)), logs)
    found = estimate(sized)
    return Wandering(sized, found) if found.solved and fitted_share(found.windows) >= ENOUGH else None


def jump_notes(rig: Rig, jumps: Sequence[Jump | None]) -> list[str]:
    """Per log whose offset jumps, when it did and how much which channel."""
    notes = []
    for k, jump in enumerate(jumps):
        if jump is None:
            continue
        sizes = np.abs(jump.change) / rig.sensor.noise_array
        named = np.flatnonzero(sizes > NAMED * sizes.max()).tolist()
        listed = ", ".join(f"{rig.sensor.channels[i]} by {jump.change[i]:.3g}" for i in named)
        verb = "may have jumped between" if jump.faint else "jumps between"
        notes.append(
            f"the offset of log {k + 1} {verb} {jump.begin:.3f} and {jump.end:.3f} s ({listed}): it "
            "was estimated before and after, and the one reported is that at the end, with whatever the "
            "sensor bears since"
            + ("; the gain would hide so small a jump, and noise shows one at times" if jump.faint else "")
        )
    return notes


def end_notes(logs: Sequence[Log], estimate: WindowEstimate) -> list[str]:
    """Per log whose end says nothing, since when."""
    notes = []
    for k, (log, rows, wrench) in enumerate(zip(logs, estimate.wrench_rows, estimate.wrench, strict=True)):
        if 0 < open_end(wrench) < len(rows):
            since = log.time[rows[-open_end(wrench)]]
            notes.append(
                f"hardly anything is known of log {k + 1} from {since:.3f} s on (contact, or a motion that "
                "does not fit): the offset reported is that before"
            )
    return notes


def _regression(log: Log, rows: NDArray[np.int64], wrench: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Times (N,), channels (N, n) in sigma and regressors (N, p): wrench, and a constant from cut to cut."""
    known = np.isfinite(wrench).all(axis=1) & np.isfinite(log.raw[rows]).all(axis=1)
    piece = np.searchsorted(np.array(log.offset_jumps_ns, dtype=np.int64), log.time_ns[rows], side="right")
    long = np.bincount(piece, known) >= SHORT * float(np.count_nonzero(known))
    known &= long[piece]  # pieces of the doubtful time of a jump have wrenches as uncertain as their motion
    constants = piece[known, None] == np.flatnonzero(long)
    return log.time[rows][known], log.raw[rows][known] / noise, np.column_stack([wrench[known], constants])


def _misfit(y: Array, regressors: Array) -> float:
    """Sum of the squares (N, n) that the regressors (N, p) leave."""
    basis = np.linalg.qr(regressors)[0]
    return float(np.sum((y - basis @ (basis.T @ y)) ** 2))


def _explained_by_a_step(y: Array, regressors: Array) -> tuple[Array, Array, Array]:
    """Chi-square that a step from each row on explains beside the regressors, and what it is made of.

    (N,) in all channels; (n,) 1 sigma of white noise as dense as what is slow; and (N,) squared norm of
    what the regressors leave of a step by 1, 1 at least.

    Args:
        y: (N, n) channels, in sigma.
        regressors: (N, p).
    """
    count = len(y)
    basis = np.linalg.qr(regressors)[0]
    residual = y - basis @ (basis.T @ y)
    behind = np.cumsum(basis[::-1], axis=0)[::-1]  # of every row and those after it
    free = np.arange(count, 0, -1) - np.sum(behind**2, axis=1)  # squared norm of what is new in the step
    sums = np.cumsum(residual[::-1], axis=0)[::-1]
    sums[free <= 1.0] = 0.0
    sums[:PIECE] = sums[count - PIECE :] = 0.0
    free = np.maximum(free, 1.0)
    noise, explained, variance = residual, np.zeros(count), np.ones(y.shape[1])
    for _ in range(ROUNDS):
        variance = _slow_noise(noise)
        explained = np.sum(sums**2 / variance, axis=1) / free
        best = int(np.argmax(explained))  # whose share of the residual is no noise
        step = (np.arange(count) >= best) - basis @ behind[best]
        noise = residual - np.outer(step, sums[best] / free[best])
    return explained, np.sqrt(variance), free


def _slow_noise(residual: Array) -> Array:
    """(n,) variance of white noise with the means over some time that differences show; 1 at least.

    Offsets that are free from part to part take up the errors of the motion, which are large beside a good
    sensor. The largest differences are not counted: contacts would be among them.

    Args:
        residual: (N, n) in sigma.
    """
    size = len(residual) // BLOCKS
    means = residual[: BLOCKS * size].reshape(BLOCKS, size, -1).mean(axis=1)
    squares = np.sort(np.diff(means, axis=0) ** 2, axis=0)[:-LARGEST]
    slow = 0.5 * size * squares.mean(axis=0) / OF_WHITE
    return np.asarray(np.maximum(1.0, np.maximum(slow, np.mean(residual**2, axis=0))))


def _with_walk(rig: Rig, walk: Array) -> Rig:
    sensor = rig.sensor.model_copy(update={"offset_walk": tuple(walk.tolist())})
    return rig.model_copy(update={"sensor": sensor})
