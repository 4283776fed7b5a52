"""The calibration problems of cases.yaml: rig, log and truth per seed, and the bound on what can be known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from bound_oracle import MotionInformation, Rnea, covariance
from numpy.typing import NDArray

from truewrench.model.log import Log
from truewrench.model.motion.trajectory import (
    Body,
    HarmonicTwist,
    Trajectory,
    WrenchSinusoids,
    integrate_wrench,
)
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

Array = NDArray[np.float64]

TABLE_1 = Body(50.0, np.array([0.2, 0.0, 0.0]), np.diag([1.5, 1.5, 0.4]))  # [A00] Table 1
# Knot spacing of the bound [s]: finer than the motion needs, where it hardly matters any more.
BOUND_SPACING = {"scenario": 0.2, "slow": 2.0, "tumbling": 0.1, "ripple_8hz": 0.04}


@dataclass(frozen=True)
class Problem:
    """One calibration with known truth, in SI and raw units."""

    rig: Rig
    logs: list[Log]
    gain: Array  # (n, 6)
    offset: Array  # (n,) of the last log

    def normalised(self, gain: Array) -> Array:
        """A gain (n, 6) in units of the ranges."""
        return gain * self.rig.sensor.range_array / self.rig.sensor.channel_scale[:, None]


@dataclass(frozen=True)
class SampledTwist:
    """A motion that is known only at the stamps of its log."""

    rate: float
    values: Array  # (N, 6)
    slopes: Array  # (N, 6)

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self.values) / self.rate

    def twist(self, time: Array) -> Array:
        """Twist (N, 6)."""
        return self.values[np.rint(time * self.rate).astype(int)]

    def acceleration(self, time: Array) -> Array:
        """Its derivative (N, 6)."""
        return self.slopes[np.rint(time * self.rate).astype(int)]


@cache
def load_case(name: str) -> dict[str, Any]:
    """Settings of a case, with those of the case that it is `like`."""
    cases = yaml.safe_load(Path(__file__).with_name("cases.yaml").read_text(encoding="utf-8"))
    if name not in cases:
        raise SystemExit(f"no case `{name}`; there are {', '.join(cases)}")
    case = cases[name]
    return {**load_case(case["like"]), **case} if "like" in case else case


def motion_of(name: str, seed: int) -> Trajectory:
    """The motion of a case; `ripple` and `random_walk` draw theirs from the seed."""
    case = load_case(name)
    if "wrench" in case:
        return _wrench_motion(name)
    rng = np.random.default_rng([seed, 3])
    if "random_walk" in case:
        return _random_walk(case, rng)
    one = np.ones((1, 6))
    amplitude = [case["twist"]["amplitude"] * one]
    frequency = [np.array([case["twist"]["frequencies"]])]
    phase = [np.array([case["twist"]["phases"]], dtype=np.float64)]
    if "ripple" in case:
        amplitude.append(case["ripple"]["amplitude"] * one)
        frequency.append(case["ripple"]["frequency"] * one)
        phase.append(rng.uniform(0.0, 2.0 * np.pi, (1, 6)))
    return HarmonicTwist(*map(np.concatenate, (amplitude, frequency, phase)), float(case["duration"]))


def rig_of(name: str, cell: tuple[float, float], **simulation: Any) -> Rig:
    """The rig of a case in the noise cell (sf, sv)."""
    case, (sf, sv) = load_case(name), cell
    inertia = dict(zip(("xx", "yy", "zz"), np.diag(TABLE_1.inertia).tolist(), strict=True))
    exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    center = TABLE_1.center_of_mass.tolist()
    payload = {"mass": TABLE_1.mass, "center_of_mass": center, "inertia": inertia, "uncertainty": exact}
    settings = {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": "payload_on_sensor",
            "noise": [sf] * 3 + [sf / 10] * 3,
            "range": case["range"],
            "gain_prior": case["gain_prior"],
            "offset_prior": 0,
            "time_offset_prior": 0,
            "discrepancy": 0,  # nothing follows the pose in free flight: (10.10) is off
        },
        "payloads": {"default": payload},
        "motion": {"source": "twist", "of": "com", "noise": [sv] * 6},
        "plan": {"duration": case["duration"]},
        "simulate": {"rate": case["rate"], "sensor_rate": case["rate"], "gain": "nominal", "offset": "none"}
        | simulation,
    }
    return Rig.from_mapping(settings)


def problem(name: str, cell: tuple[float, float], seed: int) -> Problem:
    """Draw gain and noise of a case: ``C = diag(range) (I + spread N(0,1)) diag(range)^-1``."""
    case = load_case(name)
    scale = np.array(case["range"], dtype=np.float64)
    departure = case["spread"] * np.random.default_rng([seed, 2]).standard_normal((6, 6))
    gain = (np.eye(6) + departure) * scale[:, None] / scale
    run = simulate(rig_of(name, cell, gain=gain.tolist()), motion_of(name, seed), seed=seed)
    return Problem(rig_of(name, cell), [run.log], gain, np.zeros(6))


def bound(name: str, cell: tuple[float, float], seed: int, *, oracle: bool = False) -> Array:
    """Cramer-Rao covariance (36, 36) of a drawn problem's normalised gains, at its truth, with its prior."""
    case, instance = load_case(name), problem_gain(name, seed)
    noise = normalised_noise(name, cell)
    motion = information(name, cell, seed)
    return covariance([motion], instance, noise, gain_prior=case["gain_prior"], oracle=oracle)


