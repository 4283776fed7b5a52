"""Largest relative errors of an arm's twist, gravity and wrench against MuJoCo's own sensors.

    python benchmarks/robot_accuracy.py

Random positions, velocities and accelerations of the packaged arms and their payloads, in gravity: the sensor
frame's motion and gravity from Pinocchio and the wrench from the core, as calibrations use them, beside what
ideal sensors in MuJoCo read. Relative to the length of the vector, sample by sample.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from truewrench import robots
from truewrench.model.payload import payload_wrench
from truewrench.model.rig import Rig, load_rig
from truewrench.robot.arm import robot_of
from truewrench.simulation.arm.run import arm_with
from truewrench.simulation.truth import stated

Array = NDArray[np.float64]

ARMS = ("ssrms", "spdm", "panda", "ur10")
GRAVITY = [0.3, -0.2, -9.81]
QUANTITIES = ("velocity", "angular velocity", "specific force", "gravity", "force", "moment")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--states", type=int, default=10_000)
    states = parser.parse_args().states
    print(f"{states} random states of each arm\n")
    print("| | " + " | ".join(QUANTITIES) + " |\n|---|" + "---|" * len(QUANTITIES))
    for name in ARMS:
        errors = errors_of(name, states)
        print(f"| {name} | " + " | ".join(f"{errors[quantity]:.1e}" for quantity in QUANTITIES) + " |")


def errors_of(name: str, states: int) -> dict[str, float]:
    """Largest relative errors of a packaged arm."""
    settings = load_rig(robots.path(name)).to_mapping()
    rig = Rig.from_mapping(settings | {"gravity": GRAVITY}, robots.path(name))
    robot, payload = robot_of(rig), next(iter(rig.payloads))
    rng = np.random.default_rng(0)
    ends = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    q = rng.uniform(*ends, size=(states, robot.n))
    qd, qdd = rng.normal(size=(2, states, robot.n))
    measured = arm_with(rig, robot, stated(rig.payloads[payload])).ideal(q, qd, qdd)

    motion = robot.motion(q, qd, qdd)
    gravity = rig.gravity_array @ motion.R_root_sensor
    v, omega = np.hsplit(motion.twist, 2)
    wrench = payload_wrench(rig, payload, motion.twist, motion.acceleration, gravity) * rig.sensor.sign
    return {
        "velocity": apart(v, measured.twist[:, :3]),
        "angular velocity": apart(omega, measured.twist[:, 3:]),
        "specific force": apart(
            motion.acceleration[:, :3] + np.cross(omega, v) - gravity, measured.specific_force
        ),
        "gravity": apart(gravity, measured.gravity),
        "force": apart(wrench[:, :3], measured.wrench[:, :3]),
        "moment": apart(wrench[:, 3:], measured.wrench[:, 3:]),
    }


def apart(found: Array, expected: Array) -> float:
    """Largest length of the difference over the length."""
    return float(np.max(np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)))


if __name__ == "__main__":
    main()
