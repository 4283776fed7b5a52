"""The arm as a product of exponentials: motion of the sensor frame and its derivatives, many rows at once.

    g(q) = exp([xi_1] q_1) ... exp([xi_n] q_n) g(0)
    J_i  = Ad(exp([xi_i] q_i) ... exp([xi_n] q_n) g(0))^-1 xi_i

J_i is the i-th column of the Jacobian in sensor axes, nu = sum J_i qd_i. A joint moves what is nearer to the
root past the sensor and nothing beyond itself: for any twist y of the links before joint i, in sensor axes,

    dy/dq_i = [y, J_i],     [x, y] = (x.Omega x y.v + x.v x y.Omega,  x.Omega x y.Omega)

so that the twist, its derivative, and their Jacobians by q, qd and qdd are sums of brackets. Pinocchio gives
the screws once and judges the sums in the tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truewrench.robot.arm import Robot

__all__ = ["ScrewMotion", "Screws"]

Array = NDArray[np.float64]

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
_CHUNK = 1024  # rows whose intermediate values stay in the cache


@dataclass(frozen=True, slots=True, eq=False)
class ScrewMotion:
    """How the sensor frame moves, in N rows, and how that depends on M joints.

    Attributes:
        twist: (N, 6) nu of the sensor's origin, sensor axes [m/s, rad/s].
        acceleration: (N, 6) a, its component-wise derivative.
        R_root_sensor: (N, 3, 3) turns sensor coordinates into those of the root.
        jacobian: (N, 12, 3 M) of [nu; a] by (q, qd, qdd).
    """

    twist: Array
    acceleration: Array
    R_root_sensor: Array
    jacobian: Array


@dataclass(frozen=True, slots=True, eq=False)
class Screws:
    """The chain of M joints from the root to the sensor frame.

    Attributes:
        xi: (M, 6) twist of unit joint speed at q = 0, of the root's origin, root axes.
        R: (3, 3) R_root_sensor at q = 0.
        p: (3,) p_root_sensor at q = 0 [m].
    """

    xi: Array
    R: Array
    p: Array

    @classmethod
    def of(cls, robot: Robot) -> Screws:
        """The screws of a robot's chain."""
        import pinocchio as pin

        data, q = robot.model.createData(), np.zeros(robot.n)
        xi = pin.computeFrameJacobian(robot.model, data, q, robot.frame_id, pin.WORLD)
        placement = pin.updateFramePlacement(robot.model, data, robot.frame_id)
        return cls(np.ascontiguousarray(xi.T), np.array(placement.rotation), np.array(placement.translation))

    def motion(
        self, q: Array, qd: Array, qdd: Array, base_twist: Array | None = None, base_rate: Array | None = None
    ) -> ScrewMotion:
        """Motion of the sensor frame and its Jacobian.

        Args:
            q: (N, M) joint positions [rad, m].
            qd: (N, M) their first derivatives by time.
            qdd: (N, M) their second.
            base_twist: (N, 6) of the root's origin, root axes; None where the root stands still.
            base_rate: (N, 6) its component-wise derivative, with `base_twist`.
        """
        N, M = q.shape
        out = ScrewMotion(np.empty((N, 6)), np.empty((N, 6)), np.empty((N, 3, 3)), np.zeros((N, 12, 3 * M)))
        for begin in range(0, N, _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            base = None
            if base_twist is not None and base_rate is not None:
                base = np.ascontiguousarray(base_twist[rows].T), np.ascontiguousarray(base_rate[rows].T)
            joints = [np.ascontiguousarray(x[rows].T) for x in (q, qd, qdd)]
            self._fill(out, rows, joints[0], joints[1], joints[2], base)
        return out

    def _fill(
        self,
        out: ScrewMotion,
        rows: slice,
        q: Array,
        qd: Array,
        qdd: Array,
        base: tuple[Array, Array] | None,
    ) -> None:
        """A chunk of rows; in here the rows are the last index: q (M, K), J (M, 6, K)."""
        M, K = q.shape
        J, R, p = self._jacobian(q)
        before, faster = (
            np.zeros((M + 1, 6, K)),
            np.zeros((M + 1, 6, K)),
        )  # nu and a of what is before joint i
        if base is not None:
            before[0], faster[0] = (_at_sensor(six, R, p) for six in base)
        np.cumsum(J * qd[:, None], axis=0, out=before[1:])
        before[1:] += before[0]
        turn = _bracket(before[:M], J)  # d nu / d q_i = [nu before i, J_i]
        np.cumsum(J * qdd[:, None] + turn * qd[:, None], axis=0, out=faster[1:])
        faster[1:] += faster[0]
        nu = before[M]
        by_q = _bracket(faster[:M], J) + _bracket(turn, nu - before[:M])
        by_qd = turn - _bracket(nu - before[1:], J)
        out.twist[rows], out.acceleration[rows] = nu.T, faster[M].T
        out.R_root_sensor[rows] = R.transpose(2, 0, 1)
        jacobian = out.jacobian[rows]
        for row, parts in ((0, (turn, J, None)), (6, (by_q, by_qd, J))):
            for k, part in enumerate(parts):
                if part is not None:
                    jacobian[:, row : row + 6, k * M : (k + 1) * M] = part.transpose(2, 1, 0)

    def _jacobian(self, q: Array) -> tuple[Array, Array, Array]:
        """J (M, 6, K), R_root_sensor (3, 3, K) and p_root_sensor (3, K), from the sensor to the root."""
        M, K = q.shape
        J = np.empty((M, 6, K))
        R, p = np.repeat(self.R[:, :, None], K, axis=2), np.repeat(self.p[:, None], K, axis=1)
        for i in reversed(range(M)):
            v, omega = self.xi[i, :3], self.xi[i, 3:]
            J[i, :3] = np.einsum("jik,jk->ik", R, v[:, None] + _cross_matrix(omega) @ p)
            J[i, 3:] = np.einsum("jik,j->ik", R, omega)
            size = float(np.linalg.norm(omega))
            if size == 0.0:
                p = p + v[:, None] * q[i]
                continue
            axis, angle = omega / size, size * q[i]
            along, around = np.outer(axis, axis), _cross_matrix(axis)
            c, s = np.cos(angle), np.sin(angle)
            turned = along[:, :, None] + (np.eye(3) - along)[:, :, None] * c + around[:, :, None] * s
            r = (around @ v / size)[:, None]  # a point of the axis
            p = np.einsum("ijk,jk->ik", turned, p - r) + r + along @ v[:, None] * q[i]
            R = np.einsum("ijk,jlk->ilk", turned, R)
        return J, R, p


def _cross_matrix(x: Array) -> Array:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def _at_sensor(six: Array, R: Array, p: Array) -> Array:
    """Ad(g)^-1: twists (6, K) of the root's origin, root axes, as those of the sensor's in sensor axes."""
    v = six[:3] + _cross(six[3:], p)
    return np.concatenate([np.einsum("jik,jk->ik", R, v), np.einsum("jik,jk->ik", R, six[3:])])


def _bracket(x: Array, y: Array) -> Array:
    """[x, y] of twists (..., 6, K)."""
    v = _cross(x[..., 3:, :], y[..., :3, :]) + _cross(x[..., :3, :], y[..., 3:, :])
    return np.concatenate([v, _cross(x[..., 3:, :], y[..., 3:, :])], axis=-2)


def _cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (..., 3, K)."""
    out = a[..., _NEXT, :] * b[..., _LAST, :]
    out -= a[..., _LAST, :] * b[..., _NEXT, :]
    return np.asarray(out)
