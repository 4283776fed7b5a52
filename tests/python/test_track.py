"""What joints tell of the sensor's motion; MuJoCo's sensors and free-flying Pinocchio models judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from truewrench.estimation.inertial import InertialMotion
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.spatial import twist_adjoint
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig
from truewrench.model.split import held_out
from truewrench.robot.arm import robot_of
from truewrench.robot.track import track, tracked, tracked_streams
from truewrench.simulation.arm.model import Reading
from truewrench.simulation.arm.motion import default_motion
from truewrench.simulation.arm.run import arm_with
from truewrench.simulation.truth import stated

Array = np.ndarray[Any, np.dtype[np.float64]]
RigOf = Callable[..., Rig]

RATE = 250.0  # [Hz]
DURATION = 6.0  # [s]


@pytest.fixture(scope="module")
def rig(arm_rig: RigOf) -> Rig:
    return arm_rig("panda_ground", plan={"duration": DURATION})


@pytest.fixture(scope="module")
def motion(rig: Rig) -> SplineJoints:
    payload, spec = next(iter(rig.payloads.items()))
    return default_motion(rig, robot_of(rig), {payload: arm_with(rig, robot_of(rig), stated(spec))})


def mujoco(rig: Rig, motion: SplineJoints, time: Array) -> Reading:
    """What ideal sensors of MuJoCo read on the motion."""
    arm = arm_with(rig, robot_of(rig), stated(next(iter(rig.payloads.values()))))
    return arm.ideal(motion.position(time), motion.velocity(time), motion.acceleration(time))


def recorded(time: Array, position: Array | None, velocity: Array | None, **more: Any) -> Log:
    """A log that has not been tracked."""
    raw = np.zeros((len(time), 6))
    stamps = np.round(1e9 * time).astype(np.int64)
    return Log(None, "default", "", stamps, raw, position=position, velocity=velocity, **more)


def noise_free(motion: SplineJoints, **more: Any) -> Log:
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    return recorded(time, motion.position(time), motion.velocity(time), **more)


def noisy(rig: Rig, motion: SplineJoints, time: Array, seed: int = 0) -> Log:
    rng, n = np.random.default_rng(seed), robot_of(rig).n
    q, qd = motion.position(time), motion.velocity(time)
    if rig.motion.position_noise is not None:
        q = q + np.array(rig.motion.position_noise) * rng.standard_normal((time.size, n))
    return recorded(time, q, qd + rig.motion.noise_array * rng.standard_normal((time.size, n)))


def displaced(rig: Rig, log: Log, at: Array) -> tuple[Array, Array, Array, Array]:
    """Twist, acceleration and gravity at times of the log, and the displacements that its encoders show."""
    assert log.tracking is not None
    assert log.tracking.reference is not None
    encoders = tracked_streams(rig, log)[0]
    spline = make_interp_spline(log.time[encoders.rows], encoders.value, k=5)
    p, dp, ddp = (spline(at, nu=order) for order in range(3))
    nu, a, g = log.tracking.reference.motion(at + 1e-9 * (log.time_ns[0] - log.tracking.reference.origin_ns))

    def times(matrices: Array, vectors: Array) -> Array:
        return np.asarray(np.einsum("kij,kj->ki", matrices, vectors))

    by_nu, by_a = twist_adjoint(nu), twist_adjoint(a)
    return (
        nu + times(by_nu, p) + dp,
        a + times(by_a, p) + times(by_nu, dp) + ddp,
        g - np.cross(p[:, 3:], g),
        p,
    )


def specific_force(nu: Array, a: Array, g: Array) -> Array:
    return a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - g


def test_reference_and_encoders_together_give_the_motion_between_their_samples(
    rig: Rig, motion: SplineJoints
) -> None:
    log = track(rig, noise_free(motion))
    between = log.time[50:-50] + 0.4 / RATE
    nu, a, g, p = displaced(rig, log, between)
    truth = mujoco(rig, motion, between)
    # What is neglected is of second order: the displacement times its own rates, or times those that turn it.
    size = np.abs(p).max()
    assert log.tracking is not None
    assert log.tracking.reference is not None
    rate = 2.0 / log.tracking.reference.spacing  # of a displacement, whose knots are half as wide
    assert 1e-6 < size < 2e-3
    scale = np.abs(truth.twist).max() + size * rate
    assert np.abs(nu - truth.twist).max() < 3.0 * size * scale + 1e-9
    assert np.abs(g - truth.gravity).max() < 9.81 * size**2 + 1e-9
    limit = 3.0 * size * (9.81 + scale * rate) + 1e-6  # of the spline through samples 4 ms apart
    assert np.abs(specific_force(nu, a, g) - truth.specific_force).max() < limit
    # of first order, the reference alone is wrong by far more
    alone = log.tracking.reference.motion(between)
    assert np.abs(alone[0] - truth.twist).max() > 30.0 * np.abs(nu - truth.twist).max()
    assert np.abs(alone[2] - truth.gravity).max() > 30.0 * np.abs(g - truth.gravity).max()


def test_tachometers_measure_the_rate_of_the_displacement_and_its_coupling(
    rig: Rig, motion: SplineJoints
) -> None:
    log = track(rig, noise_free(motion))
    encoders, tachometers = tracked_streams(rig, log)
    p = make_interp_spline(log.time, encoders.value, k=5)
    inner = slice(50, -50)
    dp = p(log.time, nu=1)[inner]
    assert tachometers.coupling is not None
    coupled = np.einsum("kij,kj->ki", tachometers.coupling, encoders.value)[inner]
    off = np.abs(dp + coupled - tachometers.value[inner]).max()
    assert off < 0.05 * np.abs(coupled).max()
    assert off < 1e-3 * np.abs(dp).max()


@pytest.mark.parametrize("exact", [True, False])
def test_twist_is_that_of_mujoco_with_the_covariance_of_the_joints(
    arm_rig: RigOf, motion: SplineJoints, exact: bool
) -> None:
    changes = {"position_noise": None, "noise": [1e-3, 2e-3, 3e-3, 1e-3, 2e-3, 3e-3, 1e-3]}
    rig = arm_rig("panda_ground", motion=changes if exact else {"noise": changes["noise"]})
    time = np.arange(0.0, DURATION, 1.0 / 500.0)
    log = track(rig, noisy(rig, motion, time))
    assert log.twist is not None
    truth = mujoco(rig, motion, time)
    np.testing.assert_allclose(log.gravity, truth.gravity, atol=1e-9 if exact else 9.81 * 2e-3)
    if exact:
        (stream,) = tracked_streams(rig, log)
        departure = stream.value - truth.twist
    else:
        departure, stream = log.twist - truth.twist, tracked_streams(rig, log)[1]
        # to what the reference is away from the true position
        assert stream.coupling is not None
    white = np.einsum("kij,kj->ki", np.linalg.inv(np.linalg.cholesky(stream.covariance)), departure)
    found = white.T @ white / len(white)
    np.testing.assert_allclose(found, np.eye(6), atol=5.0 * np.sqrt(2.0 / len(white)))


def test_encoders_measure_the_displacement_with_the_covariance_of_the_joints(
    rig: Rig, motion: SplineJoints
) -> None:
    time = np.arange(0.0, DURATION, 1.0 / 500.0)
    log = track(rig, noisy(rig, motion, time))
    assert log.tracking is not None
    assert log.tracking.reference is not None
    encoders = tracked_streams(rig, log)[0]
    # away from the true pose by what their noise is: the pose of the reference follows from both
    R_root_sensor, p_root_sensor = robot_of(rig).pose(motion.position(time))
    q_reference = log.position - log.tracking.position_departure
    R_reference, p_reference = robot_of(rig).pose(q_reference)
    true = np.column_stack(
        [
            np.einsum("kji,kj->ki", R_reference, p_root_sensor - p_reference),
            Rotation.from_matrix(np.swapaxes(R_reference, 1, 2) @ R_root_sensor).as_rotvec(),
        ]
    )
    off = encoders.value - true
    white = np.einsum("kij,kj->ki", np.linalg.inv(np.linalg.cholesky(encoders.covariance)), off)
    np.testing.assert_allclose(white.T @ white / len(white), np.eye(6), atol=5.0 * np.sqrt(2.0 / len(white)))


def flying(rig: Rig, motion: SplineJoints, time: Array) -> tuple[Log, Array, Array, Array]:
    """A log of the arm on a base that tumbles; twist, specific force and gravity of its sensor."""
    robot = robot_of(rig)
    model = pin.buildModelFromUrdf(str(rig.urdf_path), pin.JointModelFreeFlyer())
    locked = [k for k in range(2, model.njoints) if model.names[k] not in robot.joints]
    model = pin.buildReducedModel(model, locked, pin.neutral(model))
    data, frame = model.createData(), model.getFrameId("ft")
    axis = np.array([0.48, -0.6, 0.64])
    angle, rate, slope = 2.5 * np.sin(0.7 * time), 1.75 * np.cos(0.7 * time), -1.225 * np.sin(0.7 * time)
    attitude = Rotation.from_rotvec(angle[:, None] * axis)
    phase = np.array([0.0, 1.0, 2.0])
    v, dv = 0.3 * np.sin(time[:, None] + phase), 0.3 * np.cos(time[:, None] + phase)
    base = np.column_stack([v, rate[:, None] * axis])
    base_rate = np.column_stack([dv, slope[:, None] * axis])
    q, qd, qdd = motion.position(time), motion.velocity(time), motion.acceleration(time)
    nu, a, g = np.empty((time.size, 6)), np.empty((time.size, 6)), np.empty((time.size, 3))
    for k in range(time.size):
        full = np.concatenate([np.zeros(3), attitude[k].as_quat(), q[k]])
        rates = np.concatenate([base[k], qd[k]]), np.concatenate([base_rate[k], qdd[k]])
        pin.forwardKinematics(model, data, full, *rates)
        placement = pin.updateFramePlacement(model, data, frame)
        nu[k] = pin.getFrameVelocity(model, data, frame, pin.LOCAL).vector
        a[k] = pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector
        g[k] = placement.rotation.T @ rig.gravity_array
    quaternion = np.roll(attitude.as_quat(), 1, axis=1)
    quaternion[time.size // 2 :] *= -1.0  # the same attitude
    log = recorded(time, q, qd, base_twist=base, base_attitude=quaternion)
    return log, nu, specific_force(nu, a, g), g


def test_a_base_that_moves_gives_the_motion_of_a_free_flying_arm(
    arm_rig: RigOf, rig: Rig, motion: SplineJoints
) -> None:
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    log, nu, force, g = flying(rig, motion, time)
    exact = track(arm_rig("panda_ground", motion={"position_noise": None}), log)
    np.testing.assert_allclose(exact.twist, nu, atol=1e-12)
    np.testing.assert_allclose(exact.gravity, g, atol=1e-12)
    found = track(rig, log)
    inner = slice(50, -50)
    twist, a, gravity, p = displaced(rig, found, time[inner])
    size = np.abs(p).max()
    assert size < 2e-3
    np.testing.assert_allclose(twist, nu[inner], atol=3.0 * size * 20.0 * size + 1e-6)
    np.testing.assert_allclose(gravity, g[inner], atol=9.81 * size**2 + 1e-6)
    # the derivative of a base that is sampled every 4 ms
    np.testing.assert_allclose(specific_force(twist, a, gravity), force[inner], atol=2e-2 * size * 200 + 2e-4)


def test_nothing_is_told_where_the_base_is_not(rig: Rig, motion: SplineJoints) -> None:
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    log, nu, _, _ = flying(rig, motion, time)
    assert log.base_twist is not None
    assert log.base_attitude is not None
    late, gone = log.base_attitude.copy(), log.base_twist.copy()
    late[time < 1.0] = np.nan  # 1 Hz and 50 Hz would do, missing rows would not
    gone[(time > 3.0) & (time < 3.5)] = np.nan
    found = track(rig, replace(log, base_attitude=late, base_twist=gone))
    assert found.twist is not None
    told = np.isfinite(found.twist).all(axis=1)
    np.testing.assert_array_equal(told, (time >= 1.0) & ~((time > 3.0) & (time < 3.5)))
    assert np.abs(found.twist[told] - nu[told]).max() < 1e-2
    np.testing.assert_array_equal(found.position, log.position)


def test_a_base_logged_more_slowly_is_followed_between_its_rows(arm_rig: RigOf, motion: SplineJoints) -> None:
    rig = arm_rig("panda_ground", motion={"position_noise": None})
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    log, nu, _, g = flying(rig, motion, time)
    assert log.base_twist is not None
    assert log.base_attitude is not None
    kept = np.arange(time.size) % 10 == 0
    slow = replace(
        log,
        base_twist=np.where(kept[:, None], log.base_twist, np.nan),
        base_attitude=np.where(kept[:, None], log.base_attitude, np.nan),
    )
    found = track(rig, slow)
    assert found.twist is not None
    assert found.gravity is not None
    told = np.isfinite(found.twist).all(axis=1)
    np.testing.assert_array_equal(told, time <= time[kept][-1])
    np.testing.assert_allclose(found.twist[told], nu[told], atol=1e-5)
    np.testing.assert_allclose(found.gravity[told], g[told], atol=1e-5)


@pytest.mark.parametrize("pause", [0.9, 60.0, 3600.0, 1e5])
def test_both_sides_of_a_gap_are_followed_as_well_as_without_it(
    rig: Rig, motion: SplineJoints, pause: float
) -> None:
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    kept = time[(time < 2.0) | (time > 2.9)]
    as_logged = np.where(kept < 2.0, kept, kept + (pause - 0.9))
    log = track(rig, recorded(as_logged, motion.position(kept), motion.velocity(kept)))
    assert log.time_ns[-1] == pytest.approx(1e9 * as_logged[-1], abs=1e3)
    for side in (kept[(kept > 0.2) & (kept < 1.9)], kept[(kept > 3.0) & (kept < 5.8)]):
        at = np.where(side < 2.0, side, side + (pause - 0.9))
        encoders = tracked_streams(rig, log)[0]
        rows = np.flatnonzero((log.time >= at[0] - 0.1) & (log.time <= at[-1] + 0.1))
        p = make_interp_spline(log.time[rows], encoders.value[rows], k=5)
        assert log.tracking is not None
        assert log.tracking.reference is not None
        assert log.tracking.reference.breakpoints.size < 3e4
        nu, _, g = log.tracking.reference.motion(at)
        truth = mujoco(rig, motion, side)
        nu = nu + np.einsum("kij,kj->ki", twist_adjoint(nu), p(at)) + p(at, nu=1)
        size, rate = np.abs(p(at)).max(), 2.0 / log.tracking.reference.spacing
        assert size < 5e-3
        assert np.abs(nu - truth.twist).max() < 3.0 * size * (1.0 + size * rate) + 1e-9
        assert np.abs(g - np.cross(p(at)[:, 3:], g) - truth.gravity).max() < 20.0 * size**2 + 1e-9


def test_rows_with_some_of_the_joints_are_left_out(rig: Rig, motion: SplineJoints) -> None:
    log = noise_free(motion)
    assert log.position is not None
    some = log.position.copy()
    some[10:20, 3] = np.nan
    found = track(rig, replace(log, position=some))
    assert found.tracking is not None
    assert found.tracking.position_departure is not None
    rows = np.flatnonzero(np.isnan(found.tracking.position_departure).any(axis=1))
    np.testing.assert_array_equal(rows, np.arange(10, 20))
    some[:750, 4:] = np.nan
    some[750:, :4] = np.nan
    with pytest.raises(InputError, match=r"0 rows with all joints, 740 with some"):
        track(rig, replace(log, position=some))


def test_streams_of_the_joints_may_have_rows_of_their_own(rig: Rig, motion: SplineJoints) -> None:
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    log = noise_free(motion)
    assert log.position is not None
    assert log.velocity is not None
    apart = replace(
        log,
        position=np.where((np.arange(time.size) % 2 == 0)[:, None], log.position, np.nan),
        velocity=np.where((np.arange(time.size) % 4 == 1)[:, None], log.velocity, np.nan),
    )
    encoders, tachometers = tracked_streams(rig, found := track(rig, apart))
    np.testing.assert_array_equal(encoders.rows, np.arange(0, time.size, 2))
    np.testing.assert_array_equal(tachometers.rows, np.arange(1, time.size, 4))
    nu, _, g, p = displaced(rig, found, time[100:-100])
    truth = mujoco(rig, motion, time[100:-100])
    size = np.abs(p).max()
    np.testing.assert_allclose(nu, truth.twist, atol=3.0 * size * 10.0 * size / 0.1 + 1e-8)
    np.testing.assert_allclose(g, truth.gravity, atol=9.81 * size**2 + 1e-8)


def test_a_part_of_a_log_keeps_the_clock_of_its_reference(rig: Rig, motion: SplineJoints) -> None:
    log = track(rig, noise_free(motion))
    time = log.time
    whole = replace(log, raw=mujoco(rig, motion, time).wrench)
    for part in held_out([whole], fraction=0.4, blocks=1):
        chunks = InertialMotion(rig, part[0]).wrench(0.0, lags=4)
        for chunk in chunks:
            inner = slice(60, -60)
            off = np.abs(chunk.wrench - part[0].raw[chunk.rows])[inner]
            assert np.all(off < 3.0 * np.sqrt(chunk.variance[inner]))
        assert chunks


def test_exact_positions_are_not_guessed_beyond_their_rows(arm_rig: RigOf, motion: SplineJoints) -> None:
    rig = arm_rig("panda_ground", motion={"position_noise": None})
    log = noise_free(motion)
    assert log.position is not None
    time, some = log.time, log.position.copy()
    some[(time < 1.0) | ((time > 3.0) & (time < 3.5))] = np.nan
    some[1::2] = np.nan
    found = track(rig, replace(log, position=some))
    assert found.twist is not None
    told = np.isfinite(found.twist).all(axis=1)
    first, last = np.flatnonzero(np.isfinite(some).all(axis=1))[[0, -1]]
    inside = (time >= time[first]) & (time <= time[last])
    assert not told[~inside].any()
    assert not told[(time > 3.01) & (time < 3.49)].any()
    assert told[inside & ((time < 2.99) | (time > 3.51))].all()
    truth = mujoco(rig, motion, time[told])
    np.testing.assert_allclose(found.twist[told], truth.twist, atol=1e-6)


def test_integrated_velocities_give_the_motion_of_the_arm(arm_rig: RigOf, motion: SplineJoints) -> None:
    start = motion.position(np.zeros(1))[0].tolist()
    rig = arm_rig("panda_ground", motion={"position_noise": None, "initial_position": start})
    log = noise_free(motion)
    found = track(rig, replace(log, position=None))
    truth = mujoco(rig, motion, log.time)
    assert found.twist is not None
    assert found.gravity is not None
    # velocities were free of noise: what is left is the reference's own departure from them
    np.testing.assert_allclose(found.twist, truth.twist, atol=2e-3)
    np.testing.assert_allclose(found.gravity, truth.gravity, atol=9.81 * 2e-3)
    rates, places = tracked_streams(rig, found)
    assert (rates.order, places.order) == (1, 0)
    # all that is said of positions, together, has the sigma of a walk of the velocities' noise
    sigma = np.sqrt(1.0 / np.sum(1.0 / places.covariance[:, 5, 5]))
    walk = 1e-3 * np.sqrt(DURATION / RATE)
    assert 0.05 * walk < sigma < 3.0 * walk


@pytest.mark.parametrize(
    ("changes", "gone", "message"),
    [
        ({"position_noise": None}, "velocity", r"dq_\*.*position_noise"),
        (
            {"position_noise": None, "initial_position": None},
            "position",
            r"motion\.initial_position.*nothing",
        ),
        ({"noise": None}, "position", r"motion\.noise: found nothing"),
    ],
)
def test_what_leaves_the_motion_open_is_refused(
    arm_rig: RigOf, motion: SplineJoints, changes: dict[str, Any], gone: str, message: str
) -> None:
    rig = arm_rig("panda_ground", motion=changes)
    with pytest.raises(InputError, match=message):
        track(rig, replace(noise_free(motion), **{gone: None}))


def test_logs_that_do_not_fit_the_arm_are_refused(
    valid_settings: dict[str, Any], rig: Rig, motion: SplineJoints
) -> None:
    log = noise_free(motion)
    assert log.position is not None
    with pytest.raises(InputError, match="no joints"):
        track(rig, replace(log, position=None, velocity=None))
    with pytest.raises(InputError, match="found 6 joints, expected 7: "):
        track(rig, replace(log, position=log.position[:, :6]))
    with pytest.raises(InputError, match="at least 16 rows"):
        track(rig, recorded(log.time[:10], log.position[:10], None))
    with pytest.raises(InputError, match="gravity has no direction"):
        track(rig, replace(log, base_twist=np.zeros((len(log.time), 6))))
    twist = Rig.from_mapping(valid_settings)
    with pytest.raises(InputError, match=r"motion\.source"):
        tracked(twist, [track(rig, log)])


def test_a_known_wrench_needs_no_joints(rig: Rig) -> None:
    log = recorded(np.arange(4.0), None, None, reference=np.ones((4, 6)))
    assert tracked(rig, [log]) == [log]
