"""Claims about the Cramer-Rao bound against dense textbook versions with Pinocchio's or MuJoCo's wrench."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from truewrench.estimation.bound import bound, information
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import Body, HarmonicTwist, attitude
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.robot.arm import robot_of
from truewrench.robot.track import track
from truewrench.simulation.arm.motion import default_motion
from truewrench.simulation.arm.run import arm_with
from truewrench.simulation.free_body import simulate, wrench_on_sensor
from truewrench.simulation.truth import stated

Array = NDArray[np.float64]

INERTIA = {"xx": 1.5, "yy": 1.5, "zz": 0.4}
FREQUENCY = np.array([[0.30, 0.51, 0.69, 0.39, 0.60, 0.87]])
PHASE = np.array([[0, 1, 2, 0.5, 1.5, 2.5]])
MOTION = HarmonicTwist(np.full((1, 6), 0.25), FREQUENCY, PHASE, 10.0)  # the scenario of the benchmarks


EXACT = {"mass": 0, "center_of_mass": 0, "inertia": 0}


def rig_of(sf: float, sv: float, *, uncertainty: Any = EXACT, gravity: Any = (0, 0, 0), **sensor: Any) -> Rig:
    return Rig.from_mapping(
        {
            "gravity": list(gravity),
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": [sf] * 3 + [sf / 10] * 3,
                "range": [500, 500, 500, 50, 50, 50],
                "offset_prior": 0,
                "time_offset_prior": 0,
                **sensor,
            },
            "payloads": {
                "p": {
                    "mass": 50,
                    "center_of_mass": [0.2, 0, 0],
                    "inertia": INERTIA,
                    "uncertainty": uncertainty,
                }
            },
            "motion": {"noise": [sv] * 6},
            "simulate": {"gain": "nominal", "offset": "none"},
        }
    )


def dense_bound(rig: Rig, offset: bool) -> tuple[float, float]:
    """Bound and oracle by a dense Jacobian of all residuals with respect to all unknowns."""
    model = pin.Model()
    model.gravity.linear[:] = 0
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "sensor")
    lever = np.array([0.2, 0, 0])
    body = pin.Inertia(50.0, lever, np.diag([1.5, 1.5, 0.4]))
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    data, q, shift = model.createData(), pin.neutral(model), np.eye(6)
    shift[:3, 3:] = pin.skew(lever)

    def wrench(nu: np.ndarray, a: np.ndarray) -> np.ndarray:
        return -pin.rnea(model, data, q, shift @ nu, shift @ a) / rig.sensor.range_array

    t = np.arange(1000) / 100
    knots = np.arange(-5, 40 + 6) * (t[-1] / 40)
    splines = BSpline(knots, np.eye(45), 5)
    value, slope = splines(t), splines(t, nu=1)
    nu, a = MOTION.twist(t), MOTION.acceleration(t)
    noise = rig.sensor.noise_array / rig.sensor.channel_scale
    w = np.array([wrench(*x) for x in zip(nu, a, strict=True)])
    columns = np.column_stack([w, np.ones(1000)]) if offset else w
    rows = [np.kron(value, np.diag(1 / rig.motion.noise_array))]
    by_motion = np.empty((1000, 6, 270))
    for k in range(1000):
        by_nu, by_a = np.empty((6, 6)), np.empty((6, 6))
        for c, e in enumerate(np.eye(6) * 0.3):
            by_nu[:, c] = (wrench(nu[k] + e, a[k]) - wrench(nu[k] - e, a[k])) / 0.6
            by_a[:, c] = (wrench(nu[k], a[k] + e) - wrench(nu[k], a[k] - e)) / 0.6
        by_motion[k] = (np.kron(value[k], by_nu) + np.kron(slope[k], by_a)) / noise[:, None]
    rows.append(by_motion.reshape(6000, 270))
    parameters = np.einsum("ij,km->kijm", np.diag(1 / noise), columns).reshape(6000, -1)
    jacobian = np.block([[rows[0], np.zeros((6000, parameters.shape[1]))], [rows[1], parameters]])
    width = columns.shape[1]
    gains = 270 + (np.arange(6)[:, None] * width + np.arange(6)).ravel()
    prior = np.zeros(jacobian.shape[1])
    prior[gains] = rig.sensor.gain_prior**-2
    if offset:
        prior[270 + np.arange(6) * width + 6] = (
            rig.sensor.channel_scale / rig.sensor.offset_prior_array
        ) ** 2
    full = np.linalg.inv(jacobian.T @ jacobian + np.diag(prior))
    oracle = np.linalg.inv(parameters.T @ parameters + np.diag(prior[270:]))
    return (
        float(np.sqrt(np.mean(np.diag(full)[gains]))),
        float(np.sqrt(np.mean(np.diag(oracle)[gains - 270]))),
    )


@pytest.mark.parametrize(("sf", "sv"), [(0.02, 1e-4), (0.5, 1e-3)])
@pytest.mark.parametrize("offset", [False, True])
def test_bound_agrees_with_a_dense_one_at_the_truth(sf: float, sv: float, offset: bool) -> None:
    rig = rig_of(sf, sv, **({"offset_prior": [5.0] * 3 + [0.5] * 3} if offset else {}))
    log = simulate(rig, MOTION).log
    expected, expected_oracle = dense_bound(rig, offset)
    found = bound(rig, [log], np.eye(6))
    assert found.rms == pytest.approx(expected, rel=0.03)  # the motion here is fitted, not the true one
    assert found.oracle_rms == pytest.approx(expected_oracle, rel=0.03)


@pytest.mark.parametrize(
    ("sf", "sv", "oracle", "rms"),
    [(0.02, 1e-4, 1.7e-4, 3.4e-4), (0.1, 1e-4, 8.3e-4, 8.9e-4), (0.5, 1e-3, 4.2e-3, 5.2e-3)],
)
def test_bound_of_the_scenario_is_what_the_documentation_says(
    sf: float, sv: float, oracle: float, rms: float
) -> None:
    found = bound(rig_of(sf, sv), [simulate(rig_of(sf, sv), MOTION).log], np.eye(6))
    assert found.oracle_rms == pytest.approx(oracle, rel=0.03)
    assert found.rms == pytest.approx(rms, rel=0.03)


def test_a_second_log_adds_its_information() -> None:
    rig = rig_of(0.5, 1e-3, offset_prior=[5.0] * 3 + [0.5] * 3)
    logs = [simulate(rig, MOTION, seed=s).log for s in range(2)]
    one, two = bound(rig, logs[:1], np.eye(6)), bound(rig, logs, np.eye(6))
    assert two.rms == pytest.approx(one.rms / np.sqrt(2), rel=0.05)


def test_bound_accepts_streams_of_different_rates() -> None:
    rig = rig_of(0.5, 1e-3)
    fast = rig.model_copy(update={"simulate": rig.simulate.model_copy(update={"sensor_rate": 400.0})})
    found, once = (
        bound(rig, [simulate(fast, MOTION).log], np.eye(6)),
        bound(rig, [simulate(rig, MOTION).log], np.eye(6)),
    )
    assert found.oracle_rms == pytest.approx(once.oracle_rms / 2, rel=0.02)
    assert found.oracle_rms < found.rms < once.rms


# -- payload, clock and gravity uncertain ----------------------------------------------------------------

UNCERTAIN = {"mass": 3e-3, "center_of_mass": 1e-3, "inertia": 0.02}
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def dense_bound_of_all(rig: Rig, gain: Array) -> tuple[float, float]:
    """Bound with and without what else is uncertain, by differences of material points that are moved.

    The unknowns are spline coefficients, gains, offsets, ten numbers of the payload, the clock, and the two
    angles by which gravity may be tilted, one after the other in a dense matrix.
    """
    t = np.arange(1000) / 100
    unit, noise = rig.sensor.range_array, rig.sensor.noise_array / rig.sensor.channel_scale
    point = np.array([0.2, 0, 0])

    def wrench(p: Array, nu: Array, a: Array, at: Array) -> Array:
        """Normalised wrench for departures of [mass, centre (3), inertia (6), clock, tilt (2)]."""
        inertia = np.diag([1.5, 1.5, 0.4])
        for x, (i, j) in zip(p[4:10], PAIRS, strict=True):
            step = x * np.sqrt(np.diag([1.5, 1.5, 0.4])[i, i] * np.diag([1.5, 1.5, 0.4])[j, j])
            inertia[i, j] += step
            inertia[j, i] = inertia[i, j]
        fall = Rotation.from_rotvec([p[11], p[12], 0.0]).apply(rig.gravity_array)
        gravity = fall @ attitude(MOTION, at)  # R^T g
        return (
            wrench_on_sensor(Body(50.0 * (1 + p[0]), point + p[1:4], inertia), point, nu, a, gravity) / unit
        )

    nu, a, none = MOTION.twist(t), MOTION.acceleration(t), np.zeros(13)
    w = wrench(none, nu, a, t)
    knots = np.arange(-5, 40 + 6) * (t[-1] / 40)
    splines = BSpline(knots, np.eye(45), 5)
    by_motion = np.zeros((1000, 6, 45, 6))
    for c, e in enumerate(np.eye(6)):
        for basis, (dn, da) in ((splines(t), (e, 0 * e)), (splines(t, nu=1), (0 * e, e))):
            slope = 0.5 * (wrench(none, nu + dn, a + da, t) - wrench(none, nu - dn, a - da, t))
            by_motion[..., c] += slope[:, :, None] * basis[:, None]
    by_others = np.zeros((1000, 6, 13))
    step = 1e-5
    for k, e in enumerate(step * np.eye(13)):
        by_others[..., k] = (wrench(e, nu, a, t) - wrench(-e, nu, a, t)) / (2 * step)
    late = wrench(none, MOTION.twist(t + step), MOTION.acceleration(t + step), t + step)
    by_others[..., 10] = (late - w) / step
    columns = np.column_stack([w, np.ones(1000)])
    parameters = np.einsum("ij,km->kijm", np.diag(1 / noise), columns).reshape(6000, 42)
    raw = [
        (np.einsum("ij,kjm->kim", gain, x.reshape(1000, 6, -1)) / noise[:, None]).reshape(6000, -1)
        for x in (by_motion, by_others)
    ]
    of_twist = np.kron(splines(t), np.diag(1 / rig.motion.noise_array))
    jacobian = np.block([[of_twist, np.zeros((6000, 42 + 13))], [raw[0], parameters, raw[1]]])
    gains = 270 + (7 * np.arange(6)[:, None] + np.arange(6)).ravel()
    prior = np.zeros(270 + 42 + 13)
    prior[gains] = rig.sensor.gain_prior**-2
    prior[270 + 7 * np.arange(6) + 6] = (rig.sensor.channel_scale / rig.sensor.offset_prior_array) ** 2
    u = rig.payloads["p"].uncertainty
    sigma = [u.mass, *[u.center_of_mass] * 3, *[u.inertia] * 6]
    prior[312:] = np.array([*sigma, rig.sensor.time_offset_prior, *[rig.gravity_tilt_prior] * 2]) ** -2.0
    full = jacobian.T @ jacobian + np.diag(prior)
    # in units of sigma: seconds and kilograms together are badly scaled
    unit_of = 1 / np.sqrt(np.diag(full))
    every = np.linalg.inv(full * np.outer(unit_of, unit_of)) * np.outer(unit_of, unit_of)
    known = np.linalg.inv(full[:312, :312])
    return tuple(float(np.sqrt(np.mean(np.diag(x)[gains]))) for x in (every, known))  # type: ignore[return-value]


@pytest.mark.parametrize(("sf", "sv"), [(0.02, 1e-4), (0.5, 1e-3)])
def test_bound_with_uncertain_payload_clock_and_gravity_agrees_with_a_dense_one(sf: float, sv: float) -> None:
    offset = {"offset_prior": [50.0] * 3 + [5.0] * 3, "time_offset_prior": 5e-3}
    rig = rig_of(sf, sv, uncertainty=UNCERTAIN, gravity=[0, 0, -9.81], **offset)
    gain = np.eye(6) + 0.1 * np.random.default_rng(0).standard_normal((6, 6))
    expected, without = dense_bound_of_all(rig, gain)
    log = simulate(rig, MOTION).log
    raw_gain = gain * rig.sensor.channel_scale[:, None] / rig.sensor.range_array
    found = information(rig, [log], raw_gain)[0]
    assert rms_of(found.covariance()) == pytest.approx(expected, rel=0.03)
    assert rms_of(found.known()) == pytest.approx(without, rel=0.03)
    assert bound(rig, [log], raw_gain).rms == rms_of(found.covariance())
    assert expected > 1.2 * without


def rms_of(covariance: Array) -> float:
    return float(np.sqrt(np.mean(np.diag(covariance))))


def test_each_source_accounts_for_what_it_adds_alone() -> None:
    uncertain = {"time_offset_prior": 5e-3}
    rig = rig_of(0.5, 1e-3, uncertainty=UNCERTAIN, gravity=[0, 0, -9.81], **uncertain)
    found = information(rig, [simulate(rig, MOTION).log], np.eye(6))[0]
    parts = found.contributions()
    assert set(parts) == {"noise", "mass", "center_of_mass", "inertia", "timing", "gravity"}
    # mass and gain of the force are one: what is not known of the mass is not known of the gain
    of_force = parts["mass"].reshape(6, 6).diagonal()[:3]
    np.testing.assert_allclose(of_force, UNCERTAIN["mass"], rtol=0.1)
    np.testing.assert_allclose(parts["noise"] ** 2, np.diag(found.known()), rtol=1e-9)


def test_tilt_of_gravity_costs_most_where_the_body_hardly_turns() -> None:
    """A tilt is a force along the root's axes; in a body that turns it is none that a gain could make."""
    cost = []
    for turning in (1.0, 0.2):
        size = np.array([[0.25] * 3 + [0.25 * turning] * 3])
        motion = HarmonicTwist(size, FREQUENCY, PHASE, 10.0)
        offset = {"offset_prior": [50.0] * 3 + [5.0] * 3}
        rig = rig_of(0.02, 1e-4, gravity=[0, 0, -9.81], **offset)
        found = information(rig, [simulate(rig, motion).log], np.eye(6))[0]
        cost.append(found.contributions()["gravity"].max())
    assert cost[1] > 2.0 * cost[0] > 0.0


