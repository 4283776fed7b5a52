"""`ft_calib_data.yaml` of force_torque_tools, whose node `gravity_compensation` reads it.

The node subtracts `bias` from the wrench that it receives, and then the weight of the gripper: m g in the
force, com x m g in the torque. It knows no gain. Up to its release 1.2.0, g was what an accelerometer at rest
reads, upward; since then (May 2021) it is the opposite: each suits one of the two signs of `feels`.
"""

from pathlib import Path

import numpy as np
import yaml

from truewrench.io.exports.loss import Loss, loss_of_factors
from truewrench.io.exports.words import introduction, line, losses
from truewrench.model.calibration import Calibration

_FRAME = "ft_sensor"
_SUITED = {
    "payload_on_sensor": "the sources of May 2021 and later, not releases up to 1.2.0",
    "sensor_on_payload": "releases up to 1.2.0, not the sources of May 2021 and later",
}


def unfit(calibration: Calibration) -> str | None:
    """Why a calibration cannot be held."""
    sensor = calibration.rig.sensor
    if calibration.estimator == "reference":
        return (
            "it subtracts the weight of a payload; this calibration is from reference wrenches and knows none"
        )
    if not np.array_equal(sensor.nominal_gain_array, np.eye(sensor.n, 6)):
        return "it wants the wrench in N and N m; the raw channels of this sensor are something else"
    return None


def loss(calibration: Calibration) -> Loss:
    """What is lost against the whole gain."""
    return loss_of_factors(calibration, np.ones(6), np.ones(6))


def write(calibration: Calibration, path: Path) -> None:
    """Bias, mass and centre of mass of the payload that the last log carried."""
    sensor = calibration.rig.sensor
    name = calibration.logs[-1].payload
    payload = calibration.rig.payloads[name]
    body = calibration.payload_posterior.get(name, {})
    robot = calibration.rig.motion.robot
    center = body.get("center_of_mass", payload.center_of_mass)
    words = [
        *introduction(calibration),
        f"Fits gravity_compensation of {_SUITED[sensor.feels]}: else the weight would be added.",
        "For the driver's wrench: bias and weight are subtracted from it, its gain is not corrected.",
        "For a wrench that is corrected already (`truewrench stream`) set bias to zero.",
        *losses(loss(calibration)),
        f"Payload `{line(name)}`: everything beyond the sensing element.",
        "gripper_com_frame_id is the sensor's frame" + ("." if robot else ": adapt it."),
    ]
    parameters = {
        "bias": [float(value) for value in calibration.offset],
        "gripper_com_child_frame_id": "gripper_com",
        "gripper_com_frame_id": robot.sensor_frame if robot else _FRAME,
        "gripper_com_pose": [*(float(value) for value in center), 0.0, 0.0, 0.0],
        "gripper_mass": float(body.get("mass", payload.mass)),
    }
    comment = "".join(f"# {line}\n" for line in words)
    path.write_text(
        comment + yaml.safe_dump(parameters, sort_keys=False, allow_unicode=True), encoding="utf-8"
    )
