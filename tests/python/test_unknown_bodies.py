"""Logs of bodies that nobody knows, pooled with those of a known payload: honest, flagged where not told."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.stats import chi2

import truewrench as tw
from truewrench.calibrating.unknown_bodies import notes_on_bodies, with_first_guess
from truewrench.cli import main
from truewrench.estimation.estimate import PayloadDeparture
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate

Array = NDArray[np.float64]

SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.05] * 3 + [0.005] * 3,
        "range": [50.0] * 3 + [5.0] * 3,
        "gain_prior": 0.1,
        "discrepancy": 0,
        "time_offset_prior": 0,
    },
    "payloads": {
        "default": {
            "mass": 5,
            "center_of_mass": [0.02, 0.03, 0.1],
            "inertia": {"xx": 0.04, "yy": 0.03, "zz": 0.02},
        },
        "tool": "unknown",
    },
    "motion": {"source": "twist", "of": "sensor", "noise": [1e-4] * 6},
    "gravity": [0, 0, -9.81],
    "required": 0.05,
    "plan": {"duration": 6},
    "simulate": {"payload": "random"},
}
ELEMENTS = ("xx", "yy", "zz")


class Case:
    """A sensor with a known payload, and with a tool of which the rig says nothing."""

    def __init__(self, seed: int, scale: float = 1.0) -> None:
        draw = np.random.default_rng(seed)
        self.mass = scale * float(np.exp(np.log(1.5) + 0.7 * draw.normal()))
        self.center = 0.05 * draw.normal(size=3)
        self.inertia = self.mass * 0.006 * draw.uniform(0.6, 1.2, 3)
        exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
        settings = deepcopy(SETTINGS)
        settings["payloads"]["tool"] = {
            "mass": self.mass,
            "center_of_mass": self.center.tolist(),
            "inertia": dict(zip(ELEMENTS, self.inertia.tolist(), strict=True)),
            "uncertainty": exact,
        }
        self.known: SimulatedRun = simulate(Rig.from_mapping(settings), payload="default", seed=seed)
        self.gain: Array = self.known.truth.gain
        settings["simulate"]["gain"] = self.gain.tolist()
        self.tool: SimulatedRun = simulate(Rig.from_mapping(settings), payload="tool", seed=seed + 1000)

    def squares(self, found: Calibration) -> tuple[float, Array]:
        """Of the gain, per number; of mass, centre of mass and moments of inertia in sigmas (7,)."""
        d = (found.gain - self.gain).ravel()
        body = found.payload_posterior["tool"]
        found_inertia, std = (
            np.array([body[key][k] for k in ELEMENTS]) for key in ("inertia", "inertia_std")
        )
        moments = (found_inertia - self.inertia) / std
        off = [
            (body["mass"] - self.mass) / body["mass_std"],
            *((np.array(body["center_of_mass"]) - self.center) / body["center_of_mass_std"]),
            *moments,
        ]
        return float(d @ np.linalg.solve(found.covariance[:36, :36], d)) / 36.0, np.array(off)


def test_pooled_with_a_known_payload_gain_and_body_are_as_good_as_they_say() -> None:
    rig = Rig.from_mapping(SETTINGS)
    gains, bodies = [], []
    for seed in range(20):
        case = Case(seed)
        found = tw.calibrate(rig, [case.known.log, case.tool.log], held_out=False)
        assert found.verdict.usable
        assert found.rig == rig
        square, off = case.squares(found)
        gains.append(square)
        bodies.append(off)
    assert chi2.ppf(1e-4, 720) / 36.0 < sum(gains) < chi2.ppf(1.0 - 1e-4, 720) / 36.0
    assert np.mean(np.abs(bodies) < 1.96) > 0.9
    assert 0.5 < np.mean(np.square(bodies)) < 1.5


@pytest.mark.parametrize("scale", [0.2, 6.0])
def test_bodies_far_from_the_guess_are_found(scale: float) -> None:
    case = Case(3, scale)
    found = tw.calibrate(Rig.from_mapping(SETTINGS), [case.known.log, case.tool.log], held_out=False)
    square, off = case.squares(found)
    assert square < 2.0
    assert np.abs(off).max() < 4.0


def test_logged_point_is_the_stated_one_whatever_the_guess() -> None:
    settings = deepcopy(SETTINGS)
    settings["motion"]["of"] = "com"
    rig = Rig.from_mapping(settings)
    case = Case(0)

    def at(log: Log, point: Array) -> Log:
        assert log.twist is not None
        twist = log.twist.copy()
        twist[:, :3] += np.cross(twist[:, 3:], point)
        return replace(log, twist=twist)

    center = np.array(SETTINGS["payloads"]["default"]["center_of_mass"])
    logs = [at(case.known.log, center), case.tool.log]  # of the unknown body: the sensor's origin
    assert with_first_guess(rig, logs).payloads["tool"].center_of_mass == (0.0, 0.0, 0.0)
    square, off = case.squares(tw.calibrate(rig, logs, held_out=False))
    assert square < 2.0
    assert np.abs(off).max() < 4.0


def test_without_a_known_body_the_scale_is_refused_or_as_wide_as_stated() -> None:
    case = Case(2)
    wide = tw.calibrate(Rig.from_mapping(SETTINGS), case.tool.log, held_out=False)
    assert not wide.verdict.usable
    assert "no log carries a known payload: mass and force scale" in wide.verdict.reasons[0]
    assert wide.verdict.undetermined
    settings = deepcopy(SETTINGS)
    settings["sensor"]["gain_prior"] = 0.02
    narrow = tw.calibrate(Rig.from_mapping(settings), case.tool.log)
    assert narrow.verdict.usable
    body = narrow.payload_posterior["tool"]
    assert 0.004 < body["mass_std"] / body["mass"] < 0.02  # of three force scales
    assert not any(axis.held_out for axis in narrow.improvement.values())


def test_what_of_a_body_is_not_told_is_named() -> None:
    rig = Rig.from_mapping(SETTINGS)
    log = replace(Case(1).tool.log, payload="tool")
    std = np.array([0.01, 1e-3, 1e-3, 0.14, *[0.2] * 3, *[1.1] * 3])
    found = PayloadDeparture(np.zeros(10), np.diag(std**2), np.zeros((10, 36)))
    (said,) = notes_on_bodies(rig, [log], {"tool": found})
    assert said == (
        "unknown payload `tool`: 1.5 kg, 1 sigma 0.015 kg; not determined: centre of mass along z, "
        "inertia xy, inertia xz, inertia yz"
    )


def test_commands_that_need_a_known_body_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")
    case = Case(4)
    known, tool = case.known.write(tmp_path / "a.csv")[0], case.tool.write(tmp_path / "b.csv")[0]
    words = ["calibrate", rig, f"{known}@default", f"{tool}@tool", "-o", tmp_path / "out", "--no-report"]
    assert main([*map(str, words), "--no-held-out"]) == 0
    assert "unknown payload `tool`" in "".join(capsys.readouterr())
    calibration = tmp_path / "out" / "calibration.yaml"
    for refused in (
        [*words, "--estimator", "ls"],
        ["validate", calibration, rig, f"{tool}@tool"],
        ["simulate", rig, "--payload", "tool", "-o", tmp_path / "c.csv"],
    ):
        assert main([str(word) for word in refused]) == 2
        assert "payloads.tool: found an unknown body, expected" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"payloads\.tool"):
        Rig.from_mapping({**SETTINGS, "payloads": {"tool": "unknwon"}})
