"""What needs no estimate to be refused: the joints themselves, or least squares on a few seconds, tell it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations

import numpy as np

from truewrench import _core
from truewrench.estimation.estimator import estimate
from truewrench.estimation.least_squares import least_squares
from truewrench.estimation.logged_otherwise import (
    BETTER,
    FOLLOWED,
    LEFT,
    MISFIT,
    Guess,
    explains,
    guesses_of_motion,
)
from truewrench.judging import gross_errors
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log, log_name
from truewrench.model.motion.smooth import covered
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.robot.joint_faults import gravity_faults, joint_faults
from truewrench.robot.track import with_twist

SECONDS, CONFIRMING = 4.0, 12.0  # of each log, from its middle: for least squares, and for the estimator
LARGEST = 40.0  # of nominal: what is larger is noise to the estimator, and the gain of no sensor
FREE = 1e3  # 1 sigma of the gains that pulls none


@dataclass(frozen=True, slots=True, eq=False)
class _Plain:
    gain: Array  # (n, 6), SI
    covariance: Array  # (6n, 6n)
    left: float  # share of the raw output, median over the channels
    chi_square: float  # per sample, likewise


def hopeless(rig: Rig, logs: Sequence[Log], known: Sequence[Log]) -> list[str]:
    """Why these logs of motion cannot calibrate, in words; empty where they may.

    Those that are `known` carry a known payload.
    """
    found = joint_faults(rig, logs) or gravity_faults(rig, logs)
    if found or not known:
        return found
    short = [_middle(log, SECONDS) for log in known]
    plain = _plain(rig, short)
    if plain is None:
        return []
    if found := _logged_otherwise(rig, short, plain):
        return found
    if plain.left < FOLLOWED and gross_errors(rig, known, plain.gain, plain.covariance):
        return _confirmed(rig, known, _largest(rig, plain))
    return []


def _confirmed(rig: Rig, logs: Sequence[Log], largest: float) -> list[str]:
    """What the estimator says of `CONFIRMING` seconds, pulled by no prior.

    Least squares smooth a noisy motion, which makes gains several times too large, and take a disturbance for
    noise, which makes those of what hardly moved any number: of 600 imperfect records 25 looked like pounds
    to them, of 2,000 five like degrees. A raw output with gains beyond `LARGEST` is given in another unit.
    """
    unit = largest if largest >= LARGEST else 1.0
    sensor = rig.sensor
    free = sensor.model_copy(
        update={
            "gain_prior": FREE * max(1.0, sensor.gain_prior),
            "noise": tuple(x / unit for x in sensor.noise),
        }
    )
    parts = [_middle(replace(log, raw=log.raw / unit), CONFIRMING) for log in logs]
    found = estimate(rig.model_copy(update={"sensor": free}), parts, brief=True)
    if not found.solved:
        return []
    return [s.words for s in gross_errors(rig, logs, found.gain * unit, found.covariance * unit**2)]


def _largest(rig: Rig, plain: _Plain) -> float:
    """The largest gain, of nominal."""
    unit = 1.0 / rig.sensor.gain_unit
    return float(np.abs(plain.gain * unit).max())


def plain_gain(rig: Rig, logs: Sequence[Log]) -> tuple[Array, Array] | None:
    """Gain and covariance by least squares, which takes no departure for noise; None if it tells little."""
    found = _plain(rig, logs)
    return None if found is None or found.left >= _core.MOST_LOST else (found.gain, found.covariance)


def _plain(rig: Rig, logs: Sequence[Log]) -> _Plain | None:
    n = rig.sensor.n
    with np.errstate(all="ignore"):  # whatever the cells hold: the estimate tells what is wrong with them
        try:
            # differences of noisy velocities would shrink the gain, which looks like a wrong unit
            found = least_squares(rig, [_in_common(with_twist(rig, log)) for log in logs], "spline")
        except (InputError, np.linalg.LinAlgError):
            return None
        variance = np.nanvar(np.concatenate([log.raw for log in logs]), axis=0)
        left = float(np.median(found.chi_square * rig.sensor.noise_array**2 / variance))
        scatter = np.repeat(np.sqrt(np.maximum(found.chi_square, 1.0)), 6)
        P = found.covariance[: 6 * n, : 6 * n] * np.outer(scatter, scatter)
    return _Plain(found.gain, P, left, float(np.median(found.chi_square))) if np.isfinite(left) else None


def _in_common(log: Log) -> Log:
    """The rows that have both sides; where hardly one has, channels at the stamps of the motion.

    Least squares merge nothing. Of the stamps of the motion no more than the sensor has samples, or each
    would count several times.
    """
    if log.twist is None:
        return log
    sensed, moved = (np.flatnonzero(np.isfinite(x).all(axis=1)) for x in (log.raw, log.twist))
    fewer = min(sensed.size, moved.size)
    both = np.intersect1d(sensed, moved)
    if fewer == 0 or 2 * both.size >= fewer:
        return log if both.size == len(log.time_ns) else rows_of(log, np.isin(np.arange(len(log.raw)), both))
    rows = moved[:: -(-moved.size // sensed.size)]
    rows = rows[covered(log.time[sensed], log.time[rows])]
    raw = np.full_like(log.raw, np.nan)
    for channel in range(raw.shape[1]):
        raw[rows, channel] = np.interp(log.time[rows], log.time[sensed], log.raw[sensed, channel])
    return rows_of(replace(log, raw=raw), np.isin(np.arange(len(raw)), rows))


def _logged_otherwise(rig: Rig, logs: Sequence[Log], plain: _Plain) -> list[str]:
    """What was done to the joints, positions and velocities alike, to gravity, or to payloads.

    With gains that no sensor has, a motion 57 times as small explains much of a noisy record: 2 of 500 of
    joints were in degrees.
    """
    if not (plain.left > LEFT and plain.chi_square > MISFIT):
        return []
    best, said = min(plain.left / BETTER, FOLLOWED), ""
    for words, stated, guess in chain(_of_payloads(rig, logs), guesses_of_motion(rig, logs)):
        other = _plain(stated, guess)
        if other is not None and other.left < best and _largest(stated, other) < LARGEST:
            best, said = other.left, words
    if not said:
        return []
    return [explains(said, best, plain.left)]


def _of_payloads(rig: Rig, logs: Sequence[Log]) -> Iterator[Guess]:
    known = [name for name, payload in rig.payloads.items() if not payload.unknown]
    for k, log in enumerate(logs):
        for name in known:
            if name != log.payload:
                words = f"{log_name(logs, k)} carries `{name}`, not `{log.payload}`"
                yield words, rig, [*logs[:k], replace(log, payload=name), *logs[k + 1 :]]
    for i, j in combinations(range(len(logs)), 2):
        if logs[i].payload != logs[j].payload:
            swapped = list(logs)
            swapped[i] = replace(logs[i], payload=logs[j].payload)
            swapped[j] = replace(logs[j], payload=logs[i].payload)
            yield f"{log_name(logs, i)} and {log_name(logs, j)} carry each other's payload", rig, swapped


def _middle(log: Log, seconds: float) -> Log:
    middle = 0.5 * float(log.time[-1]) if len(log.time_ns) else 0.0
    rows = np.abs(log.time - middle) <= 0.5 * seconds
    return log if rows.all() else rows_of(log, rows)
