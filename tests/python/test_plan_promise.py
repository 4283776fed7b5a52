"""Claims about what a plan promises, and about what it says that no residual would show."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import make_interp_spline

from truewrench.cli import main
from truewrench.estimation.bound import information
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.planning.planner import plan
from truewrench.planning.prediction import Prediction, predict
from truewrench.planning.result import Plan
from truewrench.planning.series import SeriesBasis
from truewrench.planning.spread import Spread, spread_weight
from truewrench.simulation.free_body import simulate

Array = NDArray[np.float64]

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
MASS, CENTER, INERTIA = 50.0, np.array([0.2, 0.0, 0.0]), np.diag([1.5, 1.5, 0.4])
RANGE = np.array([500.0] * 3 + [50.0] * 3)
SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
        "range": RANGE.tolist(),
    },
    "payloads": {
        "default": {
            "mass": 50,
            "center_of_mass": [0.2, 0, 0],
            "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
        }
    },
    "motion": {"noise": [1e-3] * 6},
    "limits": {"velocity": [0.5] * 6, "acceleration": [1] * 3 + [1.5] * 3, "position": [0.5] * 3 + [0.8] * 3},
    "plan": {"duration": 10, "rate": 40, "harmonics": 6, "rest_to_rest": False},
    "required": 0.3,
}


def settings_of(**sections: Any) -> dict[str, Any]:
    settings = deepcopy(SETTINGS)
    for name, section in sections.items():
        if isinstance(section, dict):
            settings[name] |= section
        else:
            settings[name] = section
    return settings


def rig_of(**sections: Any) -> Rig:
    return Rig.from_mapping(settings_of(**sections))


@pytest.fixture(scope="module")
def planned() -> Plan:
    return plan(rig_of())


@pytest.fixture(scope="module")
def written(planned: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "plan.csv"
    planned.write(path)
    return path


def promise(planned: Plan, **sections: Any) -> Prediction:
    """What the same motion promises another rig."""

    def simulated(nominal: Rig) -> Log:
        return simulate(nominal, planned.design.motion).log  # type: ignore[arg-type]

    return predict(rig_of(**sections), "default", planned.trajectory, planned.design.preview, simulated, 1.0)


# -- the promise -----------------------------------------------------------------------------------------


def test_promised_sigma_is_the_bound_with_all_that_the_rig_leaves_uncertain(planned: Plan) -> None:
    found = planned.prediction
    assert found is not None
    log = simulate(planned.rig, planned.design.motion, seed=3).log  # type: ignore[arg-type]
    told = information(planned.rig, [log], np.eye(6))[0]
    expected = np.sqrt(np.diag(told.covariance())).reshape(6, 6)
    np.testing.assert_allclose(found.std, expected, rtol=0.05)
    assert found.oracle_rms < found.bound_rms < found.rms
    assert set(found.limited_by) == {"noise", "mass", "center_of_mass", "inertia", "timing"}


def test_exact_payload_and_clock_leave_the_noise(planned: Plan) -> None:
    exact = settings_of(sensor={"time_offset_prior": 0})
    exact["payloads"]["default"]["uncertainty"] = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    found = promise(planned, sensor=exact["sensor"], payloads=exact["payloads"])
    assert found.rms == pytest.approx(found.bound_rms)
    assert set(found.limited_by) == {"noise"}


def test_direction_of_gravity_counts_where_gravity_acts(planned: Plan) -> None:
    wide = {"range": [5000.0] * 3 + [500.0] * 3, "noise": [0.5] * 3 + [0.05] * 3}
    exact, default = (
        promise(planned, gravity=[0, 0, -9.81], gravity_tilt_prior=prior, sensor=wide)
        for prior in (0, 3.5e-3)
    )
    assert "gravity" not in exact.limited_by
    assert default.limited_by["gravity"] > 0.0
    assert default.rms > exact.rms


def test_stated_discrepancy_widens_what_is_promised_as_the_motion_can_hide_the_pose(planned: Plan) -> None:
    auto, none, stated = (promise(planned, sensor={"discrepancy": f}) for f in ("auto", 0, 1e-4))
    np.testing.assert_array_equal(auto.std, none.std)
    A, moment = stated.pose.A, stated.pose.ww
    added = 1e-8 * A / (1 - A) * np.diag(np.linalg.inv(moment)) / 6
    assert (auto.std**2 + added < 0.3**2).all()  # no gain is near its prior
    np.testing.assert_allclose(stated.std**2, auto.std**2 + added, rtol=1e-6)
    assert stated.limited_by["pose"] == pytest.approx(np.sqrt(added.mean()), rel=1e-6)
    # which a longer record does not help
    assert stated.longer[5] > np.sqrt(added.mean())


def test_stated_discrepancy_raises_no_sigma_above_its_prior(planned: Plan) -> None:
    assert promise(planned, sensor={"discrepancy": 1.0}).std.max() <= 0.3 + 1e-12


# -- what it could not show ------------------------------------------------------------------------------


def test_share_of_the_pose_is_that_of_the_table(planned: Plan, written: Path) -> None:
    """Ordinary regressions of the integrated table on the wrench of a free body, written out."""
    table = np.genfromtxt(written, delimiter=",", names=True)
    spline = make_interp_spline(table["time_s"], np.column_stack([table[name] for name in TWIST]), k=5)
    time = np.linspace(0.0, table["time_s"][-1], 4001)
    nu, a = spline(time), spline(time, nu=1)
    force = -MASS * (a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]))
    about_center = a[:, 3:] @ INERTIA + np.cross(nu[:, 3:], nu[:, 3:] @ INERTIA)
    wrench = np.hstack([force, np.cross(CENTER, force) - about_center]) / RANGE
    pose = cumulative_simpson(nu, x=time, axis=0, initial=0.0)
    columns = np.column_stack([wrench, np.ones(time.size)])
    rest = pose - columns @ np.linalg.lstsq(columns, pose, rcond=None)[0]
    expected = float(np.mean(1.0 - rest.var(axis=0) / pose.var(axis=0)))
    promised = yaml.safe_load(written.with_name("plan.csv.plan.yaml").read_text())
    assert promised["A"] == pytest.approx(expected, abs=1e-3)
    effect = 1e-3 * np.sqrt(
        expected / (1 - expected) * np.diag(np.linalg.inv(wrench.T @ wrench / time.size)).max() / 6
    )
    cable = next(entry for entry in promised["verdict"]["blind_to"] if entry["kind"] == "cable")
    assert cable["size"] == 1e-3
    assert cable["effect"] == pytest.approx(min(effect, 0.3), rel=0.01)
    assert set(cable) == {"kind", "size", "effect", "words"}


def test_summary_says_what_no_residual_would_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(settings_of(plan={"harmonics": 2, "duration": 5})), encoding="utf-8")
    status = main(["plan", str(rig), "-o", str(tmp_path / "plan.csv"), "--no-pictures"])
    assert status == 0
    said = " ".join("".join(capsys.readouterr()).split())
    assert "What no residual of this motion would show (A = 0." in said
    assert "that follows the pose (a cable) would move some gain by" in said


def test_wrenches_of_one_frequency_say_what_they_would_hide() -> None:
    found = plan(rig_of(), "wrench")
    assert any("one frequency" in note for note in found.notes)
    assert {entry.kind for entry in found.verdict.blind_to} == {"cable", "delay"}  # sine and cosine
    assert found.verdict.usable


def test_several_frequencies_hide_less_of_the_pose_and_cost_next_to_nothing(planned: Plan) -> None:
    """Where nothing follows the pose, the best motion has one frequency on some axes."""
    found, free = planned.prediction, plan(rig_of(sensor={"discrepancy": 0})).prediction
    assert found is not None
    assert free is not None
    assert found.pose.A < 0.5 < 0.8 < free.pose.A
    assert found.oracle_rms < 1.02 * free.oracle_rms
    assert found.blind_to[0].effect < 0.5 * free.blind_to[0].effect


def test_plan_that_hides_most_of_its_pose_says_what_would_help() -> None:
    found = plan(rig_of(plan={"harmonics": 2, "duration": 5}))
    assert found.prediction is not None
    assert found.prediction.pose.A > 0.8
    assert any("plan.harmonics" in note for note in found.notes)


# -- several frequencies a coordinate --------------------------------------------------------------------


def test_price_is_that_of_position_explained_by_acceleration() -> None:
    basis = SeriesBasis(5, 4.0, True)
    rng = np.random.default_rng(2)
    coefficients = rng.standard_normal((3, basis.size))
    time = np.linspace(0.0, 4.0, 4000, endpoint=False)
    expected = 0.0
    for c in coefficients:
        position, acceleration = basis.table(time, 0) @ c, basis.table(time, 2) @ c
        r = np.corrcoef(position, acceleration)[0, 1] ** 2
        expected -= np.log(1.05 - r) / 3
    assert Spread(basis, 3)(coefficients.ravel()) == pytest.approx(expected, rel=1e-6)
    one = np.zeros((1, 10))
    one[0, 3] = 2.0
    free = SeriesBasis(5, 4.0, False)
    assert Spread(free, 1)(one.ravel()) == pytest.approx(np.log(20.0))  # one frequency: r is 1


def test_coordinate_that_does_not_move_costs_nothing() -> None:
    basis = SeriesBasis(4, 4.0, False)
    price = Spread(basis, 2)
    moving = np.random.default_rng(0).standard_normal(8)
    still = np.concatenate([moving, np.zeros(8)])
    alone = Spread(basis, 1)(moving)
    assert price(still) == pytest.approx(0.5 * (alone - np.log(1.05)))
    assert np.isfinite(price.derivatives(still)[1]).all()


def test_frequencies_cost_nothing_where_nothing_follows_the_pose() -> None:
    weights = [spread_weight(rig_of(sensor={"discrepancy": f})) for f in (0, "auto", 1e-3)]
    assert weights[0] == 0.0 < weights[1] < weights[2]


# -- limits ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limits", [{}, {"wrench_fraction": 0.5}])
@pytest.mark.parametrize("method", ["optimal", "wrench"])
def test_twist_that_nothing_bounds_is_refused_with_the_keys_to_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], limits: dict[str, Any], method: str
) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(SETTINGS | {"limits": limits}), encoding="utf-8")
    status = main(["plan", str(rig), "-o", str(tmp_path / "plan.csv"), "--method", method])
    assert status == 2
    said = "".join(capsys.readouterr())
    for word in ("rig.yaml", "limits", "velocity", "acceleration", "position", "workspace"):
        assert word in said
    assert list(tmp_path.iterdir()) == [rig]


def test_limits_that_are_not_stated_are_named_with_what_the_motion_reaches() -> None:
    short = settings_of(plan={"harmonics": 2, "duration": 5})
    found = plan(Rig.from_mapping(short | {"limits": {"velocity": [0.5] * 6}}))
    assert set(found.unlimited) == {"acceleration", "position"}
    preview, motion = found.design.preview, found.trajectory
    reached = np.abs(motion.acceleration(preview.time)).max(axis=0)
    np.testing.assert_allclose(found.unlimited["acceleration"], reached)
    assert any(
        f"no limit of the acceleration is stated: the motion reaches {reached[:3].max():.3g} m/s^2" in note
        for note in found.notes
    )
    assert found.to_mapping()["unlimited"] == found.unlimited


def test_limits_that_are_all_stated_leave_nothing_unlimited(planned: Plan) -> None:
    assert planned.unlimited == {}
    assert not any("no limit" in note for note in planned.notes)
