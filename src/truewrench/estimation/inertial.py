"""The payload's wrench by a motion estimated from its measurements alone, and how uncertain that makes it.

No raw sample enters: what the sensor reads can be held against it. Each component of the twist (of joints, of
the displacement that the encoders show; of an IMU, of specific force and rate of turn) is a quintic spline,
linear in its samples, so that their noise is carried through to the wrench exactly, in time, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import diags_array

from truewrench import _core
from truewrench.estimation.motion_noise import twist_noise
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import DEGREE, segments, smooth_twist, uniform_knots, uniform_spline
from truewrench.model.motion.spatial import twist_adjoint
from truewrench.model.payload import core_payload, lever, payload_wrench
from truewrench.model.rig import Rig
from truewrench.robot.track import tracked_streams

_FINER = 1.5  # knots than the coarsest that pass: their bias would count as an error of the sensor
_CHANCE = 3.0  # sigma of the fall of chi-square by halved knots that chance explains
_CHUNK = 1500  # rows of a spline, unless that is less than
_CHUNK_SECONDS = 4.0
_SHORTEST = 24  # rows
_MOST = 60_000  # rows of a log that are looked at, in chunks spread over it
_LAGGED = 24  # rows per chunk at which covariances in time are taken
_PERIODS = 1e-3  # of a chunk: step of the derivative by time


@dataclass(frozen=True, slots=True, eq=False)
class InertialChunk:
    """A stretch of a log."""

    rows: Integers  # (M,) rows of the log with every raw channel
    wrench: Array  # (M, 6) with the sign of the rig [N, N m]
    rate: Array  # (M, 6) its derivative by time [N/s, N m/s]
    twist: Array  # (M, 6) of the logged point; by an IMU, of a frame that moves with it
    acceleration: Array  # (M, 6)
    gravity: Array  # (M, 3); by an IMU 0: it is in the specific force
    variance: Array  # (M, 6) of the wrench, by the noise of the velocities
    lagged: Integers  # (S,) positions among the rows
    covariance: Array  # (S, H + 1, 6) of the wrench there with that 0 ... H rows later


class InertialMotion:
    """The motion of a log by its measurements: a spline per component and chunk, fitted once for all times.

    With `body`, what the payload was found to be; else as stated. Refused: a log without a twist, or without
    gravity where gravity acts; of an IMU, one without its columns.
    """

    def __init__(self, rig: Rig, log: Log, body: _core.Payload | None = None) -> None:
        if rig.motion.source != "imu":
            if log.twist is None:
                raise InputError.at(log.path, "", "no twist columns", "vx vy vz wx wy wz")
            if log.gravity is None and rig.in_gravity:
                expected = "gx gy gz, which a twist in gravity needs"
                raise InputError.at(log.path, "", "no gravity columns", expected)
        self._rig, self._payload = rig, log.payload
        self._body = body or core_payload(rig.payloads[log.payload])
        self._sensed = np.flatnonzero(np.isfinite(log.raw).all(axis=1))
        self._time = log.time[self._sensed]
        self._coordinates = _coordinates(rig, log)
        self._pieces = list(_pieces([stream.time for stream in self._coordinates.streams]))
        self._fits: dict[int, list[_Spline]] = {}  # by piece, those that were asked for

    def wrench(self, time_offset: float, lags: int) -> list[InertialChunk]:
        """The wrench where every raw channel has a sample, with t_motion = t_sensor + time_offset [s].

        `lags` is H, the longest of `covariance`.
        """
        found = []
        at = self._time + time_offset
        for k, piece in enumerate(self._pieces):
            ends = piece.ends
            inside = (at >= ends[0]) & (at <= ends[1])
            if np.count_nonzero(inside) > max(_SHORTEST, 2 * lags):
                if k not in self._fits:
                    self._fits[k] = self._fitted(piece)
                found.append(self._chunk(self._fits[k], self._sensed[inside], at[inside], ends, lags))
        return found

    def _fitted(self, piece: _Piece) -> list[_Spline]:
        fits = []
        for stream, rows in zip(self._coordinates.streams, piece.rows, strict=True):
            time, values, noise = stream.time[rows], stream.values[rows], stream.noise[rows]
            smooth = smooth_twist(time, values, noise)
            spacing = np.minimum(smooth.spacing, self._coordinates.widest)
            fits += [
                _Spline(time, column, sigma, _resolved(time, column, factor * sigma, coarse))
                for column, sigma, factor, coarse in zip(
                    values.T, noise.T, smooth.factor, spacing, strict=True
                )
            ]
        return fits

    def _chunk(
        self, fits: Sequence[_Spline], rows: Integers, at: Array, ends: tuple[float, float], lags: int
    ) -> InertialChunk:
        rig, payload, body, order = self._rig, self._payload, self._body, self._coordinates.order

        def motion(t: Array) -> tuple[Array, Array, Array, Array]:
            splines = [np.column_stack([fit.spline(t, nu=d) for fit in fits]) for d in range(3)]
            nu, a, g = self._coordinates.motion(t, np.array(splines))
            return nu, a, g, payload_wrench(rig, payload, nu, a, g, body)

        nu, a, g, wrench = motion(at)
        step = _PERIODS * (ends[1] - ends[0])
        before, after = (np.clip(at + by, *ends) for by in (-step, step))
        rate = (motion(after)[-1] - motion(before)[-1]) / (after - before)[:, None]

        shift = _core.twist_shift(lever(rig, payload, body))
        by_a, by_nu = _core.payload_jacobians(body, np.ascontiguousarray(nu @ shift.T))
        by_a, by_nu = by_a @ shift, by_nu @ shift
        if self._coordinates.felt:
            by_nu[..., :3], by_a[..., :3] = by_a[..., :3], 0.0
        variance = np.zeros((at.size, 6))
        lagged = np.unique(np.linspace(0, at.size - lags - 1, _LAGGED).astype(int))
        later = lagged[:, None] + np.arange(lags + 1)  # (S, H + 1)
        covariance = np.zeros((lagged.size, lags + 1, 6))
        for j, fit in enumerate(fits):
            n_, a_ = by_nu[:, :, j], by_a[:, :, j]  # (M, 6)
            of = fit.derivatives(at, order)
            same = of.covariance(np.arange(at.size), np.arange(at.size))
            variance += n_**2 * same[0, 0] + n_ * a_ * (same[0, 1] + same[1, 0]) + a_**2 * same[1, 1]
            apart = of.covariance(lagged[:, None], later)
            for x, first in enumerate((n_, a_)):
                for y, second in enumerate((n_, a_)):
                    covariance += first[lagged][:, None] * second[later] * apart[x, y]
        return InertialChunk(rows, wrench, rate, nu, a, g, variance, lagged, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """Coordinates that are measured together."""

    time: Array  # (N,) [s]
    values: Array  # (N, k)
    noise: Array  # (N, k) 1 sigma, their correlation left out


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """A stretch without a gap."""

    rows: tuple[slice, ...]  # of each stream
    ends: tuple[float, float]  # between which all of them tell [s]


@dataclass(frozen=True, slots=True, eq=False)
class _Coordinates:
    """What splines are fitted to: the twist, or about a reference the displacement from it."""

    streams: tuple[_Stream, ...]  # six coordinates in all
    widest: float  # knots that the splines may have [s]
    order: int  # of the derivative that is the twist
    felt: bool  # the first three are the specific force, which stands where the twist's derivative does
    # of times (M,), to which the coordinates and their next two derivatives (3, M, 6) add
    motion: Callable[[Array, Array], tuple[Array, Array, Array]]


def _coordinates(rig: Rig, log: Log) -> _Coordinates:
    if rig.motion.source == "imu":
        return _of_imu(rig, log)
    tracking = log.tracking
    if tracking is None or tracking.reference is None or tracking.position_sigma is not None:
        assert log.twist is not None
        rows = np.flatnonzero(np.isfinite(log.twist).all(axis=1))
        gravity = None if log.gravity is None else _gravity(log)

        def plain(t: Array, s: Array) -> tuple[Array, Array, Array]:
            return s[0], s[1], np.zeros((t.size, 3)) if gravity is None else np.asarray(gravity(t))

        if tracking is not None and tracking.reference is None:
            noise = _sigma(tracked_streams(rig, log)[0].covariance)
        else:
            noise = np.broadcast_to(twist_noise(rig, log), (rows.size, 6))
        stream = _Stream(log.time[rows], log.twist[rows], noise)
        return _Coordinates((stream,), np.inf, 0, False, plain)
    reference = tracking.reference
    origin = 1e-9 * float(log.time_ns[0] - reference.origin_ns)
    encoders = tracked_streams(rig, log)[0]

    def displaced(t: Array, s: Array) -> tuple[Array, Array, Array]:
        nu, a, g = reference.motion(t + origin)
        p, dp, ddp = s
        turn = twist_adjoint(nu)
        return (
            nu + _times(turn, p) + dp,
            a + _times(twist_adjoint(a), p) + _times(turn, dp) + ddp,
            g + np.cross(g, p[:, 3:]),
        )

    widest = 0.5 * reference.spacing  # docs/method.md, "Joints"
    stream = _Stream(log.time[encoders.rows], encoders.value, _sigma(encoders.covariance))
    return _Coordinates((stream,), widest, 1, False, displaced)


def _of_imu(rig: Rig, log: Log) -> _Coordinates:
    """In a frame at the sensor's origin, at rest at every moment: a_s = vdot + Omega x v - g (10.6)."""
    force, omega, still = log.specific_force, log.angular_velocity, np.zeros(3)
    if force is None or omega is None:
        expected = "accel_x accel_y accel_z wx wy wz"
        raise InputError.at(log.path, "", "no columns of an IMU", expected)
    streams = []
    for values, noise in ((force, rig.motion.acceleration_noise or ()), (omega, rig.motion.noise_array)):
        rows = np.flatnonzero(np.isfinite(values).all(axis=1))
        streams.append(_Stream(log.time[rows], values[rows], np.broadcast_to(noise, (rows.size, 3))))

    def felt(t: Array, s: Array) -> tuple[Array, Array, Array]:
        none = np.broadcast_to(still, (t.size, 3))
        return np.hstack([none, s[0, :, 3:]]), np.hstack([s[0, :, :3], s[1, :, 3:]]), none

    return _Coordinates(tuple(streams), np.inf, 0, True, felt)


