"""Healthy problems of every sort: how often a sound record is usable, covered, needlessly refused, or wrong.

    python benchmarks/healthy.py --runs 2000 --workers 2 --out out/healthy
    python benchmarks/healthy.py --runs 2000 --workers 2 --discrepancy auto --out out/healthy

Of ten runs five are random rigs (grid.py) of up to 10,000 samples, drawn again until one counts there; two
are `clean` and one `mass as stated` (confident.py); one moves by the joints of a packaged arm (imperfect.py,
without imperfection); one is a case of cases.yaml with the gain drawn from its prior, each noise cell in
turn, where the bound leaves no direction undetermined. Truths are drawn from all stated priors; no accuracy
is required. A gain beyond 5 sigma and 0.2% of range is wrong. Wrenches: coverage.py has their definition.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from functools import partial
from itertools import count
from typing import Any

import bound_common
import cases
import confident
import coverage
import grid
import imperfect
import numpy as np
import runs

import truewrench as tw
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

Problem = tuple[str, Rig, Log, Any, float | None]  # kind, rig, log, truth, RMS of the bound

SAMPLES = 10_000
TURN = ("grid", "clean", "grid", "joints", "grid", "mass as stated", "grid", "clean", "grid", "cases")
NAMES = ("scenario", "ripple_8hz", "ripple_20hz", "random_walk_0.3", "random_walk_3", "slow", "tumbling")
SPACING = {"ripple_8hz": 0.03, "ripple_20hz": 0.015, "slow": 2.0, "tumbling": 0.1}  # of the bound [s]


def random_rig(seed: int, index: int) -> Problem:
    """The first of the random problems of this index that counts."""
    for attempt in count():
        drawn, run = grid.problem(seed, 1000 * index + attempt, SAMPLES)
        row = grid.difficulty(drawn, run.truth)
        if grid.suits(row):
            return f"random, {row['kind']}", drawn.rig, run.log, run.truth, row["bound"]
    raise AssertionError


def of_confident(kind: str, seed: int, index: int) -> Problem:
    """A control of confident.py."""
    rig, log, run, _ = confident.problem(kind, seed, index)
    return kind, rig, log, run.truth, None


def joints(seed: int, index: int) -> Problem:
    """A packaged arm that moves through the joint motions of its own."""
    rng = np.random.default_rng([seed, index, 31])
    settings, path = imperfect.settings_of(rng, "joints", gravity=False, n=6)
    rig = Rig.from_mapping({**settings, "required": 10.0}, path)
    run = tw.simulate_arm(rig, None, seed=int(rng.integers(2**31)))
    return "joints", rig, run.log, run.truth, None


def of_cases(seed: int, index: int) -> Problem:
    """The next cell of the cases that leaves no direction undetermined."""
    cells = [(name, tuple(cell)) for name in NAMES for cell in cases.load_case(name)["noise"]]
    for attempt in count():
        name, cell = cells[(index // len(TURN) + attempt) % len(cells)]
        rig, motion = cases.rig_of(name, cell, gain="random"), cases.motion_of(name, index)
        rig = Rig.from_mapping({**rig.to_mapping(), "required": 10.0})
        run = simulate(rig, motion, seed=1_000_003 * seed + index)
        if isinstance(motion, cases.SampledTwist):
            return name, rig, run.log, run.truth, None
        covariance = bound_common.bound(rig, motion, run.truth.gain, SPACING.get(name, 0.2))
        if grid.undetermined(rig, covariance) < grid.DETERMINED:
            return name, rig, run.log, run.truth, bound_common.rms(covariance)
    raise AssertionError


def run_one(seed: int, discrepancy: float | str, index: int) -> runs.Row:
    """One row."""
    turn = TURN[index % len(TURN)]
    make = {"grid": random_rig, "joints": joints, "cases": of_cases}.get(turn, partial(of_confident, turn))
    kind, rig, log, truth, bound = make(seed, index)
    rig = rig.model_copy(update={"sensor": rig.sensor.model_copy(update={"discrepancy": discrepancy})})
    row, found = runs.calibrated(rig, log, truth.gain)
    if found is not None and np.isfinite(found.covariance).all():
        drawn = coverage.wrenches_covered(rig, found, truth, 1_000_003 * seed + index)
        row["wrench_covered"] = float(np.mean(drawn))
    return {"kind": kind, "bound": bound, **row}


def line(name: str, rows: Sequence[runs.Row]) -> list[Any]:
    """A row of the table."""
    told = [r for r in rows if r["outcome"] == "calibrated"]
    usable = [r for r in told if r["usable"]]
    sigma = [r["stated"] / r["bound"] for r in usable if r["bound"]]
    return [
        name,
        len(rows),
        runs.interval(len(usable), len(rows)),
        runs.interval(sum(not (r["usable"] or r.get("beyond")) for r in rows), len(rows)),
        runs.interval(sum(r["beyond"] for r in usable), len(rows)),
        coverage.mean([r["covered"] for r in usable]),
        coverage.mean([r["wrench_covered"] for r in usable if "wrench_covered" in r]),
        f"{np.mean([r['nees'] for r in usable]):.3f}" if usable else "-",
        f"{np.median(sigma):.3f}" if sigma else "-",
        f"{np.median([r['seconds'] for r in told]):.2f}" if told else "-",
    ]


def main() -> None:
    parser = runs.arguments(__doc__, runs=2000)
    parser.add_argument("--discrepancy", default="0", help="of the rigs; auto: the default of the product")
    options = parser.parse_args()
    stated = "auto" if options.discrepancy == "auto" else float(options.discrepancy)
    work = partial(run_one, options.seed, stated)
    settings = ["healthy", options.seed, stated]
    rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
    faults = [r for r in rows if r["outcome"] == "fault"]
    for r in faults[:10]:
        print(f"fault: {r['index']}: {r['reasons'][0]}")
    kinds = sorted({r["kind"] for r in rows if "kind" in r})
    groups = [("all", rows)] + [(k, [r for r in rows if r.get("kind") == k]) for k in kinds]
    header = (
        "runs of", "runs", "usable", "refused, no gain wrong", "usable and wrong", "gains covered",
        "wrenches covered", "NEES / dof", "sigma over bound", "s",
    )  # fmt: skip
    runs.table(header, [line(name, members) for name, members in groups])
    bad = [r for r in rows if not r["usable"]]
    print(f"\nWhy {len(bad)} are not usable (some for several reasons):\n")
    runs.table(("reason", "runs"), runs.reasons_of(bad).most_common())


if __name__ == "__main__":
    main()
