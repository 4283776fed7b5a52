"""Contact wrenches of rows that lack something: samples, headings, a base, sense."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contact_cases import Array, Swing, body_wrench, columns_of, raw_of, tilted, tool_of, unpacked
from scipy.spatial.transform import Rotation
from test_contact import HIT, all_of, stamps

from truewrench.correction.contact.run import ContactRun, View
from truewrench.model.errors import InputError
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.robot.arm import robot_of
from truewrench.tool.model import Tool


def test_a_missing_sample_of_the_motion_costs_nothing() -> None:
    tool, motion, time_ns = tool_of(6), Swing(), stamps(300)
    time = 1e-9 * time_ns
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, np.zeros(6))
    columns = columns_of(motion, time)
    for column in columns.values():
        column[[60, 100, 101, 200]] = np.nan
    run = ContactRun(tool, None)
    parts = [run.feed(time_ns[[k]], raw[[k]], {n: c[[k]] for n, c in columns.items()}) for k in range(300)]
    rows = np.concatenate([part.rows for part in [*parts, run.finish()]])
    assert rows.tolist() == list(range(5, 295))


def test_axes_of_the_root_only_where_the_heading_is_told() -> None:
    tool, motion, time_ns = tool_of(8), Swing(), stamps(200)
    time = 1e-9 * time_ns
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, HIT)
    columns = columns_of(motion, time)
    whole = all_of(ContactRun(tool, None, view=View(axes="base")), time_ns, raw, columns)
    g = np.einsum("kji,j->ki", motion.R(time), tool.rig.gravity_array)
    columns |= {name: g[:, k] for k, name in enumerate(("gx", "gy", "gz"))}
    for name in ("qw", "qx", "qy", "qz"):
        columns[name] = columns[name].copy()
        columns[name][:100] = np.nan
    found = all_of(ContactRun(tool, None, view=View(axes="base")), time_ns, raw, columns)
    assert sorted(found) == list(range(100, 195))
    # but for the tilt of gravity, which nothing tells of before the heading is known
    np.testing.assert_allclose(found[150][0], whole[150][0], atol=0.1)
    plain = all_of(ContactRun(tool, None), time_ns, raw, columns)
    assert sorted(plain) == list(range(5, 195))


def on_an_arm(base: str = "both") -> tuple[Tool, Array, Array, dict[str, Array]]:
    """A still base turned by 20 degrees under an arm that moves: tool, stamps, channels, columns."""
    rig = tool_of(0).rig.to_mapping()
    robot = {"urdf": str(Path(__file__).parents[2] / "src/truewrench/robots/ur10.urdf"), "sensor_frame": "ft"}
    rig["motion"] = {"source": "joints", "noise": [1e-4] * 6, "robot": robot}
    tool = replace(tool_of(11), rig=tool_rig(rig))
    arm, time_ns = robot_of(tool.rig), stamps(100)
    rate, phase = np.linspace(1.0, 3.0, arm.n), np.arange(arm.n)
    angle = rate * 1e-9 * time_ns[:, None] + phase
    q, qd, qdd = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
    moved, tilt_of_base = arm.motion(q, qd, qdd), Rotation.from_euler("x", 20.0, degrees=True)
    gain, mass, c, inertia, offset, R, tilt = unpacked(tool.theta)
    turned = tilt_of_base.as_matrix() @ moved.R_root_sensor
    g = np.einsum("kji,j->ki", turned, tilted(tool.rig.gravity_array, tilt))
    w = body_wrench(mass, c, inertia, moved.twist, moved.acceleration, g)
    raw = np.hstack([w[:, :3] @ R.T, w[:, 3:] @ R.T]) @ gain.T + offset
    columns = {f"q_{name}": q[:, k] for k, name in enumerate(arm.joints)}
    columns |= {f"dq_{name}": qd[:, k] for k, name in enumerate(arm.joints)}
    quaternion = np.roll(tilt_of_base.as_quat(), 1)
    if base in ("both", "attitude"):
        columns |= {f"base_q{axis}": np.full(100, quaternion[k]) for k, axis in enumerate("wxyz")}
    if base in ("both", "twist"):
        columns |= {f"base_{axis}": np.zeros(100) for axis in ("vx", "vy", "vz", "wx", "wy", "wz")}
    return tool, time_ns, raw, columns


def test_the_attitude_of_a_base_at_rest_counts() -> None:
    for base in ("both", "attitude"):
        tool, time_ns, raw, columns = on_an_arm(base)
        for names in ({"time_ns", *columns}, None):
            found = all_of(ContactRun(tool, names), time_ns, raw, columns)
            assert len(found) == 90
            assert max(np.abs(w[:3]).max() for w, *_ in found.values()) < 2e-2
    tool, time_ns, raw, columns = on_an_arm("twist")
    with pytest.raises(InputError, match="gravity has no direction"):
        ContactRun(tool, {"time_ns", *columns})
    assert not all_of(ContactRun(tool, None), time_ns, raw, columns)


def test_axes_of_the_base_are_the_arms_however_that_is_turned() -> None:
    """A base at 20 degrees: they are not those of gravity's frame, and no base that is told of is another."""
    tool, time_ns, raw, columns = on_an_arm()
    gain = unpacked(tool.theta)[0]
    raw = (
        raw + np.concatenate([unpacked(tool.theta)[5] @ HIT[:3], unpacked(tool.theta)[5] @ HIT[3:]]) @ gain.T
    )
    arm, still = robot_of(tool.rig), np.zeros(6)
    q = np.column_stack([columns[f"q_{name}"] for name in arm.joints])
    plain = all_of(ContactRun(tool, None), time_ns, raw, columns)
    for blocks in (1, 100):  # whole, and row by row
        run, found = ContactRun(tool, None, view=View(axes="base")), {}
        for part in np.array_split(np.arange(100), blocks):
            one = run.feed(time_ns[part], raw[part], {n: c[part] for n, c in columns.items()})
            found |= {int(row): one.wrench[i] for i, row in enumerate(one.rows)}
        assert len(found) > 80
        for row in (20, 50, 80):
            R = arm.motion(q[[row]], still[None], still[None]).R_root_sensor[0]
            expected = np.concatenate([R @ plain[row][0][:3], R @ plain[row][0][3:]])
            np.testing.assert_allclose(found[row], expected, atol=0.02 * np.abs(HIT).max())


