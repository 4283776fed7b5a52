"""Claims about arms simulated in MuJoCo, with Pinocchio and the laws of mechanics as judges."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.interpolate import make_interp_spline

from truewrench.cli import main
from truewrench.io.tables import read_log
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import Body
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig, load_rig
from truewrench.simulation.arm import simulate_arm
from truewrench.simulation.arm.model import Arm, Reading, arm_of
from truewrench.simulation.arm.run import ArmRun, record
from truewrench.simulation.truth import Truth, begin

Array = np.ndarray[Any, np.dtype[np.float64]]

# A turntable, an elbow without limits, a slide and a wrist, with frames askew, a link without inertia and a
# gripper beyond the sensor.
URDF = """
<robot name="four">
  <link name="base"/>
  <joint name="stand" type="fixed">
    <parent link="base"/><child link="column"/><origin xyz="0.1 0 0.4" rpy="0.1 -0.2 0.3"/>
  </joint>
  <link name="column"><visual><geometry><mesh filename="package://none/column.dae"/></geometry></visual></link>
  <joint name="turn" type="revolute">
    <parent link="column"/><child link="shoulder"/><origin xyz="0 0 0.2" rpy="0 0.3 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1.5" effort="500"/>
    <dynamics damping="0.5" friction="0.3"/>
  </joint>
  <link name="shoulder"/>
  <joint name="elbow" type="continuous">
    <parent link="shoulder"/><child link="arm"/><origin xyz="0.1 0 0.3" rpy="1.4 0 0.2"/>
    <axis xyz="0 0.6 0.8"/>
  </joint>
  <link name="arm"><inertial>
    <origin xyz="0.2 0 0.05" rpy="0.3 0.2 0.1"/><mass value="3"/>
    <inertia ixx="0.02" iyy="0.06" izz="0.05" ixy="0.001" ixz="0.002" iyz="0"/>
  </inertial></link>
  <joint name="slide" type="prismatic">
    <parent link="arm"/><child link="forearm"/><origin xyz="0.4 0 0" rpy="0 0.5 0"/>
    <axis xyz="1 0 0"/><limit lower="-0.3" upper="0.3" velocity="0.5" effort="500"/>
  </joint>
  <link name="forearm"><inertial>
    <origin xyz="0.1 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="wrist" type="revolute">
    <parent link="forearm"/><child link="hand"/><origin xyz="0.3 0 0" rpy="0.2 0 0"/>
    <axis xyz="1 0 0"/><limit lower="-3" upper="3" velocity="2" effort="100"/>
  </joint>
  <link name="hand"><inertial>
    <mass value="0.5"/><inertia ixx="0.002" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="mount" type="fixed">
    <parent link="hand"/><child link="ft"/><origin xyz="0.1 0 0.02" rpy="0.3 0.4 0.5"/>
  </joint>
  <link name="ft"/>
  <joint name="finger_joint" type="prismatic">
    <parent link="ft"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.05" velocity="0.1" effort="10"/>
  </joint>
  <link name="finger"><inertial>
    <mass value="0.1"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
