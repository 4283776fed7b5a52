"""Claims about planned motions of arms, and about the derivatives that all plans are found with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from truewrench import robots
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.rig import Rig, load_rig
from truewrench.planning.criterion import Criterion
from truewrench.planning.joint_space import arm_outputs, joint_limits, joint_space
from truewrench.planning.limits import Limits
from truewrench.planning.optimise import Problem, Space
from truewrench.planning.period import typical_velocity
from truewrench.planning.pictures import draw_plan
from truewrench.planning.planner import plan
from truewrench.planning.result import Plan
from truewrench.planning.series import SeriesBasis
from truewrench.planning.twist_space import pose_space, twist_space
from truewrench.robot.arm import robot_of

Array = NDArray[np.float64]
QUICK = {"duration": 5.0, "harmonics": 3, "rate": 50.0}


@pytest.fixture(scope="module")
def planned(arm_rig: Callable[..., Rig]) -> Plan:
    """The Panda on the ground, five seconds."""
    return plan(arm_rig("panda_ground", plan=QUICK, gravity_tilt_prior=0))


@pytest.fixture(scope="module")
def written(planned: Plan, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return planned.write(tmp_path_factory.mktemp("plan") / "plan.csv")


def test_what_no_limit_holds_back_is_told_in_the_unit_of_a_joint(planned: Plan) -> None:
    usage = tuple(use for use in planned.usage if use.limit != "acceleration")
    preview = replace(planned.design.preview, usage=usage)
    plain = replace(planned, design=replace(planned.design, preview=preview))
    (note,) = [note for note in plain.notes if "no limit of the acceleration" in note]
    assert note.endswith(f"the motion reaches {max(plain.unlimited['acceleration']):.3g} rad/s^2")


def joints(planned: Plan, path: Path) -> tuple[pin.Model, Array, Array, Array, Array]:
    """Time, positions and derivatives at 1 kHz, from the file: quintic splines by SciPy."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    model = robot_of(planned.rig).model
    rows = np.column_stack([table[f"q_{name}"] for name in model.names[1:]])
    spline = make_interp_spline(table["time_s"], rows, k=5)
    time = np.linspace(0.0, table["time_s"][-1], 5001)
    return model, time, spline(time), spline(time, nu=1), spline(time, nu=2)


def test_planned_joints_keep_to_their_limits_between_the_rows(planned: Plan, written: list[Path]) -> None:
    model, _, q, qd, qdd = joints(planned, written[0])
    limits = planned.rig.limits
    assert (q <= model.upperPositionLimit + 1e-6).all()
    assert (q >= model.lowerPositionLimit - 1e-6).all()
    most = np.minimum(model.velocityLimit, limits.velocity or np.inf)
    assert (np.abs(qd) <= most * (1 + 1e-6)).all()
    assert limits.acceleration is not None
    assert (np.abs(qdd) <= np.array(limits.acceleration) * (1 + 1e-5)).all()


def test_a_joint_whose_velocity_is_0_stands_still(arm_rig: Callable[..., Rig]) -> None:
    rig = arm_rig("panda_ground", plan=QUICK, gravity_tilt_prior=0)
    velocity = [*rig.limits.velocity]
    velocity[2] = 0.0
    found = plan(rig.model_copy(update={"limits": rig.limits.model_copy(update={"velocity": velocity})}))
    assert found.feasible
    time = np.linspace(0.0, 5.0, 1001)
    travel = np.ptp(found.trajectory.position(time), axis=0)
    assert travel[2] < 1e-8
    assert (np.delete(travel, 2) > 0.01).all()


