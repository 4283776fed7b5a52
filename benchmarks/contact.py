"""Contact test over simulated hours: false events, what is detected, honesty, time a row: a markdown table.

    python benchmarks/contact.py
    python benchmarks/contact.py --tools 2 --hours 0.5

Each tool is one of 2 kg, drawn from the covariance that the estimate claims (1% gains, 0.5% mass, 0.5 mm),
on a sensor whose offset walks by 0.5 N and 0.05 N m in the square root of an hour, swung slowly, tared every
ten minutes. Detectable: the force along a random direction that is found in 90% of the samples, in sigma of
that direction; chi-square says 7.90. Beside it the share of rows that the recipe would call contact: tool and
gain as found taken for exact, velocities differentiated, the offset of the last tare, the noise as sigma.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truewrench import _core

Array = NDArray[np.float64]

NOISE = np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.005])
WALK = np.array([0.5, 0.5, 0.5, 0.05, 0.05, 0.05]) / 60.0  # per sqrt(s)
TWIST_NOISE = 1e-3
GRAVITY = np.array([0.0, 0.0, -9.81])
TARE = 600.0  # [s]
AXIS = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
SIGMA = np.concatenate(
    [
        np.full(36, 0.01) * np.outer(NOISE, 1.0 / NOISE).ravel(),
        [5e-3],
        np.full(3, 5e-4),
        np.full(6, 1e-4),
        2.0 * NOISE,
        np.full(3, 3e-3),
        np.full(2, 2e-3),
    ]
)
MEAN = np.concatenate(
    [
        np.eye(6).ravel(),
        [np.log(2.0)],
        [0.01, -0.02, 0.09],
        [4e-3, 3e-3, 2e-3, 1e-4, -2e-4, 3e-4],
        np.zeros(11),
    ]
)


@dataclass
class Hours:
    """What was counted."""

    hours: float = 0.0
    events: int = 0
    refused: int = 0
    seconds: float = 0.0
    rows: int = 0
    plain: int = 0  # that the recipe calls contact

    def row(self, wrenches: Array, covariances: Array, rng: np.random.Generator) -> str:
        """Of the table."""
        nees = np.mean([w @ np.linalg.solve(s, w) for w, s in zip(wrenches, covariances, strict=True)]) / 6.0
        force = detectable(wrenches, covariances, rng)
        cells = [
            f"{self.hours:.2f}",
            str(self.events),
            str(self.refused),
            f"{nees:.2f}",
            f"{force:.2f}",
            f"{1e6 * self.seconds / self.rows:.1f}",
            f"{100 * self.plain / self.rows:.1f}%",
        ]
        return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--tools", type=int, default=100, help="how many")
    parser.add_argument("--hours", type=float, default=1.0, help="of each")
    parser.add_argument("--rate", type=float, default=1000.0, help="of sensor and motion [Hz]")
    parser.add_argument("--seed", type=int, default=0, help="of the first tool")
    arguments = parser.parse_args()
    total, wrenches, covariances = Hours(), [], []
    for seed in range(arguments.seed, arguments.seed + arguments.tools):
        w, s = one_tool(seed, arguments.hours, arguments.rate, total)
        wrenches.append(w)
        covariances.append(s)
    head = "hours|false events|tares refused|NEES/6|detectable [sigma]|us a row|recipe: rows called contact"
    print(f"| {head.replace('|', ' | ')} |\n{'|---' * 7}|")
    rng = np.random.default_rng(arguments.seed)
    print(total.row(np.concatenate(wrenches), np.concatenate(covariances), rng))


def one_tool(seed: int, hours: float, rate: float, total: Hours) -> tuple[Array, Array]:
    """Run one tool; some of its wrenches (K, 6) and their covariance (K, 6, 6)."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(SIGMA.size, 2 * SIGMA.size)) / np.sqrt(2.0 * SIGMA.size) * SIGMA[:, None]
    theta = MEAN + root @ rng.normal(size=2 * SIGMA.size)
    rows = _core.ContactRows(settings(root @ root.T), 0.02, False)
    start = Rotation.random(random_state=seed)
    block = round(60.0 * rate)
    offset, zero, wrenches, covariances = np.zeros(6), np.zeros(6), [], []
    for number in range(max(1, round(hours * 60.0))):
        time_ns = np.arange(number * block, (number + 1) * block, dtype=np.int64) * round(1e9 / rate)
        seconds = 1e-9 * time_ns
        angle = 0.8 * np.sin(0.7 * seconds)
        R = (start * Rotation.from_rotvec(angle[:, None] * AXIS)).as_matrix()
        nu = np.hstack(
            [0.1 * np.sin(np.outer(seconds, [1.0, 1.3, 1.7])), np.outer(0.56 * np.cos(0.7 * seconds), AXIS)]
        )
        a = np.hstack(
            [
                0.1 * np.array([1.0, 1.3, 1.7]) * np.cos(np.outer(seconds, [1.0, 1.3, 1.7])),
                np.outer(-0.392 * np.sin(0.7 * seconds), AXIS),
            ]
        )
        walked = offset + np.cumsum(rng.normal(size=(block, 6)), axis=0) * WALK / np.sqrt(rate)
        offset = walked[-1]
        raw = channels(theta, nu, a, R) + walked + rng.normal(size=(block, 6)) * NOISE
        fall = R.transpose(0, 2, 1) @ GRAVITY
        noisy = nu + TWIST_NOISE * rng.normal(size=nu.shape)
        turn = np.ascontiguousarray(R.transpose(0, 2, 1)).reshape(-1, 9)
        begun = time.process_time()
        found = rows.feed(time_ns, raw, noisy, fall, turn, np.full(block, 25.0), np.empty((0, 36)))
        total.seconds += time.process_time() - begun
        total.rows += block
        picked = rng.integers(0, len(found[4]), 20)
        wrenches.append(found[2][picked])
        covariances.append(found[3][picked])
        plain = raw - channels(MEAN, noisy, np.gradient(noisy, 1.0 / rate, axis=0), R)
        if (number * 60.0) % TARE == 0.0:
            total.refused += rows.tare() != "accepted"
            zero = plain[-round(rate) :].mean(axis=0)
        total.plain += int(np.sum((((plain - zero) / NOISE) ** 2).sum(axis=1) > _core.contact_limit))
    rows.finish()
    total.events += len(rows.ended())
    total.hours += max(1, round(hours * 60.0)) / 60.0
    return np.concatenate(wrenches), np.concatenate(covariances)


