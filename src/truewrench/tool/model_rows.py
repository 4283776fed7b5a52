"""What poses, motion and known figures say of theta: residuals, derivatives, and the offset's walk.

The vector x is theta in the order of `Layout`, then, where there are any, the ten of a body that was there
before and its offset, the offsets of all logs but the last, those where moves between dwells begin and end,
and the slope of the offset with temperature.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from truewrench import _core
from truewrench.estimation.static_poses import Move, Poses
from truewrench.model.arrays import Array, Integers
from truewrench.model.motion.spatial import cross, cross_matrix
from truewrench.model.rig import Rig
from truewrench.tool.bodies import total_body, weight
from truewrench.tool.parameters import ELEMENTS, Layout, channel_turn, symmetric, tilted
from truewrench.tool.prior import Prior

_EXACT = 1e-6  # of range: 1 sigma of a link beside the walk, which a knot at the end of its log has none of


@dataclass(frozen=True, slots=True)
class Vector:
    """Places in x beyond those of `Layout`."""

    n: int
    logs: int
    on: bool = False
    warm: bool = False
    session: bool = False
    knots: int = 0  # of moves whose offset walks

    @property
    def layout(self) -> Layout:
        """Of theta."""
        return Layout(self.n)

    @property
    def before(self) -> slice:
        """Ten of the body that was there before."""
        return slice(self.layout.size, self.layout.size + 10 * self.on)

    @property
    def carried(self) -> slice:
        """Its offset, where the logs are of one session with it: n."""
        return slice(self.before.stop, self.before.stop + self.n * self.session)

    def offset(self, log: int) -> slice:
        """Offset at the end of a log: n."""
        if log == self.logs - 1:
            return self.layout.offset
        start = self.carried.stop + self.n * log
        return slice(start, start + self.n)

    def knot(self, k: int) -> slice:
        """Offset where a move begins, or ends, of those whose offset walks: n."""
        start = self.carried.stop + self.n * (self.logs - 1 + k)
        return slice(start, start + self.n)

    @property
    def slope(self) -> slice:
        """Of the offset, per K: n."""
        start = self.knot(self.knots).start
        return slice(start, start + self.n * self.warm)

    @property
    def shared(self) -> Integers:
        """Of what all logs have in common, a slope apart: all but offsets."""
        own = np.r_[self.layout.offset, self.before.stop : self.slope.start]
        return np.setdiff1d(np.arange(self.slope.start), own)

    @property
    def size(self) -> int:
        """Of x."""
        return int(self.slope.stop)


def about_center(y: Array, n: int) -> tuple[Array, Array]:
    """What y [gain G (6n), log m, c, inertia, ...] is with m G T(c) and inertia / m, and its derivative.

    T takes a wrench at the centre of mass to the sensor's origin. Of a motion the channels show m G T(c),
    whose weight is felt: in it they are nearly linear, where the product of gain and mass, gain and centre
    of mass bends within the little that a long record leaves uncertain.
    """
    G, mass, c = y[: 6 * n].reshape(n, 6), float(np.exp(y[6 * n])), y[6 * n + 1 : 6 * n + 4]
    T = np.eye(6)
    T[3:, :3] = cross_matrix(c[None])[0]
    K = mass * G @ T
    out, J = y.copy(), np.eye(y.size)
    center, inertia = slice(6 * n + 1, 6 * n + 4), slice(6 * n + 4, 6 * n + 10)
    out[: 6 * n], out[inertia] = K.ravel(), y[inertia] / mass
    J[: 6 * n, : 6 * n] = np.kron(np.eye(n), mass * T.T)
    J[: 6 * n, 6 * n] = K.ravel()
    for k, e in enumerate(cross_matrix(np.eye(3))):
        turned = np.zeros((n, 6))
        turned[:, :3] = mass * G[:, 3:] @ e
        J[: 6 * n, center.start + k] = turned.ravel()
    J[inertia, inertia] /= mass
    J[inertia, 6 * n] = -out[inertia]
    return out, J


@dataclass(frozen=True, slots=True, eq=False)
class MotionInformation:
    """What moves say of y = [gain with mounting (6n), log m, c, inertia, offsets of moves, slope, tilt (2)].

    The first of these as `about_center` has them; offsets at the knots of each log, or its own; the slope (n)
    with the temperature where `warm_moves`.

    log p(data | y) = -(y - at)^T information (y - at) / 2 + gradient^T (y - at)
    """

    at: Array  # of the last linearisation [raw units, SI]
    information: Array  # symmetric, positive semidefinite
    gradient: Array  # there


@dataclass(frozen=True, slots=True)
class Link:
    """The offset at the end of a log, and the same as the walk brought it from, or to, another time."""

    log: int  # which log
    place: slice  # of the other offset in x
    time_ns: int  # of that


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Data and prior of one identification; `motion` is what the `moves` say."""

    rig: Rig
    prior: Prior
    poses: Poses
    end_ns: Sequence[int]
    moves: Sequence[Move] = ()
    motion: MotionInformation | None = None

    @property
    def normal_in_product(self) -> bool:
        """Whether `motion` is what is known beforehand of product and body, and no data of either."""
        return False

    @property
    def vector(self) -> Vector:
        """Places in x."""
        warm = self.rig.temperature.prior > 0.0 and bool(np.isfinite(self.poses.temperature).any())
        warm |= self.warm_moves
        session = self.prior.session_ns is not None
        knots = sum(move.knots.size for move in self.moves)
        return Vector(self.rig.sensor.n, len(self.end_ns), self.prior.on, warm, session, knots)

    @property
    def warm_moves(self) -> bool:
        """Whether motion tells how the offset follows the temperature."""
        told = (move.record.temperature for move in self.moves)
        known = any(celsius is not None and np.isfinite(celsius).any() for celsius in told)
        return known and self.rig.temperature.prior > 0.0

    @property
    def priors_of_motion(self) -> tuple[Array, float]:
        """1 sigma of the gain, which holds the mounting where motion is read (n, 6), and of tilt [rad]."""
        layout, sensor = self.vector.layout, self.rig.sensor
        sigma = np.sqrt(np.diag(self.prior.covariance))
        span = 1.0 / sensor.gain_unit
        gain_std = np.hypot(sigma[layout.gain].reshape(-1, 6), sigma[layout.mounting].max() / span)
        return gain_std, float(sigma[layout.tilt].max())

    def offsets_of_moves(self) -> list[slice]:
        """Places in x of the offsets that `MotionInformation` is of."""
        v, free, out = self.vector, count(), []
        for move in self.moves:
            out += [v.knot(next(free)) for _ in move.knots] or [v.offset(move.log)]
        return out

    def prior_of_all(self) -> tuple[Array, Array]:
        """Mean (p,) and covariance (p, p) of x."""
        v, sensor = self.vector, self.rig.sensor
        count = len(self.prior.mean)
        mean, P = np.zeros(v.size), np.zeros((v.size, v.size))
        mean[:count], P[:count, :count] = self.prior.mean, self.prior.covariance
        for place in (*(v.offset(log) for log in range(v.logs - 1)), *(v.knot(k) for k in range(v.knots))):
            at = np.arange(place.start, place.stop)
            P[at, at] = np.maximum(sensor.offset_prior_array, 1e-9 * sensor.channel_scale) ** 2
        at = np.arange(v.slope.start, v.slope.stop)
        P[at, at] = (self.rig.temperature.prior * sensor.channel_scale[: at.size]) ** 2
        return mean, P

    def links(self) -> list[Link]:
        """Between offsets of one session first, then from each knot of a move to its log's end."""
        knots, v = [(move.log, int(at)) for move in self.moves for at in move.knots_ns], self.vector
        return [*self.session_links(), *(Link(log, v.knot(k), at) for k, (log, at) in enumerate(knots))]

    def session_links(self) -> list[Link]:
        """From each log's offset to that of the log, or of the tool below, before it, in one session."""
        if not self.rig.sensor.pool_offsets:
            return []
        v, out = self.vector, []
        before = None if self.prior.session_ns is None else (v.carried, self.prior.session_ns)
        for log in sorted(range(v.logs), key=lambda k: self.end_ns[k]):
            if before is not None:
                out.append(Link(log, *before))
            before = v.offset(log), self.end_ns[log]
        return out

    def of_links(self, x: Array) -> tuple[Array, Array]:
        """Zero less the way between the offsets of each link (L, n), a walk, and its derivative (n, L, p)."""
        v, links = self.vector, self.links()
        r, J = np.zeros((len(links), v.n)), np.zeros((v.n, len(links), v.size))
        channels = np.arange(v.n)
        for k, link in enumerate(links):
            r[k] = x[link.place] - x[v.offset(link.log)]
            J[channels, k, v.offset(link.log).start + channels] = 1.0
            J[channels, k, link.place.start + channels] = -1.0
        return r, J

    def motion_of(self, x: Array) -> tuple[Array, Array]:
        """Gain with the mounting (n, 6) and body as (log m, c, inertia) (10,), as motion is read about x."""
        turn = np.kron(np.eye(2), channel_turn(x[self.vector.layout.mounting])[0])
        return x[self.vector.layout.gain].reshape(-1, 6) @ turn, self.total(x)[0]

    def total(self, x: Array) -> tuple[Array, Array]:
        """The body that the sensor carries as (log m, c, inertia) (10,), and its derivative (10, p)."""
        v = self.vector
        places = [np.arange(v.layout.body.start, v.layout.body.stop)]
        if v.on:
            places.append(np.arange(v.before.start, v.before.stop))
        at = np.concatenate(places)
        body, jacobian = total_body(x[at].reshape(-1, 10))
        out = np.zeros((10, v.size))
        out[:, at] = jacobian
        return body, out

    def of_poses(self, x: Array) -> tuple[Array, Array]:
        """Readings (T, n) that x predicts, without the walk, and their derivative (n, T, p)."""
        v, poses, rig = self.vector, self.poses, self.rig
        n, layout, T = v.n, v.layout, len(poses)
        C, sign = x[layout.gain].reshape(n, 6), rig.sensor.sign
        R, dR = channel_turn(x[layout.mounting])
        fall_root, by_tilt = tilted(rig.gravity_array, x[layout.tilt])
        fall = poses.R_sensor_root @ fall_root
        body, by_x = self.total(x)
        mass, c = float(np.exp(body[0])), body[1:4]
        w = sign * weight(mass, c, fall)

        def turned(R: Array, w: Array) -> Array:
            return np.concatenate([w[..., :3] @ R.T, w[..., 3:] @ R.T], axis=-1)

        felt = turned(R, w)
        J = np.zeros((n, T, v.size))
        for i in range(n):
            J[i, :, 6 * i : 6 * i + 6] = felt
            for log in range(v.logs):
                J[i, poses.log == log, v.offset(log).start + i] = 1.0
        body_w = np.zeros((T, 6, 4))  # by log m and c
        body_w[:, :, 0] = w
        for k, e in enumerate(np.eye(3)):
            body_w[:, 3:, 1 + k] = sign * mass * cross(e, fall)
        of_body = np.einsum(
            "ij,tjk,kp->itp", C, turned(R, body_w.transpose(0, 2, 1)).transpose(0, 2, 1), by_x[:4]
        )
        J += of_body
        for k in range(3):
            J[:, :, layout.mounting.start + k] += C @ turned(dR[k], w).T
        for k in range(2):
            step = sign * weight(mass, c, poses.R_sensor_root @ by_tilt[:, k])
            J[:, :, layout.tilt.start + k] += C @ turned(R, step).T
        y = felt @ C.T
        for log in range(v.logs):
            y[poses.log == log] += x[v.offset(log)]
        if v.warm:
            above = np.nan_to_num(poses.temperature - rig.temperature.reference)
            y = y + above[:, None] * x[v.slope]
            for i in range(n):
                J[i, :, v.slope.start + i] = above
        return y, J

    def of_motion(self, x: Array) -> tuple[Array, Array]:
        """Y of `MotionInformation` that x stands for, and its derivative (y, p)."""
        assert self.motion is not None
        v = self.vector
        n, layout = v.n, v.layout
        C = x[layout.gain].reshape(n, 6)
        R, dR = channel_turn(x[layout.mounting])
        zero = np.zeros((3, 3))
        R6 = np.block([[R, zero], [zero, R]])
        gain = np.zeros((6 * n, v.size))
        for i in range(n):
            gain[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = R6.T
        for k in range(3):
            turn = np.block([[dR[k], zero], [zero, dR[k]]])
            gain[:, layout.mounting.start + k] = (C @ turn).ravel()
        body, by_x = self.total(x)
        parts, jacobians = [(C @ R6).ravel(), body], [gain, by_x]
        slope = [v.slope] if self.warm_moves else []
        for place in (*self.offsets_of_moves(), *slope, layout.tilt):
            parts.append(x[place])
            jacobians.append(np.eye(v.size)[place])
        y, by_y = about_center(np.concatenate(parts), n)
        return y, by_y @ np.vstack(jacobians)

    def changes(self, x: Array, std: Array) -> Array:
        """D w / dx w^-1 (p, 6, 6) of the wrench w that the gain is told by, in the channels' axes.

        It is taken at x (p,), whose 1 sigma is std (p,).
        """
        body, by_x = self.total(x)
        R6 = np.kron(np.eye(2), channel_turn(x[self.vector.layout.mounting])[0])
        spread = float(np.sqrt(np.mean((by_x[4:7] * std) ** 2) * len(std)))
        payload = _core.Payload(float(np.exp(body[0])), body[1:4], symmetric(body[4:]))
        L = R6 @ _core.body_changes(payload, spread) @ R6.T
        return np.asarray(np.einsum("kp,kab->pab", by_x, L))

    def of_known(self, x: Array) -> tuple[Array, Array]:
        """What is stated of the tool less what x says, over its sigma, and the derivative of x's part."""
        v = self.vector
        place = np.arange(v.layout.body.start, v.layout.body.stop)
        body, jacobian = total_body(x[place].reshape(1, 10))
        names = ("mass", *(f"center_of_mass.{a}" for a in "xyz"), *(f"inertia.{e}" for e in ELEMENTS))
        r, J = [], []
        for name, (value, sigma) in self.prior.known.items():
            k = names.index(name)
            row = np.zeros(v.size)
            if name == "mass":
                r.append((np.log(value) - body[0]) * value / sigma)
                row[place] = jacobian[0] * value / sigma
            else:
                r.append((value - body[k]) / sigma)
                row[place] = jacobian[k] / sigma
            J.append(row)
        return np.array(r), np.array(J).reshape(len(r), v.size)

    def walked(self, linked: bool = False) -> Array:
        """(T, T) covariance of a walk of 1 per sqrt(s) that is zero at the end of each log.

        If `linked`, (T + L, T + L), `links` after the poses.
        """
        links = self.links() if linked else []
        time = np.append(self.poses.time_ns, np.array([one.time_ns for one in links], dtype=np.int64))
        log = np.append(self.poses.log, np.array([one.log for one in links], dtype=np.int64))
        end = np.array(self.end_ns, dtype=np.int64)[log]
        away = np.abs(end - time) * 1e-9
        K: Array = np.minimum(away[:, None], away) * (log[:, None] == log)
        at = np.arange(len(self.poses))
        K[at, at] -= self.poses.seconds / 6.0  # of a mean over T, from T / 2 before to T / 2 after
        return K

    def roots(self, rate: float, repeatability: float, K: Array) -> Array:
        """Cholesky factors (n, N, N) of every channel's covariance of the readings.

        The rate is that of the walk, fraction of range per sqrt(s), the repeatability 1 sigma of a pose,
        fraction of range, and K (N, N) comes of `walked`.
        """
        scale, T = self.rig.sensor.channel_scale, len(self.poses)
        own = np.full((len(scale), len(K)), _EXACT**2) * scale[:, None] ** 2
        own[:, :T] = self.poses.variance.T + (repeatability * scale[:, None]) ** 2
        V = (rate * scale[:, None, None]) ** 2 * K
        at = np.arange(len(K))
        V[:, at, at] += own
        return np.asarray(np.linalg.cholesky(V), np.float64)


def whitened(roots: Array, values: Array) -> Array:
    """L^-1 values (n, N, k) of every channel."""
    return np.asarray(np.linalg.solve(roots, values), np.float64)
