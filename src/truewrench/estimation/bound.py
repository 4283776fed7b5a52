"""What a log allows at best: the Cramer-Rao bound on the gain (docs/method.md, "The bound")."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.linalg import cho_solve_banded, cholesky_banded

from truewrench.estimation.assumptions import assumed_gain_prior, assumed_offset_prior
from truewrench.estimation.motion_noise import twist_noise
from truewrench.estimation.unknowns import Motion, Unknown, Wrench, unknowns_of, wrench_rates
from truewrench.model.arrays import Array
from truewrench.model.calibration import Bound
from truewrench.model.errors import InputError
from truewrench.model.log import Log, Reference
from truewrench.model.motion.smooth import segments, smooth_twist
from truewrench.model.motion.spatial import cross_matrix, twist_adjoint
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig
from truewrench.robot.track import tracked_streams

NOISE = "noise"  # what is left of the uncertainty when payload, clocks and gravity are known

_DEGREE = 5
_ACTIVE = _DEGREE + 1
_BLOCK = 6 * _ACTIVE  # coefficients that one sample sees
_SHORTEST = 8  # samples of a twist that a spline can follow


@dataclass(frozen=True, slots=True, eq=False)
class Information:
    """What logs tell of gain, offsets and all else that is unknown, the motion being inferred from them."""

    # (p, p) Fisher information; the 6n normalised gains first, row by row, then the n offsets of every log,
    # or of all of them, then the unknowns
    data: Array
    prior: Array  # (p,) 1 sigma of each beforehand
    gains: int  # 6n
    unknowns: tuple[Unknown, ...]  # of the last of the p

    def covariance(self, times: float = 1.0) -> Array:
        """Of the normalised gains (6n, 6n), after so many records like these."""
        return self._inverse(times)[: self.gains, : self.gains]

    def known(self, times: float = 1.0) -> Array:
        """The same if payload, clocks and gravity were exact."""
        kept = self.prior.size - len(self.unknowns)
        known = times * self.data[:kept, :kept] + np.diag(self.prior[:kept] ** -2.0)
        return np.asarray(np.linalg.inv(known)[: self.gains, : self.gains])

    def contributions(self, times: float = 1.0) -> dict[str, Array]:
        """1 sigma (6n,) that noise, and each group of unknowns, accounts for alone.

        P_gg = P_g|u + K P_uu K^T with K = P_gu P_uu^-1: the first term is that of known unknowns.
        """
        P, first = self._inverse(times), self.prior.size - len(self.unknowns)
        found = {NOISE: np.sqrt(np.diag(self.known(times)))}
        if not self.unknowns:
            return found
        inner, cross = P[first:, first:], P[: self.gains, first:]
        K = np.linalg.solve(inner, cross.T).T
        for group in dict.fromkeys(u.group for u in self.unknowns):
            at = [k for k, u in enumerate(self.unknowns) if u.group == group]
            variance = np.einsum("ij,jk,ik->i", K[:, at], inner[np.ix_(at, at)], K[:, at])
            found[group] = np.sqrt(np.maximum(variance, 0.0))
        return found

    def _inverse(self, times: float) -> Array:
        # in units of the prior: m, rad and s together are badly scaled
        scaled = times * self.data * np.outer(self.prior, self.prior) + np.eye(self.prior.size)
        return np.asarray(np.linalg.inv(scaled) * np.outer(self.prior, self.prior))


def bound(rig: Rig, logs: Sequence[Log], gain: Array) -> Bound:
    """RMS of the Cramer-Rao sigma of the normalised gains, with all of the rig's priors, and the oracle's."""
    found, wrenches = information(rig, logs, gain)
    rms = float(np.sqrt(np.mean(np.diag(found.covariance()))))
    return Bound(oracle_rms=oracle_rms(rig, wrenches), rms=rms)


def information(rig: Rig, logs: Sequence[Log], gain: Array) -> tuple[Information, list[Array]]:
    """The Schur complement onto all that is shared of the information of (motion, shared), at the truth.

    The motion is that of splines fitted to what measured it; the truth is taken to be the estimate, payloads
    and gravity are as stated, and clocks agree. The wrench (M, 6) [N, N m] of every log at the samples that
    count is given back, too.
    """
    sensor, n = rig.sensor, rig.sensor.n
    normalised = gain / sensor.gain_unit
    unknowns = unknowns_of(rig, logs)
    offset_prior = assumed_offset_prior(rig)
    pooled = 1 if sensor.pool_offsets else len(logs)
    shared = 6 * n + n * pooled
    total = np.zeros((shared + len(unknowns),) * 2)
    wrenches: list[Array] = []
    for k, log in enumerate(logs):
        # rows of [gain, offset] of one channel together, sorted into all gains, then the offsets of every log
        first = 6 * n + n * (0 if sensor.pool_offsets else k)
        order = np.column_stack([np.arange(6 * n).reshape(n, 6), first + np.arange(n)]).ravel()
        order = np.concatenate([order, np.arange(shared, len(total))])
        pieces = _information(rig, log, k, unknowns, normalised)
        for found, _ in pieces:
            total[np.ix_(order, order)] += found
        wrenches.append(np.concatenate([wrench for _, wrench in pieces] or [np.zeros((0, 6))]))
    prior = np.concatenate(
        [np.full(6 * n, assumed_gain_prior(rig)), np.tile(offset_prior, pooled), [u.prior for u in unknowns]]
    )
    present = prior > 0.0  # an offset without prior is not there
    return Information(total[np.ix_(present, present)], prior[present], 6 * n, tuple(unknowns)), wrenches


def oracle_rms(rig: Rig, wrenches: Sequence[Array]) -> float:
    """RMS of sigma_i^2 (W^T W)^-1 over the normalised gains: motion known, gain and offset alone unknown.

    The wrenches (M, 6) of every log are those at its samples of the sensor; rows with NaN do not count.
    """
    sensor, n = rig.sensor, rig.sensor.n
    offset_prior = assumed_offset_prior(rig)
    noise = sensor.noise_array / sensor.channel_scale
    rows = [w[np.isfinite(w).all(axis=1)] / sensor.range_array for w in wrenches]
    pooled = [np.concatenate(rows)] if sensor.pool_offsets else rows
    variance = 0.0
    for i in range(n):
        # the offset of each log is eliminated from the information on the row
        row = assumed_gain_prior(rig) ** -2.0 * np.eye(6)
        for w in pooled:
            row += w.T @ w / noise[i] ** 2
            if offset_prior[i] > 0.0:
                of_offset = len(w) / noise[i] ** 2 + offset_prior[i] ** -2.0
                row -= np.outer(w.sum(axis=0), w.sum(axis=0)) / noise[i] ** 4 / of_offset
        variance += float(np.trace(np.linalg.inv(row)))
    return float(np.sqrt(variance / (6 * n)))


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """Measurements of the order-th derivative of the coordinates, whitened."""

    time: Array  # (N,) [s]
    order: int  # 0, 1, ...
    rows: Array  # (N, 6, 6) or (6, 6), by the derivative
    lower: Array | None = None  # (N, 6, 6) by the derivative of the order below, or None


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The wrench at the sensor's samples, and by what."""

    wrench: Array  # (M, 6) normalised
    terms: list[Array]  # derivatives (M, 6, 6) by derivatives of the coordinates, the lowest first


