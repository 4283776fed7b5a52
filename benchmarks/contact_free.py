"""The contact wrench of tools as they are identified: is its covariance honest beyond what was fitted?

    python benchmarks/contact_free.py --runs 200 --workers 2

Tools, sensors and logs are those of tool_draws.py, 12 poses and 10 s of motion, identified together. Then,
while the offset walks on at the rate of the poses: a pose, a motion, both without contact and with one of
50 N, and a pose after a tare in another one. NEES/6: mean of (w - truth)^T Sigma^-1 (w - truth) / 6 and its
standard error; coverage: of 95% intervals of each axis, interval by the number of tools. Beside it the recipe
of ten linear parameters with an exact gain: what it leaves, its formal sigma, and its tare, a subtraction.
Then S-curves, from the motion alone: 2 kg, 500 Hz, velocities to 1e-3 m/s, an exact tool; beside it central
differences of the velocities.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from functools import partial
from typing import Any

import numpy as np
import runs
from numpy.typing import NDArray
from runs import interval
from scipy.spatial.transform import Rotation
from tool_draws import LAYOUT, REPEATABILITY, channels_of, draw, log_of, moved, posed, rig_of, swung
from tool_recipe import Fitted, fitted

import truewrench as tw
from truewrench import _core
from truewrench.correction.contact.run import ContactRun, Contacts
from truewrench.model.rig import Rig
from truewrench.tool.parameters import channel_turn

Array = NDArray[np.float64]
HIT = np.array([30.0, -20.0, 34.0, 1.0, -0.5, 0.7])  # 50 N
PAUSE, APART = 10.0, 5.0  # [s] after the logs that are fitted, and between poses
WITHIN = 1.959964
ROWS = 10  # of a motion that are looked at
CURVE_ROWS, CURVE_STEP, CURVE_NOISE, CURVE_DELAY = 10_000, 2e-3, 1e-3, 0.01  # [s], [m/s], [s]
WHAT = ("pose", "pose, 50 N", "pose, tared in another", "motion", "motion, 50 N")


def felt(rig: Rig, theta: Array, hit: Array) -> Array:
    """Channels (n,) of a contact."""
    R6 = np.kron(np.eye(2), channel_turn(theta[LAYOUT.mounting])[0])
    return np.asarray(theta[LAYOUT.gain].reshape(-1, 6) @ R6 @ hit)


def walked(rng: np.random.Generator, rig: Rig, walk: float, since: Array) -> Array:
    """(N, n) of the offset at times since its own [s], the first of them anew."""
    steps = rng.normal(size=(since.size, rig.sensor.n)) * np.sqrt(np.diff(since, prepend=0.0))[:, None]
    return np.asarray(walk * rig.sensor.channel_scale * np.cumsum(steps, axis=0))


def found(parts: list[Contacts]) -> tuple[Array, Array]:
    """Wrenches and covariances of all of them."""
    return np.concatenate([one.wrench for one in parts]), np.concatenate([one.covariance for one in parts])


def columns(rig: Rig, turns: Rotation, nu: Array) -> dict[str, Array]:
    """Twist and attitude by name."""
    log = log_of(rig, turns, np.arange(float(len(nu))), nu, nu, 0)
    assert log.attitude is not None
    named = dict(zip(("vx", "vy", "vz", "wx", "wy", "wz"), nu.T, strict=True))
    return named | dict(zip(("qw", "qx", "qy", "qz"), log.attitude.T, strict=True))


Found = tuple[Array, Array]  # wrenches (K, 6) and their covariances


def of_pose(
    rng: np.random.Generator,
    tool: tw.Tool,
    plain: Fitted,
    theta: Array,
    walk: float,
    hit: Array,
    *,
    tared: bool,
) -> tuple[Found, Found]:
    """Of the second of two poses, tared in the first; the same by the recipe."""
    rig, turns = tool.rig, Rotation.random(2, random_state=rng)
    since, still = PAUSE + APART * np.arange(2.0), np.zeros((2, 6))
    raw = channels_of(rig, turns)(theta, still, still) + walked(rng, rig, walk, since)
    raw += REPEATABILITY * rig.sensor.channel_scale * rng.normal(size=raw.shape)
    raw += rig.sensor.noise_array * rng.normal(size=raw.shape)
    raw[1] += felt(rig, theta, hit)
    stamps = tool.offset_time_ns + np.rint(1e9 * since).astype(np.int64)
    run = ContactRun(tool, None)
    parts = [run.feed(stamps, raw, columns(rig, turns, still))]  # the first pose is known with the second
    if tared:
        run.tare()
    w, P = found([*parts, run.finish()])
    of_recipe = plain.tared if tared else plain.contact
    left, own = of_recipe(raw, still, still, turns.inv().apply(rig.gravity_array))
    return (w[-1:], P[-1:]), (left[-1:], own[-1:])


def of_motion(
    rng: np.random.Generator, tool: tw.Tool, plain: Fitted, theta: Array, walk: float, hit: Array
) -> tuple[Found, Found]:
    """Of some rows of a motion; the same by the recipe."""
    rig, (turns, t, nu, rate) = tool.rig, swung(rng)
    raw = channels_of(rig, turns)(theta, nu, rate) + walked(rng, rig, walk, PAUSE + t)
    raw += rig.sensor.noise_array * rng.normal(size=raw.shape) + felt(rig, theta, hit)
    noisy = nu + rig.motion.noise_array * rng.normal(size=nu.shape)
    stamps = tool.offset_time_ns + np.rint(1e9 * (PAUSE + t)).astype(np.int64)
    run = ContactRun(tool, None)
    w, P = found([run.feed(stamps, raw, columns(rig, turns, noisy)), run.finish()])
    rows = np.linspace(0, len(w) - 1, ROWS).astype(int)
    left, own = plain.contact_of(log_of(rig, turns, PAUSE + t, raw, noisy, tool.offset_time_ns))
    other = np.linspace(0, len(left) - 1, ROWS).astype(int)
    return (w[rows], P[rows]), (left[other], own[other])


def trial(gain_prior: float, seed: int) -> runs.Row:
    """Errors of one tool, by what is felt."""
    rng, rig = np.random.default_rng(seed), rig_of(gain_prior)
    theta = draw(rng, rig, seed)
    still, truth = posed(rng, rig, theta)
    logs = [still, moved(rng, rig, theta)[0]]
    tool, plain = tw.identify_tool(rig, logs, threads=1), fitted(rig, logs, moving=True)
    row: dict[str, Any] = {}
    for name in WHAT:
        hit = HIT if "50 N" in name else np.zeros(6)
        if name.startswith("pose"):
            both = of_pose(rng, tool, plain, theta, truth.walk, hit, tared="tared" in name)
        else:
            both = of_motion(rng, tool, plain, theta, truth.walk, hit)
        for who, (w, P) in zip(("", "recipe "), both, strict=True):
            error = w - hit
            z = error / np.sqrt(np.diagonal(P, axis1=1, axis2=2))
            row[who + name] = float(np.einsum("ki,kij,kj->k", error, np.linalg.inv(P), error).mean() / 6.0)
            row[f"{who}covered {name}"] = float(np.mean(np.abs(z) < WITHIN))
            row[f"{who}left {name}"] = float(np.sqrt(np.mean(error[:, :3] ** 2)))
    return row


def s_curves(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Velocity and acceleration (N, 3) of point-to-point moves with bounded jerk, at 500 Hz."""
    a = np.zeros((count, 3))
    for axis in range(3):
        at = int(rng.integers(0, 50))
        while at < count - 400:
            ramp, hold = int(rng.integers(25, 50)), int(rng.integers(20, 60))
            size = rng.choice([-1, 1]) * rng.uniform(2.5, 4.5)
            up = np.concatenate([np.linspace(0, size, ramp), np.full(hold, size), np.linspace(size, 0, ramp)])
            move = np.concatenate([up, np.zeros(int(rng.integers(0, 10))), -up])
            a[at : at + len(move), axis] = move
            at += len(move) + int(rng.integers(0, 20))
    return np.cumsum((a + np.vstack([np.zeros(3), a[:-1]])) / 2.0, axis=0) * CURVE_STEP, a


