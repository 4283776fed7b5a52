"""The whole chain on every packaged arm: plan, MuJoCo, calibration, and whether sigma is what was promised.

    python benchmarks/chain.py --runs 50 --out out/chain
    python benchmarks/chain.py --arm panda_ground --runs 10

Payload and clock are exact, no accuracy is required; noise, offsets (on the ground) and limits are those of
the packaged rigs. An arm's motion is planned once and kept in the folder of the rows; what the servos make of
it is the same in every run, gain, offset and noise are drawn anew. Bound: Cramer-Rao for the drawn gain, by
differences of MuJoCo's sensors, priors included. Predicted: what the plan promised for the nominal gain.
Realised over predicted of a single gain has a scatter of 1/sqrt(2 runs). `--motion default` takes the sines
that `simulate` makes of its own instead of a plan, and the bound for what is predicted.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import bound_arm
import bound_common
import numpy as np
import runs
import yaml
from numpy.typing import NDArray
from scipy.stats import chi2

from truewrench import robots
from truewrench.io.plans import joint_columns, read_joint_plan
from truewrench.io.tables import write_table
from truewrench.model.files import write_yaml
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig, load_rig
from truewrench.planning.planner import plan
from truewrench.robot.arm import robot_of
from truewrench.robot.track import track
from truewrench.simulation.arm.model import Arm
from truewrench.simulation.arm.motion import default_motion
from truewrench.simulation.arm.run import Moved, arm_with, move, record
from truewrench.simulation.truth import begin, stated

Array = NDArray[np.float64]

KNOTS = 10  # of the bound, per period of the plan's fastest harmonic


def rig_of(name: str) -> Rig:
    """The packaged rig with an exact payload and clock."""
    path = robots.path(name)
    settings = load_rig(path).to_mapping()
    for payload in settings["payloads"].values():
        payload["uncertainty"] = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    settings["sensor"]["time_offset_prior"] = 0
    settings["required"] = 10.0
    return Rig.from_mapping(settings, path)


def planned(name: str, motion: str, folder: Path) -> Path:
    """The file of an arm's motion, made where there is none, with what it promises beside it."""
    path = folder / f"{name}-{motion}.csv"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        if motion == "optimal":
            plan(rig_of(name)).write(path)
        else:
            write_sines(rig_of(name), path)
    return path


def write_sines(rig: Rig, path: Path) -> None:
    """The motion that `simulate` makes of its own, as a plan."""
    robot, (payload, spec) = robot_of(rig), next(iter(rig.payloads.items()))
    arm = arm_with(rig, robot, stated(spec))
    motion = default_motion(rig, robot, {payload: arm})
    time = np.linspace(0.0, motion.duration, 1 + round(100.0 * motion.duration))
    columns: dict[str, Array] = {"time_s": time}
    for names, values in zip(
        joint_columns(robot.joints),
        (motion.position(time), motion.velocity(time), motion.acceleration(time)),
        strict=True,
    ):
        columns |= dict(zip(names, values.T, strict=True))
    gain = rig.sensor.nominal_gain_array
    covariance = bound_common.bound_of(
        rig, bound_arm.linearised(rig, arm, motion), gain, motion.duration, spacing(rig, motion.duration)
    )
    sigma = np.sqrt(np.diag(covariance)).reshape(gain.shape) / normalised(rig, np.ones_like(gain))
    write_yaml(
        path.with_name(path.name + ".plan.yaml"),
        {"period": motion.duration, "predicted_gain_std": sigma.tolist()},
    )
    write_table(path, columns)


def spacing(rig: Rig, period: float) -> float:
    """Of the knots of the bound, for a motion that repeats itself after a period [s]."""
    return period / rig.plan.harmonics / KNOTS


@cache
def moved(name: str, path: Path) -> tuple[Arm, SplineJoints, Moved]:
    """The arm, its plan, and what it makes of it."""
    rig = rig_of(name)
    robot = robot_of(rig)
    body = stated(next(iter(rig.payloads.values())))
    trajectory = read_joint_plan(path, robot.joints)
    arm = arm_with(rig, robot, body)
    return arm, trajectory, move(rig, robot, trajectory, body, 0.0)


