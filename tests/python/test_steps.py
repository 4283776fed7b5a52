"""An offset that steps within a record: what is told is that of its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imperfect_cases import rig_of

import truewrench as tw
from truewrench.estimation.estimator import estimate
from truewrench.judging.words import findings


@pytest.mark.parametrize("share", [0.5, 0.85, 0.93])
def test_an_offset_that_steps_is_told_as_it_ends(share: float) -> None:
    rig = rig_of(plan={"duration": 20})
    run = tw.simulate(rig, seed=3)
    late = np.arange(len(run.log.raw)) >= share * len(run.log.raw)
    step = 0.02 * rig.sensor.channel_scale * np.array([0.6, -0.5, 0.4, -0.3, 0.3, 0.2])
    log = replace(run.log, raw=run.log.raw + late[:, None] * step)
    found = estimate(rig, [log])
    std = found.offsets_std[0]
    assert np.abs((found.offsets[0] - run.truth.offset - step) / std).max() < 5.0
    assert np.abs(step / std).min() > 10.0
    (told,) = (one for one in findings(found, rig, [log]) if one.what.startswith("step"))
    assert ("contact" in told.what and "contact that lasts to the end" in told.evidence) == (share > 0.8)