def curves(seed: int) -> list[float]:
    """RMS of a force that the motion alone leaves of S-curves, the worst axis; by differences; inertia's."""
    rng, mass = np.random.default_rng(seed), 2.0
    settings = _core.ContactSettings()
    settings.set_sensor(np.eye(6), np.zeros(6), np.repeat([0.1, 0.005], 3), True)
    settings.mass, settings.center_of_mass, settings.S = mass, np.zeros(3), np.zeros(6)
    settings.gravity, settings.offset_walk = np.zeros(3), np.zeros(6)
    settings.covariance = 1e-12 * np.eye(LAYOUT.size)
    settings.twist_noise = CURVE_NOISE**2 * np.eye(6)
    v, a = s_curves(rng, CURVE_ROWS)
    noisy = np.hstack([v + CURVE_NOISE * rng.normal(size=v.shape), np.zeros_like(v)])
    raw, nothing = np.hstack([-mass * a, np.zeros_like(a)]), np.zeros((CURVE_ROWS, 3))
    stamps = np.arange(CURVE_ROWS, dtype=np.int64) * round(1e9 * CURVE_STEP)
    turn, warm = np.tile(np.eye(3).ravel(), (CURVE_ROWS, 1)), np.full(CURVE_ROWS, 25.0)
    rows = _core.ContactRows(settings, 2.0 * CURVE_DELAY, False)
    left = rows.feed(stamps, raw, noisy, nothing, turn, warm, np.empty((0, 36)))[2][:, :3]
    plain = -mass * (a - np.gradient(noisy[:, :3], CURVE_STEP, axis=0))
    worst = [float(np.sqrt((of**2).mean(axis=0)).max()) for of in (left, plain)]
    return [*worst, float(np.sqrt((raw[:, :3] ** 2).mean()))]


