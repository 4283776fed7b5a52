"""From a rig and logs to an `Estimate`: the core's loop (METHOD 10.3), its numbers in SI and raw units."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from truewrench import _core
from truewrench.estimation.assumptions import Assumptions
from truewrench.estimation.estimate import (
    Clock,
    Estimate,
    Event,
    FoundNoise,
    LogRows,
    Slow,
    Step,
    Tilt,
    payload_departure,
    slope_covariance,
    without_motion,
)
from truewrench.estimation.joint import EXACT, Joint, body_part, explained
from truewrench.estimation.online import History, found_online
from truewrench.estimation.record import recorded_logs
from truewrench.model.arrays import Array, Integers
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.sections import symmetric

_NOTHING = np.zeros(0)
_SOURCES = ("mass", "center_of_mass", "inertia", "timing", "gravity")


def estimate(
    rig: Rig, logs: Sequence[Log], *, threads: int = 0, online: bool = False, brief: bool = False
) -> Estimate:
    """Estimate gain, offsets and all that is unknown with them from logs of motion, pooled into one gain.

    The number of threads, 0 for all, has no effect on the result. `online` is forward only, block by block
    (METHOD 10.6), and not the whole record at once. `brief` looks for nothing beside the gain: no finer
    motion, no slow disturbance, no step.
    """
    notes: list[str] = []
    assumed, statement, records = recorded_logs(rig, logs, twists=online, notes=notes)
    settings = _core.Settings()
    settings.threads = threads
    settings.discrepancy = assumed.discrepancy
    settings.brief = brief
    found: Any
    if online:
        found = found_online(statement, records, assumed.discrepancy)
    else:
        found = _core.estimate(statement, records, settings)
    ended = found.status == _core.Status.ok
    out = solved(rig, assumed, logs, found, records) if ended else unsolved(rig, logs, found)
    return replace(out, notes=tuple(notes))


def solved(
    rig: Rig,
    assumed: Assumptions,
    logs: Sequence[Log],
    found: Any,
    records: Sequence[Any],
    rows: Sequence[LogRows] | None = None,
) -> Estimate:
    """What the core found, in SI and raw units.

    `found` is what the core's `estimate` returns, or has its attributes; the records are the logs' streams,
    and the rows of the logs those of the fit, unless given.
    """
    fit, n = found.fit, rig.sensor.n
    scale, span = assumed.channel_scale, rig.sensor.range_array
    covariance = np.array(found.covariance)
    columns = [fit.columns(k) for k in range(len(logs))]
    rows = tuple(rows or [_rows(rig, fit.rows(k)) for k in range(len(logs))])
    carried = _carried(rig, logs, columns, np.asarray(fit.theta), rows)
    prior = np.asarray(fit.prior)[: 6 * n]
    theta = np.asarray(fit.theta) + _core.to_the_middle(covariance, prior, span, carried)
    joint = _joint(rig, assumed, logs, columns, theta, covariance, np.asarray(found.gain_covariance))
    pairs = [joint.of([f"offset {k}"]) for k in range(len(logs))]
    # of [gain, offset of the last log]: (10.9) and (10.10) widen the gain's block
    _, P = joint.of(["gain", f"offset {len(logs) - 1}"])
    units = np.append((scale[:, None] / span).ravel(), scale)
    bent = _bent(rig, assumed, columns, prior, covariance)
    P[: 6 * n, : 6 * n] += bent * units[: 6 * n, None] * units[: 6 * n]
    covariance[: 6 * n, : 6 * n] += bent
    normalised = P / units[:, None] / units
    before = covariance[: 6 * n, : 6 * n] + np.asarray(found.added)
    u = np.array(columns[0].at)[columns[0].u : columns[0].u + n]
    slope = None
    if columns[0].slope >= 0:
        slope = np.array(columns[0].at)[columns[0].slope : columns[0].slope + n]
    history: History | None = getattr(found, "history", None)
    unit = scale[:, None] / span
    return Estimate(
        solved=True,
        gain=theta[: 6 * n].reshape(n, 6) * scale[:, None] / span,
        covariance=P,
        normalised_covariance=normalised,
        before_pose=before,
        gain_prior=np.sqrt(prior),
        offsets=np.array([offset for offset, _ in pairs]),
        offsets_std=np.sqrt([np.diag(variance) for _, variance in pairs]),
        clocks=tuple(
            _clocks(rig, log, c, record, fit, theta, covariance)
            for log, c, record in zip(logs, columns, records, strict=True)
        ),
        payloads={
            name: payload_departure(spec, joint, name)
            for name, spec in rig.payloads.items()
            if body_part(name) in joint.places
        },
        tilts=tuple(
            Tilt(logs, theta[at], np.sqrt(np.diag(covariance)[at])) for logs, at in _root_frames(columns)
        ),
        offset_temperature=None if slope is None else theta[slope] * scale,
        quadratic=theta[u],
        quadratic_std=np.sqrt(np.diag(covariance)[u]),
        discrepancy=np.sqrt(np.asarray(found.discrepancy2)),
        noise=tuple(_noise(rig, log, records[k], fit, k) for k, log in enumerate(logs)),
        slow=tuple(_slow(rig, found, k) for k in range(len(logs))),
        events=tuple(_events(r) for r in rows),
        steps=tuple(_steps(c, theta, covariance, n) for c in columns),
        spacing=np.array([fit.spacing(k) for k in range(len(logs))]),
        unexplained=np.array(found.unexplained),
        unresolved=np.array(found.unresolved, dtype=bool),
        dropped=np.array(found.dropped, dtype=np.int64),
        rows=rows,
        sources=_sources(columns, covariance, before, normalised, n),
        A=float(found.pose.A),
        ww=np.array(found.pose.ww),  # a view would keep the whole fit
        p_halves=float(found.halves.p),
        p_quarters=float(found.quarters.p),
        p_logs=np.array([agreement.p for agreement in found.logs] or [1.0] * len(logs)),
        converged=history is not None or bool(fit.converged),
        iterations=int(fit.iterations),
        fits=int(found.fits),
        history_time=_NOTHING if history is None else history.time,
        history_log=np.zeros(0, np.int64) if history is None else history.log,
        history_gain=np.zeros((0, n, 6)) if history is None else history.gain * unit,
        joint=joint,
        slope_covariance=slope_covariance(joint, f"offset {len(logs) - 1}"),
        deviance=float(fit.deviance),
    )


def unsolved(rig: Rig, logs: Sequence[Log], found: Any = None) -> Estimate:
    """The prior, where a record says nothing that could be solved, or was not asked."""
    n, count = rig.sensor.n, len(logs)
    scale, span = Assumptions.of(rig, logs).channel_scale, rig.sensor.range_array
    prior = np.append(np.full(6 * n, min(rig.sensor.gain_prior, 1e30)), rig.sensor.offset_prior_array / scale)
    normalised = np.diag(prior**2)
    units = np.append((scale[:, None] / span).ravel(), scale)
    offset_std = np.tile(rig.sensor.offset_prior_array, (count, 1))
    unexplained, unresolved = np.zeros(count), np.zeros(count, dtype=bool)
    dropped = np.zeros(count, dtype=np.int64)
    if found is not None:
        unexplained[: len(found.unexplained)] = found.unexplained
        unresolved[: len(found.unresolved)] = found.unresolved
        dropped[: len(found.dropped)] = found.dropped
    return without_motion(
        n,
        count,
        solved=False,
        gain=np.array(rig.sensor.nominal_gain_array),
        covariance=normalised * units[:, None] * units,
        normalised_covariance=normalised,
        before_pose=normalised[: 6 * n, : 6 * n],
        gain_prior=prior[: 6 * n],
        offsets=np.zeros((count, n)),
        offsets_std=offset_std,
        unexplained=unexplained,
        unresolved=unresolved,
        dropped=dropped,
        converged=False,
        iterations=0,
        fits=0 if found is None else int(found.fits),
    )


def _rows(rig: Rig, of: Any) -> LogRows:
    return LogRows(
        rows=np.asarray(of["source"], np.int64),
        time=np.asarray(of["time"]).ravel(),
        masked=np.asarray(of["masked"]).ravel() > 0.0,
        residual=np.asarray(of["residual"]),
        discrepancy=np.asarray(of["d"]),
        wrench=np.asarray(of["w"]) * rig.sensor.range_array,
        twist=np.asarray(of["nu"]),
        acceleration=np.asarray(of["a"]),
        stretch=np.asarray(of["stretch"], np.int64),
    )


_FIELDS = {
    "twist": "twist",
    "positions": "position",
    "velocities": "velocity",
    "rate of turn": "angular_velocity",
    "specific force": "specific_force",
    "accelerations": "acceleration",
}


def _streams(rig: Rig, record: Any) -> list[str]:
    """What people call the motion streams of a log."""
    if record.source == _core.Source.mapped:
        return [("positions", "velocities", "accelerations")[m.derivative] for m in record.motion]
    if record.source == _core.Source.imu:
        return ["specific force", "rate of turn"][: len(record.motion)]
    twist = "velocities" if rig.motion.source == "joints" else "twist"
    return [(twist, "accelerations")[m.derivative] for m in record.motion]


def _clocks(
    rig: Rig, log: Log, columns: Any, record: Any, fit: Any, theta: Array, covariance: Array
) -> tuple[Clock, ...]:
    active, at = set(fit.active), np.array(columns.at)
    std = np.sqrt(np.diag(covariance))
    gamma = at[columns.gamma] if columns.gamma >= 0 and at[columns.gamma] in active else None
    out = []
    for k, (place, stream) in enumerate(zip(columns.clock, _streams(rig, record), strict=True)):
        if k > 0 and len(record.motion[k].time) == 1:  # where velocities start, which no clock stamped
            continue
        s, kappa = at[place], at[place + 1]
        free = kappa in active
        gravity = gamma if k == 0 else None
        out.append(
            Clock(
                stream,
                float(theta[s]),
                float(std[s]),
                rig.sensor.time_offset_prior,
                float(theta[kappa]) if free else None,
                float(std[kappa]) if free else None,
                None if gravity is None else float(theta[gravity]),
                None if gravity is None else float(std[gravity]),
                log.filters_advance(_FIELDS.get(stream, "twist")),
                log.clock_set,
                math.hypot(record.half_window, record.motion[k].half_window),
            )
        )
    return tuple(out)


def _bent(rig: Rig, assumed: Assumptions, columns: Sequence[Any], prior: Array, covariance: Array) -> Array:
    """`_core.bend` of the normalised gain (6n, 6n), by the mean covariance of the logs' centres of mass."""
    n = rig.sensor.n
    unit = (assumed.channel_scale[:, None] / rig.sensor.range_array).ravel()
    places = [c.body_in_theta + np.arange(1, 4) for c in columns]
    center = np.mean([covariance[np.ix_(at, at)] for at in places], axis=0)
    gain = covariance[: 6 * n, : 6 * n] * np.outer(unit, unit)
    return np.asarray(_core.bend(gain, center, prior * unit**2) / np.outer(unit, unit))


