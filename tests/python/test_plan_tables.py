"""Claims about planned motions that are read from tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from truewrench.io.plans import joint_columns, read_joint_plan, read_plan
from truewrench.model.errors import InputError
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.motion.trajectory_joint import SplineJoints

JOINTS = ("shoulder", "wrist")


def write_plan(path: Path, acceleration_scale: float = 1.0) -> HarmonicTwist:
    one = np.ones((1, 6))
    motion = HarmonicTwist(0.2 * one, 0.4 * one, 0.0 * one, 5.0)
    t = np.arange(0, 5.0001, 0.025)
    rows = np.column_stack([t, motion.twist(t), acceleration_scale * motion.acceleration(t)])
    header = "time_s,vx,vy,vz,wx,wy,wz,ax,ay,az,alx,aly,alz"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return motion


def test_plan_is_followed_between_its_rows(tmp_path: Path) -> None:
    motion = write_plan(tmp_path / "plan.csv")
    plan = read_plan(tmp_path / "plan.csv")
    t = np.linspace(0, 5, 333)
    assert plan.duration == pytest.approx(5.0)
    np.testing.assert_allclose(plan.twist(t), motion.twist(t), atol=1e-7)
    np.testing.assert_allclose(plan.acceleration(t), motion.acceleration(t), atol=1e-4)


def test_plan_whose_acceleration_is_not_its_derivative_is_refused(tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.csv", acceleration_scale=9.81)
    with pytest.raises(InputError, match=r"plan\.csv: row \d+, column `a.*derivative of v"):
        read_plan(tmp_path / "plan.csv")


def test_plan_with_time_running_backwards_is_refused(tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.csv")
    lines = (tmp_path / "plan.csv").read_text().splitlines()
    lines[5], lines[6] = lines[6], lines[5]
    (tmp_path / "plan.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"time_s.*strictly increases"):
        read_plan(tmp_path / "plan.csv")


def joints_at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bumps t^3 (5 - t)^3 / 100 and half of it with its derivatives: at rest at both ends."""
    p = np.polynomial.Polynomial.fromroots([0, 0, 0, 5, 5, 5]) * -0.01
    return tuple(np.column_stack([f(t), 0.5 * f(t)]) for f in (p, p.deriv(), p.deriv(2)))  # type: ignore[return-value]


def write_joint_plan(path: Path, velocity_scale: float = 1.0) -> None:
    t = np.arange(0, 5.0001, 0.05)
    q, dq, ddq = joints_at(t)
    header = ",".join(["time_s", *(name for names in joint_columns(JOINTS) for name in names)])
    np.savetxt(
        path, np.column_stack([t, q, velocity_scale * dq, ddq]), delimiter=",", header=header, comments=""
    )


def test_planned_joints_are_followed_between_their_rows_and_rest_at_both_ends(tmp_path: Path) -> None:
    write_joint_plan(tmp_path / "plan.csv")
    plan = read_joint_plan(tmp_path / "plan.csv", JOINTS)
    t = np.linspace(0, 5, 333)
    for found, expected in zip(
        (plan.position(t), plan.velocity(t), plan.acceleration(t)), joints_at(t), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-5)
    ends = np.array([0.0, 5.0])
    assert np.abs(plan.velocity(ends)).max() < 1e-12
    assert np.abs(plan.acceleration(ends)).max() < 1e-10


def test_joints_are_taken_in_the_order_of_the_chain(tmp_path: Path) -> None:
    write_joint_plan(tmp_path / "plan.csv")
    plan = read_joint_plan(tmp_path / "plan.csv", JOINTS[::-1])
    middle = plan.position(np.array([2.5]))[0]
    assert middle[1] == pytest.approx(2 * middle[0])


def test_joint_velocities_in_degrees_are_refused(tmp_path: Path) -> None:
    write_joint_plan(tmp_path / "plan.csv", velocity_scale=57.3)
    with pytest.raises(InputError, match=r"column `dq_\w+`.*derivative of q_"):
        read_joint_plan(tmp_path / "plan.csv", JOINTS)


def test_missing_joint_is_named(tmp_path: Path) -> None:
    write_joint_plan(tmp_path / "plan.csv")
    with pytest.raises(InputError, match="q_elbow"):
        read_joint_plan(tmp_path / "plan.csv", ("shoulder", "elbow"))


def test_spline_without_derivatives_passes_through_its_positions() -> None:
    t = np.linspace(1.0, 3.0, 30)
    spline = SplineJoints.through(t, np.column_stack([np.sin(t), np.cos(t)]))
    assert spline.duration == 2.0
    np.testing.assert_allclose(spline.velocity(t - 1)[:, 0], np.cos(t), atol=1e-5)
