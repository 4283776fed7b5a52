"""Claims about planned twists: limits, what they promise, and what is said where no motion will do."""

from __future__ import annotations

from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import cumulative_simpson
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from truewrench.calibrating.pipeline import calibrate
from truewrench.cli import main
from truewrench.io.plans import read_plan
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.rig import Rig
from truewrench.planning.criterion import Criterion, packed
from truewrench.planning.planner import plan
from truewrench.planning.result import Plan
from truewrench.simulation.free_body import simulate

Array = np.ndarray[Any, np.dtype[np.float64]]

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
ACCELERATION = ("ax", "ay", "az", "alx", "aly", "alz")
MASS, CENTER, INERTIA = 50.0, np.array([0.2, 0.0, 0.0]), np.diag([1.5, 1.5, 0.4])
SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
        "range": [500, 500, 500, 50, 50, 50],
        "offset_prior": 0,
        "time_offset_prior": 0,
    },
    "payloads": {
        "default": {
            "mass": 50,
            "center_of_mass": [0.2, 0, 0],
            "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
            "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
        }
    },
    "motion": {"noise": [1e-4] * 6},
    "limits": {
        "velocity": [0.5, 0.5, 0.5, 1, 1, 1],
        "acceleration": [1, 1, 1, 3, 3, 3],
        "jerk": [8, 8, 8, 20, 20, 20],
        "position": [0.5, 0.5, 0.5, 0.8, 0.8, 0.8],
        "workspace": [[-0.6, 0.6], [-0.5, 0.5], [-0.5, 0.4]],
    },
    "plan": {"duration": 5, "rate": 40, "harmonics": 3, "seed": 0, "rest_to_rest": True},
    "simulate": {"rate": 100, "sensor_rate": 100},
    "required": 0.3,
}


def changed(**sections: Any) -> dict[str, Any]:
    settings = deepcopy(SETTINGS)
    for name, section in sections.items():
        if isinstance(section, dict) and isinstance(settings.get(name), dict):
            settings[name] |= section
        else:
            settings[name] = section
    return settings


def rig_of(**sections: Any) -> Rig:
    return Rig.from_mapping(changed(**sections))


@pytest.fixture(scope="module")
def planned() -> Plan:
    """From rest to rest in a box."""
    return plan(rig_of())


@pytest.fixture(scope="module")
def table(planned: Plan, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Array]:
    """The plan as it is written, and as it is read by NumPy."""
    path = tmp_path_factory.mktemp("plan") / "plan.csv"
    planned.write(path)
    return path, np.genfromtxt(path, delimiter=",", names=True)


def at_1_khz(table: Array) -> tuple[Array, Array, Array]:
    """Time, twist and its derivative between the rows: quintic splines through the rows, by SciPy."""
    spline = make_interp_spline(table["time_s"], np.column_stack([table[name] for name in TWIST]), k=5)
    time = np.linspace(0.0, table["time_s"][-1], 5001)
    return time, spline(time), spline(time, nu=1)


def newton_euler(twist: Array, acceleration: Array) -> Array:
    """Wrench on the sensor of a free body whose centre of mass moves so ([A00] 3-5, solved by hand)."""
    v, w, a, alpha = twist[:, :3], twist[:, 3:], acceleration[:, :3], acceleration[:, 3:]
    force = -MASS * (a + np.cross(w, v))
    about_center = alpha @ INERTIA + np.cross(w, w @ INERTIA)
    return np.hstack([force, np.cross(CENTER, force) - about_center])


def test_planned_twist_keeps_to_every_limit_between_its_rows(table: tuple[Path, Array]) -> None:
    limits = SETTINGS["limits"]
    time, twist, acceleration = at_1_khz(table[1])
    spline = make_interp_spline(time, acceleration, k=5)
    integral = cumulative_simpson(twist, x=time, axis=0, initial=0.0)
    for values, name in ((twist, "velocity"), (acceleration, "acceleration"), (integral, "position")):
        assert (np.abs(values).max(axis=0) <= np.array(limits[name]) * (1.0 + 2e-6)).all(), name
    assert (np.abs(spline(time, nu=1)).max(axis=0) <= np.array(limits["jerk"]) * (1.0 + 1e-4)).all()
    assert (np.abs(newton_euler(twist, acceleration)) <= 0.8 * np.array([500] * 3 + [50] * 3)).all()


