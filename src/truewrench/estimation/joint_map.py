"""What joint positions and their derivatives mean for the sensor: the map that the estimator linearises.

The base is a known input: its twist and attitude are splines through the rows that tell them, on the log's
time. METHOD 10.6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.motion.smooth import segments
from truewrench.robot.arm import robot_of, rotation_of
from truewrench.robot.screws import Screws

__all__ = ["BasePath", "JointMap", "joint_map"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BasePath:
    """The motion of the robot's root, exact, between the rows that tell it; at rest where none does.

    Attributes:
        twist: of time [s]: (K, 6) of the root's origin, root axes [m/s, rad/s]; None at rest.
        attitude: of time: (K, 4) quaternions w, x, y, z of any length, root to inertial; None: they agree.
        pieces: of each stream of the base, [begin, end] of the times at which it is known [s].
    """

    twist: CubicSpline | None
    attitude: CubicSpline | None
    pieces: tuple[tuple[tuple[float, float], ...], ...]

    @classmethod
    def of(cls, rig: Rig, log: Log) -> BasePath:
        """The base of a log.

        Raises:
            InputError: for a base that moves in gravity without an attitude, or of fewer than 4 rows.
        """
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

    def covers(self, time: Array) -> NDArray[np.bool_]:
        """Whether the base is known at times (K,)."""
        known = np.ones(time.shape, dtype=np.bool_)
        for stream in self.pieces:
            known &= np.any([(time >= begin) & (time <= end) for begin, end in stream], axis=0)
        return known


@dataclass(frozen=True, slots=True, eq=False)
class JointMap:
    """From (K,) times and (K, M) q, qd, qdd to the motion of the sensor's origin, sensor axes.

    Attributes:
        screws: the chain.
        base: what carries it.
        gravity: whether anything asks for the attitude.
    """

    screws: Screws
    base: BasePath
    gravity: bool

    def __call__(self, time: Array, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array, Array]:
        """The row of `_core.MappedMotion` at each time.

        Returns:
            nu (K, 6) and a (K, 6), R_sensor_inertial (K, 9) row by row (empty without gravity), and the
            Jacobian (K, 12 * 3M) of [nu; a] by (q, qd, qdd), row by row.
        """
        base = self.base.twist
        carried = () if base is None else (np.asarray(base(time)), np.asarray(base(time, 1)))
        moving = self.screws.motion(q, qd, qdd, *carried)
        R_sensor_inertial = np.empty((0, 9))
        if self.gravity:
            R = moving.R_root_sensor
            if self.base.attitude is not None:
                R = rotation_of(np.asarray(self.base.attitude(time))) @ R
            R_sensor_inertial = np.ascontiguousarray(R.transpose(0, 2, 1)).reshape(-1, 9)
        return (
            moving.twist,
            moving.acceleration,
            R_sensor_inertial,
            moving.jacobian.reshape(len(time), -1),
        )


def joint_map(rig: Rig, log: Log) -> JointMap:
    """The map of a log of joints.

    Raises:
        InputError: as `robot_of`, and `BasePath.of`.
    """
    return JointMap(Screws.of(robot_of(rig)), BasePath.of(rig, log), rig.in_gravity)


def _spline(time: Array, values: Array | None) -> CubicSpline | None:
    if values is None:
        return None
    rows = np.isfinite(values).all(axis=1)
    return CubicSpline(time[rows], values[rows], axis=0)


def _continuous(attitude: Array | None) -> Array | None:
    """Quaternions (N, 4) of one sign: q and -q are the same attitude, and are not interpolated between."""
    if attitude is None:
        return None
    out: Array = attitude.copy()
    rows = np.flatnonzero(np.isfinite(attitude).all(axis=1))
    turned = np.sum(attitude[rows][1:] * attitude[rows][:-1], axis=1) < 0.0
    out[rows[1:]] *= np.cumprod(np.where(turned, -1.0, 1.0))[:, None]
    return out