def test_a_base_that_was_told_of_once_does_not_stop_where_a_row_leaves_it_out() -> None:
    tool, time_ns, raw, columns = on_an_arm()
    for name in columns:
        if name.startswith("base_"):
            columns[name][1::2] = np.nan
    run, found = ContactRun(tool, None), {}
    for k in range(100):
        part = run.feed(time_ns[[k]], raw[[k]], {n: c[[k]] for n, c in columns.items()})
        found.update({int(row): part.wrench[i] for i, row in enumerate(part.rows)})
    assert len(found) > 70
    assert max(np.abs(w[:3]).max() for w in found.values()) < 5e-2
    whole = all_of(ContactRun(tool, {"time_ns", *columns}), time_ns, raw, columns)
    assert set(found) <= set(whole)
    assert all((found[row] == whole[row][0]).all() for row in found)


def test_stamps_that_begin_again_and_what_cannot_be() -> None:
    tool, motion, time_ns = tool_of(6), Swing(), stamps(100, start=10**12)
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, 1e-9 * time_ns, np.zeros(6))
    columns, run = columns_of(motion, 1e-9 * time_ns), ContactRun(tool, None)
    first = run.feed(time_ns, raw, columns).rows
    run.restart()
    again = run.feed(time_ns - 10**12, raw, columns)
    assert (again.rows == first + 100).all()
    with pytest.raises(InputError, match="either side of zero"):
        run.feed(np.array([2**62]), raw[:1], {n: c[:1] for n, c in columns.items()})
    with pytest.raises(InputError, match="a quaternion of length 2"):
        run.feed(time_ns[:1], raw[:1], {n: 2.0 * c[:1] for n, c in columns.items()})
    # of such a size that there is no sigma: none is told
    raw[50, 0] = 1e200
    found = all_of(ContactRun(tool, None), time_ns, raw, columns)
    assert not {49, 50, 51} & set(found)
    assert all(np.isfinite(chi2) and np.isfinite(S).all() for _, S, chi2 in found.values())


def test_a_delay_of_more_samples_than_are_kept_is_refused() -> None:
    tool, motion, time_ns = tool_of(6), Swing(), np.arange(500, dtype=np.int64) * 50_000
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, 1e-9 * time_ns, np.zeros(6))
    run = ContactRun(tool, None, delay=1.0)
    run.feed(time_ns, raw, columns_of(motion, 1e-9 * time_ns))
    with pytest.raises(InputError, match="--delay"):
        run.finish()
