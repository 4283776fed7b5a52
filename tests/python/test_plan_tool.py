"""Claims about `plan --tool`: poses far apart, in an order that drift cancels in, and an honest promise."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tool_cases import a_rig

from truewrench import robots
from truewrench.cli import main
from truewrench.estimation.static_poses import REPEATABILITY, WALK
from truewrench.io.plans import read_joint_plan, read_plan
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.rig import Rig, load_rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.planning.tool.collisions import collisions_of
from truewrench.planning.tool.directions import abba, spread, spread_among
from truewrench.planning.tool.plan import ToolPlan, plan_tool
from truewrench.robot.arm import robot_of
from truewrench.simulation.arm import simulate_plan
from truewrench.simulation.free_body import simulate
from truewrench.tool.identify import identify_tool
from truewrench.tool.parameters import ELEMENTS, channel_turn
from truewrench.tool.prior import MOUNTING_PRIOR, settings_of

Array = NDArray[np.float64]

TWISTS = {"limits": {"velocity": [1] * 6, "acceleration": [2] * 6}}


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


def an_arm(**changes: Any) -> Rig:
    path = robots.path("panda_ground")
    data = yaml.safe_load(path.read_text())
    for section, values in changes.items():
        data[section] = {**data[section], **values} if isinstance(values, dict) else values
    return Rig.from_mapping(data, path)


def twists(mass: float = 2.0, **changes: Any) -> Rig:
    """A sensor that turns on the spot."""
    body = {"mass": mass, "center_of_mass": [0, 0, 0.1], "inertia": {"xx": 0.01, "yy": 0.01, "zz": 0.01}}
    motion = {"source": "twist", "of": "sensor", "noise": [1e-3] * 6}
    return Rig.from_mapping(a_rig(**{**TWISTS, **changes}, payloads={"hand": body}, motion=motion))


@pytest.fixture(scope="module")
def planned() -> ToolPlan:
    return plan_tool(an_arm())


def tilt(directions: Array, axis: Array) -> Array:
    return np.asarray(np.arccos(np.clip(directions @ axis, -1.0, 1.0)))


@pytest.mark.parametrize("count", [4, 7, 12])
def test_directions_lie_on_the_rim_of_a_narrow_cone_evenly(count: int) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    found = spread(count, axis, 0.6)
    np.testing.assert_allclose(tilt(found, axis), 0.6, atol=1e-12)
    np.testing.assert_allclose(found.mean(axis=0), np.cos(0.6) * axis, atol=1e-12)


@pytest.mark.parametrize("count", [6, 12, 20])
def test_directions_over_the_sphere_come_in_opposite_pairs_as_far_apart_as_they_can(count: int) -> None:
    found = spread(count, np.array([0.0, 0.0, 1.0]), np.pi)
    cosine = found @ found.T
    np.testing.assert_allclose(cosine.min(axis=1), -1.0, atol=1e-9)
    nearest = np.arccos(np.sort(cosine, axis=1)[:, -2]).min()
    best = {6: np.pi / 2, 12: np.arctan(2.0), 20: 0.80}[count]  # octahedron, icosahedron, dodecahedron's 0.73
    assert nearest > 0.9 * best


def test_what_a_cone_more_than_half_open_does_not_hold_moves_to_its_rim() -> None:
    axis = np.array([0.0, 1.0, 0.0])
    assert tilt(spread(12, axis, 2.0), axis).max() == pytest.approx(2.0)


def test_a_drifting_offset_cancels_in_the_order_and_not_in_one_sorted_by_tilt() -> None:
    found = spread(12, np.array([0.0, 0.0, 1.0]), 0.8)
    sorted_by_x = found[np.argsort(found[:, 0])]
    time = np.arange(12) - 5.5

    def share_of_drift(directions: Array) -> float:
        """Of a linear drift, what looks like a weight in directions less their mean."""
        side = directions - directions.mean(axis=0)
        taken = np.linalg.lstsq(side, time, rcond=1e-9)[0]
        return float(np.sum((side @ taken) ** 2) / np.sum(time**2))

    order = abba(found)
    assert sorted(order) == list(range(12))
    pairs = found[order].reshape(6, 2, 3)
    np.testing.assert_allclose(np.einsum("kd,kd->k", *pairs.transpose(1, 0, 2)), np.cos(1.6), atol=1e-9)
    assert share_of_drift(found[order]) < 0.05
    assert share_of_drift(sorted_by_x) > 0.9


def test_farthest_of_what_is_reached_are_taken() -> None:
    arc = np.column_stack([np.sin(a := np.linspace(-1.0, 1.0, 41)), np.zeros(41), np.cos(a)])
    assert sorted(spread_among(arc, 3)) == [0, 20, 40]


def test_poses_stand_still_where_gravity_is_as_promised_by_pinocchio(
    planned: ToolPlan, tmp_path: Path
) -> None:
    assert planned.feasible, planned.violations
    files = planned.write(tmp_path / "plan.csv")
    robot = robot_of(planned.rig)
    motion = read_joint_plan(files[0], robot.joints)
    assert len(planned.dwells) == 12
    for (begin, end), fall in zip(planned.dwells, planned.fall, strict=True):
        inside = np.linspace(begin, end, 20)
        assert np.abs(motion.velocity(inside)).max() < 1e-4
        assert end - begin == pytest.approx(3.0)
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, motion.position(inside[-1:])[0])
        R_root_sensor = data.oMf[robot.frame_id].rotation
        np.testing.assert_allclose(R_root_sensor.T @ [0.0, 0.0, -1.0], fall, atol=1e-4)
    cosine = planned.fall @ planned.fall.T
    np.fill_diagonal(cosine, -1.0)
    assert np.degrees(np.arccos(cosine.max())) > 45.0
    np.testing.assert_allclose(np.einsum("kd,kd->k", planned.fall[::2], planned.fall[1::2]), -1.0, atol=0.01)


def test_joints_keep_to_their_limits_on_the_way(planned: ToolPlan) -> None:
    time = np.linspace(0.0, planned.design.motion.duration, 20001)
    motion, robot, limits = planned.design.motion, robot_of(planned.rig), planned.rig.limits
    q = motion.position(time)  # type: ignore[union-attr]
    assert ((q >= robot.lower - 1e-9) & (q <= robot.upper + 1e-9)).all()
    for values, most in (
        (motion.velocity(time), limits.velocity),  # type: ignore[union-attr]
        (motion.acceleration(time), limits.acceleration),
    ):
        assert (np.abs(values) <= np.array(most)).all()
    p = robot.pose(q[::20])[1]
    low, high = np.array(limits.workspace).T
    assert ((p >= low) & (p <= high)).all()


def test_a_joint_whose_velocity_is_0_stands_still() -> None:
    velocity = [*an_arm().limits.velocity]
    velocity[5] = 0.0
    motion = plan_tool(an_arm(limits={"velocity": velocity})).design.motion
    travel = np.ptp(motion.position(np.linspace(0.0, motion.duration, 500)), axis=0)
    assert travel[5] < 1e-8
    assert travel.max() > 0.5


def test_cone_is_kept_to(planned: ToolPlan) -> None:
    narrow = plan_tool(an_arm(), cone=np.radians(40.0), poses=8)
    assert narrow.prediction is not None
    assert planned.prediction is not None
    home = robot_of(narrow.rig).pose(np.array([narrow.rig.motion.initial_position]))[0][0]
    away = np.degrees(tilt(narrow.fall, home.T @ [0.0, 0.0, -1.0]))
    assert away.max() < 41.0
    assert away.min() > 30.0
    assert narrow.prediction.mass_std > planned.prediction.mass_std


def test_more_poses_and_a_heavier_tool_promise_more() -> None:
    def sigma(mass: float, poses: int) -> float:
        found = plan_tool(twists(mass=mass), poses=poses).prediction
        assert found is not None
        return found.mass_std / mass

    assert sigma(2.0, 16) < sigma(2.0, 8) < sigma(0.5, 8)


# A log of the planned dwells by another code: joints by Pinocchio's forward kinematics, the weight as a force
# of Pinocchio's, everything that is uncertain drawn from what the rig says of it.
@dataclass(frozen=True)
class Drawn:
    """A log, the offset at its end, and what is read there at rest where gravity points somewhere, (6,)."""

    log: Log
    offset: Array
    reading: Callable[[Array], Array]


def drawn_log(plan: ToolPlan, settings: Rig, seed: int) -> Drawn:
    rng, sensor, robot = np.random.default_rng(seed), settings.sensor, robot_of(plan.rig)
    spec = next(iter(plan.rig.payloads.values()))
    mass, center = spec.mass, spec.center_of_mass_array
    scale, span = sensor.channel_scale, sensor.range_array
    gain = sensor.nominal_gain_array + sensor.gain_prior * rng.normal(size=(6, 6)) * scale[:, None] / span
    turn = channel_turn(MOUNTING_PRIOR * rng.normal(size=3))[0]
    lean = Rotation.from_rotvec([*(settings.gravity_tilt_prior * rng.normal(size=2)), 0.0])
    data, body = robot.model.createData(), pin.Inertia(mass, center, np.zeros((3, 3)))

    def felt(R_root_sensor: Array) -> Array:
        fall = R_root_sensor.T @ lean.apply(settings.gravity_array)
        weight = (body * pin.Motion(fall, np.zeros(3))).vector  # I a: force and moment of free fall
        return np.asarray(gain @ np.concatenate([turn @ weight[:3], turn @ weight[3:]]))

    rate, walk, before = settings.simulate.sensor_rate, sensor.offset_prior_array * rng.normal(size=6), 0.0
    stamps, raw, positions = [], [], []
    for begin, end in [*plan.dwells, (plan.design.motion.duration, np.inf)]:
        if np.isinf(end):  # home again, where the log ends
            walk = walk + WALK * scale * np.sqrt(begin - before) * rng.normal(size=6)
            stamps.append([begin])
            raw.append(np.full((1, 6), np.nan))
            positions.append(positions[-1][-1:])
            continue
        middle = 0.5 * (begin + 1.0 + end)
        joints = plan.design.motion.position(np.array([middle]))[0]  # type: ignore[union-attr]
        pin.framesForwardKinematics(robot.model, data, joints)
        R_root_sensor = data.oMf[robot.frame_id].rotation.copy()
        walk = walk + WALK * scale * np.sqrt(middle - before) * rng.normal(size=6)
        before = middle
        stands = felt(R_root_sensor) + walk + REPEATABILITY * scale * rng.normal(size=6)
        time = begin + np.arange(round((end - begin) * rate) + 1) / rate
        stamps.append(time)
        raw.append(stands + sensor.noise_array * rng.normal(size=(time.size, 6)))
        positions.append(np.tile(joints, (time.size, 1)))
    stamps_ns = (np.concatenate(stamps) * 1e9).astype(np.int64)
    q = np.concatenate(positions)
    log = Log(None, "tool", "", stamps_ns, np.concatenate(raw), position=q, velocity=np.zeros_like(q))
    return Drawn(log, walk, lambda R: felt(R) + walk)


@pytest.mark.slow
def test_errors_of_tools_that_are_identified_are_as_large_as_the_plan_promised() -> None:
    """Thirty sensors, mountings, drifts, noises: 99.9% intervals of mean squares, contact wrenches too."""
    rig, squares = an_arm(simulate={"rate": 50, "sensor_rate": 50}), []
    plan, settings = plan_tool(rig), settings_of(rig)
    found = plan.prediction
    assert found is not None
    spec = plan.rig.payloads["default"]
    rng = np.random.default_rng(0)
    q = plan.design.motion.position(plan.dwells.mean(axis=1))  # type: ignore[union-attr]
    attitudes = robot_of(rig).pose(q)[0]
    for seed in range(30):
        drawn = drawn_log(plan, settings, seed)
        tool = identify_tool(rig, drawn.log)
        assert tool.verdict.usable, tool.verdict.reasons
        errors = [
            (tool.mass - spec.mass) / found.mass_std,
            *((tool.center_of_mass - spec.center_of_mass_array) / found.center_of_mass_std),
            *((tool.offset - drawn.offset) / found.offset_std),
        ]
        contact = []
        for R_root_sensor in attitudes:
            # 20 ms at 50 Hz: three samples by 1/4, 1/2, 1/4
            noise = settings.sensor.noise_array * np.sqrt(0.375) * rng.normal(size=6)
            w = np.linalg.solve(tool.gain, drawn.reading(R_root_sensor) + noise - tool.offset)
            R = channel_turn(tool.mounting)[0].T
            fall = R_root_sensor.T @ tool.gravity
            weight = tool.mass * np.concatenate([fall, np.cross(tool.center_of_mass, fall)])
            contact.append(np.concatenate([R @ w[:3], R @ w[3:]]) - weight)
        both = np.mean(np.square(contact), axis=0) / found.contact_std**2
        squares.append(np.concatenate([np.square(errors), both]))
    mean = np.mean(squares, axis=0)
    low, high = chi2.ppf([0.0005, 0.9995], 30) / 30
    assert ((mean > low) & (mean < high)).all(), mean


def test_twists_turn_the_sensor_to_where_gravity_is_promised(tmp_path: Path) -> None:
    """The table of twists, integrated by SciPy in small steps, against its own columns of gravity."""
    plan = plan_tool(twists(), poses=6)
    assert plan.feasible, plan.violations
    path = plan.write(tmp_path / "plan.csv")[0]
    motion = read_plan(path)
    table = np.genfromtxt(path, delimiter=",", names=True)
    stated = np.column_stack([table[name] for name in ("gx", "gy", "gz")])
    R, step, at = Rotation.identity(), 0.005, 0
    for k, begin in enumerate(np.arange(0.0, motion.duration, step)):
        while at < len(table) and table["time_s"][at] <= begin + 1e-9:
            expected = R.inv().apply([0.0, 0.0, -9.81])
            np.testing.assert_allclose(stated[at], expected, atol=0.02, err_msg=f"row {at}, step {k}")
            at += 1
        R = R * Rotation.from_rotvec(motion.twist(np.array([begin + 0.5 * step]))[0, 3:] * step)
    for (begin, end), fall in zip(plan.dwells, plan.fall, strict=True):
        rows = (table["time_s"] >= begin) & (table["time_s"] <= end)
        np.testing.assert_allclose(stated[rows] / 9.81, np.tile(fall, (rows.sum(), 1)), atol=1e-4)
        assert np.abs(motion.twist(np.linspace(begin, end, 20))).max() < 1e-4


def test_turns_of_a_twist_keep_to_the_limits_of_its_integral() -> None:
    limits = {**TWISTS["limits"], "position": [0.1] * 3 + [0.5] * 3}
    plan = plan_tool(twists(limits=limits))
    assert plan.feasible, plan.violations
    assert 0.35 < tilt(plan.fall, np.array([0.0, 0.0, -1.0])).max() <= 0.5


def test_a_plan_that_tilts_too_little_says_so_and_ends_in_3(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(a_rig(**TWISTS)))
    out = tmp_path / "plan.csv"
    assert run("plan", tmp_path / "rig.yaml", "--tool", "--cone", "4", "-o", out, "--json") == 3
    said = json.loads(capsys.readouterr().out)
    assert "directions of gravity: three at least" in said["verdict"]["reasons"][0]
    facts = yaml.safe_load((tmp_path / "plan.csv.plan.yaml").read_text())
    assert facts["feasible"] is False
    assert facts["violations"] == said["verdict"]["reasons"]
    assert all(Path(path).is_file() for path in said["outputs"])


def test_plan_of_a_rig_without_payloads_holds_what_the_contract_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(a_rig(**TWISTS)))
    assert run("plan", tmp_path / "rig.yaml", "--tool", "--poses", "8", "-o", tmp_path / "plan.csv") == 0
    words = capsys.readouterr().out
    assert words.startswith("FEASIBLE: 8 poses")
    assert "a tool of 1.5 kg is expected" in words
    facts = yaml.safe_load((tmp_path / "plan.csv.plan.yaml").read_text())
    assert np.shape(facts["predicted_gain_std"]) == (6, 6)
    assert 0.0 < facts["predicted_rms"] <= 0.0201
    assert facts["alpha"]["normalised"] >= 0.0
    assert len(facts["poses"]) == 8
    assert facts["predicted"]["inertia_std"] is None
    assert (tmp_path / "plan.csv.poses.png").is_file()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--tool", "--poses", "3"], "--poses: found 3, expected at least 4"),
        (["--tool", "--dwell", "1"], "--dwell: found 1, expected more than 1.5 s"),
        (["--tool", "--cone", "0"], "--cone: found 0, expected degrees"),
        (["--tool", "--payload", "hand"], "payloads: found no `hand`"),
        (["--tool", "--method", "wrench"], "--tool: found --method"),
        (["--cone", "30"], "--cone: found it without --tool"),
    ],
)
def test_bad_options_are_2_and_write_nothing(
    tmp_path: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(a_rig(**TWISTS)))
    assert run("plan", tmp_path / "rig.yaml", *options, "-o", tmp_path / "plan.csv") == 2
    assert words in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["rig.yaml"]


def test_a_calibration_in_place_of_its_rig_promises_what_its_covariance_allows(
    calibration: Calibration,
) -> None:
    rig = twists()
    covariance = calibration.covariance.copy()
    covariance[:36, :36] *= 0.01
    calibrated = replace(calibration, rig=rig, covariance=covariance)
    better, plain = plan_tool(calibrated, poses=6).prediction, plan_tool(rig, poses=6).prediction
    assert better is not None
    assert plain is not None
    assert better.mass_std < 0.5 * plain.mass_std
    assert better.contact_std[0] < 1.5 * plain.contact_std[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"poses": 3}, "--poses: found 3, expected at least 4 and at most 200"),
        ({"poses": 100_000}, "--poses: found 100000, expected at least 4 and at most 200"),
        ({"dwell": 1.5}, r"--dwell: found 1\.5, expected more than 1\.5 s"),
        ({"dwell": np.inf}, "--dwell: found inf, expected .* at most 600 s"),
        ({"dwell": np.nan}, "--dwell: found nan"),
        ({"cone": np.inf}, "--cone: found inf"),
    ],
)
def test_options_beyond_their_bounds_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan_tool(twists(), **options)


@pytest.mark.parametrize("motion", [True, False])
def test_a_plan_of_a_rig_without_of_says_that_another_command_reads_it_otherwise(motion: bool) -> None:
    stated = twists(plan={"duration": 4.0, "harmonics": 2})
    rig = stated.to_mapping()
    assert not any("motion.of" in note for note in plan_tool(stated, motion=motion).notes)
    del rig["motion"]["of"]
    notes = plan_tool(Rig.from_mapping(rig), motion=motion).notes
    assert any("state `motion.of: sensor`" in note for note in notes)


def test_a_plan_simulated_and_identified_with_one_rig_tells_the_tool() -> None:
    gains = {"gain": "nominal", "offset": "none"}
    rig = twists(simulate=gains)
    log = simulate(rig, plan_tool(rig, poses=8).design.motion, seed=1).log
    tool = identify_tool(rig, log)
    assert tool.verdict.usable
    np.testing.assert_allclose(tool.mass, 2.0, atol=4.0 * tool.mass_std)
    np.testing.assert_array_less(np.abs(tool.center_of_mass - [0, 0, 0.1]), 4.0 * tool.center_of_mass_std)


def test_an_imu_is_refused() -> None:
    motion = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
    with pytest.raises(UnsupportedError, match="`imu`, expected `twist` or `joints`"):
        plan_tool(Rig.from_mapping({**twists().to_mapping(), "motion": motion}))


def test_a_home_that_is_not_allowed_is_named() -> None:
    with pytest.raises(
        InputError, match=r"motion\.initial_position: .*expected sensor and tool within the workspace$"
    ):
        plan_tool(an_arm(limits={"workspace": [[0.2, 0.75], [0.3, 0.5], [0.2, 0.9]]}))


TWO_JOINTS = """<robot name="r"><link name="base"/><link name="a"/><link name="b"/><link name="ft"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/>
<origin xyz="0 0 0.4"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="50"/></joint>
<joint name="j2" type="continuous"><parent link="a"/><child link="b"/>
<origin xyz="0.3 0 0"/><axis xyz="{}"/></joint>
<joint name="j3" type="fixed"><parent link="b"/><child link="ft"/><origin xyz="0.3 0 0"/></joint></robot>"""


def two_joints(folder: Path, second_axis: str) -> Rig:
    (folder / "arm.urdf").write_text(TWO_JOINTS.format(second_axis))
    robot = {"urdf": "arm.urdf", "sensor_frame": "ft"}
    motion = {"source": "joints", "noise": [1e-3] * 2, "position_noise": [1e-4] * 2, "robot": robot}
    return tool_rig(a_rig(motion=motion), folder / "rig.yaml")


def test_what_is_reached_may_be_a_circle_and_no_cone(tmp_path: Path) -> None:
    """A wrist that only rolls: gravity goes around in one plane, and poses are spread over the circle."""
    plan = plan_tool(two_joints(tmp_path, "1 0 0"))
    assert plan.half_angle == 0.0
    assert len(plan.fall) == 12
    np.testing.assert_allclose(plan.fall[:, 0], 0.0, atol=1e-9)
    turn = np.sort(np.arctan2(plan.fall[:, 2], plan.fall[:, 1]))
    assert np.degrees(np.diff(np.append(turn, turn[0] + 2.0 * np.pi)).max()) < 65.0
    assert plan.feasible, plan.violations


def test_an_arm_that_cannot_tilt_is_told_so(tmp_path: Path) -> None:
    plan = plan_tool(two_joints(tmp_path, "0 0 1"))
    assert not plan.feasible
    assert "show 1 directions of gravity" in plan.violations[0]
    assert "stays within 0 deg of one direction" in " ".join(plan.notes)


# A box for the last link, and one on the root in the way of a pose.
BOX = '<collision><origin xyz="{}"/><geometry><box size="{}"/></geometry></collision>'
HAND = BOX.format("0 0 0.08", "0.06 0.2 0.06")
MESH = '<collision><geometry><mesh filename="package://no/hand.stl"/></geometry></collision>'


def with_boxes(folder: Path, wall: str) -> Rig:
    path = robots.path("panda_ground")
    urdf = path.with_name("panda.urdf").read_text()
    urdf = urdf.replace('<link name="panda_link0">', f'<link name="panda_link0">{wall}')
    urdf = urdf.replace('<link name="panda_link7">', f'<link name="panda_link7">{HAND}{MESH}')
    (folder / "panda.urdf").write_text(urdf)
    (folder / "rig.yaml").write_text(path.read_text())
    return load_rig(folder / "rig.yaml")


def corners(plan: ToolPlan) -> Array:
    """(N, 8, 3) of the hand's box, in the root, along the rows of a plan; the sensor is 0.107 m beyond."""
    robot = robot_of(plan.rig)
    rows = np.column_stack([plan.design.columns[f"q_{name}"] for name in robot.joints])
    R, p = robot.pose(rows)
    box = np.array([[x, y, z - 0.107] for x in (-0.03, 0.03) for y in (-0.1, 0.1) for z in (0.05, 0.11)])
    return np.asarray(p[:, None] + box @ R.transpose(0, 2, 1))


