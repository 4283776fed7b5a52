"""`online` where the sensor is late: a quarter of the knots' spacing told of filters that were not there."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tool_cases import a_rig, newton_euler

import truewrench as tw
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig

MASS, CENTER, INERTIA = 4.0, np.array([0.03, -0.02, 0.08]), np.diag([0.03, 0.028, 0.02])


@pytest.fixture(scope="module")
def rig() -> Rig:
    sensor = {"noise": [0.2] * 3 + [0.02] * 3, "range": [200] * 3 + [20] * 3, "gain_prior": 0.05}
    inertia = dict(zip(("xx", "yy", "zz"), np.diag(INERTIA).tolist(), strict=True))
    payload = {"mass": MASS, "center_of_mass": CENTER.tolist(), "inertia": inertia}
    motion = {"source": "twist", "of": "sensor", "noise": [1e-3] * 6}
    return Rig.from_mapping(a_rig(sensor=sensor, motion=motion, required=0.2) | {"payloads": {"p": payload}})


def late_log(rig: Rig, gain: Array, seed: int, delay: float) -> Log:
    """20 s at 200 Hz of places and Euler angles that are sums of sines; the motion so much later [s]."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.15, 1.2, (6, 5)), rng.uniform(0.0, 6.3, (6, 5))
    size = rng.uniform(0.4, 1.0, (6, 5)) / np.sqrt(5) / (1.0 + (f / 0.7) ** 2)
    size *= np.repeat([0.15, 0.7], 3)[:, None]
    h = 1e-3

    def q(t: Array) -> Array:
        return np.asarray((size * np.sin(2.0 * np.pi * f * t[:, None, None] + phase)).sum(axis=2))

    def turn(t: Array) -> Rotation:
        return Rotation.from_euler("ZYX", q(t)[:, 3:])

    def twist(t: Array) -> Array:
        v = turn(t).inv().apply((q(t + h)[:, :3] - q(t - h)[:, :3]) / (2.0 * h))
        return np.hstack([v, (turn(t - h).inv() * turn(t + h)).as_rotvec() / (2.0 * h)])

    t = np.arange(4000) / 200.0
    a, fall = (twist(t + h) - twist(t - h)) / (2.0 * h), turn(t).inv().apply(rig.gravity_array)
    w = rig.sensor.sign * newton_euler(MASS, CENTER, INERTIA, twist(t), a, fall)
    raw = w @ gain.T + rng.normal(size=w.shape) * rig.sensor.noise_array
    raw += rng.normal(size=6) * 0.05 * rig.sensor.range_array
    seen = twist(t - delay) + 1e-3 * rng.normal(size=w.shape)
    fall = turn(t - delay).inv().apply(rig.gravity_array)
    return Log(None, "p", "", (t * 1e9).astype(np.int64), raw, twist=seen, gravity=fall)


@pytest.mark.parametrize("delay", [0.0075, 0.01, -0.01])
def test_a_late_sensor_costs_no_honesty(rig: Rig, delay: float) -> None:
    """Kappa was found 3 to 10 sigma of its prior below it, and the gain up to 7 sigma off."""
    span = rig.sensor.range_array
    for seed in (0, 1, 3, 5):
        departure = 0.05 * np.random.default_rng(seed).normal(size=(6, 6))
        gain = np.eye(6) + departure * span[:, None] / span
        found = tw.calibrate(rig, late_log(rig, gain, seed, delay), "online", held_out=False)
        assert found.verdict.usable, found.verdict.reasons
        assert found.time_offset == pytest.approx(delay, abs=1e-3)
        assert np.abs((found.gain - gain) / found.gain_std).max() < 3.8
