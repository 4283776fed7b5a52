"""Several logs of one tool agree by chance; a log of another tool, or of another sensor, is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2
from tool_cases import Array, a_rig, pose_log, swing_log, tour_log

import truewrench as tw
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.model.split import rows_of
from truewrench.tool.judge import CHANCE

MASS, CENTER = 2.0, np.array([0.01, -0.02, 0.09])
INERTIA = np.diag([0.012, 0.010, 0.006])
PLAIN = tool_rig(a_rig())
IMU = tool_rig(a_rig(motion={"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}))

Logged = Callable[[int, float, Array], Log]


def poses(seed: int, mass: float, center: Array) -> Log:
    return pose_log(PLAIN, mass, center, poses=12, seed=seed)[0]


def swing(seed: int, mass: float, center: Array) -> Log:
    return swing_log(PLAIN, mass, center, mass / MASS * INERTIA, seed=seed, seconds=5.0)


def imu(seed: int, mass: float, center: Array) -> Log:
    return swing_log(IMU, mass, center, mass / MASS * INERTIA, seed=seed, seconds=5.0)


PAIRS = pytest.mark.parametrize(
    ("rig", "first", "second"),
    [(PLAIN, poses, poses), (PLAIN, poses, swing), (PLAIN, swing, swing), (IMU, imu, imu)],
    ids=["poses", "poses and motion", "motion", "imu"],
)


@PAIRS
def test_logs_of_one_tool_agree(rig: Rig, first: Logged, second: Logged) -> None:
    for seed in range(2):
        tool = tw.identify_tool(rig, [first(seed, MASS, CENTER), second(seed + 50, MASS, CENTER)])
        assert tool.verdict.usable
        assert tool.figures["logs_agree"] > 1e-3


@PAIRS
@pytest.mark.parametrize(
    ("mass", "center", "gain"),
    [(1.03 * MASS, CENTER, 0.0), (MASS, CENTER + [0.004, 0.0, 0.0], 0.0), (MASS, CENTER, 0.02)],
    ids=["3% heavier", "4 mm off", "another gain"],
)
def test_a_log_of_another_tool_or_sensor_is_told(
    rig: Rig, first: Logged, second: Logged, mass: float, center: Array, gain: float
) -> None:
    """Each fits a body of its own, and both together one between, whose sigma knows of neither."""
    other = second(60, mass, center)
    span = rig.sensor.range_array
    turned = np.eye(6) + gain * np.random.default_rng(1).normal(size=(6, 6)) * span[:, None] / span
    tool = tw.identify_tool(rig, [first(1, MASS, CENTER), replace(other, raw=other.raw @ turned.T)])
    assert tool.figures["logs_agree"] < CHANCE
    assert not tool.verdict.usable
    assert any("one log and the other" in reason for reason in tool.verdict.reasons)


def test_the_log_that_stands_out_is_named() -> None:
    logs = [poses(k, 1.05 * MASS if k == 1 else MASS, CENTER) for k in range(3)]
    (reason,) = [x for x in tw.identify_tool(PLAIN, logs).verdict.reasons if x.startswith("Logs tell")]
    assert "log 2 and the others" in reason


def test_p_is_spread_evenly_where_all_is_well() -> None:
    p = [
        tw.identify_tool(PLAIN, [poses(2 * seed, MASS, CENTER), poses(2 * seed + 1, MASS, CENTER)]).figures[
            "logs_agree"
        ]
        for seed in range(30)
    ]
    for share in (0.2, 0.5, 0.8):
        low, high = binom.interval(1.0 - 1e-3, len(p), share)
        assert low <= np.count_nonzero(np.array(p) < share) <= high


@pytest.mark.parametrize("walk", [1e-4, 1e-3], ids=["ordinary", "restless"])
def test_a_tool_that_slips_between_poses_is_told_and_an_offset_that_walks_is_none(walk: float) -> None:
    for seed in range(4):
        log = pose_log(PLAIN, MASS, CENTER, poses=16, walk=walk, seed=seed)[0]
        assert tw.identify_tool(PLAIN, log).figures["halves_agree"] > 1e-4
        assert log.gravity is not None
        change = 2.0 * MASS * 0.1 * np.column_stack([log.gravity, np.cross(CENTER, log.gravity)])
        change[:8] = 0.0
        tool = tw.identify_tool(PLAIN, replace(log, raw=log.raw + PLAIN.sensor.sign * change))
        assert tool.figures["halves_agree"] < CHANCE
        assert any("first and the second half of the log" in x for x in tool.verdict.reasons)


def test_a_tool_that_slips_while_it_moves_is_told() -> None:
    """5 mm: the body found lay between, 4 to 6 of its sigma from either, and both halves told one gain."""
    for seed in range(3):
        log = swing_log(PLAIN, MASS, CENTER, INERTIA, seed=seed, seconds=12.0)
        assert tw.identify_tool(PLAIN, log).figures["halves_agree"] > 1e-4
        slipped = swing_log(PLAIN, MASS, CENTER + [0.005, 0.0, 0.0], INERTIA, seed=seed, seconds=12.0)
        raw = np.where(np.arange(len(log.raw))[:, None] < 600, log.raw, slipped.raw)
        tool = tw.identify_tool(PLAIN, replace(log, raw=raw))
        assert tool.figures["halves_agree"] < CHANCE
        assert not tool.verdict.usable


def test_a_tool_that_slips_between_few_poses_is_told_by_its_motion() -> None:
    """Six dwells are too few to be compared by halves, and kept the motion between them from it."""
    end, slip = 6 * 200 + 5 * 149, 3 * 200 + 2 * 149 + 75
    for seed in range(3):
        log, slipped = (
            tour_log(PLAIN, MASS, center, INERTIA, dwell=2.0, walk=1e-4, seed=seed)[0]
            for center in (CENTER, CENTER + [0.008, 0.0, 0.0])
        )
        assert tw.identify_tool(PLAIN, rows_of(log, slice(0, end))).figures["halves_agree"] > 1e-4
        raw = np.where(np.arange(len(log.raw))[:, None] < slip, log.raw, slipped.raw)
        tool = tw.identify_tool(PLAIN, rows_of(replace(log, raw=raw), slice(0, end)))
        assert tool.figures["halves_agree"] < CHANCE
        assert not tool.verdict.usable


def test_a_half_that_cannot_be_read_alone_is_no_agreement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truewrench.tool.agreement._motion", lambda *_, **__: None)
    tool = tw.identify_tool(PLAIN, swing(0, MASS, CENTER))
    assert tool.figures["halves_agree"] is None
    assert any("is not known, as a half" in need for need in tool.verdict.needed)


def test_two_motions_of_a_rod_agree() -> None:
    """No inertia about the long axis: gain and inertia, a product, must be linear about one body."""
    rod = np.diag([0.012, 0.012, 0.0])
    for seed in range(6):
        logs = [swing_log(PLAIN, MASS, CENTER, rod, seed=10 * seed + k, seconds=8.0) for k in (0, 1)]
        figures = tw.identify_tool(PLAIN, logs).figures
        assert min(figures["logs_agree"], figures["halves_agree"]) > 1e-4


def test_logs_of_one_session_share_their_offset_and_are_told_all_the_same() -> None:
    """The sizes of their walk are found with a body for each: with one for both they would grow."""
    rig = tool_rig(a_rig(sensor={"pool_offsets": True}))
    log = pose_log(rig, MASS, CENTER, poses=24, seed=3)[0]
    half = np.arange(24) < 12
    first, second = rows_of(log, half), rows_of(log, ~half)
    assert tw.identify_tool(rig, [first, second]).figures["logs_agree"] > 1e-3
    assert second.gravity is not None
    more = 0.1 * MASS * np.column_stack([second.gravity, np.cross(CENTER, second.gravity)])
    heavier = replace(second, raw=second.raw + rig.sensor.sign * more)
    assert tw.identify_tool(rig, [first, heavier]).figures["logs_agree"] < CHANCE


def test_logs_of_one_session_come_one_after_the_other() -> None:
    """Both begin at zero: no walk leads from one to the other."""
    rig = tool_rig(a_rig(sensor={"pool_offsets": True}))
    with pytest.raises(InputError, match=r"time: found a log that begins 88 s before another .* ends"):
        tw.identify_tool(rig, [poses(1, MASS, CENTER), poses(2, MASS, CENTER)])


def test_a_log_of_which_nothing_was_used_is_named() -> None:
    short = rows_of(swing(1, MASS, CENTER), slice(150))
    tool = tw.identify_tool(PLAIN, [poses(2, MASS, CENTER), short])
    assert tool.verdict.usable
    assert "log 2" in tool.verdict.needed[0]
    assert "neither a pose nor 2 s of motion" in tool.verdict.needed[0]


def test_a_log_in_other_units_than_the_others_is_refused() -> None:
    """In mN and N m / 1000, with a channel that is dead: what it tells is 10^6 times what the others do."""
    log = swing(1, MASS, CENTER)
    dead = replace(log, raw=1e3 * log.raw * [1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    for others in ([poses(2, MASS, CENTER)], [poses(2, MASS, CENTER), poses(3, MASS, CENTER)]):
        verdict = tw.identify_tool(PLAIN, [dead, *others]).verdict
        assert not verdict.usable
        assert len(verdict.reasons) > 1


def test_p_of_poses_is_that_of_two_textbook_fits() -> None:
    """Noise that hides walk and repeatability, an exact gain: weight, moment and offset are linear."""
    noise = [2.0, 2.0, 2.0, 0.1, 0.1, 0.1]
    rig = tool_rig(a_rig(sensor={"noise": noise, "gain_prior": 1e-9}))
    logs = [
        pose_log(rig, mass, CENTER, poses=14, walk=0.0, seed=seed)[0]
        for seed, mass in ((1, MASS), (2, 1.04 * MASS))
    ]
    tool = tw.identify_tool(rig, logs, mounting_sigma=0.0, tilt_sigma=1e-9)
    found, information = [], []
    for log in logs:
        assert log.gravity is not None
        A = np.zeros((len(log.raw), 6, 10))  # of m, m c and the offset
        A[:, :3, 0] = log.gravity
        for k, e in enumerate(np.eye(3)):
            A[:, 3:, 1 + k] = np.cross(e, log.gravity)
        A[:, :, 4:] = np.eye(6)
        A = (A / np.array(noise)[:, None]).reshape(-1, 10)
        y = (rig.sensor.sign * log.raw / noise).ravel()
        found.append(np.linalg.lstsq(A, y, rcond=None)[0][:4])
        information.append(np.linalg.inv(np.linalg.inv(A.T @ A)[:4, :4]))
    V = sum(np.linalg.inv(one) for one in information)
    away = found[0] - found[1]
    expected = chi2.sf(away @ np.linalg.solve(V, away), 4)
    assert 1e-6 < expected < 0.2
    assert np.log(tool.figures["logs_agree"]) == pytest.approx(np.log(expected), rel=0.1)
