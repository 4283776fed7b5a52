"""Whether logs of known wrenches, and halves of them, tell one gain (METHOD 10.7): each part by itself.

Its errors are as they were found of all.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truewrench.estimation.assumptions import assumed_gain_prior
from truewrench.estimation.known_wrench import KnownWrenchEstimate, estimate_from_known_wrench
from truewrench.estimation.reference_clock import ReferenceClock
from truewrench.estimation.together import Shared, Told
from truewrench.model.arrays import Array, Integers
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of

FEWEST = 16  # rows of a log that are compared by halves


def agreement_of_known_wrenches(
    rig: Rig, logs: Sequence[Log], found: KnownWrenchEstimate, clocks: Sequence[ReferenceClock | None]
) -> Array:
    """(L,) how likely chance makes each log depart as far from the others (10.11); 1 of a single one."""
    if len(logs) < 2:
        return np.ones(1)
    alone = [_alone(rig, log, k, found, clocks[k]) for k, log in enumerate(logs)]
    shared = Shared([_told(rig, one) for one in alone])
    gains = 6 * rig.sensor.n
    return np.array([shared.agreement(np.arange(len(logs)) == k, gains) for k in range(len(logs))])


def agreement_of_known_halves(
    rig: Rig, logs: Sequence[Log], found: KnownWrenchEstimate, clocks: Sequence[ReferenceClock | None]
) -> Array:
    """(L,) the same of the first and the second half of each log, an offset each; 1: of few rows."""
    p = np.ones(len(logs))
    for k, log in enumerate(logs):
        rows = found.rows[k]
        if rows.size < FEWEST:
            continue
        cut = _between(log, rows, np.array(rig.reference_noise))
        parts = [np.isin(np.arange(log.time.size), half) for half in (rows[:cut], rows[cut:])]
        clock = clocks[k]
        halves = [
            _alone(rig, rows_of(log, part), k, found, clock and replace(clock, moved=clock.moved[part]))
            for part in parts
        ]
        kinds = [{kind.stepped for kind in one.errors} for one in halves]
        if all(kind == {one.stepped for one in found.errors if k in one.logs} for kind in kinds):
            told = [_told(rig, half) for half in halves]  # by the sizes of its kind
            p[k] = Shared(told).agreement(np.array([True, False]), 6 * rig.sensor.n)
    return p


def _between(log: Log, rows: Integers, noise: Array) -> int:
    """Where the second half of rows begins: near the middle where the reference steps most, in no plateau."""
    assert log.reference is not None
    near = np.arange(2 * rows.size // 5, 3 * rows.size // 5)
    step = np.abs(np.diff(log.reference[rows], axis=0)[near - 1])
    return int(near[np.argmax((step / np.maximum(noise, np.finfo(np.float64).tiny)).max(axis=1))])


def _alone(
    rig: Rig, log: Log, k: int, of_all: KnownWrenchEstimate, clock: ReferenceClock | None
) -> KnownWrenchEstimate:
    """From a log, the k-th of all or a part of it, by itself."""
    errors = [replace(kind, logs=(0,)) for kind in of_all.errors if k in kind.logs]
    return estimate_from_known_wrench(rig, [log], errors, [clock])


def _told(rig: Rig, found: KnownWrenchEstimate) -> Told:
    sensor = rig.sensor
    gains = 6 * sensor.n
    unit = 1.0 / sensor.gain_unit
    return Told(
        keys={j: j for j in range(gains)},
        first=gains,
        u=slice(0, 0),
        theta=(found.gain * unit).ravel(),
        mean=(sensor.nominal_gain_array * unit).ravel(),
        prior=np.full(gains, assumed_gain_prior(rig) ** 2),
        covariance=found.normalised_covariance[:gains, :gains],
        added=np.zeros((gains, gains)),
    )