def information(name: str, cell: tuple[float, float], seed: int) -> MotionInformation:
    """What the true motion of a drawn problem tells of its gain."""
    return _information(name, cell[1], seed if "ripple" in load_case(name) else 0)


def normalised_noise(name: str, cell: tuple[float, float]) -> Array:
    """Noise of the channels (6,) in units of the ranges."""
    return np.array([cell[0]] * 3 + [cell[0] / 10] * 3) / np.array(load_case(name)["range"])


def problem_gain(name: str, seed: int) -> Array:
    """The true gain of `problem`, normalised."""
    spread = load_case(name)["spread"]
    return np.eye(6) + np.asarray(spread * np.random.default_rng([seed, 2]).standard_normal((6, 6)))


@cache
def _wrench_motion(name: str) -> Trajectory:
    case = load_case(name)
    return integrate_wrench(WrenchSinusoids.of(**case["wrench"]), TABLE_1, float(case["duration"]))


@cache
def _information(name: str, sv: float, seed: int) -> MotionInformation:
    case, motion = load_case(name), motion_of(name, seed)
    time = np.arange(round(case["duration"] * case["rate"])) / case["rate"]
    point = TABLE_1.center_of_mass
    return MotionInformation.of(
        Rnea(TABLE_1.mass, point, TABLE_1.inertia, point),
        time,
        motion.twist(time),
        motion.acceleration(time),
        twist_noise=np.full(6, sv),
        scale=np.array(case["range"], dtype=np.float64),
        spacing=BOUND_SPACING[name],
    )


def _random_walk(case: dict[str, Any], rng: np.random.Generator) -> SampledTwist:
    """Acceleration driven by white jerk, sampled exactly: Q of the double integrator over dt."""
    walk, dt = case["random_walk"], 1.0 / case["rate"]
    count = round(case["duration"] * case["rate"])
    q = walk["jerk_density"] * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    steps = rng.standard_normal((count, 6, 2)) @ np.linalg.cholesky(q).T
    twist, acceleration = np.empty((count, 6)), np.empty((count, 6))
    nu = walk["velocity_start"] * rng.standard_normal(6)
    a = walk["acceleration_start"] * rng.standard_normal(6)
    for k in range(count):
        twist[k], acceleration[k] = nu, a
        nu, a = nu + dt * a + steps[k, :, 0], a + steps[k, :, 1]
    return SampledTwist(float(case["rate"]), twist, acceleration)