def test_planned_body_stays_in_its_workspace(table: tuple[Path, Array]) -> None:
    time, twist, _ = at_1_khz(table[1])
    rotation, place = Rotation.identity(), CENTER.copy()
    low, high = np.array(SETTINGS["limits"]["workspace"]).T
    step = time[1] - time[0]
    for before, after in pairwise(twist):  # midpoint rule, by SciPy's rotations
        middle = 0.5 * (before + after) * step
        place = place + (rotation * Rotation.from_rotvec(0.5 * middle[3:])).apply(middle[:3])
        rotation = rotation * Rotation.from_rotvec(middle[3:])
        sensor = place - rotation.apply(CENTER)
        assert (place <= high + 1e-6).all()
        assert (place >= low - 1e-6).all()
        assert (sensor <= high + 1e-6).all()
        assert (sensor >= low - 1e-6).all()
    np.testing.assert_allclose(place, CENTER, atol=1e-4)  # the path closes
    assert rotation.magnitude() < 1e-4


def test_planned_motion_begins_and_ends_at_rest(table: tuple[Path, Array]) -> None:
    for name in (*TWIST, *ACCELERATION):
        np.testing.assert_allclose(table[1][name][[0, -1]], 0.0, atol=1e-9)


def test_written_derivatives_are_those_of_the_written_twist(table: tuple[Path, Array]) -> None:
    _, _, acceleration = at_1_khz(table[1])
    written = np.column_stack([table[1][name] for name in ACCELERATION])
    np.testing.assert_allclose(acceleration[:: 5000 // (len(written) - 1)], written, atol=2e-4)


def test_same_seed_plans_the_same_motion(planned: Plan) -> None:
    again = plan(planned.rig)
    for name, column in planned.design.columns.items():
        np.testing.assert_array_equal(column, again.design.columns[name])


def test_oracle_sigma_of_a_plan_is_that_of_its_wrenches(planned: Plan, table: tuple[Path, Array]) -> None:
    spline = make_interp_spline(table[1]["time_s"], np.column_stack([table[1][n] for n in TWIST]), k=5)
    time = np.arange(0.0, 5.0, 0.01)
    wrench = newton_euler(spline(time), spline(time, nu=1)) / np.array([500] * 3 + [50] * 3)
    information = wrench.T @ wrench / 1e-3**2 + np.eye(6) / 0.3**2  # noise over range, prior of the gain
    expected = np.sqrt(np.trace(np.linalg.inv(information)) / 6)
    assert planned.prediction is not None
    assert planned.prediction.oracle_rms == pytest.approx(expected, rel=0.01)


def test_predicted_sigma_is_the_error_of_calibrations(planned: Plan, table: tuple[Path, Array]) -> None:
    rig, errors = planned.rig, []
    unit = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
    for seed in range(16):
        run = simulate(rig, read_plan(table[0]), seed=seed)
        found = calibrate(rig, run.log, held_out=False)
        errors.append((found.gain - run.truth.gain) * unit)
    realised = np.sqrt(np.mean(np.square(errors)))
    assert 0.8 < realised / planned.predicted_rms < 1.25  # 576 errors
    assert planned.prediction is not None
    each = np.sqrt(np.mean(np.square(errors), axis=0)) / planned.prediction.std
    assert each.min() > 0.4  # chi-square of 16, 36 times: 0.43 to 1.7 with 99 %
    assert each.max() < 1.8


def test_a_optimal_plans_have_the_smaller_sigma_and_d_optimal_ones_the_smaller_volume() -> None:
    rig = rig_of(plan={"harmonics": 2, "rest_to_rest": False}, limits={"workspace": None, "jerk": None})
    wrench = {kind: plan(rig, criterion=kind).design.preview.wrench for kind in ("A", "D")}
    sigma, volume = {}, {}
    for kind, values in wrench.items():
        w = values / np.array([500] * 3 + [50] * 3)
        information = w.T @ w / len(w) * 500 / 1e-3**2 + np.eye(6) / 0.3**2
        sigma[kind] = np.trace(np.linalg.inv(information))
        volume[kind] = -np.linalg.slogdet(information)[1]
    assert sigma["A"] < sigma["D"]
    assert volume["D"] < volume["A"]


@pytest.mark.parametrize("kind", ["A", "D"])
@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_criterion_is_the_marginal_covariance_of_the_gain(kind: Any, offset: float) -> None:
    rng = np.random.default_rng(3)
    prior = [offset * 500] * 3 + [offset * 50] * 3
    rig = rig_of(sensor={"offset_prior": prior})
    measure = Criterion(rig, 400.0, kind)
    wrench = 0.1 * rng.standard_normal((30, 6)) + 0.05
    one = np.column_stack([wrench, np.ones(30)])
    information = 400.0 / 30 * one.T @ one / 1e-3**2 + np.diag([0.3**-2] * 6 + [max(offset, 1e-9) ** -2])
    covariance = np.linalg.inv(information)[:6, :6]
    whole = {
        "A": 0.5 * np.log(np.trace(covariance) / 6),
        "D": np.linalg.slogdet(covariance)[1] / 12,
    }[kind]
    assert measure(packed(wrench)) == pytest.approx(whole, rel=1e-9)
    value, gradient, hessian = measure.derivatives(packed(wrench))
    step = 1e-7
    for k in range(28):
        ahead = packed(wrench) + step * np.eye(28)[k]
        assert measure(ahead) - value == pytest.approx(step * gradient[k], rel=2e-3, abs=1e-9)
        np.testing.assert_allclose(
            measure.derivatives(ahead)[1] - gradient,
            step * hessian[k],
            rtol=5e-3,
            atol=1e-5 * np.abs(step * hessian).max(),
        )


@pytest.mark.slow
def test_plan_of_20_s_reaches_what_the_best_known_motion_reaches() -> None:
    """Periodic motion of the payload of [A00] within 0.5 m/s, 0.5 rad/s, 1 m/s^2, 1.5 rad/s^2."""
    limits = {"velocity": [0.5] * 6, "acceleration": [1] * 3 + [1.5] * 3, "position": [0.5] * 3 + [0.8] * 3}
    settings = changed(
        plan={"duration": 20, "harmonics": 6, "rest_to_rest": False},
        simulate={"rate": 40, "sensor_rate": 40},
    ) | {"limits": limits}
    found = plan(Rig.from_mapping(settings))
    assert found.feasible
    assert found.prediction is not None
    assert found.prediction.oracle_rms <= 0.0064


# -- the paper's sinusoidal wrenches ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def sinusoids() -> Plan:
    return plan(rig_of(limits={"workspace": None, "jerk": None}), "wrench")


def test_excitation_of_sinusoidal_wrenches_is_that_of_the_paper(sinusoids: Plan) -> None:
    facts = sinusoids.design.facts
    assert facts is not None
    assert len(set(facts["k"])) == 3
    amplitudes = np.array([*facts["force"], *facts["moment"]])
    assert sinusoids.alpha["published"] == pytest.approx(0.5 * facts["tau"] * np.min(amplitudes**2), rel=1e-3)


def test_sinusoidal_wrenches_are_felt_at_the_sensor(sinusoids: Plan) -> None:
    facts, preview = sinusoids.design.facts, sinusoids.design.preview
    assert facts is not None
    angle = 2 * np.pi * preview.time[:, None] * np.array(facts["k"]) / facts["tau"]
    expected = np.hstack([np.sin(angle) * facts["force"], np.cos(angle) * facts["moment"]])
    np.testing.assert_allclose(preview.wrench, expected, atol=2e-3 * np.abs(expected).max())


def test_sinusoidal_wrenches_within_bounds_are_found_where_they_exist(sinusoids: Plan) -> None:
    assert sinusoids.feasible
    assert max(use.share for use in sinusoids.usage) <= 1.0 + 1e-6
    assert sinusoids.prediction is not None
    assert sinusoids.prediction.rms < 0.3 / 2


def test_sinusoidal_wrenches_out_of_bounds_name_what_is_exceeded_first() -> None:
    found = plan(rig_of(limits={"workspace": [[-0.6, 0.15], [-1, 1], [-1, 1]]}), "wrench")  # begins at 0.2 m
    times = [float(words.rsplit("first at ", 1)[1].split(" s")[0]) for words in found.violations]
    assert times
    assert times == sorted(times)
    assert found.violations[0].startswith("workspace of x of the centre of mass")
    assert not found.verdict.usable


def test_sinusoidal_wrenches_in_gravity_are_refused() -> None:
    with pytest.raises(UnsupportedError, match="gravity"):
        plan(rig_of(gravity=[0, 0, -9.81]), "wrench")


# -- what no motion can do -------------------------------------------------------------------------------


def run(tmp_path: Path, settings: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(settings), encoding="utf-8")
    status = main(["plan", str(rig), "-o", str(tmp_path / "plan.csv"), "--no-pictures"])
    return status, "".join(capsys.readouterr())


def test_weight_beyond_the_range_is_said_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, said = run(tmp_path, changed(gravity=[0, 0, -9.81]), capsys)
    assert status == 3
    assert "gravity alone loads" in said
    promised = yaml.safe_load((tmp_path / "plan.csv.plan.yaml").read_text())
    assert promised["feasible"] is False
    assert promised["predicted_gain_std"] is None


def test_options_without_an_effect_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(SETTINGS), encoding="utf-8")
    words = ["plan", str(rig), "-o", str(tmp_path / "plan.csv")]
    for more, said in (
        (["--method", "wrench", "--criterion", "D"], "--criterion"),
        (["--tool", "--motion", "--poses", "5"], "--poses: found it beside --motion"),
    ):
        assert main([*words, *more]) == 2
        assert said in "".join(capsys.readouterr())
    assert not (tmp_path / "plan.csv").exists()


def test_a_workspace_without_the_start_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No motion that is drawn keeps to it, not even rest: one start is all that there is to search from."""
    status, said = run(tmp_path, changed(limits={"workspace": [[1.0, 2.0], [-1, 1], [-1, 1]]}), capsys)
    assert status == 3
    assert "workspace" in said
    promised = yaml.safe_load((tmp_path / "plan.csv.plan.yaml").read_text())
    assert promised["feasible"] is False


def test_payload_that_shows_no_moments_is_said_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    point = {"center_of_mass": [0, 0, 0], "inertia": {"xx": 1e-6, "yy": 1e-6, "zz": 1e-6}}
    settings = changed(plan={"harmonics": 2}, limits={"workspace": None})
    settings["payloads"]["default"] |= point
    status, said = run(tmp_path, settings, capsys)
    assert status == 3
    assert "would not determine" in said
    assert "moment about" in said


def test_axis_that_must_not_move_leaves_its_gains_undetermined(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = {"workspace": None, "velocity": [0.5, 0.5, 1e-6, 1e-6, 1e-6, 1]}
    settings = changed(plan={"harmonics": 2}, limits=still)
    status, said = run(tmp_path, settings, capsys)
    assert status == 3
    assert "would not determine" in said


def test_series_that_cannot_rest_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"plan\.harmonics"):
        plan(rig_of(plan={"harmonics": 1}))


def test_table_too_coarse_for_its_harmonics_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"plan\.rate"):
        plan(rig_of(plan={"rate": 4}))


def test_files_beside_a_plan_say_what_it_promises(planned: Plan, table: tuple[Path, Array]) -> None:
    promised = yaml.safe_load(table[0].with_name("plan.csv.plan.yaml").read_text())
    assert promised["feasible"] is True
    assert promised["violations"] == []
    std = np.array(promised["predicted_gain_std"])
    unit = planned.rig.sensor.range_array / planned.rig.sensor.channel_scale[:, None]
    assert np.sqrt(np.mean((std * unit) ** 2)) == pytest.approx(promised["predicted_rms"], rel=1e-9)
    assert set(promised["alpha"]) == {"normalised", "published"}
