"""Claims about simulated logs, with Pinocchio as the independent judge of their wrenches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml

from truewrench._core import pose_share
from truewrench.estimation.pose import delay_share
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.motion.trajectory import Body, attitude
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, default_trajectory, simulate, wrench_on_sensor

QUIET = {"sensor": {"noise": [1e-12] * 6}, "motion": {"noise": [1e-12] * 6}}


def rig_of(**changes: Any) -> Rig:
    settings: dict[str, Any] = {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": "payload_on_sensor",
            "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
            "range": [500, 500, 500, 50, 50, 50],
        },
        "payloads": {
            "table_1": {
                "mass": 50,
                "center_of_mass": [0.2, 0, 0],
                "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
            },
        },
        "motion": {"noise": [1e-3] * 6},
        "plan": {"duration": 4},
        "simulate": {"gain": "nominal", "offset": "none"},
    }
    for section, values in changes.items():
        settings[section] = {**settings.get(section, {}), **values} if isinstance(values, dict) else values
    return Rig.from_mapping(settings)


def pinocchio_wrench(
    body: Body, point: np.ndarray, twist: np.ndarray, a: np.ndarray, g: np.ndarray
) -> np.ndarray:
    """The payload's wrench on the sensor by RNEA of a free-flying body whose joint frame is the sensor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "sensor")
    model.appendBodyToJoint(
        joint, pin.Inertia(body.mass, body.center_of_mass, body.inertia), pin.SE3.Identity()
    )
    data, q = model.createData(), pin.neutral(model)
    out = []
    for nu, acceleration, gravity in zip(twist, a, g, strict=True):
        model.gravity.linear = gravity
        at_sensor = [np.concatenate([x[:3] + np.cross(point, x[3:]), x[3:]]) for x in (nu, acceleration)]
        out.append(-pin.rnea(model, data, q, *at_sensor))
    return np.array(out)


def random_body(rng: np.random.Generator) -> Body:
    points = rng.normal(size=(8, 3)) * 0.2
    masses = rng.uniform(0.1, 2.0, 8)
    center = masses @ points / masses.sum()
    r = points - center
    inertia = np.einsum(
        "p,pij->ij", masses, (r**2).sum(1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None]
    )
    return Body(float(masses.sum()), center, inertia)


def true_wrench(run: SimulatedRun, rig: Rig, shown: np.ndarray) -> np.ndarray:
    body = run.truth.payloads[run.log.payload]
    point = rig.payloads[run.log.payload].center_of_mass_array if rig.motion.of == "com" else np.zeros(3)
    g = np.zeros((shown.size, 3))
    if rig.in_gravity:
        g = rig.gravity_array @ attitude(run.trajectory, shown)
    motion = run.trajectory
    return pinocchio_wrench(body, point, motion.twist(shown), motion.acceleration(shown), g)


