"""Whether the estimator needs luck: random rigs, payloads, motions, rates, lengths and initial errors.

    python benchmarks/grid.py --runs 1000 --out out/grid
    python benchmarks/grid.py --runs 1000 --discrepancy 0 --out out/grid

Every run draws a rig from wide ranges and a truth from its priors (one in five with initial errors of 1 to
3 times the stated gain prior instead), simulates a log and calibrates. A run counts where the model holds,
and the Cramer-Rao bound on the RMS of the 36 normalised gains (motion inferred; payload, offset and clock
as uncertain as stated) is below 0.02 and leaves no direction undetermined (above half its prior), which the
verdict must refuse. The model holds where the truth is drawn from the priors, the true gain has a condition
number below 100, and a spline of three samples a coefficient can follow the motion to a fraction of the
noise (0.05 in mean square in every second: steps of the jerk may be more). No accuracy is required of the
rigs, so that usable says that the estimate is sound. RMS / bound is sqrt(mean (e/b)^2) over the runs that
count and are usable; over all that count in brackets. Longer logs than --samples are cut, unless --full.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import bound_common
import motions
import numpy as np
import runs
from numpy.typing import NDArray

from truewrench.model.motion.trajectory import Body, Trajectory
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate, wrench_on_sensor

Array = NDArray[np.float64]

BOUND = 0.02
DETERMINED = 0.5  # of the prior: the verdict's limit
CONDITION = 100.0  # the verdict's limit
RESOLVED = 0.05  # mean square, over the noise, of what no spline can follow of the motion


@dataclass(frozen=True)
class Drawn:
    """One problem."""

    rig: Rig
    motion: Trajectory
    spacing: float  # of the knots of the bound [s]
    about: dict[str, Any]


def draw(seed: int, index: int, samples: int, discrepancy: float | str = "auto") -> Drawn:
    """The problem of a run: everything from wide ranges."""
    rng = np.random.default_rng([seed, index, 17])
    kind = str(rng.choice(motions.KINDS))
    mass, rate, duration, speed = (
        logarithmic(rng, *ends) for ends in ((0.1, 1000.0), (50.0, 4000.0), (3.0, 600.0), (0.05, 0.5))
    )
    headroom, relative_noise, sv = (
        logarithmic(rng, *ends) for ends in ((2.0, 15.0), (4e-5, 1e-2), (1e-4, 1e-3))
    )
    mode = str(rng.choice(["exact", "offset", "uncertain", "loose"], p=[0.3, 0.3, 0.3, 0.1]))
    prior = logarithmic(rng, 0.03, 0.6)
    far = rng.uniform() < 0.2
    beyond = rng.uniform(1.0, 3.0)
    ground = rng.uniform() < 0.25
    if kind == "wrench":
        duration = min(duration, motions.LONGEST_WRENCH)
    if ground:
        duration = min(duration, 60.0)
    duration = min(duration, samples / rate)
    body = motions.draw_body(rng, mass)
    motion, spacing = motions.draw_motion(kind, rng, duration, speed, body)
    gravity = [0.0, 0.0, -9.81 if ground else 0.0]
    span = headroom * peaks(body, motion, 9.81 if ground else 0.0)
    prior = min(prior, 0.6 / beyond) if far else prior
    settings = {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": str(rng.choice(["payload_on_sensor", "sensor_on_payload"])),
            "noise": (relative_noise * span).tolist(),
            "range": span.tolist(),
            "gain_prior": prior,
            "discrepancy": discrepancy,
            **({"offset_prior": 0} if mode == "exact" else {}),
            "time_offset_prior": {"exact": 0, "offset": 0, "uncertain": 1e-3, "loose": 5e-3}[mode],
        },
        "payloads": {"default": payload(body, mode)},
        "motion": {"source": "twist", "of": "com", "noise": [sv] * 6},
        "gravity": gravity,
        "required": 10.0,
        "plan": {"duration": duration},
        "simulate": {
            "rate": rate,
            "sensor_rate": rate,
            "gain": "random",
            "offset": "random",
            "time_offset": "random",
            "payload": "random",
        },
    }
    about = {
        "kind": kind, "mode": mode, "mass": mass, "rate": rate, "duration": duration, "speed": speed,
        "headroom": headroom, "noise": relative_noise, "sv": sv, "prior": prior, "ground": ground,
        "far": beyond if far else 0.0,
    }  # fmt: skip
    return Drawn(Rig.from_mapping(settings), motion, spacing, about)


def logarithmic(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def payload(body: Body, mode: str) -> dict[str, Any]:
    """Settings of a payload, exact or with a stated uncertainty."""
    i = body.inertia
    size = float(np.linalg.norm(body.center_of_mass))
    uncertainty = {
        "uncertain": {"mass": 1e-3, "center_of_mass": 2.5e-3 * size, "inertia": 1e-2},
        "loose": {"mass": 1e-2, "center_of_mass": 1e-2 * size, "inertia": 5e-2},
    }.get(mode, {"mass": 0, "center_of_mass": 0, "inertia": 0})
    return {
        "mass": body.mass,
        "center_of_mass": body.center_of_mass.tolist(),
        "inertia": {"xx": i[0, 0], "yy": i[1, 1], "zz": i[2, 2], "xy": i[0, 1], "xz": i[0, 2], "yz": i[1, 2]},
        "uncertainty": uncertainty,
    }


def peaks(body: Body, motion: Trajectory, gravity: float) -> Array:
    """Largest force and moment of the motion, the one for three axes and the other for three (6,)."""
    t = np.linspace(0.0, motion.duration, 2000)
    w = wrench_on_sensor(
        body, body.center_of_mass, motion.twist(t), motion.acceleration(t), np.zeros((2000, 3))
    )
    weight = body.mass * gravity * np.array([1.0, np.linalg.norm(body.center_of_mass)])
    return np.repeat([np.abs(w[:, :3]).max() + weight[0], np.abs(w[:, 3:]).max() + weight[1]], 3)


def problem(seed: int, index: int, samples: int, discrepancy: float | str = "auto") -> tuple[Drawn, Any]:
    """The drawn problem and its simulated run; the gain further from nominal than stated where so drawn."""
    drawn = draw(seed, index, samples, discrepancy)
    rig = drawn.rig
    if drawn.about["far"]:
        wide = rig.to_mapping()
        wide["sensor"]["gain_prior"] *= drawn.about["far"]
        return drawn, simulate(Rig.from_mapping(wide), drawn.motion, seed=1_000_003 * seed + index)
    return drawn, simulate(rig, drawn.motion, seed=1_000_003 * seed + index)


def difficulty(drawn: Drawn, truth: Any) -> runs.Row:
    """What decides whether a problem counts: bound at its truth, condition, what no spline can follow."""
    start = time.perf_counter()
    covariance = bound_common.bound(
        drawn.rig, drawn.motion, truth.gain, drawn.spacing, time_offset=truth.time_offset
    )
    seconds = time.perf_counter() - start
    span = drawn.rig.sensor.range_array
    return {
        **drawn.about,
        "unresolved": motions.unresolved(
            next(iter(truth.payloads.values())),
            drawn.motion,
            drawn.rig.simulate.sensor_rate,
            drawn.rig.sensor.noise_array,
        ),
        "bound": bound_common.rms(covariance),
        "bound_max": float(np.sqrt(np.diag(covariance)).max()),
        "undetermined": undetermined(drawn.rig, covariance),
        "condition": float(np.linalg.cond(truth.gain * span / span[:, None])),
        "bound_seconds": seconds,
    }


def undetermined(rig: Rig, covariance: Array) -> float:
    """Largest sigma of a direction of the gain over its prior."""
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) / rig.sensor.gain_prior


def run(seed: int, samples: int, estimator: str, discrepancy: float | str, index: int) -> runs.Row:
    """One row."""
    drawn, simulated = problem(seed, index, samples, discrepancy)
    row = difficulty(drawn, simulated.truth)
    row["samples"] = len(simulated.log.raw)
    return row | runs.calibrate_row(drawn.rig, simulated.log, simulated.truth.gain, estimator=estimator)


def counts(row: runs.Row) -> bool:
    """Whether the model of a run holds and its log can teach the gain."""
    return row["outcome"] != "fault" and suits(row)


def suits(row: runs.Row) -> bool:
    """The same of a problem that nobody has tried yet: its `difficulty`."""
    return (
        not row["far"]
        and row["bound"] < BOUND
        and row["undetermined"] < DETERMINED
        and row["condition"] < CONDITION
        and row["unresolved"] < RESOLVED
    )


def good(row: runs.Row) -> bool:
    """Usable, with nearly all of its samples."""
    return bool(row["usable"]) and row["used"] >= 0.95


def ratio(rows: Sequence[runs.Row]) -> str:
    """RMS of error over bound."""
    values = [r["rms"] / r["bound"] for r in rows if r.get("rms") is not None]
    return f"{np.sqrt(np.mean(np.square(values))):.3f}" if values else "-"


def line(name: str, rows: Sequence[runs.Row]) -> list[Any]:
    """A row of the table."""
    holds = [r for r in rows if counts(r)]
    ok = [r for r in holds if good(r)]
    calibrated = [r for r in holds if r["outcome"] == "calibrated"]
    worst = max((r["rms"] / r["bound"] for r in ok), default=np.nan)
    return [
        name,
        len(rows),
        len(holds),
        f"{len(ok) / len(holds):.1%}" if holds else "-",
        f"{ratio(ok)} ({ratio(calibrated)})",
        f"{worst:.2f}",
        f"{np.mean([r['nees'] for r in ok]):.3f}" if ok else "-",
        sum(bool(r.get("wrong_and_confident")) for r in rows),
        f"{np.median([r['seconds'] for r in rows if 'seconds' in r]):.2f}" if rows else "-",
    ]


def report(rows: list[runs.Row]) -> None:
    """The tables."""
    header = (
        "runs of", "runs", "count", "usable, all samples", "RMS / bound", "worst run", "NEES / dof",
        "wrong and confident", "s",
    )  # fmt: skip
    groups: list[tuple[str, Callable[[runs.Row], bool]]] = [("all", lambda r: True)]
    groups += [(k, lambda r, k=k: r["kind"] == k) for k in motions.KINDS]
    groups += [
        (f"{m} payload and clock", lambda r, m=m: r["mode"] == m)
        for m in ("exact", "offset", "uncertain", "loose")
    ]
    groups += [
        ("in gravity", lambda r: r["ground"]),
        ("initial errors beyond the prior", lambda r: r["far"] > 0),
    ]
    for low, high in ((50, 200), (200, 1000), (1000, 4001)):
        groups.append((f"{low} to {high} Hz", lambda r, a=low, b=high: a <= r["rate"] < b))
    for low, high in ((0, 10), (10, 60), (60, 601)):
        groups.append((f"{low} to {high} s", lambda r, a=low, b=high: a <= r["duration"] < b))
    for low, high in ((0.1, 2), (2, 50), (50, 1001)):
        groups.append((f"{low} to {high} kg", lambda r, a=low, b=high: a <= r["mass"] < b))
    for low, high in ((0, 0.1), (0.1, 0.3), (0.3, 0.61)):
        groups.append((f"gain prior {low} to {high}", lambda r, a=low, b=high: a <= r["prior"] < b))
    runs.table(header, [line(name, [r for r in rows if "kind" in r and test(r)]) for name, test in groups])
    counted = [r for r in rows if counts(r)]
    below = [r for r in rows if r["outcome"] != "fault" and not r["far"] and r["bound"] < BOUND]
    fast = sum(r["unresolved"] >= RESOLVED for r in below)
    vague = sum(r["undetermined"] >= DETERMINED for r in below)
    crooked = sum(r["condition"] >= CONDITION for r in below)
    share = f"{sum(map(good, below)) / len(below):.1%}" if below else "-"
    print(
        f"\n{len(below)} runs have a bound below {BOUND}: {vague} leave a direction undetermined, "
        f"{fast} have motion that no spline follows, "
        f"{crooked} have an ill-conditioned gain. Of all these {share} "
        "are usable, with all samples."
    )
    told = [r for r in counted if r["outcome"] == "calibrated"]
    usable = [r for r in told if r["usable"]]
    needless = sum(not r["usable"] and not r["beyond"] for r in told)
    wrong = sum(r["beyond"] for r in usable)
    covered = float(np.mean([r["covered"] for r in usable])) if usable else float("nan")
    sigma = float(np.median([r["stated"] / r["bound"] for r in usable])) if usable else float("nan")
    rates = [runs.interval(count, len(counted)) for count in (len(usable), needless, wrong)]
    print(
        f"\nOf the runs that count {rates[0]} are usable; {rates[1]} refused although no gain is beyond 5 "
        f"sigma and 0.2% of range; {rates[2]} usable although one is. Of the usable 95% intervals hold "
        f"{covered:.3f} of the gains, and the median of sigma over the bound is {sigma:.2f}."
    )
    bad = [r for r in counted if not good(r)]
    print(f"\nWhy {len(bad)} of {len(counted)} runs that count are not usable (some for several reasons):\n")
    runs.table(
        ("reason", "runs", "which"),
        [
            (
                kind,
                count,
                " ".join(str(r["index"]) for r in bad if kind in map(runs.kind_of, r["reasons"]))[:60],
            )
            for kind, count in runs.reasons_of(bad).most_common()
        ],
    )
    faults = [r for r in rows if r["outcome"] == "fault"]
    print(f"\nFaults: {len(faults)}" + "".join(f"\n  {r['index']}: {r['reasons'][0]}" for r in faults[:20]))
    silent = [r["index"] for r in rows if r["outcome"] != "fault" and not r["usable"] and not r["reasons"]]
    print(f"Not usable without a reason: {len(silent)}")


def main() -> None:
    parser = runs.arguments(__doc__, runs=1000)
    parser.add_argument("--samples", type=int, default=400_000, help="of the longest log")
    parser.add_argument("--full", action="store_true", help="no limit on samples")
    parser.add_argument("--seconds", type=float, default=0.0, help="limit of a run; a longer one is a fault")
    parser.add_argument("--estimator", default="map")
    parser.add_argument(
        "--discrepancy", default="auto", help="of the rigs: 0 says that nothing follows the pose"
    )
    options = parser.parse_args()
    samples = 10**9 if options.full else options.samples
    stated = "auto" if options.discrepancy == "auto" else float(options.discrepancy)
    work = partial(run, options.seed, samples, options.estimator, stated)
    settings = ["grid", options.seed, samples, options.estimator, stated]
    report(runs.gather(work, range(options.runs), options.out, options.workers, settings, options.seconds))


if __name__ == "__main__":
    main()
