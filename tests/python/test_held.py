"""What a record hardly tells of a filter is held at its mean or found; the fit comes to an end."""

from __future__ import annotations

import numpy as np
import pytest
from record_cases import light_rig

import truewrench as tw
from truewrench.estimation.estimator import estimate
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import Rig

SECONDS = 12.0


def motion() -> HarmonicTwist:
    rng = np.random.default_rng(150)
    frequency = np.tile(np.array([0.15, 0.3, 0.45, 0.65, 0.85, 1.1])[:, None], (1, 6))
    size, phase = 0.25 * rng.uniform(0.2, 0.7, (6, 6)), rng.uniform(0, 2 * np.pi, (6, 6))
    return HarmonicTwist(size, frequency, phase, SECONDS)


@pytest.mark.parametrize("late", np.linspace(0.0117, 0.0123, 7))
def test_a_filter_at_the_edge_of_being_told_comes_to_an_end(late: float) -> None:
    """The later the sensor, the more is told of why; at 12 ms more at the mean than where that leads."""
    stated = light_rig(seconds=SECONDS, rate=100, time_offset_prior=0.005).to_mapping()
    rig = Rig.from_mapping({**stated, "simulate": {**stated["simulate"], "time_offset": float(late)}})
    run = tw.simulate(rig, motion(), seed=150)
    found = estimate(rig, [run.log])
    assert found.converged
    z = (found.gain - run.truth.gain).ravel() / np.sqrt(np.diag(found.covariance)[:36])
    assert np.abs(z).max() < 4.5
