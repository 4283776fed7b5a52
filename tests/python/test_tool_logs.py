"""Logs of tools as drivers make them: a weight subtracted, a sensor that warms up, poses and motion mixed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from tool_cases import Array, a_rig, apart, as_imu, pose_log, swing_log, tour_log

import truewrench as tw
from truewrench.correction.contact.apply import apply_contact
from truewrench.estimation.static_poses import split_poses
from truewrench.io.tables import write_table
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.model.split import rows_of
from truewrench.robot.track import track
from truewrench.tool.identify import Evidence

MASS, CENTER = 2.0, np.array([0.01, -0.02, 0.09])
INERTIA = np.diag([0.012, 0.010, 0.006])
BELIEVED, ITS_CENTER = 0.8, np.array([0.0, 0.01, 0.05])  # what the driver takes for the tool
SUBTRACTED: dict[str, Any] = {"compensated": {"mass": BELIEVED, "center_of_mass": ITS_CENTER.tolist()}}
PLAIN = tool_rig(a_rig())
SLOPE = 2e-3  # of the offset, fraction of range per kelvin


def without_weight(log: Log) -> Log:
    """The log with the driver's weight taken off."""
    assert log.gravity is not None
    weight = BELIEVED * np.column_stack([log.gravity, np.cross(ITS_CENTER, log.gravity)])
    return replace(log, raw=log.raw - PLAIN.sensor.sign * weight)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("moving", [False, True])
def test_a_weight_that_the_driver_subtracted_is_part_of_the_tool(seed: int, moving: bool) -> None:
    log = (
        swing_log(PLAIN, MASS, CENTER, INERTIA, seed=seed)
        if moving
        else pose_log(PLAIN, MASS, CENTER, seed=seed)[0]
    )
    whole = tw.identify_tool(PLAIN, log)
    tool = tw.identify_tool(tool_rig(a_rig(sensor=SUBTRACTED)), without_weight(log))
    assert tool.verdict.usable
    sigma = 0.2 if moving else 1e-3  # a motion's clock is found with the weight that was there
    assert tool.mass == pytest.approx(whole.mass, abs=sigma * whole.mass_std)
    assert (np.abs(tool.center_of_mass - whole.center_of_mass) < sigma * whole.center_of_mass_std).all()


def warm(log: Log, temperature: Array) -> Log:
    drift = SLOPE * PLAIN.sensor.range_array * (temperature[:, None] - 25.0)
    return replace(log, raw=log.raw + drift, temperature=temperature)


@pytest.mark.parametrize("seed", range(3))
def test_an_offset_that_follows_the_temperature_is_no_walk(seed: int) -> None:
    log, _ = pose_log(PLAIN, MASS, CENTER, poses=30, seed=seed)
    heating = 25.0 + 15.0 * np.linspace(0.0, 1.0, 30) ** 0.5
    told = tool_rig(a_rig(temperature={"reference": 25, "prior": 3e-3}))
    tool, blind = tw.identify_tool(told, warm(log, heating)), tw.identify_tool(PLAIN, warm(log, heating))
    assert tool.verdict.usable
    assert abs(tool.mass - MASS) < 4.0 * tool.mass_std
    assert (np.abs(tool.center_of_mass - CENTER) < 4.0 * tool.center_of_mass_std).all()
    assert (tool.offset_walk < 0.3 * blind.offset_walk).all()


def test_poses_that_warm_up_and_a_motion_that_is_warm() -> None:
    poses, swing = pose_log(PLAIN, MASS, CENTER)[0], swing_log(PLAIN, MASS, CENTER, INERTIA)
    told = tool_rig(a_rig(temperature={"reference": 25, "prior": 3e-3}))
    logs = [warm(poses, np.linspace(25.0, 35.0, len(poses.raw))), warm(swing, np.full(len(swing.raw), 40.0))]
    tool = tw.identify_tool(told, logs)
    assert tool.verdict.usable
    assert abs(tool.mass - MASS) < 4.0 * tool.mass_std
    assert (np.abs(tool.center_of_mass - CENTER) < 4.0 * tool.center_of_mass_std).all()
    assert tool.determined["inertia"][0]


