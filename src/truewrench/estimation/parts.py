"""Long records in parts, each with a spline, an offset, a delay and sizes of its own, then put together.

The parts share gain, bodies, gravity's tilt where the attitude is logged, and the kind of lateness, and are
independent beside them: what they say is added (together.py). Of a part nothing is kept but that and some of
its rows: an hour takes the memory of minutes. The parts also tell whether clocks run at different rates, and
judge what the others say.
"""

import os
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

from truewrench import _core
from truewrench.estimation.assumptions import Assumptions, statement
from truewrench.estimation.clock_rate import LEFT, TOLD, told_rate, with_rate
from truewrench.estimation.estimate import Clock, Estimate, LogRows, undisturbed
from truewrench.estimation.estimator import solved, unsolved
from truewrench.estimation.part import Found, Part, Place, events_of, part_of, told_by
from truewrench.estimation.record import recorded
from truewrench.estimation.together import Shared, Told
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of

_Result = TypeVar("_Result")

LONG_ROWS, LONG = 300_000, 600.0
"""Rows of all logs, and [s], from which on a record is taken part by part: 0.9 GB at once."""
PART = 100.0  # [s]: 0.1 GB at 1 kHz
SHOWN = 150_000  # rows of all logs that are kept
COMPARED = 30_000  # of a part that was held out
ROUNDS = 3  # times that clocks are set, and
SETTLED = 3  # that parts are looked at again, until
MOVE = 0.05  # of a sigma (RMS) is the way to where all of them together are
FEWEST = 4  # parts that tell a rate
ROOM, IN_HAND = 4_600_000, 10  # rows of the record, and ten times those of the parts in hand: 1 GB


def is_long(rig: Rig, logs: Sequence[Log]) -> bool:
    """Whether a record is to be taken part by part; joints known by velocities alone go on from one start."""
    if rig.motion.source == "joints" and any(log.position is None for log in logs):
        return False
    return sum(len(log.time_ns) for log in logs) > LONG_ROWS or _lasting(logs) > LONG


def _lasting(logs: Sequence[Log]) -> float:
    """Seconds from the first to the last stamp of all logs together."""
    return sum(float(log.time[-1]) for log in logs if len(log.time_ns))


