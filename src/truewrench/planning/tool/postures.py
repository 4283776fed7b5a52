"""Postures of an arm in which gravity points where it is wanted in the sensor, within every limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.planning.buffered import Buffered
from truewrench.planning.joint_space import ArmOutputs, arm_outputs, joint_limits
from truewrench.planning.limits import SMALLEST, Limits
from truewrench.planning.tool.collisions import Collisions, collisions_of
from truewrench.planning.tool.directions import rim
from truewrench.robot.arm import Robot, planned_robot_of

_SAMPLES = 6000
_WRIST = 3  # last joints, which turn the tool; the others stay near where they are
_NEAR = 0.6  # [rad, m] of the others
_FAR = np.pi  # of the wrist from where it is: no more than half a turn
_WITHIN = np.radians(12.0)  # of a direction: a sample there says that it can be reached
_GRID = 24  # directions of a ring that is looked at
_COVERED = 0.95  # of a ring that is reached
_RING = np.radians(2.5)  # between rings
_FIRST_RING = np.radians(10.0)  # what is narrower is filled from the farthest on
_ALIGNED = np.radians(2.0)  # of a direction: a posture that shows it
_STEPS = 30
_KEPT = 8  # postures of one direction
_ROOM = 0.01  # of a joint's range that is left at both ends
_SPARE = 0.98  # of a limit that a posture may use: its neighbours on the way are not looked at one by one


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """What an arm may do while it stands."""

    rig: Rig  # the rig
    robot: Robot  # its arm
    limits: Limits  # of joints, workspace, clearance and wrench
    outputs: ArmOutputs  # what is limited, as a function of the joints
    collisions: Collisions | None  # of its links, None where the URDF states none
    home: Array  # (n,) where it begins

    @classmethod
    def of(cls, rig: Rig, payload: str) -> Stand:
        """Of a rig with an arm that carries a payload."""
        robot = planned_robot_of(rig)
        limits = joint_limits(rig, robot)
        stated = rig.motion.initial_position
        if stated is None:
            home = np.zeros(robot.n)
            bounded = np.isfinite(limits.lower) & np.isfinite(limits.upper)
            home[bounded] = 0.5 * (limits.lower[bounded] + limits.upper[bounded])
        else:
            home = np.array(stated)
        assert rig.urdf_path is not None  # it was read
        room = np.where(np.isfinite(limits.upper - limits.lower), _ROOM * (limits.upper - limits.lower), 0.0)
        lower, upper = np.minimum(limits.lower + room, home), np.maximum(limits.upper - room, home)
        lower, upper = np.maximum(lower, limits.lower), np.minimum(upper, limits.upper)
        still = limits.velocity <= SMALLEST
        limits = replace(limits, lower=np.where(still, home, lower), upper=np.where(still, home, upper))
        touching = collisions_of(rig.urdf_path, robot, home)
        return cls(rig, robot, limits, arm_outputs(rig, payload, robot), touching, home)

    def allowed(self, q: Array) -> Mask:
        """Whether every limit holds at rest, and nothing touches, in each of N postures (N, n)."""
        out = np.all(list(self.kept(q).values()), axis=0)
        if self.collisions is not None and out.any():
            at = np.flatnonzero(out)
            out[at] = ~self.collisions.touch(q[at])
        return np.asarray(out)

    def kept(self, q: Array) -> dict[str, Mask]:
        """Which limits hold, by what a person calls them."""
        rest = np.zeros_like(q).T
        wrench, every = (x.T for x in Buffered(self.outputs.function.map(len(q)))(q.T, rest, rest))
        share = _SPARE * self.limits.wrench / self.rig.sensor.range_array
        low, high = self.limits.workspace.T
        place = every[:, self.outputs.workspace].reshape(-1, 2, 3)
        torque, near = every[:, self.outputs.torque], every[:, self.outputs.distance]
        return {
            "joints within their limits": ((q >= self.limits.lower) & (q <= self.limits.upper)).all(axis=1),
            "a wrench within the sensor's range": (np.abs(wrench) <= share).all(axis=1),
            "sensor and tool within the workspace": ((place >= low) & (place <= high)).all(axis=(1, 2)),
            "torques within the joints' effort": (
                np.abs(torque) <= _SPARE * self.limits.torque[: torque.shape[1]]
            ).all(axis=1),
            "sensor and tool clear of the links": (near <= _SPARE * self.limits.clearance**-2.0).all(axis=1),
        }

    def fall(self, q: Array) -> Array:
        """Direction of gravity (N, 3) in the sensor."""
        R_root_sensor = self.robot.pose(q)[0]
        down = self.rig.gravity_array / np.linalg.norm(self.rig.gravity_array)
        return np.asarray(np.einsum("kji,j->ki", R_root_sensor, down))


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """What gravity can do in the sensor."""

    stand: Stand  # the arm
    samples: Array  # (M, n) postures within the limits
    fall: Array  # (M, 3) directions of gravity there
    axis: Array  # (3,) that at home
    half_angle: float  # [rad] of the widest cone about it whose rim is reached all around; 0 without any


def reach_of(stand: Stand, widest: float, seed: int) -> Reach:
    """The directions of gravity that an arm reaches, within a cone about that at home.

    `widest` is its half angle [rad]. The seed is of the postures that are tried. InputError: where the rig
    begins is not allowed.
    """
    rng, home, n = np.random.default_rng(seed), stand.home, stand.robot.n
    if not stand.allowed(home[None])[0]:
        missed = [words for words, holds in stand.kept(home[None]).items() if not holds[0]]
        expected = ", ".join(missed or ["links that do not touch"])
        raise InputError.at(stand.rig.path, "motion.initial_position", f"{home.tolist()}", expected)
    wrist = np.arange(n) >= n - _WRIST
    draws = [
        home + rng.uniform(-1.0, 1.0, (_SAMPLES, n)) * np.where(wrist, _FAR, room) for room in (0.0, _NEAR)
    ]
    q = np.concatenate(draws)
    q = np.clip(q, stand.limits.lower, stand.limits.upper)
    q = np.concatenate([home[None], q[stand.allowed(q)]])
    fall = stand.fall(q)
    axis = fall[0]
    inside = np.arccos(np.clip(fall @ axis, -1.0, 1.0)) <= widest + 1e-9
    q, fall = q[inside], fall[inside]
    return Reach(stand, q, fall, axis, _widest_ring(fall, axis, widest))


def _widest_ring(fall: Array, axis: Array, widest: float) -> float:
    """Half angle of the widest cone that is reached all around at every angle up to its own."""
    best, away = 0.0, np.arccos(np.clip(fall @ axis, -1.0, 1.0))
    for angle in np.arange(_FIRST_RING, min(widest, np.pi) + 1e-9, _RING):
        near = min(_WITHIN, 0.5 * float(angle))
        count = max(4, round(_GRID * float(np.sin(angle)))) if angle > 0.5 * np.pi else _GRID
        ring = rim(axis, float(angle), count)
        # samples on the near side of a ring do not tell that it is reached
        outside = away >= angle - _RING
        if not outside.any() or np.mean((ring @ fall[outside].T).max(axis=1) >= np.cos(near)) < _COVERED:
            break
        best = float(angle)
    return best


def postures_towards(reach: Reach, direction: Array) -> Array:
    """(K, n) postures in which gravity points along a unit vector (3,), the nearest to home first."""
    stand, home = reach.stand, reach.stand.home
    away = np.arccos(np.clip(reach.fall @ direction, -1.0, 1.0))
    travel = np.abs(reach.samples - home).max(axis=1)
    near = np.flatnonzero(away <= 2.0 * _WITHIN)
    starts = near[np.argsort(travel[near] + 2.0 * away[near])][: 4 * _KEPT]
    if not starts.size:
        return np.empty((0, stand.robot.n))
    found = np.array([_turned(stand, reach.samples[k], direction) for k in starts])
    left = np.arccos(np.clip(stand.fall(found) @ direction, -1.0, 1.0))
    found = found[(left <= _ALIGNED) & stand.allowed(found)]
    found = found[np.argsort(np.abs(found - home).max(axis=1), kind="stable")]
    kept: list[Array] = []
    for q in found:
        if all(np.abs(q - other).max() > 0.05 for other in kept):
            kept.append(q)
    return np.array(kept[:_KEPT]).reshape(-1, stand.robot.n)


def _turned(stand: Stand, q: Array, direction: Array) -> Array:
    """Joints near q (n,) that turn gravity towards a direction, by damped Gauss-Newton."""
    q = q.copy()
    for _ in range(_STEPS):
        fall = stand.fall(q[None])[0]
        if fall @ direction > np.cos(1e-4):
            break
        # d/dt (R^T g) = - Omega x (R^T g)
        cross = np.array([[0, -fall[2], fall[1]], [fall[2], 0, -fall[0]], [-fall[1], fall[0], 0]])
        J = cross @ stand.robot.jacobian(q[None])[0, 3:]
        step = J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(3), direction - fall)
        q = np.clip(
            q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-12)), stand.limits.lower, stand.limits.upper
        )
    return q
