"""An unknown tool is found with an honest sigma, and a set-up that is not as stated ends in its word."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from tool_cases import a_rig, pose_log, swing_log, tour_log

import truewrench as tw
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.model.split import rows_of
from truewrench.tool.judge import misfit_of_motion
from truewrench.tool.model import Tool

MASS, CENTER = 2.0, np.array([0.01, -0.02, 0.09])
INERTIA = np.array([[0.012, 5e-4, -3e-4], [5e-4, 0.010, 2e-4], [-3e-4, 2e-4, 0.006]])
RIG = tool_rig(a_rig())
STILL_AIR: dict[str, Any] = {"discrepancy": 0, "time_offset_prior": 0.0}


def within(tool: Tool, sigma: float = 4.0) -> bool:
    """Whether mass and centre of mass are where they claim to be."""
    return bool(
        abs(tool.mass - MASS) < sigma * tool.mass_std
        and (np.abs(tool.center_of_mass - CENTER) < sigma * tool.center_of_mass_std).all()
    )


def test_poses_tell_mass_center_and_offset_but_no_inertia() -> None:
    log, offset = pose_log(RIG, MASS, CENTER)
    tool = tw.identify_tool(RIG, log)
    assert tool.verdict.usable
    assert within(tool)
    assert tool.mass_std / MASS < 0.02
    assert (tool.center_of_mass_std < 3e-3).all()
    assert (np.abs(tool.offset - offset) < 4.0 * tool.offset_std).all()
    assert tool.determined["mass"]
    assert not any(tool.determined["inertia"])
    assert tool.exported.inertia_assumed
    words = " ".join(one.words for one in tool.verdict.undetermined)
    assert "The tool was not accelerated: its inertia is not known. Swing it at 1 rad/s for 5 s." in words
    assert "Mass and the sensor's force scale cannot be told apart" in words
    assert tool.offset_time_ns == log.time_ns[-1]


def test_held_out_poses_beat_the_recipe_where_the_offset_drifts() -> None:
    log, _ = pose_log(RIG, MASS, CENTER, poses=30, walk=1e-3)
    tool = tw.identify_tool(RIG, log)
    assert tool.held_out.force is not None
    assert tool.held_out.recipe_force is not None
    assert tool.held_out.force < 0.7 * tool.held_out.recipe_force
    assert tool.offset_walk / RIG.sensor.channel_scale == pytest.approx(1e-3, rel=0.5)
    assert any("The offset moved by" in one.words for one in tool.verdict.undetermined)


def test_motion_tells_the_inertia() -> None:
    rig = tool_rig(a_rig(sensor=STILL_AIR))
    tool = tw.identify_tool(rig, swing_log(rig, MASS, CENTER, INERTIA))
    assert tool.verdict.usable, tool.verdict.reasons
    assert within(tool)
    assert all(tool.determined["inertia"])
    truth = np.array([INERTIA[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
    assert (np.abs(tool.inertia - truth) < 4.0 * tool.inertia_std).all()
    assert (tool.inertia_std < 0.05 * INERTIA[0, 0]).all()
    assert not tool.exported.inertia_assumed


def test_filtered_noise_is_told_and_undone() -> None:
    rig = tool_rig(a_rig())
    log = swing_log(rig, MASS, CENTER, INERTIA, seconds=20.0)
    share = 1.0 - np.exp(-2.0 * np.pi * 14.0 / 100.0)  # 14 Hz, as `y += share * (x - y)` of a driver
    late = {k: lfilter([share], [1.0, share - 1.0], getattr(log, k), axis=0) for k in ("raw", "twist")}
    told = np.arange(100, len(log.time_ns))  # where the filter has forgotten its begin
    twist = rows_of(replace(log, twist=late["twist"]), told)
    raw = rows_of(replace(log, raw=late["raw"]), told)
    for filtered, column, advance in ((twist, "vx ... wz", 9e-3), (raw, "raw_*", -9e-3)):
        tool = tw.identify_tool(rig, filtered)
        assert tool.verdict.usable, tool.verdict.reasons
        assert within(tool)
        truth = np.array([INERTIA[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
        assert (np.abs(tool.inertia - truth) < 4.0 * tool.inertia_std).all()
        assert tool.time_offset == pytest.approx(advance, abs=3e-3)  # as it is logged
        assert [words.split(" looks")[0] for words in tool.figures["filters"]] == [f"the noise of {column}"]


def test_vibration_is_told_and_left_out() -> None:
    rig = tool_rig(a_rig())
    log = swing_log(rig, MASS, CENTER, INERTIA, seconds=20.0)
    wave = np.sin(2.0 * np.pi * 18.0 * log.time[:, None] + np.arange(rig.sensor.n))
    shaken = replace(log, raw=log.raw + 10.0 * rig.sensor.noise_array * wave)
    tool, plain = tw.identify_tool(rig, shaken), tw.identify_tool(rig, log)
    assert tool.verdict.usable, tool.verdict.reasons
    assert within(tool)
    assert [words.split(",")[0] for words in tool.figures["vibrations"]] == ["a vibration at 18 Hz"]
    assert plain.figures["vibrations"] == []
    (band,) = tool.vibrations
    assert band[0] == pytest.approx(18.0, abs=0.5)
    # medians of densities are taken, and of one frequency alone they are 4 / 3 of what they are of noise
    np.testing.assert_allclose(band[1:], 10.0 / np.sqrt(2.0) * rig.sensor.noise_array, rtol=0.2)
    assert len(plain.vibrations) == 0
    assert (tool.inertia_std < 1.2 * plain.inertia_std).all()


def test_poses_and_motion_together_are_better_than_either() -> None:
    rig = tool_rig(a_rig(sensor=STILL_AIR))
    swing, (poses, _) = swing_log(rig, MASS, CENTER, INERTIA), pose_log(rig, MASS, CENTER)
    both = tw.identify_tool(rig, [poses, swing])
    for alone in (tw.identify_tool(rig, poses), tw.identify_tool(rig, swing)):
        assert both.mass_std < alone.mass_std
        assert (both.center_of_mass_std < alone.center_of_mass_std).all()
    assert within(both)


def test_a_weighing_tells_the_mass() -> None:
    log, _ = pose_log(RIG, MASS, CENTER)
    tool = tw.identify_tool(RIG, log, known={"mass": (2.001, 0.001)})
    assert tool.mass_std < 1.01e-3
    assert abs(tool.mass - MASS) < 4e-3
    assert not any("force scale" in one.words for one in tool.verdict.undetermined)


def test_a_tight_gain_gives_a_tight_mass() -> None:
    rig = tool_rig(a_rig(sensor={"gain_prior": 1e-6, "noise": [0.01] * 3 + [1e-3] * 3}))
    log, _ = pose_log(rig, MASS, CENTER, walk=1e-6)
    tool = tw.identify_tool(rig, log, mounting_sigma=0.0, tilt_sigma=0.0)
    assert tool.mass == pytest.approx(MASS, rel=2e-3)
    assert tool.mass_std < 2e-3
    assert within(tool)


def test_what_follows_the_pose_is_in_sigma() -> None:
    """0.2% of range, half of it linear in the weight; of a gain that is known to 0.1% NEES was 3.8."""
    rig = tool_rig(a_rig(sensor={"gain_prior": 1e-3}))
    nees = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        log, _ = pose_log(rig, MASS, CENTER, seed=seed)
        assert log.gravity is not None
        down = log.gravity / 9.81
        linear = down @ rng.normal(size=(3, 6))
        bent = np.einsum("ni,ijk,nj->nk", down, rng.normal(size=(3, 3, 6)), down)
        bent -= bent.mean(axis=0)
        follows = (linear / linear.std(axis=0) + bent / bent.std(axis=0)) / np.sqrt(2.0)
        raw = log.raw + 2e-3 * rig.sensor.range_array * follows
        tool = tw.identify_tool(rig, replace(log, raw=raw), mounting_sigma=1e-6, tilt_sigma=1e-6)
        away = np.append(np.log(tool.mass / MASS), tool.center_of_mass - CENTER)
        told = slice(tool.layout.log_mass, tool.layout.log_mass + 4)
        nees.append(away @ np.linalg.solve(tool.covariance[told, told], away) / 4.0)
    assert np.mean(nees) < 1.5


def test_readings_in_other_units_are_named() -> None:
    log, _ = pose_log(RIG, MASS, CENTER)
    scale = np.array([50.0] * 3 + [1.0] * 3)
    verdict = tw.identify_tool(RIG, replace(log, raw=scale * log.raw)).verdict
    assert not verdict.usable
    assert "times its range: the units of `raw_" in verdict.reasons[0]


def test_an_overload_is_named() -> None:
    log, _ = pose_log(RIG, MASS, CENTER, poses=40)
    least, most = np.quantile(log.raw[:, 0], [0.3, 0.7])
    raw = log.raw.copy()
    raw[:, 0] = np.clip(raw[:, 0], least, most)
    verdict = tw.identify_tool(RIG, replace(log, raw=raw)).verdict
    assert not verdict.usable
    assert "overload" in verdict.reasons[0]


def test_a_workpiece_on_a_known_tool() -> None:
    """What was there before is subtracted, with its uncertainty."""
    before = tw.identify_tool(RIG, pose_log(RIG, MASS, CENTER)[0])
    whole, middle = 2.5, (MASS * CENTER + 0.5 * np.array([0.0, 0.0, 0.2])) / 2.5
    tool = tw.identify_tool(RIG, pose_log(RIG, whole, middle, seed=3)[0], on=before)
    assert abs(tool.mass - 0.5) < 4.0 * tool.mass_std
    assert tool.mass_std < 0.05
    assert (np.abs(tool.center_of_mass - [0.0, 0.0, 0.2]) < 4.0 * tool.center_of_mass_std).all()


def test_dwells_of_a_sampled_log_are_poses() -> None:
    rng = np.random.default_rng(5)
    R = Rotation.random(8, random_state=rng).as_matrix()
    poses, _ = pose_log(RIG, MASS, CENTER, attitudes=R, walk=0.0)
    assert poses.attitude is not None
    assert poses.gravity is not None
    count = 8 * 40
    time_ns = np.arange(count) * 100_000_000
    moving = np.arange(count) % 40 < 10  # a second of turning, three of rest
    twist = np.where(moving[:, None], 0.5, 0.0) * np.ones(6)
    rows = np.repeat(np.arange(8), 40)
    raw = poses.raw[rows] + rng.normal(size=(count, 6)) * RIG.sensor.noise_array
    raw[moving] = np.nan
    sampled = Log(
        None,
        "tool",
        "",
        time_ns,
        raw,
        twist=twist,
        gravity=poses.gravity[rows],
        attitude=poses.attitude[rows],
    )
    tool = tw.identify_tool(RIG, sampled)
    assert tool.logs[0]["poses"] == 8
    assert within(tool)


def turned(log: Log, quaternion: np.ndarray) -> Log:
    attitude = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).as_matrix()
    return replace(log, attitude=quaternion, gravity=attitude.transpose(0, 2, 1) @ RIG.gravity_array)


def _sign(log: Log) -> Log:
    return replace(log, raw=-log.raw)


def _swapped(log: Log) -> Log:
    return replace(log, raw=log.raw[:, [1, 0, 2, 4, 3, 5]])


def _quarter(log: Log) -> Log:
    """Channels turned by 90 deg about z, which a turn of the mounting explains and no gain shows."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return replace(log, raw=log.raw @ np.kron(np.eye(2), turn).T)


