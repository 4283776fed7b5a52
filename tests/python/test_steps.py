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


@pytest.mark.parametrize("size", [3e-3, 1e-2])
@pytest.mark.parametrize("seed", range(3))
def test_a_step_that_leaves_nothing_slow_is_no_drift(size: float, seed: int) -> None:
    rig = rig_of({"step": {"size": size, "time": 9.137}}, plan={"duration": 20})
    run = tw.simulate(rig, seed=seed)
    found = estimate(rig, [run.log])
    (step,) = found.steps[0]
    assert step.time == pytest.approx(9.137, abs=0.1)  # a block of knots, in which it is sought, has 0.25 s
    direction = np.array(run.truth.imperfections["step"]["direction"])
    assert np.abs((step.size - size * direction) / step.std).max() < 4.0
    assert all(slow.form == "none" for slow in found.slow[0])


@pytest.mark.parametrize("kind", ["drift", "random_walk"])
def test_what_wanders_is_no_step(kind: str) -> None:
    rig = rig_of({kind: 1e-3}, plan={"duration": 20})
    for seed in range(4):
        assert not estimate(rig, [tw.simulate(rig, seed=seed).log]).steps[0]
