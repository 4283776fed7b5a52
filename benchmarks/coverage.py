"""Whether the stated sigma is what the errors are, with everything drawn from exactly the rig's priors.

    python benchmarks/coverage.py --case uncertain,gravity --runs 500 --out out/coverage
    python benchmarks/coverage.py --case sinusoids,fourier,ripple --runs 2000 --out out/coverage
    python benchmarks/coverage.py --case tumbling --runs 500 --out out/coverage
    python benchmarks/coverage.py --case clock --runs 200 --out out/coverage

Payload, clock, gain and offset are drawn from the priors of the rig: a gain prior of 0.3, offsets of 10% of
range, and in `uncertain` and `gravity` a payload known to 1% in mass, 2 mm and 5% in inertia with a clock
known to 1 ms; elsewhere payload and clock are exact. No accuracy is required of the rigs. Covered is the
share of the 36 gains within 1.96 stated sigma, over all runs and over those whose verdict is usable; all
else is over all runs. That of wrenches is over other samples of the same sensor, corrected as `apply` does,
against the true wrench. `tumbling`: a free body of 0.7 kg whose forces are the sines of three frequencies
and whose moments their cosines, so that the gain undoes any time offset, with a clock known to 1 ms and a
sensor much better than the velocities. `clock`: 10 ms between the streams with a prior of 10 ms, beside
the same logs without a time offset.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from functools import partial
from typing import Any

import bound_common
import cases
import numpy as np
import runs
from numpy.typing import NDArray
from scipy.stats import chi2

from truewrench import _core
from truewrench.model.motion.trajectory import (
    Body,
    HarmonicTwist,
    Trajectory,
    WrenchSinusoids,
    integrate_wrench,
)
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

Array = NDArray[np.float64]

CELL = (0.5, 1e-3)
CLOCK_CELLS = ((0.5, 1e-3), (0.02, 1e-4))
EXACT = ("sinusoids", "fourier", "ripple")
UNCERTAIN = ("uncertain", "gravity")
KNOTS = {"ripple": 0.03}  # of the bound [s]
SAMPLES = 200  # of the second log
TUMBLING = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [1e-3] * 3 + [2e-6] * 3,
        "range": [10.0] * 3 + [0.02] * 3,
        "gain_prior": 0.1,
        "offset_prior": 0,
        "time_offset_prior": 1e-3,
    },
    "payloads": {
        "default": {
            "mass": 0.7,
            "center_of_mass": [-0.012, 0.015, 0.004],
            "inertia": {"xx": 1.2e-3, "yy": 0.8e-3, "zz": 0.95e-3},
            "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
        }
    },
    "motion": {"source": "twist", "of": "com", "noise": [6e-4] * 6},
    "required": 10.0,
    "simulate": {"rate": 1000, "sensor_rate": 1000, "gain": "random", "time_offset": "random"},
}


def rig_of(name: str, cell: tuple[float, float] = CELL) -> Rig:
    """The rig of a case: that of the case `scenario`, with priors to draw from; or of the free body."""
    if name == "tumbling":
        return Rig.from_mapping(TUMBLING)
    settings = cases.rig_of("scenario", cell).to_mapping()
    settings["required"] = 10.0
    del settings["sensor"]["offset_prior"]
    settings["simulate"] |= {"gain": "random", "offset": "random"}
    if name in UNCERTAIN:
        uncertainty = {"mass": 0.01, "center_of_mass": 0.002, "inertia": 0.05}
        settings["payloads"]["default"]["uncertainty"] = uncertainty
        settings["sensor"]["time_offset_prior"] = 1e-3
        settings["simulate"] |= {"payload": "random", "time_offset": "random"}
    if name == "gravity":
        settings["gravity"] = [0.0, 0.0, -9.81]
        settings["sensor"]["range"] = [1500.0] * 3 + [300.0] * 3
    return Rig.from_mapping(settings)


def motion_of(name: str, seed: int) -> Trajectory:
    """The motion of a run; drawn anew for each, but for sinusoids."""
    if name == "tumbling":
        rate = 2.0 * np.pi * np.array([5, 7, 9]) / 4.0
        forces = WrenchSinusoids.of(0.3 * 0.7 * rate, 3e-4 * rate, np.array([5, 7, 9]), 4.0)
        spec = rig_of(name).payloads["default"]
        body = Body(spec.mass, np.array(spec.center_of_mass), spec.inertia_matrix)
        return integrate_wrench(forces, body, 4.0)
    if name == "ripple":
        return cases.motion_of("ripple_8hz", seed)
    if name == "fourier":
        rng = np.random.default_rng([seed, 5])
        frequency = np.repeat(0.1 * np.arange(1.0, 7.0)[:, None], 6, axis=1)
        amplitude = 0.25 * rng.standard_normal((6, 6)) / np.sqrt(3.0)
        return HarmonicTwist(amplitude, frequency, rng.uniform(0.0, 2.0 * np.pi, (6, 6)), 10.0)
    return cases.motion_of("scenario", seed)


def run(name: str, campaign: int, estimator: str, index: int) -> runs.Row:
    """One row."""
    seed = 1_000_003 * campaign + index
    rig, motion = rig_of(name), motion_of(name, seed)
    simulated = simulate(rig, motion, seed=seed)
    row, found = runs.calibrated(rig, simulated.log, simulated.truth.gain, estimator=estimator)
    row["bound"] = bound_common.rms(
        bound_common.bound(rig, motion, simulated.truth.gain, KNOTS.get(name, 0.2))
    )
    if found is not None and np.isfinite(found.covariance).all():
        row["wrench_covered"] = wrenches_covered(rig, found, simulated.truth, seed)
    return row


def wrenches_covered(rig: Rig, found: Any, truth: Any, seed: int) -> list[float]:
    """Share of the corrected samples of a second log within 1.96 sigma of the truth, per axis (6,)."""
    rng = np.random.default_rng([seed, 7])
    wrench = rig.sensor.range_array * rng.uniform(-0.2, 0.2, (SAMPLES, 6))
    noise = rig.sensor.noise_array * rng.standard_normal((SAMPLES, rig.sensor.n))
    raw = wrench @ truth.gain.T + truth.offset + noise
    corrector = _core.Corrector(found.gain, found.offset, rig.sensor.noise_array, found.covariance)
    corrected, std = corrector.correct(raw)
    inside = np.abs(corrected - wrench) <= runs.WITHIN_95 * std
    return [float(x) for x in inside.mean(axis=0)]


def run_clock(cell: tuple[float, float], campaign: int, estimator: str, index: int) -> runs.Row:
    """One row: the errors with a clock that is 10 ms off and known to 10 ms, and with an exact one."""
    seed = 1_000_003 * campaign + index
    out: runs.Row = {}
    for label, prior, offset in (("exact", 0.0, 0.0), ("unknown", 0.01, 0.01 * (-1) ** index)):
        settings = rig_of("clock", cell).to_mapping()
        settings["sensor"]["time_offset_prior"] = prior
        settings["simulate"] |= {"time_offset": offset}
        rig = Rig.from_mapping(settings)
        simulated = simulate(rig, motion_of("clock", seed), seed=seed)
        row, found = runs.calibrated(rig, simulated.log, simulated.truth.gain, estimator=estimator)
        out |= {f"{label}_{key}": row[key] for key in ("usable", "rms", "nees", "reasons") if key in row}
        if found is not None:
            out[f"{label}_clock_error"] = found.time_offset - offset
    return {"outcome": "calibrated", **out}


def honest(values: Sequence[float], freedom: int) -> str:
    """Mean of NEES over its degrees of freedom, with the 99.8% interval of chi-square."""
    total = freedom * len(values)
    low, high = chi2.ppf([0.001, 0.999], total) / total
    return f"{np.mean(values):.3f} [{low:.3f}, {high:.3f}]"


def mean(values: Sequence[float]) -> str:
    """A share and the standard error of its mean over runs."""
    return f"{np.mean(values):.2%} ± {np.std(values) / np.sqrt(len(values)):.2%}" if len(values) else "-"


def line(name: str, rows: list[runs.Row]) -> list[Any]:
    """A row of the table."""
    found = [r for r in rows if r["outcome"] == "calibrated" and np.isfinite(r["rms"])]
    usable = [r for r in found if r["usable"]]
    wrench = np.array([r["wrench_covered"] for r in found if "wrench_covered" in r])
    squared = [np.mean([r[k] ** 2 for r in found]) for k in ("rms", "bound")]
    return [
        name,
        len(rows),
        f"{len(usable) / len(rows):.1%}",
        mean([r["covered"] for r in found]),
        mean([r["covered"] for r in usable]),
        honest([r["nees"] for r in found], 36),
        f"{max(r['nees'] for r in found):.2f}",
        mean([float(x) for x in wrench.mean(axis=1)]) if len(wrench) else "-",
        f"{np.sqrt(squared[0] / squared[1]):.3f}",
        sum(bool(r["wrong"]) for r in found),
        sum(bool(r["wrong_and_confident"]) for r in usable),
        f"{np.median([r['seconds'] for r in found]):.2f}",
    ]


def main() -> None:
    parser = runs.arguments(__doc__, runs=500)
    parser.add_argument("--case", default="uncertain,gravity,sinusoids,fourier,ripple,clock")
    parser.add_argument("--estimator", default="map")
    options = parser.parse_args()
    lines, refusals = [], []
    for name in options.case.split(","):
        if name == "clock":
            continue
        work = partial(run, name, options.seed, options.estimator)
        settings = ["coverage", name, options.seed, options.estimator]
        rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
        lines.append(line(name, rows))
        refusals += [
            (name, kind, n, next(r["index"] for r in rows if kind in map(runs.kind_of, r["reasons"])))
            for kind, n in runs.reasons_of(r for r in rows if not r.get("usable")).most_common()
        ]
    if lines:
        header = (
            "case", "runs", "usable", "covered, all", "covered, usable", "NEES/36 [99.8%]", "worst",
            "corrected wrenches covered", "RMS / bound", "wrong", "wrong and confident", "s",
        )  # fmt: skip
        runs.table(header, lines)
        print()
        runs.table(("case", "not usable because", "runs", "such as"), refusals)
    if "clock" in options.case.split(","):
        print()
        report_clock(options)


def report_clock(options: Any) -> None:
    """The table of `clock`."""
    lines = []
    for cell in CLOCK_CELLS:
        work = partial(run_clock, cell, options.seed, options.estimator)
        settings = ["clock", cell, options.seed, options.estimator]
        rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
        rows = [r for r in rows if "unknown_rms" in r and "exact_rms" in r]
        exact, unknown = (np.sqrt(np.mean([r[f"{k}_rms"] ** 2 for r in rows])) for k in ("exact", "unknown"))
        clock = np.sqrt(np.mean([r["unknown_clock_error"] ** 2 for r in rows]))
        lines.append(
            (
                f"{cell[0]:g}, {cell[1]:g}", len(rows), f"{exact:.6f}", f"{unknown:.6f}",
                f"{unknown / exact:.3f}", f"{1e3 * clock:.4f}",
                f"{np.mean([r['exact_usable'] for r in rows]):.0%}",
                f"{np.mean([r['unknown_usable'] for r in rows]):.0%}",
                honest([r["unknown_nees"] for r in rows], 36),
            )
        )  # fmt: skip
    header = (
        "sf [N], sv", "runs", "RMS, exact clock", "RMS, 10 ms unknown", "ratio", "clock error [ms]",
        "usable, exact", "usable, unknown", "NEES/36, unknown",
    )  # fmt: skip
    runs.table(header, lines)


if __name__ == "__main__":
    main()
