"""An accelerometer at the sensor beside a measured twist: honest, and better than the twist alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from record_cases import G, estimate, nees, rig_with
from scipy.interpolate import make_interp_spline

from truewrench.estimation.assumptions import Assumptions
from truewrench.estimation.record import recorded
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate

Array = NDArray[np.float64]

NOISE = 5e-3  # [m/s^2]
BIAS = np.array([0.05, -0.03, 0.04])
CENTER = np.array([0.2, 0.0, 0.0])


def with_accelerometer(rig: Rig, seed: int) -> tuple[SimulatedRun, Log]:
    """A simulated log, and the same with what an accelerometer at the sensor reads."""
    run = simulate(rig, seed=seed)
    still = simulate(
        rig.model_copy(update={"motion": rig.motion.model_copy(update={"noise": (1e-12,) * 6})}), seed=seed
    ).log
    assert still.twist is not None
    told = np.isfinite(still.twist).all(axis=1)
    spline = make_interp_spline(still.time[told], still.twist[told], k=7)
    twist, rate = spline(still.time), spline.derivative()(still.time)
    if rig.motion.of == "com":  # of a rigid body
        omega, alpha = twist[:, 3:], rate[:, 3:]
        twist, rate = twist.copy(), rate.copy()
        twist[:, :3] -= np.cross(omega, CENTER)
        rate[:, :3] -= np.cross(alpha, CENTER)
    force = rate[:, :3] + np.cross(twist[:, 3:], twist[:, :3])
    if still.gravity is not None:
        force -= still.gravity
    noise = NOISE * np.random.default_rng(seed).normal(size=force.shape)
    return run, replace(run.log, specific_force=force + BIAS + noise)


@pytest.mark.parametrize("gravity", [[0, 0, 0], G])
@pytest.mark.parametrize("of", ["com", "sensor"])
def test_gains_are_better_known_and_as_well_as_they_say(
    settings: dict[str, Any], gravity: list[float], of: str
) -> None:
    sensor = {"noise": [0.04 * x for x in settings["sensor"]["noise"]], "discrepancy": 0}
    exact = {**settings["payloads"]["default"], "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0}}
    stated: dict[str, Any] = {"sensor": sensor, "gravity": gravity, "payloads": {"default": exact}}
    plain = rig_with(settings, **stated, motion={"of": of})
    rig = rig_with(settings, **stated, motion={"of": of, "acceleration_noise": [NOISE] * 3})
    scores, better = [], []
    for seed in range(5):
        run, log = with_accelerometer(plain, seed)
        found, alone = estimate(rig, log), estimate(plain, run.log)
        scores.append(nees(found, rig, run.truth))
        better.append(np.trace(alone.gain_covariance) / np.trace(found.gain_covariance))
    assert 0.6 < np.mean(scores) < 1.45
    assert np.mean(better) > 1.5  # variances: 1.8 to 2.2


def test_one_whose_lever_costs_more_than_it_tells_is_passed_over(settings: dict[str, Any]) -> None:
    body = {**settings["payloads"]["default"], "center_of_mass": [2.0, 0.0, 0.0]}
    rig = rig_with(settings, payloads={"default": body}, motion={"acceleration_noise": [1e-2] * 3})
    log = simulate(rig).log
    log = replace(log, specific_force=np.zeros((len(log.time_ns), 3)))
    notes: list[str] = []
    assert len(recorded(rig, Assumptions.of(rig, [log]), log, notes=notes).motion) == 1
    assert "of: sensor" in notes[0]
