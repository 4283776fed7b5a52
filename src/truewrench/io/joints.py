"""Which columns of a log tell how an arm moved: joints by name, and its base (docs/formats.md)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from truewrench.io.table import Table
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of

BASE_TWIST = ("base_vx", "base_vy", "base_vz", "base_wx", "base_wy", "base_wz")
BASE_ATTITUDE = ("base_qw", "base_qx", "base_qy", "base_qz")

_LENGTH = 1e-2  # by which that of a logged quaternion may differ from 1


def joint_groups(table: Table, rig: Rig) -> dict[str, tuple[str, ...]]:
    """Columns of `position` and `velocity`, in the order of the chain, `base_twist` and `base_attitude`.

    A group is there when one of its columns is, though others may be missing. Joints that do not move the
    sensor (a gripper's) are passed over. A stream is missing that the rig needs: InputError.
    """
    joints, motion = robot_of(rig).joints, rig.motion
    present = set(table.names)
    groups = {"position": tuple(f"q_{joint}" for joint in joints)}
    groups["velocity"] = tuple(f"dq_{joint}" for joint in joints)
    groups |= {"base_twist": BASE_TWIST, "base_attitude": BASE_ATTITUDE}
    found = {group: names for group, names in groups.items() if present.intersection(names)}

    def refuse(what: str, expected: str) -> InputError:
        return InputError.at(table.path, "header", what, expected)

    if "position" not in found and "velocity" not in found:
        return {"position": groups["position"]}  # of which all are missing
    if "position" not in found:
        if motion.noise is None:
            expected = "positions `q_*`, or the noise of velocities: `motion.noise` in the rig"
            raise refuse("joint velocities alone", expected)
        if motion.initial_position is None:
            expected = "positions `q_*`, or where the joints start: `motion.initial_position` in the rig"
            raise refuse("joint velocities alone", expected)
    if "velocity" not in found and motion.position_noise is None:
        expected = "velocities `dq_*`, or the noise of positions: `motion.position_noise` in the rig"
        raise refuse("joint positions alone", expected)
    if "base_twist" in found and "base_attitude" not in found and rig.in_gravity:
        raise without_attitude(table.path)
    return found


def without_attitude(path: str | Path | None) -> InputError:
    """What is wrong with a table, in gravity, of a base that moves without an attitude."""
    expected = "`base_qw` ... `base_qz` too: without them gravity has no direction"
    return InputError.at(path, "header", "`base_vx` ... `base_wz`, a base that moves", expected)


def check_attitude(
    attitude: Array,
    names: Sequence[str],
    path: str | Path | None,
    time_ns: Integers,
) -> None:
    """Refuse quaternions (N, 4), columns of these names, that are none; rows with NaN are passed over."""
    length = np.linalg.norm(attitude, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > _LENGTH)
    if len(wrong):
        i = int(wrong[0])
        place = f"columns `{names[0]}` ... `{names[-1]}`, time {time_ns[i]} ns"
        raise InputError.at(path, place, f"a quaternion of length {length[i]:.6g}", "length 1")
