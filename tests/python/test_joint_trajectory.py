"""A joint motion reaches ROS as the message that its YAML readers fill field by field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from truewrench.io.joint_trajectory import write_joint_trajectory
from truewrench.model.errors import InputError

JOINTS = ("SR", "on", "7")  # two that plain YAML would not take for text


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    time = 5.0 + np.array([0.0, 0.025, 1.0, 1.9999999999, 4.000000001])
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 5, 3))
    q[0, 0], qd[1, 1] = 1e-7, 0.0
    return time, q, qd, qdd


def test_message_holds_the_fields_of_trajectory_msgs(tmp_path: Path) -> None:
    time, q, qd, qdd = motion()
    path = tmp_path / "plan.trajectory.yaml"
    write_joint_trajectory(path, JOINTS, time, q, qd, qdd)
    message = yaml.safe_load(path.read_text(encoding="utf-8"))  # what ROS reads with
    assert list(message) == ["header", "joint_names", "points"]
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert message["joint_names"] == list(JOINTS)
    point_fields = {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    for k, point in enumerate(message["points"]):
        assert set(point) == point_fields
        assert point["effort"] == []
        for name, values in (("positions", q), ("velocities", qd), ("accelerations", qdd)):
            assert point[name] == values[k].tolist()
            assert all(type(x) is float for x in point[name])  # a sequence of float64 takes nothing else
    stamps = [(p["time_from_start"]["sec"], p["time_from_start"]["nanosec"]) for p in message["points"]]
    assert stamps == [(0, 0), (0, 25_000_000), (1, 0), (2, 0), (4, 1)]


def test_what_no_controller_could_follow_is_refused(tmp_path: Path) -> None:
    time, q, qd, qdd = motion()
    path = tmp_path / "plan.trajectory.yaml"
    with pytest.raises(InputError, match=r"time.*strictly increasing"):
        write_joint_trajectory(path, JOINTS, time[[0, 1, 1, 3, 4]], q, qd, qdd)
    with pytest.raises(InputError, match=r"velocities: found an array of shape \(5, 2\), expected \(5, 3\)"):
        write_joint_trajectory(path, JOINTS, time, q, qd[:, :2], qdd)
    qdd[2, 1] = np.nan
    with pytest.raises(InputError, match=r"accelerations, point 3, `on`"):
        write_joint_trajectory(path, JOINTS, time, q, qd, qdd)
    assert not path.exists()
