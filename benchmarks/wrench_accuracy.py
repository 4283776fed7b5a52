"""Largest relative errors of the payload's wrench and of its Jacobians against independent mechanics.

    python benchmarks/wrench_accuracy.py

Random payloads, motions and gravities: the wrench beside Pinocchio's RNEA, the Jacobians beside central
differences of Pinocchio's wrench, and beside the matrices printed as [A00] 24.
"""

from __future__ import annotations

import argparse

import numpy as np
from bound_oracle import Rnea
from numpy.typing import NDArray

from truewrench import _core

Array = NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=10_000)
    draws = parser.parse_args().draws
    rng = np.random.default_rng(0)
    wrench, by_acceleration, by_twist, printed = (np.empty(draws) for _ in range(4))
    for k in range(draws):
        payload = random_payload(rng)
        nu, a, gravity = 3.0 * rng.normal(size=6), 5.0 * rng.normal(size=6), 10.0 * rng.normal(size=3)
        oracle = Rnea(payload.mass, payload.center_of_mass, payload.inertia, payload.center_of_mass)
        found = _core.payload_wrench(payload, nu[None], a[None], gravity[None])[0]
        wrench[k] = apart(found, oracle(nu, a, gravity))
        expected_by_twist, expected_by_acceleration = oracle.jacobians(nu, a, gravity)
        found_by_acceleration, found_by_twist = _core.payload_jacobians(payload, nu[None])
        by_acceleration[k] = apart(found_by_acceleration[0], expected_by_acceleration)
        by_twist[k] = apart(found_by_twist[0], expected_by_twist)
        printed[k] = beside_the_paper(rng)
    print(f"{draws} random payloads, motions and gravities\n")
    print("| | largest relative error |\n|---|---|")
    for name, errors in (
        ("wrench, Pinocchio's RNEA", wrench),
        ("dw/da, differences of Pinocchio's wrench", by_acceleration),
        ("dw/dnu, differences of Pinocchio's wrench", by_twist),
        ("both, matrices printed in the paper", printed),
    ):
        print(f"| {name} | {errors.max():.1e} |")


def apart(found: Array, expected: Array) -> float:
    """Norm of the difference over the norm."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def random_payload(rng: np.random.Generator) -> _core.Payload:
    """Any centre of mass, and the inertia of four random point masses about it."""
    points, masses = rng.normal(size=(4, 3)), rng.uniform(0.1, 10.0, 4)
    points -= masses @ points / masses.sum()
    payload = _core.Payload()
    payload.mass = masses.sum()
    payload.center_of_mass = rng.normal(size=3)
    payload.inertia = sum(
        m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True)
    )
    return payload


def beside_the_paper(rng: np.random.Generator) -> float:
    """Relative error against [A00] 24, which takes a diagonal inertia and a centre of mass along x."""
    m, c = rng.uniform(1.0, 100.0), rng.normal()
    square = rng.uniform(0.1, 1.0, 3)
    ixx, iyy, izz = m * (square.sum() - square)
    payload = _core.Payload()
    payload.mass, payload.center_of_mass = m, np.array([c, 0.0, 0.0])
    payload.inertia = np.diag([ixx, iyy, izz])
    vx, vy, vz, ox, oy, oz = nu = 3.0 * rng.normal(size=6)
    px, py, pz = (iyy - izz) / m, (izz - ixx) / m, (ixx - iyy) / m
    by_acceleration = [
        [-m, 0, 0, 0, 0, 0],
        [0, -m, 0, 0, 0, 0],
        [0, 0, -m, 0, 0, 0],
        [0, 0, 0, -ixx, 0, 0],
        [0, 0, m * c, 0, -iyy, 0],
        [0, -m * c, 0, 0, 0, -izz],
    ]
    by_twist = [
        [0, m * oz, -m * oy, 0, -m * vz, m * vy],
        [-m * oz, 0, m * ox, m * vz, 0, -m * vx],
        [m * oy, -m * ox, 0, -m * vy, m * vx, 0],
        [0, 0, 0, 0, m * px * oz, m * px * oy],
        [-m * c * oy, m * c * ox, 0, m * (c * vy + py * oz), -m * c * vx, m * py * ox],
        [-m * c * oz, 0, m * c * ox, m * (c * vz + pz * oy), m * pz * ox, -m * c * vx],
    ]
    found = [jacobian[0] for jacobian in _core.payload_jacobians(payload, nu[None])]
    pairs = zip(found, (by_acceleration, by_twist), strict=True)
    return max(apart(one, np.array(other)) for one, other in pairs)


if __name__ == "__main__":
    main()