def _carried(
    rig: Rig, logs: Sequence[Log], columns: Sequence[Any], theta: Array, rows: Sequence[LogRows]
) -> list[_core.Carried]:
    """The payloads of the logs as theta has them, and what the sensor felt of them."""
    felt: dict[str, Array] = {}
    for log, of in zip(logs, rows, strict=True):
        felt[log.payload] = felt.get(log.payload, 0.0) + of.every * of.wrench.T @ of.wrench
    out = []
    for log, c in zip(logs, columns, strict=True):
        if log.payload not in felt:
            continue
        spec, places = rig.payloads[log.payload], c.body_in_theta + np.arange(10)
        mass, center = spec.mass * np.exp(theta[places[0]]), spec.center_of_mass_array + theta[places[1:4]]
        inertia = spec.inertia_matrix + symmetric(theta[places[4:]])
        payload = _core.Payload(float(mass), center, inertia)
        out.append(_core.Carried(places.tolist(), payload, felt.pop(log.payload)))
    return out


def _joint(
    rig: Rig,
    assumed: Assumptions,
    logs: Sequence[Log],
    columns: Sequence[Any],
    theta: Array,
    covariance: Array,
    gain_covariance: Array,
) -> Joint:
    """Gain, tilts, bodies and offsets out of theta, with the gain's own covariance as it was widened."""
    n, P_theta = rig.sensor.n, covariance.copy()
    P_theta[: 6 * n, : 6 * n] = gain_covariance
    unit = np.eye(theta.size)
    scale = assumed.channel_scale
    rows = {"gain": unit[: 6 * n] * (scale[:, None] / rig.sensor.range_array).reshape(-1, 1)}
    stated = {}
    rows |= {f"tilt {of[0]}": unit[at] for of, at in _root_frames(columns)}
    for log, c in zip(logs, columns, strict=True):
        spec, name = rig.payloads[log.payload], body_part(log.payload)
        if name in rows or spec.exact:
            continue
        body = unit[c.body_in_theta : c.body_in_theta + 10]
        rows[name], rows[f"inertia {log.payload}"] = body[:4], body[4:]
        stated[name] = np.append(np.log(spec.mass), spec.center_of_mass_array)
    for k, c in enumerate(columns):
        rows[f"offset {k}"] = scale[:, None] * sum(unit[np.array(c.at)[b : b + n]] for b in (c.b, *c.steps))
    if columns[0].slope >= 0:
        rows["slope"] = scale[:, None] * unit[np.array(columns[0].at)[columns[0].slope :][:n]]
    whole = np.vstack(list(rows.values()))
    P = whole @ P_theta @ whole.T
    P[np.diag_indices_from(P)] += EXACT**2 * (np.diag(P) == 0.0)
    means = {name: row @ theta + stated.get(name, 0.0) for name, row in rows.items()}
    return Joint.of_parts(means, P)


