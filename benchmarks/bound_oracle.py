"""The Cramer-Rao bound of a calibration at its truth, without a line of the core (docs/method.md).

The wrench and its Jacobians come from Pinocchio's RNEA by finite differences; motion and gain are inferred
together: the information of (spline coefficients of the twist, gains, offsets) is reduced onto the gains and
offsets by a Schur complement. All in normalised units: gain_ij range_j / scale_i, offset_i / scale_i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

Array = NDArray[np.float64]
DEGREE = 5
ACTIVE = DEGREE + 1


class Rnea:
    """Wrench of a payload on its sensor by Pinocchio, for twists of a body-fixed point (sensor axes)."""

    def __init__(self, mass: float, center_of_mass: Array, inertia: Array, point: Array) -> None:
        self.model = pin.Model()
        joint = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "sensor")
        self.model.appendBodyToJoint(joint, pin.Inertia(mass, center_of_mass, inertia), pin.SE3.Identity())
        self.data = self.model.createData()
        self.neutral = pin.neutral(self.model)
        # twist of the sensor origin from the twist of the point: v_S = v_P + p x Omega
        self.to_sensor = np.eye(6)
        self.to_sensor[:3, 3:] = pin.skew(point)

    def __call__(self, twist: Array, acceleration: Array, gravity: Array) -> Array:
        """Wrench (6,) of the payload on the sensor, at the sensor origin."""
        self.model.gravity.linear = gravity
        nu, a = self.to_sensor @ twist, self.to_sensor @ acceleration
        return np.asarray(-pin.rnea(self.model, self.data, self.neutral, nu, a))

    def jacobians(self, twist: Array, acceleration: Array, gravity: Array) -> tuple[Array, Array]:
        """dw/dnu and dw/da (6, 6) each."""
        h = 0.5  # the wrench is quadratic in nu and linear in a: central differences of any step are exact
        by_twist, by_acceleration = np.empty((6, 6)), np.empty((6, 6))
        for j, e in enumerate(h * np.eye(6)):
            plus, minus = self(twist + e, acceleration, gravity), self(twist - e, acceleration, gravity)
            by_twist[:, j] = (plus - minus) / (2 * h)
            plus, minus = self(twist, acceleration + e, gravity), self(twist, acceleration - e, gravity)
            by_acceleration[:, j] = (plus - minus) / (2 * h)
        return by_twist, by_acceleration


@dataclass(frozen=True)
class MotionInformation:
    """What one log's motion contributes, whatever the gain: computed once per motion."""

    wrench: Array  # (N, 6) normalised, with the rig's sign
    by_coefficients: Array  # (N, 6, 36) d(normalised wrench)/d(active spline coefficients)
    starts: NDArray[np.int64]  # first sample of every knot interval, and N
    twist_blocks: Array  # (K, 36, 36) information of a twist of unit noise, per component scaled

    @classmethod
    def of(
        cls,
        rnea: Rnea,
        time: Array,
        twist: Array,
        acceleration: Array,
        *,
        twist_noise: Array,
        scale: Array,
        spacing: float,
        gravity: Array | None = None,
        sign: float = 1.0,
    ) -> MotionInformation:
        """Build from the true motion (N, 6) at the times (N,), wrench and twist sampled together.

        Args:
            rnea: wrench of the payload.
            time: sample times [s].
            twist: true twist of the logged point.
            acceleration: its component-wise derivative.
            twist_noise: 1 sigma per component (6,).
            scale: range of the sensor (6,).
            spacing: knot spacing of the splines that stand for the motion [s].
            gravity: gravity in sensor axes (N, 3); none if left out.
            sign: +1 payload_on_sensor, -1 sensor_on_payload.
        """
        g = np.zeros((time.size, 3)) if gravity is None else gravity
        span = time[-1] - time[0]
        intervals = max(1, round(span / spacing))
        h = span / intervals
        knots = time[0] + h * np.arange(-DEGREE, intervals + DEGREE + 1)
        index = np.clip(((time - time[0]) / h).astype(int), 0, intervals - 1)
        starts = np.searchsorted(index, np.arange(intervals + 1))
        basis, slope = np.empty((time.size, ACTIVE)), np.empty((time.size, ACTIVE))
        for m in range(ACTIVE):  # on a uniform knot vector every interval sees the same six pieces
            piece = BSpline(knots[: 2 * ACTIVE], np.eye(ACTIVE)[m], DEGREE)
            local = time - time[0] - index * h + time[0]
            basis[:, m], slope[:, m] = piece(local), piece(local, nu=1)
        wrench = np.array([rnea(*x) for x in zip(twist, acceleration, g, strict=True)])
        jacobians = [rnea.jacobians(*x) for x in zip(twist, acceleration, g, strict=True)]
        by_twist = np.array([j[0] for j in jacobians])
        by_acceleration = np.array([j[1] for j in jacobians])
        by_coefficients = np.einsum("km,kpc->kpmc", basis, by_twist)
        by_coefficients += np.einsum("km,kpc->kpmc", slope, by_acceleration)
        blocks = np.zeros((intervals, 6 * ACTIVE, 6 * ACTIVE))
        for i, (a, b) in enumerate(pairwise(starts)):
            blocks[i] = np.kron(basis[a:b].T @ basis[a:b], np.diag(twist_noise**-2.0))
        normalised = by_coefficients.reshape(time.size, 6, 6 * ACTIVE) / scale[None, :, None]
        return cls(sign * wrench / scale, sign * normalised, starts, blocks)

    def schur(self, gain: Array, noise: Array, offset: bool) -> Array:
        """Information on the rows of the normalised gain (n, 6), each followed by its offset if any."""
        columns = np.column_stack([self.wrench, np.ones(len(self.wrench))]) if offset else self.wrench
        n, width = len(gain), columns.shape[1]
        by_coefficients = (gain / noise[:, None]) @ self.by_coefficients  # (N, n, 36), over the noise
        intervals = len(self.starts) - 1
        band = np.zeros((6 * ACTIVE, 6 * (intervals + DEGREE)))
        cross = np.zeros((6 * (intervals + DEGREE), n, width))
        rows, cols = np.tril_indices(6 * ACTIVE)
        for i, (a, b) in enumerate(pairwise(self.starts)):
            j = by_coefficients[a:b]
            flat = j.reshape(-1, 6 * ACTIVE)
            block = self.twist_blocks[i] + flat.T @ flat
            band[rows - cols, 6 * i + cols] += block[rows, cols]
            part = j.reshape(b - a, -1).T @ columns[a:b]
            cross[6 * i : 6 * (i + ACTIVE)] += part.reshape(n, 6 * ACTIVE, width).transpose(1, 0, 2)
        flat_cross = (cross / noise[None, :, None]).reshape(len(cross), n * width)
        known = np.kron(np.diag(noise**-2.0), columns.T @ columns)
        factor = cholesky_banded(band, lower=True)
        return np.asarray(known - flat_cross.T @ cho_solve_banded((factor, True), flat_cross))

    def oracle(self, noise: Array, offset: bool) -> Array:
        """The same information when the motion is known."""
        columns = np.column_stack([self.wrench, np.ones(len(self.wrench))]) if offset else self.wrench
        return np.asarray(np.kron(np.diag(noise**-2.0), columns.T @ columns))


