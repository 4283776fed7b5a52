"""`online` of arms that rest before they move, clocks a little apart: it begins with the motion."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from truewrench import robots
from truewrench.estimation.estimator import estimate
from truewrench.model.arrays import Array
from truewrench.model.motion.trajectory_joint import JointTrajectory, SplineJoints
from truewrench.model.rig import Rig, load_rig
from truewrench.planning.planner import plan
from truewrench.simulation.arm import simulate_arm


@dataclass(frozen=True)
class Held:
    """A motion from rest to rest, with so much rest before and after it [s]."""

    motion: JointTrajectory
    rest: float

    @property
    def duration(self) -> float:
        return self.motion.duration + 2.0 * self.rest

    def _within(self, time: Array) -> Array:
        return np.clip(time - self.rest, 0.0, self.motion.duration)

    def position(self, time: Array) -> Array:
        return self.motion.position(self._within(time))

    def velocity(self, time: Array) -> Array:
        return self.motion.velocity(self._within(time))

    def acceleration(self, time: Array) -> Array:
        inside = (time > self.rest) & (time < self.duration - self.rest)
        return self.motion.acceleration(self._within(time)) * inside[:, None]


@pytest.fixture(scope="module")
def planned() -> tuple[Rig, JointTrajectory]:
    path = robots.path("ur10_ground")
    settings = load_rig(path).to_mapping()
    settings["plan"] |= {"duration": 12, "seed": 0}
    settings["simulate"] |= {"time_offset": -0.003}
    rig = Rig.from_mapping(settings, path)
    motion = plan(rig).design.motion
    assert isinstance(motion, SplineJoints)
    return rig, motion


@pytest.mark.parametrize("rest", [0.3, 1.0])
def test_a_rest_before_the_motion_costs_no_honesty(planned: tuple[Rig, JointTrajectory], rest: float) -> None:
    """With 1 s of it NEES was 9 to 12: of the first lag half was at rest, and it chose knots and sizes."""
    rig, motion = planned
    unit = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
    nees = []
    for seed in (1, 2):
        run = simulate_arm(rig, Held(motion, rest), seed=seed)
        found = estimate(rig, [replace(run.log, tracking=None)], online=True)
        error = ((found.gain - run.truth.gain) * unit).ravel()
        nees.append(error @ np.linalg.solve(found.normalised_covariance[:36, :36], error) / 36.0)
    assert np.mean(nees) < 1.5
