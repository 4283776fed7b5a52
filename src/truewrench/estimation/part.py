"""One part of a long record: its estimate, what it says of what it shares, and a few of its rows."""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from truewrench import _core
from truewrench.estimation.assumptions import Assumptions
from truewrench.estimation.estimate import Estimate, Event, LogRows
from truewrench.estimation.estimator import solved, unsolved
from truewrench.estimation.record import recorded
from truewrench.estimation.together import Told
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What the core found of one log, as copies that do not keep its fit."""

    columns: _core.Columns
    theta: Array
    mean: Array
    prior: Array
    active: frozenset[int]
    covariance: Array
    added: Array
    discrepancy2: Array
    A: float
    ww: Array
    sizes: SimpleNamespace
    moments: list[SimpleNamespace]
    converged: bool
    iterations: int


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a part lies."""

    log: int  # which it is of
    begin: float  # its first stamp [s] from that of the log
    rows: slice  # of the log
    origin: Integers  # which row of the log each of its own is of, -1 without a sample of the sensor


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What one part says."""

    log: int  # which it is of
    begin: float  # its first stamp [s] from that of the log
    end: float  # its last one
    rows: slice  # of the log
    masked: Integers  # samples of the sensor that were left out, rows of the log
    found: Found | None  # by the core, without the fit; None where nothing could be solved
    fit: _core.Part | None  # put away; likewise
    estimate: Estimate  # the same in SI units
    record: SimpleNamespace  # its streams' names and sizes

    @property
    def samples(self) -> int:
        """Of the sensor that were fitted."""
        return self.estimate.rows[0].samples

    @property
    def follows(self) -> bool:
        """Whether the motion explains it and the samples resolve it."""
        return self.found is not None and self.estimate.follows


def part_of(
    rig: Rig,
    assumed: Assumptions,
    statement: _core.Statement,
    settings: _core.Settings,
    log: Log,
    place: Place,
    every: int,
) -> Part | None:
    """The estimate of a part, the log alone; None where it holds no motion, or nothing of the sensor.

    One of `every` so many rows is kept.
    """
    try:
        record = recorded(rig, assumed, log)
    except InputError:
        return None
    found = _core.estimate(statement, [record], settings)
    ok = found.status == _core.Status.ok
    if not ok:
        estimate = unsolved(rig, [log], found)
    else:
        estimate = solved(rig, assumed, [log], found, [record])
        if np.max(found.fit.sizes(0).raw_factor) > _core.NOISE_TOLD:
            unexplained = max(float(estimate.unexplained[0]), _noise_share(estimate, assumed))
            estimate = replace(estimate, unexplained=np.array([unexplained]))
    held = estimate.rows[0]
    origin = place.origin[held.rows]
    streams = [  # of the times, whether there is more than one: a copy, or the whole record would be kept
        SimpleNamespace(
            derivative=m.derivative,
            half_window=m.half_window,
            time=np.array(m.time[:2]),
        )
        for m in record.motion
    ]
    return Part(
        place.log,
        place.begin,
        place.begin + float(log.time[-1]),
        place.rows,
        origin[held.masked],
        _without_fit(found) if ok else None,
        _core.put_away(found) if ok else None,
        replace(estimate, rows=(_some(held, origin, place.begin, every),)),
        SimpleNamespace(source=record.source, half_window=record.half_window, motion=streams),
    )


def _without_fit(found: Any) -> Found:
    fit = found.fit
    sizes = fit.sizes(0)
    return Found(
        columns=fit.columns(0),
        theta=np.array(fit.theta),
        mean=np.array(fit.mean),
        prior=np.array(fit.prior),
        active=frozenset(fit.active),
        covariance=np.array(found.covariance),
        added=np.array(found.added),
        discrepancy2=np.array(found.discrepancy2),
        A=float(found.pose.A),
        ww=np.array(found.pose.ww),
        sizes=SimpleNamespace(
            raw_factor=np.array(sizes.raw_factor),
            motion_factor=[np.array(x) for x in sizes.motion_factor],
            form=sizes.form,
            delta=np.array(sizes.delta),
            k=float(sizes.k),
            cap=np.array(sizes.cap),
        ),
        moments=[SimpleNamespace(tau=m.tau, delta2=m.delta2, sd=m.sd, z=m.z) for m in found.moments[0]],
        converged=bool(fit.converged),
        iterations=int(fit.iterations),
    )


def _some(held: LogRows, origin: Integers, begin: float, every: int) -> LogRows:
    """One of so many rows, and the ends of every stretch, in rows and seconds of the whole log."""
    edge = np.diff(held.stretch, prepend=-1, append=-1) != 0
    at = np.flatnonzero((np.arange(held.rows.size) % every == 0) | edge[:-1] | edge[1:])
    return LogRows(
        rows=origin[at],
        time=held.time[at] + begin,
        masked=held.masked[at],
        residual=held.residual[at],
        discrepancy=held.discrepancy[at],
        wrench=held.wrench[at],
        twist=held.twist[at],
        acceleration=held.acceleration[at],
        stretch=held.stretch[at],
        every=every,
        whole=(held.samples, held.left_out),
    )


def _noise_share(part: Estimate, assumed: Assumptions) -> float:
    """Share of the raw output that is noise, of the best channel: of an unplugged sensor, all."""
    rows = part.rows[0]
    used = ~rows.masked & np.isfinite(rows.residual).all(axis=1)
    if not used.any():
        return 1.0
    left = (rows.residual + rows.discrepancy)[used].var(axis=0)
    felt = (rows.wrench[used] @ part.gain.T / assumed.channel_scale).var(axis=0)
    return float(np.min(left / (left + felt)))


def told_by(part: Part, rig: Rig) -> Told:
    """What a part says, and of it what it shares with others: of its log, or of all."""
    assert part.found is not None
    columns = part.found.columns
    at = np.array(columns.at)
    first = int(at[columns.b]) + (rig.sensor.n if rig.sensor.pool_offsets else 0)
    keys: dict[int, Hashable] = {j: j for j in range(first)}  # but for those that some logs lack
    for name, place in (("slope", columns.slope), ("tilt", columns.tilt), ("b", columns.b)):
        begin = int(at[place]) if place >= 0 else first
        keys |= {j: (name, j - begin) for j in range(begin, first)}
    # attitudes of parts begin anew as those of logs do
    own = at[columns.tilt : columns.tilt + 2 * len(columns.roots)]
    keys = {j: key for j, key in keys.items() if j not in own}
    keys |= {int(at[place + 1]): ("kappa", part.log, i) for i, place in enumerate(columns.clock)}
    if columns.gamma >= 0:
        keys[int(at[columns.gamma])] = ("gamma", part.log)
    u = slice(int(at[columns.u]), int(at[columns.u]) + rig.sensor.n)
    found = part.found
    return Told(keys, first, u, found.theta, found.mean, found.prior, found.covariance, found.added)


def events_of(part: Part) -> list[Event]:
    """What a part left out; all of it where its motion does not explain it."""
    if part.follows:
        return [
            replace(e, begin=e.begin + part.begin, end=e.end + part.begin) for e in part.estimate.events[0]
        ]
    if part.found is None:
        return []
    size = np.nanmax(np.abs(np.nan_to_num(part.estimate.rows[0].residual)), axis=0, initial=0.0)
    return [Event(part.begin, part.end, part.samples, True, size)]