def _inverse(log: Log) -> Log:
    assert log.attitude is not None
    return turned(log, log.attitude * [1.0, -1.0, -1.0, -1.0])


def _subtracted(log: Log) -> Log:
    assert log.gravity is not None
    weight = MASS * np.column_stack([log.gravity, np.cross(CENTER, log.gravity)])
    return replace(log, raw=log.raw - weight)


def _equal(log: Log) -> Log:
    assert log.attitude is not None
    again = turned(log, np.repeat(log.attitude[:1], len(log.raw), axis=0))
    assert again.gravity is not None
    weight = MASS * np.column_stack([again.gravity, np.cross(CENTER, again.gravity)])
    noise = np.random.default_rng(0).normal(size=log.raw.shape) * RIG.sensor.noise_array
    return replace(again, raw=weight + noise)


def _in_root(log: Log) -> Log:
    """As drivers log it that turn the wrench to the base."""
    assert log.attitude is not None
    R_root_sensor = Rotation.from_quat(log.attitude[:, [1, 2, 3, 0]])
    return replace(
        log, raw=np.hstack([R_root_sensor.apply(log.raw[:, :3]), R_root_sensor.apply(log.raw[:, 3:])])
    )


def _two(log: Log) -> Log:
    assert log.gravity is not None
    assert log.attitude is not None
    assert log.twist is not None
    return replace(
        log,
        time_ns=log.time_ns[:2],
        raw=log.raw[:2],
        twist=log.twist[:2],
        gravity=log.gravity[:2],
        attitude=log.attitude[:2],
    )


