"""A right calibration holds on perfect logs whose payload and gravity depart as the rig says they may."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import truewrench as tw
from truewrench.judging.validation import Validation
from truewrench.model.calibration import AXES, Calibration
from truewrench.model.rig import Rig
from truewrench.simulation.arm import simulate_arm
from truewrench.simulation.free_body import simulate

WIDE = {"mass": 1e-2, "center_of_mass": 2e-3, "inertia": 5e-2}
EXACT = {"mass": 0, "center_of_mass": 0, "inertia": 0}


def rig_of(
    uncertainty: dict[str, float], tilt: float | None = None, prior: float = 3.5e-3, **motion: Any
) -> Rig:
    gravity = {} if tilt is None else {"gravity": [0, 0, -9.81], "gravity_tilt_prior": prior}
    imperfections = {"imperfections": {"gravity_tilt": tilt}} if tilt else {}
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": list(AXES),
                "feels": "payload_on_sensor",
                "noise": [0.1] * 3 + [0.01] * 3,
                "range": [500] * 3 + [50] * 3,
            },
            "payloads": {
                "default": {
                    "mass": 50,
                    "center_of_mass": [0.2, 0, 0],
                    "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
                    "uncertainty": uncertainty,
                }
            },
            "motion": {"noise": [1e-4] * 6, **motion},
            "required": 0.15,
            "simulate": {"payload": "random", **imperfections},
            **gravity,
        }
    )


def calibrated(rig: Rig, seed: int) -> Calibration:
    return tw.calibrate(rig, simulate(rig, seed=seed).log, held_out=False)


def validated(calibration: Calibration, rig: Rig, seed: int) -> Validation:
    """On another motion of the same hardware."""
    other = Rig.from_mapping({**rig.to_mapping(), "plan": {"duration": 15, "seed": 7}})
    return tw.validate(calibration, rig, simulate(other, seed=seed).log)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "rig",
    [
        pytest.param(rig_of(WIDE), id="orbit"),
        pytest.param(rig_of(WIDE, of="sensor"), id="orbit, sensor"),
        pytest.param(rig_of(WIDE, tilt=0.0), id="gravity"),
        pytest.param(rig_of(EXACT, tilt=3.5e-3), id="tilt"),
        pytest.param(rig_of(WIDE, tilt=3.5e-3, of="sensor"), id="both"),
    ],
)
def test_what_the_rig_says_of_payload_and_gravity_speaks_against_no_right_gain(rig: Rig, seed: int) -> None:
    found = validated(calibrated(rig, seed), rig, seed)
    assert found.verdict.usable, found.verdict.reasons
    for axis in found.axes.values():
        assert axis.better is True
        assert axis.nis == pytest.approx(1.0, abs=0.2)


def test_a_gain_beyond_its_sigma_is_still_seen() -> None:
    rig = rig_of(WIDE, tilt=3.5e-3)
    right = calibrated(rig, 0)
    gain = right.gain.copy()
    gain[1] *= 1.02  # of which the payload's mass, known to 1%, explains nothing: that of one axis alone
    found = validated(replace(right, gain=gain, inverse=np.linalg.inv(gain)), rig, 0)
    assert not found.axes["fy"].keep
    assert not any("gravity" in reason for reason in found.verdict.reasons)


def test_a_file_says_as_much_as_the_calibration(tmp_path: Path) -> None:
    rig = rig_of(WIDE)
    calibration = calibrated(rig, 1)
    calibration.write_yaml(tmp_path / "calibration.yaml")
    read = tw.load_calibration(tmp_path / "calibration.yaml")
    assert validated(read, rig, 1).to_mapping() == validated(calibration, rig, 1).to_mapping()
    for body in read.payload_posterior.values():  # as files had it before there was a covariance
        del body["covariance"], body["covariance_with_gain"]
    assert validated(read, rig, 1).verdict.usable


def test_another_body_of_the_same_name_is_as_its_rig_states_it() -> None:
    rig = rig_of(WIDE)
    settings = rig.to_mapping()
    settings["payloads"]["default"].update(mass=20.0, uncertainty=EXACT)
    other = Rig.from_mapping(settings)
    found = validated(calibrated(rig, 0), other, 0)
    assert not found.payload_seen
    assert max(axis.nis for axis in found.axes.values()) < 2.0


def test_stretches_of_finer_knots_do_not_colour_the_others(arm_rig: Callable[..., Rig]) -> None:
    """One in four, with ten times the variance of the others: its correlation was expected of all."""
    late = {"simulate": {"time_offset": 5e-3}, "sensor": {"time_offset_prior": 5e-3, "discrepancy": 0}}
    rig = arm_rig("panda_ground", plan={"duration": 15}, gravity_tilt_prior=0, **late)
    log = simulate_arm(rig, seed=1).log
    found = tw.validate(tw.calibrate(rig, log, held_out=False), rig, log)
    assert found.verdict.usable, found.verdict.reasons
    assert max(abs(axis.autocorrelation) for axis in found.axes.values()) < 0.1


@pytest.mark.parametrize("prior", [0.0, 3.5e-3])
def test_gravity_beyond_what_is_stated_is_named(prior: float) -> None:
    rig = rig_of(EXACT, tilt=0.03, prior=prior)
    right = calibrated(rig_of(EXACT, tilt=0.0), 0)
    found = validated(right, rig, 0)
    assert not found.verdict.usable
    (reason,) = (reason for reason in found.verdict.reasons if reason.startswith("gravity:"))
    assert "1.7 deg" in reason
    if prior:
        assert found.tilts[0] == pytest.approx(0.03, rel=0.05)
