"""The contact wrench against its equations written out, other mechanics, and chance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_cases import Array, Swing, body_wrench, columns_of, raw_of, tilted, tool_of, unpacked
from scipy.spatial.transform import Rotation

from truewrench.correction.contact.log import contact
from truewrench.correction.contact.run import ContactRun, View
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.robot.arm import robot_of
from truewrench.tool.model import Tool

PERIOD = 2_000_000  # 500 Hz
HIT = np.array([30.0, -20.0, 34.0, 1.0, -0.5, 0.7])  # 50 N


def stamps(count: int, start: int = 0) -> Array:
    return start + PERIOD * np.arange(count, dtype=np.int64)


def all_of(run: ContactRun, time_ns: Any, raw: Array, columns: dict[str, Array]) -> dict[int, Any]:
    """Row number to wrench, covariance and chi2."""
    found: dict[int, Any] = {}
    for part in (run.feed(time_ns, raw, columns), run.finish()):
        for k, row in enumerate(part.rows):
            found[int(row)] = (part.wrench[k], part.covariance[k], part.chi2[k])
    return found


def kernels(n: int) -> tuple[Array, Array]:
    """Slope and mean weights of n samples, a period apart: the matched pair of the line."""
    dt = 1e-9 * PERIOD
    j = np.arange(n)
    slope = 12.0 * (j - (n - 1) / 2) / (n * (n * n - 1.0)) / dt
    j = np.arange(1, n)
    halves = 6.0 * j * (n - j) / (n * (n * n - 1.0))
    mean = np.zeros(n)
    mean[:-1] += 0.5 * halves
    mean[1:] += 0.5 * halves
    return slope, mean


def written_out(theta: Array, tool: Tool, raw: Array, motion: Swing, time: Array) -> Array:
    """The contact wrench of one window by the equations, sample by sample."""
    gain, mass, c, inertia, offset, R, tilt = unpacked(theta)
    slope, mean = kernels(len(time))
    nu = motion.twist(time)[0]
    g = np.einsum("kji,j->ki", motion.R(time), tilted(tool.rig.gravity_array, tilt))
    M = -np.column_stack(
        [
            body_wrench(mass, c, inertia, np.zeros((1, 6)), np.eye(6)[[k]], np.zeros((1, 3)))[0]
            for k in range(6)
        ]
    )
    q = -body_wrench(mass, c, inertia, nu, np.zeros_like(nu), g)
    inverse = np.linalg.inv(gain @ np.kron(np.eye(2), R))
    of_tool = M @ (slope @ nu) + mean @ q
    return np.asarray(inverse @ (mean @ raw - offset) + tool.rig.sensor.sign * of_tool)


@pytest.mark.parametrize("follows", [0.0, 1e-3], ids=["sound", "hysteresis"])
@pytest.mark.parametrize("feels", ["payload_on_sensor", "sensor_on_payload"])
def test_wrench_and_covariance_are_those_of_the_equations(feels: str, follows: float) -> None:
    tool = tool_of(1, sensor={"feels": feels})
    scale = tool.rig.sensor.channel_scale
    tool = replace(tool, pose_repeatability=np.hypot(2e-4, follows) * scale)
    time_ns, motion = stamps(60), Swing()
    time = 1e-9 * time_ns
    contact_wrench = np.array([5.0, -3.0, 2.0, 0.2, 0.1, -0.3])
    sign, gravity = tool.rig.sensor.sign, tool.rig.gravity_array
    raw = raw_of(tool.theta, sign, gravity, motion, time, contact_wrench)
    found = all_of(ContactRun(tool, None), time_ns, raw, columns_of(motion, time))
    assert sorted(found) == list(range(5, 55))
    window = slice(25, 36)
    wrench, covariance, chi2 = found[30]
    expected = written_out(tool.theta, tool, raw[window], motion, time[window])
    np.testing.assert_allclose(wrench, expected, rtol=0, atol=1e-12)
    assert np.abs(wrench - contact_wrench).max() < 2e-3
    J = np.empty((6, len(tool.theta)))
    for k in range(len(tool.theta)):
        step = np.zeros(len(tool.theta))
        step[k] = 1e-6
        ends = [written_out(tool.theta + s * step, tool, raw[window], motion, time[window]) for s in (1, -1)]
        J[:, k] = (ends[0] - ends[1]) / 2e-6
    gain, mass, c, inertia, _, R, _ = unpacked(tool.theta)
    inverse = np.linalg.inv(gain @ np.kron(np.eye(2), R))
    slope, mean = kernels(11)
    M = np.column_stack(
        [
            body_wrench(mass, c, inertia, np.zeros((1, 6)), np.eye(6)[[k]], np.zeros((1, 3)))[0]
            for k in range(6)
        ]
    )
    noise = tool.rig.sensor.noise_array**2 * (mean @ mean)
    noise = noise + tool.offset_walk**2 * time[30] + (follows * scale) ** 2
    dense = J @ tool.covariance @ J.T + inverse @ np.diag(noise) @ inverse.T
    dense += 1e-6 * (slope @ slope) * M @ M.T
    np.testing.assert_allclose(covariance, dense, rtol=2e-6, atol=1e-9)
    assert chi2 == pytest.approx(wrench @ np.linalg.solve(covariance, wrench), rel=1e-9)


@pytest.mark.parametrize(("hz", "most"), [(0.0, 1.1), (15.0, 1.15), (30.0, 1.3), (45.0, 2.0)])
def test_what_shakes_adds_to_sigma_what_the_kernel_leaves_of_it(hz: float, most: float) -> None:
    """At 500 Hz the kernel is longer by a sample than its 20 ms, and leaves less of what is fast."""
    std, tool, motion, time_ns = np.full(6, 0.05), tool_of(1), Swing(), stamps(1500)
    time = 1e-9 * time_ns
    still = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, np.zeros(6))
    phase = 2.0 * np.pi * max(hz, 1.0) * time[:, None]  # of dwells, whose frequency is 0: all that is slow
    shaking = still + np.sqrt(2.0) * std * np.sin(phase + np.arange(6.0))
    told = replace(tool, vibrations=np.append(hz, std)[None])
    runs = [
        all_of(ContactRun(one, None), time_ns, raw, columns_of(motion, time))
        for one, raw in ((tool, still), (tool, shaking), (told, shaking))
    ]
    rows = sorted(runs[0])[:1000]  # two seconds: whole periods
    moved = np.array([runs[1][k][0] - runs[0][k][0] for k in rows])
    added = np.mean([runs[2][k][1] - runs[1][k][1] for k in rows], axis=0)
    share = np.diag(added) / np.mean(moved**2, axis=0)
    assert (share > 0.95).all()
    assert (share < most).all()


def test_tool_alone_is_what_pinocchio_says() -> None:
    pin = pytest.importorskip("pinocchio")
    tool = replace(tool_of(2), mounting=np.zeros(3), tilt=np.zeros(2), gain=np.eye(6), offset=np.zeros(6))
    motion, time_ns = Swing(), stamps(40)
    time = 1e-9 * time_ns
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    _, mass, c, inertia, *_ = unpacked(tool.theta)
    model.appendBodyToJoint(joint, pin.Inertia(mass, c, inertia), pin.SE3.Identity())
    model.gravity.linear = tool.rig.gravity_array
    data = model.createData()
    nu, a = motion.twist(time)
    quaternions = Rotation.from_matrix(motion.R(time)).as_quat()
    raw = np.empty((40, 6))
    for k in range(40):
        q = np.concatenate([np.zeros(3), quaternions[k]])
        raw[k] = -pin.rnea(model, data, q, nu[k], a[k])
    found = all_of(ContactRun(tool, None), time_ns, raw, columns_of(motion, time))
    assert max(np.abs(w[:3]).max() for w, *_ in found.values()) < 2e-3  # of 20 N: linear between samples
    assert max(np.abs(w[3:]).max() for w, *_ in found.values()) < 2e-4


def nees(
    seed: int, contact_wrench: Array, *, tared: bool, delay: float = 0.01, heading: bool = True
) -> float:
    """(w - truth)^T Sigma^-1 (w - truth) / 6 of a record of a tool that is not quite the believed one.

    Without heading the record has gravity in sensor axes alone, and nobody knows the turn about it.
    """
    rng, tool = np.random.default_rng(seed), tool_of(seed)
    tool = replace(tool, time_offset_std=1e-3)
    if not heading:  # a base that stands aslant by 2 deg
        tool = replace(tool, tilt=0.035 * np.array([np.cos(seed), np.sin(seed)]))
    theta = rng.multivariate_normal(tool.theta, tool.covariance, method="cholesky")
    clock = 1e-3 * rng.normal()
    run = ContactRun(tool, None, delay=delay)
    drift = np.zeros(6)
    error = np.zeros(6)
    for part, (start, hit) in enumerate([(0, np.zeros(6)), (20_000_000_000, contact_wrench)]):
        if part == 0 and not tared:
            continue
        motion = Swing(start=Rotation.random(random_state=seed + part))
        time_ns = stamps(90, start)
        time = 1e-9 * (time_ns - start)
        drift = drift + tool.offset_walk * np.sqrt(20.0 if start else 0.09) * rng.normal(size=6)
        raw = raw_of(theta, 1, tool.rig.gravity_array, motion, time + clock, hit) + drift
        raw += rng.normal(size=raw.shape) * tool.rig.sensor.noise_array
        columns = columns_of(motion, time)
        for name in ("vx", "vy", "vz", "wx", "wy", "wz"):
            columns[name] = columns[name] + 1e-3 * rng.normal(size=90)
        if not heading:
            stated = tool.rig.gravity_array @ motion.R(time)
            columns = {name: values for name, values in columns.items() if not name.startswith("q")}
            columns |= dict(zip(("gx", "gy", "gz"), stated.T, strict=True))
        found = run.feed(time_ns, raw, columns)
        if part == 0:
            accepted, reason = run.tare()
            assert accepted, reason
            continue
        error = found.wrench[-1] - hit
        return float(error @ np.linalg.solve(found.covariance[-1], error)) / 6.0
    raise AssertionError


@pytest.mark.parametrize("tared", [False, True])
@pytest.mark.parametrize("hit", [0.0, 1.0])
def test_claimed_covariance_is_the_one_of_chance(tared: bool, hit: float) -> None:
    values = [nees(seed, hit * HIT, tared=tared) for seed in range(400)]
    # the mean of 400 has a sigma of 0.03
    assert 0.9 < np.mean(values) < 1.1
    inside = np.mean(np.array(values) * 6 < 12.592)  # 95% of chi-square with 6
    assert 0.92 < inside < 0.98


@pytest.mark.parametrize("tared", [False, True])
def test_claims_hold_where_the_turn_about_gravity_is_not_known(tared: bool) -> None:
    # a tilt of gravity was found about axes of the root, which another record without attitude does not have
    values = [nees(seed, np.zeros(6), tared=tared, heading=False) for seed in range(400)]
    assert 0.9 < np.mean(values) < 1.1


def test_claims_hold_without_delay() -> None:
    values = [nees(seed, HIT, tared=False, delay=0.0) for seed in range(400)]
    assert 0.9 < np.mean(values) < 1.1


def s_curves(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Velocity and acceleration (N, 3) of point-to-point moves with bounded jerk, at 500 Hz."""
    dt, a = 1e-9 * PERIOD, np.zeros((count, 3))
    for axis in range(3):
        at = int(rng.integers(0, 50))
        while at < count - 400:
            ramp, hold = int(rng.integers(25, 50)), int(rng.integers(20, 60))
            size = rng.choice([-1, 1]) * rng.uniform(2.5, 4.5)
            up = np.concatenate([np.linspace(0, size, ramp), np.full(hold, size), np.linspace(size, 0, ramp)])
            move = np.concatenate([up, np.zeros(int(rng.integers(0, 10))), -up])
            a[at : at + len(move), axis] = move
            at += len(move) + int(rng.integers(0, 20))
    v = np.cumsum((a + np.vstack([np.zeros(3), a[:-1]])) / 2, axis=0) * dt
    return v, a


