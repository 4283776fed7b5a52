"""The Cramer-Rao bound of a joint rig, its wrench linearised by differences of MuJoCo's sensors.

As bound_common.py: nothing of the core, of Pinocchio, or of what plans and calibrations predict. Payload and
clock exact.
"""

from __future__ import annotations

import bound_common
import numpy as np
from numpy.typing import NDArray

from truewrench.arm_simulation.model import Arm
from truewrench.rig import Rig
from truewrench.trajectory_joint import JointTrajectory

Array = NDArray[np.float64]

STEP = 1e-4  # [rad, m] of positions; by velocities and accelerations differences of any length are exact


def bound(rig: Rig, arm: Arm, trajectory: JointTrajectory, gain: Array, spacing: float) -> Array:
    """Covariance (6n, 6n) that no estimator of the normalised gains can beat, the rig's priors included.

    Args:
        rig: positions and velocities are logged; payload and clock are exact.
        arm: in MuJoCo, with the payload.
        trajectory: the motion; the plan will do, what servos make of it differs to second order.
        gain: the true gain (n, 6), SI.
        spacing: of the knots that stand for the motion of the joints [s].
    """
    motion, sensor = rig.motion, rig.sensor
    assert next(iter(rig.payloads.values())).exact
    assert sensor.time_offset_prior == 0.0
    precision = np.zeros((3, arm.n))
    for order, noise in enumerate((motion.position_noise, motion.noise)):
        if noise is not None:
            precision[order] = np.array(noise) ** -2.0
    unit = sensor.sign / sensor.range_array

    def at(t: Array) -> tuple[Array, Array, Array, Array]:
        state = [trajectory.position(t), trajectory.velocity(t), trajectory.acceleration(t)]
        by_motion = np.empty((3, t.size, 6, arm.n))
        for order, step in enumerate((STEP, 1.0, 1.0)):
            for joint, e in enumerate(step * np.eye(arm.n)):
                there = [x + e * (k == order) for k, x in enumerate(state)]
                back = [x - e * (k == order) for k, x in enumerate(state)]
                change = arm.ideal(*there).wrench - arm.ideal(*back).wrench
                by_motion[order, :, :, joint] = change / (2.0 * step) * unit
        nothing = np.zeros((t.size, 6, 10))
        return arm.ideal(*state).wrench * unit, by_motion, nothing, nothing[:, :, 0]

    linear = bound_common.Linearised(precision, at)
    return bound_common.bound_of(rig, linear, gain, trajectory.duration, spacing)
