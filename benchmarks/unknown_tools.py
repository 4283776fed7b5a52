"""Unknown tools drawn from the priors, identified from poses, from motion and from both: is sigma honest?

    python benchmarks/unknown_tools.py --trials 400 --workers 2
    python benchmarks/unknown_tools.py --trials 400 --gain-prior 0.05 --data poses

Sensor of 100 N and 10 N m, noise of 0.1 N and 0.005 N m; gains, mounting, gravity, offsets and bodies (a
quarter of them rods) are drawn; 12 poses 8 s apart with an offset that walks at a rate drawn about 1e-4 of
range per sqrt(s), 10 s of motion of four frequencies an axis. Beside it the recipe of ten linear parameters
with an exact gain and its own formal sigma.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import beta

import truewrench as tw
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.rig.tool_rig import tool_rig
from truewrench.tool.parameters import Layout, channel_turn, inertia_of, symmetric, tilted
from truewrench.tool.prior import make_prior

Array = NDArray[np.float64]
LAYOUT = Layout(6)
POSES, APART, SECONDS, RATE = 12, 8.0, 10.0, 100
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def rig_of(gain_prior: float) -> Rig:
    return tool_rig(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": [0.1] * 3 + [0.005] * 3,
                "range": [100] * 3 + [10] * 3,
                "gain_prior": gain_prior,
                "discrepancy": 0,
                "time_offset_prior": 0.0,
            },
            "gravity": [0, 0, -9.81],
        }
    )


def newton_euler(theta: Array, gravity: Array, nu: Array, a: Array, fall_turn: Array) -> Array:
    """Wrench (N, 6) on the sensor of the tool that theta holds, point by point."""
    mass, c = float(np.exp(theta[LAYOUT.log_mass])), theta[LAYOUT.center_of_mass]
    inertia = symmetric(inertia_of(mass, theta[LAYOUT.S]))
    fall = fall_turn @ tilted(gravity, theta[LAYOUT.tilt])[0]
    omega, alpha = nu[:, 3:], a[:, 3:]
    at_mass = a[:, :3] + np.cross(omega, nu[:, :3]) + np.cross(alpha, c)
    at_mass += np.cross(omega, np.cross(omega, c)) - fall
    moment = alpha @ inertia + np.cross(omega, omega @ inertia) + mass * np.cross(c, at_mass)
    return -np.column_stack([mass * at_mass, moment])


def draw(rng: np.random.Generator, rig: Rig, seed: int) -> Array:
    """Theta from the prior, the body physical and of an ordinary mass."""
    prior = make_prior(rig, rig)
    theta = rng.multivariate_normal(prior.mean, prior.covariance)
    theta[LAYOUT.log_mass] = np.log(rng.uniform(0.5, 3.0))
    theta[LAYOUT.center_of_mass] = rng.normal(size=3) * [0.02, 0.02, 0.03] + [0.0, 0.0, 0.09]
    root = 0.03 * rng.normal(size=(3, 3))
    S = np.diag([1e-6, 1e-6, 2e-3]) if seed % 4 == 0 else root @ root.T
    theta[LAYOUT.S] = [S[i, j] for i, j in PAIRS]
    return theta


def read(rng: np.random.Generator, rig: Rig, theta: Array, wrench: Array, t: Array, walk: float) -> Array:
    R6 = np.kron(np.eye(2), channel_turn(theta[LAYOUT.mounting])[0])
    steps = rng.normal(size=wrench.shape) * np.sqrt(np.diff(t, prepend=t[0]))[:, None]
    drift = np.cumsum(steps, axis=0) * walk * rig.sensor.channel_scale
    theta[LAYOUT.offset] = rng.normal(size=6) * rig.sensor.offset_prior_array
    noise = rng.normal(size=wrench.shape) * rig.sensor.noise_array
    return (
        wrench @ (theta[LAYOUT.gain].reshape(6, 6) @ R6).T + theta[LAYOUT.offset] + drift - drift[-1] + noise
    )


def log_of(rig: Rig, turns: Rotation, t: Array, raw: Array, nu: Array, start: int) -> Log:
    quaternion = turns.as_quat()[:, [3, 0, 1, 2]]
    stamps = (t * 1e9).astype(np.int64) + start
    fall = turns.inv().apply(rig.gravity_array)
    return Log(None, "tool", "", stamps, raw, twist=nu, gravity=fall, attitude=quaternion)


def poses(rng: np.random.Generator, rig: Rig, theta: Array) -> Log:
    turns, still, t = Rotation.random(POSES, random_state=rng), np.zeros((POSES, 6)), np.arange(POSES) * APART
    wrench = newton_euler(theta, rig.gravity_array, still, still, turns.inv().as_matrix())
    raw = read(rng, rig, theta, wrench, t, 1e-4 * np.exp(0.7 * rng.normal()))
    raw += rng.normal(size=raw.shape) * 2e-4 * rig.sensor.channel_scale
    return log_of(rig, turns, t, raw, still, 0)


def motion(rng: np.random.Generator, rig: Rig, theta: Array) -> Log:
    t = np.arange(int(SECONDS * RATE)) / RATE
    f, phase = rng.uniform(0.2, 0.9, (6, 4)), rng.uniform(0.0, 2.0 * np.pi, (6, 4))
    size = np.repeat([0.5, 1.0], 3)

    def twist(at: Array) -> Array:
        return size * np.sin(2.0 * np.pi * f * at[:, None, None] + phase).sum(axis=2)

    rate = size * (2.0 * np.pi * f * np.cos(2.0 * np.pi * f * t[:, None, None] + phase)).sum(axis=2)
    fine = twist((np.arange(4 * (t.size - 1)) + 0.5) / (4.0 * RATE))[:, 3:] / (4.0 * RATE)
    turns = [Rotation.random(random_state=rng)]
    for part in fine:
        turns.append(turns[-1] * Rotation.from_rotvec(part))
    way, nu = Rotation.concatenate(turns[::4]), twist(t)
    wrench = newton_euler(theta, rig.gravity_array, nu, rate, way.inv().as_matrix())
    raw = read(rng, rig, theta, wrench, t, 0.0)
    return log_of(rig, way, t, raw, nu + rng.normal(size=nu.shape) * rig.motion.noise_array, 10**12)


def recipe(rig: Rig, log: Log) -> tuple[Array, Array]:
    """Mass and centre of mass of ten linear parameters, and their formal sigma."""
    assert log.gravity is not None
    count = len(log.raw)
    A = np.zeros((count, 6, 10))
    A[:, :3, 0] = log.gravity
    for k, e in enumerate(np.eye(3)):
        A[:, 3:, 1 + k] = np.cross(e, log.gravity)
    A[:, :, 4:] = np.eye(6)
    rows, y = A.reshape(-1, 10), log.raw.ravel()
    weight = 1.0 / np.tile(rig.sensor.noise_array, count)
    x, *_ = np.linalg.lstsq(rows * weight[:, None], y * weight, rcond=None)
    left = (y - rows @ x) * weight
    P = np.linalg.inv((rows * weight[:, None]).T @ (rows * weight[:, None])) * (left @ left / (y.size - 10))
    by = np.hstack([-x[1:4, None] / x[0] ** 2, np.eye(3) / x[0]])
    return np.append(x[0], x[1:4] / x[0]), np.append(
        np.sqrt(P[0, 0]), np.sqrt(np.diag(by @ P[:4, :4] @ by.T))
    )


def trial(seed: int, gain_prior: float, data: str) -> dict[str, Array]:
    rng, rig = np.random.default_rng(seed), rig_of(gain_prior)
    theta, logs = draw(rng, rig, seed), []
    if data in ("poses", "both"):
        logs.append(poses(rng, rig, theta))
    if data in ("motion", "both"):
        logs.append(motion(rng, rig, theta))
    begin = time.perf_counter()
    tool = tw.identify_tool(rig, logs, threads=1)
    seconds = time.perf_counter() - begin
    error, std = tool.theta - theta, np.sqrt(np.diag(tool.covariance))
    inertia = inertia_of(float(np.exp(theta[LAYOUT.log_mass])), theta[LAYOUT.S])
    told = np.r_[LAYOUT.log_mass, LAYOUT.center_of_mass] if data == "poses" else np.r_[LAYOUT.body]
    P = tool.covariance[np.ix_(told, told)]
    out = {
        "mass": (error / std)[[LAYOUT.log_mass]],
        "centre of mass": (error / std)[LAYOUT.center_of_mass],
        "offset": (error / std)[LAYOUT.offset],
        "nees": np.array([error[told] @ np.linalg.solve(P, error[told]) / told.size]),
        "usable": np.array([tool.verdict.usable]),
        "seconds": np.array([seconds]),
    }
    if data != "poses":
        out["inertia"] = (tool.inertia - inertia) / tool.inertia_std
    if data == "poses":
        x, sigma = recipe(rig, logs[0])
        truth = np.append(np.exp(theta[LAYOUT.log_mass]), theta[LAYOUT.center_of_mass])
        out["recipe mass"], out["recipe centre of mass"] = np.split((x - truth) / sigma, [1])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--gain-prior", type=float, default=0.02)
    parser.add_argument("--data", choices=("poses", "motion", "both"), default="both")
    given = parser.parse_args()
    work = partial(trial, gain_prior=given.gain_prior, data=given.data)
    with ProcessPoolExecutor(given.workers) as pool:
        found = list(pool.map(work, range(given.trials)))
    what = f"{given.trials} tools, {given.data}, gain prior {100 * given.gain_prior:g}%"
    print(f"{what}; 95% intervals hold the truth")
    for name in ("mass", "centre of mass", "inertia", "offset", "recipe mass", "recipe centre of mass"):
        if name in found[0]:
            z = np.concatenate([one[name] for one in found])
            share, count = (
                float(np.mean(np.abs(z) < 1.96)),
                len(found),
            )  # trials are independent, elements are not
            low, high = beta.ppf([0.025, 0.975], share * count + 0.5, (1.0 - share) * count + 0.5)
            print(f"  {name:22} {100 * share:5.1f} %   ({100 * low:.1f} to {100 * high:.1f})")
    mean = {key: float(np.mean([one[key] for one in found])) for key in ("nees", "usable", "seconds")}
    print(f"  NEES/n {mean['nees']:.2f}, usable {100 * mean['usable']:.0f} %, {mean['seconds']:.2f} s each")


if __name__ == "__main__":
    main()
