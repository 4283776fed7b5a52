"""What is advised suffices: the estimate repeated as advised meets what is required, and hardly more."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from truewrench.estimate.sources import Sources
from truewrench.estimate.windows import estimate_windows
from truewrench.log import Log
from truewrench.motion.trajectory import HarmonicTwist
from truewrench.rig import Rig
from truewrench.simulation.free_body import simulate
from truewrench.verdict.advice import advice

FREQUENCY = np.array([[0.3, 0.5, 0.7, 0.4, 0.6, 0.9]])  # 10 s is a period of all
STATED = {"mass": 0.0, "center_of_mass": 0.0, "inertia": 0.0}


def rig_of(required: float, uncertainty: dict[str, float], clock: float = 0.0, noise: float = 0.5) -> Rig:
    settings: dict[str, Any] = {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": "payload_on_sensor",
            "noise": [noise] * 3 + [noise / 10] * 3,
            "range": [500, 500, 500, 50, 50, 50],
            "time_offset_prior": clock,
        },
        "payloads": {
            "block": {
                "mass": 50,
                "center_of_mass": [0.2, 0, 0],
                "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
                "uncertainty": {**STATED, **uncertainty},
            }
        },
        "motion": {"noise": [1e-4] * 6},
        "required": required,
    }
    return Rig.from_mapping(settings)


def log_of(rig: Rig, duration: float = 10.0, seed: int = 0) -> Log:
    phase = np.array([[0, 1, 2, 0.5, 1.5, 2.5]])
    return simulate(rig, HarmonicTwist(np.full((1, 6), 0.25), FREQUENCY, phase, duration), seed=seed).log


def worst(rig: Rig, log: Log) -> float:
    return float(np.sqrt(np.diag(estimate_windows(rig, [log]).normalised_covariance)[:36].max()))


def said(rig: Rig, log: Log) -> str:
    return advice(rig, estimate_windows(rig, [log]), "block")


def number(pattern: str, words: str) -> float:
    found = re.search(pattern, words)
    assert found, words
    return float(found[1])


def test_noise_asks_for_a_longer_record_by_the_square_of_the_ratio() -> None:
    first = rig_of(1.0, {})
    sigma = worst(first, log_of(first))
    rig = rig_of(sigma / 2.2, {})
    words = said(rig, log_of(rig))
    assert words.startswith("noise limits it: a record ")
    times = number(r"record ([\d.]+) times as long", words)
    assert times == pytest.approx(2.2**2, rel=0.1)
    assert number(r"wrenches ([\d.]+) times", words) == pytest.approx(2.2, rel=0.05)
    assert worst(rig, log_of(rig, 10.0 * times)) == pytest.approx(sigma / 2.2, rel=0.1)


@pytest.mark.parametrize(
    ("key", "stated", "unit", "size", "name"),
    [
        ("mass", 0.02, "%", 1e2, "mass"),
        ("center_of_mass", 5e-4, "mm", 1e3, "centre of mass"),
        ("inertia", 0.1, "%", 1e2, "inertia"),
    ],
)
def test_payload_known_as_advised_is_known_well_enough(
    key: str, stated: float, unit: str, size: float, name: str
) -> None:
    first = rig_of(1.0, {key: stated}, noise=0.05)
    log = log_of(first)
    sigma = worst(first, log)
    words = said(rig_of(sigma / 2.0, {key: stated}, noise=0.05), log)
    assert words.startswith(f"the {name} of payload `block` limits it: the {name} known to ")
    known = number(rf"known to ([\d.]+) {unit} \(stated: {size * stated:.3g} {unit}\)", words) / size
    assert worst(rig_of(1.0, {key: known}, noise=0.05), log) == pytest.approx(sigma / 2.0, rel=0.08)


@pytest.mark.parametrize(("large", "name"), [(36, "mass"), (37, "timing")])
@pytest.mark.parametrize("seed", range(3))
def test_factor_is_exact_in_a_linear_model(large: int, name: str, seed: int) -> None:
    """36 gains, a mass and a clock, measured through a random design; every prior enters the inverse anew."""
    draw = np.random.default_rng(seed)
    design = draw.normal(size=(400, 38)) / 0.2
    design[:, 36] = design[:, :36] @ draw.normal(size=36) + 0.02 * draw.normal(size=400)
    design[:, 37] = design[:, :36] @ draw.normal(size=36) + 0.02 * draw.normal(size=400)
    prior = np.append(np.full(36, 10.0), [0.01, 0.01])
    prior[large] = 0.3

    def posterior(sigma: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.inv(design.T @ design + np.diag(sigma**-2.0)))

    covariance = posterior(prior)
    sources = Sources.of(covariance, 36, {"mass": [36], "timing": [37]}, prior, 10.0)
    target = 0.4 * float(np.sqrt(np.diag(covariance)[:36].max()))
    remedy = sources.remedy(np.ones(36, dtype=bool), target)
    assert list(remedy) == [name]
    changed = prior.copy()
    changed[large] *= remedy[name]
    assert np.sqrt(np.diag(posterior(changed))[:36].max()) == pytest.approx(target, rel=1e-6)


def test_clocks_are_named_with_the_time_they_have_to_agree_to() -> None:
    rig = rig_of(0.02, {}, clock=5e-3)
    estimate = estimate_windows(rig, [log_of(rig)])
    sensitivity = np.zeros((36, 1))
    sensitivity[7] = 0.05
    one = Sources(np.full(36, 1e-6), 0.3, sensitivity, np.eye(1), {"timing": [0]})
    covariance = 1e-6 * np.eye(42)
    covariance[7, 7] += 0.05**2
    late = replace(estimate, sources=one, normalised_covariance=covariance)
    # 0.05 per 5 ms, beside a noise of 0.001: 0.02 is met at sqrt(0.02^2 - 0.001^2) / 0.05 of 5 ms
    words = advice(rig, late, "block")
    assert words == ("the clocks limit it: sensor and motion synchronised to 1.9 ms (stated: 5 ms) would do")


def test_two_sources_that_both_matter_are_both_named() -> None:
    first = rig_of(1.0, {"mass": 0.01}, noise=2.0)
    log = log_of(first)
    sigma = worst(first, log)
    words = said(rig_of(sigma / 4.0, {"mass": 0.01}, noise=2.0), log)
    assert "noise" in words
    assert "mass" in words
    assert " limit it: " in words
    times = number(r"record ([\d.]+) times", words)
    mass = 1e-2 * number(r"mass known to ([\d.]+) %", words)
    after = rig_of(1.0, {"mass": mass}, noise=2.0)
    assert worst(after, log_of(after, 10.0 * times)) == pytest.approx(sigma / 4.0, rel=0.12)


def test_direction_without_data_gets_no_number() -> None:
    rig = rig_of(0.02, {})
    log = log_of(rig, 0.5)
    assert said(rig, log) == "a motion, or a second payload, that loads that axis by itself helps"
