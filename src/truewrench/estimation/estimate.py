"""What the estimator of one spline and one likelihood found: numbers and findings, no judgement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truewrench.estimation.joint import Joint, body_part
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.log import Log
from truewrench.model.rig import PayloadSpec, Rig
from truewrench.model.rig.sections import COLUMNS, ROWS


@dataclass(frozen=True, slots=True)
class PayloadDeparture:
    """What the data say of a payload, as departures from what was stated.

    Attributes:
        mean: (10,) mass, relative; centre of mass [m]; xx yy zz xy xz yz of the inertia, relative to
            sqrt(I_ii I_jj).
        std: (10,) 1 sigma.
    """

    mean: Array
    std: Array


@dataclass(frozen=True, slots=True)
class Clock:
    """How late the sensor is against one motion stream, and what kind of lateness that is (10.1, 10.4, 10.5).

    Attributes:
        stream: `twist`, `positions`, `velocities`, `rate of turn`, `specific force` or `accelerations`.
        late: s = -time_offset [s].
        std: 1 sigma of it.
        stated: 1 sigma that the rig states.
        kappa: 1/2 for a clock, 0 for a filtered sensor, 1 for filtered velocities; None where it was held.
        kappa_std: its 1 sigma, None where it was held.
        gamma: 1 where gravity is late, too; None where it was held or does not act.
        gamma_std: its 1 sigma.
        undone: how much later the sensor was than `late` before filters were undone [s].
    """

    stream: str
    late: float
    std: float
    stated: float
    kappa: float | None = None
    kappa_std: float | None = None
    gamma: float | None = None
    gamma_std: float | None = None
    undone: float = 0.0


@dataclass(frozen=True, slots=True)
class FoundNoise:
    """Noise found, as a factor on the stated one.

    Attributes:
        what: `force`, `moment`, `channels`, or a motion stream and its part (`velocities v`, `positions`).
        factor: found over stated.
    """

    what: str
    factor: float


@dataclass(frozen=True, slots=True)
class Slow:
    """A slow disturbance of one group of channels: (10.2) where it is in the fit, else (10.9).

    Attributes:
        what: `force`, `moment` or `channels`.
        size: 1 sigma, fraction of range.
        size_std: of the size, by moments; None where d is in the fit.
        tau: correlation time [s].
        z: standard normal deviate of its moment.
        form: `none` (it stayed out of the fit), `matern` or `walk` (size: over the length of the stretch).
        capped: the size ended at three sigma of a sample: as large as it may be.
    """

    what: str
    size: float
    size_std: float | None
    tau: float
    z: float
    form: str
    capped: bool = False


@dataclass(frozen=True, slots=True)
class Event:
    """Consecutive samples of the sensor that were left out.

    Attributes:
        begin: [s] from the log's first stamp.
        end: [s].
        samples: how many.
        lasting: 30 ms or more: a contact; else outliers.
        size: (n,) largest departure of each channel from the model, fraction of range.
    """

    begin: float
    end: float
    samples: int
    lasting: bool
    size: Array


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the offset.

    Attributes:
        time: [s] from the log's first stamp.
        size: (n,) fraction of range.
        std: (n,) 1 sigma.
    """

    time: float
    size: Array
    std: Array


