"""What joints measured, as streams of the window estimators (docs/method.md, "Joints")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.log import Log, Tracking
from truewrench.rig import Rig

__all__ = ["add_tracked_motion"]

Array = NDArray[np.float64]

_EXACT = 1e-6  # variance of a direction that no joint moves, relative to the others'


def add_tracked_motion(streams: _core.RecordedLog, rig: Rig, log: Log, origin_ns: int, time: Array) -> None:
    """Add the motion of a joint log to its streams.

    Without a reference the twist J qd is a measurement with the covariance J Sigma J^T ([A00] 26). About one,
    encoders measure the displacement xi = J (q - q_ref), and tachometers

        J (qd - qd_ref) = dxi/dt - Jdot (q - q_ref) = dxi/dt - Jdot J^# xi,

    J^# being the inverse that their noise weighs: what of q moves no sensor is not seen.

    Args:
        streams: that the motion is added to.
        rig: noise of the joints.
        log: with its tracking.
        origin_ns: that the times count from.
        time: (N,) of the log's rows [s].
    """
    tracking = log.tracking
    assert tracking is not None and log.twist is not None
    if tracking.reference is None:
        rows = np.isfinite(log.twist).all(axis=1)
        covariance = _covariance(tracking.jacobian[rows], rig.motion.noise_array)
        _add(streams, 0, time[rows], log.twist[rows], covariance)
        return
    reference = tracking.reference
    later = (reference.origin_ns - origin_ns) * 1e-9
    streams.set_reference((reference.breakpoints + later).tolist(), reference.twist, reference.spacing)
    if reference.gravity is not None:
        streams.set_gravity(reference.gravity_time + later, reference.gravity)
    assert tracking.position_departure is not None and rig.motion.position_noise is not None
    sigma = np.array(rig.motion.position_noise)
    rows = np.isfinite(tracking.position_departure).all(axis=1)
    J = tracking.jacobian[rows]
    displacement = np.einsum("kij,kj->ki", J, tracking.position_departure[rows])
    _add(streams, 0, time[rows], displacement, _covariance(J, sigma))
    if tracking.velocity_departure is None:
        return
    rows = np.isfinite(tracking.velocity_departure).all(axis=1)
    J = tracking.jacobian[rows]
    rate = np.einsum("kij,kj->ki", J, tracking.velocity_departure[rows])
    _add(
        streams, 1, time[rows], rate, _covariance(J, rig.motion.noise_array), _coupling(tracking, rows, sigma)
    )


def _add(
    streams: _core.RecordedLog,
    order: int,
    time: Array,
    value: Array,
    covariance: Array,
    coupling: Array | None = None,
) -> None:
    streams.add_motion(
        order,
        np.ascontiguousarray(time),
        np.ascontiguousarray(value),
        np.ones(6),
        covariance=covariance,
        coupling=coupling,
    )


def _covariance(J: Array, sigma: Array) -> Array:
    """J Sigma J^T (N, 6, 6), of full rank also where the joints cannot move the sensor in some direction."""
    covariance = np.einsum("kij,j,klj->kil", J, sigma**2, J)
    floor = _EXACT * np.trace(covariance, axis1=1, axis2=2) / 6.0
    return np.ascontiguousarray(covariance + floor[:, None, None] * np.eye(6))


def _coupling(tracking: Tracking, rows: NDArray[np.bool_], sigma: Array) -> Array:
    """-Jdot J^# (N, 6, 6)."""
    assert tracking.jacobian_rate is not None
    J, J_rate = tracking.jacobian[rows], tracking.jacobian_rate[rows]
    weighted = np.einsum("j,kij->kji", sigma**2, J)  # Sigma J^T
    return np.ascontiguousarray(-J_rate @ weighted @ np.linalg.inv(_covariance(J, sigma)))
