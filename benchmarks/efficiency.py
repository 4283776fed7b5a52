"""Accuracy and honesty of the estimators on the simulated cases: a markdown table per case.

    python benchmarks/efficiency.py --case scenario --seeds 200 --estimators map,online,ekf,ls,spline

RMS is that of the 36 normalised gains over all seeds; efficiency is RMS over the RMS of the Cramer-Rao bound,
taken per seed for its gain and with the prior; NEES/36 is honest when its mean lies in the 99.8% chi-square
interval widened by 0.05. `ekf` stands at the process density of its grid with the least RMS, and at that of
the case.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import re
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import cases
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

import truewrench as tw

Array = NDArray[np.float64]

DENSITIES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
NO_BOUND = (
    "random_walk_0.3",
    "random_walk_3",
    "ripple_20hz",
)  # refused: what they would allow is no yardstick


@dataclass
class Outcome:
    """One estimator on one drawn problem."""

    label: str
    squared_error: float  # mean over the 36 normalised gains
    nees: float  # over 36
    usable: bool
    seconds: float
    reasons: tuple[str, ...] = ()


@dataclass
class Drawn:
    """One drawn problem: the bound on it and what the estimators made of it."""

    bound: float  # trace / 36
    oracle: float
    outcomes: list[Outcome] = field(default_factory=list)


def run_seed(
    name: str, cell: tuple[float, float], estimators: list[str], window: float | None, seed: int
) -> Drawn:
    """All estimators on the problem of one seed."""
    problem = cases.problem(name, cell, seed)
    if name in NO_BOUND:
        drawn = Drawn(np.nan, np.nan)
    else:
        bounds = [np.trace(cases.bound(name, cell, seed, oracle=oracle)) / 36 for oracle in (False, True)]
        drawn = Drawn(*map(float, bounds))
    for estimator in estimators:
        for label, options in variants(name, estimator, window):
            drawn.outcomes.append(score(problem, label, options))
    return drawn


def variants(name: str, estimator: str, window: float | None) -> Iterator[tuple[str, dict[str, object]]]:
    """Labels and options of `calibrate` under which an estimator is run."""
    if estimator == "ekf":
        own = cases.load_case(name).get("ekf", {}).get("process_density")
        for q in sorted({*DENSITIES, *([own] if own else [])}):
            yield f"ekf q={q:g}", {"estimator": "ekf", "process_density": q}
    elif estimator == "online":
        yield "online", {"estimator": "online", "window": window}
    elif estimator == "spline":
        yield "ls --smooth spline", {"estimator": "ls", "smooth": "spline"}
    else:
        yield estimator, {"estimator": estimator}


def score(problem: cases.Problem, label: str, options: dict[str, object]) -> Outcome:
    """Calibrate and compare with the truth, in normalised units."""
    start = time.perf_counter()
    calibration = tw.calibrate(problem.rig, problem.logs, threads=1, **options)
    seconds = time.perf_counter() - start
    error = problem.normalised(calibration.gain - problem.gain).ravel()
    unit = problem.normalised(np.ones_like(problem.gain)).ravel()
    covariance = calibration.covariance[:36, :36] * unit[:, None] * unit
    nees = float(error @ np.linalg.lstsq(covariance, error, rcond=None)[0]) / 36
    verdict = calibration.verdict
    return Outcome(label, float(np.mean(error**2)), nees, verdict.usable, seconds, verdict.reasons)


def report(name: str, cell: tuple[float, float], drawn: list[Drawn], window: float | None) -> None:
    """Print the rows of one noise cell."""
    bound = np.sqrt(np.mean([d.bound for d in drawn]))
    oracle = np.sqrt(np.mean([d.oracle for d in drawn]))
    labels = [o.label for o in drawn[0].outcomes]
    columns = {label: [d.outcomes[i] for d in drawn] for i, label in enumerate(labels)}
    filters = [label for label in labels if label.startswith("ekf")]
    if filters:
        best = min(filters, key=lambda label: np.mean([o.squared_error for o in columns[label]]))
        own = f"ekf q={cases.load_case(name).get('ekf', {}).get('process_density', 0):g}"
        labels = [label for label in labels if label not in filters or label in (best, own)]
        columns = {label: columns[label] for label in labels}
    low, high = chi2.ppf([0.001, 0.999], 36 * len(drawn)) / (36 * len(drawn)) + [-0.05, 0.05]
    for label, outcomes in columns.items():
        rms = np.sqrt(np.mean([o.squared_error for o in outcomes]))
        nees = np.array([o.nees for o in outcomes])
        shown = label
        if filters and label == best:
            shown += " (best of grid)"
        if label == "online" and window:
            shown += f", {window:g} s windows"
        honest = "honest" if low <= nees.mean() <= high else "no"
        usable = np.mean([o.usable for o in outcomes])
        milliseconds = 1e3 * np.median([o.seconds for o in outcomes])
        cells = [
            f"{cell[0]:g}, {cell[1]:g}",
            shown,
            *(f"{value:.5f}" if np.isfinite(value) else "-" for value in (rms, bound, oracle)),
            f"{rms / bound:.3f}" if np.isfinite(bound) else "-",
            f"{nees.mean():.3g}",
            f"{honest} [{low:.2f}, {high:.2f}]",
            f"{nees.max():.3g}",
            f"{usable:.0%}",
            f"{milliseconds:.0f}",
        ]
        print("| " + " | ".join(cells) + " |", flush=True)
    for label, outcomes in columns.items():
        if label.split(",")[0] in ("map", "online"):
            reasons = Counter(re.split(r"[:(]", reason)[0].strip() for o in outcomes for reason in o.reasons)
            for reason, count in reasons.most_common(3):
                print(f"<!-- {label}: {count} of {len(outcomes)}: {reason} -->")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", default="scenario", help="a case of benchmarks/cases.yaml")
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--estimators", default="map,online,ekf,ls,spline")
    parser.add_argument("--cells", help="which noise cells, from 0, comma separated; all if left out")
    parser.add_argument(
        "--window", type=float, help="window of `online` [s]; chosen by the motion if left out"
    )
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    estimators = options.estimators.split(",")
    cells = [tuple(cell) for cell in cases.load_case(options.case)["noise"]]
    if options.cells:
        cells = [cells[int(k)] for k in options.cells.split(",")]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    print(f"Case `{options.case}`, {options.seeds} seeds a cell.\n")
    header = "sf [N], sv|estimator|RMS|bound|oracle|efficiency|NEES/36|honest|worst|usable|ms"
    print("| " + header.replace("|", " | ") + " |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(options.processes) as pool:
        for cell in cells:
            job = partial(run_seed, options.case, cell, estimators, options.window)
            report(options.case, cell, list(pool.map(job, seeds, chunksize=4)), options.window)


if __name__ == "__main__":
    main()
