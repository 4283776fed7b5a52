"""What is refused before anything is estimated: joints that contradict themselves, gross mistakes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import truewrench as tw
from truewrench.calibrating.hopeless import hopeless, plain_gain
from truewrench.estimation.logged_otherwise import logged_otherwise
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.robot.attitude import attitude_of
from truewrench.robot.joint_faults import joint_faults

Array = NDArray[np.float64]

TWIST: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.05] * 3 + [0.005] * 3,
        "range": [100] * 3 + [10] * 3,
        "gain_prior": 0.1,
    },
    "payloads": {
        "default": {
            "mass": 5,
            "center_of_mass": [0.02, 0.03, 0.1],
            "inertia": {"xx": 0.06, "yy": 0.05, "zz": 0.03},
        }
    },
    "motion": {"source": "twist", "of": "sensor", "noise": [1e-3] * 6},
    "gravity": [0, 0, -9.81],
    "required": 0.05,
    "plan": {"duration": 12},
    "simulate": {"rate": 100, "payload": "random"},
}


@pytest.fixture(scope="module")
def twist_log() -> Log:
    return tw.simulate(Rig.from_mapping(TWIST), seed=1).log


@pytest.fixture
def arm(arm_rig: Callable[..., Rig]) -> tuple[Rig, Log]:
    rig = arm_rig("panda_ground", plan={"duration": 10}, simulate={"rate": 125, "sensor_rate": 125})
    return rig, as_read(tw.simulate_arm(rig, seed=1).log)


def as_read(log: Log) -> Log:
    return replace(log, twist=None, gravity=None, tracking=None)


def changed(log: Log, j: int, position: Callable[[Array], Array], velocity: Callable[[Array], Array]) -> Log:
    assert log.position is not None
    assert log.velocity is not None
    q, dq = log.position.copy(), log.velocity.copy()
    q[:, j], dq[:, j] = position(q[:, j]), velocity(dq[:, j])
    return replace(log, position=q, velocity=dq)


def same(x: Array) -> Array:
    return x


def test_sound_records_are_left_to_the_estimate(twist_log: Log, arm: tuple[Rig, Log]) -> None:
    rig = Rig.from_mapping(TWIST)
    assert hopeless(rig, [twist_log], [twist_log]) == []
    assert hopeless(arm[0], [arm[1]], [arm[1]]) == []


@pytest.mark.parametrize(
    ("position", "velocity", "words"),
    [
        (lambda q: np.where(np.arange(q.size) > q.size // 2, q + 0.3, q), same, "jumps by 0.3 rad"),
        (lambda q: -q, same, "against its velocities"),
        (np.rad2deg, same, "57.3 times as far"),
        (same, lambda v: 0.0 * v, "velocities hardly move"),
        (same, lambda v: 0.3 * np.sin(0.1 * np.arange(v.size)), "different motions"),
        (lambda q: -q, lambda v: -v, "its sign is turned"),
    ],
    ids=["jump", "against", "degrees", "no velocities", "another motion", "turned"],
)
def test_joints_that_no_arm_moves_so_are_named(
    arm: tuple[Rig, Log],
    position: Callable[[Array], Array],
    velocity: Callable[[Array], Array],
    words: str,
) -> None:
    rig, log = arm
    found = hopeless(rig, [changed(log, 3, position, velocity)], [changed(log, 3, position, velocity)])
    assert len(found) == 1
    assert "panda_joint4" in found[0]
    assert words in found[0]


@pytest.mark.parametrize("velocities", [True, False])
def test_streams_with_stamps_of_their_own_are_tested_alike(
    arm_rig: Callable[..., Rig], velocities: bool
) -> None:
    """As any recording has them: nothing was, and a turned joint was the motion of another run."""
    rig = arm_rig("panda_ground", plan={"duration": 10}, simulate={"rate": 125, "sensor_rate": 300})
    log = as_read(tw.simulate_arm(rig, seed=1).log)
    log = log if velocities else replace(log, velocity=None)
    assert hopeless(rig, [log], [log]) == []
    assert log.position is not None
    factor = np.where(np.arange(7) == 3, -1.0, 1.0)
    velocity = None if log.velocity is None else log.velocity * factor
    turned = replace(log, position=log.position * factor, velocity=velocity)
    (said,) = hopeless(rig, [turned], [turned])
    assert said.startswith("joint panda_joint4: its sign is turned")


def test_a_push_that_looks_like_a_huge_gain_is_no_wrong_unit(twist_log: Log) -> None:
    """What hardly moves is known to least squares as badly as a disturbance is small beside it."""
    rig = Rig.from_mapping(TWIST)
    span = rig.sensor.range_array
    middle = np.abs(twist_log.time - 6.0) <= 2.0
    seen = (twist_log.raw - twist_log.raw[middle].mean(axis=0)) / span
    least = np.linalg.svd(seen[middle])[2][-1]
    push = np.outer(np.where(middle, 80.0 * seen @ least, 0.0), [1, 0, 0, 1, 0, 0]) * span
    pushed = replace(twist_log, raw=twist_log.raw + push)
    known = plain_gain(rig, [rows_of(pushed, middle)])
    assert known is not None
    assert np.abs(known[0] * span / span[:, None]).max() > 40.0
    assert hopeless(rig, [pushed], [pushed]) == []
    thousandfold = replace(pushed, raw=1e3 * pushed.raw)
    (said, *_) = hopeless(rig, [thousandfold], [thousandfold])
    assert "1000 times too large" in said


@pytest.mark.parametrize("gravity", [(0, 0, 9.81), (0, -9.81, 0), (0, 0, 0), (0, 0, -1)])
def test_gravity_that_a_rig_states_otherwise_is_named(
    arm: tuple[Rig, Log], gravity: tuple[float, float, float]
) -> None:
    """It was a gain 1e100 to 1 off, after ten times as long."""
    rig, log = arm
    wrong = Rig.from_mapping({**rig.to_mapping(), "gravity": list(gravity)}, rig.path)
    (said,) = hopeless(wrong, [log], [log])
    assert said.startswith("gravity is not [")
    assert "] in the root frame, but [0, 0, -9.81]" in said


@pytest.mark.parametrize(
    ("payloads", "words"),
    [
        (("default", "heavy"), None),
        (("heavy", "default"), "log 1 and log 2 carry each other's payload"),
        (("default", "default"), "log 2 carries `heavy`, not `default`"),
    ],
)
def test_payloads_of_pooled_logs_that_were_mixed_up_are_named(
    payloads: tuple[str, str], words: str | None
) -> None:
    """They were a gain 1e30 to 1 off, or a centre of mass, after up to two minutes."""
    heavy = {
        "mass": 9,
        "center_of_mass": [-0.03, 0.01, 0.15],
        "inertia": {"xx": 0.09, "yy": 0.08, "zz": 0.04},
    }
    both = Rig.from_mapping({**TWIST, "payloads": {**TWIST["payloads"], "heavy": heavy}})
    logs = [tw.simulate(both, seed=1, payload=name).log for name in ("default", "heavy")]
    logs = [replace(log, payload=name) for log, name in zip(logs, payloads, strict=True)]
    found = hopeless(both, logs, logs)
    assert [said.split(":")[0] for said in found] == ([words] if words else [])


def turned(log: Log) -> Log:
    """With an attitude that follows gravity and the rate of turn, in place of gravity."""
    assert log.twist is not None
    assert log.gravity is not None
    rows = np.isfinite(log.gravity).all(axis=1)
    log = rows_of(log, rows)
    _, R_sensor_root = attitude_of(Rig.from_mapping(TWIST), log) or (None, None)
    assert R_sensor_root is not None
    attitude = Rotation.from_matrix(R_sensor_root).inv().as_quat()[:, [3, 0, 1, 2]]
    return replace(log, gravity=None, attitude=attitude)


def test_a_direction_of_gravity_that_turns_otherwise_than_the_twist_is_named(twist_log: Log) -> None:
    """Refused they were all, as a gain 1e400 to 1 off, or as the motion of another run."""
    rig = Rig.from_mapping(TWIST)
    assert twist_log.twist is not None
    assert twist_log.gravity is not None
    told = turned(twist_log)
    assert told.attitude is not None
    assert hopeless(rig, [told], [told]) == []
    degrees = twist_log.twist * np.repeat([1.0, 180.0 / np.pi], 3)
    for log, words in (
        (replace(twist_log, twist=degrees), "wx wy wz turn otherwise than the direction of gravity"),
        (replace(twist_log, twist=twist_log.twist * np.repeat([1.0, -1.0], 3)), "turn the other way than"),
        (replace(told, attitude=told.attitude * [1, -1, -1, -1]), "an attitude from root to sensor"),
        (replace(twist_log, gravity=twist_log.gravity[::-1].copy()), "tell different turns"),
        (replace(twist_log, gravity=twist_log.gravity * 0 + [0, 0, -9.81]), "hardly does"),
        (replace(twist_log, gravity=-twist_log.gravity), "gx gy gz point up, as what an accelerometer reads"),
    ):
        (said,) = hopeless(rig, [log], [log])
        assert words in said


@pytest.mark.parametrize(
    ("gravity", "kind", "words"),
    [
        ([0, 0, 0], "degrees", "wx wy wz are in degrees per second"),
        ([0, 0, -9.81], "mm", "vx vy vz are in mm/s"),
    ],
)
@pytest.mark.parametrize("sensor_rate", [125, 500])
def test_units_of_a_twist_are_named_at_any_two_rates(
    gravity: list[float], kind: str, words: str, sensor_rate: float
) -> None:
    """Rows of a slower motion stand among those of the sensor, at its stamps."""
    rates = TWIST["simulate"] | {"rate": 125, "sensor_rate": sensor_rate}
    rig = Rig.from_mapping(TWIST | {"gravity": gravity, "simulate": rates})
    log = tw.simulate(rig, seed=1).log
    assert log.twist is not None
    assert hopeless(rig, [log], [log]) == []
    unit = {"degrees": [1.0, 180.0 / np.pi], "mm": [1e3, 1.0]}[kind]
    wrong = replace(log, twist=log.twist * np.repeat(unit, 3))
    (said,) = hopeless(rig, [wrong], [wrong])
    assert words in said


def test_joints_of_an_arm_slower_than_its_sensor_are_named(arm_rig: Callable[..., Rig]) -> None:
    rig = arm_rig("panda_ground", plan={"duration": 10}, simulate={"rate": 125, "sensor_rate": 500})
    log = as_read(tw.simulate_arm(rig, seed=1).log)
    assert hopeless(rig, [log], [log]) == []
    turned = changed(log, 3, np.negative, np.negative)
    (said,) = hopeless(rig, [turned], [turned])
    assert "its sign is turned" in said


def test_joints_in_degrees_are_named_and_a_verdict_says_nothing_else(arm: tuple[Rig, Log]) -> None:
    rig, log = arm
    assert log.position is not None
    assert log.velocity is not None
    degrees = replace(log, position=np.rad2deg(log.position), velocity=np.rad2deg(log.velocity))
    verdict = tw.calibrate(rig, degrees).verdict
    assert not verdict.usable
    assert len(verdict.reasons) == 1
    assert verdict.reasons[0].startswith("the joints are in degrees")


def test_gains_that_least_squares_make_too_large_are_left_to_the_estimate() -> None:
    noisy = {
        **TWIST,
        "gravity": [0, 0, 0],
        "motion": {**TWIST["motion"], "noise": [5e-2] * 6},
        "plan": {"duration": 120, "harmonics": 1},
    }
    rig = Rig.from_mapping(noisy)
    log = tw.simulate(rig, seed=2).log
    found = plain_gain(rig, [log])
    assert found is not None
    assert np.abs(found[0]).max() > 1.5
    assert hopeless(rig, [log], [log]) == []


@pytest.mark.parametrize("step", [1e-5, 1e-3, 1e-2])
def test_coarse_encoders_do_not_jump(arm: tuple[Rig, Log], step: float) -> None:
    rig, log = arm
    assert log.position is not None
    coarse = replace(log, position=np.round(log.position / step) * step)
    assert joint_faults(rig, [coarse]) == []
    assert joint_faults(rig, [replace(coarse, velocity=None)]) == []


@pytest.mark.parametrize("late", [2, 5])
def test_lost_rows_beside_late_velocities_are_no_jumps(arm: tuple[Rig, Log], late: int) -> None:
    rig, log = arm
    assert log.position is not None
    assert log.velocity is not None
    velocity = np.vstack([log.velocity[:late], log.velocity[:-late]])
    for seed in range(5):
        kept = np.random.default_rng(seed).random(len(log.time_ns)) > 0.25
        lossy = replace(
            log,
            time_ns=log.time_ns[kept],
            raw=log.raw[kept],
            position=log.position[kept],
            velocity=velocity[kept],
        )
        assert not any("jumps by" in fault for fault in joint_faults(rig, [lossy]))


def test_velocities_that_nobody_fills_are_left_out(arm: tuple[Rig, Log]) -> None:
    rig, log = arm
    assert log.velocity is not None
    found = tw.calibrate(rig, replace(log, velocity=np.zeros_like(log.velocity)))
    without = tw.calibrate(rig, replace(log, velocity=None))
    assert np.array_equal(found.gain, without.gain)
    assert any("the driver does not fill them" in note for note in found.figures["notes"])


def test_poses_are_no_jumps(arm: tuple[Rig, Log]) -> None:
    rig, log = arm
    assert log.position is not None
    rows = np.repeat([100, 100, 100, 100, 100, 900], 8)
    time_ns = 2_000_000_000 * np.arange(rows.size)
    poses = replace(log, time_ns=time_ns, raw=log.raw[rows], position=log.position[rows], velocity=None)
    assert joint_faults(rig, [poses]) == []


def test_a_tool_is_refused_by_the_same_words(arm: tuple[Rig, Log]) -> None:
    rig, log = arm
    with pytest.raises(tw.InputError, match=r"panda_joint4.*against its velocities"):
        tw.identify_tool(rig, changed(log, 3, lambda q: -q, same))


def test_a_tool_is_not_fitted_to_a_motion_that_was_logged_otherwise(arm_rig: Callable[..., Rig]) -> None:
    """Whatever the gripper weighs and the sensor gains: a fit took minutes, and named nothing."""
    rig = arm_rig("panda_ground", plan={"duration": 10}, simulate={"rate": 125, "sensor_rate": 500})
    log = tw.simulate_arm(rig, seed=1).log
    assert logged_otherwise(rig, as_read(log)) == ""
    turned = changed(as_read(log), 3, np.negative, np.negative)
    with pytest.raises(tw.InputError, match=r"joint panda_joint4: its sign is turned"):
        tw.identify_tool(rig, turned)


def test_a_stray_row_comes_back_and_is_no_jump(arm: tuple[Rig, Log]) -> None:
    rig, log = arm
    assert log.position is not None
    q = log.position.copy()
    q[400, 2] += 0.5
    assert joint_faults(rig, [replace(log, position=q)]) == []


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (lambda x: 9.80665 * x, "9.807 times too large"),
        (lambda x: -x, "wrong sign of the whole wrench"),
        (lambda x: x[:, ::-1].copy(), "axes mixed up"),
        (lambda x: x * [1, -1, 1, 1, -1, 1], "wrong sign of fy and my"),
        (lambda x: x * [1, 1, 1, 1e3, 1e3, 1e3], "moments 1000 times too large (N mm for N m)"),
        (lambda x: x * [1, 1, 1, 1e2, 1e2, 1e2], "moments 100 times too large (N cm for N m)"),
        (lambda x: x * [1e3, 1e3, 1e3, 1, 1, 1], "forces 1000 times too large (mN for N"),
        (lambda x: 1e3 * x, "all axes 1000 times too large"),
    ],
    ids=["kilograms", "sign", "order", "left-handed", "N mm", "N cm", "mN", "all mN"],
)
def test_gross_mistakes_of_the_set_up_need_no_estimate(
    twist_log: Log, raw: Callable[[Array], Array], words: str
) -> None:
    log = replace(twist_log, raw=raw(twist_log.raw))
    found = hopeless(Rig.from_mapping(TWIST), [log], [log])
    assert found
    assert words in found[0]
    calibration = tw.calibrate(Rig.from_mapping(TWIST), log)
    assert calibration.verdict.reasons == tuple(found)
    assert not any(calibration.axes.values())
