"""What carries an arm: a known input, splines through the rows that tell them (METHOD 10.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from truewrench.model.arrays import Array, Mask
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import segments
from truewrench.model.rig import Rig
from truewrench.robot.arm import rotation_of


@dataclass(frozen=True, slots=True, eq=False)
class BasePath:
    """The motion of the robot's root, exact, between the rows that tell it; at rest where none does."""

    # of time [s]: (K, 6) of the root's origin, root axes [m/s, rad/s]; None at rest
    twist: CubicSpline | None
    # of time: (K, 4) quaternions w, x, y, z of any length, root to inertial; None: they agree
    attitude: CubicSpline | None
    # of each stream of the base, [begin, end] of the times at which it is known [s]
    pieces: tuple[tuple[tuple[float, float], ...], ...]

    @classmethod
    def of(cls, rig: Rig, log: Log) -> BasePath:
        """The base of a log: of 4 rows or more, and with an attitude if it moves in gravity."""
        if log.base_twist is not None and log.base_attitude is None and rig.in_gravity:
            expected = "`base_qw` ... `base_qz` too: without them gravity has no direction"
            raise InputError.at(log.path, "", "`base_vx` ... `base_wz`, a base that moves", expected)
        columns = {"base_v*, base_w*": log.base_twist, "base_q*": log.base_attitude}
        pieces = []
        for name, values in columns.items():
            if values is None:
                continue
            time = log.time[np.isfinite(values).all(axis=1)]
            if time.size < 4:
                raise InputError.at(log.path, name, f"{time.size} complete rows", "at least 4")
            pieces.append(tuple((float(time[s][0]), float(time[s][-1])) for s in segments(time)))
        twist = _spline(log.time, log.base_twist)
        return cls(twist, _spline(log.time, _continuous(log.base_attitude)), tuple(pieces))

    def covers(self, time: Array) -> Mask:
        """Whether the base is known at times (K,)."""
        known = np.ones(time.shape, dtype=np.bool_)
        for stream in self.pieces:
            known &= np.any([(time >= begin) & (time <= end) for begin, end in stream], axis=0)
        return known

    def within(self, log: Log, joints: Array | None) -> Array | None:
        """Joints (N, n) of the rows at which the motion of the base is known, NaN elsewhere."""
        return None if joints is None else np.where(self.covers(log.time)[:, None], joints, np.nan)

    def carried(self, time: Array) -> tuple[Array, Array, Array]:
        """What `_core.Chain.motion` takes of the root at times (K,): twist, its derivative, attitude."""
        twist, rate, R_inertial_root = np.empty((0, 6)), np.empty((0, 6)), np.empty((0, 9))
        if self.twist is not None:
            at = _held(self.twist, time)
            twist, rate = np.asarray(self.twist(at)), np.asarray(self.twist(at, 1))
        if self.attitude is not None:
            turned = np.asarray(self.attitude(_held(self.attitude, time)))
            R_inertial_root = rotation_of(turned).reshape(-1, 9)
        return twist, rate, R_inertial_root

    @property
    def rests(self) -> bool:
        """Whether nothing of it was told."""
        return self.twist is None and self.attitude is None


def _spline(time: Array, values: Array | None) -> CubicSpline | None:
    if values is None:
        return None
    rows = np.isfinite(values).all(axis=1)
    return CubicSpline(time[rows], values[rows], axis=0)


def _held(path: CubicSpline, time: Array) -> Array:
    """Times within those told: the sensor's clock may lead out of them, and cubics run away there."""
    return np.asarray(np.clip(time, path.x[0], path.x[-1]))


def _continuous(attitude: Array | None) -> Array | None:
    """Quaternions (N, 4) of one sign: q and -q are the same attitude, and are not interpolated between."""
    if attitude is None:
        return None
    out: Array = attitude.copy()
    rows = np.flatnonzero(np.isfinite(attitude).all(axis=1))
    turned = np.sum(attitude[rows][1:] * attitude[rows][:-1], axis=1) < 0.0
    out[rows[1:]] *= np.cumprod(np.where(turned, -1.0, 1.0))[:, None]
    return out
