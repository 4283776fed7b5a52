"""The arm as the core moves it: a product of exponentials (include/truewrench/model/chain.hpp)."""

from __future__ import annotations

import numpy as np

from truewrench import _core
from truewrench.robot.arm import Robot

__all__ = ["chain_of"]


def chain_of(robot: Robot) -> _core.Chain:
    """The joints of a robot from the root to its sensor frame."""
    import pinocchio as pin

    data, q = robot.model.createData(), np.zeros(robot.n)
    xi = pin.computeFrameJacobian(robot.model, data, q, robot.frame_id, pin.WORLD)
    placement = pin.updateFramePlacement(robot.model, data, robot.frame_id)
    return _core.Chain(np.ascontiguousarray(xi.T), placement.rotation, placement.translation)
