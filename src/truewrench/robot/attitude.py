"""How the sensor is turned against the root frame: as logged, or from gravity and angular velocity.

What it is for: gravity's direction in the root frame is uncertain by a small tilt, and a tilt about an axis
of the root moves g in sensor axes by R_sensor_root (tilt x g_root). Free fall itself is exact in every row.
The turn about the vertical comes from the integrated angular velocity and drifts slowly (a gyroscope of
1e-3 rad/s: a degree in 17 s): that mixes the tilt's two axes as slowly, which no fit of seconds to minutes
notices. It begins anew in every log, and after every gap, in which anything may have happened: root frames
that are this log's alone (`own_roots`), with a tilt of each.
"""

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, Slerp

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import SILENT, segments
from truewrench.model.motion.spatial import cross_matrix, rotated, turns_between
from truewrench.model.rig import Rig

_NO_RATE = 1e6  # [rad/s]: tolerance
_OTHER_GRAVITY = 0.02  # of its size: no drift of an accelerometer, but another planet or unit
_CONTRADICTS = 10.0  # [deg] beyond any tilt of the root frame
_OPPOSITE = 1e-12  # 1 + cosine of two directions that are taken for opposite


def attitude_of(rig: Rig, log: Log) -> tuple[Array, Array] | None:
    """R_sensor_root, which takes vectors of the root frame to sensor axes, where a log tells it.

    From the attitude columns; else from gravity in sensor axes, the angular velocity (or the twist) giving
    the turn about it (see above). Of a log of joints, gravity and twist are those that `tracked` gives. The
    root frame is that of `rig.gravity`: the inertial frame, where a base moves.

    Given are times (K,) since the first row [s] and rotations (K, 3, 3), one for every row with an attitude,
    or with gravity: R_sensor_root @ g_root then has exactly the direction of the logged g. None where nothing
    tells the attitude: on orbit without these columns.
    """
    if log.attitude is not None:
        known = np.isfinite(log.attitude).all(axis=1)
        if known.any():
            return log.time[known], _from_root(log.attitude[known])
    if log.gravity is None or not rig.in_gravity:
        return None
    known = np.isfinite(log.gravity).all(axis=1) & (np.linalg.norm(np.nan_to_num(log.gravity), axis=1) > 0.0)
    if not known.any():
        return None
    down = rig.gravity_array / np.linalg.norm(rig.gravity_array)
    fall = log.gravity[known] / np.linalg.norm(log.gravity[known], axis=1, keepdims=True)
    turns = _turns(log.time[known], *_angular_velocity(log))
    return log.time[known], _followed(down, fall, turns)


def check_fall(rig: Rig, log: Log) -> None:
    """Refuse gx gy gz of another size than the rig's `gravity`, or that an attitude contradicts."""
    if log.gravity is None or rig.motion.source == "joints":
        return
    sizes, stated = np.linalg.norm(log.gravity, axis=1), float(np.linalg.norm(rig.gravity_array))
    size = float(np.nanmedian(sizes))
    if abs(size - stated) > _OTHER_GRAVITY * max(stated, 1.0):
        expected = f"{stated:.4g} m/s^2, the size of the rig's `gravity`"
        raise InputError.at(log.path, "gx gy gz", f"free fall of {size:.4g} m/s^2", expected)
    if log.attitude is None or stated == 0.0:
        return
    both = np.isfinite(log.attitude).all(axis=1) & (sizes > 0.0)  # False for NaN
    if both.any():
        fall = _from_root(log.attitude[both]) @ rig.gravity_array
        cosine = np.einsum("ki,ki->k", fall, log.gravity[both]) / (stated * sizes[both])
        apart = float(np.degrees(np.arccos(np.clip(np.median(cosine), -1.0, 1.0))))
        if apart > _CONTRADICTS:
            found = f"free fall {apart:.3g} deg from that by qw qx qy qz"
            raise InputError.at(log.path, "gx gy gz", found, "one direction of both, or one of them")


def own_roots(rig: Rig, log: Log, *, twists: bool = False) -> Array:
    """Root frames of a log's attitude that are that log's alone: nothing tells their headings to others.

    (R, 2) from when to when each holds [s since the first row], the first from 0 on and the last to infinity;
    none where logs share the root frame. One holds as long as the angular velocity does: five periods and six
    knots of silence end it. `twists`: of a log of joints, those that its tachometers measure, as its joints
    do not tell the attitude.
    """
    integrated = rig.motion.source == "twist" or (rig.motion.source == "joints" and twists)
    told = log.attitude is not None and bool(np.isfinite(log.attitude).all(axis=1).any())
    if told or not (rig.in_gravity and integrated):
        return np.zeros((0, 2))
    time, _ = _angular_velocity(log)
    pieces = segments(time, SILENT)
    begins = [0.0, *(time[piece.start] for piece in pieces[1:])]
    return np.column_stack([begins, [*(time[piece.stop - 1] for piece in pieces[:-1]), np.inf]])


