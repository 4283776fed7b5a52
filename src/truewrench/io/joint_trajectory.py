"""A joint motion as ROS takes it: `trajectory_msgs/msg/JointTrajectory`, in YAML (docs/formats.md)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.files import write_yaml


def write_joint_trajectory(
    path: str | Path,
    joints: Sequence[str],
    time: Array,
    position: Array,
    velocity: Array,
    acceleration: Array,
) -> None:
    """Write a joint motion as one message, with which `ros2 topic pub` and ROS's own YAML readers start.

    By convention the file is PLAN.trajectory.yaml. The first of the times (N,) [s] is at `time_from_start` 0;
    position, velocity and acceleration are (N, n). Refused: numbers that are not finite, and time that does
    not increase by at least a nanosecond.
    """
    columns = {"positions": position, "velocities": velocity, "accelerations": acceleration}
    for name, values in columns.items():
        if np.shape(values) != (len(time), len(joints)):
            found = f"an array of shape {np.shape(values)}"
            raise InputError.at(path, name, found, f"({len(time)}, {len(joints)}): points, joints")
        if not np.isfinite(values).all():
            point, joint = np.argwhere(~np.isfinite(values))[0]
            raise InputError.at(path, f"{name}, point {point + 1}, `{joints[joint]}`", "no number", "one")
    since = np.rint((np.asarray(time, dtype=np.float64) - time[0]) * 1e9)
    if not np.isfinite(since).all() or (np.diff(since) <= 0).any():
        raise InputError.at(path, "time", "time that does not increase", "strictly increasing seconds")
    points = [
        {name: np.asarray(values[k], dtype=np.float64).tolist() for name, values in columns.items()}
        | {"effort": [], "time_from_start": dict(zip(("sec", "nanosec"), divmod(ns, 10**9), strict=True))}
        for k, ns in enumerate(since.astype(np.int64).tolist())
    ]
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    write_yaml(path, {"header": header, "joint_names": list(joints), "points": points})