def test_what_the_motion_alone_leaves_of_s_curves() -> None:
    rng = np.random.default_rng(5)
    tool = replace(
        tool_of(0, gravity=[0, 0, 0]),
        mounting=np.zeros(3),
        tilt=np.zeros(2),
        gain=np.eye(6),
        offset=np.zeros(6),
        center_of_mass=np.zeros(3),
    )
    count = 10_000
    v, a = s_curves(rng, count)
    raw = np.hstack([-tool.mass * a, np.zeros((count, 3))])
    noisy = v + 1e-3 * rng.normal(size=v.shape)
    columns = {name: noisy[:, k] for k, name in enumerate(("vx", "vy", "vz"))}
    columns |= {name: np.zeros(count) for name in ("wx", "wy", "wz")}
    found = all_of(ContactRun(tool, None), stamps(count), raw, columns)
    left = np.array([w[:3] for w, *_ in found.values()])
    inertial = np.sqrt((raw[:, :3] ** 2).mean())
    rms = np.sqrt((left**2).mean(axis=0))
    assert inertial > 4.0
    assert (rms < 0.10).all()


def test_tare_is_refused_in_contact_and_before_there_is_anything() -> None:
    tool, motion, time_ns = tool_of(3), Swing(), stamps(60)
    time = 1e-9 * time_ns
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, HIT)
    run = ContactRun(tool, None)
    assert run.tare() == (False, "there is no contact wrench yet, or none since the last tare")
    run.feed(time_ns, raw, columns_of(motion, time))
    accepted, reason = run.tare()
    assert not accepted
    assert "contact" in reason
    assert run.in_contact
    run.finish()
    (event,) = run.events()
    assert event.begin_ns == 5 * PERIOD
    assert event.end_ns == 54 * PERIOD
    assert event.peak_force == pytest.approx(np.linalg.norm(HIT[:3]), rel=1e-3)


