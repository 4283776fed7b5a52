"""Logs of joints as the new estimator reads them; Pinocchio and simulated arms with truth judge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from record_cases import HONEST, Array, RigOf, arm_with, base_log, estimate, nees
from scipy.spatial.transform import Rotation

import truewrench as tw
from truewrench.estimation.assumptions import FIRST_POSITION_NOISE, Assumptions
from truewrench.estimation.record import recorded, recorded_logs
from truewrench.model.log import Log
from truewrench.robot.arm import BaseMotion, Robot, robot_of
from truewrench.robot.base_path import BasePath
from truewrench.robot.chain import chain_of, sensor_motion
from truewrench.robot.parts import unwrapped
from truewrench.simulation.arm import simulate_arm
from truewrench.simulation.free_body import wrench_on_sensor
from truewrench.simulation.truth import Truth, stated


def states(robot: Robot, rows: int, seed: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.normal(size=(3, rows, robot.n))
    return q, qd, qdd


def base_of(rows: int, moves: bool) -> BaseMotion | None:
    rng = np.random.default_rng(7)
    return BaseMotion(*rng.normal(size=(2, rows, 6))) if moves else None


def root_of(base: BaseMotion | None) -> tuple[Array, Array, Array]:
    """What a chain takes of its root."""
    if base is None:
        return np.empty((0, 6)), np.empty((0, 6)), np.empty((0, 9))
    return base.twist, base.acceleration, np.empty((0, 9))


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("arm", ["panda_ground", "ssrms"])
def test_chain_moves_the_sensor_as_pinocchio_does(arm_rig: RigOf, arm: str, moves: bool) -> None:
    robot = robot_of(arm_rig(arm))
    q, qd, qdd = states(robot, 1500, 0)
    base = base_of(1500, moves)
    pinocchio = robot.motion(q, qd, qdd, base)
    nu, a, R_sensor_root, _ = chain_of(robot).motion(q, qd, qdd, *root_of(base))
    size = np.abs(pinocchio.acceleration).max()
    np.testing.assert_allclose(nu, pinocchio.twist, atol=1e-13 * size)
    np.testing.assert_allclose(a, pinocchio.acceleration, atol=1e-13 * size)
    expected = pinocchio.R_root_sensor.transpose(0, 2, 1).reshape(-1, 9)
    np.testing.assert_allclose(R_sensor_root, expected, atol=1e-14)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("arm", ["panda_ground", "ssrms"])
def test_jacobian_is_what_differences_of_pinocchios_motion_are(arm_rig: RigOf, arm: str, moves: bool) -> None:
    robot = robot_of(arm_rig(arm))
    state, base = states(robot, 5, 1), base_of(5, moves)
    jacobian = chain_of(robot).motion(*state, *root_of(base))[3].reshape(5, 12, -1)
    step = 1e-6

    def moved(order: int, joint: int, by: float) -> Array:
        shifted = [x.copy() for x in state]
        shifted[order][:, joint] += by
        motion = robot.motion(*shifted, base)
        return np.column_stack([motion.twist, motion.acceleration])

    for order in range(3):
        for joint in range(robot.n):
            slope = (moved(order, joint, step) - moved(order, joint, -step)) / (2.0 * step)
            column = jacobian[:, :, order * robot.n + joint]
            np.testing.assert_allclose(column, slope, atol=1e-8 * np.abs(jacobian).max())


def test_what_carries_the_arm_turns_its_attitude(arm_rig: RigOf) -> None:
    rig = arm_rig("panda_ground")
    robot = robot_of(rig)
    time = np.arange(0.0, 2.0, 0.01)
    at, (q, qd, qdd) = np.array([0.512, 1.3]), states(robot, 2, 3)
    path = BasePath.of(rig, base_log(rig, time, robot.n))
    nu, a, R_sensor_inertial, _ = chain_of(robot).motion(q, qd, qdd, *path.carried(at))
    base = BaseMotion(
        np.column_stack([0.3 * np.cos(0.9 * at + k) for k in range(6)]),
        np.column_stack([-0.27 * np.sin(0.9 * at + k) for k in range(6)]),
    )
    pinocchio = robot.motion(q, qd, qdd, base)
    np.testing.assert_allclose(nu, pinocchio.twist, atol=1e-7)
    np.testing.assert_allclose(a, pinocchio.acceleration, atol=1e-5)
    turn = Rotation.from_euler("xyz", np.column_stack([0.4 * np.sin(0.5 * at + k) for k in range(3)]))
    expected = (turn.as_matrix() @ pinocchio.R_root_sensor).transpose(0, 2, 1)
    np.testing.assert_allclose(R_sensor_inertial.reshape(-1, 3, 3), expected, atol=1e-8)


@pytest.mark.parametrize("arm", ["panda_ground", "ssrms"])
def test_jacobian_and_its_rate_are_pinocchios(arm_rig: RigOf, arm: str) -> None:
    rig = arm_rig(arm)
    robot = robot_of(rig)
    q, qd, _ = states(robot, 5000, 4)  # more than are done at once
    log = Log(None, "default", "", np.arange(5000), np.zeros((5000, 6)), position=q)
    rest = BasePath.of(rig, log)
    assert rest.rests
    found = sensor_motion(chain_of(robot), rest, log.time, q, qd)
    np.testing.assert_allclose(found.jacobian, robot.jacobian(q), atol=1e-12)
    data, rate = robot.model.createData(), np.empty((5000, 6, robot.n))
    for k in range(5000):
        pin.computeJointJacobiansTimeVariation(robot.model, data, q[k], qd[k])
        rate[k] = pin.getFrameJacobianTimeVariation(robot.model, data, robot.frame_id, pin.LOCAL)
    np.testing.assert_allclose(found.jacobian_rate, rate, atol=1e-12 * np.abs(rate).max())


def test_chain_refuses_what_does_not_fit_together(arm_rig: RigOf) -> None:
    robot = robot_of(arm_rig("panda"))
    chain, full, rest = chain_of(robot), np.zeros((4, robot.n)), root_of(None)
    still, turn = np.zeros((4, 6)), np.empty((0, 9))
    for joints, root in (
        ([full[:, 1:]] * 3, rest),
        ([full, full, full[1:]], rest),
        ([full] * 3, (still, still[:0], turn)),  # no derivative
        ([full] * 3, (still[1:], still[1:], turn)),
        ([full] * 3, (still[:, 1:], still[:, 1:], turn)),
        ([full] * 3, (still, still, np.zeros((4, 6)))),
    ):
        with pytest.raises(ValueError, match=r"joints \(K, M\), or what carries them: array lengths"):
            chain.motion(*joints, *root)
    assert chain.motion(*[full] * 3, still, still, np.zeros((4, 9)))[0].shape == (4, 6)


@pytest.mark.parametrize(("arm", "without"), [("panda_ground", None), ("panda", "noise"), ("ssrms", None)])
def test_joint_log_gives_the_gain_within_its_sigma(arm_rig: RigOf, arm: str, without: str | None) -> None:
    rig = arm_with(arm_rig, arm, **({without: None} if without else {}))
    run = simulate_arm(rig, seed=2)
    found = estimate(rig, run.log)
    assert nees(found, rig, run.truth) < HONEST
    for factor in found.fit.sizes(0).motion_factor:
        np.testing.assert_allclose(factor, 1.0, atol=0.05)


def test_positions_without_a_stated_noise_begin_at_a_microradian(arm_rig: RigOf) -> None:
    rig = arm_with(arm_rig, "panda", position_noise=None, initial_position=None)
    log = simulate_arm(rig, seed=2).log
    _, _, (streams,) = recorded_logs(rig, [log])
    np.testing.assert_array_equal(np.ravel(streams.motion[0].sigma), FIRST_POSITION_NOISE)
    assert [m.derivative for m in streams.motion] == [0, 1]


def test_velocities_alone_go_on_from_a_known_start_until_a_gap(arm_rig: RigOf) -> None:
    rig = arm_with(arm_rig, "panda", position_noise=None)
    log = simulate_arm(arm_with(arm_rig, "panda"), seed=2).log
    assert log.velocity is not None
    velocity = log.velocity.copy()
    velocity[500:560] = np.nan
    alone = replace(log, position=None, velocity=velocity, tracking=None)
    notes: list[str] = []
    streams = recorded(rig, Assumptions.of(rig, [alone]), alone, notes=notes)
    rates, start = streams.motion
    assert (start.derivative, rates.derivative) == (0, 1)
    np.testing.assert_array_equal(start.value, [rig.motion.initial_position])
    assert rates.time[-1] < log.time[500]
    np.testing.assert_array_equal(np.ravel(start.sigma), FIRST_POSITION_NOISE)
    (note,) = notes
    assert "rows of dq_* left out: after a gap nothing tells the joints' positions" in note


def test_the_time_offset_of_velocities_alone_is_theirs(arm_rig: RigOf) -> None:
    """Where they start no clock stamped: taken for one it was 0 +- 5, 56 +- 5 or 82 +- 91 ms of nothing."""
    rig = arm_with(arm_rig, "panda", position_noise=None)
    for seed in range(3):
        run = simulate_arm(arm_with(arm_rig, "panda"), seed=seed)
        alone = replace(run.log, position=None, tracking=None)
        found = tw.calibrate(rig, alone, held_out=False)
        assert found.time_offset_std < 1e-3
        assert found.time_offset == pytest.approx(run.truth.time_offset, abs=4.0 * found.time_offset_std)
        assert not [assumed for assumed in found.assumed if "positions" in assumed.what]


def test_position_begins_anew_where_the_sensor_was_silent(arm_rig: RigOf) -> None:
    rig = arm_with(arm_rig, "panda", position_noise=None)
    log = simulate_arm(arm_with(arm_rig, "panda"), seed=2).log
    assert log.position is not None
    raw = log.raw.copy()
    raw[:200], raw[400:450] = np.nan, np.nan
    alone = replace(log, raw=raw, position=None, tracking=None)
    _, _, (streams,) = recorded_logs(rig, [alone])
    _, *starts = streams.motion
    assert len(starts) == 2
    period, sigma = 0.01, rig.motion.noise_array
    for start in starts:
        row = int(np.searchsorted(log.time, start.time[0]))
        assert np.isfinite(raw[row]).all()
        walked = sigma * np.sqrt(period * (log.time[row] - log.time[0]))
        np.testing.assert_allclose(np.ravel(start.sigma), walked, rtol=1e-3)
        np.testing.assert_array_less(np.abs(start.value[0] - log.position[row]), 5.0 * walked)


def test_velocities_alone_give_the_gain_within_its_sigma(arm_rig: RigOf) -> None:
    rig = arm_with(arm_rig, "panda_ground", position_noise=None)
    run = simulate_arm(rig, seed=2)
    assert nees(estimate(rig, run.log), rig, run.truth) < HONEST


@pytest.mark.parametrize("late", [0.0, 0.01])
def test_arm_on_a_moving_base_gives_the_gain_within_its_sigma(arm_rig: RigOf, late: float) -> None:
    rig = arm_with(arm_rig, "panda_ground")
    robot = robot_of(rig)
    stamps = np.arange(0.0, 8.0, 0.01)
    time = stamps + late  # of joints and base, when the sensor reads what it stamps so
    start = np.array([0, -0.785, 0, -2.356, 0, 1.571, 0.785])
    hz = np.array([0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.1])
    w = 2.0 * np.pi * hz
    phase = np.outer(time, w) + np.arange(7)
    q, qd, qdd = start + 0.3 * np.sin(phase), 0.3 * w * np.cos(phase), -0.3 * w**2 * np.sin(phase)
    base = base_log(rig, time, robot.n, hurry=3.0)
    rate = np.column_stack([-0.81 * np.sin(2.7 * time + k) for k in range(6)])
    assert base.base_twist is not None
    assert base.base_attitude is not None
    motion = robot.motion(q, qd, qdd, BaseMotion(base.base_twist, rate))
    turn = Rotation.from_quat(base.base_attitude[:, [1, 2, 3, 0]]).as_matrix() @ motion.R_root_sensor
    fall = np.einsum("kji,j->ki", turn, rig.gravity_array)
    truth = stated(rig.payloads["default"])
    wrench = wrench_on_sensor(truth, np.zeros(3), motion.twist, motion.acceleration, fall)
    rng = np.random.default_rng(4)
    gain = (
        np.eye(6)
        + 0.1 * rng.standard_normal((6, 6)) * rig.sensor.range_array[:, None] / rig.sensor.range_array
    )
    assert rig.motion.position_noise is not None
    q, qd = start + 0.3 * np.sin(phase - w * late), 0.3 * w * np.cos(phase - w * late)
    log = replace(
        base_log(rig, stamps, robot.n, hurry=3.0),
        raw=wrench @ gain.T + rig.sensor.noise_array * rng.standard_normal((time.size, 6)),
        position=q + np.array(rig.motion.position_noise) * rng.standard_normal(q.shape),
        velocity=qd + rig.motion.noise_array * rng.standard_normal(q.shape),
    )
    found = estimate(rig, log)
    assert nees(found, rig, Truth(gain, np.zeros(6), 0.0, {}, 0)) < HONEST
    # 0.0072 on one clock; a base at another time than its joints takes the motion for rougher: 0.0144
    assert np.sqrt(np.mean(np.diag(found.gain_covariance))) < 0.008


def test_samples_while_the_base_is_not_known_are_left_out(arm_rig: RigOf) -> None:
    rig = arm_with(arm_rig, "panda_ground")
    log = base_log(rig, np.arange(0.0, 2.0, 0.01), 7)
    assert log.base_twist is not None
    log.base_twist[:20], log.base_twist[100:130] = np.nan, np.nan
    notes: list[str] = []
    recorded(rig, Assumptions.of(rig, [log]), log, notes=notes)
    assert notes == ["50 samples of the sensor left out: the motion of the base is not known then"]


def test_a_joint_that_went_on_in_a_pause_is_where_it_is_logged(arm_rig: RigOf) -> None:
    rig = arm_with(arm_rig, "panda_ground", position_noise=[1e-5] * 7)
    log = simulate_arm(rig).log
    assert log.position is not None
    rows = np.arange(0, 400, 50)
    away = np.where(np.arange(rows.size) % 2 == 0, -1.9, 1.9)  # each time by more than half a turn
    position = log.position[rows].copy()
    position[:, 6] = away
    poses = replace(
        log,
        time_ns=5_000_000_000 * np.arange(rows.size),
        raw=log.raw[rows],
        position=position,
        velocity=np.zeros_like(position),
    )
    again = unwrapped(rig, poses)
    assert again.position is not None
    np.testing.assert_array_equal(again.position[:, 6], away)


@pytest.mark.parametrize("estimator", ["map", "online", "ekf"])
def test_angles_logged_within_one_turn_are_the_same_record(arm_rig: RigOf, estimator: Any) -> None:
    rig = arm_with(arm_rig, "panda_ground", position_noise=[1e-5] * 7)
    log = simulate_arm(rig).log
    assert log.position is not None
    wrapped = log.position.copy()
    for k in (0, 6):  # the cut where the joint passes it, not at 180 deg, is as good
        known = np.isfinite(wrapped[:, k])
        cut = np.median(wrapped[known, k])
        wrapped[known & (wrapped[:, k] > cut), k] -= 2.0 * np.pi
    plain, again = (
        tw.calibrate(rig, one, estimator, held_out=False) for one in (log, replace(log, position=wrapped))
    )
    # the same posture to rounding; whole turns are one thing apart from it
    np.testing.assert_allclose(again.gain, plain.gain, atol=1e-6 * np.abs(plain.gain).max())
    if estimator != "ekf":
        assert any("within one turn" in note for note in again.figures["notes"])
        assert not any("within one turn" in note for note in plain.figures["notes"])