def _touched(log: Log) -> Log:
    raw = log.raw.copy()
    raw[7, 0] += 5.0
    return replace(log, raw=raw)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        (_sign, "The gains would have to be 100 of their stated sigma away: sign"),
        (_swapped, "sign, axes or units of the log are not as stated"),
        (_inverse, "attitudes fit when taken the other way round"),
        (_in_root, "The wrench fits when turned from the root's axes"),
        (_subtracted, "a weight already subtracted"),
        (_equal, "directions of gravity"),
        (_two, "directions of gravity"),
        (_touched, "A contact during the poses"),
    ],
)
def test_what_is_not_as_stated_is_refused_with_its_word(wrong: Any, word: str, seed: int) -> None:
    tool = tw.identify_tool(RIG, wrong(pose_log(RIG, MASS, CENTER, seed=seed)[0]))
    assert not tool.verdict.usable
    assert word in " ".join(tool.verdict.reasons)


def test_a_tool_lighter_than_the_noise_is_no_tool() -> None:
    tool = tw.identify_tool(RIG, pose_log(RIG, 0.003, CENTER)[0])
    assert not tool.verdict.usable
    assert "lighter than the noise" in tool.verdict.reasons[0]


def test_an_offset_that_runs_is_refused() -> None:
    tool = tw.identify_tool(RIG, pose_log(RIG, MASS, CENTER, walk=2e-2, poses=40)[0])
    assert not tool.verdict.usable
    assert any("offset wanders" in reason for reason in tool.verdict.reasons)