def _sigma(covariance: Array) -> Array:
    """1 sigma (N, 6) of samples, none of them zero: an axis that a joint turns about sees nothing of it."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return np.asarray(np.sqrt(variance + 1e-12 * variance.max()))


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("kij,kj->ki", matrices, vectors))


def _chunks(time: Array) -> Iterator[slice]:
    """Stretches without a gap, short enough for one spline each; of a long record a share of them."""
    chunks = []
    for piece in segments(time):
        size = piece.stop - piece.start
        if size < _SHORTEST:
            continue
        rate = (size - 1) / (time[piece.stop - 1] - time[piece.start])
        count = max(1, round(size / max(_CHUNK, _CHUNK_SECONDS * rate)))
        edges = np.linspace(piece.start, piece.stop, count + 1).astype(int)
        chunks += [slice(int(a), int(b)) for a, b in pairwise(edges)]
    total = sum(c.stop - c.start for c in chunks)
    keep = max(1, round(len(chunks) * min(1.0, _MOST / max(total, 1))))
    for k in np.unique(np.linspace(0, len(chunks) - 1, keep).astype(int)) if chunks else ():
        yield chunks[k]


def _pieces(times: Sequence[Array]) -> Iterator[_Piece]:
    """Chunks of the first of some streams, cut where another has a gap."""
    for chunk in _chunks(times[0]):
        found = [(float(times[0][chunk.start]), float(times[0][chunk.stop - 1]))]
        for other in times[1:]:
            inside = [other[_between(other, ends)] for ends in found]
            found = [(float(t[p.start]), float(t[p.stop - 1])) for t in inside if t.size for p in segments(t)]
        for ends in found:
            rows = tuple(_between(t, ends) for t in times)
            if min(r.stop - r.start for r in rows) >= _SHORTEST:
                first = max(float(t[r.start]) for t, r in zip(times, rows, strict=True))
                last = min(float(t[r.stop - 1]) for t, r in zip(times, rows, strict=True))
                yield _Piece(rows, (first, last))


def _between(time: Array, ends: tuple[float, float]) -> slice:
    return slice(int(np.searchsorted(time, ends[0])), int(np.searchsorted(time, ends[1], side="right")))


def _gravity(log: Log) -> PchipInterpolator:
    assert log.gravity is not None
    rows = np.isfinite(log.gravity).all(axis=1)
    if np.count_nonzero(rows) < 2:
        raise InputError.at(log.path, "gx gy gz", f"{np.count_nonzero(rows)} complete rows", "at least 2")
    return PchipInterpolator(log.time[rows], log.gravity[rows], axis=0)


def _resolved(time: Array, values: Array, sigma: Array, spacing: float) -> float:
    """The coarsest spacing not above a given one that halving would not improve by more than chance.

    Residuals of the size of their noise are not enough: among thousands of samples they hide a bias that the
    acceleration, times a mass, shows far above the noise of a good sensor.
    """

    def chi_square(intervals: int) -> float:
        return float(np.sum(((values - uniform_spline(time, values, intervals, sigma)(time)) / sigma) ** 2))

    span = time[-1] - time[0]
    intervals, finest = max(1, round(span / spacing)), max(1, time.size // 3 - DEGREE)
    while 2 * intervals <= finest:
        fall = chi_square(intervals) - chi_square(2 * intervals)
        if fall <= intervals + _CHANCE * np.sqrt(2.0 * intervals):
            break
        intervals = max(intervals + 1, int(np.ceil(intervals * 4 / 3)))
    return float(span / intervals)


class _Spline:
    """A least-squares spline through samples, each with its sigma (N,)."""

    def __init__(self, time: Array, values: Array, sigma: Array, spacing: float) -> None:
        intervals = round(_FINER * (time[-1] - time[0]) / spacing)
        intervals = max(1, min(intervals, time.size // 3 - DEGREE))
        self._knots = uniform_knots(time, intervals)
        design = diags_array(1.0 / sigma) @ BSpline.design_matrix(time, self._knots, DEGREE)
        normal = (design.T @ design).toarray()
        normal += 1e-12 * np.trace(normal) * np.eye(len(normal))
        self._covariance = np.asarray(cho_solve(cho_factor(normal), np.eye(len(normal))))
        self.spline = BSpline(self._knots, self._covariance @ np.asarray(design.T @ (values / sigma)), DEGREE)

    def derivatives(self, at: Array, order: int) -> _Derivatives:
        """A derivative and the next one at times (M,)."""
        first, basis = _basis(self._knots, at, order)
        return _Derivatives(self._covariance, first, np.stack([basis, _basis(self._knots, at, order + 1)[1]]))


@dataclass(frozen=True, slots=True, eq=False)
class _Derivatives:
    """Two derivatives of a spline with uncertain coefficients, at M times."""

    of_coefficients: Array  # (p, p) their covariance
    first: Integers  # (M,) of the coefficients that act at a time
    basis: Array  # (2, M, DEGREE + 1) by which

    def covariance(self, rows: Integers, others: Integers) -> Array:
        """(2, 2, ..., 1) between derivatives at rows and at others, of shapes that broadcast."""
        active = np.arange(DEGREE + 1)
        at, there = (self.first[k][..., None] + active for k in (rows, others))
        between = self.of_coefficients[at[..., :, None], there[..., None, :]]
        found = np.einsum("x...i,...ij,y...j->xy...", self.basis[:, rows], between, self.basis[:, others])
        return np.asarray(found)[..., None]


def _basis(knots: Array, at: Array, order: int) -> tuple[Integers, Array]:
    """(M,) the first basis function that acts at a time; (M, DEGREE + 1) a derivative of all that do."""
    degree = DEGREE - order
    inner = knots[order : len(knots) - order]
    design = BSpline.design_matrix(at, inner, degree)
    first = design.indices.reshape(at.size, degree + 1)[:, 0].astype(np.int64)
    basis = design.data.reshape(at.size, degree + 1)
    for k in range(degree + 1, DEGREE + 1):  # each derivative is a difference of splines one degree lower
        inner = knots[DEGREE - k : len(knots) - DEGREE + k]
        ahead = first[:, None] + np.arange(k) + 1
        slope = k * basis / (inner[ahead + k] - inner[ahead])
        basis = np.pad(slope, ((0, 0), (1, 0))) - np.pad(slope, ((0, 0), (0, 1)))
    return first, basis
