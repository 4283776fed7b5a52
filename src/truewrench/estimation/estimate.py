"""What the estimator of one spline and one likelihood found: numbers and findings, no judgement."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truewrench import _core
from truewrench.estimation.joint import Joint, body_part
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.log import Log, log_name
from truewrench.model.rig import PayloadSpec, Rig

AGREE = 0.5 * _core.DOUBT  # p of each of the two comparisons of (10.11), from which on parts agree


@dataclass(frozen=True, slots=True)
class PayloadDeparture:
    """What the data say of a payload, as departures from what was stated."""

    # (10,) mass, relative; centre of mass [m]; xx yy zz xy xz yz of the inertia, relative to sqrt(I_ii I_jj)
    mean: Array
    covariance: Array  # (10, 10)
    with_gain: Array  # (10, 6n) covariance with the gain row by row, SI and raw units

    @property
    def std(self) -> Array:
        """(10,) 1 sigma."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, slots=True)
class Clock:
    """How late the sensor is against a motion stream, and what kind of lateness it is (10.1, 10.4, 10.5)."""

    stream: str  # `twist`, `positions`, `velocities`, `rate of turn`, `specific force` or `accelerations`
    late: float  # s = -time_offset [s]
    std: float  # 1 sigma of it
    stated: float  # 1 sigma that the rig states
    # 1/2 for a clock, 0 for a filtered sensor, 1 for filtered velocities; None where it was held
    kappa: float | None = None
    kappa_std: float | None = None  # its 1 sigma, None where it was held
    gamma: float | None = None  # 1 where gravity is late, too; None where it was held or does not act
    gamma_std: float | None = None  # its 1 sigma
    undone: float = 0.0  # how much later the sensor was than `late` before filters were undone [s]
    set_back: float = 0.0  # the same of a clock that was set before the estimate [s]
    half_window: float = 0.0  # r of (10.4): of what samples of sensor and stream are means of [s]

    @property
    def as_logged(self) -> float:
        """How late the sensor was [s]."""
        return self.late + self.undone + self.set_back


@dataclass(frozen=True, slots=True)
class FoundNoise:
    """Noise found, as a factor on the stated one."""

    what: str  # `force`, `moment`, `channels`, or a motion stream and its part (`velocities v`, `positions`)
    factor: float  # found over what filters have left of the stated
    left: float = 1.0  # that, of the stated

    @property
    def of_sample(self) -> float:
        """The scatter of a sample as it is read, over the stated."""
        return self.factor * self.left


@dataclass(frozen=True, slots=True)
class Slow:
    """A slow disturbance of one group of channels: (10.2) where it is in the fit, else (10.9)."""

    what: str  # `force`, `moment` or `channels`
    size: float  # 1 sigma, fraction of range
    size_std: float | None  # of the size, by moments; None where d is in the fit
    tau: float  # correlation time [s]
    z: float  # standard normal deviate of its moment
    form: str  # `none` (it stayed out of the fit), `matern` or `walk` (size: over the length of the stretch)
    capped: bool = False  # the size ended at three sigma of a sample: as large as it may be


