"""Records of imperfect hardware: usable, covered, wrong although usable, kind by kind, each beside its twin.

    python benchmarks/imperfect.py --runs 2000 --workers 2 --out out/imperfect
    python benchmarks/imperfect.py --runs 500 --pairs --workers 2
    python benchmarks/imperfect.py --runs 500 --estimator online --workers 2

Kinds and ranges of strengths as docs/imperfections.md defines them, log-uniform; `ordinary` are the sizes of
the first part of a range. Three quarters carry Table 1 (500 N, 50 N m), one quarter 5 kg (50 N, 5 N m);
8 to 20 s, 100 Hz to 1 kHz, half in gravity; half move at six frequencies an axis, a quarter at one, a quarter
are a packaged arm's joints; a tenth have eight channels. The truth is drawn from all stated priors. The twin
is the same record on perfect hardware. A result is wrong when some gain is off by more than 5 sigma and 0.2%
of range. Rates with their 95% binomial intervals.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import runs
from numpy.typing import NDArray

import truewrench as tw
from truewrench import robots
from truewrench.model.motion.trajectory import HarmonicTwist
from truewrench.model.rig import load_rig

Array = NDArray[np.float64]
Row = dict[str, Any]

SCENARIO = ((0.02, 1e-4), (0.1, 1e-4), (0.5, 1e-4), (0.5, 1e-3))  # noise of force [N], of the twist
SIX = np.array([0.15, 0.3, 0.45, 0.65, 0.85, 1.1])  # [Hz]
ARMS = ("panda_ground", "ur10_ground")
REQUIRED = 0.05
SLOW = ("hysteresis", "cable", "drift", "random_walk")

# from, to of `ordinary`, to of all
RANGES: dict[str, tuple[float, float, float]] = {
    "hysteresis": (3e-4, 2e-3, 1e-2),
    "nonlinearity": (3e-4, 5e-3, 1e-2),
    "cable": (1e-4, 1e-3, 5e-3),
    "drift": (1e-4, 1e-3, 1e-2),
    "random_walk": (1e-4, 3e-4, 3e-3),
    "velocity_filter": (200.0, 20.0, 10.0),
    "sensor_filter": (200.0, 40.0, 20.0),
    "clock": (3e-4, 5e-3, 1e-2),
    "jitter": (1e-4, 1e-3, 2e-3),
    "vibration": (3e-4, 5e-3, 1e-2),
    "resolution": (1.0, 10.0, 20.0),
    "noise": (0.5, 2.0, 5.0),
    "gravity": (0.02, 0.3, 1.0),
    "step": (3e-3, 1e-2, 5e-2),
    "contact": (1e-2, 1e-1, 3e-1),
    "spikes": (1e-2, 1e-1, 3e-1),
}
# what a refusal may call it
CAUSES = {
    "random_walk": ("drift",),
    "velocity_filter": ("filter", "delay"),
    "sensor_filter": ("filter", "delay"),
    "clock": ("clock", "delay"),
    "spikes": ("outliers",),
}


def imperfection(kind: str, size: float, rng: np.random.Generator) -> dict[str, Any]:
    """A kind as keys of `simulate`."""
    if kind == "clock":
        return {"time_offset": float(size * rng.choice([-1.0, 1.0]))}
    order = int(rng.integers(1, 3))
    stated: dict[str, Any] = {
        "hysteresis": {"size": size, "form": str(rng.choice(["play", "dahl"]))},
        "velocity_filter": {"hz": size, "order": order},
        "sensor_filter": {"hz": size, "order": order},
        "vibration": {"size": size},
        "contact": {"size": size},
        "step": {"size": size},
        "spikes": {"size": size},
        "gravity": float(np.deg2rad(size)),
    }
    name = {"resolution": "quantisation", "gravity": "gravity_tilt"}.get(kind, kind)
    return {"imperfections": {name: stated.get(kind, size)}}


def settings_of(rng: np.random.Generator, motion: str, gravity: bool, n: int) -> tuple[dict[str, Any], Any]:
    """A rig as a mapping, and its path if it is an arm's."""
    force, velocity = SCENARIO[rng.integers(4)]
    light = bool(rng.uniform() < 0.25)
    scale = 0.1 if light else 1.0
    span = [500.0 * scale] * 3 + [50.0 * scale] * 3
    noise = [force * scale] * 3 + [0.1 * force * scale] * 3
    body = (
        {"mass": 5.0, "center_of_mass": [0.02, 0.03, 0.1], "inertia": {"xx": 0.04, "yy": 0.03, "zz": 0.02}}
        if light
        else {"mass": 50.0, "center_of_mass": [0.2, 0, 0], "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4}}
    )
    sensor: dict[str, Any] = {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": noise,
        "range": span,
    }
    if n == 8:  # gauges: random rows of unit size
        rows = rng.normal(size=(8, 6))
        rows /= np.abs(rows).sum(axis=1, keepdims=True)
        sensor |= {
            "channels": [f"g{i}" for i in range(8)],
            "noise": [force * scale / span[0]] * 8,
            "nominal_gain": (rows / np.array(span)).tolist(),
        }
    rate = float(np.exp(rng.uniform(np.log(100.0), np.log(1000.0))))
    settings: dict[str, Any] = {
        "sensor": sensor,
        "payloads": {"default": body},
        "motion": {"source": "twist", "of": "com", "noise": [velocity] * 6},
        "gravity": [0, 0, -9.81] if gravity else [0, 0, 0],
        "required": REQUIRED,
        "plan": {"duration": float(rng.uniform(8.0, 20.0))},
        "simulate": {"rate": rate, "sensor_rate": rate, "payload": "random", "time_offset": "random"},
    }
    if motion != "joints":
        return settings, None
    path = robots.path(ARMS[rng.integers(len(ARMS))])
    arm = load_rig(path).to_mapping()
    for key in ("motion", "limits"):
        settings[key] = arm[key]
    settings["simulate"]["rate"] = settings["simulate"]["sensor_rate"] = min(rate, 250.0)
    settings["payloads"]["default"] = next(iter(arm["payloads"].values()))
    settings["sensor"] = arm["sensor"]
    settings["gravity"] = arm["gravity"]
    return settings, path


def motion_of(rng: np.random.Generator, kind: str, duration: float) -> HarmonicTwist | None:
    """Six frequencies an axis or one, as the definitions have them; None: the arm's own."""
    if kind == "joints":
        return None
    if kind == "six":
        frequency = np.tile(SIX[:, None], (1, 6))
        amplitude = 0.25 * rng.uniform(0.2, 0.7, (6, 6))
    else:
        frequency = rng.permutation([0.25, 0.37, 0.5, 0.65, 0.82, 1.05])[None]
        amplitude = 0.25 * np.sqrt(6.0) * rng.uniform(0.3, 0.6, (1, 6))
    return HarmonicTwist(amplitude, frequency, rng.uniform(0, 2 * np.pi, amplitude.shape), duration)


def run_one(seed: int, pairs: bool, ordinary: bool, estimator: str, twins: bool, index: int) -> Row:
    """One record, and its twin."""
    rng = np.random.default_rng((seed, index))
    names = list(RANGES)
    kinds = [names[index % len(names)]] if not pairs else rng.choice(names, 2, replace=False).tolist()
    motion = ("six", "six", "one", "joints")[index // len(names) % 4]
    gravity = "gravity" in kinds or bool(index // (4 * len(names)) % 2)
    n = 8 if rng.uniform() < 0.1 and motion != "joints" else 6
    settings, path = settings_of(rng, motion, gravity, n)
    trajectory = motion_of(rng, motion, settings["plan"]["duration"])
    drawn = int(rng.integers(2**31))
    sizes, stated = [], {"imperfections": {}}
    for kind in kinds:
        low, middle, high = np.log(RANGES[kind])
        sizes.append(float(np.exp(rng.uniform(*sorted((low, middle if ordinary else high))))))
        found = imperfection(kind, sizes[-1], rng)
        stated["imperfections"] |= found.pop("imperfections", {})
        stated |= found
    is_ordinary = all(
        (s - RANGES[k][1]) * np.sign(RANGES[k][1] - RANGES[k][0]) <= 0
        for s, k in zip(sizes, kinds, strict=True)
    )
    row: Row = {"kinds": kinds, "sizes": sizes, "motion": motion, "ordinary": bool(is_ordinary), "n": n}
    for name, extra in (("", stated), ("twin_", {})):
        if name and not twins:
            break
        rig = tw.Rig.from_mapping({**settings, "simulate": {**settings["simulate"], **extra}}, path)
        simulate = tw.simulate if motion != "joints" else tw.simulate_arm
        run = simulate(rig, trajectory, seed=drawn)
        made, calibration = runs.calibrated(rig, run.log, run.truth.gain, estimator=estimator, held_out=False)
        if calibration is not None:
            made["wrong"] = made["beyond"]
        row |= {name + key: value for key, value in made.items()}
    return row


def named(row: Row) -> int:
    """Place of the right kind among those that a refusal names; -1: it names none of them."""
    right = {cause for kind in row["kinds"] for cause in CAUSES.get(kind, (kind,))}
    text = " ".join(row["reasons"])
    listed = sorted((text.find(k), k) for k in (*RANGES, "filter", "delay", "outliers") if k in text)
    return next((i for i, (_, k) in enumerate(listed) if k in right), -1)


def line(name: str, rows: Sequence[Row]) -> list[str]:
    done = [r for r in rows if r["outcome"] == "calibrated"]
    usable = [r for r in done if r["usable"]]
    asked = [r for r in done if r.get("twin_usable")]
    ordinary = [r for r in asked if r["ordinary"]]
    ratio = [r["seconds"] / r["twin_seconds"] for r in done if r.get("twin_seconds")]
    # by what is imperfect: the twin is usable, or more than accuracy speaks against it
    refused = [
        r
        for r in done
        if not r["usable"] and (r.get("twin_usable") or not all("accuracy" in x for x in r["reasons"]))
    ]
    return [
        name,
        str(len(rows)),
        str(len(rows) - len(done)),
        runs.interval(sum(r["usable"] for r in ordinary), len(ordinary)),
        runs.interval(sum(r["usable"] for r in asked), len(asked)),
        runs.interval(sum(r["wrong"] for r in usable), len(done)),
        f"{np.mean([r['covered'] for r in done]):.3f}" if done else "-",
        f"{np.median([r['nees'] for r in done]):.2f}" if done else "-",
        f"{np.median(ratio):.1f} ({np.max(ratio):.1f})" if ratio else "-",
        runs.interval(sum(named(r) >= 0 for r in refused), len(refused)),
        runs.interval(sum(named(r) == 0 for r in refused), len(refused)),
    ]


def main() -> None:
    parser = runs.arguments(__doc__, runs=2000)
    parser.add_argument("--pairs", action="store_true", help="two kinds at a time")
    parser.add_argument("--ordinary", action="store_true", help="sizes of ordinary hardware alone")
    parser.add_argument("--estimator", default="map", choices=["map", "online"])
    parser.add_argument("--no-twins", action="store_true", help="without the records of perfect hardware")
    options = parser.parse_args()
    work = partial(
        run_one, options.seed, options.pairs, options.ordinary, options.estimator, not options.no_twins
    )
    if options.estimator == "online":
        work = partial(_twists_only, work)
    settings = {key: str(value) for key, value in vars(options).items() if key not in ("out", "workers")}
    rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
    header = "kind|runs|failed|usable, ordinary|usable, all|wrong and usable|coverage|NEES|time (worst)"
    header += "|refused: named|first"
    groups: list[tuple[str, Callable[[Row], bool]]] = [(kind, partial(_is, kind)) for kind in RANGES]
    groups += [(f"all, {m}", partial(_moves, m)) for m in ("six", "one", "joints")]
    groups.append(("all but slow ones, six and joints", _not_slow))
    groups.append(("all", lambda row: True))
    rows = [row for row in rows if row["outcome"] != "skipped"]
    told = [row for row in rows if "kinds" in row]
    runs.table(header.split("|"), [line(name, [r for r in told if of(r)]) for name, of in groups])
    for row in rows:
        if row["outcome"] == "fault":
            print(f"- run {row['index']}: {row['reasons'][0]}")
        elif row.get("usable") and row.get("wrong"):
            print(f"- wrong and usable: run {row['index']}, {row['kinds']} {row['sizes']}, {row['motion']}")


def _twists_only(work: Callable[[int], Row], index: int) -> Row:
    if index // len(RANGES) % 4 == 3:
        return {"outcome": "skipped", "reasons": []}
    return work(index)


def _is(kind: str, row: Row) -> bool:
    return kind in row["kinds"]


def _moves(motion: str, row: Row) -> bool:
    return bool(row["motion"] == motion)


def _not_slow(row: Row) -> bool:
    return row["motion"] != "one" and not set(row["kinds"]) & set(SLOW)


if __name__ == "__main__":
    main()
