"""Whether logs tell the same tool on the same sensor: each log against the others (METHOD (10.11))."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from truewrench.estimation.static_poses import APART, MOVING, Move
from truewrench.model.arrays import Array, Integers
from truewrench.tool.model_rows import MotionInformation, Problem
from truewrench.tool.motion import motion_information
from truewrench.tool.solve import Solution, told

FEWEST = 8  # poses of a log, which are compared by halves
_LEAST = 1e-9  # of the prior's variance: a direction of which two parts know no more is none


def agreement_of_logs(solution: Solution, threads: int) -> Array:
    """(L,) how likely chance makes each log differ as much from the others in gain, body, mounting and tilt.

    About the solution of all. Each log is read alone, so that no size has grown with what differs, and its
    offsets are integrated out; those of one session tell of each other, and are kept, with one walk.
    1: nothing to compare; no numbers: a motion could not be read alone.
    """
    problem = solution.problem
    v, poses = problem.vector, problem.poses
    moves = {move.log: move for move in problem.moves}
    logs = [log for log in range(v.logs) if log in moves or (poses.log == log).any()]
    p = np.ones(v.logs)
    if len(logs) < 2:
        return p
    of_moves = {log: _motion(solution, move, move, threads, of_log=True) for log, move in moves.items()}
    if None in of_moves.values():
        return np.full(v.logs, np.nan)
    kept = np.arange(v.slope.start) if problem.rig.sensor.pool_offsets else v.shared
    parts = [
        (replace(problem, poses=poses.of(poses.log == log), motion=of_moves.get(log)), solution.x)
        for log in (-1, *logs)
    ]
    p[logs] = differences(parts, kept, v.shared)
    return p


def agreement_of_halves(solution: Solution, threads: int) -> Array:
    """(L,) the same of the first and the second half of each log: of poses, or of motion with few of them.

    With offsets of their own, as if the log had been cut. 1: too little to be parted; no number: half of the
    motion could not be read alone. Of poses and the moves between them a half is too little to tell what
    follows the pose, as hysteresis: 9 of 18 such logs, sound but for that, were told apart.
    """
    problem = solution.problem
    v, poses, p = problem.vector, problem.poses, np.ones(problem.vector.logs)
    moves = {move.log: move for move in problem.moves}
    for log in range(v.logs):
        own = np.flatnonzero(poses.log == log)
        halves = own[: own.size // 2], own[own.size // 2 :]
        motion: list[MotionInformation | None] = [None, None]
        if own.size < FEWEST:
            if log not in moves or (middle_ns := _middle_ns(moves[log])) is None:
                continue
            halves = own[poses.time_ns[own] < middle_ns], own[poses.time_ns[own] >= middle_ns]
            motion = _halves(solution, moves[log], middle_ns, threads)
            if None in motion:
                p[log] = np.nan
                continue
        parts = [
            (replace(problem, poses=poses.of(chosen), motion=says), solution.x)
            for chosen, says in zip((own[:0], *halves), (None, *motion), strict=True)
        ]
        p[log] = differences(parts, v.shared, v.shared)[0]
    return p


def _middle_ns(move: Move) -> int | None:
    """When half of what a log moves has passed; None: too little of it moves to be parted."""
    sensed = np.flatnonzero(np.isfinite(move.record.raw).any(axis=1))
    step = np.diff(move.record.time[sensed])
    moving = np.cumsum(np.where(step < APART, step, 0.0))
    if not moving.size or moving[-1] < 2.0 * MOVING:
        return None
    return int(move.record.time_ns[sensed[1 + np.searchsorted(moving, 0.5 * moving[-1])]])


def _halves(solution: Solution, move: Move, middle_ns: int, threads: int) -> list[MotionInformation | None]:
    """What a log's motion says before and after a time; None: what cannot be read alone."""
    later = move.record.time_ns >= middle_ns
    out: list[MotionInformation | None] = []
    for half in (~later, later):
        raw = np.where(half[:, None], move.record.raw, np.nan)
        part = replace(move, record=replace(move.record, raw=raw))
        out.append(_motion(solution, part, move, threads))
    return out


def differences(parts: Sequence[tuple[Problem, Array]], kept: Integers, common: Integers) -> Array:
    """(K,) p of each of several parts of a problem, each about an x, against the others.

    Parts as of `told`, before them one without data; `kept` of x, the rest integrated out, and of these what
    is compared; over what rate and repeatability may be.
    """
    p, total = np.zeros(len(parts) - 1), 0.0
    for weight, says in told(parts):
        said = []
        for A, g in says:
            P = np.linalg.inv(A)
            information: Array = np.linalg.inv(P[np.ix_(kept, kept)])
            said.append((information, np.asarray(information @ (P @ g)[kept])))
        p += weight * apart(said[0], said[1:], np.searchsorted(kept, common))
        total += weight
    return p / total


def apart(prior: tuple[Array, Array], said: Sequence[tuple[Array, Array]], places: Integers) -> Array:
    """(K,) p of what each of several says, the prior within, against the others, at places of it."""
    before, of_before = prior
    own = [(S - before, h - of_before) for S, h in said]
    all_S, all_h = sum(S for S, _ in own) + before, sum(h for _, h in own) + of_before
    block, p = np.ix_(places, places), np.ones(len(own))
    root = np.linalg.cholesky(np.linalg.inv(before)[block])
    for k, (S, h) in enumerate(own):
        P, rest = np.linalg.inv(S + before), np.linalg.inv(all_S - S)
        both = P @ before @ rest
        V = (P + rest - both - both.T)[block]  #                                                       (10.11)
        V = np.linalg.solve(root, np.linalg.solve(root, V).T)
        away = np.linalg.solve(root, (P @ (h + of_before) - rest @ (all_h - h))[places])
        values, vectors = np.linalg.eigh(0.5 * (V + V.T))
        seen = values > _LEAST
        if seen.any():
            p[k] = chdtrc(np.count_nonzero(seen), ((vectors[:, seen].T @ away) ** 2 / values[seen]).sum())
    return p


def _motion(
    solution: Solution, part: Move, move: Move, threads: int, *, of_log: bool = False
) -> MotionInformation | None:
    """What a move, or a part of it, says alone, at the places of all."""
    problem = solution.problem
    gain, body = problem.motion_of(solution.x)
    gain_std, tilt_std = problem.priors_of_motion
    found = motion_information(
        problem.rig,
        [part],
        gain,
        gain_std,
        body,
        tilt_std,
        walk=solution.rate,
        threads=threads,
        linear_there=True,
        of_log=of_log,
    )
    if found is None:
        return None
    n, says = problem.vector.n, found.information
    counts = [n * max(one.knots.size, 1) for one in problem.moves]
    first, k = 6 * n + 10, problem.moves.index(move)
    last = 2 + n * problem.warm_moves
    start, size = first + sum(counts[:k]), first + sum(counts) + last
    at = np.r_[:first, start : start + counts[k], size - last : size]
    out = MotionInformation(np.zeros(size), np.zeros((size, size)), np.zeros(size))
    out.at[at], out.information[np.ix_(at, at)], out.gradient[at] = says.at, says.information, says.gradient
    return out