@dataclass(frozen=True, slots=True)
class Event:
    """Consecutive samples of the sensor that were left out."""

    begin: float  # [s] from the log's first stamp
    end: float  # [s]
    samples: int  # how many
    lasting: bool  # 30 ms or more: a contact; else outliers
    size: Array  # (n,) largest departure of each channel from the model, fraction of range


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the offset."""

    time: float  # [s] from the log's first stamp
    size: Array  # (n,) fraction of range
    std: Array  # (n,) 1 sigma


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """How far gravity is off its stated direction in one root frame."""

    logs: tuple[int, ...]  # numbers of those that have this root frame
    angles: Array  # (2,) about two of its axes [rad]
    std: Array  # (2,) 1 sigma


@dataclass(frozen=True, slots=True, eq=False)
class LogRows:
    """The sensor's samples of one log that the fit holds, and what it says at them; of a long log some."""

    rows: Integers  # (K,) of the log
    time: Array  # (K,) [s] from the log's first stamp
    masked: Mask  # (K,) left out
    # (K, n) raw less the model, the discrepancy taken out, fraction of range; NaN where missing
    residual: Array
    discrepancy: Array  # (K, n) d of (10.2), fraction of range; 0 where it stayed out
    wrench: Array  # (K, 6) of the payload, SI, with the rig's sign
    twist: Array  # (K, 6) of the logged point (joints: of the sensor)
    acceleration: Array  # (K, 6) its component-wise derivative
    stretch: Integers  # (K,) which gap-free stretch each belongs to
    every: int = 1  # one of so many samples is here
    # how many the fit holds, and how many of them are masked, where these are some of them
    whole: tuple[int, int] | None = None

    @property
    def samples(self) -> int:
        """How many the fit holds."""
        return self.masked.size if self.whole is None else self.whole[0]

    @property
    def left_out(self) -> int:
        """How many of them are masked."""
        return int(self.masked.sum()) if self.whole is None else self.whole[1]


def no_rows(n: int) -> LogRows:
    """Of a log of n channels that holds no motion."""
    none = np.zeros(0, np.int64)
    empty = np.zeros((0, 6))
    left = np.zeros((0, n))
    return LogRows(none, np.zeros(0), np.zeros(0, bool), left, left, empty, empty, empty, none)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Gain, offsets and all that was estimated with them.

    "Normalised": gain_ij range_j / R_i and offset_i / R_i, R_i = |nominal_i| @ range.
    """

    solved: bool  # whether the record could be solved at all; where not, everything else is the prior
    gain: Array  # (n, 6), SI and raw units
    # (7n, 7n) of [gain row by row, offset of the last log at its end], (10.9), (10.10) within
    covariance: Array
    normalised_covariance: Array  # the same, normalised
    before_pose: Array  # (6n, 6n) normalised covariance of the gain before (10.10)
    gain_prior: Array  # (6n,) 1 sigma beforehand, normalised
    offsets: Array  # (L, n) raw units, at the end of each log
    offsets_std: Array  # (L, n)
    clocks: tuple[tuple[Clock, ...], ...]  # per log, of each motion stream
    payloads: dict[str, PayloadDeparture]  # by name
    # of gravity, one of each root frame: of the one that logs share, and of those that a log whose attitude
    # is not logged has alone, in its last part or after its last gap; none without gravity
    tilts: tuple[Tilt, ...]
    offset_temperature: Array | None  # (n,) raw units per K, None without a slope
    quadratic: Array  # (n,) u of (10.3), fraction of range; quadratic_std likewise
    quadratic_std: Array  # its 1 sigma
    discrepancy: Array  # (n,) 1 sigma of what (10.10) takes to follow the pose, fraction of range
    noise: tuple[tuple[FoundNoise, ...], ...]  # per log
    slow: tuple[tuple[Slow, ...], ...]  # per log, of each group of channels
    events: tuple[tuple[Event, ...], ...]  # per log
    steps: tuple[tuple[Step, ...], ...]  # per log
    spacing: Array  # (L,) h [s]
    unexplained: Array  # (L,) share of the raw output that no motion explains; 0 where its noise is as stated
    unresolved: Mask  # (L,) (10.7) still falls at one knot per sample
    dropped: Integers  # (L,) stretches that were too short
    rows: tuple[LogRows, ...]  # per log
    # 1 sigma (n, 6) of the normalised gain that each source accounts for: `noise` (with priors), `mass`,
    # `center_of_mass`, `inertia`, `timing`, `gravity`, `slow` (10.9), `pose` (10.10)
    sources: dict[str, Array]
    A: float  # of (10.10)
    ww: Array  # (6, 6) E w w^T, fractions of range
    p_halves: float  # of (10.11)
    p_quarters: float  # of (10.11)
    p_logs: Array  # (L,) of (10.11): each log against the others, of `online` those before; 1: not asked
    converged: bool  # whether the last fit did
    iterations: int  # of it
    fits: int  # how many were made
    history_time: Array  # (B,) [s] of the blocks of `online`; empty for `map`
    history_log: Integers  # (B,) which log each belongs to
    history_gain: Array  # (B, n, 6) the gain after it
    # `gain`, `tilt K` of each root frame by the first log that has it, of each payload that is not exact its
    # `body_part` and the departure of its inertia, `inertia NAME` [kg m^2], `offset K` of each log, and
    # `slope` where the offset has one, together; None where nothing moved
    joint: Joint | None = None
    notes: tuple[str, ...] = ()  # what of the logs was not read
    # (n, 8n) covariance of `offset_temperature` with [gain row by row, offset of the last log, itself]; None
    # without a slope
    slope_covariance: Array | None = None
    deviance: float = math.nan  # -2 log L of `map` (10.7), nan of `online` and of parts

    @property
    def follows(self) -> bool:
        """Whether the motion explains the record, and its samples resolve the motion."""
        return not (self.unresolved.any() or (self.unexplained > _core.MOST_LOST).any())

    @property
    def parts_agree(self) -> bool:
        """By (10.11)."""
        return all(p >= AGREE for p in (self.p_halves, self.p_quarters, self.p_worst_log))

    @property
    def p_worst_log(self) -> float:
        """Of (10.11)."""
        return worst_of_logs(self.p_logs)

    @property
    def time_offsets(self) -> Array:
        """(L,) t_motion = t_sensor + time_offset [s], as logged, of the first motion stream."""
        return np.array([-clocks[0].as_logged if clocks else 0.0 for clocks in self.clocks])

    @property
    def time_offsets_std(self) -> Array:
        """(L,) 1 sigma [s]."""
        return np.array([clocks[0].std if clocks else 0.0 for clocks in self.clocks])

    def masked_share(self) -> float:
        """Share of the sensor's samples that were left out."""
        return float(sum(r.left_out for r in self.rows)) / max(sum(r.samples for r in self.rows), 1)