def test_rows_in_blocks_give_the_same_bits() -> None:
    tool, motion, time_ns = tool_of(4), Swing(), stamps(200)
    time = 1e-9 * time_ns
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, HIT)
    columns = columns_of(motion, time)
    whole = all_of(ContactRun(tool, None), time_ns, raw, columns)
    run, by_row = ContactRun(tool, None), {}
    for k in range(200):
        part = run.feed(time_ns[k : k + 1], raw[k : k + 1], {n: c[k : k + 1] for n, c in columns.items()})
        by_row.update({int(r): part.wrench[i] for i, r in enumerate(part.rows)})
    assert len(by_row) == 190
    for row, wrench in by_row.items():
        assert (wrench == whole[row][0]).all()
    assert run.lag == 5


@pytest.mark.parametrize(("rate", "delay"), [(2000, 0.01), (8000, 0.01), (500, 0.05), (100, 0.5)])
def test_kernels_may_be_longer_than_what_tells_the_periods(rate: int, delay: float) -> None:
    tool, motion = tool_of(4), Swing(rate=0.5)
    time_ns = np.arange(600, dtype=np.int64) * (10**9 // rate)
    time = 1e-9 * time_ns
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, np.zeros(6))
    run, columns = ContactRun(tool, None, delay=delay), columns_of(motion, time)
    parts = [
        run.feed(time_ns[k : k + 7], raw[k : k + 7], {name: c[k : k + 7] for name, c in columns.items()})
        for k in range(0, 600, 7)
    ]
    half = round(delay * rate)
    rows = np.concatenate([part.rows for part in parts] + [run.finish().rows])
    assert run.lag == half
    assert rows.tolist() == list(range(half, 600 - half))


