"""Where `map` begins: gains, clocks and payloads far from nominal, read by precise sensors at high rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_windows import FITTED, error, honest, nees, rig_of

from truewrench import _core
from truewrench.estimate.attempts import Attempts
from truewrench.estimate.fits import fitted_share
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.estimate.windows import estimate_windows
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, default_trajectory, simulate

FAR = {"gain_prior": 0.5, "time_offset_prior": 5e-3}
VAGUE = {"mass": 1e-2, "center_of_mass": 2e-3, "inertia": 5e-2}
SEQUENCE = 100  # Gauss-Newton steps that only a pass in sequence needs


def far_rig(noise: float, rate: float) -> Rig:
    stated = rig_of(
        sensor={**FAR, "noise": [noise] * 3 + [0.1 * noise] * 3, "offset_prior": [10.0] * 3 + [1.0] * 3},
        simulate={"rate": rate, "sensor_rate": rate, "gain": "random", "time_offset": "random"},
    ).to_mapping()
    stated["payloads"]["table_1"]["uncertainty"] = VAGUE
    stated["simulate"] |= {"payload": "random", "offset": "random"}
    return Rig.from_mapping(stated)


def simulated(rig: Rig, seed: int) -> SimulatedRun:
    return simulate(rig, default_trajectory(rig), seed=seed, payload="table_1")


def apart(rig: Rig, run: SimulatedRun, found: WindowEstimate, reference: WindowEstimate) -> float:
    """Largest difference of two gains, in sigma of the second."""
    sigma = np.sqrt(np.diag(reference.normalised_covariance))[:36]
    difference = (error(rig, found, [run]) - error(rig, reference, [run]))[:36]
    return float(np.abs(difference / sigma).max())


@pytest.mark.parametrize(("noise", "rate"), [(0.5, 100.0), (0.02, 500.0), (2e-3, 1000.0)])
def test_a_sensor_far_from_nominal_is_found_at_once_however_precise(noise: float, rate: float) -> None:
    rig, scores = far_rig(noise, rate), []
    for seed in range(4):
        run = simulated(rig, seed)
        estimate = estimate_windows(rig, [run.log])
        assert all(w.status == FITTED for w in estimate.windows)
        assert estimate.iterations < SEQUENCE
        scores.append(nees(rig, estimate, [run]))
    assert honest(scores, 42)


def test_a_contact_in_the_first_second_costs_only_its_samples() -> None:
    rig = far_rig(0.1, 250.0)
    run = simulated(rig, 3)
    raw = run.log.raw.copy()
    raw[20:70] += 3.0 * rig.sensor.noise_array * np.array([1, -1, 1, 1, -1, -1])
    raw[[5, 200, 333]] += 50.0 * rig.sensor.noise_array
    clean, struck = (estimate_windows(rig, [log]) for log in (run.log, replace(run.log, raw=raw)))
    assert struck.iterations < SEQUENCE
    assert struck.left_out[0][20:70].mean() > 0.9
    assert struck.left_out[0].sum() < 70
    assert apart(rig, run, struck, clean) < 1.0


def pushed(rig: Rig, run: SimulatedRun, seed: int, size: float = 30.0, length: float = 0.2) -> Log:
    """The log with two pushes [s] by a wrench, so many times the noise in the channel that feels it most."""
    rng = np.random.default_rng(seed)
    raw, noise = run.log.raw.copy(), rig.sensor.noise_array
    for k in range(2):
        start = (k + rng.uniform(0.1, 0.9)) * 0.5 * (run.log.time[-1] - length)
        push = run.truth.gain @ (rig.sensor.range_array * rng.standard_normal(6)) / noise
        inside = (run.log.time >= start) & (run.log.time < start + length)
        raw[inside] += size * push / np.abs(push).max() * noise
    return replace(run.log, raw=raw)


def test_pushes_in_one_window_of_all_the_log_do_not_spoil_its_beginning() -> None:
    # Of a slow motion all the log is one window: a push that spoils it leaves nothing.
    rig = far_rig(0.1, 250.0)
    scores = []
    for seed in range(6):
        run = simulated(rig, seed)
        found = estimate_windows(rig, [pushed(rig, run, seed)])
        assert fitted_share(found.windows) > 0.9
        scores.append(nees(rig, found, [run]))
    assert honest(scores, 42)


def test_pushes_that_motion_and_gain_take_up_are_left_out() -> None:
    # Of 0.4 s, longer than a knot interval, and with little known of gain, clock and payload.
    rig = far_rig(0.1, 250.0)
    scores = []
    for seed in range(6):
        run = simulated(rig, seed)
        found = estimate_windows(rig, [pushed(rig, run, seed, 10.0, 0.4)])
        assert fitted_share(found.windows) > 0.9
        assert np.isfinite(found.wrench[0]).any()
        scores.append(nees(rig, found, [run]))
    assert honest(scores, 42)


def test_a_start_spares_the_way_to_the_same_gain() -> None:
    rig = far_rig(0.02, 500.0)
    run = simulated(rig, 0)
    cold = estimate_windows(rig, [run.log])
    warm = estimate_windows(rig, [run.log], start=cold)
    assert warm.iterations < 0.5 * cold.iterations
    assert apart(rig, run, warm, cold) < 0.3


def test_a_start_that_leads_nowhere_is_left() -> None:
    rig = far_rig(0.02, 500.0)
    run, other = simulated(rig, 0), simulated(rig, 1)
    cold, elsewhere = (estimate_windows(rig, [r.log]) for r in (run, other))
    assert elsewhere.beginning is not None
    elsewhere.beginning.mean = [-3.0 * mean for mean in elsewhere.beginning.mean]
    elsewhere.beginning.spacing = [100.0 * spacing for spacing in elsewhere.beginning.spacing]
    attempts = Attempts([], "map", _core.EstimatorSettings())
    found = attempts.without([run.log], rig, elsewhere)
    assert all(w.status == FITTED for w in found.windows)
    assert apart(rig, run, found, cold) < 0.3