def _information(
    rig: Rig, log: Log, number: int, unknowns: Sequence[Unknown], gain: Array
) -> list[tuple[Array, Array]]:
    """Of every unbroken piece: information on the rows of [gain, offset] and the unknowns; wrench (N, 6)."""
    if log.twist is None:
        raise InputError.at(log.path, "", "no twist columns", "vx vy vz wx wy wz")
    moving, sensing = np.isfinite(log.twist).all(axis=1), np.isfinite(log.raw).all(axis=1)
    stamps, streams = log.time[sensing], _motion_streams(rig, log)
    wrench = _wrench_of(rig, log)
    pieces = []
    for piece in segments(log.time[moving]):
        rows = np.flatnonzero(moving)[piece]
        t = log.time[rows]
        inside = stamps[(stamps >= t[0]) & (stamps <= t[-1])]
        if t.size < _SHORTEST or not inside.size:
            continue
        tracking = log.tracking
        if tracking is not None and tracking.reference is not None:
            knots = _uniform(t, 0.5 * tracking.reference.spacing)
            motion = _of_reference(log, tracking.reference)
            linear = _about_reference(wrench, *motion(inside))
        else:
            spacing = smooth_twist(t, log.twist[rows], twist_noise(rig, log)).spacing.min()
            knots = _uniform(t, float(spacing))
            motion = _of_spline(log, make_lsq_spline(t, log.twist[rows], knots, k=_DEGREE))
            linear = _linear(wrench, *motion(inside))
            linear.terms.pop()
        within = [_cut(s, t[0], t[-1]) for s in streams]
        rates = gain @ wrench_rates(rig, log, number, unknowns, inside, motion, wrench)
        information = _piece_information(rig, gain, knots, within, inside, linear, rates)
        pieces.append((information, linear.wrench * rig.sensor.range_array))
    return pieces