@pytest.mark.parametrize("kind", ["gap", "missing", "rates"])
def test_gaps_missing_samples_and_two_rates(kind: str) -> None:
    tool, motion, time_ns = tool_of(6), Swing(), stamps(300)
    time = 1e-9 * time_ns
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, np.zeros(6))
    columns = columns_of(motion, time)
    if kind == "gap":
        keep = np.r_[0:150, 170:300]
        time_ns, raw = time_ns[keep], raw[keep]
        columns = {name: column[keep] for name, column in columns.items()}
    if kind == "missing":
        raw[::7] = np.nan
    if kind == "rates":
        for column in columns.values():
            column[np.arange(300) % 4 != 0] = np.nan
    found = all_of(ContactRun(tool, None), time_ns, raw, columns)
    worst = max(np.abs(w[:3]).max() for w, *_ in found.values())
    assert worst < (0.05 if kind == "rates" else 5e-3)
    if kind == "gap":
        assert not {145, 149, 150, 154} & set(found)
        assert {144, 155} <= set(found)
    assert len(found) >= 260


@pytest.mark.parametrize("size", [4, 8, 16])
def test_samples_that_come_in_packets_have_their_wrench(size: int) -> None:
    """As of a serial adapter; by the stamps of receipt no row has one."""
    tool, motion, taken = tool_of(6), Swing(), stamps(1600)
    last = np.minimum((np.arange(1600) // size + 1) * size - 1, 1599)
    received = taken[last] + 20_000 * (1 + np.arange(1600) - last) + 1_000 * size
    time_ns = np.union1d(taken, received)
    columns = {name: np.full(time_ns.size, np.nan) for name in columns_of(motion, np.zeros(1))}
    for name, values in columns_of(motion, 1e-9 * taken).items():
        columns[name][np.searchsorted(time_ns, taken)] = values
    raw = np.full((time_ns.size, 6), np.nan)
    raw[np.searchsorted(time_ns, received)] = raw_of(
        tool.theta, 1, tool.rig.gravity_array, motion, 1e-9 * taken, np.zeros(6)
    )
    found = all_of(ContactRun(tool, None), time_ns, raw, columns)
    assert len(found) > 0.85 * time_ns.size
    assert max(np.abs(w[:3]).max() for row, (w, *_) in found.items() if row > 400) < 5e-2


def test_poses_are_filled() -> None:
    tool = tool_of(7)
    count = 6
    time_ns = np.arange(count, dtype=np.int64) * 4_000_000_000
    motion = Swing(rate=0.3)
    time = 1e-9 * time_ns
    gain, mass, c, inertia, offset, R, tilt = unpacked(tool.theta)
    g = np.einsum("kji,j->ki", motion.R(time), tilted(tool.rig.gravity_array, tilt))
    still = np.zeros((count, 6))
    w = body_wrench(mass, c, inertia, still, still, g)
    raw = np.hstack([w[:, :3] @ R.T, w[:, 3:] @ R.T]) @ gain.T + offset
    columns = columns_of(motion, time)
    for name in ("vx", "vy", "vz", "wx", "wy", "wz"):
        columns[name][:] = 0.0
    for delay in (0.01, 0.0):
        found = all_of(ContactRun(tool, None, delay=delay), time_ns, raw, columns)
        assert sorted(found) == list(range(count))
        assert max(np.abs(w).max() for w, *_ in found.values()) < 1e-10
    log = Log(
        None,
        "tool",
        "",
        time_ns,
        raw,
        twist=still,
        gravity=np.einsum("kji,j->ki", motion.R(time), tool.rig.gravity_array),
    )
    turned = contact(log, tool)  # by gravity alone: the turn about it is that of the smallest rotation
    assert np.abs(turned.wrench).max() < 0.3
    assert np.isfinite(turned.covariance).all()


def test_at_a_point_and_in_axes_of_the_root() -> None:
    tool, motion, time_ns = tool_of(8), Swing(), stamps(60)
    time = 1e-9 * time_ns
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, HIT)
    columns = columns_of(motion, time)
    plain = all_of(ContactRun(tool, None), time_ns, raw, columns)[30]
    at = (0.1, -0.2, 0.3, 0.2, 0.4, -0.6)
    point = np.array(at[:3])
    moved = all_of(ContactRun(tool, None, view=View(at)), time_ns, raw, columns)[30]
    R = Rotation.from_euler("xyz", at[3:]).as_matrix()
    force, moment = plain[0][:3], plain[0][3:] - np.cross(point, plain[0][:3])
    np.testing.assert_allclose(moved[0], np.concatenate([R.T @ force, R.T @ moment]), atol=1e-12)
    assert moved[0] @ np.linalg.solve(moved[1], moved[0]) == pytest.approx(plain[2], rel=1e-6)
    root = all_of(ContactRun(tool, None, view=View(axes="base")), time_ns, raw, columns)[30]
    np.testing.assert_allclose(root[0][:3], motion.R(time[[30]])[0] @ force, atol=1e-9)
    gravity_only = [name for name in columns if name not in ("qw", "qx", "qy", "qz")] + ["gx", "gy", "gz"]
    with pytest.raises(InputError, match="attitude"):
        ContactRun(tool, gravity_only, view=View(axes="base"))


def test_an_imu_and_temperature() -> None:
    tool = tool_of(9)
    motion, time_ns = Swing(), stamps(120)
    time = 1e-9 * time_ns
    rig = tool.rig.to_mapping()
    rig["motion"] = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
    slope = np.full(6, 0.05)
    tool = replace(tool, rig=tool_rig(rig), tilt=np.zeros(2), offset_temperature=slope)
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, np.zeros(6))
    warm = 25.0 + np.where(np.arange(120) < 60, 0.0, 4.0)
    raw += np.outer(warm - tool.rig.temperature.reference, slope)
    nu, a = motion.twist(time)
    g = np.einsum("kji,j->ki", motion.R(time), tool.rig.gravity_array)
    force = a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - g
    columns = {name: nu[:, 3 + k] for k, name in enumerate(("wx", "wy", "wz"))}
    columns |= {name: force[:, k] for k, name in enumerate(("accel_x", "accel_y", "accel_z"))}
    columns |= {"temperature": np.where(np.arange(120) % 10 == 0, warm, np.nan)}
    names = {"time_ns", *columns}
    found = all_of(ContactRun(tool, names), time_ns, raw, columns)
    assert len(found) == 110
    assert max(np.abs(w).max() for w, *_ in found.values()) < 5e-3


