"""The joints of an arm as streams of the window estimators (docs/method.md, "Joints")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.arm.track import TrackedStream, tracked_streams
from truewrench.errors import UnsupportedError
from truewrench.log import Log
from truewrench.motion.spatial import cross_matrix, twist_adjoint
from truewrench.rig import Rig

__all__ = ["add_tracked_motion"]

Array = NDArray[np.float64]


def add_tracked_motion(streams: _core.RecordedLog, rig: Rig, log: Log, origin_ns: int, time: Array) -> None:
    """Add the motion of a joint log to its streams.

    Args:
        streams: that the motion is added to.
        rig: noise of the joints.
        log: with its tracking.
        origin_ns: that the times count from.
        time: (N,) of the log's rows [s].
    """
    assert log.tracking is not None
    reference = log.tracking.reference
    if reference is not None:
        later = (reference.origin_ns - origin_ns) * 1e-9
        streams.set_reference((reference.breakpoints + later).tolist(), reference.twist, reference.spacing)
        if reference.gravity is not None:
            streams.set_gravity(reference.gravity_time + later, reference.gravity)
    found = tracked_streams(rig, log)
    for stream in found:
        rows, value, covariance = stream.rows, stream.value, stream.covariance
        if stream.order == 0 and log.tracking.position_sigma is not None:
            # few among the rows of the velocities, but of no other rate: every row has it, most of them empty
            rows = found[0].rows
            at = np.searchsorted(rows, stream.rows)
            value, covariance = np.full((rows.size, 6), np.nan), np.tile(np.eye(6), (rows.size, 1, 1))
            value[at], covariance[at] = stream.value, stream.covariance
        streams.add_motion(
            stream.order,
            np.ascontiguousarray(time[rows]),
            np.ascontiguousarray(value),
            np.ones(6),
            covariance=covariance,
            coupling=stream.coupling,
        )
    if reference is not None:
        _add_acceleration(streams, rig, log, found, time)


def _add_acceleration(
    streams: _core.RecordedLog, rig: Rig, log: Log, found: list[TrackedStream], time: Array
) -> None:
    """Add what accelerometers read beyond what they would on the reference, p = [r; theta] away from it.

    The derivative of the twist departs by ddp + ad(nu0) dp + ad(a0) p, the specific force alpha by

        ddr + 2 Omega0 x dr + ([dOmega0] + [Omega0]^2) r + alpha0 x theta.

    What depends on p itself is taken from the joints, and its noise counts as the accelerometer's.
    """
    noise = np.array(rig.motion.acceleration_noise or ())
    measured = {6: log.acceleration, 3: log.specific_force}.get(noise.size)
    assert log.tracking is not None
    reference = log.tracking.reference
    if measured is None or reference is None:
        return
    if log.tracking.position_sigma is not None:
        expected = "none: with joint velocities alone the attitude drifts"
        raise UnsupportedError.at(rig.path, "motion.acceleration_noise", "accelerometers", expected)
    rows = np.flatnonzero(np.isfinite(measured).any(axis=1))
    at = (log.time_ns[rows] - reference.origin_ns) * 1e-9
    inside = (at >= reference.breakpoints[0]) & (at <= reference.breakpoints[-1])
    rows, at = rows[inside], at[inside]
    nu, a, gravity = reference.motion(at)
    value, by_rate, by_place = np.full((rows.size, 6), np.nan), *np.zeros((2, rows.size, 6, 6))
    if noise.size == 6:
        value[:] = measured[rows] - a
        by_rate, by_place = twist_adjoint(nu), twist_adjoint(a)
    else:
        turning = cross_matrix(nu[:, 3:])
        alpha = a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - gravity
        value[:, :3] = measured[rows] - alpha
        by_rate[:, :3, :3] = 2.0 * turning
        by_place[:, :3, :3] = cross_matrix(a[:, 3:]) + turning @ turning
        by_place[:, :3, 3:] = cross_matrix(alpha)
    encoders = found[0]
    place = [np.interp(time[rows], time[encoders.rows], column) for column in encoders.value.T]
    value -= np.einsum("kij,jk->ki", by_place, np.array(place))
    covariance = np.mean(encoders.covariance, axis=0)
    of_place = np.einsum("kij,jl,kil->i", by_place, covariance, by_place) / max(rows.size, 1)
    variance = of_place + np.append(noise**2.0, np.ones(6 - noise.size))
    streams.add_motion(2, time[rows], value, np.sqrt(variance), coupling=np.ascontiguousarray(by_rate))