def settings(covariance: Array) -> _core.ContactSettings:
    """What the estimate claims."""
    out = _core.ContactSettings()
    out.set_sensor(np.eye(6), np.zeros(6), NOISE, True)
    out.mass, out.center_of_mass, out.S = 2.0, MEAN[37:40], MEAN[40:46]
    out.gravity, out.covariance, out.offset_walk = GRAVITY, covariance, WALK
    out.twist_noise = TWIST_NOISE**2 * np.eye(6)
    return out


def channels(theta: Array, nu: Array, a: Array, R: Array) -> Array:
    """(N, 6) without noise and drift, of a tool that feels nothing but itself."""
    gain, mass, c, S = theta[:36].reshape(6, 6), np.exp(theta[36]), theta[37:40], theta[40:46]
    moments = np.array([[S[0], S[3], S[4]], [S[3], S[1], S[5]], [S[4], S[5], S[2]]])
    inertia = mass * (np.trace(moments) * np.eye(3) - moments)
    v, omega, alpha = nu[:, :3], nu[:, 3:], a[:, 3:]
    tilted = Rotation.from_rotvec(tilt_axes() @ theta[55:57]).as_matrix() @ GRAVITY
    g = R.transpose(0, 2, 1) @ tilted
    f = mass * (a[:, :3] + np.cross(omega, v) + np.cross(alpha, c) + np.cross(omega, np.cross(omega, c)) - g)
    n = np.cross(c, f) + alpha @ inertia + np.cross(omega, omega @ inertia)
    turn = Rotation.from_euler("xyz", theta[52:55]).as_matrix()
    return -np.hstack([f @ turn, n @ turn]) @ gain.T + theta[46:52]


def tilt_axes() -> Array:
    """(3, 2) about which gravity tilts."""
    e1 = np.cross(GRAVITY, [1.0, 0.0, 0.0])
    e1 /= np.linalg.norm(e1)
    return np.column_stack([e1, np.cross(GRAVITY, e1) / np.linalg.norm(GRAVITY)])


def detectable(wrenches: Array, covariances: Array, rng: np.random.Generator) -> float:
    """Size, in sigma of its direction, of a force that 90% of the samples are a contact with."""
    directions = np.zeros_like(wrenches)
    directions[:, :3] = rng.normal(size=(len(wrenches), 3))
    inverse = np.linalg.inv(covariances)
    size = np.einsum("ki,kij,kj->k", directions, inverse, directions)
    directions /= np.sqrt(size)[:, None]
    low, high = 0.0, 50.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        w = wrenches + middle * directions
        above = np.einsum("ki,kij,kj->k", w, inverse, w) > _core.contact_limit
        low, high = (low, middle) if above.mean() > 0.9 else (middle, high)
    return high


if __name__ == "__main__":
    main()
