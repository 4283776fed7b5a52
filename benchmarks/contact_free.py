"""The contact wrench of tools as they are identified: is its covariance honest beyond what was fitted?

    python benchmarks/contact_free.py --runs 200 --workers 2

Tools, sensors and logs are those of tool_draws.py, 12 poses and 10 s of motion, identified together. Then,
while the offset walks on at the rate of the poses: a pose, a motion, both without contact and with one of
50 N, and a pose after a tare in another one. NEES/6: mean of (w - truth)^T Sigma^-1 (w - truth) / 6 and its
standard error; coverage: of 95% intervals of each axis, interval by the number of tools.
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

import truewrench as tw
from truewrench.correction.contact.run import ContactRun, Contacts
from truewrench.model.rig import Rig
from truewrench.tool.parameters import channel_turn

Array = NDArray[np.float64]
HIT = np.array([30.0, -20.0, 34.0, 1.0, -0.5, 0.7])  # 50 N
PAUSE, APART = 10.0, 5.0  # [s] after the logs that are fitted, and between poses
WITHIN = 1.959964
ROWS = 10  # of a motion that are looked at
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


def of_pose(
    rng: np.random.Generator, tool: tw.Tool, theta: Array, walk: float, hit: Array, *, tared: bool
) -> tuple[Array, Array]:
    """Wrench and covariance of the second of two poses; tared in the first."""
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
    return w[-1:], P[-1:]


def of_motion(
    rng: np.random.Generator, tool: tw.Tool, theta: Array, walk: float, hit: Array
) -> tuple[Array, Array]:
    """Wrenches and covariances of some rows of a motion."""
    rig, (turns, t, nu, rate) = tool.rig, swung(rng)
    raw = channels_of(rig, turns)(theta, nu, rate) + walked(rng, rig, walk, PAUSE + t)
    raw += rig.sensor.noise_array * rng.normal(size=raw.shape) + felt(rig, theta, hit)
    noisy = nu + rig.motion.noise_array * rng.normal(size=nu.shape)
    stamps = tool.offset_time_ns + np.rint(1e9 * (PAUSE + t)).astype(np.int64)
    run = ContactRun(tool, None)
    w, P = found([run.feed(stamps, raw, columns(rig, turns, noisy)), run.finish()])
    rows = np.linspace(0, len(w) - 1, ROWS).astype(int)
    return w[rows], P[rows]


def trial(gain_prior: float, seed: int) -> runs.Row:
    """Errors of one tool, by what is felt."""
    rng, rig = np.random.default_rng(seed), rig_of(gain_prior)
    theta = draw(rng, rig, seed)
    still, truth = posed(rng, rig, theta)
    tool = tw.identify_tool(rig, [still, moved(rng, rig, theta)[0]], threads=1)
    row: dict[str, Any] = {}
    for name in WHAT:
        hit = HIT if "50 N" in name else np.zeros(6)
        if name.startswith("pose"):
            w, P = of_pose(rng, tool, theta, truth.walk, hit, tared="tared" in name)
        else:
            w, P = of_motion(rng, tool, theta, truth.walk, hit)
        error = w - hit
        z = error / np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        row[name] = np.einsum("ki,kij,kj->k", error, np.linalg.inv(P), error).mean() / 6.0
        row[f"covered {name}"] = float(np.mean(np.abs(z) < WITHIN))
        row[f"left {name}"] = float(np.sqrt(np.mean(error[:, :3] ** 2)))
    return row


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
        nees = np.array([row[name] for row in rows])
        share = float(np.mean([row[f"covered {name}"] for row in rows]))
        left = float(np.sqrt(np.mean([row[f"left {name}"] ** 2 for row in rows])))
        error = float(nees.std()) / np.sqrt(len(rows))
        lines.append(
            (name, f"{nees.mean():.2f} +- {error:.2f}", interval(share * len(rows), len(rows)), f"{left:.2f}")
        )
    print(f"{len(rows)} tools, gain prior {100 * given.gain_prior:g}%\n")
    runs.table(("wrench", "NEES/6", "covered", "RMS error of a force [N]"), lines)


if __name__ == "__main__":
    main()
