"""A planned twist becomes files that an arm can be driven with, or a verdict that says why not."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from truewrench import robots
from truewrench.cli import main
from truewrench.io.plans import read_joint_plan
from truewrench.io.tables import write_table
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig, load_rig
from truewrench.planning.arm import unchecked_torques
from truewrench.planning.follow import follow_plan
from truewrench.robot.arm import Robot, robot_of


def plan(path: Path, size: float) -> Path:
    """A twist table of 4 s that starts and ends at rest."""
    time = np.linspace(0.0, 4.0, 161)
    names = ("vx", "vy", "vz", "wx", "wy", "wz")
    turns = (1, 2, 3, 2, 1, 3)
    twist = {n: size * np.sin(2 * np.pi * k * time / 4.0) for n, k in zip(names, turns, strict=True)}
    write_table(path, {"time_s": time, **twist})
    return path


def test_files_hold_the_joints_that_move_the_mass_as_planned(tmp_path: Path) -> None:
    rig = load_rig(robots.path("panda"))
    robot = robot_of(rig)
    followed = follow_plan(rig, plan(tmp_path / "plan.csv", 0.1), rate=50.0)
    assert followed.reasons == ()
    table, message = followed.write(tmp_path / "joints.csv")
    joints = read_joint_plan(table, robot.joints)  # whose derivatives it checks
    t = np.linspace(0.3, 3.7, 50)
    twist = np.einsum("kij,kj->ki", robot.jacobian(joints.position(t)), joints.velocity(t))
    lever = rig.payloads["default"].center_of_mass_array
    at_mass = twist[:, :3] + np.cross(twist[:, 3:], lever)
    wanted = 0.1 * np.sin(2 * np.pi * np.outer(t, [1, 2, 3, 2, 1, 3]) / 4.0)
    np.testing.assert_allclose(np.column_stack([at_mass, twist[:, 3:]]), wanted, atol=1e-3)
    points = yaml.safe_load(message.read_text(encoding="utf-8"))["points"]
    assert len(points) == 201
    np.testing.assert_allclose(points[100]["positions"], joints.position(np.array([2.0]))[0], atol=1e-12)


def test_a_plan_that_is_too_fast_is_written_with_a_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = plan(tmp_path / "plan.csv", 1.5)
    output = tmp_path / "joints.parquet"
    status = main(
        ["follow", str(robots.path("panda")), str(table), "-o", str(output), "--rate", "50", "--json"]
    )
    said = json.loads(capsys.readouterr().out)
    assert status == 3
    assert "the joints' limits cost" in said["verdict"]["reasons"][0]
    assert said["outputs"] == [str(output), f"{output}.trajectory.yaml"]
    assert all(Path(name).exists() for name in said["outputs"])
    followed = follow_plan(load_rig(robots.path("panda")), table, rate=50.0)
    limits = robot_of(load_rig(robots.path("panda"))).velocity
    assert (np.abs(followed.motion.velocity) <= limits * (1 + 1e-9)).all()
    path, _ = followed.write(tmp_path / "joints.csv")
    written = read_joint_plan(path, followed.robot.joints).velocity(followed.motion.time)
    over = [
        joint
        for joint, x in zip(followed.robot.joints, np.abs(written).max(0) / limits, strict=True)
        if x > 1.01
    ]
    assert over, "no case of what is told"
    for joint in over:
        assert any(f"the speed that `{joint}` may have" in reason for reason in followed.reasons)


def test_what_following_needs_is_asked_for(tmp_path: Path) -> None:
    rig = load_rig(robots.path("panda"))
    table = plan(tmp_path / "plan.csv", 0.1)
    with pytest.raises(InputError, match="no payload `tool`, expected one of: default"):
        follow_plan(rig, table, payload="tool")
    with pytest.raises(InputError, match="--rate: found 1 Hz for 4 s: 5 rows, expected at least 6"):
        follow_plan(rig, table, rate=1.0)
    outside = rig.motion.model_copy(update={"initial_position": (9.0, *rig.motion.initial_position[1:])})
    with pytest.raises(
        InputError, match=r"panda\.yaml: motion\.initial_position\[0\], joint `panda_joint1`: found 9"
    ):
        follow_plan(rig.model_copy(update={"motion": outside}), table)
    motion = rig.motion.model_copy(update={"initial_position": None})
    with pytest.raises(InputError, match=r"motion\.initial_position: found nothing"):
        follow_plan(rig.model_copy(update={"motion": motion}), table)


def test_limits_of_zero_are_none_and_torques_that_cannot_be_told_are_said(tmp_path: Path) -> None:
    """Many URDFs have them where nobody knew; an arm that may not move at all is none."""
    path = robots.path("ur10")
    rig = load_rig(path)
    assert rig.urdf_path is not None
    text = rig.urdf_path.read_text(encoding="utf-8")
    limited, unknown = robot_of(rig), re.sub(r'(velocity|effort)="[^"]*"', r'\1="0"', text)
    assert np.isfinite(limited.velocity).all()
    assert unchecked_torques(limited) == ()
    settings = rig.to_mapping()
    settings["motion"]["robot"]["urdf"] = "arm.urdf"

    def robot(urdf: str) -> Robot:
        (tmp_path / "arm.urdf").write_text(urdf, encoding="utf-8")
        return robot_of(Rig.from_mapping(settings, tmp_path / "rig.yaml"))

    free = robot(unknown)
    assert np.isinf(free.velocity).all()
    assert np.isinf(free.effort).all()
    assert unchecked_torques(free) == ()
    (said,) = unchecked_torques(
        robot(re.sub(r"<inertial>.*?</inertial>", "", text, count=3, flags=re.DOTALL))
    )
    assert "torques are not looked at" in said