class InParts:
    """The parts of some logs of motion, each estimated alone.

    So many threads are parts in hand at a time, 0: as many as there are processors and room for; no effect on
    the result. A part lasts about so many seconds. InputError: none has both motion and samples of the
    sensor.
    """

    def __init__(self, rig: Rig, logs: Sequence[Log], threads: int = 0, seconds: float | None = None) -> None:
        self._rig, self._assumed = rig, Assumptions.of(rig, logs)
        self._seconds = PART if seconds is None else seconds
        rows, lasting = sum(len(log.time_ns) for log in logs), _lasting(logs)
        room = (ROOM - rows) / (IN_HAND * rows * min(1.0, self._seconds / lasting)) if lasting > 0.0 else 1.0
        self._workers = min(threads or os.cpu_count() or 1, max(1, int(room)))
        self._statement = statement(self._assumed)
        self._every = max(1, -(-rows // SHOWN))
        self.logs, self._rates = list(logs), [0.0] * len(logs)  # with the rates of their clocks
        every = self._parts_of(range(len(logs)))
        told = every
        for _ in range(ROUNDS):
            rates = {k: rate for k, parts in told.items() if (rate := _rate(parts, self._rates[k])) != 0.0}
            before = {k: (self._rates[k], self.logs[k]) for k in rates}
            for k, rate in rates.items():
                self._rates[k] += rate
                self.logs[k] = replace(self.logs[k], clock_rate=self.logs[k].clock_rate + rate)
            told = self._parts_of(rates)
            for k in [k for k, parts in told.items() if not _deviance(parts) <= _deviance(every[k])]:
                self._rates[k], self.logs[k] = before[k]
                del told[k]
            every |= told
        self.parts = [part for parts in every.values() for part in parts]
        if not self.parts:  # as of the whole, so that it says what is missing
            recorded(rig, self._assumed, self.logs[0])
        self._told = self._settled()

    def unseen(self, part: Part) -> Log:
        """The middle of a part, what it left out apart, cut where its offset steps: to judge others by."""
        log, _ = self._cut(part.log, part.rows)
        left_out = np.flatnonzero(np.isin(self._origin(part.log, part.rows, log), part.masked))
        more = max(0, len(log.time_ns) - COMPARED)
        log = undisturbed(log, left_out, part.estimate.steps[0])
        log = replace(log, sha256="", nan_counts={}, dropped_rows=0)
        return rows_of(log, slice(more // 2, len(log.time_ns) - (more - more // 2)))

    def held_out(self, logs: Collection[int], share: float, most: int) -> list[int]:
        """Parts spread over some logs, to be held out: so large a share, and at most so many of each log."""
        out: list[int] = []
        for k in logs:
            of = [i for i, part in enumerate(self.parts) if part.log == k and part.follows]
            count = min(most, int(share * len(of)))
            out += [of[int((j + 0.5) * len(of) / count)] for j in range(count)]
        return out

    def estimate(self, without: Collection[int] = ()) -> Estimate:
        """Of all parts that their motion explains, some of them held out."""
        parts = [part for i, part in enumerate(self.parts) if i not in without]
        used = [part for part in parts if part.follows]
        count = len(self.logs)
        of = [[part for part in parts if part.log == k] for k in range(count)]
        lost = SimpleNamespace(
            unexplained=np.array([_unexplained(parts) for parts in of]),
            unresolved=np.array([_unresolved(parts) for parts in of]),
            dropped=np.array([sum(int(part.estimate.dropped.sum()) for part in parts) for parts in of]),
            fits=sum(part.estimate.fits for part in parts),
        )
        last = [next((part for part in reversed(used) if part.log == k), None) for k in range(count)]
        if any(part is None for part in last):
            return unsolved(self._rig, self.logs, lost)
        ends = [part for part in last if part is not None]
        shared = Shared([told for i, told in self._told.items() if i not in without])
        found = self._found([[part for part in used if part.log == k] for k in range(count)], ends, shared)
        halves, quarters = _places(used)
        found.halves = SimpleNamespace(p=shared.agreement(halves, 6 * self._rig.sensor.n))
        found.quarters = SimpleNamespace(p=shared.agreement(quarters, 6 * self._rig.sensor.n))
        found.logs = [
            SimpleNamespace(p=shared.agreement(np.array([p.log == k for p in used]), 6 * self._rig.sensor.n))
            for k in range(count)
        ]
        vars(found).update(vars(lost))
        rows = [_joined([part for part in parts if part.found is not None]) for parts in of]
        whole = solved(self._rig, self._assumed, self.logs, found, [part.record for part in ends], rows)
        return replace(
            whole,
            clocks=tuple(_clocks([p for p in used if p.log == k]) for k in range(count)),
            events=tuple(tuple(e for part in parts for e in events_of(part)) for parts in of),
            steps=tuple(
                tuple(
                    replace(s, time=s.time + p.begin) for p in used if p.log == k for s in p.estimate.steps[0]
                )
                for k in range(count)
            ),
        )

    def _found(self, of: Sequence[Sequence[Part]], ends: Sequence[Part], shared: Shared) -> SimpleNamespace:
        """What the core would have found of the whole."""
        theta, covariance, places = shared.with_own([self._told[self.parts.index(part)] for part in ends])
        every = [part.found for parts in of for part in parts if part.found is not None]
        n6 = 6 * self._rig.sensor.n
        of_channels = shared.weights(n6).reshape(len(every), -1, 6).mean(axis=2)
        weight = of_channels.mean(axis=1)
        weights = np.split(weight, np.cumsum([len(parts) for parts in of])[:-1])
        columns = [_columns_at(part, at) for part, at in zip(ends, places, strict=True)]
        of_logs = [
            _sizes([part.found for part in parts if part.found is not None], weight)
            for parts, weight in zip(of, weights, strict=True)
        ]
        ww = np.tensordot(weight, [found.ww for found in every], 1)
        A = float(weight @ [found.A for found in every])
        # a force that follows the pose does so in all of them: its errors add, and not their squares
        discrepancy2 = np.sum(of_channels * np.sqrt([found.discrepancy2 for found in every]), axis=0) ** 2
        added = (shared.covariance - shared.without_added)[:n6, :n6]
        gain = covariance[:n6, :n6] + added
        prior = np.zeros(len(theta))
        prior[:n6] = every[0].prior[:n6]
        stated = self._assumed.discrepancy
        if stated != 0.0:
            f2 = np.maximum(discrepancy2, stated**2) if stated > 0.0 else discrepancy2
            gain = _core.with_pose(gain, prior[:n6], _core.PoseShare(A, ww), f2)
        fit = SimpleNamespace(
            theta=theta,
            prior=prior,
            active={
                int(place[j])
                for part, place in zip(ends, places, strict=True)
                if part.found is not None
                for j in part.found.active
            },
            columns=columns.__getitem__,
            sizes=lambda k: of_logs[k][0],
            spacing=lambda k: float(np.median([part.estimate.spacing[0] for part in of[k]])),
            converged=all(found.converged for found in every),
            iterations=max(found.iterations for found in every),
            deviance=np.nan,
        )
        return SimpleNamespace(
            fit=fit,
            covariance=covariance,
            gain_covariance=gain,
            added=added,
            moments=[moments for _, moments in of_logs],
            discrepancy2=discrepancy2,
            pose=SimpleNamespace(A=A, ww=ww),
        )

    def _settled(self) -> dict[int, Told]:
        """What the parts say, by their place, all at the values of what they share that are best for all.

        Where each was where it alone is best, they would not agree on what is not told: of a gain and a
        centre of mass that make up for each other, each would leave another mixture open, and the sum none.
        """
        told = {i: told_by(part, self._rig) for i, part in enumerate(self.parts) if part.follows}
        at: Array | None = None
        for _ in range(SETTLED):
            if not told:
                break
            shared = Shared(list(told.values()))
            std = np.sqrt(np.diag(shared.covariance))
            of_all = np.unique(np.concatenate([shared.of_all(fit) for fit in told.values()]))
            if at is not None and np.sqrt(np.mean(((shared.mean - at) / std)[of_all] ** 2)) < MOVE:
                break
            at = shared.mean
            places = [shared.first_of(before) for before in told.values()]
            again = self._each(self._at, told, told.values(), places)
            told = dict(zip(told, again, strict=True))
        return told

    def _at(self, i: int, before: Told, place: Array) -> Told:
        """What a part says where what it shares is at this place; as before where nothing could be solved."""
        log, _ = self._cut(self.parts[i].log, self.parts[i].rows)
        fit = self.parts[i].fit
        assert fit is not None
        if not fit.settle(recorded(self._rig, self._assumed, log), place):
            return before
        return replace(before, theta=np.array(fit.theta), covariance=np.array(fit.covariance))

    def _parts_of(self, logs: Iterable[int]) -> dict[int, list[Part]]:
        """The parts of some logs, by log, in the order of time."""
        places = [(k, slice(a, b)) for k in logs for a, b in pairwise(self._bounds(k)) if a < b]
        found = self._each(self._part, [k for k, _ in places], [rows for _, rows in places])
        out: dict[int, list[Part]] = {k: [] for k in logs}
        for part in found:
            if part is not None:
                out[part.log].append(part)
        return out

    def _bounds(self, k: int) -> list[int]:
        log = self.logs[k]
        if not len(log.time_ns):
            return []
        count = max(1, round(float(log.time[-1]) / self._seconds))
        edges = np.searchsorted(log.time, np.linspace(0.0, float(log.time[-1]), count + 1)[1:-1])
        return [0, *edges.tolist(), len(log.time_ns)]

    def _part(self, k: int, rows: slice) -> Part | None:
        cut, begin = self._cut(k, rows)
        place = Place(k, begin, rows, self._origin(k, rows, cut))
        settings = _core.Settings()
        settings.threads, settings.discrepancy = 1, self._assumed.discrepancy
        return part_of(self._rig, self._assumed, self._statement, settings, cut, place, self._every)

    def _each(self, work: Callable[..., _Result], *items: Iterable[Any]) -> list[_Result]:
        """As `map`, some at a time."""
        if self._workers == 1:  # a thread of its own has memory of its own
            return list(map(work, *items))
        with ThreadPoolExecutor(self._workers) as pool:
            return list(pool.map(work, *items))

    def _cut(self, k: int, rows: slice) -> tuple[Log, float]:
        """Some rows of a log on one clock, and when they begin [s]."""
        log = self.logs[k]
        part = rows_of(log, rows)
        if self._rates[k] != 0.0 and np.isfinite(part.raw).any():
            part = with_rate(part, self._rates[k], 0.5 * float(log.time_ns[0] + log.time_ns[-1]))
        return part, float((part.time_ns[0] - log.time_ns[0]) * 1e-9)

    def _origin(self, k: int, rows: slice, part: Log) -> Integers:
        """Which row of the log each row of its part is of, for those with a sample of the sensor."""
        out = np.full(len(part.time_ns), -1, np.int64)
        sensed = np.isfinite(self.logs[k].raw[rows]).any(axis=1)
        out[np.isfinite(part.raw).any(axis=1)] = rows.start + np.flatnonzero(sensed)
        return out


def _joined(parts: Sequence[Part]) -> LogRows:
    rows = [part.estimate.rows[0] for part in parts]
    begins = np.cumsum([0, *(int(r.stretch.max(initial=-1)) + 1 for r in rows)])
    left_out = sum(r.left_out if part.follows else r.samples for r, part in zip(rows, parts, strict=True))
    names = ("rows", "time", "masked", "residual", "discrepancy", "wrench", "twist", "acceleration")
    return LogRows(
        **{name: np.concatenate([getattr(r, name) for r in rows]) for name in names},
        stretch=np.concatenate([r.stretch + b for r, b in zip(rows, begins[:-1], strict=True)]),
        every=rows[0].every,
        whole=(sum(r.samples for r in rows), left_out),
    )


def _deviance(parts: Sequence[Part]) -> float:
    return sum(part.estimate.deviance for part in parts)


def _unexplained(parts: Sequence[Part]) -> float:
    """Of the raw output of a log: of the parts left out, where they are too many."""
    lost, kept = ([p for p in parts if p.follows == way] for way in (False, True))
    share = sum(p.samples for p in lost) / max(sum(p.samples for p in parts), 1)
    of = lost if share > _core.MOST_LOST or not kept else kept
    return float(np.mean([p.estimate.unexplained[0] for p in of])) if of else 0.0


def _unresolved(parts: Sequence[Part]) -> bool:
    lost = sum(p.samples for p in parts if p.estimate.unresolved.any())
    return lost > _core.MOST_LOST * sum(p.samples for p in parts)


def _places(parts: Sequence[Part]) -> tuple[Mask, Mask]:
    """Whether each part lies in the first half of its log; and in its first or third quarter."""
    end = [max(p.end for p in parts if p.log == part.log) for part in parts]
    middle = np.array([0.5 * (p.begin + p.end) / max(e, 1e-9) for p, e in zip(parts, end, strict=True)])
    return middle < 0.5, (4.0 * middle).astype(int) % 2 == 0


def _columns_at(part: Part, place: Integers) -> SimpleNamespace:
    """Where the parameters of a log stand in theta of all."""
    assert part.found is not None
    columns = part.found.columns
    names = ("C", "b", "u", "slope", "tilt", "roots", "gamma", "clock", "bias", "steps", "step_times")
    return SimpleNamespace(
        **{name: getattr(columns, name) for name in names},
        body_in_theta=int(place[columns.body_in_theta]),
        at=place[np.array(columns.at)].tolist(),
    )


def _sizes(parts: Sequence[Found], weight: Array) -> tuple[SimpleNamespace, list[SimpleNamespace]]:
    """Sizes and moments of a log: means of its parts, of a slow disturbance of those in which it is alike.

    The weight is how much the gain rests on each.
    """
    weight = weight / weight.sum()

    def rms(values: Sequence[Array], stream: int = 0) -> Array:
        has = [len(part.sizes.motion_factor) > stream for part in parts]
        return np.asarray(np.sqrt(np.average(np.square(values), axis=0, weights=weight[has])))

    forms = {part.sizes.form: 0.0 for part in parts}
    for part, w in zip(parts, weight, strict=True):
        forms[part.sizes.form] += w
    form = max(forms, key=lambda f: forms[f])
    alike = [part.sizes for part in parts if part.sizes.form == form]
    sizes = SimpleNamespace(
        raw_factor=rms([part.sizes.raw_factor for part in parts]),
        motion_factor=[
            rms([part.sizes.motion_factor[i] for part in parts if len(part.sizes.motion_factor) > i], i)
            for i in range(len(parts[-1].sizes.motion_factor))
        ],
        form=form,
        delta=np.sqrt(np.mean([np.square(x.delta) for x in alike], axis=0)),
        k=float(np.mean([x.k for x in alike])),
        cap=np.mean([x.cap for x in alike], axis=0),
    )
    moments = [
        SimpleNamespace(
            tau=float(weight @ [m.tau for m in of]),
            delta2=float(weight @ [m.delta2 for m in of]),
            sd=float(np.sqrt(weight**2 @ [m.sd**2 for m in of])),
            z=float(weight @ [m.z for m in of] / np.sqrt(weight @ weight)),
        )
        for of in zip(*(part.moments for part in parts), strict=True)
    ]
    return sizes, moments


def _clocks(parts: Sequence[Part]) -> tuple[Clock, ...]:
    """How late the sensor is: of each stream the mean of the parts that have it, 1 sigma as they scatter."""
    out = []
    every = [part.estimate.clocks[0] for part in parts]
    for i in range(len(every[-1])):
        of = [clocks[i] for clocks in every if len(clocks) > i]
        late, std = np.array([c.late for c in of]), np.array([c.std for c in of])
        if not (std > 0.0).all():
            out.append(of[-1])
            continue
        weight = std**-2.0 / np.sum(std**-2.0)
        mean = float(weight @ late)
        scatter = np.sum(((late - mean) / std) ** 2) / max(len(of) - 1, 1)
        sigma = float(np.sqrt(max(scatter, 1.0) / np.sum(std**-2.0)))
        out.append(replace(of[-1], late=mean, std=sigma))
    return tuple(out)


def _rate(parts: Sequence[Part], before: float) -> float:
    """How much faster than the motion's the sensor's clock still runs; 0 where none is told."""
    of = [part for part in parts if part.follows and part.estimate.clocks[0]]
    if len(of) < FEWEST:
        return 0.0
    clocks = [part.estimate.clocks[0][0] for part in of]
    late, std = np.array([c.late for c in clocks]), np.array([c.std for c in clocks])
    if not (std > 0.0).all():
        return 0.0
    middle = np.array([0.5 * (part.begin + part.end) for part in of])
    return told_rate(middle, late, std**-2.0, TOLD if before == 0.0 else LEFT)