def test_a_record_twice_as_long_has_the_bound_of_two_records() -> None:
    rig = rig_of(0.5, 1e-3, offset_prior=[5.0] * 3 + [0.5] * 3, pool_offsets=True, uncertainty=UNCERTAIN)
    logs = [simulate(rig, MOTION, seed=s).log for s in range(2)]
    one, two = (information(rig, logs[:k], np.eye(6))[0] for k in (1, 2))
    assert rms_of(one.covariance(2.0)) == pytest.approx(rms_of(two.covariance()), rel=0.02)


def dense_bound_of_joints(rig: Rig, time: np.ndarray, positions: bool, velocities: bool) -> tuple[float, Log]:
    """RMS bound with splines on every joint and differences of MuJoCo's sensors, and a noise-free log."""
    robot = robot_of(rig)
    payload, spec = next(iter(rig.payloads.items()))
    arm = arm_with(rig, robot, stated(spec))
    motion = default_motion(rig, robot, {payload: arm})
    state = [motion.position(time), motion.velocity(time), motion.acceleration(time)]
    n, noise, unit = robot.n, rig.sensor.noise_array / rig.sensor.channel_scale, rig.sensor.range_array
    intervals = 50
    knots = np.arange(-5, intervals + 6) * (time[-1] / intervals)
    splines = BSpline(knots, np.eye(intervals + 5), 5)
    basis = [splines(time, nu=order) for order in range(3)]
    unknowns = n * (intervals + 5)
    by_motion = np.zeros((time.size, 6, intervals + 5, n))
    for order, step in enumerate((1e-4, 1.0, 1.0)):
        for joint, e in enumerate(step * np.eye(n)):
            there, back = ([x + s * e * (k == order) for k, x in enumerate(state)] for s in (1.0, -1.0))
            slope = (arm.ideal(*there).wrench - arm.ideal(*back).wrench) / (2.0 * step * unit)
            by_motion[..., joint] += slope[:, :, None] * basis[order][:, None]
    wrench = arm.ideal(*state).wrench / unit
    rows = [by_motion.reshape(time.size, 6, unknowns) / noise[:, None]]
    parameters = np.einsum(
        "ij,km->kijm", np.diag(1 / noise), np.column_stack([wrench, np.ones(time.size)])
    ).reshape(6 * time.size, 42)
    known = np.zeros((unknowns, unknowns))
    if positions:
        known += np.kron(basis[0].T @ basis[0], np.diag(np.array(rig.motion.position_noise) ** -2.0))
    if velocities:
        known += np.kron(basis[1].T @ basis[1], np.diag(rig.motion.noise_array**-2.0))
    jacobian = np.hstack([rows[0].reshape(-1, unknowns), parameters])
    information = jacobian.T @ jacobian
    information[:unknowns, :unknowns] += known
    gains = unknowns + (7 * np.arange(6)[:, None] + np.arange(6)).ravel()
    prior = np.zeros(len(information))
    prior[gains] = rig.sensor.gain_prior**-2
    prior[unknowns + 7 * np.arange(6) + 6] = (rig.sensor.channel_scale / rig.sensor.offset_prior_array) ** 2
    covariance = np.linalg.inv(information + np.diag(prior))
    stamps = np.round(1e9 * time).astype(np.int64)
    position, velocity = state[0] if positions else None, state[1] if velocities else None
    log = Log(None, payload, "", stamps, wrench * unit, position=position, velocity=velocity)
    return float(np.sqrt(np.mean(np.diag(covariance)[gains]))), track(rig, log)


