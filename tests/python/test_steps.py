"""An offset that steps within a record: what is told is that of its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imperfect_cases import rig_of

import truewrench as tw
from truewrench.estimation.estimator import estimate


@pytest.mark.parametrize("share", [0.5, 0.85, 0.93])
def test_an_offset_that_steps_is_told_as_it_ends(share: float) -> None:
    rig = rig_of(plan={"duration": 20})
    run = tw.simulate(rig, seed=3)
    late = np.arange(len(run.log.raw)) >= share * len(run.log.raw)
    step = 0.02 * rig.sensor.channel_scale * np.array([0.6, -0.5, 0.4, -0.3, 0.3, 0.2])
    found = estimate(rig, [replace(run.log, raw=run.log.raw + late[:, None] * step)])
    std = found.offsets_std[0]
    assert np.abs((found.offsets[0] - run.truth.offset - step) / std).max() < 5.0
    assert np.abs(step / std).min() > 10.0