</robot>
"""
JOINTS = ("turn", "elbow", "slide", "wrist")
BODY = Body(6.0, np.array([0.05, -0.02, 0.1]),
            np.array([[0.09, 0.01, 0.005], [0.01, 0.08, -0.004], [0.005, -0.004, 0.05]]))  # fmt: skip
SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.1, 0.1, 0.1, 0.01, 0.01, 0.01],
        "range": [300, 300, 300, 30, 30, 30],
    },
    "payloads": {
        "default": {
            "mass": BODY.mass,
            "center_of_mass": BODY.center_of_mass.tolist(),
            "inertia": {"xx": 0.09, "yy": 0.08, "zz": 0.05, "xy": 0.01, "xz": 0.005, "yz": -0.004},
        }
    },
    "motion": {
        "source": "joints",
        "noise": [1e-4, 2e-4, 3e-4, 4e-4],
        "position_noise": [1e-5, 2e-5, 3e-5, 4e-5],
        "robot": {"urdf": "four.urdf", "sensor_frame": "ft"},
    },
    "plan": {"duration": 4},
    "simulate": {"gain": "nominal", "offset": "none"},
}
ORBIT, GROUND = np.zeros(3), np.array([0.5, -0.2, -9.81])
FAST = SETTINGS["simulate"] | {"rate": 500, "sensor_rate": 500}
QUIET = {"sensor": {"noise": [1e-12] * 6}, "motion": {"noise": [1e-14] * 4, "position_noise": [1e-14] * 4}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robot")
    (path / "four.urdf").write_text(URDF)
    return path


def rig_of(folder: Path, **changes: Any) -> Rig:
    settings = deepcopy(SETTINGS)
    for section, values in changes.items():
        settings[section] = {**settings.get(section, {}), **values} if isinstance(values, dict) else values
    return Rig.from_mapping(settings, folder / "rig.yaml")


@pytest.fixture(scope="module")
def quiet(folder: Path) -> ArmRun:
    """A run without noise, in gravity."""
    return simulate_arm(rig_of(folder, gravity=GROUND.tolist(), simulate=FAST, **QUIET))


class Oracle:
    """The arm in Pinocchio, its payload behind one more joint, which never moves: RNEA tells its load."""

    def __init__(self, folder: Path, body: Body, gravity: Array) -> None:
        whole = pin.buildModelFromUrdf(str(folder / "four.urdf"))
        model = pin.buildReducedModel(whole, [whole.getJointId("finger_joint")], pin.neutral(whole))
        frame = model.frames[model.getFrameId("ft")]
        self.weld = model.addJoint(frame.parentJoint, pin.JointModelRX(), frame.placement, "weld")
        model.appendBodyToJoint(
            self.weld, pin.Inertia(body.mass, body.center_of_mass, body.inertia), pin.SE3.Identity()
        )
        model.gravity.linear = gravity
        self.model, self.gravity = model, gravity

    def reading(self, q: Array, qd: Array, qdd: Array) -> Reading:
        data, rows = self.model.createData(), []
        for position, velocity, acceleration in zip(q, qd, qdd, strict=True):
            full, rates = pin.neutral(self.model), np.zeros((2, self.model.nv))
            for name, x, v, a in zip(JOINTS, position, velocity, acceleration, strict=True):
                joint = self.model.joints[self.model.getJointId(name)]
                full[joint.idx_q : joint.idx_q + joint.nq] = [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
                rates[:, joint.idx_v] = v, a
            pin.rnea(self.model, data, full, *rates)
            pin.forwardKinematics(self.model, data, full, *rates)
            R = data.oMi[self.weld].rotation
            nu = data.v[self.weld].vector
            a = data.a[self.weld].vector
            inertial = a[:3] + np.cross(nu[3:], nu[:3])
            g = R.T @ self.gravity
            p = data.oMi[self.weld].translation
            rows.append(np.concatenate([-data.f[self.weld].vector, nu, inertial - g, g, R.ravel(), p]))
        wrench, twist, force, g, R, p = np.hsplit(np.array(rows), [6, 12, 15, 18, 27])
        return Reading(wrench, twist, force, g, R.reshape(-1, 3, 3), p)


def arm(folder: Path, body: Body = BODY, gravity: Array = GROUND) -> Arm:
    return arm_of(folder / "four.urdf", "ft", JOINTS, body, gravity)


@pytest.mark.parametrize("gravity", [ORBIT, GROUND])
def test_mujoco_and_pinocchio_agree_on_the_sensor_of_random_states(folder: Path, gravity: Array) -> None:
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-1, 1, (3, 50, 4)) * np.array([[[3.0]], [[2.0]], [[10.0]]])
    found = arm(folder, gravity=gravity).ideal(q, qd, qdd)
    expected = Oracle(folder, BODY, gravity).reading(q, qd, qdd)
    for name in ("wrench", "twist", "specific_force", "gravity", "R_root_sensor", "p_root_sensor"):
        value = getattr(expected, name)
        np.testing.assert_allclose(
            getattr(found, name), value, rtol=0, atol=1e-12 * (1 + np.abs(value).max())
        )


def test_driven_wrench_is_that_of_pinocchio_on_the_recorded_motion(folder: Path, quiet: ArmRun) -> None:
    log, raw = quiet.log, quiet.log.raw
    assert log.position is not None
    assert log.velocity is not None
    qdd = make_interp_spline(log.time, log.velocity, k=5)(log.time, nu=1)
    expected = Oracle(folder, BODY, GROUND).reading(log.position, log.velocity, qdd).wrench
    inner = slice(10, -10)  # splines are poor at their ends
    scale = np.abs(expected).max(axis=0)
    assert np.max(np.abs(raw - expected)[inner] / scale) < 1e-6


def test_recorded_wrench_obeys_newton_and_euler_on_the_recorded_twist(quiet: ArmRun) -> None:
    assert 0.0 < quiet.moved.disagreement < 2e-8


def test_a_record_that_breaks_the_laws_of_mechanics_is_never_truth(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = Arm.read

    def ten_ppm_too_heavy(self: Arm, data: Any) -> Array:
        row = honest(self, data)
        row[:6] *= 1.0 + 1e-5
        return row

    monkeypatch.setattr(Arm, "read", ten_ppm_too_heavy)
    with pytest.raises(RuntimeError, match="Newton-Euler"):
        simulate_arm(rig_of(folder))


@pytest.mark.parametrize("gravity", [ORBIT, GROUND])
def test_work_of_the_sensor_is_the_energy_of_the_payload(folder: Path, gravity: Array) -> None:
    rig = rig_of(
        folder,
        gravity=gravity.tolist(),
        simulate={"rate": 500, "sensor_rate": 500, "gain": "nominal"},
        **QUIET,
    )
    run = simulate_arm(rig)
    reading = run.moved.joints.reading
    power = -np.einsum("ij,ij->i", run.moved.wrench, reading.twist)  # of the sensor on the payload
    omega = reading.twist[:, 3:]
    center = reading.twist[:, :3] + np.cross(omega, BODY.center_of_mass)
    kinetic = 0.5 * BODY.mass * (center**2).sum(axis=1)
    kinetic += 0.5 * np.einsum("ni,ij,nj->n", omega, BODY.inertia, omega)
    falling = BODY.mass * np.einsum("ij,ij->i", center, reading.gravity)  # work of gravity per second
    work = make_interp_spline(run.moved.stamps.motion, power + falling, k=5).antiderivative()
    gained = kinetic - kinetic[0]
    np.testing.assert_allclose(work(run.moved.stamps.motion), gained, atol=1e-6 * np.abs(kinetic).max())
    assert kinetic.max() > 0.1


def test_skeleton_runs_from_the_root_through_the_joints_to_the_sensor(folder: Path) -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(-0.3, 0.3, (20, 4))
    points = arm(folder).skeleton(q)
    model = pin.buildModelFromUrdf(str(folder / "four.urdf"))
    data = model.createData()
    for position, found in zip(q, points, strict=True):
        full = pin.neutral(model)
        for name, x in zip(JOINTS, position, strict=True):
            joint = model.joints[model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
        pin.framesForwardKinematics(model, data, full)
        joints = [data.oMi[model.getJointId(name)].translation for name in JOINTS]
        expected = [np.zeros(3), *joints, data.oMf[model.getFrameId("ft")].translation]
        # the slide's own origin moves along its axis: any point of the axis will do
        along = data.oMi[model.getJointId("slide")].rotation[:, 0]
        off = found - np.array(expected)
        off[3] -= along * (along @ off[3])
        np.testing.assert_allclose(off, 0.0, atol=1e-12)


def still(position: list[float], duration: float = 1.0) -> SplineJoints:
    return SplineJoints.through(np.linspace(0, duration, 50), np.tile(position, (50, 1)))


def test_an_arm_at_rest_weighs_its_payload(folder: Path) -> None:
    rig = rig_of(folder, gravity=GROUND.tolist(), **QUIET)
    run = simulate_arm(rig, still([0.3, -0.4, 0.1, 0.7]))
    force, moment = run.log.raw[:, :3], run.log.raw[:, 3:]
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), BODY.mass * np.linalg.norm(GROUND), rtol=1e-9)
    np.testing.assert_allclose(moment, np.cross(BODY.center_of_mass, force), atol=1e-8)
    np.testing.assert_allclose(force, BODY.mass * run.moved.joints.reading.gravity, atol=1e-8)


def test_an_arm_at_rest_on_orbit_feels_nothing(folder: Path) -> None:
    run = simulate_arm(rig_of(folder, **QUIET), still([0.3, -0.4, 0.1, 0.7]))
    assert np.abs(run.log.raw).max() < 1e-9


def recorded(rig: Rig, run: ArmRun) -> tuple[Log, Truth]:
    """The log of another rig on the same movement."""
    name, truth = begin(rig, None, None)
    return record(rig, name, truth, run.moved), truth


def test_sensor_on_payload_reads_the_opposite(folder: Path, quiet: ArmRun) -> None:
    rig = rig_of(folder, **QUIET | {"sensor": QUIET["sensor"] | {"feels": "sensor_on_payload"}})
    np.testing.assert_allclose(recorded(rig, quiet)[0].raw, -quiet.log.raw, atol=1e-9)


def test_servos_follow_the_plan_closely_but_not_exactly(quiet: ArmRun) -> None:
    planned = quiet.trajectory.velocity(quiet.moved.stamps.motion)
    error = np.abs(quiet.moved.joints.velocity - planned).max(axis=0) / np.abs(planned).max(axis=0)
    assert np.all(error > 1e-3)
    assert np.all(error < 0.1)
    position = quiet.trajectory.position(quiet.moved.stamps.motion)
    assert np.abs(quiet.moved.joints.position - position).max() < 0.05


def test_streams_keep_their_own_rates_and_share_one_table(folder: Path) -> None:
    log = simulate_arm(rig_of(folder, simulate={"rate": 100, "sensor_rate": 250})).log
    assert log.velocity is not None
    assert log.position is not None
    moving, sensing = np.isfinite(log.velocity[:, 0]), np.isfinite(log.raw[:, 0])
    np.testing.assert_array_equal(log.time_ns[moving], 10_000_000 * np.arange(400))
    np.testing.assert_array_equal(log.time_ns[sensing], 4_000_000 * np.arange(1000))
    np.testing.assert_array_equal(moving, np.isfinite(log.position).all(axis=1))
    assert log.time_ns.size == 400 + 1000 - 200  # every 20 ms they meet


def test_noise_is_as_large_as_the_rig_states(folder: Path, quiet: ArmRun) -> None:
    (log, _), moved = recorded(rig_of(folder), quiet), quiet.moved
    for values, true, sigma in (
        (log.raw, moved.wrench, SETTINGS["sensor"]["noise"]),
        (log.velocity, moved.joints.velocity, SETTINGS["motion"]["noise"]),
        (log.position, moved.joints.position, SETTINGS["motion"]["position_noise"]),
    ):
        assert values is not None
        deviates = (values - true) / np.array(sigma)
        assert np.all(np.abs(deviates.std(axis=0) - 1.0) < 5.0 / np.sqrt(2.0 * len(deviates)))
        assert np.abs(np.corrcoef(deviates.T) - np.eye(deviates.shape[1])).max() < 5.0 / np.sqrt(
            len(deviates)
        )


def test_seeds_decide_everything_that_is_drawn(folder: Path) -> None:
    rig = rig_of(
        folder, simulate={"payload": "random", "time_offset": "random", "seed": 5}, plan={"duration": 1}
    )
    one, again, other = simulate_arm(rig), simulate_arm(rig, seed=5), simulate_arm(rig, seed=6)
    np.testing.assert_array_equal(one.log.raw, again.log.raw)
    np.testing.assert_array_equal(one.log.velocity, again.log.velocity)
    assert one.truth.to_mapping() == again.truth.to_mapping()
    assert one.truth.time_offset != other.truth.time_offset
    assert one.truth.payloads["default"].mass != other.truth.payloads["default"].mass
    assert not np.array_equal(one.log.raw[:50], other.log.raw[:50])


def test_a_drawn_payload_is_the_one_that_the_arm_carries(folder: Path) -> None:
    rig = rig_of(
        folder, gravity=GROUND.tolist(), **QUIET | {"simulate": {"payload": "random", "gain": "nominal"}}
    )
    run = simulate_arm(rig, still([0.0] * 4))
    body = run.truth.payloads["default"]
    assert body.mass != BODY.mass
    weight = np.linalg.norm((run.log.raw - run.truth.offset)[:, :3], axis=1)
    np.testing.assert_allclose(weight, body.mass * np.linalg.norm(GROUND), rtol=1e-9)


@pytest.mark.parametrize("time_offset", [0.02, -0.02])
def test_sensor_sample_shows_the_motion_at_its_stamp_plus_the_time_offset(
    folder: Path, quiet: ArmRun, time_offset: float
) -> None:
    changes = QUIET | {"simulate": SETTINGS["simulate"] | {"time_offset": time_offset}}
    log = simulate_arm(rig_of(folder, gravity=GROUND.tolist(), **changes)).log
    sampled = np.isfinite(log.raw).all(axis=1)
    late = make_interp_spline(log.time[sampled], log.raw[sampled], k=5)
    lags = np.linspace(-0.04, 0.04, 81)
    inner = (quiet.log.time > 0.2) & (quiet.log.time < 3.8)
    stamps, true = quiet.log.time[inner], quiet.log.raw[inner]
    # the sample that shows time t is stamped t - time_offset
    likeness = [float(np.sum((late(stamps - lag) - true) ** 2)) for lag in lags]
    assert lags[int(np.argmin(likeness))] == pytest.approx(time_offset, abs=1e-9)


def test_gain_and_offset_make_the_raw_channels(folder: Path, quiet: ArmRun) -> None:
    gain = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) + 0.1
    offset = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    log, truth = recorded(
        rig_of(folder, **QUIET | {"simulate": {"gain": gain.tolist(), "offset": offset}}), quiet
    )
    np.testing.assert_allclose(log.raw, quiet.log.raw @ gain.T + offset, atol=1e-8)
    np.testing.assert_array_equal(truth.gain, gain)


def test_written_log_is_read_back_with_its_truth(folder: Path, tmp_path: Path) -> None:
    rig = rig_of(folder, simulate={"rate": 50, "sensor_rate": 100}, plan={"duration": 1})
    run = simulate_arm(rig)
    log_path, truth_path = run.write(tmp_path / "run.csv")
    header, first, second = log_path.read_text().splitlines()[:3]
    assert header == ",".join(
        [
            "time_ns",
            *(f"raw_{i}" for i in range(6)),
            *(f"q_{j}" for j in JOINTS),
            *(f"dq_{j}" for j in JOINTS),
        ]
    )
    assert "," * 8 in second
    assert "," * 8 not in first
    log = read_log(log_path, rig)
    for name in ("time_ns", "raw", "position", "velocity"):
        np.testing.assert_array_equal(getattr(log, name), getattr(run.log, name))
    truth = yaml.safe_load(truth_path.read_text())
    assert set(truth) == {"gain", "offset", "time_offset", "payloads", "seed"}
    np.testing.assert_array_equal(truth["gain"], run.truth.gain)


@pytest.mark.parametrize(
    ("motion", "columns"),
    [
        ({"noise": [1e-4] * 4}, {"position", "velocity"}),  # positions are then exact
        ({"noise": [1e-4] * 4, "initial_position": [0.1, 0.2, 0.05, 0.3]}, {"velocity"}),
        ({"position_noise": [1e-5] * 4}, {"position"}),
    ],
)
def test_log_holds_the_streams_that_the_rig_states(
    folder: Path, motion: dict[str, Any], columns: set[str]
) -> None:
    settings = deepcopy(SETTINGS) | {"plan": {"duration": 1}}
    settings["motion"] = {"source": "joints", "robot": SETTINGS["motion"]["robot"]} | motion
    run = simulate_arm(Rig.from_mapping(settings, folder / "rig.yaml"))
    assert {name for name in ("position", "velocity") if getattr(run.log, name) is not None} == columns
    if "position_noise" not in motion and "position" in columns:
        np.testing.assert_array_equal(run.log.position, run.moved.joints.position)
    if "initial_position" in motion:
        np.testing.assert_allclose(
            run.trajectory.position(np.zeros(1))[0], motion["initial_position"], atol=1e-9
        )


def test_default_motion_rests_at_both_ends_within_all_limits(folder: Path) -> None:
    limits = {"velocity": [0.3] * 4, "acceleration": [0.6] * 4, "jerk": [3.0] * 4}
    limits |= {"position": [0.5, 0.5, 0.1, 0.5], "wrench_fraction": 0.01}
    rig = rig_of(folder, limits=limits, plan={"duration": 8}, **QUIET)
    run = simulate_arm(rig)
    time = np.linspace(0, 8, 4001)
    plan = run.trajectory
    assert np.all(np.abs(plan.position(time)) <= limits["position"])
    assert np.all(np.abs(plan.velocity(time)) <= 0.3)
    assert np.all(np.abs(plan.acceleration(time)) <= 0.6)
    assert np.abs(np.diff(plan.acceleration(time), axis=0)).max() / (time[1] - time[0]) <= 3.0
    ends = np.array([0.0, 8.0])
    assert np.abs(plan.velocity(ends)).max() < 1e-6
    assert np.abs(plan.acceleration(ends)).max() < 1e-4
    share = np.abs(run.log.raw).max(axis=0) / rig.sensor.range_array
    assert 0.009 < share.max() < 0.0105  # the servos may overshoot


def test_default_motion_keeps_sensor_and_payload_inside_the_workspace(folder: Path) -> None:
    free = simulate_arm(rig_of(folder, **QUIET)).moved.joints.reading
    middle = free.p_root_sensor[0] + 0.5 * free.R_root_sensor[0] @ BODY.center_of_mass
    box = np.column_stack([middle - 0.12, middle + 0.12])
    rig = rig_of(folder, limits={"workspace": box.tolist()}, **QUIET)
    held = simulate_arm(rig).moved.joints.reading
    assert np.any(free.p_root_sensor < box[:, 0]) or np.any(free.p_root_sensor > box[:, 1])
    for point in (held.p_root_sensor, held.p_root_sensor + held.R_root_sensor @ BODY.center_of_mass):
        assert np.all(point > box[:, 0] - 1e-3)  # the servos may overshoot
        assert np.all(point < box[:, 1] + 1e-3)
        assert np.ptp(point, axis=0).max() > 0.05


def test_a_flat_payload_at_any_angle_can_be_carried(folder: Path) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        inertia = turn @ np.diag([0.01, 0.02, 0.03]) @ turn.T
        body = Body(1.0, np.zeros(3), 0.5 * (inertia + inertia.T))
        found = arm(folder, body).ideal(np.zeros((1, 4)), np.ones((1, 4)), np.ones((1, 4)))
        expected = Oracle(folder, body, GROUND).reading(np.zeros((1, 4)), np.ones((1, 4)), np.ones((1, 4)))
        np.testing.assert_allclose(found.wrench, expected.wrench, atol=1e-12)


def test_plans_beyond_the_robot_are_refused(folder: Path) -> None:
    with pytest.raises(InputError, match=r"joint `slide`.*0\.9.*limits"):
        simulate_arm(rig_of(folder), still([0.0, 9.0, 0.9, 0.0]))  # the elbow has no limits
    with pytest.raises(InputError, match="3 joints"):
        simulate_arm(rig_of(folder), still([0.0, 0.0, 0.0]))
    only_velocities = {"initial_position": [0, 0.2, 0, 0], "position_noise": None}
    with pytest.raises(InputError, match=r"initial_position\[1\]"):
        simulate_arm(rig_of(folder, motion=only_velocities), still([0.0] * 4))


def test_rigs_that_cannot_be_simulated_are_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="hammer"):
        simulate_arm(rig_of(folder), payload="hammer")
    with pytest.raises(UnsupportedError, match="lowpass_hz"):
        simulate_arm(rig_of(folder, sensor={"lowpass_hz": 100}))
    with pytest.raises(InputError, match="workspace"):
        simulate_arm(rig_of(folder, limits={"workspace": [[5, 6]] * 3}))
    with pytest.raises(InputError, match="wrench_fraction"):
        simulate_arm(rig_of(folder, gravity=[0, 0, -9.81], limits={"wrench_fraction": 0.05}))


def test_command_simulates_arms_with_and_without_a_plan(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    settings = deepcopy(SETTINGS) | {"plan": {"duration": 1}}
    settings["motion"]["robot"]["urdf"] = str(folder / "four.urdf")
    rig.write_text(yaml.safe_dump(settings))
    plan = tmp_path / "plan.csv"
    time = np.linspace(0, 1, 41)
    rows = np.column_stack([time, np.tile(0.1 * np.sin(np.pi * time)[:, None] ** 4, (1, 4))])
    header = ",".join(["time_s", *(f"q_{name}" for name in JOINTS)])
    np.savetxt(plan, rows, delimiter=",", header=header, comments="")
    for arguments in ([], [str(plan)]):
        log = tmp_path / "run.csv"
        status = main(["simulate", str(rig), *arguments, "-o", str(log), "--json"])
        assert status == 0
        said = json.loads(capsys.readouterr().out)
        assert said["outputs"] == [str(log), f"{log}.truth.yaml"]
        assert said["figures"]["newton_euler_disagreement"] < 1e-6
    planned = np.interp(read_log(log, load_rig(rig)).time, time, rows[:, 1])
    np.testing.assert_allclose(read_log(log, load_rig(rig)).position[:, 2], planned, atol=5e-3)
