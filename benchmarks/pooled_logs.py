"""Several logs of one sensor, pooled: usable where they are of one sensor, told where they are not.

    python benchmarks/pooled_logs.py --runs 600 --workers 2 --out out/pooled
    python benchmarks/pooled_logs.py --runs 600 --estimator online --workers 2

Rigs and motions of imperfect.py, six frequencies an axis or joints, two to five logs, truth drawn once from
all stated priors; each log has a motion, an offset and noise of its own, a second payload in a third of the
pools. `sound`: nothing else. `another gain`: one log is of a sensor whose gains have departed by 0.1 to 10%
of range; `another payload`: one log carries 2 to 20% more mass than the rig says. Then the kinds of
imperfect.py, of ordinary size, in all logs; a cable's law is drawn for each. In half of the pools
`discrepancy` is 0. Wrong: a gain beyond 5 sigma and 0.2% of range, of the sensor of most logs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import runs
from imperfect import RANGES, imperfection, motion_of, settings_of

import truewrench as tw
from truewrench.estimation.estimate import AGREE

Row = dict[str, Any]
KINDS = ("sound", "another gain", "another payload", *RANGES)


def run_one(seed: int, estimator: str, kinds: Sequence[str], index: int) -> Row:
    """One pool."""
    rng = np.random.default_rng((seed, index))
    kind = kinds[index % len(kinds)]
    joints = estimator == "map" and rng.uniform() < 0.25
    gravity = kind == "gravity" or bool(rng.uniform() < 0.5)
    settings, path = settings_of(rng, "joints" if joints else "six", gravity, 6)
    settings["sensor"] = {**settings["sensor"], "discrepancy": 0 if rng.uniform() < 0.5 else "auto"}
    if not joints:
        settings["motion"] = {**settings["motion"], "of": "sensor"}  # one point, whatever is carried
    (name, body), *_ = settings["payloads"].items()
    settings["payloads"] = {name: body}
    if rng.uniform() < 1.0 / 3.0:  # of the same shape, and lighter
        inertia = {key: 0.5 * value for key, value in body["inertia"].items()}
        settings["payloads"]["second"] = {**body, "mass": 0.5 * body["mass"], "inertia": inertia}
    count = int(rng.choice([2, 2, 3, 5]))
    odd = int(rng.integers(count)) if kind.startswith("another") else -1
    stated: Row = {}
    if kind in RANGES:
        low, ordinary, _ = np.log(RANGES[kind])
        stated = imperfection(kind, float(np.exp(rng.uniform(*sorted((low, ordinary))))), rng)
    departure = float(np.exp(rng.uniform(np.log(1e-3), np.log(0.1))))
    heavier = float(rng.uniform(1.02, 1.2))

    simulate = tw.simulate_arm if joints else tw.simulate
    drawn = {**settings["simulate"], **stated}
    truth = simulate(
        tw.Rig.from_mapping(settings, path),
        motion_of(rng, "joints" if joints else "six", settings["plan"]["duration"]),
        seed=int(rng.integers(2**31)),
    ).truth
    # one truth for all logs; of a second payload that which is stated
    true = {**settings["payloads"], name: truth.to_mapping()["payloads"][name]}
    span = np.array(settings["sensor"]["range"])
    logs = []
    for k in range(count):
        carried = list(true)[k % len(true)]
        bodies, gain = true, truth.gain
        if k == odd and kind == "another gain":
            gain = gain + departure * rng.normal(size=gain.shape) * span[:, None] / span
        if k == odd and kind == "another payload":
            bodies = {**true, carried: {**true[carried], "mass": heavier * true[carried]["mass"]}}
        plan = {"duration": float(rng.uniform(8.0, 20.0)), "seed": int(rng.integers(2**31))}
        simulated = {**drawn, "gain": gain.tolist(), "payload": "nominal"}
        rig = tw.Rig.from_mapping({**settings, "payloads": bodies, "simulate": simulated, "plan": plan}, path)
        motion = motion_of(rng, "joints" if joints else "six", plan["duration"])
        run = simulate(rig, motion, payload=carried, seed=int(rng.integers(2**31)))
        logs.append(replace(run.log, payload=carried))
    rig = tw.Rig.from_mapping(settings, path)
    row, found = runs.calibrated(rig, logs, truth.gain, estimator=estimator, held_out=False)
    # of two logs either may be the odd one
    row |= {"kind": kind, "stated": settings["sensor"]["discrepancy"], "told": False}
    if found is not None:
        row["told"] = not found.figures["parts_agree"]["logs"] >= AGREE
        row["wrong"] = row["beyond"] and not (count == 2 and kind == "another gain")
    return row


def line(name: str, rows: Sequence[Row]) -> list[str]:
    done = [r for r in rows if r["outcome"] == "calibrated"]
    return [
        name,
        str(len(rows)),
        str(len(rows) - len(done)),
        runs.interval(sum(r["usable"] for r in done), len(done)),
        runs.interval(sum(r["told"] for r in done), len(done)),
        runs.interval(sum(r["usable"] and r["wrong"] for r in done), len(done)),
        f"{np.mean([r['covered'] for r in done]):.3f}" if done else "-",
        f"{np.median([r['seconds'] for r in done]):.1f}" if done else "-",
    ]


def main() -> None:
    parser = runs.arguments(__doc__, runs=600)
    parser.add_argument("--estimator", default="map", choices=["map", "online"])
    parser.add_argument("--kind", default=",".join(KINDS))
    options = parser.parse_args()
    kinds = options.kind.split(",")
    work = partial(run_one, options.seed, options.estimator, kinds)
    settings = {key: str(value) for key, value in vars(options).items() if key not in ("out", "workers")}
    rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
    header = "logs|pools|failed|usable|one log told apart|wrong and usable|coverage|seconds"
    groups = [(kind, [r for r in rows if r.get("kind") == kind]) for kind in kinds]
    imperfect = [r for r in rows if r.get("kind") in RANGES]
    groups += [
        (f"imperfect, `discrepancy: {stated}`", [r for r in imperfect if str(r["stated"]) == stated])
        for stated in ("0", "auto")
    ]
    runs.table(header.split("|"), [line(name, of) for name, of in groups])
    for row in rows:
        if row["outcome"] == "fault":
            print(f"- run {row['index']}: {row['reasons'][0]}")
        elif row.get("usable") and row.get("wrong"):
            print(f"- wrong and usable: run {row['index']}, {row['kind']}")


if __name__ == "__main__":
    main()