@pytest.mark.parametrize(
    ("positions", "velocities"), [(True, True), (True, False)], ids=["both", "positions alone"]
)
@pytest.mark.parametrize("accurate", [False, True])
def test_bound_of_joints_agrees_with_a_dense_one_in_joint_space(
    arm_rig: Callable[..., Rig], positions: bool, velocities: bool, accurate: bool
) -> None:
    noise = [0.001, 0.001, 0.002, 6e-5, 6e-5, 6e-5] if accurate else [0.05, 0.05, 0.1, 3e-3, 3e-3, 3e-3]
    of_joints = {"noise": [2e-4] * 7, "position_noise": [1e-4, 5e-5, 1e-4, 1e-4, 2e-4, 1e-4, 5e-5]}
    rig = arm_rig(
        "panda_ground",
        sensor={"noise": noise},
        motion=of_joints,
        plan={"duration": 6},
        simulate={"rate": 50},
        gravity_tilt_prior=0,
    )
    expected, log = dense_bound_of_joints(rig, np.arange(300) / 50, positions, velocities)
    found = bound(rig, [log], np.eye(6))
    assert found.rms == pytest.approx(expected, rel=0.05)  # not on the same knots
    assert found.rms > (1.3 if accurate else 1.0) * found.oracle_rms  # it is the motion that counts


def test_no_duration_leaves_the_last_sample_outside() -> None:
    """Of 250 durations, 25 did, by rounding: the last knot was before it."""
    rig = rig_of(0.1, 1e-3)
    log = simulate(rig, replace(MOTION, duration=12.0)).log
    for count in range(600, 680):
        assert np.isfinite(bound(rig, [rows_of(log, slice(count))], np.eye(6)).rms)
