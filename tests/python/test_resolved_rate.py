"""An arm in velocity mode follows a planned twist as far as its joints' limits let it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from truewrench import robots
from truewrench.model.errors import InputError
from truewrench.model.rig import load_rig
from truewrench.planning.resolved_rate import JointLimits, follow_twist, limits_of
from truewrench.robot.arm import Robot, robot_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sines:
    """A twist that starts and ends at zero."""

    amplitude: Array
    turns: Array
    duration: float

    def twist(self, time: Array) -> Array:
        return self.amplitude * np.sin(2 * np.pi * self.turns * time[:, None] / self.duration)

    def acceleration(self, time: Array) -> Array:
        rate = 2 * np.pi * self.turns / self.duration
        return self.amplitude * rate * np.cos(rate * time[:, None])


TURNS = np.array([1, 2, 3, 2, 1, 3])
PANDA = Sines(np.full(6, 0.15), TURNS, 6.0)
SSRMS = Sines(np.array([0.2, 0.2, 0.2, 6e-3, 6e-3, 6e-3]), TURNS, 60.0)
CASES = [("panda", PANDA, 100.0), ("ssrms", SSRMS, 10.0)]


def arm(name: str) -> tuple[Robot, JointLimits, Array]:
    rig = load_rig(robots.path(name))
    return robot_of(rig), limits_of(rig), np.array(rig.motion.initial_position)


def pseudo_inverse(robot: Robot, plan: Sines, start: Array, rate: float) -> Array:
    """The textbook's resolved rate: positions (N, n) without any thought of limits."""
    steps = round(plan.duration * rate)
    q, positions = start.copy(), [start]
    for k in range(steps):
        nu = plan.twist(np.array([(k + 0.5) / rate]))[0]
        q = q + np.linalg.pinv(robot.jacobian(q)[0]) @ nu / rate
        positions.append(q)
    return np.array(positions)


def worst(position: Array, velocity: Array, limits: JointLimits) -> float:
    """By how much limits are exceeded [rad, rad/s]; negative: how far away they stay."""
    excess = [limits.lower - position, position - limits.upper, np.abs(velocity) - limits.velocity]
    return float(max(x.max() for x in excess))


@pytest.mark.parametrize(("name", "plan", "rate"), CASES)
def test_a_twist_within_the_limits_is_followed_closely(name: str, plan: Sines, rate: float) -> None:
    robot, limits, start = arm(name)
    followed = follow_twist(robot, plan, start, limits=limits, rate=rate)
    assert followed.time[-1] == plan.duration
    np.testing.assert_array_equal(followed.position[0], start)
    assert worst(followed.position, followed.velocity, limits) <= 1e-6
    assert np.abs(followed.twist_error).max() <= 1e-3 * np.abs(plan.amplitude).max()
    assert followed.position_error.max() < 2e-4
    # where the sensor is, by the poses alone
    R, p = robot.pose(followed.position)
    v = np.einsum("kji,kj->ki", R[:-1], np.diff(p, axis=0)) * rate
    np.testing.assert_allclose(v, plan.twist(followed.time[:-1] + 0.5 / rate)[:, :3], atol=5e-3)


@pytest.mark.parametrize(("name", "plan", "rate"), CASES)
def test_limits_hold_when_the_plan_asks_too_much(name: str, plan: Sines, rate: float) -> None:
    robot, limits, start = arm(name)
    tight = JointLimits(start - 0.05, start + 0.05, limits.velocity / 3)
    followed = follow_twist(
        robot, replace(plan, amplitude=4 * plan.amplitude), start, limits=tight, rate=rate
    )
    assert worst(followed.position, followed.velocity, tight) <= 1e-6
    assert np.abs(followed.twist_error).max() > 0.1 * np.abs(plan.amplitude).max()  # and it is reported
    moved = np.diff(followed.position, axis=0) * rate
    np.testing.assert_allclose(followed.velocity[:-1], moved, atol=1e-9)


@pytest.mark.parametrize(("name", "plan", "rate"), CASES)
def test_seven_joints_avoid_a_limit_that_the_pseudo_inverse_violates(
    name: str, plan: Sines, rate: float
) -> None:
    robot, limits, start = arm(name)
    free = pseudo_inverse(robot, plan, start, rate)
    excursion = np.abs(free - start).max(axis=0)
    joint = 0  # of the shoulder: for it the elbow can swing out
    half = JointLimits(limits.lower.copy(), limits.upper.copy(), limits.velocity)
    half.lower[joint] = start[joint] - excursion[joint] / 2
    half.upper[joint] = start[joint] + excursion[joint] / 2
    assert worst(free, np.zeros_like(free), half) > 0.4 * excursion[joint]
    followed = follow_twist(robot, plan, start, limits=half, rate=rate)
    assert worst(followed.position, followed.velocity, half) <= 1e-6
    assert np.abs(followed.twist_error).max() <= 5e-3 * np.abs(plan.amplitude).max()


def test_a_plan_of_the_centre_of_mass_moves_the_sensor_beneath_it() -> None:
    robot, limits, start = arm("panda")
    lever = np.array([0.03, 0.0, 0.07])
    followed = follow_twist(robot, PANDA, start, limits=limits, lever=lever)
    wanted = PANDA.twist(followed.time[:-1] + 0.005)
    at_lever = followed.twist[:-1, :3] + np.cross(followed.twist[:-1, 3:], lever)
    np.testing.assert_allclose(at_lever, wanted[:, :3], atol=1e-3)


def test_a_start_outside_the_limits_is_refused() -> None:
    robot, limits, start = arm("panda")
    start[3] = 0.2
    with pytest.raises(InputError, match=r"start, joint `panda_joint4`: found 0\.2, expected -3\.0718 to"):
        follow_twist(robot, PANDA, start, limits=limits)
    with pytest.raises(InputError, match=r"start: found 6 joint positions, expected 7"):
        follow_twist(robot, PANDA, start[:6], limits=limits)
