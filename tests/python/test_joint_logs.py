"""Joints are read by their names, whatever else a log holds, and what is missing is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from truewrench.inspection.log import inspect_log
from truewrench.io.tables import read_log
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.model.split import held_out, rows_of

CsvOf = Callable[..., Path]
Cells = dict[str, list[str]]

JOINTS = ("shoulder", "elbow", "wrist")
ARM = "<robot name='arm'><link name='base'/>{links}</robot>"
LINK = """<link name='{child}'/><joint name='{name}' type='revolute'>
<parent link='{parent}'/><child link='{child}'/>
<origin xyz='1 0 0'/><axis xyz='0 {y} 1'/><limit lower='-3' upper='3' velocity='1' effort='1'/></joint>"""


@pytest.fixture
def joint_settings(settings: dict[str, Any], tmp_path: Path) -> dict[str, Any]:
    parents = ("base", *JOINTS[:-1])
    links = "".join(
        LINK.format(name=name, parent=f"{parent}_link" if parent != "base" else parent,
                    child=f"{name}_link", y=i)
        for i, (name, parent) in enumerate(zip(JOINTS, parents, strict=True))
    )  # fmt: skip
    (tmp_path / "arm.urdf").write_text(ARM.format(links=links), encoding="utf-8")
    robot = {"urdf": "arm.urdf", "sensor_frame": "wrist_link"}
    settings["motion"] = {"source": "joints", "noise": [1e-4] * 3, "position_noise": [1e-5] * 3}
    settings["motion"]["robot"] = robot
    return settings


ROWS = 40


@pytest.fixture
def joint_cells() -> Cells:
    """Joints that swing, in an order of their own, a gripper between them."""
    time = 0.01 * np.arange(ROWS)
    columns: dict[str, np.ndarray] = {f"raw_{i}": np.cos(i + time) for i in range(6)}
    for name in ("dq_wrist", "q_elbow", "q_gripper", "q_wrist", "dq_elbow", "q_shoulder", "dq_shoulder"):
        prefix, _, joint = name.partition("_")
        phase = float(len(joint))
        columns[name] = np.sin(3 * time + phase) if prefix == "q" else 3 * np.cos(3 * time + phase)
    cells = {"time_ns": [str(10_000_000 * k) for k in range(ROWS)]}
    return cells | {name: [repr(float(x)) for x in values] for name, values in columns.items()}


RigOf = Callable[[dict[str, Any]], Rig]


def test_joints_come_in_the_order_of_the_chain(
    joint_settings: dict[str, Any], joint_cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    joint_cells["dq_elbow"][3] = ""
    log = read_log(csv_of(joint_cells), rig_of(joint_settings))
    assert log.position is not None
    assert log.velocity is not None
    for j, name in enumerate(JOINTS):
        np.testing.assert_array_equal(log.position[:, j], [float(x) for x in joint_cells[f"q_{name}"]])
        expected = [float(x or "nan") for x in joint_cells[f"dq_{name}"]]
        np.testing.assert_array_equal(log.velocity[:, j], expected)
    assert log.base_twist is None
    assert log.base_attitude is None
    assert log.nan_counts == {}


def test_inspect_tells_joints_and_base(joint_cells: Cells, csv_of: CsvOf) -> None:
    joint_cells["base_vx"] = ["0"] * ROWS
    content = inspect_log(csv_of(joint_cells))
    streams = {stream.name: [column.name for column in stream.columns] for stream in content.streams}
    assert set(streams["joint positions"]) == {"q_shoulder", "q_elbow", "q_wrist", "q_gripper"}
    assert set(streams["joint velocities"]) == {"dq_shoulder", "dq_elbow", "dq_wrist"}
    assert streams["base"] == ["base_vx"]
    assert content.unknown == ()


def without(cells: Cells, prefix: str) -> Cells:
    return {name: column for name, column in cells.items() if not name.startswith(prefix)}


def test_positions_alone_are_enough_when_their_noise_is_known(
    joint_settings: dict[str, Any], joint_cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    path = csv_of(without(joint_cells, "dq_"))
    log = read_log(path, rig_of(joint_settings))
    assert log.velocity is None
    assert log.position is not None
    del joint_settings["motion"]["position_noise"]  # positions are then exact, and say nothing of velocities
    with pytest.raises(InputError, match=r"run\.csv.*joint positions alone.*`motion\.position_noise`"):
        read_log(path, rig_of(joint_settings))


def test_velocities_alone_need_to_know_where_the_joints_start(
    joint_settings: dict[str, Any], joint_cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    path = csv_of(without(joint_cells, "q_"))
    with pytest.raises(InputError, match=r"joint velocities alone.*`motion\.initial_position`"):
        read_log(path, rig_of(joint_settings))
    joint_settings["motion"]["initial_position"] = [0.1, 0.2, 0.3]
    assert read_log(path, rig_of(joint_settings)).position is None
    del joint_settings["motion"]["noise"]
    with pytest.raises(InputError, match=r"joint velocities alone.*`motion\.noise`"):
        read_log(path, rig_of(joint_settings))


def test_a_missing_joint_names_the_nearest_column(
    joint_settings: dict[str, Any], joint_cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    joint_cells["q_elbw"] = joint_cells.pop("q_elbow")
    with pytest.raises(InputError, match=r"header: found no column `q_elbow` \(nearest: `q_elbw`\)"):
        read_log(csv_of(joint_cells), rig_of(joint_settings))


def test_a_log_without_joints_names_every_missing_one(
    joint_settings: dict[str, Any], cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    with pytest.raises(InputError, match=r"`q_shoulder`.*`q_elbow`.*`q_wrist`"):
        read_log(csv_of(cells), rig_of(joint_settings))


def test_lists_of_the_rig_are_held_against_the_joints_of_the_arm(
    joint_settings: dict[str, Any], joint_cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    joint_settings["motion"] |= {"noise": [1e-4] * 4, "position_noise": [1e-5] * 4}
    with pytest.raises(
        InputError, match=r"motion\.noise: found 4 entries, expected 3: .*shoulder, elbow, wrist"
    ):
        read_log(csv_of(joint_cells), rig_of(joint_settings))


def base(joint_cells: Cells) -> Cells:
    still = {f"base_{name}": ["0.5"] * ROWS for name in ("vx", "vy", "vz", "wx", "wy", "wz")}
    return joint_cells | still | {f"base_q{name}": ["0.5"] * ROWS for name in "wxyz"}


def test_a_base_that_moves_is_read_and_split_with_the_rest(
    joint_settings: dict[str, Any], joint_cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    log = read_log(csv_of(base(joint_cells)), rig_of(joint_settings))
    np.testing.assert_array_equal(log.base_twist, np.full((ROWS, 6), 0.5))
    np.testing.assert_array_equal(log.base_attitude, np.full((ROWS, 4), 0.5))
    some = rows_of(log, np.arange(ROWS) % 2 == 0)
    for name in ("position", "velocity", "base_twist", "base_attitude"):
        np.testing.assert_array_equal(getattr(some, name), getattr(log, name)[::2])
    assert held_out([log])[0][0] is log  # too short to be split


def test_a_base_that_turns_in_gravity_needs_its_attitude(
    joint_settings: dict[str, Any], joint_cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    joint_settings["gravity"] = [0, 0, -9.81]
    with pytest.raises(InputError, match="gravity has no direction"):
        read_log(csv_of(without(base(joint_cells), "base_q")), rig_of(joint_settings))
    spoilt = base(joint_cells)
    spoilt["base_qz"][4] = "0"
    with pytest.raises(InputError, match=r"time 40000000 ns: found a quaternion of length 0\.866"):
        read_log(csv_of(spoilt), rig_of(joint_settings))


def test_a_reference_needs_no_joints(
    joint_settings: dict[str, Any], cells: Cells, csv_of: CsvOf, rig_of: RigOf
) -> None:
    referenced = without(without(cells, "v"), "w")
    referenced |= {f"ref_{axis}": ["1"] * 10 for axis in ("fx", "fy", "fz", "mx", "my", "mz")}
    joint_settings["reference_noise"] = [1.0] * 6
    log = read_log(csv_of(referenced), rig_of(joint_settings))
    assert log.position is None
    assert log.reference is not None