def worst_of_logs(p_logs: Array) -> float:
    """Of (10.11), each log against the others (L,): what two say of each other is one test."""
    return float(np.minimum(1.0, max(len(p_logs) - 1, 1) * p_logs.min()))


def worst_of_halves(p_halves: Array) -> float:
    """Of (10.11), the halves of each log against each other (L,): as many tests as logs."""
    return float(np.minimum(1.0, len(p_halves) * p_halves.min()))


def odd_log(p_logs: Array, logs: Sequence[Log]) -> str:
    """Which log stands out, by how likely each is to differ as much by chance (L,)."""
    if len(p_logs) < 3:
        return "one log and the other"
    least = p_logs[np.argmin(p_logs)]
    odd = np.flatnonzero(np.isclose(p_logs, least, rtol=1e-3, atol=0.0, equal_nan=True)).tolist()
    # two that move, beside static poses, differ from each other alike
    names = [log_name(logs, k) for k in odd] if len(odd) == 2 else [log_name(logs, odd[0]), "the others"]
    return " and ".join(names)


def undisturbed(log: Log, left_out: Integers, steps: Sequence[Step]) -> Log:
    """A log without the rows that were left out, cut where its offset steps."""
    raw = log.raw.copy()
    raw[left_out] = np.nan
    jumps = tuple(int(log.time_ns[0] + round(1e9 * step.time)) for step in steps)
    return replace(log, raw=raw, offset_jumps_ns=jumps)


