"""The arm as the core moves it: a product of exponentials (include/truewrench/model/chain.hpp)."""

from dataclasses import dataclass, fields

import numpy as np

from truewrench import _core
from truewrench.model.arrays import Array
from truewrench.robot.arm import Robot
from truewrench.robot.base_path import BasePath

_CHUNK = 4096  # rows, whose Jacobians take 8 MB


@dataclass(frozen=True, slots=True, eq=False)
class SensorMotion:
    """How the sensor frame moves, in N rows, sensor axes."""

    twist: Array  # (N, 6) of its origin [m/s, rad/s]
    R_sensor_inertial: Array  # (N, 3, 3)
    jacobian: Array  # (N, 6, n) J of nu = J qd, the base at rest
    jacobian_rate: Array  # (N, 6, n) Jdot, its component-wise derivative: a = J qdd + Jdot qd


def chain_of(robot: Robot) -> _core.Chain:
    """The joints of a robot from the root to its sensor frame."""
    import pinocchio as pin

    data, q = robot.model.createData(), np.zeros(robot.n)
    xi = pin.computeFrameJacobian(robot.model, data, q, robot.frame_id, pin.WORLD)
    placement = pin.updateFramePlacement(robot.model, data, robot.frame_id)
    return _core.Chain(np.ascontiguousarray(xi.T), placement.rotation, placement.translation)


def sensor_motion(chain: _core.Chain, base: BasePath, time: Array, q: Array, qd: Array) -> SensorMotion:
    """The motion of the sensor frame at times (N,) [s] of joints (N, n) and their derivatives."""
    n, parts = chain.joints, []
    for begin in range(0, max(1, len(q)), _CHUNK):
        rows = slice(begin, begin + _CHUNK)
        nu, _, R, found = chain.motion(q[rows], qd[rows], np.zeros_like(qd[rows]), *base.carried(time[rows]))
        by = found.reshape(-1, 2, 6, 3, n)  # of nu and a, by q, qd and qdd
        # d nu / d q_i = [nu of the links before i, J_i], and d a / d qd_i is that and Jdot_i
        parts.append(
            SensorMotion(nu, R.reshape(-1, 3, 3), by[:, 0, :, 1].copy(), by[:, 1, :, 1] - by[:, 0, :, 0])
        )
    return SensorMotion(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(SensorMotion)))