def _motion_streams(rig: Rig, log: Log) -> list[_Stream]:
    """What was measured of the coordinates: of the twist, or of the displacement from the reference."""
    if log.tracking is None:
        assert log.twist is not None
        moving = np.isfinite(log.twist).all(axis=1)
        return [_Stream(log.time[moving], 0, np.diag(1.0 / rig.motion.noise_array))]
    streams = []
    for found in tracked_streams(rig, log):
        white = np.linalg.inv(np.linalg.cholesky(found.covariance))
        lower = None if found.coupling is None else white @ found.coupling
        streams.append(_Stream(log.time[found.rows], found.order, white, lower))
    return streams


def _cut(stream: _Stream, begin: float, end: float) -> _Stream:
    chosen = (stream.time >= begin) & (stream.time <= end)
    rows = stream.rows if stream.rows.ndim == 2 else stream.rows[chosen]
    return _Stream(
        stream.time[chosen], stream.order, rows, None if stream.lower is None else stream.lower[chosen]
    )


def _uniform(time: Array, spacing: float) -> Array:
    intervals = max(1, round((time[-1] - time[0]) / spacing))
    knots = time[0] + (time[-1] - time[0]) / intervals * np.arange(-_DEGREE, intervals + _DEGREE + 1)
    knots[-1 - _DEGREE] = time[-1]  # rounding may leave it before the last sample
    return np.asarray(knots)


def _piece_information(
    rig: Rig,
    gain: Array,
    knots: Array,
    streams: Sequence[_Stream],
    stamps: Array,
    linear: _Linear,
    rates: Array,
) -> Array:
    """(7n + m, 7n + m); `rates` (M, n, m): of the channels by the m unknowns."""
    n, sensor = rig.sensor.n, rig.sensor
    noise = sensor.noise_array / sensor.channel_scale
    rates = rates / noise[:, None]
    intervals = knots.size - 2 * _DEGREE - 1
    columns = np.column_stack([linear.wrench, np.ones(stamps.size)])
    weight = gain / noise[:, None]
    at_stamps = [_basis(knots, stamps, order) for order in range(len(linear.terms))]
    band = np.zeros((_BLOCK, 6 * (intervals + _DEGREE)))
    cross = np.zeros((band.shape[1], n, 7))
    by_unknowns = np.zeros((band.shape[1], rates.shape[2]))
    rows, cols = np.tril_indices(_BLOCK)
    edges = knots[_DEGREE : _DEGREE + intervals]
    wrench_starts = np.append(np.searchsorted(stamps, edges), stamps.size)
    of_motion = [_motion_blocks(s, knots, edges) for s in streams]
    for i, (b0, b1) in enumerate(pairwise(wrench_starts)):
        block = np.sum([blocks[i] for blocks in of_motion], axis=0)
        by_coefficients = np.zeros((b1 - b0, 6, _ACTIVE, 6))
        for values, jacobian in zip(at_stamps, linear.terms, strict=True):
            by_coefficients += np.einsum("km,kpc->kpmc", values[b0:b1], jacobian[b0:b1])
        j = weight @ by_coefficients.reshape(b1 - b0, 6, _BLOCK)
        flat = j.reshape(-1, _BLOCK)
        block += flat.T @ flat
        band[rows - cols, 6 * i + cols] += block[rows, cols]
        part = j.reshape(b1 - b0, n * _BLOCK).T @ columns[b0:b1]
        cross[6 * i : 6 * i + _BLOCK] += part.reshape(n, _BLOCK, 7).transpose(1, 0, 2)
        by_unknowns[6 * i : 6 * i + _BLOCK] += flat.T @ rates[b0:b1].reshape(len(flat), rates.shape[2])
    by_shared = np.hstack([(cross / noise[None, :, None]).reshape(len(cross), 7 * n), by_unknowns])
    factor = cholesky_banded(band, lower=True)
    known = _known(noise, columns, rates)
    return np.asarray(known - by_shared.T @ cho_solve_banded((factor, True), by_shared))