@dataclass(frozen=True, slots=True, eq=False)
class LogRows:
    """The sensor's samples of one log that the fit holds, and what it says at them; of a long log some.

    Attributes:
        rows: (K,) of the log.
        time: (K,) [s] from the log's first stamp.
        masked: (K,) left out.
        residual: (K, n) raw less the model, the discrepancy taken out, fraction of range; NaN where missing.
        discrepancy: (K, n) d of (10.2), fraction of range; 0 where it stayed out.
        wrench: (K, 6) of the payload, SI, with the rig's sign.
        twist: (K, 6) of the logged point (joints: of the sensor).
        acceleration: (K, 6) its component-wise derivative.
        stretch: (K,) which gap-free stretch each belongs to.
        every: one of so many samples is here.
        whole: how many the fit holds, and how many of them are masked, where these are some of them.
    """

    rows: Integers
    time: Array
    masked: Mask
    residual: Array
    discrepancy: Array
    wrench: Array
    twist: Array
    acceleration: Array
    stretch: Integers
    every: int = 1
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

    Attributes:
        solved: whether the record could be solved at all; where not, everything else is the prior.
        gain: (n, 6), SI and raw units.
        covariance: (7n, 7n) of [gain row by row, offset of the last log at its end], (10.9), (10.10) within.
        normalised_covariance: the same, normalised.
        before_pose: (6n, 6n) normalised covariance of the gain before (10.10).
        gain_prior: (6n,) 1 sigma beforehand, normalised.
        offsets: (L, n) raw units, at the end of each log.
        offsets_std: (L, n).
        clocks: per log, of each motion stream.
        payloads: by name.
        tilt: (2,) gravity's tilt [rad], None without gravity; tilt_std likewise.
        tilt_std: its 1 sigma.
        offset_temperature: (n,) raw units per K, None without a slope.
        quadratic: (n,) u of (10.3), fraction of range; quadratic_std likewise.
        quadratic_std: its 1 sigma.
        discrepancy: (n,) 1 sigma of what (10.10) takes to follow the pose, fraction of range.
        noise: per log.
        slow: per log, of each group of channels.
        events: per log.
        steps: per log.
        spacing: (L,) h [s].
        unexplained: (L,) share of the raw output that no motion explains; 0 where its noise is as stated.
        unresolved: (L,) (10.7) still falls at one knot per sample.
        dropped: (L,) stretches that were too short.
        rows: per log.
        sources: 1 sigma (n, 6) of the normalised gain that each source accounts for: `noise` (with priors),
            `mass`, `center_of_mass`, `inertia`, `timing`, `gravity`, `slow` (10.9), `pose` (10.10).
        A: of (10.10).
        ww: (6, 6) E w w^T, fractions of range.
        p_halves: of (10.11).
        p_quarters: of (10.11).
        converged: whether the last fit did.
        iterations: of it.
        fits: how many were made.
        deviance: -2 log L of `map` (10.7), nan of `online` and of parts.
        history_time: (B,) [s] of the blocks of `online`; empty for `map`.
        history_log: (B,) which log each belongs to.
        history_gain: (B, n, 6) the gain after it.
        joint: `gain`, `tilt`, of each payload that is not exact its `body_part` and the departure of its
            inertia, `inertia NAME` [kg m^2], and `offset K` of each log, together; None where nothing moved.
    """

    solved: bool
    gain: Array
    covariance: Array
    normalised_covariance: Array
    before_pose: Array
    gain_prior: Array
    offsets: Array
    offsets_std: Array
    clocks: tuple[tuple[Clock, ...], ...]
    payloads: dict[str, PayloadDeparture]
    tilt: Array | None
    tilt_std: Array | None
    offset_temperature: Array | None
    quadratic: Array
    quadratic_std: Array
    discrepancy: Array
    noise: tuple[tuple[FoundNoise, ...], ...]
    slow: tuple[tuple[Slow, ...], ...]
    events: tuple[tuple[Event, ...], ...]
    steps: tuple[tuple[Step, ...], ...]
    spacing: Array
    unexplained: Array
    unresolved: Mask
    dropped: Integers
    rows: tuple[LogRows, ...]
    sources: dict[str, Array]
    A: float
    ww: Array
    p_halves: float
    p_quarters: float
    converged: bool
    iterations: int
    fits: int
    history_time: Array
    history_log: Integers
    history_gain: Array
    joint: Joint | None = None
    deviance: float = math.nan

    @property
    def time_offsets(self) -> Array:
        """(L,) t_motion = t_sensor + time_offset [s], as logged, of the first motion stream."""
        return np.array([-clocks[0].late - clocks[0].undone if clocks else 0.0 for clocks in self.clocks])

    @property
    def time_offsets_std(self) -> Array:
        """(L,) 1 sigma [s]."""
        return np.array([clocks[0].std if clocks else 0.0 for clocks in self.clocks])

    def masked_share(self) -> float:
        """Share of the sensor's samples that were left out."""
        return float(sum(r.left_out for r in self.rows)) / max(sum(r.samples for r in self.rows), 1)


