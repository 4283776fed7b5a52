"""A weight that the driver has subtracted comes back before anything is estimated."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from truewrench.calibrating.pipeline import calibrate
from truewrench.io.tables import read_log, write_table
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.motion.trajectory import HarmonicTwist
from truewrench.planning.planner import plan
from truewrench.robot.compensation import uncompensated
from truewrench.simulation.free_body import simulate

BODY = {"mass": 1.5, "center_of_mass": [0.02, -0.03, 0.11]}
FALL = [3.0, -5.0, 7.0]
CsvOf = Callable[..., Path]


def rig_with(settings: dict[str, Any], compensated: object, **sensor: object) -> Rig:
    """In gravity that has a part along every axis."""
    changed = deepcopy(settings) | {"gravity": FALL}
    changed["sensor"] |= {"compensated": compensated, **sensor}
    return Rig.from_mapping(changed)


def log_of(rows: int = 20, **columns: Any) -> Log:
    """A silent sensor at 100 Hz."""
    fall = np.tile(FALL, (rows, 1))
    time_ns = np.arange(rows, dtype=np.int64) * 10_000_000
    return Log(None, "default", "", time_ns, np.zeros((rows, 6)), **{"gravity": fall, **columns})


@pytest.mark.parametrize("feels", ["payload_on_sensor", "sensor_on_payload"])
def test_what_comes_back_is_the_weight_that_a_sensor_at_rest_feels(
    settings: dict[str, Any], feels: str
) -> None:
    """Simulated with the nominal gain, which the driver believes in."""
    gain = np.eye(6) + np.random.default_rng(5).normal(scale=0.2, size=(6, 6))
    sensor = {"feels": feels, "nominal_gain": gain.tolist(), "noise": [1e-9] * 6}
    inertia = {"xx": 0.02, "yy": 0.02, "zz": 0.02}
    settings["payloads"]["default"] = {**BODY, "inertia": inertia}
    settings["simulate"] = {"gain": "nominal", "offset": "none"}
    still = HarmonicTwist(np.zeros((1, 6)), np.ones((1, 6)), np.zeros((1, 6)), 0.2)
    felt = simulate(rig_with(settings, False, **sensor), still).log.raw
    silent = log_of(len(felt))
    [whole] = uncompensated(rig_with(settings, BODY, **sensor), [silent])
    np.testing.assert_allclose(whole.raw, felt, atol=1e-7)
    assert not silent.raw.any()


def test_compensated_log_calibrates_to_the_gain_of_the_raw_one(settings: dict[str, Any]) -> None:
    settings |= {"plan": {"duration": 4}, "simulate": {"seed": 2}}
    raw_rig = rig_with(settings, False)
    log = simulate(raw_rig).log
    assert log.gravity is not None
    weight = BODY["mass"] * np.hstack([log.gravity, np.cross(BODY["center_of_mass"], log.gravity)])
    given = log.raw - weight  # payload on sensor, and the identity is nominal
    compensated = replace(log, raw=given.copy())
    found = calibrate(rig_with(settings, BODY), compensated, held_out=False)
    np.testing.assert_array_equal(compensated.raw, given)
    expected = calibrate(raw_rig, log, held_out=False)
    np.testing.assert_allclose(found.gain, expected.gain, atol=1e-9)
    np.testing.assert_allclose(found.offset, expected.offset, atol=1e-7)


def test_raw_logs_stay_as_they_are(settings: dict[str, Any]) -> None:
    log = log_of()
    assert uncompensated(rig_with(settings, False), [log]) == [log]


def test_gravity_between_its_rows_is_interpolated(settings: dict[str, Any]) -> None:
    """A sensor four times as fast as gravity, which turns at 2 rad/s."""
    angle = 2.0 * np.arange(201) * 0.01
    fall = 9.81 * np.column_stack([np.sin(angle), np.zeros(201), -np.cos(angle)])
    rig = rig_with(settings, BODY)
    [dense] = uncompensated(rig, [log_of(201, gravity=fall)])
    seldom = np.where(np.arange(201)[:, None] % 4 == 0, fall, np.nan)
    [sparse] = uncompensated(rig, [log_of(201, gravity=seldom)])
    np.testing.assert_allclose(sparse.raw, dense.raw, atol=1e-4)
    assert sparse.notes == ()


def test_samples_without_gravity_are_left_out_and_counted(settings: dict[str, Any]) -> None:
    """Before the first of its rows, after the last, and in a gap."""
    fall = np.tile(FALL, (100, 1))
    unknown = np.r_[0:2, 40:60, 99]
    fall[unknown] = np.nan
    [whole] = uncompensated(rig_with(settings, BODY), [log_of(100, gravity=fall)])
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(whole.raw).all(axis=1)), unknown)
    assert whole.notes[0].startswith("23 samples of the sensor left out")


def test_attitude_tells_the_weight_too(settings: dict[str, Any]) -> None:
    half = np.sqrt(0.5)
    turned = np.tile([half, 0.0, 0.0, half], (20, 1))  # a quarter turn about z, sensor to root
    [whole] = uncompensated(rig_with(settings, BODY), [log_of(gravity=None, attitude=turned)])
    fall = np.array([-5.0, -3.0, 7.0])  # in sensor axes
    np.testing.assert_allclose(whole.raw[0, :3], BODY["mass"] * fall, atol=1e-12)


def test_weight_without_the_direction_of_gravity_is_refused(
    settings: dict[str, Any], cells: dict[str, list[str]], csv_of: CsvOf
) -> None:
    rig = rig_with(settings, BODY)
    with pytest.raises(InputError, match=r"nothing that tells the direction of gravity, expected gx gy gz"):
        uncompensated(rig, [log_of(gravity=None)])
    with pytest.raises(InputError, match=r"no direction of gravity at any of them"):
        uncompensated(rig, [log_of(gravity=np.full((20, 3), np.nan))])
    known = {name: ["1.0"] * 10 for name in ("ref_fx", "ref_fy", "ref_fz", "ref_mx", "ref_my", "ref_mz")}
    with pytest.raises(InputError, match=r"no column `gx`"):
        read_log(csv_of(cells | known), rig)


def test_wrench_known_from_elsewhere_is_of_the_whole_weight(settings: dict[str, Any], tmp_path: Path) -> None:
    """Dead weights on a compensated sensor: the gain is that of the raw channels."""
    draw = np.random.default_rng(4)
    gain = np.eye(6) + draw.normal(scale=0.05, size=(6, 6))
    wrench = draw.normal(size=(300, 6)) * [100, 100, 100, 10, 10, 10]
    fall = draw.normal(size=(300, 3))
    fall *= 9.81 / np.linalg.norm(fall, axis=1, keepdims=True)
    weight = BODY["mass"] * np.hstack([fall, np.cross(BODY["center_of_mass"], fall)])
    raw = wrench @ gain.T - weight + draw.normal(size=(300, 6)) * 1e-3
    columns = {"time_s": np.arange(300.0)}
    columns |= {f"raw_{i}": raw[:, i] for i in range(6)}
    columns |= {f"ref_{axis}": wrench[:, i] for i, axis in enumerate(("fx", "fy", "fz", "mx", "my", "mz"))}
    columns |= {name: fall[:, i] for i, name in enumerate(("gx", "gy", "gz"))}
    write_table(tmp_path / "run.csv", columns)
    settings |= {"reference_noise": [1e-3] * 6, "required": 1.0}
    rig = rig_with(settings, BODY, noise=[1e-3] * 6)
    found = calibrate(rig, read_log(tmp_path / "run.csv", rig), held_out=False)
    np.testing.assert_allclose(found.gain, gain, atol=1e-3)


def test_driver_that_subtracts_is_not_simulated_but_planned_for(settings: dict[str, Any]) -> None:
    limits = {"velocity": [0.5] * 6, "acceleration": [2.0] * 6, "position": [0.5] * 6}
    settings |= {"plan": {"duration": 6, "harmonics": 2}, "limits": limits}
    settings["payloads"]["default"]["mass"] = 10
    rig = rig_with(settings, BODY)
    with pytest.raises(UnsupportedError, match=r"sensor\.compensated: found a weight, expected false"):
        simulate(rig)
    promised, plain = (plan(each).prediction for each in (rig, rig_with(settings, False)))
    assert promised is not None
    assert plain is not None
    np.testing.assert_array_equal(promised.gain_std, plain.gain_std)