def test_planned_torques_and_wrenches_are_within_what_pinocchio_finds(
    planned: Plan, written: list[Path]
) -> None:
    """The payload as a body of Pinocchio's own model, moved by its recursive Newton-Euler algorithm."""
    model, _, q, qd, qdd = joints(planned, written[0])
    body, robot = planned.rig.payloads["default"], robot_of(planned.rig)
    model = pin.Model(model)
    inertia = pin.Inertia(body.mass, body.center_of_mass_array, body.inertia_matrix)
    frame = model.frames[robot.frame_id]
    model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    model.gravity.linear = planned.rig.gravity_array
    data, sensor_range = model.createData(), planned.rig.sensor.range_array
    bare = robot.model.inertias[frame.parentJoint]
    for k in range(0, len(q), 5):
        torque = pin.rnea(model, data, q[k], qd[k], qdd[k])
        assert (np.abs(torque) <= model.effortLimit * (1 + 1e-6)).all()
        pin.forwardKinematics(model, data, q[k], qd[k], qdd[k])
        gravity = data.oMi[frame.parentJoint].rotation.T @ planned.rig.gravity_array
        acceleration = data.a[frame.parentJoint] - pin.Motion(gravity, np.zeros(3))
        velocity = data.v[frame.parentJoint]
        link = bare * acceleration + velocity.cross(bare * velocity)
        wrench = frame.placement.actInv(data.f[frame.parentJoint] - link).vector
        assert (np.abs(wrench) <= planned.rig.limits.wrench_fraction * sensor_range * (1 + 1e-6)).all()


def test_planned_sensor_and_payload_stay_in_the_workspace(planned: Plan, written: list[Path]) -> None:
    model, _, q, _, _ = joints(planned, written[0])
    box = np.array(planned.rig.limits.workspace)
    data, robot = model.createData(), robot_of(planned.rig)
    for row in q[::2]:
        pin.framesForwardKinematics(model, data, row)
        at = data.oMf[robot.frame_id]
        center = at.act(planned.rig.payloads["default"].center_of_mass_array)
        for place in (at.translation, center):
            assert (place >= box[:, 0] - 1e-6).all()
            assert (place <= box[:, 1] + 1e-6).all()


def test_planned_joints_begin_and_end_at_rest_where_they_began(planned: Plan, written: list[Path]) -> None:
    table = np.genfromtxt(written[0], delimiter=",", names=True)
    for name in robot_of(planned.rig).joints:
        np.testing.assert_allclose(table[f"dq_{name}"][[0, -1]], 0.0, atol=1e-9)
        np.testing.assert_allclose(table[f"ddq_{name}"][[0, -1]], 0.0, atol=1e-9)
        assert table[f"q_{name}"][0] == pytest.approx(table[f"q_{name}"][-1], abs=1e-9)


def test_plan_of_an_arm_is_also_a_joint_trajectory(planned: Plan, written: list[Path]) -> None:
    message = yaml.safe_load(next(p for p in written if p.name.endswith("trajectory.yaml")).read_text())
    table = np.genfromtxt(written[0], delimiter=",", names=True)
    assert message["joint_names"] == list(robot_of(planned.rig).joints)
    assert len(message["points"]) == len(table)
    point, row = message["points"][100], table[100]
    assert point["positions"] == pytest.approx([row[f"q_{name}"] for name in message["joint_names"]])
    since = point["time_from_start"]
    assert since["sec"] + 1e-9 * since["nanosec"] == pytest.approx(row["time_s"])


def test_what_a_plan_promises_of_longer_records_is_the_root_of_time(planned: Plan) -> None:
    found = planned.prediction
    assert found is not None
    exact = found.limited_by["noise"]  # payload and clock are exact here
    assert found.rms == pytest.approx(exact, rel=0.05)
    assert found.longer[2] == pytest.approx(found.rms / np.sqrt(2.0), rel=0.03)
    assert found.longer[5] == pytest.approx(found.rms / np.sqrt(5.0), rel=0.03)


def test_pictures_of_a_plan_are_drawn(planned: Plan, tmp_path: Path) -> None:
    drawn = draw_plan(planned, tmp_path / "plan.csv")
    assert {path.name for path in drawn} == {
        f"plan.csv.{kind}.png" for kind in ("motion", "limits", "sigma", "path")
    }
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in drawn)


# -- derivatives -----------------------------------------------------------------------------------------