def without_motion(n: int, count: int, **found: Any) -> Estimate:
    """An estimate of `count` logs in which nothing of a motion is: no rows, clocks, sizes or events.

    All that was found all the same comes by attribute.
    """
    nothing: dict[str, Any] = {
        "clocks": ((),) * count,
        "payloads": {},
        "tilts": (),
        "offset_temperature": None,
        "quadratic": np.zeros(n),
        "quadratic_std": np.zeros(n),
        "discrepancy": np.zeros(n),
        "noise": ((),) * count,
        "slow": ((),) * count,
        "events": ((),) * count,
        "steps": ((),) * count,
        "spacing": np.full(count, np.nan),
        "unexplained": np.zeros(count),
        "unresolved": np.zeros(count, dtype=bool),
        "dropped": np.zeros(count, dtype=np.int64),
        "rows": (no_rows(n),) * count,
        "sources": {},
        "A": 0.0,
        "ww": np.zeros((6, 6)),
        "p_halves": 1.0,
        "p_quarters": 1.0,
        "p_logs": np.ones(count),
        "history_time": np.zeros(0),
        "history_log": np.zeros(0, np.int64),
        "history_gain": np.zeros((0, n, 6)),
    }
    return Estimate(**(nothing | found))


def of_joint(
    rig: Rig, joint: Joint, offsets: Sequence[str], roots: Mapping[str, Sequence[int]]
) -> dict[str, Any]:
    """What an estimate has of a joint distribution, by attribute.

    That has `gain`, the parts `offsets` that hold the offset of each log, and those of gravity's tilt:
    `roots` names them, with the logs that have the root frame of each.
    """
    n, scale = rig.sensor.n, rig.sensor.channel_scale
    units = np.append(rig.sensor.gain_unit.ravel(), scale)
    pairs = [joint.of([name]) for name in offsets]
    mean, P = joint.of(["gain", offsets[-1]])
    normalised = P / np.outer(units, units)
    return {
        "gain": mean[: 6 * n].reshape(n, 6),
        "covariance": P,
        "slope_covariance": slope_covariance(joint, offsets[-1]),
        "normalised_covariance": normalised,
        "before_pose": normalised[: 6 * n, : 6 * n],
        "offsets": np.array([offset for offset, _ in pairs]),
        "offsets_std": np.sqrt([np.diag(variance) for _, variance in pairs]),
        "payloads": {
            name: payload_departure(spec, joint, name)
            for name, spec in rig.payloads.items()
            if body_part(name) in joint.places and not spec.exact
        },
        "tilts": tuple(
            Tilt(tuple(logs), joint.of([part])[0], np.sqrt(np.diag(joint.of([part])[1])))
            for part, logs in roots.items()
        ),
    }


def slope_covariance(joint: Joint, offset: str) -> Array | None:
    """Of the slope with gain, an offset and itself, (n, 8n); None where the offset has none."""
    if "slope" not in joint.places:
        return None
    own = joint.at(["slope"])
    return np.asarray(joint.covariance[np.ix_(own, joint.at(["gain", offset, "slope"]))])


def payload_departure(spec: PayloadSpec, joint: Joint, name: str) -> PayloadDeparture:
    """What was found of a payload less what was stated; the inertia as stated where nothing moved with it."""
    parts = [part for part in (body_part(name), f"inertia {name}") if part in joint.places]
    found, P = joint.of(["gain", *parts])
    at = slice(joint.at(["gain"]).size, None)
    unit = np.append(1.0, 1.0 / spec.units[1:])[: found[at].size]  # the mass is told as its logarithm
    mean, covariance = np.zeros(10), spec.uncertainty.inertia**2 * np.eye(10)
    with_gain = np.zeros((10, at.start))
    told = slice(unit.size)
    mean[told], covariance[told, told] = found[at] * unit, P[at, at] * np.outer(unit, unit)
    with_gain[told] = P[at, : at.start] * unit[:, None]
    mean[0] = np.expm1(mean[0] - np.log(spec.mass))
    mean[1:4] -= spec.center_of_mass_array
    return PayloadDeparture(mean, covariance, with_gain)