@cache
def linear(name: str, path: Path) -> bound_common.Linearised:
    """The wrench about an arm's plan."""
    arm, trajectory, _ = moved(name, path)
    return bound_arm.linearised(rig_of(name), arm, trajectory)


def run(name: str, path: Path, campaign: int, estimator: str, index: int) -> runs.Row:
    """One row."""
    rig = rig_of(name)
    _, trajectory, movement = moved(name, path)
    payload, truth = begin(rig, None, 1_000_003 * campaign + index)
    log = record(rig, payload, truth, movement)
    row, found = runs.calibrated(rig, track(rig, log), truth.gain, estimator=estimator)
    knots = spacing(rig, promise(path)["period"])
    covariance = bound_common.bound_of(rig, linear(name, path), truth.gain, trajectory.duration, knots)
    row["bound"] = bound_common.rms(covariance)
    row["disagreement"] = movement.disagreement
    if found is not None:
        row["errors"] = [float(x) for x in normalised(rig, found.gain - truth.gain).ravel()]
    return row


def normalised(rig: Rig, gain: Array) -> Array:
    """Gains (n, 6) in units of range."""
    return np.asarray(gain * rig.sensor.range_array / rig.sensor.channel_scale[:, None])


@cache
def promise(path: Path) -> dict[str, Any]:
    """What stands beside a plan."""
    return dict(yaml.safe_load(path.with_name(path.name + ".plan.yaml").read_text()))


def promised(name: str, path: Path) -> Array:
    """Normalised sigma (6n,) that the plan promises."""
    return normalised(rig_of(name), np.array(promise(path)["predicted_gain_std"])).ravel()


def line(name: str, path: Path, rows: Sequence[runs.Row]) -> list[Any]:
    """A row of the table."""
    found = [r for r in rows if r["outcome"] == "calibrated" and np.isfinite(r["rms"])]
    usable = sum(bool(r["usable"]) for r in rows)
    feasible = "yes" if promise(path)["feasible"] else "no"
    first = [name, feasible, len(rows), f"{usable / len(rows):.0%}"]
    if not found:
        return [*first, *["-"] * 8]
    error = np.array([r["errors"] for r in found])
    sigma = promised(name, path)
    rms = np.sqrt(np.mean(error**2))
    each = np.sqrt(np.mean(error**2, axis=0)) / sigma
    total = error.shape[1] * len(found)
    low, high = chi2.ppf([0.001, 0.999], total) / total
    return [
        *first,
        f"{rms:.6f}",
        f"{rms / np.sqrt(np.mean([r['bound'] ** 2 for r in found])):.3f}",
        f"{np.mean([r['nees'] for r in found]):.3f} [{low:.3f}, {high:.3f}]",
        f"{max(r['nees'] for r in found):.2f}",
        f"{rms / np.sqrt(np.mean(sigma**2)):.3f}",
        f"{each.min():.2f} to {each.max():.2f}",
        sum(bool(r["wrong_and_confident"]) for r in found),
        f"{np.median([r['seconds'] for r in found]):.1f}",
    ]


HEADER = (
    "arm", "plan within limits", "runs", "usable", "RMS", "RMS / bound", "NEES/36 [99.8%]", "worst",
    "realised / predicted", "of each gain", "wrong and confident", "s",
)  # fmt: skip


def main() -> None:
    parser = runs.arguments(__doc__, runs=50)
    parser.add_argument("--arm", default=",".join(robots.NAMES), help="names, separated by commas")
    parser.add_argument("--motion", choices=["optimal", "default"], default="optimal")
    parser.add_argument("--estimator", default="map")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        lines, reasons = [], []
        for name in options.arm.split(","):
            path = planned(name, options.motion, Path(scratch) if options.out is None else options.out)
            work = partial(run, name, path, options.seed, options.estimator)
            settings = ["chain", name, options.seed, options.estimator, path.read_text()]
            rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
            lines.append(line(name, path, rows))
            reasons += [(name, kind, count) for kind, count in runs.reasons_of(rows).most_common()]
    runs.table(HEADER, lines)
    if reasons:
        print("\nWhy runs are not usable (some for several reasons):\n")
        runs.table(("arm", "reason", "runs"), reasons)


if __name__ == "__main__":
    main()
