"""A weight that the driver has subtracted comes back before anything is estimated."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from tool_cases import a_rig, apart, swing_log

from truewrench.calibrating.pipeline import calibrate
from truewrench.correction.contact.log import contact
from truewrench.io.tables import read_log, write_table
from truewrench.judging.validation import validate
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist, attitude
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.planning.planner import plan
from truewrench.robot.compensation import subtracted, uncompensated
from truewrench.simulation.free_body import simulate, wrench_on_sensor
from truewrench.tool.identify import identify_tool

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
    found = calibrate(rig_with(settings, BODY, time_offset_prior=0), compensated, held_out=False)
    np.testing.assert_array_equal(compensated.raw, given)
    raw_rig = rig_with(settings, False, time_offset_prior=0)
    expected = calibrate(raw_rig, log, held_out=False)
    np.testing.assert_allclose(found.gain, expected.gain, atol=1e-9)
    np.testing.assert_allclose(found.offset, expected.offset, atol=1e-7)


class Late:
    """A log whose sensor reads 5 ms late, with the whole wrench and as a driver leaves it."""

    def __init__(self, settings: dict[str, Any], seed: int) -> None:
        self.body = {"mass": 5.0, "center_of_mass": [0.02, 0.03, 0.1]}
        changed = deepcopy(settings)
        changed["payloads"]["default"] = self.body | {
            "inertia": {"xx": 0.04, "yy": 0.03, "zz": 0.02},
            "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
        }
        changed |= {"motion": {"noise": [1e-4] * 6}, "plan": {"duration": 12}, "required": 0.5}
        changed |= {"gravity_tilt_prior": 0, "simulate": {"time_offset": 5e-3}}
        good = {"noise": [0.1] * 3 + [0.01] * 3, "discrepancy": 0}
        self.plain, self.rig = (rig_with(changed, weight, **good) for weight in (False, self.body))
        self.run = simulate(self.plain, seed=seed)
        # free fall in sensor axes at the moments that the sensor shows
        fall = np.array(FALL) @ attitude(self.run.trajectory, self.run.log.time + 5e-3)
        weight = 5.0 * np.hstack([fall, np.cross(self.body["center_of_mass"], fall)])
        self.log = replace(self.run.log, raw=self.run.log.raw - weight)

    def nees(self, found: Calibration) -> float:
        error = (found.gain - self.run.truth.gain).ravel()
        return float(error @ np.linalg.solve(found.covariance[:36, :36], error)) / 36


@pytest.mark.parametrize("seed", range(3))
def test_weight_of_a_sensor_that_is_late_comes_back_where_the_sensor_felt_it(
    settings: dict[str, Any], seed: int
) -> None:
    late = Late(settings, seed)
    whole = calibrate(late.plain, late.run.log, held_out=False)
    found = calibrate(late.rig, late.log, held_out=False)
    assert found.verdict.usable, found.verdict.reasons
    assert late.nees(found) < late.nees(whole) + 0.2
    assert found.time_offset == pytest.approx(whole.time_offset, abs=2e-5)
    assert [one.what.split(",")[0] for one in found.assumed] == ["clock"]  # no filter, nothing slow
    judged = validate(found, late.rig, late.log)
    assert judged.verdict.usable, judged.verdict.reasons
    assert judged.time_offsets[0] == pytest.approx(5e-3, abs=1e-4)


class Slow:
    """A body of which the driver subtracts the weight, turning at 0.6 rad/s with so many m/s."""

    body: ClassVar[dict[str, Any]] = {"mass": 5.0, "center_of_mass": [0.02, 0.03, 0.1]}

    def __init__(
        self, settings: dict[str, Any], seed: int, speed: float, hertz: float, **simulated: Any
    ) -> None:
        changed = deepcopy(settings) | {"motion": {"noise": [1e-3] * 6}, "gravity_tilt_prior": 0}
        exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
        inertia = {"xx": 0.04, "yy": 0.03, "zz": 0.02}
        changed["payloads"]["default"] = {**self.body, "inertia": inertia, "uncertainty": exact}
        changed |= {"simulate": simulated, "required": 0.5}
        sensor = {"noise": [0.1] * 3 + [0.01] * 3, "discrepancy": 0, "gain_prior": 0.02}
        self.plain, self.rig = (rig_with(changed, weight, **sensor) for weight in (False, self.body))
        rates = hertz * np.outer([0.4, 0.7, 1.0, 1.35, 1.7], 1.0 + 0.03 * np.arange(6))
        size = np.tile(np.repeat([speed, 0.6], 3) / np.sqrt(5.0), (5, 1))
        phase = np.random.default_rng([seed, 9]).uniform(0.0, 6.28, (5, 6))
        self.run = simulate(self.plain, HarmonicTwist(size, rates, phase, 12.0), seed=seed)

    def fall(self, time: Array) -> Array:
        """Free fall (N, 3) at times (N,) [s] of the motion."""
        return np.asarray(np.array(FALL) @ attitude(self.run.trajectory, time.clip(0.0)))

    def weight(self, fall: Array) -> Array:
        """(N, 6) in free fall (N, 3)."""
        return 5.0 * np.hstack([fall, np.cross(self.body["center_of_mass"], fall)])


@pytest.mark.parametrize(("speed", "hertz"), [(0.05, 0.4), (0.1, 0.6)])
def test_where_nearly_all_that_moves_is_weight_the_clock_is_as_uncertain_as_it_errs(
    settings: dict[str, Any], speed: float, hertz: float
) -> None:
    """Of 20 seeds of the slower 5 ended with a step out of the log, the others were 15 sigma off (RMS)."""
    deviates = []
    for seed in range(5):
        late = float(np.random.default_rng([seed, 3]).normal(scale=2e-3))
        slow = Slow(settings, seed, speed, hertz, time_offset=late)
        log = slow.run.log
        log = replace(log, raw=log.raw - slow.weight(slow.fall(log.time + late)))
        found = calibrate(slow.rig, log, held_out=False)
        deviates.append((found.time_offset - late) / found.time_offset_std)
    assert np.sqrt(np.mean(np.square(deviates))) < 1.8  # of five normal ones more in 1e-3


def test_weight_follows_a_clock_that_runs_at_another_rate(settings: dict[str, Any]) -> None:
    """500 ppm over 12 s: at the stamps as they were NEES/36 was 1.8, at those of one clock 1.0."""
    nees = []
    for seed in range(4):
        slow = Slow(settings, seed, 0.3, 0.8)
        run, c = slow.run, np.array(slow.body["center_of_mass"])
        shown = (run.log.time - 5e-4 * (run.log.time - run.log.time.mean())).clip(0.0)
        motion, fall = run.trajectory, slow.fall(shown)
        body = run.truth.payloads["default"]
        felt = wrench_on_sensor(body, c, motion.twist(shown), motion.acceleration(shown), fall)
        noise = slow.rig.sensor.noise_array * np.random.default_rng([seed, 7]).standard_normal(felt.shape)
        raw = felt @ run.truth.gain.T + run.truth.offset + noise - slow.weight(fall)
        found = calibrate(slow.rig, replace(run.log, raw=raw), held_out=False)
        assert any("rate" in one.what for one in found.assumed)
        error = (found.gain - run.truth.gain).ravel()
        nees.append(float(error @ np.linalg.solve(found.covariance[:36, :36], error)) / 36)
    assert np.mean(nees) < 1.35


def test_weight_comes_back_once_where_a_part_is_held_out(settings: dict[str, Any]) -> None:
    late = Late(settings, 0)
    found = calibrate(late.rig, late.log)
    assert all(axis.held_out for axis in found.improvement.values())
    assert max(found.figures["held_out"]["nis"].values()) < 1.5


def test_a_tool_that_moves_on_a_late_sensor_is_that_of_its_raw_channels() -> None:
    """Nearly all that moves the channels is weight: they hardly tell the clock while it is added on time."""
    rig, weighed = (
        tool_rig(a_rig(motion={"source": "twist", "of": "sensor", "noise": [1e-3] * 6}, sensor=sensor))
        for sensor in ({}, {"compensated": {"mass": 1.4, "center_of_mass": [0.0, 0.01, 0.09]}})
    )
    log = swing_log(rig, 1.5, np.array([0.01, -0.02, 0.08]), 0.004 * np.eye(3), seed=2)
    assert log.gravity is not None
    driven = apart(replace(log, raw=log.raw - subtracted(weighed, log.gravity)), 6_000_000)
    whole, found = identify_tool(rig, apart(log, 6_000_000)), identify_tool(weighed, driven)
    assert found.verdict.usable, found.verdict.reasons
    assert found.time_offset == pytest.approx(whole.time_offset, abs=2e-4)
    assert found.mass == pytest.approx(whole.mass, abs=0.3 * whole.mass_std)
    chi2 = contact(driven, found).chi2
    assert np.nanmean(chi2) == pytest.approx(np.nanmean(contact(apart(log, 6_000_000), whole).chi2), rel=0.2)


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