def test_links_that_would_touch_are_kept_apart_on_the_whole_way(tmp_path: Path) -> None:
    """Along every row the hand stays on this side of a wall through which it goes where there is none."""
    free = corners(plan_tool(an_arm(), poses=6)).reshape(-1, 8, 3)
    away = free.max(axis=(0, 1)) - free[0].max(axis=0)  # beyond where the hand is at home
    axis = int(np.argmax(away))
    beyond = float(free[0].max(axis=0)[axis] + 0.5 * away[axis])
    assert away[axis] > 0.05
    middle, size = [0.3, 0.0, 0.5], [3.0, 3.0, 3.0]
    middle[axis], size[axis] = beyond + 0.1, 0.2
    wall = BOX.format(" ".join(map(str, middle)), " ".join(map(str, size)))
    rig = with_boxes(tmp_path, wall)
    assert rig.urdf_path is not None
    touching = collisions_of(rig.urdf_path, robot_of(rig), np.array(rig.motion.initial_position))
    assert touching is not None
    assert touching.missing == ("package://no/hand.stl",)
    plan = plan_tool(rig, poses=6)
    assert "1 meshes of the URDF were not found" in " ".join(plan.notes)
    assert plan.feasible, plan.violations
    assert corners(plan)[..., axis].max() < beyond


