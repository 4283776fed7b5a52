"""What an estimate needed beside the rig as stated, and what it looks like, in words (METHOD 10.7).

One function makes them; it changes neither estimate nor verdict. What a record holds beside the model is
named by one of `KINDS`, or by at most three of them, the likeliest first: they begin `Assumed.what`, before a
colon.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from scipy.special import pdtrc

from truewrench import _core
from truewrench.estimation.assumptions import FIRST_POSITION_NOISE
from truewrench.estimation.estimate import Clock, Estimate, FoundNoise, Slow
from truewrench.estimation.far_clock import bent
from truewrench.estimation.reference_clock import ReferenceClock
from truewrench.judging.attribution import Looks, fast_looks, slow_looks
from truewrench.model.arrays import Mask
from truewrench.model.calibration_parts import Assumed
from truewrench.model.log import Log, log_name
from truewrench.model.rig import Rig

MOST = 3  # kinds that are named at once
STEPPED = 0.7  # shares left out before and after a step differ so: 5 of 8 steps that `online` refuses
WORTH = 0.1  # of the highest score, from which on a kind is named: the right one in 21 of 27 refusals
TOLD = 4.0  # sigma of a clock, a quadratic term, a slow disturbance: 1 clean record in 2,000
FILTERED = 4.0  # sigma of kappa and gamma from those of a clock, from which on a filter is named first
LARGE = 10.0  # times a slow disturbance or the noise, below which an event may be a part of it: words only
NEAR = 0.3  # [s] of a step, within which a contact may be its edge: words only
TILTED = 2.0  # sigma of its prior, that gravity's tilt is told from: 1 true prior in 10
CLEAN_OUTLIERS = 3e-4  # share of clean samples that are masked,
CHANCE = 1e-3  # and the probability of as many as found, below which outliers are told
FINE = 0.3  # of the coarsest spacing of knots, below which the motion is told to be fast: 1 of 102 records
EVENTS = 10  # contacts that are named one by one
CHANNELS = ("force", "moment", "channels")  # what `FoundNoise.what` is where it is the sensor's

_STREAMS = {"twist": "velocities", "rate of turn": "rates of turn"}
_FAST = {
    "vibration": "peak in the residuals, fraction of range",
    "jitter": "1 sigma of the stamps, s",
    "resolution": "step of the logged motion, SI units",
}
_SLOW = ("hysteresis", "cable", "drift")
_WALK = ("drift", "cable", "hysteresis")


def findings(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[Assumed, ...]:
    """Every alternative that the estimate needed beside the rig as stated, and what was left out."""
    if not estimate.solved:
        return ()
    slow, fast = looks_slow(estimate, rig, logs), fast_looks(estimate, rig, logs)
    found: list[Assumed] = []
    for k in range(len(estimate.rows)):
        found += _undone(logs, k)
        found += _clocks(estimate, rig, logs, k)
        found += _slow(estimate, rig, logs, k, slow)
        found += _noise(estimate, rig, logs, k, [looks.kind for looks in fast])
        found += _steps(estimate, rig, logs, k, slow)
        found += _events(estimate, rig, logs, k, slow, [looks.kind for looks in fast])
        found += _fine(estimate, logs, k, [looks.kind for looks in fast])
    found += _quadratic(estimate, rig)
    found += _tilts(estimate, rig, logs)
    for looks in fast:
        what = f"{looks.kind}: {_FAST[looks.kind]}"
        found.append(Assumed(what, "the record", looks.value, None, looks.words))
    return tuple(found)


def looks_slow(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[str, ...]:
    """At most three kinds that the slow departures look like, likeliest first; some always."""
    walks = any(slow.form == "walk" for of_log in estimate.slow for slow in of_log)
    return _likeliest(slow_looks(estimate, rig, logs)) or (_WALK if walks else _SLOW)


def looks_fast(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[str, ...]:
    """The same of what is faster than the motion resolves."""
    return _likeliest(fast_looks(estimate, rig, logs)) or ("vibration", "jitter", "noise")


def kinds_of_disturbances(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[str, ...]:
    """The kinds of what was left out: what it may be a part of, then events."""
    count = {"contact": 0, "outliers": 0}
    for event in (event for of_log in estimate.events for event in of_log):
        count["contact" if event.lasting else "outliers"] += event.samples
    kinds = [kind for kind in sorted(count, key=lambda kind: -count[kind]) if count[kind]] or ["contact"]
    if slow_found(estimate):
        return (*looks_slow(estimate, rig, logs)[: MOST - 1], *kinds)
    stepped = ("step",) if any(_from_some_time_on(rows.masked) for rows in estimate.rows) else ()
    return (*stepped, *likeliest_fast(estimate, rig, logs), *kinds)


def _from_some_time_on(masked: Mask) -> bool:
    """Whether most samples after some time were left out and few before it, or the other way round."""
    count = len(masked)
    at = np.arange(count // 10 + 1, count - count // 10)
    if not at.size:
        return False
    before = np.cumsum(masked)[at - 1]
    after = np.count_nonzero(masked) - before
    return bool(np.abs(after / (count - at) - before / at).max() > STEPPED)


def likeliest_fast(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[str, ...]:
    """The one kind that the fast departures look like most; none where they look like noise."""
    return tuple(looks.kind for looks in fast_looks(estimate, rig, logs)[:1])


def slow_stands(estimate: Estimate) -> bool:
    """Whether a slow disturbance is in the estimate."""
    return any(slow.form != "none" for of_log in estimate.slow for slow in of_log)


def slow_found(estimate: Estimate) -> bool:
    """Whether a slow disturbance is in the estimate, or stands out beside it."""
    return slow_stands(estimate) or any(slow.z > TOLD for of_log in estimate.slow for slow in of_log)


def scatter(estimate: Estimate) -> float:
    """The noise found of the sensor, times the stated; of its noisiest channels and log."""
    return _largest(f for of_log in estimate.noise for f in of_log if f.what in CHANNELS)


def motion_scatter(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> float:
    """The same of the motion, where its noise is stated."""
    return _largest(
        found
        for log, of_log in zip(logs, estimate.noise, strict=False)
        for found in of_log
        if found.what not in CHANNELS and not (found.what == "positions" and _positions_unstated(rig, log))
    )


def _largest(noise: Iterable[FoundNoise]) -> float:
    return max((found.factor for found in noise if not math.isnan(found.factor)), default=1.0)


def kinds_of_disagreement(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> tuple[str, ...]:
    """Why parts of a record may disagree: slow departures, and noise far beyond the stated.

    Where nothing slow was found: what was left out, then a filter that was. A filter, of whose kernel two
    moments are undone, may leave something slow.
    """
    told = [found.what.split(":")[0].split(", ")[0] for found in findings(estimate, rig, logs)]
    fast = likeliest_fast(estimate, rig, logs) if scatter(estimate) > _core.NOISE_TOLD else ()
    if slow_found(estimate) and "filter" in told:
        fast = fast or ("filter",)
    kinds = [*looks_slow(estimate, rig, logs)[: MOST - len(fast)], *fast]
    if not slow_found(estimate):
        kinds = [*(kind for kind in ("contact", "outliers", "filter") if kind in told), *kinds]
    return tuple(dict.fromkeys(kinds))[:MOST]


def listed(words: Sequence[str], last: str = "or") -> str:
    """`hysteresis, cable or drift`."""
    return f" {last} ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _likeliest(looks: Sequence[Looks]) -> tuple[str, ...]:
    ordered = sorted(looks, key=lambda x: -x.score)
    return tuple(x.kind for x in ordered if x.score > WORTH * ordered[0].score)[:MOST]


def _what(kinds: Sequence[str], meaning: str) -> str:
    return f"{', '.join(kinds[:MOST])}: {meaning}"


def _undone(logs: Sequence[Log], k: int) -> Iterator[Assumed]:
    """Vibrations, filters and a clock's rate, which the estimate's log is without."""
    if k >= len(logs):
        return
    for shakes in logs[k].vibrations:
        kind = "vibration: mean amplitude, fraction of range"
        yield Assumed(kind, log_name(logs, k), shakes.size, None, shakes.words)
    for found in logs[k].whitened.values():
        kind = "filter: corner of a stream's noise, Hz"
        yield Assumed(kind, log_name(logs, k), found.corner, None, found.words)
    yield from _rate(float(logs[k].clock_rate), log_name(logs, k), "motion's")


def of_references(logs: Sequence[Log], clocks: Sequence[ReferenceClock | None]) -> tuple[Assumed, ...]:
    """How late sensors are against reference wrenches, which was undone."""
    found: list[Assumed] = []
    for k, clock in enumerate(clocks):
        if clock is None:
            continue
        s, std, where = clock.late, clock.late_std, log_name(logs, k)
        words = _late(s, std, "reference", "is")
        what = _what(("clock", "delay", "filter"), "how late the sensor is against the reference, s")
        found += [Assumed(what, where, s, std, words), *_rate(clock.rate, where, "reference's")]
    return tuple(found)


def _late(s: float, std: float, other: str, verb: str) -> str:
    """Whether the sensor is late, or what it is compared with, which `verb` goes with."""
    first, second, said = ("sensor", other, "is") if s > 0.0 else (other, "sensor", verb)
    return f"the {first} {said} {_pm(1e3 * abs(s), 1e3 * std)} ms late against the {second}"


def _rate(rate: float, where: str, whose: str) -> Iterator[Assumed]:
    if rate != 0.0:
        faster = f"{1e6 * abs(rate):.2g} ppm {'faster' if rate > 0.0 else 'slower'}"
        words = f"the sensor's clock runs {faster} than the {whose}"
        yield Assumed(f"clock: rate over the {whose}, less 1", where, rate, None, words)


def _clocks(estimate: Estimate, rig: Rig, logs: Sequence[Log], k: int) -> Iterator[Assumed]:
    """Clocks and filters.

    With a first-order filter of time constant tau beside a clock c, s = c - tau for one of the motion and
    c + tau for one of the sensor; then in (10.5) gamma s = c, and in (10.4) (2 kappa - 1) (s^2 + r^2) is
    +-tau^2.
    """
    hz = rig.sensor.lowpass_hz
    for clock in estimate.clocks[k]:
        s, std, undone = clock.late + clock.set_back, clock.std, clock.undone
        expected = 0.0 if hz is None else 1.0 / (2.0 * math.pi * hz)
        if not abs(s + undone - expected) > TOLD * std or not math.isfinite(s):
            continue
        stream, where = _STREAMS.get(clock.stream, clock.stream), log_name(logs, k)
        tau, sigma, motion = _filter(clock, hz) if undone == 0.0 else (0.0, 0.0, False)
        if tau > 0.0:
            kinds = ("filter", "delay") if clock.gamma is not None else ("filter", "delay", "clock")
            late = stream if motion else "sensor's channels"
            words = (
                f"the {late} are late by {_pm(1e3 * tau, 1e3 * sigma)} ms and look filtered at "
                f"{1.0 / (2.0 * math.pi * tau):.2g} Hz (first order)"
            )
            yield Assumed(_what(kinds, f"how late the {late} are, s"), where, tau, sigma, words)
            s += tau if motion else -tau  # what is left is a clock
            if not abs(s - expected) > TOLD * math.hypot(std, sigma):
                continue
        s += undone
        seen = ("filter", "delay", "clock") if undone else ("clock", "delay", "filter")
        kinds = ("clock", "delay") if tau > 0.0 else seen
        within = f", within the stated {1e3 * clock.stated:.3g} ms" if abs(s) <= clock.stated else ""
        words = _late(s, std, stream, "are") + within
        yield Assumed(_what(kinds, f"how late the sensor is against the {stream}, s"), where, s, std, words)


def _filter(clock: Clock, lowpass_hz: float | None) -> tuple[float, float, bool]:
    """Time constant of a filter that a clock alone does not explain, its sigma, and whether of the motion."""
    if clock.gamma is not None and clock.gamma_std is not None:
        tau, sigma = (clock.gamma - 1.0) * clock.late, abs(clock.late) * clock.gamma_std
        if tau > FILTERED * sigma:
            return tau, sigma, True
    if clock.kappa is not None and clock.kappa_std is not None and lowpass_hz is None:
        excess = 2.0 * clock.kappa - 1.0
        motion, late = excess > 0.0, clock.late + clock.set_back
        if abs(excess) > FILTERED * 2.0 * clock.kappa_std and (motion or late > 0.0):
            span = math.hypot(clock.late + bent(clock.set_back), clock.half_window)
            tau = span * math.sqrt(min(abs(excess), 1.0))
            return tau, span * clock.kappa_std / math.sqrt(abs(excess)), motion
    return 0.0, 0.0, False


def _slow(
    estimate: Estimate, rig: Rig, logs: Sequence[Log], k: int, kinds: Sequence[str]
) -> Iterator[Assumed]:
    for slow in estimate.slow[k]:
        if slow.form == "none" and not slow.z > TOLD:
            continue
        size = _physical(rig, slow)
        over = "wandering over the record" if slow.form == "walk" else f"correlated over {slow.tau:.2g} s"
        words = f"slow disturbance of {size}, {over}: {listed(kinds)}"
        if slow.capped:
            words += "; it ended as large as it may be"
        meaning = f"slow disturbance of the {plural(slow.what)}, fraction of range"
        yield Assumed(_what(kinds, meaning), log_name(logs, k), slow.size, slow.size_std, words)


def _physical(rig: Rig, slow: Slow) -> str:
    at = {"force": slice(0, 3), "moment": slice(3, 6)}.get(slow.what)
    if at is None:
        return f"{100 * slow.size:.2g}% of range"
    return f"{slow.size * float(rig.sensor.range_array[at].mean()):.2g} {'N' if at.start == 0 else 'N m'}"


def _noise(
    estimate: Estimate, rig: Rig, logs: Sequence[Log], k: int, fast: Sequence[str]
) -> Iterator[Assumed]:
    where, positions = log_name(logs, k), []
    for found in estimate.noise[k]:
        if found.what == "positions" and _positions_unstated(rig, logs[k]):
            positions.append(found.factor)
        elif not 1.0 / _core.NOISE_TOLD <= found.factor <= _core.NOISE_TOLD:
            kinds = (*[kind for kind in fast if found.factor > _core.NOISE_TOLD], "noise")
            words = f"noise of the {plural(found.what)} is {found.factor:.2g} x the stated"
            meaning = f"of the {plural(found.what)}, times the stated"
            yield Assumed(_what(kinds[-MOST:], meaning), where, found.factor, None, words)
    if positions:
        value = FIRST_POSITION_NOISE * max(positions)
        words = f"no `position_noise` is stated: {value:.2g} was found, from {FIRST_POSITION_NOISE:g}"
        yield Assumed("noise: of the joints' positions, rad", where, value, None, words)


def _positions_unstated(rig: Rig, log: Log) -> bool:
    logged = rig.motion.source == "joints" and log.position is not None
    return logged and rig.motion.position_noise is None


def plural(what: str) -> str:
    """What is noisy, for a sentence."""
    return {"force": "forces", "moment": "moments"}.get(what, what)


def _fine(estimate: Estimate, logs: Sequence[Log], k: int, fast: Sequence[str]) -> Iterator[Assumed]:
    h, period = float(estimate.spacing[k]), logs[k].motion_period
    if period is None:
        return
    coarsest = _core.coarsest_spacing(period)
    if h < FINE * coarsest:
        kinds = [kind for kind in fast if kind in ("vibration", "jitter")] or ["vibration", "jitter"]
        words = f"the motion is resolved in steps of {1e3 * h:.2g} ms, not {1e3 * coarsest:.2g} ms"
        yield Assumed(_what(kinds, "spacing of the motion's knots, s"), log_name(logs, k), h, None, words)


def _quadratic(estimate: Estimate, rig: Rig) -> Iterator[Assumed]:
    for name, u, std in zip(rig.sensor.channels, estimate.quadratic, estimate.quadratic_std, strict=True):
        if math.isfinite(u) and std > 0.0 and abs(u) > TOLD * std:
            words = f"channel {name} departs from linear by {100 * abs(u):.2g}% of range"
            what = "nonlinearity: quadratic term at full scale, fraction of range"
            yield Assumed(what, f"channel {name}", float(u), float(std), words)


def _tilts(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> Iterator[Assumed]:
    prior = rig.gravity_tilt_prior
    for tilt in estimate.tilts if prior > 0.0 else ():
        angle = float(np.linalg.norm(tilt.angles))
        if not np.abs(tilt.angles).max() > TILTED * prior:
            continue
        sigma = float(np.max(tilt.std))
        every = len(estimate.tilts) == 1
        where = "all logs" if every else ", ".join(log_name(logs, k) for k in tilt.logs)
        words = (
            f"gravity is tilted by {_pm(math.degrees(angle), math.degrees(sigma))} deg, "
            f"{angle / prior:.2g} sigma of what the rig states"
        )
        yield Assumed("gravity: tilt of its direction, rad", where, angle, sigma, words)


def _part_of(estimate: Estimate, k: int, size: float, kinds: Sequence[str]) -> tuple[str, ...]:
    """The kinds of the slow disturbance that something as small may be a part of; none if it is not."""
    slow = max((slow.size for slow in estimate.slow[k] if slow.form != "none"), default=0.0)
    return tuple(kinds) if abs(size) < LARGE * slow else ()


def _steps(
    estimate: Estimate, rig: Rig, logs: Sequence[Log], k: int, slow: Sequence[str]
) -> Iterator[Assumed]:
    for step in estimate.steps[k]:
        i = int(np.argmax(np.abs(step.size)))
        name, size = rig.sensor.channels[i], float(step.size[i])
        words = f"the offset of {name} steps by {100 * size:.2g}% of range at {step.time:.4g} s"
        part = _part_of(estimate, k, size, slow)
        if step.time > (1.0 - _core.MOST_LOST) * float(estimate.rows[k].time[-1]):
            words += "; a contact that lasts to the end looks the same, and the offset is then the one before"
            part = ("contact", *part[: MOST - 2])
        what = _what(("step", *part), "of the offset, fraction of range")
        where = f"{log_name(logs, k)}, {step.time:.4g} s, channel {name}"
        yield Assumed(what, where, size, float(step.std[i]), words)


def _events(
    estimate: Estimate, rig: Rig, logs: Sequence[Log], k: int, slow: Sequence[str], fast: Sequence[str]
) -> Iterator[Assumed]:
    where, rows = log_name(logs, k), estimate.rows[k]
    factor = max((f.of_sample for f in estimate.noise[k] if f.what in CHANNELS), default=1.0)
    noise = factor * rig.sensor.noise_array / rig.sensor.channel_scale
    contacts = [event for event in estimate.events[k] if event.lasting]
    for event in contacts[:EVENTS]:
        i = int(np.argmax(event.size))
        size, name = float(event.size[i]), rig.sensor.channels[i]
        words = (
            f"contact from {event.begin:.4g} to {event.end:.4g} s left out, up to {100 * size:.2g}% of range "
            f"on {name}"
        )
        step = any(event.begin - NEAR < step.time < event.end + NEAR for step in estimate.steps[k])
        part = _part_of(estimate, k, size, slow) or (tuple(fast) if size < LARGE * noise[i] else ())
        kinds = (*part[: MOST - 1], "contact") if part else ("contact", "step") if step else ("contact",)
        what = _what(kinds, "largest departure of a channel, fraction of range")
        yield Assumed(what, f"{where}, {event.begin:.4g} to {event.end:.4g} s", size, None, words)
    if len(contacts) > EVENTS:
        rest = contacts[EVENTS:]
        seconds = sum(event.end - event.begin for event in rest)
        words = f"{len(rest)} more contacts, {seconds:.3g} s in all, left out"
        yield Assumed("contact: left out, s", where, seconds, None, words)
    outliers = sum(event.samples for event in estimate.events[k] if not event.lasting)
    if outliers and pdtrc(outliers - 1, CLEAN_OUTLIERS * rows.samples) < CHANCE:
        words = f"{outliers} single samples left out of {rows.samples}"
        yield Assumed("outliers: samples left out", where, float(outliers), None, words)


def _pm(value: float, sigma: float) -> str:
    """`7.9 +- 0.1`: as many digits as sigma deserves."""
    if not 0.0 < sigma < math.inf or not math.isfinite(value):
        return f"{value:.3g}"
    decimals = min(max(-math.floor(math.log10(sigma)), 0), 9)
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"