def _root_frames(columns: Sequence[Any]) -> list[tuple[tuple[int, ...], Integers]]:
    """Which logs end in each root frame that gravity may be tilted in, and where in theta its tilt stands."""
    found: dict[tuple[int, ...], tuple[int, ...]] = {}
    for k, c in enumerate(columns):
        if at := tuple(_tilts(c)[-2:]):
            found[at] = (*found.get(at, ()), k)
    return [(logs, np.array(at)) for at, logs in found.items()]


def _tilts(c: Any) -> list[int]:
    """Where in theta the tilts of gravity in a log's root frames stand, two of each; none without gravity."""
    return list(c.at[c.tilt : c.tilt + 2 * max(len(c.roots), 1)]) if c.tilt >= 0 else []


def _sources(
    columns: Sequence[Any], covariance: Array, before: Array, normalised: Array, n: int
) -> dict[str, Array]:
    """What the variance of the gain is made of: P_gg = (P_gg - K P_vv K^T) + K P_vv K^T, K = P_gv P_vv^-1."""
    places: dict[str, set[int]] = {name: set() for name in _SOURCES}
    for c in columns:
        at = np.array(c.at)
        mass = c.body_in_theta
        places["mass"].add(mass)
        places["center_of_mass"] |= set(range(mass + 1, mass + 4))
        places["inertia"] |= set(range(mass + 4, mass + 10))
        for clock in c.clock:
            places["timing"] |= {int(at[clock]), int(at[clock + 1])}
        if c.gamma >= 0:
            places["timing"].add(int(at[c.gamma]))
        places["gravity"] |= set(_tilts(c))
    gains = np.diag(covariance)[: 6 * n]

    found = {name: explained(covariance, 6 * n, at) for name, at in places.items()}
    every = explained(covariance, 6 * n, set().union(*places.values()))
    found["noise"] = gains - every
    found["slow"] = np.diag(before) - gains
    found["pose"] = np.diag(normalised)[: 6 * n] - np.diag(before)
    sigma = {name: np.sqrt(np.maximum(v, 0.0)).reshape(n, 6) for name, v in found.items()}
    return {name: s for name, s in sigma.items() if name == "noise" or s.max() > 1e-9}