def twist_rig(**limits: Any) -> Rig:
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": list("abcdef"),
                "feels": "sensor_on_payload",
                "noise": [0.5] * 6,
                "range": [500] * 3 + [50] * 3,
            },
            "payloads": {
                "default": {
                    "mass": 5,
                    "center_of_mass": [0.2, 0.1, -0.1],
                    "inertia": {"xx": 0.5, "yy": 0.4, "zz": 0.3, "xy": 0.05},
                }
            },
            "motion": {"of": "sensor", "noise": [1e-3] * 6},
            "gravity": [0, 0, -9.81],
            "limits": {"velocity": [1] * 6, "acceleration": [2] * 6} | limits,
        }
    )


def problems(arm_rig: Callable[..., Rig]) -> list[tuple[str, Problem]]:
    basis = SeriesBasis(2, 4.0, True)
    found = []

    def add(name: str, space: Space, rig: Rig, limits: Limits) -> None:
        found.append((name, Problem(space, basis, Criterion(rig, 400.0, "A"), limits, spread=0.3)))

    boxed = twist_rig(workspace=[[-1, 1]] * 3, position=[0.5] * 6)
    limits = Limits.of(boxed, 6)
    scale = typical_velocity(limits, basis)
    add("pose", pose_space(boxed, "default", limits, scale), boxed, limits)
    add("twist", twist_space(boxed, "default", scale), boxed, limits)
    ground = arm_rig("panda_ground")
    robot = robot_of(ground)
    bounds = joint_limits(ground, robot)
    kinds = {"workspace", "torque", "clearance"}
    outputs = arm_outputs(ground, "default", robot)
    space = joint_space(ground, outputs, bounds, typical_velocity(bounds, basis), None, kinds)
    add("joints", space, ground, bounds)
    return found


@pytest.mark.parametrize(
    ("position", "upper", "words"),
    [
        ([3, 3, 3, 0.01, 3, 3, 3], None, "limits.position (-0.01 to 0.01) and the URDF (-3.0718 to -0.0698)"),
        (None, -2.8973, "limits.position (-inf to inf) and the URDF (-2.8973 to -2.8973)"),
    ],
)
def test_a_joint_without_any_range_is_named(
    arm_rig: Callable[..., Rig], position: list[float] | None, upper: float | None, words: str
) -> None:
    rig = arm_rig("panda", limits={"position": position})
    robot = robot_of(rig)
    joint = "panda_joint4"
    if upper is not None:
        joint, robot = "panda_joint1", replace(robot, upper=np.array([upper, *robot.upper[1:]]))
    with pytest.raises(InputError) as caught:
        joint_limits(rig, robot)
    assert f"joint `{joint}`: found no range within both {words}" in str(caught.value)


def test_derivatives_of_every_plan_are_those_by_finite_differences(arm_rig: Callable[..., Rig]) -> None:
    rng = np.random.default_rng(1)
    for name, problem in problems(arm_rig):
        x = 0.3 * rng.standard_normal(problem.size)
        rows = problem.rows(np.ones(problem.count, dtype=bool))
        step, direction = 1e-5, rng.standard_normal(problem.size)
        ahead, behind = x + step * direction, x - step * direction
        value, gradient = problem.gradient(x)
        assert value == problem.value(x)
        slope = (problem.value(ahead) - problem.value(behind)) / (2 * step)
        assert gradient @ direction == pytest.approx(slope, rel=1e-5), name
        jacobian = problem.constraint_jacobian(x, rows)[1]
        differences = (problem.constraints(ahead, rows) - problem.constraints(behind, rows)) / (2 * step)
        np.testing.assert_allclose(
            jacobian @ direction, differences, rtol=1e-4, atol=1e-6 * np.abs(differences).max(), err_msg=name
        )
        weights = rng.standard_normal(rows.kept.sum()) / np.maximum(np.abs(jacobian).max(axis=1), 1e-3)

        def slope_of_lagrangian(at: Array, problem: Problem, rows: Any, weights: Array) -> Array:
            return np.asarray(problem.gradient(at)[1] + weights @ problem.constraint_jacobian(at, rows)[1])

        curvature = (
            slope_of_lagrangian(ahead, problem, rows, weights)
            - slope_of_lagrangian(behind, problem, rows, weights)
        ) / (2 * step)
        hessian = problem.hessian(x, 1.0, weights, rows)
        np.testing.assert_allclose(hessian, hessian.T, atol=1e-5 * np.abs(hessian).max(), err_msg=name)
        np.testing.assert_allclose(
            hessian @ direction, curvature, atol=1e-5 * np.abs(curvature).max(), err_msg=name
        )


