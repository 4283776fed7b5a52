"""Arms whose joint positions alone are logged: some joints rest, and slow turns tell little of an inertia."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from tool_cases import Array, newton_euler

import truewrench as tw
from truewrench import robots
from truewrench.model.files import read_yaml
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.robot.track import tracked

MASS, CENTER = 1.35, np.array([0.012, -0.008, 0.065])
INERTIA = np.array([[4e-3, 2e-4, -1e-4], [2e-4, 3.5e-3, 3e-4], [-1e-4, 3e-4, 2e-3]])
SIZES = {0: 1.0, 1: 0.3, 2: 0.3, 3: 0.3, 4: 0.3, 5: 1.0}  # of a joint's turns, relative


def rig_of() -> Rig:
    """A UR10 with encoders alone and an accurate sensor."""
    path = robots.path("ur10_tool")
    stated = dict(read_yaml(path)[0])
    motion = {key: value for key, value in stated["motion"].items() if key != "noise"}
    sensor = {"noise": [0.02] * 3 + [3e-4] * 3, "range": [65.0, 65.0, 200.0, 5.0, 5.0, 5.0]}
    return tool_rig({**stated, "motion": motion, "sensor": {**stated["sensor"], **sensor}}, path)


def log_of(rig: Rig, size: float, rest: tuple[int, ...], seed: int, *, upright: bool = False) -> Log:
    """20 s at 100 Hz, three sines of 0.1 to 0.5 Hz a joint that moves; kinematics by Pinocchio alone.

    `upright`: the fourth joint takes back what the two before it turn, about axes parallel to its own.
    """
    rng, time = np.random.default_rng(seed), 0.01 * np.arange(2000)
    q, v, a = np.zeros((3, time.size, 6))
    for joint in set(SIZES) - set(rest):
        for _ in range(3):
            omega, phase = 2 * np.pi * rng.uniform(0.1, 0.5), rng.uniform(0, 2 * np.pi)
            turn = size * SIZES[joint]
            q[:, joint] += turn * np.sin(omega * time + phase)
            v[:, joint] += turn * omega * np.cos(omega * time + phase)
            a[:, joint] -= turn * omega**2 * np.sin(omega * time + phase)
    for turns in (q, v, a) if upright else ():
        turns[:, 3] -= turns[:, 1:3].sum(axis=1)
    q += np.asarray(rig.motion.initial_position)
    assert rig.motion.robot is not None
    model = pin.buildModelFromUrdf(str(robots.path("ur10_tool").with_name("ur10.urdf")))
    data, sensor = model.createData(), model.getFrameId(rig.motion.robot.sensor_frame)
    nu, rate, fall = np.empty((time.size, 6)), np.empty((time.size, 6)), np.empty((time.size, 3))
    for k in range(time.size):
        pin.forwardKinematics(model, data, pin.integrate(model, pin.neutral(model), q[k]), v[k], a[k])
        pin.updateFramePlacement(model, data, sensor)
        nu[k] = pin.getFrameVelocity(model, data, sensor, pin.LOCAL).vector
        rate[k] = pin.getFrameAcceleration(model, data, sensor, pin.LOCAL).vector
        fall[k] = data.oMf[sensor].rotation.T @ rig.gravity_array
    raw = newton_euler(MASS, CENTER, INERTIA, nu, rate, fall)
    raw += rig.sensor.noise_array * rng.normal(size=raw.shape)
    position = q + 5e-5 * rng.normal(size=q.shape)
    log = Log(None, "tool", "", np.rint(1e9 * time).astype(np.int64), raw, position=position)
    return tracked(rig, [log])[0]


def deviations(tool: tw.Tool) -> Array:
    """Of mass, centre of mass and inertia, sigma."""
    elements = INERTIA[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.concatenate(
        [
            [(tool.mass - MASS) / tool.mass_std],
            (tool.center_of_mass - CENTER) / tool.center_of_mass_std,
            (tool.inertia - elements) / tool.inertia_std,
        ]
    )


@pytest.mark.parametrize("rest", [(), (3, 4), (0, 1, 2), (0, 1, 2, 3)])
def test_joints_that_rest_take_nothing_from_those_that_move(rest: tuple[int, ...]) -> None:
    rig = rig_of()
    tool = tw.identify_tool(rig, log_of(rig, 0.3, rest, seed=1))
    assert np.abs(deviations(tool)).max() < 4.0
    assert tool.determined["mass"]


@pytest.mark.parametrize("seed", range(4))
def test_an_inertia_that_slow_turns_do_not_tell_is_not_told(seed: int) -> None:
    """The sensor tells the angular acceleration better than the encoders: its noise is no inertia."""
    rig = rig_of()
    tool = tw.identify_tool(rig, log_of(rig, 0.04, (3, 4), seed, upright=True))
    assert np.abs(deviations(tool)).max() < 3.0
    assert not any(tool.determined["inertia"][:2])
    assert tool.determined["inertia"][2]
