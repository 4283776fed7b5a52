"""Unknown tools drawn from the priors, identified from poses, from motion and from both: is sigma honest?

    python benchmarks/unknown_tools.py --runs 400 --workers 2
    python benchmarks/unknown_tools.py --runs 400 --gain-prior 0.05 --data poses
    python benchmarks/unknown_tools.py --runs 400 --channels 8
    python benchmarks/unknown_tools.py --runs 100 --joints panda_ground

Tools, sensors and logs are those of tool_draws.py; with `--joints` an arm moves in MuJoCo (tool_joints.py).
Sigma over the Cramer-Rao bound (tool_bound.py): RMS, with walk and repeatability as they are found, and as
they are. Beside it the recipe of ten linear parameters with an exact gain and its own formal sigma. Intervals
are Clopper-Pearson's, 95%, of the number of trials.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Sequence
from functools import partial

import numpy as np
import runs
import tool_joints
from numpy.typing import NDArray
from runs import interval
from tool_bound import Truth, bound
from tool_draws import SPREAD, draw, moved, posed, rig_of
from tool_recipe import recipe

import truewrench as tw
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.tool.identify import Evidence
from truewrench.tool.parameters import Layout, inertia_of
from truewrench.tool.prior import make_prior
from truewrench.tool.solve import solve

Array = NDArray[np.float64]
QUANTITIES = ("mass", "centre of mass", "inertia", "offset")
WITHIN = 1.959964


def by_inertia(at: Layout, theta: Array) -> Array:
    """(6, p) of the inertia about the centre of mass by theta."""
    mass, out = float(np.exp(theta[at.log_mass])), np.zeros((6, theta.size))
    out[:, at.log_mass] = inertia_of(mass, theta[at.S])
    out[:, at.S] = np.column_stack([inertia_of(mass, e) for e in np.eye(6)])
    return out


def sigmas(at: Layout, theta: Array, P: Array) -> dict[str, Array]:
    """1 sigma by quantity."""
    std, J = np.sqrt(np.diag(P)), by_inertia(at, theta)
    return {
        "mass": std[[at.log_mass]],
        "centre of mass": std[at.center_of_mass],
        "inertia": np.sqrt(np.einsum("ij,jk,ik->i", J, P, J)),
        "offset": std[at.offset],
    }


def score(tool: tw.Tool, theta: Array, *, inertia: bool) -> dict[str, Array]:
    """Errors in sigma by quantity, NEES of the body, and whether it may be used."""
    at = tool.layout
    error, std = tool.theta - theta, np.sqrt(np.diag(tool.covariance))
    told = np.r_[at.body] if inertia else np.r_[at.log_mass, at.center_of_mass]
    P = tool.covariance[np.ix_(told, told)]
    true = inertia_of(float(np.exp(theta[at.log_mass])), theta[at.S])
    out = {
        "mass": (error / std)[[at.log_mass]],
        "centre of mass": (error / std)[at.center_of_mass],
        "offset": (error / std)[at.offset],
        "nees": np.array([error[told] @ np.linalg.solve(P, error[told]) / told.size]),
        "usable": np.array([float(tool.verdict.usable)]),
    }
    return out | ({"inertia": (tool.inertia - true) / tool.inertia_std} if inertia else {})


def trial(gain_prior: float, data: str, sensor: int | str, spread: float, seed: int) -> runs.Row:
    """One tool, on a sensor of so many channels that moves freely, or on that of an arm."""
    rng, logs, truths = np.random.default_rng(seed), [], []
    rig = rig_of(gain_prior, sensor) if isinstance(sensor, int) else tool_joints.rig_of(sensor, gain_prior)
    theta = draw(rng, rig, seed)
    if isinstance(sensor, int):
        makers = {"poses": partial(posed, spread=spread), "motion": moved}
        made = [make(rng, rig, theta) for kind, make in makers.items() if data in (kind, "both")]
        logs, truths = [log for log, _ in made], [truth for _, truth in made]
    else:
        logs = tool_joints.logs(rng, rig, theta, data)
    found: list[Evidence] = []
    begin = time.process_time()
    tool = tw.identify_tool(rig, logs, threads=1, evidence=found.append)
    seconds = time.process_time() - begin
    inertia = data != "poses" or not truths
    out = score(tool, theta, inertia=inertia) | {"seconds": np.array([seconds])}
    if truths:
        out |= over(rig, found[0], tool, theta, truths)
    out |= of_recipe(rig, logs, theta, moving=inertia)
    return {name: value.tolist() for name, value in out.items()}


def over(rig: Rig, found: Evidence, tool: tw.Tool, theta: Array, truths: list[Truth]) -> dict[str, Array]:
    """Sigma over its bound, by quantity."""
    at, out = tool.layout, {}
    best = sigmas(at, theta, bound(rig, make_prior(rig, rig).covariance, theta, truths))
    stated = {"found": tool.covariance}
    if truths[0].walk:
        sizes = np.log([truths[0].walk, truths[0].repeatability])
        held = solve(found.solution.problem, found.solution.x, sizes)
        stated["known"] = held.covariance[: at.size, : at.size]
    for name, P in stated.items():
        out |= {f"{name} {key}": value / best[key] for key, value in sigmas(at, tool.theta, P).items()}
    return out


def of_recipe(rig: Rig, logs: Sequence[Log], theta: Array, *, moving: bool) -> dict[str, Array]:
    """Errors of the recipe in its own sigma."""
    at = Layout(rig.sensor.n)
    x, sigma = recipe(rig, logs, moving=moving)
    mass = float(np.exp(theta[at.log_mass]))
    offset = theta[at.offset] @ np.linalg.pinv(rig.sensor.nominal_gain_array).T
    true = np.concatenate([[mass], theta[at.center_of_mass], inertia_of(mass, theta[at.S]), offset])
    parts = dict(zip(QUANTITIES, np.split((x - true) / sigma, [1, 4, 10]), strict=True))
    return {f"recipe {name}": z for name, z in parts.items() if np.isfinite(z).all()}


def covered(rows: Sequence[runs.Row], name: str) -> str:
    """How often 95% intervals hold the truth; elements of one trial are not independent, trials are."""
    if name not in rows[0]:
        return "-"
    z = np.concatenate([row[name] for row in rows])
    return interval(float(np.mean(np.abs(z) < WITHIN)) * len(rows), len(rows))


def over_bound(rows: Sequence[runs.Row], name: str) -> str:
    """RMS of sigma over its bound."""
    if name not in rows[0]:
        return "-"
    return f"{np.sqrt(np.mean(np.concatenate([row[name] for row in rows]) ** 2)):.3f}"


def table(rows: Sequence[runs.Row], *, inertia: bool) -> None:
    """Print what was counted."""
    print("| % held by 95% intervals | here | recipe | sigma / bound, sizes found | known |")
    print("|---|---|---|---|---|")
    for name in QUANTITIES:
        if name != "inertia" or inertia:
            cells = (covered(rows, name), covered(rows, f"recipe {name}"))
            cells += (over_bound(rows, f"found {name}"), over_bound(rows, f"known {name}"))
            print(f"| {name} | {' | '.join(cells)} |")
    mean = {key: float(np.mean([row[key] for row in rows])) for key in ("nees", "usable", "seconds")}
    spread = float(np.std([row["nees"] for row in rows])) / np.sqrt(len(rows))
    print(
        f"\nNEES/n of the body {mean['nees']:.2f} +- {spread:.2f}, usable {100 * mean['usable']:.0f}%, "
        f"{mean['seconds']:.2f} s each"
    )


def main() -> None:
    parser = runs.arguments(__doc__, runs=400)
    parser.add_argument("--gain-prior", type=float, default=0.02)
    parser.add_argument("--data", choices=("poses", "motion", "both"), default="both")
    parser.add_argument("--channels", type=int, default=6)
    parser.add_argument("--joints", metavar="ARM", choices=tool_joints.ARMS, help="moved by this arm")
    parser.add_argument("--walk-spread", type=float, default=SPREAD, help="1 sigma of log rates of walks")
    given = parser.parse_args()
    case = (given.gain_prior, given.data, given.joints or given.channels, given.walk_spread)
    work, settings = partial(trial, *case), ["unknown tools", *case]
    indices = range(given.seed, given.seed + given.runs)
    rows = runs.gather(work, indices, given.out, given.workers, settings)
    for row in rows:
        if "nees" not in row:
            print(f"run {row['index']}: {row['reasons'][0]}")
    rows = [row for row in rows if "nees" in row]
    where = f", {given.joints}" if given.joints else f", {given.channels} channels"
    print(f"{len(rows)} tools, {given.data}, gain prior {100 * given.gain_prior:g}%{where}\n")
    table(rows, inertia="inertia" in rows[0])


if __name__ == "__main__":
    main()