# -- the paper's wrenches, led through joints -------------------------------------------------------------


def test_joints_lead_the_payload_so_that_every_force_has_one_frequency(arm_rig: Callable[..., Rig]) -> None:
    """By Pinocchio's motion of the sensor's frame, within the joints' limits."""
    rig = arm_rig("spdm", plan={"duration": 10.0})
    found = plan(rig, method="wrench")
    motion, body = found.trajectory, rig.payloads["default"]
    t = np.linspace(0.0, 10.0, 401)
    q, dq, ddq = motion.position(t), motion.velocity(t), motion.acceleration(t)
    assert found.feasible
    assert np.abs(dq).max() <= 0.0698
    assert np.abs(ddq).max() <= 0.07
    assert rig.path is not None
    model = pin.buildModelFromUrdf(str(Path(rig.path).parent / "spdm.urdf"))
    data, frame, c = model.createData(), model.getFrameId("ft"), np.array(body.center_of_mass)
    force = np.empty((len(t), 3))
    for k in range(len(t)):
        pin.forwardKinematics(model, data, q[k], dq[k], ddq[k])
        omega = pin.getFrameVelocity(model, data, frame, pin.LOCAL).angular
        a = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL)
        force[k] = body.mass * (a.linear + np.cross(a.angular, c) + np.cross(omega, np.cross(omega, c)))

    def left(axis: int, hz: float) -> float:
        phase = 2.0 * np.pi * hz * t
        design = np.column_stack([np.ones_like(t), np.sin(phase), np.cos(phase)])
        rest = force[:, axis] - design @ np.linalg.lstsq(design, force[:, axis])[0]
        return float(np.var(rest) / np.var(force[:, axis]))

    best = [min((left(axis, hz), hz) for hz in np.linspace(0.05, 1.0, 96)) for axis in range(3)]
    assert max(share for share, _ in best) < 0.1
    assert len({round(hz, 1) for _, hz in best}) == 3


@pytest.mark.parametrize(
    ("arm", "changes", "words"),
    [
        ("ur10_ground", {}, "a rig in gravity"),
        ("spdm", {"motion": {"initial_position": None}}, "motion.initial_position: found nothing"),
    ],
)
def test_sinusoidal_wrenches_ask_for_free_fall_and_a_posture(
    arm_rig: Callable[..., Rig], arm: str, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        plan(arm_rig(arm, **changes), method="wrench")


def test_a_joint_that_mimics_another_is_not_planned(tmp_path: Path) -> None:
    path = robots.path("panda_ground")
    text = (path.parent / "panda.urdf").read_text(encoding="utf-8")
    joint = '<joint name="panda_joint5" type="revolute">'
    assert joint in text
    (tmp_path / "arm.urdf").write_text(text.replace(joint, f'{joint}<mimic joint="panda_joint3"/>'))
    settings = load_rig(path).to_mapping()
    settings["motion"]["robot"]["urdf"] = str(tmp_path / "arm.urdf")
    rig = Rig.from_mapping(settings)
    assert robot_of(rig).n == 7  # logs that have it tell it
    with pytest.raises(UnsupportedError, match=r"`panda_joint5`: found <mimic> of `panda_joint3`"):
        plan(rig)


def test_a_narrow_workspace_is_tried_from_other_draws() -> None:
    """The optima of the first draw leave it, and a random motion was planned: 12% in place of 0.5%."""
    path = robots.path("panda_ground")
    settings = load_rig(path).to_mapping()
    settings["plan"]["duration"] = 10
    rig = load_rig(path)
    assert rig.motion.initial_position is not None
    place = robot_of(rig).pose(np.array([rig.motion.initial_position]))[1][0]
    half = np.array([0.08, 0.1, 0.08])
    settings["limits"]["workspace"] = np.column_stack([place - half, place + half]).tolist()
    found = plan(Rig.from_mapping(settings, path))
    assert found.verdict.usable
    assert found.prediction is not None
    assert found.prediction.rms < 0.01
