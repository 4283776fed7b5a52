"""A slow filter of an accurate sensor is no disturbance."""

from __future__ import annotations

import numpy as np
import pytest
from record_cases import light_rig

import truewrench as tw
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun


def _filtered(hz: float, gravity: list[float] | None = None) -> tuple[Rig, SimulatedRun]:
    """A record of 12 s at 100 Hz whose channels one pole filters."""
    bare = light_rig(seconds=12, rate=100, noise=[0.004] * 3 + [4e-4] * 3).to_mapping()
    bare["gravity"] = gravity or [0.0, 0.0, 0.0]
    filtered = bare["simulate"] | {"imperfections": {"sensor_filter": {"hz": hz}}}
    rig = Rig.from_mapping(bare | {"simulate": filtered})
    rng = np.random.default_rng(1)
    size, frequency = rng.uniform(0.2, 0.6, (6, 6)) / np.sqrt(6.0), rng.uniform(0.2, 1.1, (6, 6))
    motion = HarmonicTwist(size, frequency, rng.uniform(0.0, 2.0 * np.pi, (6, 6)), 12)
    return rig, tw.simulate(rig, motion, seed=1)


@pytest.mark.parametrize("estimator", ["map", "online"])
@pytest.mark.parametrize("gravity", [[0.0, 0.0, 0.0], [3.0, -5.0, 7.0]])
def test_products_that_a_filter_averages_are_no_disturbance(gravity: list[float], estimator: str) -> None:
    """8 Hz, as a controller offers it: what it averages of 5 kg is as large as the noise, and none."""
    rig, run = _filtered(8.0, gravity)
    found = tw.calibrate(rig, run.log, estimator=estimator, held_out=False)  # type: ignore[arg-type]
    assert found.verdict.usable
    assert np.abs((found.gain - run.truth.gain) / found.gain_std).max() < 4.0


def test_a_pole_is_told_by_its_corner_though_samples_are_thinned() -> None:
    """Of 5 Hz one sample of five is read, a mean of 50 ms: its corner was told as 6.2 Hz."""
    rig, run = _filtered(5.0)
    found = tw.calibrate(rig, run.log, held_out=False)
    [pole] = [a for a in found.assumed if "look filtered" in a.evidence]
    assert pole.sigma is not None
    assert pole.value == pytest.approx(1.0 / (2.0 * np.pi * 5.0), abs=5.0 * pole.sigma)