@pytest.mark.parametrize("seed", range(20))
def test_wrench_of_material_points_matches_pinocchio_rnea(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body, point = random_body(rng), rng.normal(size=3)
    nu, a, g = rng.normal(size=(50, 6)) * 3, rng.normal(size=(50, 6)) * 10, rng.normal(size=(50, 3)) * 9.81
    expected = pinocchio_wrench(body, point, nu, a, g)
    np.testing.assert_allclose(wrench_on_sensor(body, point, nu, a, g), expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("of", ["com", "sensor"])
@pytest.mark.parametrize("gravity", [[0, 0, 0], [0, 0, -9.81]])
def test_noise_free_log_obeys_newton_and_euler(of: str, gravity: list[float]) -> None:
    rig = rig_of(**QUIET | {"gravity": gravity, "motion": {"noise": [1e-12] * 6, "of": of}})
    run = simulate(rig)
    np.testing.assert_allclose(run.log.raw, true_wrench(run, rig, run.log.time_ns * 1e-9), atol=1e-8)


def test_sensor_on_payload_reads_the_opposite() -> None:
    one = simulate(rig_of(**QUIET)).log.raw
    other = simulate(
        rig_of(sensor={**QUIET["sensor"], "feels": "sensor_on_payload"}, motion=QUIET["motion"])
    ).log.raw
    np.testing.assert_allclose(one, -other, atol=1e-9)


def test_gain_and_offset_make_the_raw_channels() -> None:
    gain = (np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) + 0.1).tolist()
    offset = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    rig = rig_of(**QUIET | {"simulate": {"gain": gain, "offset": offset}})
    run = simulate(rig)
    wrench = true_wrench(run, rig, run.log.time_ns * 1e-9)
    np.testing.assert_allclose(run.log.raw, wrench @ np.array(gain).T + offset, atol=1e-7)


def test_random_time_offset_follows_its_prior_and_changes_no_other_draw() -> None:
    sensor = {"time_offset_prior": 2e-3}
    options = {"gain": "random", "offset": "random", "payload": "random", "rate": 20, "sensor_rate": 20}
    drawn = rig_of(sensor=sensor, simulate=options | {"time_offset": "random"})
    motion = default_trajectory(drawn)
    truths = [simulate(drawn, motion, seed=seed).truth for seed in range(300)]
    offsets = np.array([truth.time_offset for truth in truths])
    assert abs(offsets.std() / 2e-3 - 1.0) < 4.0 / np.sqrt(2.0 * offsets.size)
    assert abs(offsets.mean()) < 4.0 * 2e-3 / np.sqrt(offsets.size)
    fixed = simulate(rig_of(sensor=sensor, simulate=options), seed=7).truth
    assert np.array_equal(fixed.gain, truths[7].gain)
    assert np.array_equal(fixed.offset, truths[7].offset)
    assert fixed.payloads["table_1"].mass == truths[7].payloads["table_1"].mass


def test_sensor_sample_shows_the_motion_at_its_stamp_plus_the_time_offset() -> None:
    rig = rig_of(**QUIET | {"simulate": {"gain": "nominal", "offset": "none", "time_offset": 0.013}})
    run = simulate(rig)
    sampled = np.isfinite(run.log.raw[:, 0])
    stamps = run.log.time_ns[sampled] * 1e-9
    assert sampled.sum() == 399  # the last sample would show the motion after its end
    np.testing.assert_allclose(run.log.raw[sampled], true_wrench(run, rig, stamps + 0.013), atol=1e-8)
    np.testing.assert_allclose(run.log.twist, run.trajectory.twist(run.log.time_ns * 1e-9), atol=1e-9)


def test_streams_of_different_rates_share_one_table_with_empty_cells() -> None:
    log = simulate(rig_of(simulate={"rate": 100, "sensor_rate": 250})).log
    assert log.twist is not None
    assert np.isfinite(log.raw[:, 0]).sum() == 1000
    assert np.isfinite(log.twist[:, 0]).sum() == 400
    assert len(log.time_ns) == 1200  # every 20 ms they meet
    assert np.all(np.diff(log.time_ns) > 0)


def test_gravity_turns_in_the_sensor_frame_and_keeps_its_length() -> None:
    log = simulate(rig_of(gravity=[0, 0, -9.81])).log
    assert log.gravity is not None
    np.testing.assert_allclose(np.linalg.norm(log.gravity, axis=1), 9.81, rtol=1e-10)
    np.testing.assert_allclose(log.gravity[0], [0, 0, -9.81])
    assert np.abs(log.gravity[:, :2]).max() > 0.5


def test_noise_has_the_stated_sigma_and_the_seed_decides_it() -> None:
    rig = rig_of(plan={"duration": 40})
    quiet = simulate(rig_of(**QUIET, plan={"duration": 40})).log
    log, again, other = simulate(rig).log, simulate(rig).log, simulate(rig, seed=1).log
    assert log.twist is not None
    assert quiet.twist is not None
    np.testing.assert_array_equal(log.raw, again.raw)
    assert not np.any(log.raw == other.raw)
    np.testing.assert_allclose((log.raw - quiet.raw).std(axis=0), rig.sensor.noise_array, rtol=0.06)
    np.testing.assert_allclose((log.twist - quiet.twist).std(axis=0), rig.motion.noise_array, rtol=0.06)


def test_logs_of_one_seed_are_of_one_sensor_and_each_payload_has_noise_of_its_own() -> None:
    bodies = rig_of().to_mapping()["payloads"]
    rig = rig_of(payloads={"table_1": bodies["table_1"], "other": bodies["table_1"]})
    first, other = (simulate(rig, payload=name) for name in ("table_1", "other"))
    np.testing.assert_array_equal(first.truth.gain, other.truth.gain)
    noise = first.log.raw - other.log.raw  # of the same wrench
    np.testing.assert_allclose(noise.std(axis=0), np.sqrt(2.0) * rig.sensor.noise_array, rtol=0.15)


def test_random_truth_has_the_spread_of_the_priors() -> None:
    changes = {
        "simulate": {"gain": "random", "offset": "random", "payload": "random"},
        "plan": {"duration": 0.1},
    }
    rig = rig_of(**changes)
    motion = default_trajectory(rig)
    truths = [simulate(rig, motion, seed=s).truth for s in range(300)]
    scale = rig.sensor.range_array / rig.sensor.channel_scale[:, None]
    gains = np.array([(t.gain - np.eye(6)) * scale for t in truths])
    assert gains.std() == pytest.approx(0.3, rel=0.05)
    offsets = np.array([t.offset / rig.sensor.offset_prior_array for t in truths])
    assert offsets.std() == pytest.approx(1.0, rel=0.1)
    bodies = [t.payloads["table_1"] for t in truths]
    assert np.std([b.mass / 50 for b in bodies]) == pytest.approx(1e-3, rel=0.15)
    assert np.std([b.center_of_mass for b in bodies], axis=0) == pytest.approx(5e-4, rel=0.2)
    assert np.std([b.inertia[0, 2] for b in bodies]) == pytest.approx(1e-2 * np.sqrt(1.5 * 0.4), rel=0.2)


def test_random_payload_moves_the_mass_and_not_the_logged_point() -> None:
    changes = QUIET | {"simulate": {"gain": "nominal", "offset": "none", "payload": "random"}}
    rig = rig_of(**changes)
    run = simulate(rig)
    assert not np.allclose(run.truth.payloads["table_1"].center_of_mass, [0.2, 0, 0])
    np.testing.assert_allclose(run.log.raw, true_wrench(run, rig, run.log.time_ns * 1e-9), atol=1e-8)


def test_default_motion_keeps_to_the_limits() -> None:
    limits = {
        "velocity": [0.2] * 6,
        "acceleration": [0.5] * 3 + [1.0] * 3,
        "position": [0.1] * 6,
        "wrench_fraction": 0.04,
    }
    rig = rig_of(limits=limits, plan={"duration": 10})
    motion = default_trajectory(rig)
    t = np.linspace(0, 10, 2001)
    nu, a = motion.twist(t), motion.acceleration(t)
    assert np.all(np.abs(nu) <= 0.2 + 1e-12)
    assert np.all(np.abs(a) <= np.array(limits["acceleration"]) + 1e-12)
    travel = np.cumsum(nu[:-1] + nu[1:], axis=0) * 0.5 * (t[1] - t[0])
    assert np.all(np.abs(travel) <= 0.1 + 1e-4)
    body = Body(50.0, np.array([0.2, 0, 0]), np.diag([1.5, 1.5, 0.4]))
    wrench = wrench_on_sensor(body, body.center_of_mass, nu, a, np.zeros((t.size, 3)))
    share = np.abs(wrench) / rig.sensor.range_array
    assert 0.035 < share.max() < 0.0405


def test_written_log_and_truth_hold_what_was_simulated(tmp_path: Path) -> None:
    run = simulate(rig_of(simulate={"rate": 50, "sensor_rate": 100, "gain": "random"}))
    log_path, truth_path = run.write(tmp_path / "run.csv")
    assert truth_path.name == "run.csv.truth.yaml"
    lines = log_path.read_text().splitlines()
    assert lines[0] == "time_ns,raw_0,raw_1,raw_2,raw_3,raw_4,raw_5,vx,vy,vz,wx,wy,wz"
    assert lines[2].endswith(",,,,,,")
    assert [float(x) for x in lines[1].split(",")[1:7]] == run.log.raw[0].tolist()
    truth = yaml.safe_load(truth_path.read_text())
    assert set(truth) == {"gain", "offset", "time_offset", "payloads", "seed"}
    np.testing.assert_array_equal(truth["gain"], run.truth.gain)
    assert truth["payloads"]["table_1"]["inertia"]["xx"] == 1.5


def test_rigs_that_cannot_be_simulated_are_refused() -> None:
    with pytest.raises(UnsupportedError, match="lowpass_hz"):
        simulate(rig_of(sensor={"lowpass_hz": 100}))
    with pytest.raises(UnsupportedError, match="workspace"):
        simulate(rig_of(limits={"workspace": [[-1, 1], [-1, 1], [-1, 1]]}))
    with pytest.raises(InputError, match="table_1"):
        simulate(rig_of(), payload="hammer")
    with pytest.raises(InputError, match="wrench_fraction"):
        simulate(rig_of(gravity=[0, 0, -9.81], limits={"wrench_fraction": 0.1}))


def test_default_motion_has_several_frequencies_on_every_axis() -> None:
    """What one-frequency motion would hide, this one shows; and some gains would not be known without it."""
    motion = default_trajectory(rig_of(plan={"duration": 20}))
    time = np.arange(0.0, 100 / 3, 0.01)  # a period
    power = np.abs(np.fft.rfft(motion.twist(time), axis=0)) ** 2
    power /= power.sum(axis=0)
    assert (np.sum(power > 0.05, axis=0) >= 6).all()
    used = [set(np.flatnonzero(axis > 1e-3).tolist()) for axis in power.T]
    assert not set.intersection(*used)
    for duration in (6.0, 10.0, 20.0):
        t = np.arange(0.0, duration, 0.01)
        nu, a = motion.twist(t), motion.acceleration(t)
        body = Body(50.0, np.array([0.2, 0, 0]), np.diag([1.5, 1.5, 0.4]))
        wrench = wrench_on_sensor(body, body.center_of_mass, nu, a, np.zeros((t.size, 3)))
        share = wrench / np.array([500.0] * 3 + [50.0] * 3)
        assert pose_share(t, nu, share).A < 0.5
        assert delay_share(t, share).share < 0.7


def test_default_motion_is_the_same_every_time() -> None:
    first, second = (default_trajectory(rig_of(plan={"duration": d})) for d in (4, 40))
    t = np.linspace(0, 4, 100)
    np.testing.assert_array_equal(first.twist(t), second.twist(t))
