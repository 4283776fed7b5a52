"""Calibrations of arms are as good as the bound and as honest as they say, whatever joints log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.estimate.windows import estimate_windows

import truewrench as tw
from truewrench.arm.robot import robot_of
from truewrench.arm.track import tracked
from truewrench.calibration import Calibration
from truewrench.cli import main
from truewrench.errors import InputError, UnsupportedError
from truewrench.estimation.bound import bound
from truewrench.log import Log
from truewrench.motion.trajectory_joint import SplineJoints
from truewrench.rig import Rig
from truewrench.simulation.arm.drive import Driven
from truewrench.simulation.arm.motion import default_motion
from truewrench.simulation.arm.run import Moved, arm_with, move, record
from truewrench.simulation.truth import Truth, begin, stamps_of, stated, write_run
from truewrench.split import rows_of
from truewrench.validation import validate

Array = np.ndarray[Any, np.dtype[np.float64]]
RigOf = Callable[..., Rig]

GOOD = {"noise": [0.005, 0.005, 0.01, 3e-4, 3e-4, 3e-4]}  # of the sensor: then the motion decides
PANDA: dict[str, Any] = {"plan": {"duration": 8}, "simulate": {"rate": 100, "sensor_rate": 100}}


@dataclass(frozen=True, eq=False)
class Scene:
    """An arm and what MuJoCo says of a motion of it, to be recorded with any gain and noise."""

    rig: Rig
    motion: SplineJoints
    moved: Moved

    def log(self, seed: int, rig: Rig | None = None) -> tuple[Log, Truth]:
        """A log, recorded as a rig says, which may state another noise later."""
        rig = rig or self.rig
        payload, truth = begin(rig, None, seed)
        return record(rig, payload, truth, self.moved), truth


def states_of(motion: SplineJoints, time: Array) -> tuple[Array, Array, Array]:
    return motion.position(time), motion.velocity(time), motion.acceleration(time)


def scene_of(rig: Rig, driven: bool = False) -> Scene:
    """On the default motion, exactly or as servos follow it."""
    robot, (payload, spec) = robot_of(rig), next(iter(rig.payloads.items()))
    arm = arm_with(rig, robot, stated(spec))
    motion = default_motion(rig, robot, {payload: arm})
    delay = float(rig.simulate.time_offset)
    if driven:
        return Scene(rig, motion, move(rig, robot, motion, stated(spec), delay))
    stamps = stamps_of(rig, motion.duration, delay)
    state = [states_of(motion, time) for time in (stamps.motion, stamps.shown)]
    q, qd, _ = state[0]
    joints = Driven(q, qd, np.zeros_like(q), arm.ideal(*state[0]))
    return Scene(rig, motion, Moved(stamps, joints, arm.ideal(*state[1]).wrench, 0.0))


@pytest.fixture(scope="module")
def scene(arm_rig: RigOf) -> Callable[..., Scene]:
    """The ground arm of 7 joints on an exact motion."""

    @cache
    def of(rates: tuple[float, float] = (100, 100), delay: float = 0.0, duration: float = 8.0) -> Scene:
        simulate = {"rate": rates[0], "sensor_rate": rates[1], "time_offset": delay}
        return scene_of(arm_rig("panda_ground", plan={"duration": duration}, simulate=simulate))

    return of


def normalised(rig: Rig, gain: Array) -> Array:
    return np.asarray(gain * rig.sensor.range_array / rig.sensor.channel_scale[:, None]).ravel()


def score(rig: Rig, estimate: WindowEstimate, truth: Truth) -> tuple[float, float]:
    """Mean square of the errors of the normalised gains, and NEES per gain."""
    error = normalised(rig, estimate.gain - truth.gain)
    covariance = estimate.normalised_covariance[:36, :36]
    return float(np.mean(error**2)), float(error @ np.linalg.solve(covariance, error) / 36.0)


def assert_honest(scores: Sequence[float]) -> None:
    """Mean NEES per gain within the 99.8% interval of chi-square, widened by 0.05."""
    freedom = 36 * len(scores)
    low, high = chi2.ppf([0.001, 0.999], freedom) / freedom
    assert low - 0.05 < np.mean(scores) < high + 0.05
    assert max(scores) < chi2.isf(1e-6, 36) / 36


ARMS = {
    "panda_ground": {"plan": {"duration": 8}, "simulate": {"rate": 100, "sensor_rate": 160}},
    "ssrms": {"plan": {"duration": 30}, "simulate": {"rate": 20, "sensor_rate": 50}},
}


@pytest.mark.parametrize("name", ARMS)
def test_arm_gives_an_honest_gain_near_the_bound(arm_rig: RigOf, name: str) -> None:
    scene = scene_of(arm_rig(name, **ARMS[name]), driven=name == "panda_ground")
    squares, scores, limits = [], [], []
    for seed in range(6):
        log, truth = scene.log(seed)
        estimate = estimate_windows(scene.rig, [log])
        assert estimate.converged
        square, nees = score(scene.rig, estimate, truth)
        squares.append(square)
        scores.append(nees)
        limits.append(bound(scene.rig, [log], truth.gain).rms)
    assert_honest(scores)
    assert 0.75 < np.sqrt(np.mean(squares) / np.mean(np.square(limits))) < 1.15
    stated = np.sqrt(np.mean(np.diag(estimate.normalised_covariance)[:36]))
    assert stated == pytest.approx(limits[-1], rel=0.1)


def test_parts_of_an_arm_with_times_of_their_own_give_an_honest_gain(scene: Callable[..., Scene]) -> None:
    recorded = scene((200, 100))
    scores, squares, limits = [], [], []
    for seed in range(6):
        log, truth = recorded.log(seed)
        assert log.position is not None
        assert log.velocity is not None
        turn = np.cumsum(np.isfinite(log.position).all(axis=1)) % 2 == 0
        apart = np.where(turn[:, None], [True] * 4 + [False] * 3, [False] * 4 + [True] * 3)
        position, velocity = (np.where(apart, x, np.nan) for x in (log.position, log.velocity))
        split = tracked(recorded.rig, [replace(log, position=position, velocity=velocity, tracking=None)])
        estimate = estimate_windows(recorded.rig, split)
        square, nees = score(recorded.rig, estimate, truth)
        squares.append(square)
        scores.append(nees)
        limits.append(bound(recorded.rig, [log], truth.gain).rms)
    assert max(scores) < chi2.isf(1e-6, 36) / 36
    assert 0.7 < np.mean(scores) < 1.2
    # half of the samples of every joint: no worse than twice the variance
    assert np.sqrt(np.mean(squares) / np.mean(np.square(limits))) < 1.15 * np.sqrt(2.0)


LOGGED: dict[str, dict[str, Any]] = {
    "positions alone": {"noise": None},
    "velocities alone": {"position_noise": None},
    "exact positions": {"position_noise": None, "initial_position": None},
    "poor encoders": {"position_noise": [1e-3] * 7},
    "good tachometers": {"position_noise": [2e-4] * 7, "noise": [2e-5] * 7},
}


@pytest.mark.parametrize("logged", LOGGED)
def test_gain_is_honest_whatever_is_logged_of_the_joints(
    arm_rig: RigOf, scene: Callable[..., Scene], logged: str
) -> None:
    motion = dict(LOGGED[logged])
    if logged == "velocities alone":
        motion["initial_position"] = scene().motion.position(np.zeros(1))[0].tolist()
    rig = arm_rig("panda_ground", motion=motion, **PANDA)
    scores, squares = [], []
    for seed in range(4):
        log, truth = scene().log(seed, rig)
        estimate = estimate_windows(rig, [log])
        square, nees = score(rig, estimate, truth)
        squares.append(square)
        scores.append(nees)
    assert_honest(scores)
    limit = bound(rig, [log], truth.gain).rms
    assert 0.65 < np.sqrt(np.mean(squares)) / limit < 1.35
    assert tw.calibrate(rig, log, held_out=False).verdict.usable


def test_better_sensors_of_the_motion_make_a_better_gain(arm_rig: RigOf, scene: Callable[..., Scene]) -> None:
    found = []
    for motion in ({"position_noise": [1e-3] * 7}, {"noise": None}, {"noise": [5e-5] * 7}):
        rig = arm_rig("panda_ground", sensor=GOOD, motion=motion, **PANDA)
        log, _ = scene().log(0, rig)
        estimate = estimate_windows(rig, [log])
        found.append(np.sqrt(np.mean(np.diag(estimate.normalised_covariance)[:36])))
    assert found[0] > 1.3 * found[1]
    assert found[1] > 1.01 * found[2]


def test_log_made_in_python_is_followed_when_it_is_calibrated_from(scene: Callable[..., Scene]) -> None:
    rig = scene().rig
    log, _ = scene().log(0)
    bare = replace(log, tracking=None, twist=None, gravity=None)
    expected, found = (tw.calibrate(rig, x, held_out=False) for x in (log, bare))
    np.testing.assert_array_equal(found.gain, expected.gain)
    np.testing.assert_array_equal(found.covariance, expected.covariance)
    one, two = (validate(expected, rig, x) for x in (log, bare))
    assert one.axes == two.axes


def test_clock_between_joints_and_sensor_is_found(arm_rig: RigOf, scene: Callable[..., Scene]) -> None:
    late = scene((100, 160), 3e-3)
    rig = arm_rig("panda_ground", sensor={"time_offset_prior": 5e-3}, **PANDA)
    scores, clocks = [], []
    for seed in range(4):
        log, truth = late.log(seed, rig.model_copy(update={"simulate": late.rig.simulate}))
        assert truth.time_offset == 3e-3
        estimate = estimate_windows(rig, [log])
        scores.append(score(rig, estimate, truth)[1])
        clocks.append((estimate.time_offsets[0] - 3e-3) / estimate.time_offsets_std[0])
        assert estimate.time_offsets_std[0] < 2e-3
    assert_honest(scores)
    assert np.mean(np.square(clocks)) < 4.0


def test_no_window_spans_a_gap_of_the_joints(scene: Callable[..., Scene]) -> None:
    rig, scores = scene().rig, []
    for seed in range(4):
        log, truth = scene().log(seed)
        gap = (log.time > 3.0) & (log.time < 3.8)
        assert log.position is not None
        assert log.velocity is not None
        holed = replace(
            log,
            position=np.where(gap[:, None], np.nan, log.position),
            velocity=np.where(gap[:, None], np.nan, log.velocity),
            tracking=None,
            twist=None,
            gravity=None,
        )
        estimate = estimate_windows(rig, tracked_logs(rig, holed))
        assert all(w.end <= 3.0 + 1e-6 or w.begin >= 3.8 - 1e-6 for w in estimate.windows)
        scores.append(score(rig, estimate, truth)[1])
    assert_honest(scores)


def tracked_logs(rig: Rig, *logs: Log) -> list[Log]:
    return tracked(rig, logs)


def test_parts_of_a_joint_log_calibrate_like_the_whole(scene: Callable[..., Scene]) -> None:
    rig = scene().rig
    log, truth = scene().log(2)
    halves = [rows_of(log, log.time < 4.0), rows_of(log, log.time >= 4.0)]
    whole, parts = (estimate_windows(rig, logs) for logs in ([log], halves))
    assert score(rig, parts, truth)[1] < chi2.isf(1e-4, 36) / 36
    one, two = (np.diag(e.normalised_covariance)[:36] for e in (whole, parts))
    assert np.all(two > 0.99 * one)  # there is a seam, and an offset for each half
    assert np.all(two < 2.0 * one)
    off = normalised(rig, parts.gain - whole.gain)
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.maximum(two - one, 0.01 * one)))


@pytest.mark.parametrize("kind", ["accelerometer", "derivative of the twist"])
def test_accelerations_are_fused_with_joints(arm_rig: RigOf, scene: Callable[..., Scene], kind: str) -> None:
    sigma = [2e-3] * 3 if kind == "accelerometer" else [2e-3] * 3 + [4e-3] * 3
    motion = {"position_noise": [1e-3] * 7, "noise": [5e-3] * 7}
    rig, fused = (
        arm_rig("panda_ground", sensor=GOOD, motion={**motion, **more}, **PANDA)
        for more in ({}, {"acceleration_noise": sigma})
    )
    reading, time = scene().moved.joints.reading, scene().moved.stamps.motion
    true = reading.specific_force
    if kind != "accelerometer":
        true = robot_of(rig).motion(*states_of(scene().motion, time)).acceleration
    scores = []
    for seed in range(2):
        log, truth = scene().log(seed, rig)
        rng = np.random.default_rng([seed, 9])
        measured = true + np.array(sigma) * rng.standard_normal(true.shape)
        log = replace(log, **{"specific_force" if len(sigma) == 3 else "acceleration": measured})
        estimate = estimate_windows(fused, [log])
        scores.append(score(fused, estimate, truth)[1])
    assert_honest(scores)
    without = estimate_windows(rig, [log])
    one, two = (np.sqrt(np.mean(np.diag(e.normalised_covariance)[:36])) for e in (estimate, without))
    assert one < 0.92 * two
    wrong = replace(log, **{"specific_force" if len(sigma) == 3 else "acceleration": 1.05 * measured})
    wrong = rows_of(wrong, wrong.time < 3.0)
    assert not tw.calibrate(fused, wrong, held_out=False).verdict.usable


def test_accelerations_need_to_know_where_the_joints_are(arm_rig: RigOf, scene: Callable[..., Scene]) -> None:
    start = scene().motion.position(np.zeros(1))[0].tolist()
    motion = {"position_noise": None, "initial_position": start, "acceleration_noise": [0.01] * 3}
    rig = arm_rig("panda_ground", motion=motion, **PANDA)
    log, _ = scene().log(0, rig)
    with pytest.raises(UnsupportedError, match=r"acceleration_noise.*velocities alone"):
        estimate_windows(rig, [replace(log, specific_force=np.zeros((len(log.time), 3)))])


@pytest.mark.parametrize(("factor", "word"), [(3.0, "Omega"), (1.0 / 3.0, "noise stated too small")])
def test_misstated_noise_of_the_joints_is_refused_and_found(
    arm_rig: RigOf, scene: Callable[..., Scene], factor: float, word: str
) -> None:
    noise = {"noise": [factor * 1e-3] * 7, "position_noise": [factor * 2e-5] * 7}
    rig = arm_rig("panda_ground", motion=noise, **PANDA)
    log, truth = scene().log(0)
    bare = replace(log, tracking=None, twist=None, gravity=None)
    refused = tw.calibrate(rig, bare, held_out=False)
    assert not refused.verdict.usable
    assert any(word in reason for reason in refused.verdict.reasons)
    found = tw.calibrate(rig, bare, held_out=False, rescale_noise=True)
    assert found.verdict.usable
    noise_found = found.figures["noise"]["joints"]
    assert noise_found["estimated"] == pytest.approx(2e-5, rel=0.1)
    error = normalised(rig, found.gain - truth.gain)
    unit = normalised(rig, np.ones((6, 6)))
    covariance = found.covariance[:36, :36] * np.outer(unit, unit)
    assert error @ np.linalg.solve(covariance, error) / 36 < chi2.isf(1e-4, 36) / 36


def test_base_that_flies_is_calibrated_on(arm_rig: RigOf, scene: Callable[..., Scene]) -> None:
    rig = arm_rig("panda_ground", **PANDA)
    stamps, motion = scene().moved.stamps, scene().motion
    time, robot = stamps.time, robot_of(rig)
    q, qd, qdd = states_of(motion, time)
    axis, angle = np.array([0.48, -0.6, 0.64]), 1.5 * np.sin(0.8 * time)
    turning = 1.2 * np.cos(0.8 * time)[:, None] * axis
    v, dv = (0.2 * f(1.3 * time[:, None] + np.arange(3)) for f in (np.sin, lambda x: 1.3 * np.cos(x)))
    base = np.column_stack([v, turning])
    base_rate = np.column_stack([dv, -0.96 * np.sin(0.8 * time)[:, None] * axis])
    attitude = np.roll(Rotation.from_rotvec(angle[:, None] * axis).as_quat(), 1, axis=1)

    # the free-flying arm, and the wrench of its payload, by Pinocchio
    model = pin.buildModelFromUrdf(str(rig.urdf_path), pin.JointModelFreeFlyer())
    locked = [k for k in range(2, model.njoints) if model.names[k] not in robot.joints]
    model = pin.buildReducedModel(model, locked, pin.neutral(model))
    data, frame = model.createData(), model.getFrameId("ft")
    spec = next(iter(rig.payloads.values()))
    body = pin.Inertia(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)
    wrench = np.empty((time.size, 6))
    for k in range(time.size):
        full = np.concatenate([np.zeros(3), np.roll(attitude[k], -1), q[k]])
        rates = np.concatenate([base[k], qd[k]]), np.concatenate([base_rate[k], qdd[k]])
        pin.forwardKinematics(model, data, full, *rates)
        placement = pin.updateFramePlacement(model, data, frame)
        nu = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
        a = pin.getFrameAcceleration(model, data, frame, pin.LOCAL)
        a.linear = a.linear - placement.rotation.T @ rig.gravity_array
        wrench[k] = -(body * a + nu.cross(body * nu)).vector

    moving = replace(scene().moved, wrench=wrench)
    scores = []
    for seed in range(4):
        payload, truth = begin(rig, None, seed)
        log = record(rig, payload, truth, moving)
        log = replace(log, tracking=None, twist=None, gravity=None, base_twist=base, base_attitude=attitude)
        estimate = estimate_windows(rig, tracked_logs(rig, log))
        scores.append(score(rig, estimate, truth)[1])
    assert_honest(scores)
    still = replace(log, base_twist=None, base_attitude=None)
    taken_still = tw.calibrate(rig, still, held_out=False)
    assert not taken_still.verdict.usable
    assert any("base is taken to stand still" in note for note in taken_still.figures["notes"])
    assert not any("base" in note for note in tw.calibrate(rig, log, held_out=False).figures["notes"])


@pytest.fixture(scope="module")
def calibrated(scene: Any) -> tuple[Calibration, Truth]:
    scene = scene((100, 100), 0.0, 11.0)
    log, truth = scene.log(11)
    return tw.calibrate(scene.rig, log), truth


def test_calibration_holds_a_part_of_the_joint_log_out(calibrated: tuple[Calibration, Truth]) -> None:
    assert calibrated[0].verdict.usable
    assert all(axis.held_out for axis in calibrated[0].improvement.values())
    assert any(axis.better is True for axis in calibrated[0].improvement.values())
    assert all(axis.better is not False for axis in calibrated[0].improvement.values())


def test_validation_on_another_joint_log_keeps_the_gain_and_finds_a_wrong_one(
    scene: Callable[..., Scene], calibrated: tuple[Calibration, Truth]
) -> None:
    found, truth = calibrated
    rig, moved = scene().rig, scene().moved
    log = record(rig, found.logs[0].payload, replace(truth, seed=77), moved)
    kept = validate(found, rig, log)
    assert kept.verdict.usable, kept.verdict.reasons
    assert all(axis.better is True for name, axis in kept.axes.items() if axis.nominal > 3.0 * axis.new)
    assert sum(axis.better is True for axis in kept.axes.values()) >= 3
    wrong = found.gain * 1.05
    spoilt = validate(replace(found, gain=wrong, inverse=np.linalg.inv(wrong)), rig, log)
    assert not spoilt.verdict.usable


@pytest.mark.parametrize("estimator", ["ekf", "ls"])
def test_reference_estimators_take_joints_and_sensor_of_one_rate(
    scene: Callable[..., Scene], estimator: Any
) -> None:
    log, truth = scene().log(1)
    found = tw.calibrate(scene().rig, log, estimator=estimator)
    assert not found.verdict.usable
    assert any("reference estimator" in reason for reason in found.verdict.reasons)
    error = normalised(scene().rig, found.gain - truth.gain)
    start = normalised(scene().rig, scene().rig.sensor.nominal_gain_array - truth.gain)
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(start**2))
    other, _ = scene((100, 160)).log(1)
    with pytest.raises(UnsupportedError, match="streams of one rate"):
        tw.calibrate(scene().rig, other, estimator=estimator)


def test_smoothed_least_squares_of_a_joint_log_is_near_the_bound(scene: Callable[..., Scene]) -> None:
    rig, squares = scene().rig, []
    for seed in range(4):
        log, truth = scene().log(seed)
        found = tw.calibrate(rig, log, estimator="ls", smooth="spline")
        squares.append(np.mean(normalised(rig, found.gain - truth.gain) ** 2))
    assert np.sqrt(np.mean(squares)) < 1.6 * bound(rig, [log], truth.gain).rms


def test_command_line_calibrates_joint_logs(
    scene: Callable[..., Scene], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, truth = scene().log(1)
    settings = scene().rig.to_mapping()
    settings["motion"]["robot"]["urdf"] = str(scene().rig.urdf_path)
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(settings))
    path, _ = write_run(tmp_path / "run.csv", log, truth, robot_of(scene().rig).joints)

    def status(*more: str) -> object:
        with pytest.raises(SystemExit) as left:
            main(["calibrate", str(rig), str(path), "-o", str(tmp_path / "out"), *more])
        return left.value.code

    assert status("--no-held-out") == 0
    assert status("--estimator", "ls") == 3
    assert "reference estimator" in capsys.readouterr().out
    header, *lines = path.read_text().splitlines()
    path.write_text("\n".join([header.replace("q_panda_joint4", "q_four", 1), *lines]))
    assert status() == 2
    assert "q_panda_joint4" in capsys.readouterr().err


def test_twists_of_a_joint_rig_are_refused_without_joints(scene: Callable[..., Scene]) -> None:
    log, _ = scene().log(0)
    with pytest.raises(InputError, match="no joints"):
        tw.calibrate(scene().rig, replace(log, position=None, velocity=None, tracking=None))
