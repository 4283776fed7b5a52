"""The robot model against the sensors of MuJoCo, an independent physics engine, on random states.

MuJoCo fuses links that have no joint, unless it is told not to. Its force sensor reads the wrench that
moves the payload (`sensor_on_payload`), the opposite of the payload's reaction.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from truewrench import robots
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of

Array = NDArray[np.float64]

STATES = 50
SENSORS = {
    "velocity": mujoco.mjtSensor.mjSENS_VELOCIMETER,
    "rate": mujoco.mjtSensor.mjSENS_GYRO,
    "specific force": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
    "angular acceleration": mujoco.mjtSensor.mjSENS_FRAMEANGACC,  # along the world's axes
    "force": mujoco.mjtSensor.mjSENS_FORCE,
    "moment": mujoco.mjtSensor.mjSENS_TORQUE,
}


def rig_of(name: str) -> Rig:
    """The rig, in place of an unknown tool with a known payload."""
    path = robots.path(name)
    settings = yaml.safe_load(path.read_text())
    bar = {"mass": 2, "center_of_mass": [0.03, 0, 0.07], "inertia": {"xx": 0.003, "yy": 0.008, "zz": 0.007}}
    return Rig.from_mapping({"payloads": {"default": bar}} | settings, path)


def readings(name: str, q: Array, qd: Array, qdd: Array, gravity: Array) -> dict[str, Array]:
    """What MuJoCo's sensors at `ft` read with the rig's payload welded to it."""
    rig = rig_of(name)
    assert rig.urdf_path is not None
    spec = mujoco.MjSpec.from_string(rig.urdf_path.read_text())
    spec.compiler.fusestatic = False
    spec.option.gravity = gravity
    payload, body = rig.payloads["default"], spec.body("ft")
    body.mass, body.ipos, body.explicitinertial = payload.mass, payload.center_of_mass_array, True
    i = payload.inertia_matrix
    body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    body.add_site(name="ft")
    for sensor, kind in SENSORS.items():
        spec.add_sensor(name=sensor, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="ft")
    model = spec.compile()
    data = mujoco.MjData(model)
    assert [model.joint(j).name for j in range(model.njnt)] == list(robot_of(rig).joints)
    read: dict[str, list[Array]] = {sensor: [] for sensor in SENSORS} | {"R": [], "p": []}
    for state in zip(q, qd, qdd, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)  # the accelerations as given: no integrator has a say
        for sensor in SENSORS:
            read[sensor].append(data.sensor(sensor).data.copy())
        read["R"].append(data.site("ft").xmat.reshape(3, 3).copy())
        read["p"].append(data.site("ft").xpos.copy())
    return {key: np.array(values) for key, values in read.items()}


def close(found: Array, expected: Array) -> None:
    """Equal to 1e-9 of the largest."""
    assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("name", robots.NAMES + robots.TOOL_RIGS)
def test_motion_gravity_and_wrench_are_those_that_mujoco_measures(name: str) -> None:
    rig = rig_of(name)
    robot = robot_of(rig)
    draw = np.random.default_rng(11)
    q = draw.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), size=(STATES, robot.n))
    qd, qdd = draw.normal(size=(2, STATES, robot.n))
    gravity = np.array([0.3, -0.2, -9.81])
    read = readings(name, q, qd, qdd, gravity)

    motion = robot.motion(q, qd, qdd)
    close(motion.R_root_sensor, read["R"])
    close(motion.p_root_sensor, read["p"])
    v, omega = motion.twist[:, :3], motion.twist[:, 3:]
    close(v, read["velocity"])
    close(omega, read["rate"])
    gravity_sensor = np.einsum("kji,j->ki", motion.R_root_sensor, gravity)
    close(motion.acceleration[:, :3] + np.cross(omega, v) - gravity_sensor, read["specific force"])
    turning = np.einsum("kij,kj->ki", motion.R_root_sensor, motion.acceleration[:, 3:])
    close(turning, read["angular acceleration"])
    still = readings(name, q, 0 * qd, 0 * qdd, gravity)
    close(gravity_sensor, -still["specific force"])

    assert rig.motion.of == "sensor"
    wrench = payload_wrench(rig, "default", motion.twist, motion.acceleration, gravity_sensor)
    assert rig.sensor.feels == "payload_on_sensor"
    close(wrench[:, :3], -read["force"])
    close(wrench[:, 3:], -read["moment"])
