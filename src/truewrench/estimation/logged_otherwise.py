"""What a motion may have been logged as, where the raw output does not follow it: units, signs, gravity."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from truewrench.estimation.far_clock import left_of_any_body
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of, turning

FOLLOWED = 0.02  # share of the raw output that least squares leave, up to which it follows the motion
LEFT, MISFIT = 0.003, 4.0  # the same, and chi-square, from which on a motion may be logged otherwise,
BETTER = 10.0  # and how many times less must be left then
STANDARD = 9.81  # [m/s^2] of free fall
_SAME = 0.1  # of it, within which the free fall is the stated one: tolerance

TWISTS: dict[str, Callable[[Array], Array]] = {
    "wx wy wz are in degrees per second": lambda nu: nu * np.repeat([1.0, np.pi / 180.0], 3),
    "vx vy vz are in mm/s": lambda nu: nu * np.repeat([1e-3, 1.0], 3),
    "vx vy vz are the angular velocities, and wx wy wz the linear ones": lambda nu: np.roll(nu, 3, axis=1),
}
"""What a twist (N, 6) may have been logged as, and the one that was meant."""

Guess = tuple[str, Rig, list[Log]]  # in words, as a rig, and as logs, what may have been meant


def logged_otherwise(rig: Rig, log: Log) -> str:
    """As what its motion explains the raw output of a log, whatever gain and body; mostly nothing."""
    here = left_of_any_body(rig, log)
    if here is None or not (here[0] > LEFT and here[1] > MISFIT):
        return ""
    best, said = min(here[0] / BETTER, FOLLOWED), ""
    for words, stated, guess in guesses_of_motion(rig, [log]):
        other = left_of_any_body(stated, guess[0])
        if other is not None and other[0] < best:
            best, said = other[0], words
    return explains(said, best, here[0]) if said else ""


def explains(said: str, best: float, left: float) -> str:
    """A guess with the shares of the raw output that it leaves, and that the log as it is leaves."""
    return (
        f"{said}: so the motion explains all but {100 * best:.2g}% of the raw output, as it is logged all "
        f"but {100 * left:.2g}%"
    )


def guesses_of_motion(rig: Rig, logs: Sequence[Log]) -> Iterator[Guess]:
    """What may have been done to joints, positions and velocities alike, to a twist, or to gravity."""
    if rig.motion.source != "joints":
        if all(log.gravity is not None and log.attitude is None for log in logs):
            up = [replace(log, gravity=None if log.gravity is None else -log.gravity) for log in logs]
            yield "gx gy gz point up, as what an accelerometer reads at rest does", rig, up
        if rig.motion.source == "twist":
            for words, as_meant in TWISTS.items():
                yield (
                    words,
                    rig,
                    [log if log.twist is None else replace(log, twist=as_meant(log.twist)) for log in logs],
                )
        return

    def scaled(factor: Array) -> list[Log]:
        return [_scaled(log, factor) for log in logs]

    robot = robot_of(rig)
    turns = turning(robot)
    yield "the joints are in degrees", rig, scaled(np.where(turns, np.pi / 180.0, 1.0))
    if not turns.all():
        yield "the joints that slide are in mm", rig, scaled(np.where(turns, 1.0, 1e-3))
    for j, name in enumerate(robot.joints):
        words = (
            f"joint {name}: its sign is turned, or its axis is the other way round in the robot's description"
        )
        yield words, rig, scaled(np.where(np.arange(robot.n) == j, -1.0, 1.0))
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        fall = tuple((STANDARD * axis + 0.0).tolist())
        if np.linalg.norm(rig.gravity_array - fall) < _SAME * STANDARD:  # it is what is stated
            continue
        words = f"gravity is not {_listed(rig.gravity)} in the root frame, but {_listed(fall)}"
        yield words, rig.model_copy(update={"gravity": fall}), scaled(np.ones(robot.n))


def _listed(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{x:g}' for x in values)}]"


def _scaled(log: Log, factor: Array) -> Log:
    """The log with other joints, from which its motion follows anew."""
    position = None if log.position is None else log.position * factor
    velocity = None if log.velocity is None else log.velocity * factor
    return replace(log, position=position, velocity=velocity, twist=None, gravity=None, tracking=None)
