"""What a higher rate is worth: RMS of the gains from one motion, sampled at 100 Hz to 1 kHz.

    python benchmarks/rates.py --runs 100 --out out/rates

The motion of the case `scenario`, the same noise per sample at every rate: where white noise dominates, ten
times the samples are worth a factor of 3.2. `ls` differentiates the samples, `ls --smooth spline` a spline.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from functools import partial
from typing import Any

import bound_common
import cases
import numpy as np
import runs

from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

RATES = (100, 200, 500, 1000)
CELLS = ((0.1, 1e-4), (0.5, 1e-4), (0.5, 1e-3), (5.0, 1e-3))
ESTIMATORS: dict[str, dict[str, Any]] = {
    "map": {"estimator": "map"},
    "online": {"estimator": "online"},
    "ls": {"estimator": "ls"},
    "ls --smooth spline": {"estimator": "ls", "smooth": "spline"},
}


def rig_of(cell: tuple[float, float], rate: float) -> Rig:
    """The rig of the scenario at another rate."""
    settings = cases.rig_of("scenario", cell).to_mapping()
    settings["simulate"] |= {"gain": "random", "rate": rate, "sensor_rate": rate}
    settings["sensor"]["gain_prior"] = 0.2
    return Rig.from_mapping(settings)


def run(cell: tuple[float, float], campaign: int, index: int) -> runs.Row:
    """One row: all rates and estimators on one gain."""
    seed = 1_000_003 * campaign + index
    row: runs.Row = {"outcome": "calibrated"}
    for rate in RATES:
        rig = rig_of(cell, rate)
        motion = cases.motion_of("scenario", seed)
        simulated = simulate(rig, motion, seed=seed)
        truth = simulated.truth.gain
        row[f"bound {rate}"] = bound_common.rms(bound_common.bound(rig, motion, truth, 0.2))
        for name, how in ESTIMATORS.items():
            found = runs.calibrate_row(rig, simulated.log, truth, **how)
            row[f"{name} {rate}"] = found.get("rms")
            row[f"{name} {rate} usable"] = found["usable"]
    return row


def main() -> None:
    parser = runs.arguments(__doc__, runs=100)
    options = parser.parse_args()
    lines = []
    for cell in CELLS:
        settings = ["rates", cell, options.seed]
        rows = runs.gather(
            partial(run, cell, options.seed), range(options.runs), options.out, options.workers, settings
        )
        for r in [r for r in rows if r["outcome"] == "fault"][:3]:
            print(f"fault: {r['index']}: {r['reasons'][0]}")
        rows = [r for r in rows if r["outcome"] != "fault"]
        for name in (*ESTIMATORS, "bound"):
            rms = [np.sqrt(np.mean([r[f"{name} {rate}"] ** 2 for r in rows])) for rate in RATES]
            share = [r.get(f"{name} {rate} usable", False) for r in rows for rate in RATES]
            usable = f"{np.mean(share):.1%}" if name in ("map", "online") else "-"
            cells = [f"{x:.6f}" for x in rms]
            lines.append(
                (
                    f"{cell[0]:g}, {cell[1]:g}",
                    name,
                    *cells,
                    f"{rms[0] / rms[-1]:.2f}",
                    f"{rms[2] / rms[0]:.2f}",
                    usable,
                )
            )
    header = (
        "sf [N], sv",
        "estimator",
        *(f"{rate} Hz" for rate in RATES),
        "100 Hz / 1 kHz",
        "500 Hz / 100 Hz",
        "usable",
    )
    runs.table(header, lines)


if __name__ == "__main__":
    main()
