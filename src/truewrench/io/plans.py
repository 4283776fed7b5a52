"""Planned motions as tables, CSV or Parquet (docs/formats.md)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from truewrench.io.table import ACCELERATION, TWIST
from truewrench.io.tables import open_table, read_columns, require
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.motion.trajectory import SplineTwist
from truewrench.model.motion.trajectory_joint import SplineJoints

_FEWEST_ROWS = 6  # what a quintic spline needs
# of the largest: forgives a coarse table, not a wrong unit or the derivative in another frame
_TOLERANCE = 0.02


def read_plan(path: str | Path) -> SplineTwist:
    """Read the planned twist of a PLAN table: vx ... wz and, checked, ax ... alz, its derivative."""
    stated = any(name in open_table(path).names for name in ACCELERATION)
    time, data = _columns(path, TWIST + ACCELERATION if stated else TWIST)
    trajectory = SplineTwist.through(time, data[:, :6])
    if stated:
        derivative = trajectory.acceleration(time - time[0])
        _check_derivative(path, ACCELERATION, data[:, 6:], derivative, TWIST)
    return trajectory


def joint_columns(joints: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Names of the columns of positions, velocities and accelerations."""
    positions, velocities, accelerations = (
        tuple(f"{prefix}_{name}" for name in joints) for prefix in ("q", "dq", "ddq")
    )
    return positions, velocities, accelerations


def joint_table(joints: Sequence[str], time: Array, *motion: Array) -> dict[str, Array]:
    """Columns of a PLAN table: times (N,) [s], and positions, velocities and accelerations (N, n)."""
    table = {"time_s": time}
    for names, values in zip(joint_columns(joints), motion, strict=True):
        table |= dict(zip(names, values.T, strict=True))
    return table


def read_joint_plan(path: str | Path, joints: Sequence[str]) -> SplineJoints:
    """Read the planned joints of a PLAN table: q_NAME and, checked, dq_NAME and ddq_NAME, the derivatives.

    Names are in the order of the chain; further columns are not looked at.
    """
    positions, velocities, accelerations = joint_columns(joints)
    present = set(open_table(path).names)
    wanted = [positions, *(names for names in (velocities, accelerations) if present.intersection(names))]
    time, data = _columns(path, [name for names in wanted for name in names])
    blocks = dict(zip(wanted, np.hsplit(data, len(wanted)), strict=True))
    velocity, acceleration = blocks.get(velocities), blocks.get(accelerations)
    trajectory = SplineJoints.through(time, blocks[positions], velocity, acceleration)
    at = time - time[0]
    if velocity is not None:
        _check_derivative(path, velocities, velocity, trajectory.velocity(at), positions)
    if acceleration is not None:
        _check_derivative(path, accelerations, acceleration, trajectory.acceleration(at), velocities)
    return trajectory


def _columns(path: str | Path, names: Sequence[str]) -> tuple[Array, Array]:
    """Time (N,) [s] and the columns (N, len(names)), a number in every cell."""
    table = open_table(path)
    require(table, names)
    time_ns, columns, _ = read_columns(table, names)
    if len(time_ns) < _FEWEST_ROWS:
        raise InputError.at(path, "", f"{len(time_ns)} rows", f"at least {_FEWEST_ROWS}")
    data = np.column_stack([columns[name] for name in names])
    if np.isnan(data).any():
        row, column = np.argwhere(np.isnan(data))[0]
        raise InputError.at(
            path, f"row {row + 1}, column `{names[column]}`", "no number", "a number in every row"
        )
    return np.asarray(1e-9 * time_ns, dtype=np.float64), data


def _check_derivative(
    path: str | Path, names: Sequence[str], stated: Array, derivative: Array, of: Sequence[str]
) -> None:
    excess = np.abs(derivative - stated) - _TOLERANCE * np.abs(stated).max(axis=0) - 1e-6
    row, axis = map(int, np.unravel_index(np.argmax(excess), excess.shape))
    if excess[row, axis] > 0.0:
        place = f"row {row + 1}, column `{names[axis]}`"
        expected = f"{derivative[row, axis]:.6g}, the derivative of {of[axis]}"
        raise InputError.at(path, place, f"{stated[row, axis]:.6g}", expected)
