"""Accuracy and honesty of the estimators on the simulated cases: a markdown table per case.

    python benchmarks/efficiency.py --case scenario --seeds 200 --estimators map,online,ekf,ls,spline

RMS is that of the 36 normalised gains over all seeds, median that of a seed. Efficiency is RMS over the
RMS of the Cramer-Rao bound, taken per seed for its gain and with the prior. NEES/36 is honest when its
mean lies in the 99.8% chi-square interval widened by 0.05. In brackets stands what an efficient, honest
estimator shows when gains are drawn more narrowly than the prior says. `ekf` starts with the acceleration
of the case, and is shown at the densities of its grid with the least RMS: one for all axes, and a pair
(linear, angular). `known` is regression on the true motion: the draw of the noise alone.
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
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import cases
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

import truewrench as tw
from truewrench.estimation.ekf import estimate_ekf

Array = NDArray[np.float64]

DENSITIES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0, 10000.0)
PAIRED = (0.001, 0.01, 0.1, 1.0, 10.0, 100.0, 1000.0, 10000.0)  # all pairs of them
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
    expected_squared_error: float  # of an efficient estimator, for gains drawn with the spread of the case
    expected_nees: float
    outcomes: list[Outcome]


def run_seed(name: str, cell: tuple[float, float], estimators: list[str], seed: int) -> Drawn:
    """All estimators on the problem of one seed."""
    problem = cases.problem(name, cell, seed)
    outcomes: list[Outcome] = []
    for estimator in estimators:
        if estimator == "ekf":
            outcomes += filtered(name, problem)
        elif estimator == "known":
            outcomes.append(with_known_motion(name, cell, seed, problem))
        else:
            outcomes.append(calibrated(problem, estimator))
    if name in NO_BOUND:
        return Drawn(np.nan, np.nan, np.nan, np.nan, outcomes)
    bound, oracle = (cases.bound(name, cell, seed, oracle=oracle) for oracle in (False, True))
    case = cases.load_case(name)
    # E e e^T = P - k P P: the prior counts on a spread gain_prior, the gains have a smaller one
    prior = case["gain_prior"]
    k = (1.0 - (case["spread"] / prior) ** 2) / prior**2
    squared, trace = np.sum(bound**2) / 36, np.trace(bound) / 36
    return Drawn(trace, np.trace(oracle) / 36, trace - k * squared, 1.0 - k * trace, outcomes)


def filtered(name: str, problem: cases.Problem) -> Iterator[Outcome]:
    """The published filter at all process densities of the grid."""
    acceleration = cases.load_case(name).get("ekf", {}).get("acceleration_prior")
    for linear, angular in dict.fromkeys([*zip(DENSITIES, DENSITIES, strict=True), *product(PAIRED, PAIRED)]):
        start = time.perf_counter()
        estimate = estimate_ekf(
            problem.rig,
            problem.logs,
            process_density=[linear] * 3 + [angular] * 3,
            acceleration_prior=acceleration,
            history_every=10**9,
        )
        seconds = time.perf_counter() - start
        label = f"ekf q = {linear:g}" if linear == angular else f"ekf q_v = {linear:g}, q_o = {angular:g}"
        squared, nees = score(problem, estimate.gain, estimate.covariance)
        yield Outcome(label, squared, nees, False, seconds)


def with_known_motion(name: str, cell: tuple[float, float], seed: int, problem: cases.Problem) -> Outcome:
    """Linear regression on the true motion: by how much chance alone departs from the oracle."""
    start = time.perf_counter()
    wrench = cases.information(name, cell, seed).wrench
    prior, variance = cases.load_case(name)["gain_prior"] ** 2, cases.normalised_noise(name, cell) ** 2
    raw = problem.logs[0].raw / np.array(cases.load_case(name)["range"])
    gain, covariance = np.empty((6, 6)), np.zeros((36, 36))
    for i in range(6):
        of_row = np.linalg.inv(wrench.T @ wrench / variance[i] + np.eye(6) / prior)
        gain[i] = of_row @ (wrench.T @ raw[:, i] / variance[i] + np.eye(6)[i] / prior)
        covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = of_row
    unit = problem.normalised(np.ones((6, 6)))
    in_si = covariance / unit.ravel()[:, None] / unit.ravel()
    squared, nees = score(problem, gain / unit, in_si)
    return Outcome("regression, motion known", squared, nees, False, time.perf_counter() - start)


def calibrated(problem: cases.Problem, label: str) -> Outcome:
    """What `truewrench calibrate` makes of it."""
    options: dict[str, Any] = {"estimator": label}
    if label == "spline":
        options, label = {"estimator": "ls", "smooth": "spline"}, "ls --smooth spline"
    start = time.perf_counter()
    calibration = tw.calibrate(problem.rig, problem.logs, threads=1, **options)
    seconds = time.perf_counter() - start
    verdict = calibration.verdict
    squared, nees = score(problem, calibration.gain, calibration.covariance)
    return Outcome(label, squared, nees, verdict.usable, seconds, verdict.reasons)


def score(problem: cases.Problem, gain: Array, covariance: Array) -> tuple[float, float]:
    """Mean squared error and NEES/36 in normalised units."""
    error = problem.normalised(gain - problem.gain).ravel()
    unit = problem.normalised(np.ones_like(problem.gain)).ravel()
    normalised = covariance[:36, :36] * unit[:, None] * unit
    nees = float(error @ np.linalg.lstsq(normalised, error, rcond=None)[0]) / 36
    return float(np.mean(error**2)), nees


def report(cell: tuple[float, float], drawn: list[Drawn]) -> list[str]:
    """Print the rows of one noise cell; return the commonest reasons why results are not to be used."""
    bound, oracle, expected = (
        np.sqrt(np.mean([getattr(d, key) for d in drawn]))
        for key in ("bound", "oracle", "expected_squared_error")
    )
    expected_nees = np.mean([d.expected_nees for d in drawn])
    columns: dict[str, list[Outcome]] = {}
    for outcome in (o for d in drawn for o in d.outcomes):
        columns.setdefault(outcome.label, []).append(outcome)
    filters = [label for label in columns if label.startswith("ekf")]
    kept = {min(group, key=lambda x: mean_square(columns[x])) for group in by_densities(filters)}
    low, high = chi2.ppf([0.001, 0.999], 36 * len(drawn)) / (36 * len(drawn)) + np.array([-0.05, 0.05])
    for label, outcomes in columns.items():
        if label in filters and label not in kept:
            continue
        rms = np.sqrt(mean_square(outcomes))
        median = np.median([np.sqrt(o.squared_error) for o in outcomes])
        nees = np.array([o.nees for o in outcomes])
        honest = "honest" if low <= nees.mean() <= high else "no"
        numbers = [f"{x:.5f}" if np.isfinite(x) else "-" for x in (rms, median, bound, oracle)]
        shares = [f"{rms / bound:.3f} ({expected / bound:.3f})", f"{nees.mean():.3g} ({expected_nees:.2f})"]
        cells = [
            f"{cell[0]:g}, {cell[1]:g}",
            label,
            *numbers,
            *(shares if np.isfinite(bound) else ["-", f"{nees.mean():.3g}"]),
            f"{honest} [{low:.2f}, {high:.2f}]",
            f"{nees.max():.3g}",
            f"{np.mean([o.usable for o in outcomes]):.0%}",
            f"{1e3 * np.median([o.seconds for o in outcomes]):.0f}",
        ]
        print("| " + " | ".join(cells) + " |", flush=True)
    notes = []
    for label in ("map", "online"):
        reasons = (re.split(r"[:(]", r)[0].strip() for o in columns.get(label, []) for r in o.reasons)
        for reason, count in Counter(reasons).most_common(3):
            notes.append(f"- {cell[0]:g}, {cell[1]:g}, {label}: {count} of {len(drawn)}: {reason}")
    return notes


def mean_square(outcomes: list[Outcome]) -> float:
    """Of the error of a gain."""
    return float(np.mean([o.squared_error for o in outcomes]))


def by_densities(filters: list[str]) -> Iterator[list[str]]:
    """One density for all axes, and pairs of densities."""
    for paired in (False, True):
        if group := [label for label in filters if ("q_v" in label) == paired]:
            yield group


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", default="scenario", help="a case of benchmarks/cases.yaml")
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--estimators", default="map,online,ekf,ls,spline")
    parser.add_argument("--cells", help="which noise cells, from 0, comma separated; all if left out")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    estimators = options.estimators.split(",")
    cells = [tuple(cell) for cell in cases.load_case(options.case)["noise"]]
    if options.cells:
        cells = [cells[int(k)] for k in options.cells.split(",")]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    print(f"Case `{options.case}`, {options.seeds} seeds a cell.\n")
    header = "sf [N], sv|estimator|RMS|median|bound|oracle|efficiency|NEES/36|honest|worst|usable|ms"
    print("| " + header.replace("|", " | ") + " |")
    print("|---" * 12 + "|")
    reasons: list[str] = []
    with ProcessPoolExecutor(options.processes) as pool:
        for cell in cells:
            job = partial(run_seed, options.case, cell, estimators)
            drawn = list(pool.map(job, seeds, chunksize=4))
            reasons += report(cell, drawn)
    if reasons:
        print("\nNot to be used:\n\n" + "\n".join(reasons))


if __name__ == "__main__":
    main()
