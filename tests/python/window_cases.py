"""Rigs and errors that the tests of the window estimators share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs import changed, two_payloads
from scipy.stats import chi2

from truewrench import _core
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.rig import Rig
from truewrench.simulation.free_body import SimulatedRun

Array = NDArray[np.float64]
Method = Literal["map", "online"]

FITTED = _core.WindowStatus.fitted
GRAVITY = [0, 0, -9.81]
METHODS = pytest.mark.parametrize("method", ["map", "online"])


def rig_of(**changes: Any) -> Rig:
    return Rig.from_mapping(changed(two_payloads("table_1"), **changes))


def error(rig: Rig, estimate: WindowEstimate, runs: Sequence[SimulatedRun]) -> Array:
    """Error of [gain, offset of the last log] (7n,), normalised."""
    sensor, truth = rig.sensor, runs[-1].truth
    gain = (estimate.gain - truth.gain) * sensor.range_array / sensor.channel_scale[:, None]
    return np.append(gain.ravel(), (estimate.offsets[-1] - truth.offset) / sensor.channel_scale)


def nees(rig: Rig, estimate: WindowEstimate, runs: Sequence[SimulatedRun]) -> float:
    """Squared error in units of the claimed covariance, per parameter."""
    d = error(rig, estimate, runs)
    return float(d @ np.linalg.solve(estimate.normalised_covariance, d) / d.size)


def honest(scores: Sequence[float], size: int) -> bool:
    """Whether the mean lies in the 99.8% interval of chi-square, widened by 0.05."""
    freedom = len(scores) * size
    low, high = chi2.ppf([0.001, 0.999], freedom) / freedom
    return bool(low - 0.05 < np.mean(scores) < high + 0.05)


UNCERTAIN = {"mass": 1e-3, "center_of_mass": 5e-4, "inertia": 1e-2}


def uncertain_rig(uncertainty: dict[str, float] = UNCERTAIN, **changes: Any) -> Rig:
    """Payload and clock drawn from exactly what the rig states of them."""
    payloads = {"table_1": {**rig_of().to_mapping()["payloads"]["table_1"], "uncertainty": uncertainty}}
    return rig_of(
        payloads=payloads,
        sensor={"time_offset_prior": 5e-3},
        simulate={"payload": "random", "time_offset": "random"},
        plan={"duration": 10},
        **changes,
    )
