"""Joints of a recording are matched by name, each from one publisher."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bags import MS, START, Bag, write

from truewrench.io.tables import read_log
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of
from truewrench.robot.track import tracked


@pytest.fixture
def joint_rig(arm_rig: Callable[..., Rig]) -> Rig:
    return arm_rig("ur10")


def swing(names: tuple[str, ...], i: int) -> tuple[dict[str, float], dict[str, float]]:
    q = {name: 0.1 * np.sin(0.3 * i + j) for j, name in enumerate(names)}
    return q, {name: 30.0 * np.cos(0.3 * i + j) for j, name in enumerate(names)}


def joints_of(rig: Rig) -> tuple[str, ...]:
    return tuple(robot_of(rig).joints)


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_joints_are_matched_by_name_among_several_publishers(
    joint_rig: Rig, tmp_path: Path, kind: str
) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(60):
            stamp = START + 10 * i * MS
            bag.wrench("/ft", stamp, [i] * 6)
            q, dq = swing(names, i)
            order = names[::-1] if i % 2 else names
            bag.joints("/joint_states", stamp, {n: q[n] for n in order}, dq)
            bag.joints("/joint_states", stamp + MS, {"gripper": 0.5}, {"gripper": 0.0})

    log = read_log(write(tmp_path, kind, fill), joint_rig)
    assert log.position is not None
    assert log.velocity is not None
    assert len(log.time_ns) == 60
    for i in range(60):
        q, dq = swing(names, i)
        np.testing.assert_array_equal(log.position[i], list(q.values()))
        np.testing.assert_array_equal(log.velocity[i], list(dq.values()))


@pytest.mark.parametrize("fill_in", [None, np.nan])
def test_joints_without_velocities_are_positions_alone(
    joint_rig: Rig, tmp_path: Path, fill_in: float | None
) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(60):
            q = swing(names, i)[0]
            bag.wrench("/ft", START + 10 * i * MS, [i] * 6)
            dq = None if fill_in is None else dict.fromkeys(names, fill_in)
            bag.joints("/joint_states", START + 10 * i * MS, q, dq)

    settings = joint_rig.to_mapping()
    settings["motion"] |= {"position_noise": [1e-5] * len(names)}
    log = read_log(write(tmp_path, "mcap", fill), Rig.from_mapping(settings, joint_rig.path))
    assert log.velocity is None
    assert log.position is not None
    assert np.isfinite(log.position).all()


def test_joint_on_two_topics_is_ambiguous(joint_rig: Rig, tmp_path: Path) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(20):
            q, dq = swing(names, i)
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.joints("/joint_states", START + i * MS, q, dq)
            bag.joints("/joint_states_filtered", START + i * MS, q, dq)

    with pytest.raises(InputError, match=r"on several topics: /joint_states .*; /joint_states_filtered"):
        read_log(write(tmp_path, "mcap", fill), joint_rig)


def test_publishers_that_contradict_one_another_are_refused(joint_rig: Rig, tmp_path: Path) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(20):
            q, dq = swing(names, i)
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.joints("/joint_states", START + i * MS, q, dq)
            bag.joints("/joint_states", START + i * MS, {names[0]: 1.0}, dq)

    with pytest.raises(InputError, match=f"joint `{names[0]}` in messages with different sets of joints"):
        read_log(write(tmp_path, "mcap", fill), joint_rig)


@pytest.mark.parametrize("topics", [("/joint_states", "/joint_states"), ("/base/joints", "/wrist/joints")])
def test_parts_of_an_arm_are_interpolated_at_the_times_of_the_slower(
    joint_rig: Rig, tmp_path: Path, topics: tuple[str, str]
) -> None:
    names = joints_of(joint_rig)
    slow, fast = 5 * MS, 2 * MS

    def state(joints: tuple[str, ...], at: float) -> tuple[dict[str, float], dict[str, float]]:
        phase = {n: 3.0 * at + names.index(n) for n in joints}
        return {n: np.sin(p) for n, p in phase.items()}, {n: 3.0 * np.cos(p) for n, p in phase.items()}

    def fill(bag: Bag) -> None:
        for i in range(400):
            bag.wrench("/ft", START + i * slow, [i] * 6)
            bag.joints(topics[0], START + i * slow, *state(names[:3], 5e-3 * i))
        for i in range(1000):
            bag.joints(topics[1], START + i * fast + 7, *state(names[3:], 2e-3 * i + 7e-9))

    found = tracked(joint_rig, [read_log(write(tmp_path, "mcap", fill), joint_rig)])[0]
    assert any(f"at the times of {', '.join(names[:3])}" in note for note in found.notes)
    assert found.twist is not None
    rows = np.flatnonzero(np.isfinite(found.twist).all(axis=1))
    assert 395 <= rows.size <= 400
    at = found.time[rows]
    q, qd = np.array([[list(x.values()) for x in state(names, t)] for t in at]).swapaxes(0, 1)
    expected = robot_of(joint_rig).motion(q, qd, np.zeros_like(q)).twist
    np.testing.assert_allclose(found.twist[rows], expected, atol=1e-6)


def test_joint_that_is_missing_is_named_with_those_that_are_there(joint_rig: Rig, tmp_path: Path) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(5):
            q = swing(names, i)[0]
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.joints(
                "/joint_states", START + i * MS, {("elbow" if n == names[2] else n): q[n] for n in names}
            )

    with pytest.raises(
        InputError, match=rf"no samples of the joints {names[2]} \(joints in the recording: elbow, "
    ):
        read_log(write(tmp_path, "mcap", fill), joint_rig)
