"""The Cramer-Rao bound of a joint rig, its wrench linearised by differences of MuJoCo's sensors.

As bound_common.py: nothing of the core, of Pinocchio, or of what plans and calibrations predict. Payload and
clock exact.
"""

from __future__ import annotations

import bound_common
import numpy as np
from numpy.typing import NDArray

from truewrench.model.motion.trajectory_joint import JointTrajectory
from truewrench.model.rig import Rig
from truewrench.simulation.arm.model import Arm

Array = NDArray[np.float64]

STEP = 1e-4  # [rad, m] of positions; by velocities and accelerations differences of any length are exact


def linearised(rig: Rig, arm: Arm, trajectory: JointTrajectory) -> bound_common.Linearised:
    """What `bound_common.bound_of` wants to know of an arm; times asked for again are not computed again.

    Args:
        rig: positions and velocities are logged; payload and clock are exact.
        arm: in MuJoCo, with the payload.
        trajectory: the motion; the plan will do, what servos make of it differs to second order.
    """
    motion, sensor = rig.motion, rig.sensor
    assert next(iter(rig.payloads.values())).exact
    assert sensor.time_offset_prior == 0.0
    precision = np.zeros((3, arm.n))
    for order, noise in enumerate((motion.position_noise, motion.noise)):
        if noise is not None:
            precision[order] = np.array(noise) ** -2.0
    unit = sensor.sign / sensor.range_array
    known: dict[bytes, tuple[Array, Array, Array, Array]] = {}

    def at(t: Array) -> tuple[Array, Array, Array, Array]:
        key = t.tobytes()
        if key not in known:
            wrench, by_motion = _differences(arm, trajectory, t)
            nothing = np.zeros((t.size, 6, 10))
            known[key] = wrench * unit, by_motion * unit[:, None], nothing, nothing[:, :, 0]
        return known[key]

    return bound_common.Linearised(precision, at)


def _differences(arm: Arm, trajectory: JointTrajectory, t: Array) -> tuple[Array, Array]:
    """Wrench (N, 6), and by positions, velocities and accelerations of the joints (3, N, 6, n)."""
    state = [trajectory.position(t), trajectory.velocity(t), trajectory.acceleration(t)]
    by_motion = np.empty((3, t.size, 6, arm.n))
    for order, step in enumerate((STEP, 1.0, 1.0)):
        for joint, e in enumerate(step * np.eye(arm.n)):
            there = [x + e * (k == order) for k, x in enumerate(state)]
            back = [x - e * (k == order) for k, x in enumerate(state)]
            change = arm.ideal(*there).wrench - arm.ideal(*back).wrench
            by_motion[order, :, :, joint] = change / (2.0 * step)
    return arm.ideal(*state).wrench, by_motion