@pytest.mark.parametrize("block", [1, 7, 600])
def test_halves_of_an_imu_may_have_rows_of_their_own(block: int) -> None:
    """Sensor, accelerometer and gyroscope at 500, 250 and 125 Hz; row by row the same as all at once."""
    tool, motion = tool_of(9), Swing()
    rig = tool.rig.to_mapping()
    rig["motion"] = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
    tool = replace(tool, rig=tool_rig(rig), tilt=np.zeros(2))
    apart = [PERIOD * step * np.arange(600 // (3 * step)) + late for step, late in ((1, 0), (2, 1), (4, 2))]
    time_ns = np.unique(np.concatenate(apart))
    rows = [np.searchsorted(time_ns, each) for each in apart]
    time = 1e-9 * time_ns
    nu, a = motion.twist(time)
    g = np.einsum("kji,j->ki", motion.R(time), tool.rig.gravity_array)
    force = a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - g
    whole = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time, HIT)
    raw, read = np.full_like(whole, np.nan), np.full((len(time), 6), np.nan)
    raw[rows[0]], read[rows[1], :3], read[rows[2], 3:] = whole[rows[0]], force[rows[1]], nu[rows[2], 3:]
    columns = dict(zip(("accel_x", "accel_y", "accel_z", "wx", "wy", "wz"), read.T, strict=True))
    run, found = ContactRun(tool, {"time_ns", *columns}), []
    for first in range(0, len(time), block):
        part = slice(first, first + block)
        found.append(run.feed(time_ns[part], raw[part], {n: c[part] for n, c in columns.items()}))
    found.append(run.finish())
    wrench = np.vstack([part.wrench for part in found])
    assert len(wrench) > 180
    np.testing.assert_allclose(wrench, np.tile(HIT, (len(wrench), 1)), atol=0.1)


def test_of_an_imu_the_weight_a_driver_subtracted_comes_of_gravity_not_of_the_specific_force() -> None:
    tool, motion, time_ns = tool_of(9), Swing(rate=8.0), stamps(300)
    time, rig = 1e-9 * time_ns, tool.rig.to_mapping()
    rig["motion"] = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
    mass, center = 1.5, np.array([0.0, 0.01, 0.07])
    rig["sensor"]["compensated"] = {"mass": mass, "center_of_mass": center.tolist()}
    tool = replace(tool, rig=tool_rig(rig), tilt=np.zeros(2), time_offset=0.002)
    nu, a = motion.twist(time)
    g, shown = (np.einsum("kji,j->ki", motion.R(t), tool.rig.gravity_array) for t in (time, time + 0.002))
    weight = mass * np.hstack([shown, np.cross(center, shown)])
    raw = raw_of(tool.theta, 1, tool.rig.gravity_array, motion, time + 0.002, np.zeros(6)) - weight
    force = a[:, :3] + np.cross(nu[:, 3:], nu[:, :3]) - g
    columns = {name: nu[:, 3 + k] for k, name in enumerate(("wx", "wy", "wz"))}
    columns |= {name: force[:, k] for k, name in enumerate(("accel_x", "accel_y", "accel_z"))}
    with pytest.raises(InputError, match=r"gx gy gz or .* `sensor\.compensated` needs"):
        ContactRun(tool, {"time_ns", *columns})
    attitude = columns_of(motion, time)
    for told in (("gx", "gy", "gz"), ("qw", "qx", "qy", "qz")):
        by = dict(zip(told, g.T, strict=True)) if told[0] == "gx" else {name: attitude[name] for name in told}
        found = all_of(ContactRun(tool, {"time_ns", *columns, *by}), time_ns, raw, columns | by)
        assert len(found) > 280
        assert (
            max(np.abs(w).max() for w, *_ in found.values()) < 5e-3
        )  # 2 N and 0.1 N m by the specific force


def test_missing_columns_and_other_sensors_are_named() -> None:
    tool = tool_of(0)
    with pytest.raises(InputError, match="no column `wz`"):
        ContactRun(tool, ["time_ns", "vx", "vy", "vz", "wx", "wy", "qw", "qx", "qy", "qz"])
    with pytest.raises(InputError, match="nothing that tells it"):
        ContactRun(tool, ["time_ns", "vx", "vy", "vz", "wx", "wy", "wz"])
    with pytest.raises(InputError, match="--delay"):
        ContactRun(tool, None, delay=-1.0)


def test_joints_tell_the_motion_row_by_row() -> None:
    rig = tool_of(0).rig.to_mapping()
    robot = {"urdf": str(Path(__file__).parents[2] / "src/truewrench/robots/ur10.urdf"), "sensor_frame": "ft"}
    rig["motion"] = {"source": "joints", "noise": [1e-4] * 6, "robot": robot}
    tool = replace(tool_of(11), rig=tool_rig(rig))
    arm = robot_of(tool.rig)
    time_ns = stamps(100)
    time = 1e-9 * time_ns
    rate, phase = np.linspace(1.0, 3.0, arm.n), np.arange(arm.n)
    angle = rate * time[:, None] + phase
    q, qd, qdd = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
    moved = arm.motion(q, qd, qdd)
    gain, mass, c, inertia, offset, R, tilt = unpacked(tool.theta)
    g = np.einsum("kji,j->ki", moved.R_root_sensor, tilted(tool.rig.gravity_array, tilt))
    w = body_wrench(mass, c, inertia, moved.twist, moved.acceleration, g)
    raw = np.hstack([w[:, :3] @ R.T, w[:, 3:] @ R.T]) @ gain.T + offset
    columns = {f"q_{name}": q[:, k] for k, name in enumerate(arm.joints)}
    columns |= {f"dq_{name}": qd[:, k] for k, name in enumerate(arm.joints)}
    run = ContactRun(tool, {"time_ns", *columns}, view=View(axes="base"))
    found = all_of(run, time_ns, raw, columns)
    assert len(found) == 90
    assert max(np.abs(w[:3]).max() for w, *_ in found.values()) < 2e-2
    log = Log(None, "tool", "", time_ns, raw, position=q, velocity=qd)
    np.testing.assert_allclose(
        contact(log, tool, view=View(axes="base")).wrench[30], found[30][0], atol=1e-12
    )
