"""Calibration from reference wrenches in Monte Carlo: accuracy and honesty down to a poor signal.

    python benchmarks/reference_wrenches.py

Sensor and reference have the same noise in units of range. Loads have a spread of 0.3 of range; gain and
offset are drawn from their priors, 0.3 and 0.1. `one body`: the moment follows from the force, as that of a
weight does. `regression` takes the reference for exact, and states the sigma of the sensor's noise alone.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one process per core; before NumPy is imported

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from truewrench.estimate.reference import estimate_from_reference
from truewrench.log import Log
from truewrench.rig import Rig

Array = NDArray[np.float64]

SPREAD = 0.3
SIGNALS = (1000, 100, 10, 5, 3, 1.5)  # spread of the loads over noise
ROWS = (24, 200, 5000)
LEVER = (0.4, -0.2, 0.5)  # of the one body, in ranges of moment per range of force


def rig_of(noise: float) -> Rig:
    """Everything in units of range."""
    body = {"mass": 1, "center_of_mass": [0, 0, 0], "inertia": {"xx": 1, "yy": 1, "zz": 1}}
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": [noise] * 6,
                "range": [1] * 6,
                "gain_prior": 0.3,
            },
            "payloads": {"default": body},
            "motion": {"noise": [1e-3] * 6},
            "reference_noise": [noise] * 6,
        }
    )


def trial(seed: int, signal: float, rows: int, one_body: bool) -> tuple[float, float, float, float, float]:
    """Squared error, stated variance, NEES/42, share within 95% limits; NEES/42 of plain regression."""
    rig, noise = rig_of(SPREAD / signal), SPREAD / signal
    draw = np.random.default_rng(seed)
    gain = np.eye(6) + 0.3 * draw.standard_normal((6, 6))
    offset = 0.1 * draw.standard_normal(6)
    wrench = SPREAD * draw.standard_normal((rows, 6))
    if one_body:
        wrench[:, 3:] = np.cross(LEVER, wrench[:, :3])
    raw = wrench @ gain.T + offset + noise * draw.standard_normal((rows, 6))
    reference = wrench + noise * draw.standard_normal((rows, 6))
    log = Log(None, "default", "", np.arange(rows) * 10**9, raw, reference=reference)
    found = estimate_from_reference(rig, [log])
    error = np.append((found.gain - gain).ravel(), found.offsets[0] - offset)
    P = found.normalised_covariance
    nees = float(error @ np.linalg.solve(P, error)) / 42
    within = float(np.mean(np.abs(error) < 1.96 * np.sqrt(np.diag(P))))

    design = np.column_stack([reference, np.ones(rows)])
    prior = np.diag([0.3**-2.0] * 6 + [0.1**-2.0])
    information = design.T @ design / noise**2 + prior
    start = np.column_stack([np.eye(6), np.zeros(6)])
    fitted = np.linalg.solve(information, design.T @ raw / noise**2 + prior @ start.T).T
    off = fitted - np.column_stack([gain, offset])
    regression = float(np.einsum("ij,jk,ik->", off, information, off)) / 42
    return float(np.mean(error[:36] ** 2)), float(np.mean(np.diag(P)[:36])), nees, within, regression


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    print(f"{options.trials} trials a row.\n")
    names = [
        "loads",
        "rows",
        "signal / noise",
        "RMS",
        "stated",
        "NEES/42",
        "within 95%",
        "regression: NEES/42",
    ]
    print("| " + " | ".join(names) + " |\n" + "|---" * len(names) + "|")
    with ProcessPoolExecutor(options.processes) as pool:
        for one_body, rows, signal in product((False, True), ROWS, SIGNALS):
            run = partial(trial, signal=signal, rows=rows, one_body=one_body)
            results = np.array(list(pool.map(run, range(options.trials), chunksize=10)))
            squared, variance, nees, within, regression = results.mean(axis=0)
            cells = ["one body" if one_body else "independent", f"{rows}", f"{signal:g}"]
            cells += [f"{np.sqrt(squared):.4g}", f"{np.sqrt(variance):.4g}", f"{nees:.3f}", f"{within:.1%}"]
            print("| " + " | ".join([*cells, f"{regression:.3g}"]) + " |", flush=True)


if __name__ == "__main__":
    main()