def main() -> None:
    parser = runs.arguments(__doc__, runs=200)
    parser.add_argument("--gain-prior", type=float, default=0.02)
    given = parser.parse_args()
    settings = ["contact free", given.gain_prior]
    work = partial(trial, given.gain_prior)
    indices = range(given.seed, given.seed + given.runs)
    rows = runs.gather(work, indices, given.out, given.workers, settings)
    for row in rows:
        if WHAT[0] not in row:
            print(f"run {row['index']}: {row['reasons'][0]}")
    rows = [row for row in rows if WHAT[0] in row]
    lines = []
    for name in WHAT:
        cells = [name]
        for who in ("", "recipe "):
            nees = np.array([row[who + name] for row in rows])
            share = float(np.mean([row[f"{who}covered {name}"] for row in rows]))
            left = float(np.sqrt(np.mean([row[f"{who}left {name}"] ** 2 for row in rows])))
            error = float(nees.std()) / np.sqrt(len(rows))
            cells += [
                f"{nees.mean():.2f} +- {error:.2f}",
                interval(share * len(rows), len(rows)),
                f"{left:.2f}",
            ]
        lines.append(cells)
    print(f"{len(rows)} tools, gain prior {100 * given.gain_prior:g}%\n")
    columns = ("NEES/6", "covered", "RMS error of a force [N]")
    runs.table(("wrench", *columns, *(f"recipe: {column}" for column in columns)), lines)
    left, plain, inertia = np.array([curves(seed) for seed in range(given.seed, given.seed + 20)]).T
    rms, by_differences = (float(np.sqrt(np.mean(of**2))) for of in (left, plain))
    worst = f"{left.max():.3f} N in the worst of {left.size}"
    print(f"\nS-curves of {inertia.mean():.1f} N: {rms:.3f} N RMS left, {worst}")
    print(f"Differences leave {by_differences:.2f} N")


if __name__ == "__main__":
    main()
