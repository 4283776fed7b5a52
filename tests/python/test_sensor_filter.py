"""A slow filter of an accurate sensor is no disturbance."""

from __future__ import annotations

import numpy as np
import pytest
from record_cases import light_rig

import truewrench as tw
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig


@pytest.mark.parametrize("estimator", ["map", "online"])
@pytest.mark.parametrize("gravity", [[0.0, 0.0, 0.0], [3.0, -5.0, 7.0]])
def test_products_that_a_filter_averages_are_no_disturbance(gravity: list[float], estimator: str) -> None:
    """8 Hz, as a controller offers it: what it averages of 5 kg is as large as the noise, and none."""
    bare = light_rig(seconds=12, rate=100, noise=[0.004] * 3 + [4e-4] * 3).to_mapping()
    bare["gravity"] = gravity
    filtered = bare["simulate"] | {"imperfections": {"sensor_filter": {"hz": 8.0}}}
    rig = Rig.from_mapping(bare | {"simulate": filtered})
    rng = np.random.default_rng(1)
    size, frequency = rng.uniform(0.2, 0.6, (6, 6)) / np.sqrt(6.0), rng.uniform(0.2, 1.1, (6, 6))
    run = tw.simulate(rig, HarmonicTwist(size, frequency, rng.uniform(0.0, 2.0 * np.pi, (6, 6)), 12), seed=1)
    found = tw.calibrate(rig, run.log, estimator=estimator, held_out=False)  # type: ignore[arg-type]
    assert found.verdict.usable
    assert np.abs((found.gain - run.truth.gain) / found.gain_std).max() < 4.0