def _known(noise: Array, columns: Array, rates: Array) -> Array:
    """Information on the shared parameters where the motion is known."""
    n, m = noise.size, rates.shape[2]
    rows = np.kron(np.diag(noise**-2.0), columns.T @ columns)
    mixed = np.einsum("ka,kim->iam", columns, rates / noise[:, None]).reshape(7 * n, m)
    return np.block([[rows, mixed], [mixed.T, np.einsum("kim,kil->ml", rates, rates)]])


def _motion_blocks(stream: _Stream, knots: Array, edges: Array) -> Array:
    """(intervals, _BLOCK, _BLOCK) of J^T J on every interval."""
    basis = _basis(knots, stream.time, stream.order)
    starts = np.append(np.searchsorted(stream.time, edges), stream.time.size)
    blocks = np.zeros((edges.size, _BLOCK, _BLOCK))
    lower = None if stream.lower is None else _basis(knots, stream.time, stream.order - 1)
    for i, (a, b) in enumerate(pairwise(starts)):
        if stream.rows.ndim == 2:
            blocks[i] = np.kron(basis[a:b].T @ basis[a:b], stream.rows.T @ stream.rows)
            continue
        j = np.einsum("km,kpc->kpmc", basis[a:b], stream.rows[a:b])
        if lower is not None and stream.lower is not None:
            j += np.einsum("km,kpc->kpmc", lower[a:b], stream.lower[a:b])
        flat = j.reshape(-1, _BLOCK)
        blocks[i] = flat.T @ flat
    return blocks


def _basis(knots: Array, at: Array, derivative: int) -> Array:
    """Derivatives (N, 6) of the six quintic B-splines on uniform knots that are not zero at each time."""
    step, degree = knots[1] - knots[0], _DEGREE - derivative
    inner = knots[derivative : knots.size - derivative]
    values = BSpline.design_matrix(at, inner, degree).data.reshape(-1, degree + 1)
    for _ in range(derivative):
        values = (np.pad(values, ((0, 0), (1, 0))) - np.pad(values, ((0, 0), (0, 1)))) / step
    return np.asarray(values)


def _gravity(log: Log, at: Array) -> Array:
    if log.gravity is None:
        return np.zeros((at.size, 3))
    rows = np.isfinite(log.gravity).all(axis=1)
    return np.column_stack([np.interp(at, log.time[rows], g) for g in log.gravity[rows].T])


def _of_spline(log: Log, spline: BSpline) -> Motion:
    """The motion of a log whose twist is a spline."""

    def motion(at: Array) -> tuple[Array, Array, Array]:
        return spline(at), spline(at, nu=1), _gravity(log, at)

    return motion


def _of_reference(log: Log, reference: Reference) -> Motion:
    """The motion of the reference of a log, by the time of the log."""
    since = 1e-9 * float(log.time_ns[0] - reference.origin_ns)
    return lambda at: reference.motion(at + since)


def _wrench_of(rig: Rig, log: Log) -> Wrench:
    """Of twist, derivative and free fall: the normalised wrench (M, 6)."""
    return lambda nu, a, g: payload_wrench(rig, log.payload, nu, a, g) / rig.sensor.range_array


def _about_reference(wrench: Wrench, nu: Array, a: Array, gravity: Array) -> _Linear:
    """At the reference, by displacements p from it: nu = nu0 + ad(nu0) p + dp/dt, a its derivative."""
    linear = _linear(wrench, nu, a, gravity)
    by_twist, by_acceleration, by_gravity = linear.terms
    turned = np.zeros_like(by_twist)
    turned[:, :, 3:] = by_gravity[:, :, :3] @ cross_matrix(gravity)
    lowest = by_twist @ twist_adjoint(nu) + by_acceleration @ twist_adjoint(a) + turned
    return _Linear(linear.wrench, [lowest, by_twist + by_acceleration @ twist_adjoint(nu), by_acceleration])


def _linear(wrench: Wrench, nu: Array, a: Array, gravity: Array) -> _Linear:
    """By twist, acceleration, and (in three of six columns) gravity."""
    terms = [np.zeros((len(nu), 6, 6)) for _ in range(3)]
    none = np.zeros(6)
    for c, e in enumerate(np.eye(6)):  # quadratic in nu, linear in a and g: central differences are exact
        for term, (dn, da, dg) in zip(
            terms, ((e, none, none), (none, e, none), (none, none, e)), strict=True
        ):
            if c < 3 or not dg.any():
                ahead, back = (wrench(nu + s * dn, a + s * da, gravity + s * dg[:3]) for s in (1.0, -1.0))
                term[:, :, c] = 0.5 * (ahead - back)
    return _Linear(wrench(nu, a, gravity), terms)
