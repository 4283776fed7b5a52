"""The estimate as samples arrive (METHOD 10.6), in the terms of the one that looks at the whole record."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from truewrench import _core
from truewrench.model.arrays import Array, Integers


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """The gain whenever it changed: time (B,) [s of its log], log (B,), gain (B, n, 6) normalised."""

    time: Array
    log: Integers
    gain: Array


@dataclass(frozen=True, slots=True, eq=False)
class OnlineFound:
    """What the core's `Estimate` holds, of an estimate that looked at every sample once.

    `fit` stands at the final parameters, its motion that of the velocities alone: what left the lag was not
    revisited, and its motion not kept. Offsets and clocks of logs before the last are as uncertain as when
    these logs ended.
    """

    fit: Any
    status: Any
    covariance: Array
    added: Array
    gain_covariance: Array
    discrepancy2: Array
    moments: Sequence[Any]
    pose: Any
    halves: Any
    quarters: Any
    logs: Sequence[Any]  # each against those before it
    unexplained: Sequence[float]
    unresolved: Sequence[bool]
    dropped: Sequence[int]
    history: History
    fits: int = 1


def _at_clocks(record: Any, clocks: Array) -> Any:
    """A record whose clocks are expected where they were found: by these its velocities tell the motion."""
    out, streams = copy(record), record.motion
    for stream, s in zip(streams, clocks, strict=True):
        stream.clock_mean = float(s)
    out.motion = streams
    return out


def found_online(statement: Any, records: Sequence[Any], discrepancy: float) -> OnlineFound:
    """Run the core's logs, of twists or an IMU, through it in the order of time.

    The discrepancy is as stated; -1 for auto.
    """
    settings = _core.IncrementalSettings()
    settings.discrepancy = discrepancy
    found = _core.estimate_online(statement, list(records), settings)
    n = len(statement.noise)
    if found.status != _core.Status.ok or not len(found.own):
        nothing = History(np.zeros(0), np.zeros(0, np.int64), np.zeros((0, n, 6)))
        none = np.zeros((0, 0))
        status = found.status if found.status != _core.Status.ok else _core.Status.wrong_size
        return OnlineFound(
            None, status, none, none, none, none, (), found.pose, found.halves, found.quarters, (),
            [0.0] * len(records), found.unresolved, found.dropped, nothing,
        )  # fmt: skip
    at = [np.array(c.at) for c in found.columns]
    late = [np.asarray(own)[k[c.clock]] for own, k, c in zip(found.own, at, found.columns, strict=True)]
    moved = [_at_clocks(record, s) for record, s in zip(records, late, strict=True)]
    fit = _core.fit_of_sizes(statement, moved, list(found.spacing), list(found.sizes))
    theta = np.array(fit.theta)
    ends = []  # where in theta each log's parameters stand, but for the root frames before its last
    for k, (own, c) in enumerate(zip(found.own, found.columns, strict=True)):
        places = np.array(fit.columns(k).at)
        theta[places] = np.insert(np.asarray(own)[at[k]], max(c.tilt, 0), found.tilts[k])
        ends.append(np.delete(places, max(c.tilt, 0) + np.arange(len(found.tilts[k]))))
    # C, u and all payloads come first in either theta; of the rest the last log has told what it has
    shared = 7 * n + 10 * len(statement.body_prior)
    here, there = (np.r_[:shared, places[places >= shared]] for places in (ends[-1], at[-1]))
    theta[here] = np.asarray(found.theta)[there]
    fit.theta = theta
    fit.lagged = theta[: 6 * n].reshape(n, 6)
    fit.predict()
    for k, masked in enumerate(found.masked):
        fit.set_mask(k, masked)
    covariance = np.diag(np.asarray(fit.stated))
    for places, own, P in zip(ends, at, found.covariance, strict=True):
        alone = ~np.isin(places, here)  # what such a log left with the others is in theirs
        covariance[np.ix_(places[alone], places[alone])] = np.asarray(P)[np.ix_(own[alone], own[alone])]
    covariance[np.ix_(here, here)] = np.asarray(found.covariance[-1])[np.ix_(there, there)]
    counts = [len(time) for time in found.history_time]
    return OnlineFound(
        fit=fit,
        status=_core.Status.not_factorizable if fit.failed else found.status,
        covariance=covariance,
        added=np.asarray(found.added),
        gain_covariance=np.asarray(found.gain_covariance),
        discrepancy2=np.asarray(found.discrepancy2),
        moments=found.moments,
        pose=found.pose,
        halves=found.halves,
        quarters=found.quarters,
        logs=found.logs,
        unexplained=[0.0] * len(records),
        unresolved=found.unresolved,
        dropped=found.dropped,
        history=History(
            np.concatenate(found.history_time),
            np.repeat(np.arange(len(counts)), counts),
            np.concatenate([np.asarray(g).reshape(-1, n, 6) for g in found.history_gain]),
        ),
    )
