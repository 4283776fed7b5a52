"""Columns of a log, row by row, as motion and gravity of the sensor's origin."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from truewrench.io.joints import BASE_ATTITUDE, BASE_TWIST, check_attitude, without_attitude
from truewrench.io.table import ANGULAR_VELOCITY, AT_REST, ATTITUDE, GRAVITY, SPECIFIC_FORCE, TWIST
from truewrench.model.arrays import Array, Integers, Mask
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.robot.arm import BaseMotion, robot_of, rotation_of
from truewrench.tool.checks import check_positions, check_rates

Columns = Mapping[str, Array]

OTHER_UNIT = 1.5  # times free fall as stated, or less than its part: another unit, or planet
HELD = 0.1  # [s] that positions of joints are carried on by velocities, a direction of gravity by Omega, and
# what one half of an IMU read to the other's rows


@dataclass(frozen=True, slots=True, eq=False)
class MotionRows:
    """N rows; NaN where a row does not tell."""

    twist: Array  # (N, 6) of the sensor's origin, sensor axes; without v of an IMU [m/s, rad/s]
    fall: Array  # (N, 3) free fall there [m/s^2]; of an IMU less its specific force
    turn: Array  # (N, 9) R_sensor_root row by row
    noise: Array  # (N, 36) covariance of the twist where it changes with the pose, else (0, 36)
    base: Array | None = None  # (N, 3, 3) R_inertial_root of an arm whose base turns


@dataclass(slots=True, eq=False)
class _Half:
    """What a gyroscope, or an accelerometer, read last."""

    time: int = 0  # [ns]
    value: Array = field(default_factory=lambda: np.full(3, np.nan))
    fresh: bool = False  # and no row of motion has told yet


class MotionColumns:
    """What the source of motion of a tool's rig needs of a table, and what it makes of it.

    Joints tell twist and gravity of each row by itself: no spline is fitted. Velocities at rows without
    positions are taken at the last ones, carried on by the velocities. Where gyroscope and accelerometer have
    rows of their own, the slower one's tell the motion. Without `names` of columns rows come
    one by one, and any may come; `place` is that of the table, for messages.
    """

    def __init__(self, rig: Rig, names: Collection[str] | None, place: Path | None = None) -> None:
        self._rig, self._source = rig, rig.motion.source
        self._place = place
        motion = rig.motion
        self.imu = self._source == "imu"
        self.twist_noise, self.gravity_noise = np.zeros((6, 6)), np.zeros((3, 3))
        self.attitude_known = False
        if self._source == "joints":
            self._robot = robot_of(rig)
            self._q, self._q_time = np.full(self._robot.n, np.nan), 0
            self._positions = tuple(f"q_{joint}" for joint in self._robot.joints)
            self._velocities = tuple(f"dq_{joint}" for joint in self._robot.joints)
            self._sigma = motion.noise_array if motion.noise is not None else np.zeros(self._robot.n)
            needed = (*self._positions, *self._velocities)
            self.attitude_known = True
            optional: tuple[str, ...] = (*BASE_TWIST, *BASE_ATTITUDE)
            self._carried = self._turned = False  # whether the base's twist and attitude are told
            if names is not None:
                self._carried, self._turned = (
                    any(name in names for name in group) for group in (BASE_TWIST, BASE_ATTITUDE)
                )
                needed += BASE_TWIST * self._carried + BASE_ATTITUDE * self._turned
                if self._carried and not self._turned and rig.in_gravity:
                    raise without_attitude(place)
        elif self.imu:
            needed = (*ANGULAR_VELOCITY, *SPECIFIC_FORCE)
            self._halves = [_Half(), _Half()]  # Omega and specific force
            # which gravity is no part of, but for the weight that a driver has subtracted
            optional = () if rig.sensor.subtracted is None else (*GRAVITY, *ATTITUDE)
            self.twist_noise[3:, 3:] = np.diag(motion.noise_array**2)
            if motion.acceleration_noise is not None:
                self.gravity_noise = np.diag(np.array(motion.acceleration_noise)[-3:] ** 2)
        else:
            needed, optional = TWIST, (*GRAVITY, *ATTITUDE)
            if motion.noise is not None:
                self.twist_noise = np.diag(motion.noise_array**2)
            self.attitude_known = self._present(ATTITUDE, names)
        told = self._present(ATTITUDE, names) or self._present(GRAVITY, names)
        if rig.in_gravity and GRAVITY[0] in optional and not told:
            why = ", which `sensor.compensated` needs" if self.imu else ""
            expected = f"gx gy gz or qw qx qy qz: gravity's direction in sensor axes{why}"
            raise InputError.at(place, "header", "nothing that tells it", expected)
        missing = [] if names is None else [name for name in needed if name not in names]
        if missing:
            poses = told and tuple(missing) == TWIST
            expected = ", ".join(needed) + (f"; {AT_REST}" if poses else "")
            raise InputError.at(place, "header", f"no column `{missing[0]}`", expected)
        further = (name for name in optional if name not in needed)
        self.columns = (*needed, *(name for name in further if names is None or name in names))

    @staticmethod
    def _present(group: Collection[str], names: Collection[str] | None) -> bool:
        return names is None or all(name in names for name in group)

    def restart(self) -> None:
        """Where stamps begin again: no position is carried on from before."""
        if self._source == "joints":
            self._q[:] = np.nan
        elif self.imu:
            self._halves = [_Half(), _Half()]

    def read(self, time_ns: Integers, columns: Columns) -> MotionRows:
        """N rows, after those that were read before; columns (N,) that are absent hold no sample."""
        count = len(time_ns)
        if self._source == "joints":
            return self._of_joints(time_ns, columns)
        if self.imu:
            omega, force = self._together(
                time_ns, _group(columns, ANGULAR_VELOCITY, count), _group(columns, SPECIFIC_FORCE, count)
            )
            check_rates(self._place, omega)
            twist = np.hstack([np.zeros((count, 3)), omega])
            return MotionRows(twist, -force, np.full((count, 9), np.nan), np.empty((0, 36)))
        twist, (fall, turn) = _group(columns, TWIST, count), self.gravity(time_ns, columns)
        check_rates(self._place, twist[:, 3:])
        stated = float(np.linalg.norm(self._rig.gravity_array))
        size = np.linalg.norm(fall[np.isfinite(fall).all(axis=1)], axis=1)
        told = float(np.median(size)) if size.size else stated
        if not stated / OTHER_UNIT <= told <= stated * OTHER_UNIT:
            expected = f"{stated:.4g} m/s^2, the size of the rig's `gravity`"
            raise InputError.at(self._place, "gx gy gz", f"free fall of {told:.4g} m/s^2", expected)
        return MotionRows(twist, fall, turn, np.empty((0, 36)))

    def _together(self, time_ns: Integers, omega: Array, force: Array) -> tuple[Array, Array]:
        """Both halves (N, 3) of an IMU at rows by which each has read anew; NaN at the others."""
        halves = (omega, force)
        told = [np.asarray(np.isfinite(values).all(axis=1), np.bool_) for values in halves]
        if (told[0] == told[1]).all() and not any(half.fresh for half in self._halves):
            return halves
        out = np.full((2, len(time_ns), 3), np.nan)
        for k in np.flatnonzero(told[0] | told[1]):
            for half, values, here in zip(self._halves, halves, told, strict=True):
                if here[k]:
                    half.time, half.value, half.fresh = int(time_ns[k]), values[k].copy(), True
                half.fresh = half.fresh and 1e-9 * (int(time_ns[k]) - half.time) <= HELD
            if all(half.fresh for half in self._halves):
                out[:, k] = [half.value for half in self._halves]
                for half in self._halves:
                    half.fresh = False
        return out[0], out[1]

    def gravity(self, time_ns: Integers, columns: Columns) -> tuple[Array, Array]:
        """Free fall (N, 3) and R_sensor_root (N, 9) of rows that tell them by themselves."""
        count = len(time_ns)
        fall, turn = _group(columns, GRAVITY, count), np.full((count, 9), np.nan)
        attitude = _group(columns, ATTITUDE, count)
        check_attitude(attitude, ATTITUDE, self._place, time_ns)
        known = np.isfinite(attitude).all(axis=1)
        if known.any():
            R = rotation_of(attitude[known]).transpose(0, 2, 1)
            turn[known] = R.reshape(-1, 9)
            unlogged = known & ~np.isfinite(fall).all(axis=1)
            fall[unlogged] = turn[unlogged].reshape(-1, 3, 3) @ self._rig.gravity_array
        return fall, turn

    def _of_joints(self, time_ns: Integers, columns: Columns) -> MotionRows:
        count = len(time_ns)
        q, qd = _group(columns, self._positions, count), _group(columns, self._velocities, count)
        check_positions(self._place, q)
        for k in range(count):  # a row without positions has the last ones, carried on
            if np.isfinite(q[k]).all():
                self._q, self._q_time = q[k].copy(), int(time_ns[k])
            elif np.isfinite(qd[k]).all():
                since = 1e-9 * (int(time_ns[k]) - self._q_time)
                q[k] = self._q + since * qd[k] if since <= HELD else np.nan
        twist, fall = np.full((count, 6), np.nan), np.full((count, 3), np.nan)
        turn, noise = np.full((count, 9), np.nan), np.full((count, 36), np.nan)
        told = np.isfinite(q).all(axis=1) & np.isfinite(qd).all(axis=1)
        carried, attitude = _group(columns, BASE_TWIST, count), _group(columns, BASE_ATTITUDE, count)
        check_attitude(attitude, BASE_ATTITUDE, self._place, time_ns)
        # once a base has been told of, every row needs it: where it is missing the base has not stopped
        moves, turned = _ever(self._carried, carried), _ever(self._turned, attitude)
        known = np.isfinite(attitude).all(axis=1)
        told &= np.isfinite(carried).all(axis=1) | ~moves
        told &= known | ~(turned | moves if self._rig.in_gravity else turned)
        if count:
            self._carried, self._turned = bool(moves[-1]), bool(turned[-1])
        rows = np.flatnonzero(told)
        R_inertial_root = np.tile(np.eye(3), (count, 1, 1))
        R_inertial_root[known & told] = rotation_of(attitude[known & told])
        if rows.size:
            base = None
            if moves.any():
                base = BaseMotion(np.where(moves[rows, None], carried[rows], 0.0), np.zeros((rows.size, 6)))
            moved = self._robot.motion(q[rows], qd[rows], np.zeros_like(qd[rows]), base)
            R = (R_inertial_root[rows] @ moved.R_root_sensor).transpose(0, 2, 1)
            twist[rows], turn[rows] = moved.twist, R.reshape(-1, 9)
            fall[rows] = R @ self._rig.gravity_array
            J = self._robot.jacobian(q[rows]) * self._sigma
            noise[rows] = (J @ J.transpose(0, 2, 1)).reshape(-1, 36)
        return MotionRows(twist, fall, turn, noise, R_inertial_root if turned.any() else None)


def _ever(before: bool, values: Array) -> Mask:
    """Whether a row, or one before it, told anything."""
    told: Mask = np.logical_or.accumulate(np.isfinite(values).any(axis=1))
    return told | before


def _group(columns: Columns, names: Collection[str], count: int) -> Array:
    nothing = np.full(count, np.nan)
    return np.column_stack([np.asarray(columns.get(name, nothing), dtype=np.float64) for name in names])