def test_moves_between_poses_walk_with_them() -> None:
    """One offset for all moves of half a minute was 7 sigma off."""
    squares = []
    for seed in range(6):
        log, offset = tour_log(PLAIN, MASS, CENTER, INERTIA, dwell=2.5, walk=3e-4, seed=seed)
        found: list[Evidence] = []
        tool = tw.identify_tool(PLAIN, log, evidence=found.append)
        assert tool.verdict.usable
        squares += [*((tool.center_of_mass - CENTER) / tool.center_of_mass_std) ** 2]
        squares += [
            ((tool.mass - MASS) / tool.mass_std) ** 2,
            *((tool.offset - offset) / tool.offset_std) ** 2,
        ]
        motion = found[0].motion
        assert motion is not None
        fit: Any = motion.found
        assert len(fit.fit.columns(0).ramps) == 13, "an offset where each of seven moves begins and ends"
    assert sum(squares) < chi2.ppf(1.0 - 1e-4, len(squares))


def dwelling_arm(rig: Rig, step: float = 0.0) -> Log:
    """Positions at 100 Hz of eight dwells of 2.5 s, and of 1.5 s from each to the next; nothing is held."""
    rng = np.random.default_rng(2)
    s = np.linspace(0.0, 1.0, 150)
    there = rng.uniform(-1.0, 1.0, (8, 6))
    q = [np.repeat(there[:1], 250, axis=0)]
    for a, b in pairwise(there):
        q += [a + (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * (b - a), np.repeat(b[None], 250, axis=0)]
    position = np.vstack(q) + 5e-5 * rng.normal(size=(8 * 250 + 7 * 150, 6))
    position = step * np.round(position / step) if step else position
    raw = rig.sensor.noise_array * rng.normal(size=position.shape)
    return Log(None, "tool", "", np.arange(len(raw)) * 10_000_000, raw, position=position)


@pytest.mark.parametrize("step", [0.0, 4e-4], ids=["noise", "steps of an encoder"])
def test_positions_alone_tell_where_an_arm_dwells(step: float) -> None:
    rig = tw.load_tool_rig(tw.robots.path("ur10_tool"))
    log = dwelling_arm(rig, step)
    dwells = 1.25e9 + 4.0e9 * np.arange(8) + 0.5e9 * (np.arange(8) > 0)  # a second of settling left out
    for split in (split_poses(rig, [one]) for one in (log, apart(log, 2_000_000))):
        assert len(split.poses) == 8
        np.testing.assert_allclose(split.poses.time_ns[1:], dwells[1:], atol=0.3e9)
        assert len(split.moves) == 1
        lasts = np.diff(split.moves[0].knots)[::2]
        assert lasts.size == 7
        assert ((lasts > 1.5) & (lasts < 3.3)).all()


def test_halves_of_an_arm_with_stamps_of_their_own_dwell_as_one() -> None:
    """As the legs of a humanoid: no row has all joints."""
    rig = tw.load_tool_rig(tw.robots.path("ur10_tool"))
    log = dwelling_arm(rig)
    assert log.position is not None
    first, later = log.position.copy(), log.position.copy()
    first[:, 3:], later[:, :3] = np.nan, np.nan
    stamps = np.concatenate([log.time_ns, log.time_ns + 3_000_000])
    order = np.argsort(stamps)
    raw = np.vstack([log.raw, np.full_like(log.raw, np.nan)])[order]
    halves = replace(log, time_ns=stamps[order], raw=raw, position=np.vstack([first, later])[order])
    whole, found = (split_poses(rig, [track(rig, one)]) for one in (log, halves))
    assert len(whole.poses) == len(found.poses) == 8
    np.testing.assert_allclose(found.poses.R_sensor_root, whole.poses.R_sensor_root, atol=1e-4)
    assert len(found.moves) == 1


@pytest.mark.parametrize("kind", ["tour", "swing"])
def test_topics_with_stamps_of_their_own_say_the_same(kind: str) -> None:
    """Of a recording the sensor's samples and those of the motion share no row."""
    if kind == "tour":
        log = tour_log(PLAIN, MASS, CENTER, INERTIA, dwell=2.5, walk=1e-4, seed=1)[0]
    else:
        log = swing_log(PLAIN, MASS, CENTER, INERTIA)
    plain, found = (tw.identify_tool(PLAIN, one) for one in (log, apart(log, 20_000)))
    assert found.verdict.usable
    body = plain.layout.body
    std = np.sqrt(np.diag(plain.covariance)[body])
    assert np.abs((found.theta - plain.theta)[body] / std).max() < 0.2


@pytest.mark.parametrize("data", ["poses", "motion", "both"])
def test_an_imu_tells_attitude_and_motion(data: str) -> None:
    motion = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
    rig = tool_rig(a_rig(motion=motion, sensor={"discrepancy": 0, "time_offset_prior": 0}))
    squares: list[float] = []
    for seed in range(6):
        log, _ = pose_log(rig, MASS, CENTER, seed=seed)
        still = np.zeros((len(log.raw), 6))
        logs = {
            "poses": as_imu(log, still, still, np.random.default_rng(seed)),
            "motion": swing_log(rig, MASS, CENTER, INERTIA, seed=seed),
        }
        tool = tw.identify_tool(rig, [log for name, log in logs.items() if data in (name, "both")])
        assert tool.verdict.usable
        squares += [*((tool.center_of_mass - CENTER) / tool.center_of_mass_std) ** 2]
        squares.append(((tool.mass - MASS) / tool.mass_std) ** 2)
    assert sum(squares) < chi2.ppf(1.0 - 1e-4, len(squares))


def test_an_imu_needs_no_gravity_and_no_row_that_it_shares_with_the_sensor() -> None:
    """Gyroscope, accelerometer and sensor each at stamps of its own, as a recording has them."""
    motion = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
    sensor = {"discrepancy": 0, "time_offset_prior": 0}
    rig = tool_rig(a_rig(motion=motion, sensor=sensor))
    log = swing_log(rig, MASS, CENTER, INERTIA)
    plain = tw.identify_tool(rig, log)
    count = len(log.time_ns)
    stamps = (log.time_ns[:, None] + np.array([0, 20_000, 40_000])).ravel()
    parts = {
        name: np.full((3 * count, getattr(log, name).shape[1]), np.nan)
        for name in ("raw", "angular_velocity", "specific_force")
    }
    for k, (name, values) in enumerate(parts.items()):
        values[k::3] = getattr(log, name)
    weightless = tool_rig(a_rig(motion=motion, sensor=sensor, gravity=[0.0, 0.0, 0.0]))
    found = tw.identify_tool(weightless, replace(log, time_ns=stamps, **parts))
    assert found.verdict.usable
    body = plain.layout.body
    std = np.sqrt(np.diag(plain.covariance)[body])
    assert np.abs((found.theta - plain.theta)[body] / std).max() < 0.3


def test_a_log_a_pose_is_one_log_of_poses_where_they_are_of_one_session() -> None:
    rig = tool_rig(a_rig(sensor={"pool_offsets": True}))
    log, offset = pose_log(rig, MASS, CENTER)
    whole = tw.identify_tool(rig, log)
    single = [rows_of(log, np.arange(len(log.time_ns)) == k) for k in range(len(log.time_ns))]
    for order in (single, single[::-1]):  # as a shell may name them
        tool = tw.identify_tool(rig, order)
        assert tool.verdict.usable
        assert tool.mass == pytest.approx(whole.mass, abs=0.2 * whole.mass_std)
        assert tool.mass_std == pytest.approx(whole.mass_std, rel=0.1)
        assert tool.offset_time_ns == log.time_ns[-1]
        assert (np.abs(tool.offset - offset) < 4.0 * tool.offset_std).all()
    alone = tw.identify_tool(tool_rig(a_rig()), single)  # with offsets of their own
    assert alone.mass_std > 5.0 * whole.mass_std


def test_poses_without_a_twist_are_told_what_would_do(tmp_path: Path) -> None:
    """A table of attitudes at rest, as people write them down: nothing moves, but nothing says so."""
    rig = tool_rig(a_rig())
    log, _ = pose_log(rig, MASS, CENTER)
    columns = {"time_ns": log.time_ns, **{f"raw_{i}": log.raw[:, i] for i in range(6)}}
    assert log.attitude is not None
    columns |= dict(zip(("qw", "qx", "qy", "qz"), log.attitude.T, strict=True))
    write_table(tmp_path / "poses.csv", columns)
    with pytest.raises(tw.InputError, match=r"0 in all of vx \.\.\. wz, if each row is a pose at rest"):
        tw.read_log(tmp_path / "poses.csv", rig)
    tool = tw.identify_tool(rig, log)
    with pytest.raises(tw.InputError, match=r"0 in all of vx \.\.\. wz, if each row is a pose at rest"):
        apply_contact(tool, tmp_path / "poses.csv", tmp_path / "out.csv")
