"""Calibrations of arms are as good as the bound and as honest as they say, whatever joints log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.stats import chi2

import truewrench as tw
from truewrench.cli import main
from truewrench.estimation.bound import bound
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.judging.validation import validate
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.robot.arm import robot_of
from truewrench.simulation.arm.drive import Driven
from truewrench.simulation.arm.motion import default_motion
from truewrench.simulation.arm.run import Moved, arm_with, move, record
from truewrench.simulation.truth import Truth, begin, stamps_of, stated, write_run

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


def score(rig: Rig, found: Estimate, truth: Truth) -> tuple[float, float]:
    """Mean square of the errors of the normalised gains, and NEES per gain."""
    error = normalised(rig, found.gain - truth.gain)
    covariance = found.normalised_covariance[:36, :36]
    return float(np.mean(error**2)), float(error @ np.linalg.solve(covariance, error) / 36.0)


def assert_honest(scores: Sequence[float]) -> None:
    """Mean NEES per gain within the 99.8% interval of chi-square, widened by 0.05."""
    freedom = 36 * len(scores)
    low, high = chi2.ppf([0.001, 0.999], freedom) / freedom
    assert low - 0.05 < np.mean(scores) < high + 0.05
    assert max(scores) < chi2.isf(1e-6, 36) / 36


def without_discrepancy(scene: Scene) -> Scene:
    """Of an arm that nothing pulls at, and that says so: (10.10) prices what could follow the pose."""
    settings = scene.rig.to_mapping()
    settings["sensor"]["discrepancy"] = 0
    return replace(scene, rig=Rig.from_mapping(settings, scene.rig.path))


def test_arm_gives_an_honest_gain_near_the_bound(scene: Callable[..., Scene]) -> None:
    recorded = without_discrepancy(scene((100, 160)))
    squares, bounds, nees = [], [], []
    for seed in range(5):
        log, truth = recorded.log(seed)
        square, squared = score(recorded.rig, estimate(recorded.rig, [log]), truth)
        squares.append(square)
        nees.append(squared)
        bounds.append(bound(recorded.rig, [log], truth.gain).rms ** 2)
    assert_honest(nees)
    assert np.sqrt(np.mean(squares)) < 1.3 * np.sqrt(np.mean(bounds))


def test_online_reads_joints_as_the_twist_that_their_velocities_measure(scene: Callable[..., Scene]) -> None:
    recorded = without_discrepancy(scene((100, 160)))
    nees = []
    for seed in range(5):
        log, truth = recorded.log(seed)
        nees.append(score(recorded.rig, estimate(recorded.rig, [log], online=True), truth)[1])
    assert_honest(nees)
    positions = replace(log, velocity=None, tracking=None)
    with pytest.raises(InputError, match=r"dq_.*joint velocities"):
        estimate(recorded.rig, [positions], online=True)


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


def test_a_base_of_which_a_log_says_nothing_is_said_to_stand_still(
    calibrated: tuple[Calibration, Truth],
) -> None:
    assert any("base is taken to stand still" in note for note in calibrated[0].figures["notes"])


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
        return main(["calibrate", str(rig), str(path), "-o", str(tmp_path / "out"), *more])

    assert status("--no-held-out") == 0
    assert status("--estimator", "ls") == 3
    assert "reference estimator" in capsys.readouterr().out
    header, *lines = path.read_text().splitlines()
    path.write_text("\n".join([header.replace("q_panda_joint4", "q_four", 1), *lines]))
    assert status() == 2
    assert "q_panda_joint4" in capsys.readouterr().err


def test_twists_of_a_joint_rig_are_refused_without_joints(scene: Callable[..., Scene]) -> None:
    log, _ = scene().log(0)
    with pytest.raises(InputError, match="no motion"):
        tw.calibrate(scene().rig, replace(log, position=None, velocity=None, tracking=None))


def test_a_clock_that_is_late_looks_like_a_clock_and_not_like_a_filter(scene: Callable[..., Scene]) -> None:
    """Noise and smoothness bend the motion that kappa is told by: over fine encoders to below 0 (10.4)."""
    late = scene(delay=0.02, duration=8.0)
    kappa = []
    for seed in range(4):
        found = estimate(late.rig, [late.log(seed)[0]], threads=1)
        kappa += [
            (clock.kappa - 0.5) / clock.kappa_std
            for clock in found.clocks[0]
            if clock.kappa is not None and clock.kappa_std is not None
        ]
    assert kappa
    assert abs(np.mean(kappa)) < 1.0


def test_a_record_too_short_to_turn_the_wrench_tells_and_moves_nothing(arm_rig: RigOf) -> None:
    """Its gain imitates any delay of the joints: sigma was 20 priors, the payload 20 sigma off, untold."""
    uncertain = {"mass": 1e-3, "center_of_mass": 5e-4, "inertia": 1e-2}
    rig = arm_rig("ur10_ground", sensor={"gain_prior": 0.1, "time_offset_prior": 5e-3})
    settings = rig.to_mapping()
    for payload in settings["payloads"].values():
        payload["uncertainty"] = uncertain
    settings |= {"plan": settings["plan"] | {"duration": 8}, "simulate": {"rate": 500, "sensor_rate": 500}}
    rig = Rig.from_mapping(settings, rig.path)
    log = replace(tw.simulate_arm(rig, seed=1).log, twist=None, gravity=None, tracking=None)
    found = estimate(rig, [rows_of(log, np.arange(len(log.time_ns)) < 500)])
    assert found.solved
    sigma = np.sqrt(np.diag(found.normalised_covariance))[:36]
    assert sigma.max() < 2.0 * 0.1
    departure = found.payloads["default"]
    assert np.abs(departure.mean / departure.std).max() < 1.0
    (clocks,) = found.clocks
    assert max(clock.std for clock in clocks) == pytest.approx(5e-3, rel=0.05)  # of the one that is held