def test_gravity_of_another_planet_is_bad_input() -> None:
    log, _ = pose_log(RIG, MASS, CENTER)
    assert log.gravity is not None
    moon = replace(log, gravity=log.gravity / 6.0, attitude=None)
    with pytest.raises(InputError, match=r"free fall of 1\.635 m/s\^2, expected 9\.81 m/s\^2"):
        tw.identify_tool(RIG, moon)


@pytest.mark.parametrize("rows", range(8))
def test_a_record_of_a_few_rows_is_no_tool(rows: int) -> None:
    log = swing_log(RIG, MASS, CENTER, INERTIA, seconds=0.2)
    kept = {f.name: getattr(log, f.name) for f in fields(log)}
    short = {name: v[:rows] for name, v in kept.items() if isinstance(v, np.ndarray)}
    try:
        verdict = tw.identify_tool(RIG, replace(log, **short)).verdict
    except InputError:
        return  # status 2
    assert not verdict.usable


def test_a_reading_far_beyond_the_range_is_bad_input() -> None:
    log, _ = pose_log(RIG, MASS, CENTER)
    log.raw[3, 2] *= 1e100
    with pytest.raises(InputError, match=r"times its range, expected .* within its range: units"):
        tw.identify_tool(RIG, log)


def test_degrees_are_bad_input() -> None:
    swing = swing_log(RIG, MASS, CENTER, INERTIA, seconds=3.0)
    assert swing.twist is not None
    with pytest.raises(InputError, match="degrees"):
        tw.identify_tool(RIG, replace(swing, twist=np.degrees(swing.twist)))


