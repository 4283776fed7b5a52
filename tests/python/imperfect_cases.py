"""Logs on imperfect hardware and their twins on perfect hardware.

Twins of the same seed share gain, payload and noise: what they differ by is the imperfection.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rigs import changed, two_payloads

from truewrench.model.motion.trajectory import HarmonicTwist, Trajectory
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate, wrench_on_sensor

Array = np.ndarray[Any, np.dtype[np.float64]]

GROUND = [0, 0, -9.81]
EIGHT = {  # a sensor of eight gauges in microstrain
    "channels": [f"g{i}" for i in range(8)],
    "noise": [0.01] * 8,
    "nominal_gain": np.round(
        np.random.default_rng(8).standard_normal((8, 6)) * [0.4, 0.4, 0.4, 4, 4, 4], 3
    ).tolist(),
}
EVERYTHING: dict[str, Any] = {
    "hysteresis": {"size": 2e-3, "form": "dahl"},
    "nonlinearity": 5e-3,
    "cable": 1e-3,
    "drift": 1e-3,
    "random_walk": 3e-4,
    "vibration": {"size": 5e-3},
    "contact": {"size": 0.1},
    "step": {"size": 1e-2},
    "spikes": {"size": 0.1, "share": 0.05},
    "velocity_filter": {"hz": 20, "order": 2},
    "sensor_filter": {"hz": 40},
    "jitter": 1e-3,
    "quantisation": 10,
    "gravity_tilt": 5e-3,
    "noise": 2,
}


def rig_of(imperfections: dict[str, Any] | None = None, **changes: Any) -> Rig:
    """Payload of [A00], 8 s; `duration` and sections of the rig may be others."""
    settings = changed(two_payloads("table_1"), plan={"duration": 8})
    settings["simulate"] = {} if imperfections is None else {"imperfections": imperfections}
    return Rig.from_mapping(changed(settings, **changes))


def twins(
    imperfections: dict[str, Any], trajectory: Trajectory | None = None, seed: int = 0, **changes: Any
) -> tuple[Rig, SimulatedRun, Array, Array]:
    """The rig, the imperfect run, its times (M,) and by what its channels (M, n) differ, of scale."""
    rig, perfect = rig_of(imperfections, **changes), rig_of(**changes)
    run, twin = (simulate(r, trajectory, seed=seed) for r in (rig, perfect))
    assert np.array_equal(run.truth.gain, twin.truth.gain)
    off = (run.log.raw - twin.log.raw) / rig.sensor.channel_scale
    sampled = np.isfinite(off[:, 0])
    return rig, run, run.log.time_ns[sampled] * 1e-9, off[sampled]


def normalised_gain(rig: Rig, run: SimulatedRun) -> Array:
    return np.asarray(run.truth.gain * rig.sensor.range_array / rig.sensor.channel_scale[:, None])


def true_load(rig: Rig, run: SimulatedRun, time: Array) -> Array:
    """The payload's wrench on orbit, fractions of range."""
    body, motion = run.truth.payloads["table_1"], run.trajectory
    point, still = np.array([0.2, 0, 0]), np.zeros((time.size, 3))
    wrench = wrench_on_sensor(body, point, motion.twist(time), motion.acceleration(time), still)
    return np.asarray(wrench / rig.sensor.range_array)


def swing(frequency: float, duration: float = 8.0, amplitude: float = 0.25) -> HarmonicTwist:
    """All axes at one frequency."""
    return HarmonicTwist(
        np.full((1, 6), amplitude), np.full((1, 6), frequency), np.arange(6.0)[None], duration
    )
