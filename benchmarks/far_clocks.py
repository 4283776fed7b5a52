"""Sensor and motion stamped by two computers: usable, covered, wrong, and the time.

    python benchmarks/far_clocks.py --runs 320 --workers 2 --out out/far_clocks

Problems of imperfect.py, half on perfect hardware, half with one of its kinds of ordinary size; the sensor is
stamped 0.01 to 4 s too late or too early (log-uniform). Each stands beside its twin, the same log stamped by
one clock. Wrong is what imperfect.py calls so.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from functools import partial

import imperfect
import numpy as np
import runs
import twins
from imperfect import Row

import truewrench as tw
from truewrench.estimation.clock_rate import with_stamps
from truewrench.estimation.far_clock import with_clock_set

NEAREST, FURTHEST = 0.01, 4.0  # [s]
KINDS = tuple(kind for kind in imperfect.RANGES if kind not in ("clock", "jitter"))


def run_one(seed: int, index: int) -> Row:
    """One record, and its twin."""
    rng = np.random.default_rng((seed, index))
    motion = ("six", "six", "one", "joints")[index % 4]
    kind = str(rng.choice(KINDS)) if index // 4 % 2 else "none"
    settings, path = imperfect.settings_of(rng, motion, kind == "gravity" or bool(rng.uniform() < 0.5), 6)
    trajectory = imperfect.motion_of(rng, motion, settings["plan"]["duration"])
    if kind != "none":
        low, middle, _ = np.log(imperfect.RANGES[kind])
        settings["simulate"] |= imperfect.imperfection(
            kind, float(np.exp(rng.uniform(*sorted((low, middle))))), rng
        )
    rig = tw.Rig.from_mapping(settings, path)
    simulate = tw.simulate if motion != "joints" else tw.simulate_arm
    run = simulate(rig, trajectory, seed=int(rng.integers(2**31)))
    late = float(np.exp(rng.uniform(np.log(NEAREST), np.log(FURTHEST))) * rng.choice([-1.0, 1.0]))
    sensed = np.isfinite(run.log.raw).any(axis=1)
    far = with_stamps(run.log, run.log.time_ns[sensed] + round(1e9 * late))
    row: Row = {"late": abs(late), "kind": kind, "motion": motion}
    row["set_in_vain"] = with_clock_set(rig, run.log).clock_set != 0.0
    return row | twins.compared(rig, far, run.log, run.truth)


def main() -> None:
    options = runs.arguments(__doc__, runs=320)
    chosen = options.parse_args()
    rows = runs.gather(
        partial(run_one, chosen.seed), range(chosen.runs), chosen.out, chosen.workers, [chosen.seed]
    )
    lost = [r for r in rows if "late" not in r]
    rows = [r for r in rows if "late" in r]
    groups = [(name, [r for r in rows if r["motion"] == name]) for name in ("six", "one", "joints")]
    groups += [
        ("perfect hardware", [r for r in rows if r["kind"] == "none"]),
        ("imperfect hardware", [r for r in rows if r["kind"] != "none"]),
    ]
    groups += [
        (f"{low:g} to {high:g} s", [r for r in rows if low <= r["late"] < high])
        for low, high in ((0.01, 0.03), (0.03, 0.1), (0.1, 0.3), (0.3, 1.0), (1.0, 4.0))
    ]
    twins.table("records", [*groups, ("all", rows)])
    vain = sum(r["set_in_vain"] for r in rows)
    print(f"\nlost: {len(lost)}; clocks set of twins: {vain}")


if __name__ == "__main__":
    main()