def test_a_urdf_without_shapes_has_no_collisions() -> None:
    rig = an_arm()
    assert rig.urdf_path is not None
    assert collisions_of(rig.urdf_path, robot_of(rig), np.zeros(7)) is None


@pytest.mark.slow
def test_on_orbit_a_motion_is_planned_whose_promise_logs_of_mujoco_keep(tmp_path: Path) -> None:
    path = robots.path("panda")
    data = yaml.safe_load(path.read_text())
    data["plan"] = {"duration": 5, "harmonics": 3, "rate": 50}
    data["sensor"]["gain_prior"] = 0.02
    data["simulate"] |= {"rate": 100, "sensor_rate": 100}
    rig = Rig.from_mapping(data, path)
    plan = plan_tool(rig)
    assert plan.kind == "motion"
    assert plan.feasible, plan.violations
    assert "poses tell nothing: a motion is planned" in " ".join(plan.notes)
    found, (table, *_) = plan.prediction, plan.write(tmp_path / "plan.csv")
    assert found is not None
    assert found.inertia_std is not None
    spec = rig.payloads["default"]
    inertia = np.array([getattr(spec.inertia, name) for name in ELEMENTS])
    for seed in range(3):
        run = simulate_plan(rig, table, seed=seed)
        tool = identify_tool(rig, run.log)
        assert tool.verdict.usable, tool.verdict.reasons
        stated = np.concatenate([[tool.mass_std], tool.center_of_mass_std, tool.inertia_std])
        promised = np.concatenate([[found.mass_std], found.center_of_mass_std, found.inertia_std])
        np.testing.assert_allclose(stated, promised, rtol=0.35)
        error = [tool.mass - spec.mass, *(tool.center_of_mass - spec.center_of_mass_array)]
        error += list(tool.inertia - inertia)
        assert (np.abs(error) < 4.0 * promised).all(), np.array(error) / promised


def test_a_body_that_turns_far_keeps_to_its_limits_between_the_nodes() -> None:
    """Made smaller, this motion turns faster about x: it is planned anew within tighter limits."""
    limits = {"velocity": [0.38] * 3 + [2.49] * 3, "acceleration": [2.52] * 3 + [3.9] * 3}
    plan = {"duration": 6, "rate": 100, "harmonics": 3, "seed": 2}
    motion = {"noise": [1e-3] * 6}
    found = plan_tool(tool_rig(a_rig(limits=limits, plan=plan, motion=motion)), motion=True)
    assert found.violations == ()