def undisturbed(log: Log, left_out: Integers, steps: Sequence[Step]) -> Log:
    """A log without the samples that were left out, cut where its offset steps.

    Args:
        log: the whole of it.
        left_out: rows.
        steps: of it.
    """
    raw = log.raw.copy()
    raw[left_out] = np.nan
    jumps = tuple(int(log.time_ns[0] + round(1e9 * step.time)) for step in steps)
    return replace(log, raw=raw, offset_jumps_ns=jumps)


def without_motion(n: int, count: int, **found: Any) -> Estimate:
    """An estimate in which nothing of a motion is: no rows, clocks, sizes or events.

    Args:
        n: channels.
        count: logs.
        found: all that was found all the same, by attribute.
    """
    nothing: dict[str, Any] = {
        "clocks": ((),) * count,
        "payloads": {},
        "tilt": None,
        "tilt_std": None,
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
        "history_time": np.zeros(0),
        "history_log": np.zeros(0, np.int64),
        "history_gain": np.zeros((0, n, 6)),
    }
    return Estimate(**(nothing | found))


def of_joint(rig: Rig, joint: Joint, offsets: Sequence[str]) -> dict[str, Any]:
    """What an estimate has of a joint distribution, by attribute.

    Args:
        rig: sensor and payloads.
        joint: with `gain`, `tilt`, and the offset of each log.
        offsets: parts that hold them.
    """
    n, scale = rig.sensor.n, rig.sensor.channel_scale
    units = np.append((scale[:, None] / rig.sensor.range_array).ravel(), scale)
    pairs = [joint.of([name]) for name in offsets]
    mean, P = joint.of(["gain", offsets[-1]])
    normalised = P / np.outer(units, units)
    tilt, P_tilt = joint.of(["tilt"])
    return {
        "gain": mean[: 6 * n].reshape(n, 6),
        "covariance": P,
        "normalised_covariance": normalised,
        "before_pose": normalised[: 6 * n, : 6 * n],
        "offsets": np.array([offset for offset, _ in pairs]),
        "offsets_std": np.sqrt([np.diag(variance) for _, variance in pairs]),
        "payloads": {
            name: payload_departure(spec, joint, name)
            for name, spec in rig.payloads.items()
            if body_part(name) in joint.places and not spec.exact
        },
        "tilt": tilt,
        "tilt_std": np.sqrt(np.diag(P_tilt)),
    }


def payload_departure(spec: PayloadSpec, joint: Joint, name: str) -> PayloadDeparture:
    """What was found of a payload less what was stated; the inertia as stated where nothing moved with it.

    Args:
        spec: as stated.
        joint: with its `body_part`.
        name: of the payload.
    """
    body, P = joint.of([body_part(name)])
    mean, std = np.zeros(10), np.full(10, spec.uncertainty.inertia)
    mean[0] = np.expm1(body[0] - np.log(spec.mass))
    mean[1:4] = body[1:] - spec.center_of_mass_array
    std[:4] = np.sqrt(np.diag(P))
    if f"inertia {name}" in joint.places:
        root = np.sqrt(np.diag(spec.inertia_matrix))
        unit = 1.0 / (root[ROWS] * root[COLUMNS])
        inertia, P = joint.of([f"inertia {name}"])
        mean[4:], std[4:] = inertia * unit, np.sqrt(np.diag(P)) * unit
    return PayloadDeparture(mean, std)