def _groups(n: int) -> tuple[str, ...]:
    return ("force", "moment") if n == 6 else ("channels",)


def _noise(rig: Rig, log: Log, record: Any, fit: Any, k: int) -> tuple[FoundNoise, ...]:
    sizes, left = fit.sizes(k), log.calmed.get("raw", 1.0)
    groups = zip(_groups(rig.sensor.n), sizes.raw_factor, strict=True)
    out = [FoundNoise(what, float(f) / left, left) for what, f in groups]
    for stream, factors in zip(_streams(rig, record), sizes.motion_factor, strict=True):
        name = "velocities" if stream == "twist" else stream
        parts = (" v", " Omega") if record.source == _core.Source.twist else ("",)
        left = log.calmed.get(_FIELDS[stream], 1.0)
        of_parts = zip(parts, np.asarray(factors), strict=False)
        out += [FoundNoise(name + p, float(f) / left, left) for p, f in of_parts]
    return tuple(out)


def _slow(rig: Rig, found: Any, k: int) -> tuple[Slow, ...]:
    sizes, out = found.fit.sizes(k), []
    form = str(sizes.form).rsplit(".", 1)[-1]
    for g, what in enumerate(_groups(rig.sensor.n)):
        moment = found.moments[k][g] if k < len(found.moments) else None
        if form == "none":
            if moment is None:
                continue
            size = float(np.sqrt(moment.delta2))
            std = float(moment.sd) / (2.0 * size) if size > 0.0 else float(np.sqrt(max(moment.sd, 0.0)))
            out.append(Slow(what, size, std, float(moment.tau), float(moment.z), form))
        else:
            delta = float(sizes.delta[g])
            z = float(moment.z) if moment is not None else np.nan
            out.append(Slow(what, delta, None, 1.0 / sizes.k, z, form, delta >= 0.999 * float(sizes.cap[g])))
    return tuple(out)


def _events(rows: LogRows) -> tuple[Event, ...]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.masked.astype(int), [0]])))
    period = float(np.median(np.diff(rows.time))) if rows.time.size > 1 else 0.0
    out = []
    for a, b in edges.reshape(-1, 2):
        with np.errstate(invalid="ignore"):
            size = np.nanmax(np.abs(np.nan_to_num(rows.residual[a:b])), axis=0)
        lasting = rows.time[b - 1] - rows.time[a] + period >= _core.MASK_SHORTEST - 1e-9
        out.append(Event(float(rows.time[a]), float(rows.time[b - 1]), int(b - a), bool(lasting), size))
    return tuple(out)


def _steps(columns: Any, theta: Array, covariance: Array, n: int) -> tuple[Step, ...]:
    at, out = np.array(columns.at), []
    for place, time in zip(columns.steps, columns.step_times, strict=True):
        where = at[place : place + n]
        out.append(Step(float(time), theta[where], np.sqrt(np.diag(covariance)[where])))
    return tuple(out)