def test_degrees_of_a_slow_motion_are_told_by_the_attitude() -> None:
    """d/dt g = -Omega x g holds whatever the sensor, and at speeds that radians could have."""
    swing = swing_log(RIG, MASS, CENTER, INERTIA, seconds=4.0)
    assert swing.twist is not None
    slow = replace(swing, time_ns=10 * swing.time_ns, twist=0.1 * swing.twist)
    turned_by = np.hstack([slow.twist[:, :3], np.degrees(slow.twist[:, 3:])])  # type: ignore[index]
    with pytest.raises(InputError, match=r"wx wy wz: found 57\.\d times the attitude's rate"):
        tw.identify_tool(RIG, replace(slow, twist=turned_by))


def test_an_attitude_that_stays_while_the_tool_turns_is_bad_input() -> None:
    swing = swing_log(RIG, MASS, CENTER, INERTIA, seconds=3.0)
    assert swing.attitude is not None
    frozen = turned(swing, np.repeat(swing.attitude[:1], len(swing.raw), axis=0))
    with pytest.raises(InputError, match="a direction of gravity that stays while wx wy wz turn by"):
        tw.identify_tool(RIG, frozen)


@pytest.mark.parametrize("size", [0.5, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_push_that_a_walk_could_swallow_is_a_contact(seed: int, size: float) -> None:
    log, _ = pose_log(RIG, MASS, CENTER, poses=12, seed=seed)
    raw = log.raw.copy()
    raw[5] += size * np.array([4.0, -5.0, 8.0, 0.3, 0.2, -0.1])
    tool = tw.identify_tool(RIG, replace(log, raw=raw))
    assert "A contact during the poses, or a pose logged wrongly: 40 s" in " ".join(tool.verdict.reasons)


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"weight": (1.0, 0.1)}, "`weight`, expected one of mass"),
        ({"mass": (-1.0, 0.1)}, "found -1, expected a number greater than 0"),
        ({"mass": (1.0, 0.0)}, "a sigma of 0"),
    ],
)
def test_statements_that_cannot_be_right_are_bad_input(known: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        tw.identify_tool(RIG, pose_log(RIG, MASS, CENTER)[0], known=known)


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        (_sign, "sign, axes or units of the log are not as stated"),
        (_swapped, "sign, axes or units of the log are not as stated"),
        (_quarter, "axes"),
        (_subtracted, "a weight already subtracted"),
        (_inverse, "attitudes fit when taken the other way round"),
        (_in_root, "The wrench fits when turned from the root's axes"),
    ],
)
def test_a_motion_that_is_not_as_stated_is_refused_with_its_word(wrong: Any, word: str) -> None:
    rig = tool_rig(a_rig(sensor=STILL_AIR))
    tool = tw.identify_tool(rig, wrong(swing_log(rig, MASS, CENTER, INERTIA, seconds=6.0)))
    assert not tool.verdict.usable
    assert word in tool.verdict.reasons[0]


def test_an_attitude_that_turns_at_no_rate_is_no_pose() -> None:
    R = Rotation.random(8, random_state=np.random.default_rng(5)).as_matrix()
    log, _ = pose_log(RIG, MASS, CENTER, attitudes=R, walk=0.0)
    rows = np.repeat(np.arange(8), 60)
    assert log.attitude is not None
    assert log.gravity is not None
    sampled = Log(
        None, "tool", "", np.arange(480) * 50_000_000, log.raw[rows], twist=np.zeros((480, 6)),
        gravity=log.gravity[rows], attitude=log.attitude[rows],
    )  # fmt: skip
    with pytest.raises(InputError, match=r"an attitude that turns, .* while wx wy wz are 0"):
        tw.identify_tool(RIG, sampled)