def attitude_at(time: Array, R_sensor_root: Array, at: Array) -> Array:
    """Rotations (M, 3, 3) at times (M,), on the shortest way between those (K, 3, 3) at times (K,).

    Before the first and after the last, these hold on.
    """
    if len(time) == 1:
        return np.repeat(R_sensor_root, len(at), axis=0)
    way = Slerp(time, Rotation.from_matrix(R_sensor_root))
    return np.asarray(way(np.clip(at, time[0], time[-1])).as_matrix())


def free_fall(rig: Rig, attitude: Array) -> Array:
    """Acceleration of free fall (N, 3) in sensor axes [m/s^2], NaN where there is no attitude.

    The attitude is (N, 4) quaternions w, x, y, z from the sensor to the root frame.
    """
    fall = np.full((len(attitude), 3), np.nan)
    known = np.isfinite(attitude).all(axis=1)
    fall[known] = _from_root(attitude[known]) @ rig.gravity_array
    return fall


def _from_root(attitude: Array) -> Array:
    """R_sensor_root (K, 3, 3) of quaternions (K, 4) w, x, y, z from the sensor to the root."""
    if not len(attitude):
        return np.empty((0, 3, 3))
    return np.asarray(Rotation.from_quat(attitude[:, [1, 2, 3, 0]]).inv().as_matrix())


def _angular_velocity(log: Log) -> tuple[Array, Array]:
    """Times (M,) [s] and Omega (M, 3) [rad/s], sensor axes; none where the log has none."""
    omega = log.angular_velocity if log.twist is None else log.twist[:, 3:]
    if omega is None:
        return np.empty(0), np.empty((0, 3))
    known = np.isfinite(omega).all(axis=1)
    fastest = float(np.abs(omega[known]).max(initial=0.0))
    if fastest > _NO_RATE:
        raise InputError.at(log.path, "wx wy wz", f"{fastest:.3g} rad/s", "an angular velocity of a body")
    return log.time[known], omega[known]


def _turns(time: Array, omega_time: Array, omega: Array) -> Array:
    """How sensor axes turn from each time to the next, (K - 1, 3, 3): x_next = turn x, of a fixed vector x.

    The identity where Omega is not known all the way between the two.
    """
    turns = np.tile(np.eye(3), (len(time) - 1, 1, 1))
    for piece in segments(omega_time, SILENT):
        at = omega_time[piece]
        inside = np.flatnonzero((time >= at[0]) & (time <= at[-1])) if at.size > 1 else np.empty(0, np.int64)
        if inside.size < 2:
            continue
        path = make_interp_spline(at, omega[piece], k=min(3, at.size - 1))
        nodes = np.union1d(at, time[inside])
        R = rotated(turns_between(path, nodes))[np.searchsorted(nodes, time[inside])]
        turns[inside[:-1]] = R[1:].transpose(0, 2, 1) @ R[:-1]
    return turns


def _followed(down: Array, fall: Array, turns: Array) -> Array:
    """Rotations (K, 3, 3) by the turns, each with the smallest further one that puts `down` on `fall`.

    Down (3,) is a unit vector in the root frame, fall (K, 3) the same in sensor axes, and turns (K - 1, 3, 3)
    lead from each row to the next.
    """
    predicted = np.einsum("kij,kj->ki", turns, fall[:-1])
    steps = _least_rotation(predicted, fall[1:]) @ turns
    back = rotated(Rotation.from_matrix(steps).inv().as_rotvec())  # in the axes at the first row
    R_sensor_root = back.transpose(0, 2, 1) @ _least_rotation(down[None], fall[:1])
    # against the rounding of many products
    R_sensor_root = np.asarray(Rotation.from_matrix(R_sensor_root).as_matrix())
    return _least_rotation(R_sensor_root @ down, fall) @ R_sensor_root


def _least_rotation(a: Array, b: Array) -> Array:
    """The smallest rotations (K, 3, 3) that turn unit vectors a into b, both (K, 3)."""
    axis, onto = cross_matrix(np.cross(a, b)), 1.0 + np.sum(a * b, axis=1)
    opposite = onto < _OPPOSITE
    onto[opposite] = 1.0
    R = np.eye(3) + axis + axis @ axis / onto[:, None, None]
    if opposite.any():  # half a turn about any axis at right angles
        some = np.eye(3)[np.argmin(np.abs(a[opposite]), axis=1)]
        across = np.cross(a[opposite], some)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        R[opposite] = 2.0 * across[:, :, None] * across[:, None, :] - np.eye(3)
    return np.asarray(R)
