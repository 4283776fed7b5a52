"""From a rig to a planned motion: design it, look at it 1000 times a second, say what it promises."""

import time
from dataclasses import replace
from typing import Literal

import numpy as np

from truewrench.model.errors import InputError, UnsupportedError, check_word
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import SplineTwist, Trajectory
from truewrench.model.motion.trajectory_joint import JointTrajectory, SplineJoints
from truewrench.model.rig import Rig
from truewrench.planning.period import check_harmonics
from truewrench.planning.prediction import Prediction, predict
from truewrench.planning.result import Design, Plan
from truewrench.planning.search import Progress
from truewrench.planning.twist_plan import design_twist
from truewrench.planning.wrench_plan import design_wrench
from truewrench.simulation.free_body import simulate

_BOUNDS = ("position", "velocity", "acceleration", "jerk", "workspace")
_SIMULATED = 60.0  # [s] of a motion that repeats itself: the rest is more of the same


def plan(
    rig: Rig,
    method: Literal["optimal", "wrench"] = "optimal",
    *,
    criterion: Literal["A", "D"] = "A",
    payload: str | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Plan the motion of a rig by its sections `plan` and `limits`.

    Args:
        rig: sensor, payloads, motion, limits.
        method: `optimal`, or the sinusoidal wrenches of [A00] 13-17.
        criterion: `A`, RMS sigma of the normalised gains; `D`, volume of their confidence region.
        payload: name of the payload that is carried; the first of the rig if left out.
        progress: is told what is being done, and the share of it that is done.

    Raises:
        InputError: for a payload that the rig does not have, settings that no motion can have, or a twist
            that nothing bounds.
        UnsupportedError: for a combination that is not supported.
    """
    started = time.perf_counter()
    rig.check_motion("which a plan needs")
    check_word("method", method, ("optimal", "wrench"))
    check_word("criterion", criterion, ("A", "D"))
    name = rig.payload_named(payload)
    tell = progress or (lambda phase, share: None)
    if rig.motion.source == "imu":
        expected = "`twist` or `joints`: a motion is planned in these"
        raise UnsupportedError.at(rig.path, "motion.source", "`imu`", expected)
    check_limits(rig)
    if method == "optimal":
        check_harmonics(rig)
    design = _design(rig, name, method, criterion, tell)
    tell("prediction", None)
    moves = not design.obstacles and bool(np.abs(design.preview.twist).max() > 0.0)
    prediction = _predict(rig, name, design) if moves else None
    return Plan(rig, name, method, criterion, design, prediction, time.perf_counter() - started)


def check_limits(rig: Rig) -> None:
    """Refuse a twist that nothing bounds: the sensor's range alone would let it go through any wall.

    A URDF states the range and speed of its joints.
    """
    if rig.motion.source == "twist" and not any(getattr(rig.limits, key) for key in _BOUNDS):
        expected = (
            "`velocity` and `acceleration`, six numbers each, and what else bounds the motion: "
            "`position`, `jerk`, `workspace`"
        )
        raise InputError.at(rig.path, "limits", "nothing that bounds the motion", expected)


def _design(
    rig: Rig, payload: str, method: Literal["optimal", "wrench"], criterion: Literal["A", "D"], tell: Progress
) -> Design:
    if rig.motion.source == "twist":
        if method == "wrench":
            return design_wrench(rig, payload, tell)
        return design_twist(rig, payload, criterion, tell)
    # Pinocchio is heavy
    if method == "wrench":
        from truewrench.planning.joint_wrench import design_joint_wrench

        return design_joint_wrench(rig, payload, tell)
    from truewrench.planning.joint_plan import design_joints

    return design_joints(rig, payload, criterion, tell)


def _predict(rig: Rig, payload: str, design: Design) -> Prediction:
    duration = design.motion.duration
    span = min(duration, max(1, round(_SIMULATED / design.period)) * design.period)
    motion = design.motion

    def simulated(nominal: Rig) -> Log:
        return simulated_log(nominal, payload, motion, span)

    return predict(rig, payload, motion, design.preview, simulated, span / duration)


def simulated_log(rig: Rig, payload: str, motion: Trajectory | JointTrajectory, span: float) -> Log:
    """The log of the first `span` seconds of a planned motion, as the rig's `simulate` says."""
    if isinstance(motion, SplineTwist):
        return simulate(rig, replace(motion, duration=span), payload=payload).log
    from truewrench.planning.joint_plan import simulated_joints

    assert isinstance(motion, SplineJoints)
    return simulated_joints(rig, payload, replace(motion, duration=span))