def covariance(
    motions: Sequence[MotionInformation],
    gain: Array,
    noise: Array,
    *,
    gain_prior: float | None,
    offset_prior: Array | None = None,
    oracle: bool = False,
) -> Array:
    """Bound on the covariance of the normalised [gains row by row, offset of the last log].

    Args:
        motions: one per log.
        gain: true normalised gain (n, 6).
        noise: normalised noise of the channels (n,).
        gain_prior: 1 sigma of the prior on every normalised gain; None for no prior.
        offset_prior: 1 sigma of the prior on every log's normalised offset (n,); None for no offsets.
        oracle: the motion is known.
    """
    n, offset = len(gain), offset_prior is not None
    gains, width = 6 * n, 7 if offset else 6
    size = gains + (n * len(motions) if offset else 0)
    information = np.zeros((size, size))
    of_gain = (np.arange(n)[:, None] * width + np.arange(6)).ravel()
    of_offset = np.arange(n) * width + 6
    for k, motion in enumerate(motions):
        s = motion.oracle(noise, offset) if oracle else motion.schur(gain, noise, offset)
        source = np.concatenate([of_gain, of_offset]) if offset else of_gain
        target = (
            np.concatenate([np.arange(gains), gains + n * k + np.arange(n)]) if offset else np.arange(gains)
        )
        information[np.ix_(target, target)] += s[np.ix_(source, source)]
    if gain_prior is not None:
        information[np.arange(gains), np.arange(gains)] += gain_prior**-2.0
    if offset_prior is not None:
        where = np.arange(gains, size)
        information[where, where] += np.tile(offset_prior**-2.0, len(motions))
    keep = np.concatenate([np.arange(gains), np.arange(size - n, size)]) if offset else np.arange(gains)
    return np.asarray(np.linalg.inv(information)[np.ix_(keep, keep)])


def rms(covariance_of_gains: Array) -> float:
    """Root mean square of the 1 sigma of the gains: sqrt(trace/36) of the leading 36 x 36 block."""
    return float(np.sqrt(np.trace(covariance_of_gains[:36, :36]) / 36.0))