def test_a_weighing_that_the_data_contradict_is_not_believed() -> None:
    log, _ = pose_log(RIG, MASS, CENTER, walk=0.0)
    assert tw.identify_tool(RIG, log, known={"mass": (MASS, 1e-3)}).verdict.usable
    wrong = tw.identify_tool(RIG, log, known={"mass": (0.8 * MASS, 1e-3)})
    assert not wrong.verdict.usable
    assert any("or what is known of the tool" in reason for reason in wrong.verdict.reasons)
    above = tw.identify_tool(RIG, log, on=wrong)
    assert above.verdict.reasons[0].startswith("The tool that it sits on is not to be used: ")


@pytest.mark.parametrize(
    "options",
    [
        {"housing": [-5.0, 0.0, 0.0, 0.0]},
        {"housing": [1.0, np.nan, 0.0, 0.0]},
        {"housing": [5.0, 1e200, 0.0, 0.0]},
        {"flange": [0.0, 0.0, 0.1]},
        {"mounting_sigma": np.nan},
        {"tilt_sigma": np.inf},
    ],
    ids=["lighter than nothing", "nan", "huge", "three", "nan sigma", "inf sigma"],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any]) -> None:
    log, _ = pose_log(RIG, MASS, CENTER, walk=0.0)
    with pytest.raises(InputError, match="expected"):
        tw.identify_tool(RIG, log, **options)


@pytest.mark.parametrize(("p", "told"), [(0.5, False), (1e-6, True), (np.nan, True)])
def test_parts_of_a_motion_that_disagree_or_cannot_be_compared_are_told(p: float, told: bool) -> None:
    motion: Any = SimpleNamespace(factors=(1.0,), slow=0.0, agreement=p, masked=0.0)
    assert bool(misfit_of_motion(motion)) is told


def test_what_shakes_dwells_is_told_to_the_contact_wrench() -> None:
    log, _ = tour_log(RIG, MASS, CENTER, INERTIA, dwell=4.0, walk=1e-4, seed=1)
    noise, hz = RIG.sensor.noise_array, 21.0
    std = np.array([3.0, 2.0, 1.0, 2.0, 1.0, 3.0]) * noise
    log = rows_of(log, (log.gravity == np.roll(log.gravity, 1, axis=0)).all(axis=1))  # of the dwells alone
    tone = np.sqrt(2.0) * std * np.sin(2.0 * np.pi * hz * log.time)[:, None]
    still = tw.identify_tool(RIG, log).vibrations
    assert (still[:, 1:] < 0.4 * noise).all()
    (band,) = tw.identify_tool(RIG, replace(log, raw=log.raw + tone)).vibrations
    assert band[0] == 0.0
    np.testing.assert_allclose(band[1:], np.cos(np.pi * hz * 0.01) * std, rtol=0.2)  # of means of two samples


def test_noise_beyond_the_stated_is_told_to_the_contact_wrench() -> None:
    rng, noise = np.random.default_rng(3), RIG.sensor.noise_array
    log = swing_log(RIG, MASS, CENTER, INERTIA, seconds=20.0)
    noisy = replace(log, raw=log.raw + 2.0 * noise * rng.normal(size=log.raw.shape))
    np.testing.assert_allclose(tw.identify_tool(RIG, log).sample_noise, noise, rtol=0.1)
    np.testing.assert_allclose(tw.identify_tool(RIG, noisy).sample_noise, np.sqrt(5.0) * noise, rtol=0.1)


def test_a_gain_that_is_hardly_believed_is_named_where_no_weight_is_felt() -> None:
    for prior, mass in ((0.3, MASS), (0.01, 0.005)):
        rig = tool_rig(a_rig(sensor={"gain_prior": prior}))
        tool = tw.identify_tool(rig, pose_log(rig, mass, CENTER)[0])
        (reason,) = [reason for reason in tool.verdict.reasons if "No weight is felt" in reason]
        loose = prior > 0.1
        assert (f"a gain that is believed to {100 * prior:.0f}%" in reason) == loose
        assert any("Calibrate the sensor first" in step for step in tool.verdict.needed) == loose
