"""Known wrenches (`ref_*`) whose errors last, in Monte Carlo: are 95% intervals right 95 times in 100?

    python benchmarks/reference_wrenches.py --seeds 200
    python benchmarks/reference_wrenches.py --seeds 200 --only moving,held --late 0.01

Gain and offset are drawn from their priors, 0.3 and 0.1; the stated noise of sensor and reference is 1e-3 of
range. References: `moving` (30 s at 100 Hz, six frequencies an axis), `held` (40 loads of 2 s at 25 Hz, half
a second between two), `table` (40 loads, a row every 30 s). Errors that last are 1e-3 to 1e-2 of range for
0.3 to 3 s (`table`: 20 to 200 s), drawn log-uniformly: for all channels together with even seeds, for each by
itself with odd ones. A share of their variance, drawn from 0 to 1, is the reference's. `--late`: [s] that the
sensor is stamped too late, at most; uniform.

`largest errors` are the gains of the channel of which the largest errors were found: how many of their
intervals are right with sizes of its own, and with sizes and times averaged over the forces and over the
moments. `rows independent` takes the rows for that, and the noise for as stated.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one process per core; before NumPy is imported

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from truewrench.estimation.known_wrench import KnownWrenchEstimate, estimate_from_known_wrench
from truewrench.estimation.lasting_errors import ErrorSize
from truewrench.estimation.reference_clock import with_reference_on_time
from truewrench.estimation.wrench_errors import FoundErrors
from truewrench.model.log import Log
from truewrench.model.rig import Rig

Array = NDArray[np.float64]
Draw = np.random.Generator

SENSOR, REFERENCE = 1e-3, 1e-3  # stated noise, fraction of range
SIZES = 1e-3, 1e-2
TIMES = {"moving": (0.3, 3.0), "held": (0.3, 3.0), "table": (20.0, 200.0), "rows": (1.0, 1.0)}  # [s]
WALK = 1e-3  # of range per sqrt(s)


@dataclass(frozen=True)
class Case:
    """A row of the table."""

    reference: str
    errors: str
    rows: int = 40  # of a table
    signal: float = 0.0  # spread of the loads over the noise of either side; 0: as stated above


CASES = (
    Case("moving", "white"),
    Case("moving", "AR(1)"),
    Case("moving", "AR(1) + white"),
    Case("moving", "random walk + white"),
    Case("held", "white"),
    Case("held", "AR(1)"),
    Case("held", "AR(1) + white"),
    Case("held", "plateaus + white"),
    Case("table", "white"),
    Case("table", "AR(1) + white"),
    Case("rows", "white", 24, 100.0),
    Case("rows", "white", 24, 3.0),
    Case("rows", "white", 1000, 100.0),
    Case("rows", "white", 1000, 3.0),
)


def rig_of(sensor: float, reference: float) -> Rig:
    """Everything in units of range."""
    body = {"mass": 1, "center_of_mass": [0, 0, 0], "inertia": {"xx": 1, "yy": 1, "zz": 1}}
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": [sensor] * 6,
                "range": [1] * 6,
                "gain_prior": 0.3,
            },
            "payloads": {"default": body},
            "motion": {"noise": [1e-3] * 6},
            "reference_noise": [reference] * 6,
        }
    )


def moving(draw: Draw) -> tuple[Array, Array, Array]:
    """Times (N,) [s], wrenches (N, 6), and the load that each row belongs to."""
    time = np.arange(3000) / 100.0
    hertz, phase = draw.uniform(0.1, 1.0, (6, 6)), draw.uniform(0.0, 2.0 * np.pi, (6, 6))
    angle = 2.0 * np.pi * hertz[:, :, None] * time + phase[:, :, None]
    return time, 0.2 * np.sqrt(2.0 / 6.0) * np.sin(angle).sum(axis=1).T, np.zeros(time.size, dtype=np.int64)


def held(draw: Draw) -> tuple[Array, Array, Array]:
    """Likewise; on the way to a load the wrench goes over linearly."""
    time = np.arange(40 * 50) / 25.0
    load = np.minimum((time / 2.0).astype(np.int64), 39)
    loads = 0.5 * draw.uniform(-1.0, 1.0, (41, 6))
    way = np.clip((time / 2.0 - load) / 0.25, 0.0, 1.0)[:, None]
    return time, loads[load] * (1.0 - way) + loads[load + 1] * way, load + (way[:, 0] >= 0.5)


def table(draw: Draw, rows: int) -> tuple[Array, Array, Array]:
    """Likewise."""
    return 30.0 * np.arange(rows), 0.5 * draw.uniform(-1.0, 1.0, (rows, 6)), np.arange(rows)


def ornstein_uhlenbeck(draw: Draw, time: Array, lasts: float) -> Array:
    """(N,) of variance 1, sample by sample."""
    found = np.empty(time.size)
    found[0] = draw.standard_normal()
    for k in range(1, time.size):
        kept = np.exp(-(time[k] - time[k - 1]) / lasts)
        found[k] = kept * found[k - 1] + np.sqrt(1.0 - kept**2) * draw.standard_normal()
    return found


def lasting(draw: Draw, case: Case, time: Array, load: Array, alike: bool) -> Array:
    """(N, 6) errors that last, fraction of range."""
    sizes = np.exp(draw.uniform(*np.log(SIZES), 6))
    lasts = np.exp(draw.uniform(*np.log(TIMES[case.reference]), 6))
    if alike:
        sizes[:], lasts[:] = sizes[0], lasts[0]
    if case.errors.startswith("plateaus"):
        return np.asarray(sizes * draw.standard_normal((load[-1] + 1, 6))[load])
    if case.errors.startswith("random walk"):
        steps = WALK * np.sqrt(np.diff(time, prepend=time[0]))[:, None] * draw.standard_normal((time.size, 6))
        return np.asarray(np.cumsum(steps, axis=0))
    return np.column_stack(
        [size * ornstein_uhlenbeck(draw, time, last) for size, last in zip(sizes, lasts, strict=True)]
    )


def log_of(case: Case, seed: int, late: float = 0.0) -> tuple[Rig, Log, Array, Array]:
    """Rig and log, with the gain (6, 6) and the offset (6,) that made it."""
    draw = np.random.default_rng([seed, CASES.index(case)])
    noise = (0.3 / case.signal, 0.3 / case.signal) if case.signal else (SENSOR, REFERENCE)
    made: Callable[[Draw], tuple[Array, Array, Array]] = {"moving": moving, "held": held}.get(
        case.reference, partial(table, rows=case.rows)
    )
    time, wrench, load = made(draw)
    gain = np.eye(6) + 0.3 * draw.standard_normal((6, 6))
    offset = 0.1 * draw.standard_normal(6)
    raw, reference = wrench @ gain.T + offset, wrench.copy()
    if late > 0.0:
        then = time - draw.uniform(0.0, late)
        raw = CubicSpline(time, raw)(np.maximum(then, time[0]))
    if case.errors != "AR(1)":
        raw += noise[0] * draw.standard_normal(raw.shape)
        reference += noise[1] * draw.standard_normal(raw.shape)
    if case.errors != "white":
        errors = lasting(draw, case, time, load, alike=seed % 2 == 0)
        share = draw.uniform()
        raw += np.sqrt(1.0 - share) * errors
        reference += np.sqrt(share) * lasting(draw, case, time, load, alike=seed % 2 == 0)
    stamps = np.rint(time * 1e9).astype(np.int64)
    return rig_of(*noise), Log(None, "default", "", stamps, raw, reference=reference), gain, offset


@dataclass(frozen=True)
class Result:
    """Of one seed: errors of gain and offset over their sigma (42,), three ways, and what was found."""

    z: Array
    grouped: Array  # with sizes and times averaged over the forces, and over the moments
    white: Array  # as if rows were independent
    worst: int  # the channel of the largest errors found
    nees: float  # over 42
    squared_error: float
    found: bool  # another noise than stated


def averaged(found: FoundErrors) -> FoundErrors:
    """One size and one time for the forces, and one for the moments."""
    sizes: list[ErrorSize] = []
    for group in (found.sizes[:3], found.sizes[3:]):
        white, lasting = np.mean([(s.white, s.lasting) for s in group], axis=0).tolist()
        times = [s.time for s in group if s.lasting > 0.0]
        time = float(np.exp(np.mean(np.log(times)))) if times else 0.0
        sizes += [ErrorSize(white, lasting, time)] * 3
    return replace(found, sizes=tuple(sizes))


def trial(seed: int, case: Case, late: float = 0.0) -> Result:
    """Estimate one log all ways."""
    rig, log, gain, offset = log_of(case, seed, late)
    log, clock = with_reference_on_time(rig, log)

    def error(found: KnownWrenchEstimate) -> Array:
        return np.append((found.gain - gain).ravel(), found.offsets[0] - offset)

    def z(found: KnownWrenchEstimate) -> Array:
        return np.asarray(error(found) / np.sqrt(np.diag(found.normalised_covariance)))

    found = estimate_from_known_wrench(rig, [log], clocks=[clock])
    off = error(found)
    nees = float(off @ np.linalg.solve(found.normalised_covariance, off)) / 42
    other = any(kind.found for kind in found.errors)
    variance = [s.white + s.lasting for s in found.errors[0].sizes]
    alike = [averaged(kind) for kind in found.errors]
    return Result(
        z(found),
        z(estimate_from_known_wrench(rig, [log], alike, [clock]) if other else found),
        z(estimate_from_known_wrench(rig, [log], (), [clock])),
        int(np.argmax(variance)),
        nees,
        float(np.mean(off[:36] ** 2)),
        other,
    )


def binomial(share: float, count: int) -> tuple[float, float]:
    """95% interval of a probability (Wilson)."""
    z2 = 1.96**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = 1.96 / (1 + z2 / count) * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2))
    return middle - half, middle + half


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--late", type=float, default=0.0, help="[s] that the sensor is late at most")
    parser.add_argument("--only", default="moving,held,table,rows", help="references")
    options = parser.parse_args()
    print(f"{options.seeds} seeds a row.\n")
    names = (
        "reference|errors|within 95% [binomial]|max abs z|NEES/42|RMS of gain|other noise found|"
        "largest errors: own size, one a group|rows independent"
    )
    print("| " + names.replace("|", " | ") + " |\n" + "|---" * 9 + "|")
    with ProcessPoolExecutor(options.processes) as pool:
        for case in CASES:
            if case.reference not in options.only.split(","):
                continue
            results = list(
                pool.map(partial(trial, case=case, late=options.late), range(options.seeds), chunksize=5)
            )
            z = np.array([r.z for r in results])
            share = float(np.mean(np.abs(z) < 1.96))
            low, high = binomial(share, z.size)
            worst = np.array([[x[:36].reshape(6, 6)[r.worst] for x in (r.z, r.grouped)] for r in results])
            of_worst = np.mean(np.abs(worst) < 1.96, axis=(0, 2)).tolist()
            cells = [
                f"{case.rows} rows, signal {case.signal:g}" if case.signal else case.reference,
                case.errors,
                f"{share:.1%} [{low:.1%}, {high:.1%}]",
                f"{np.abs(z).max():.1f}",
                f"{np.mean([r.nees for r in results]):.2f}",
                f"{np.sqrt(np.mean([r.squared_error for r in results])):.2g}",
                f"{np.mean([r.found for r in results]):.1%}",
                f"{of_worst[0]:.1%}, {of_worst[1]:.1%}",
                f"{np.mean(np.abs([r.white for r in results]) < 1.96):.1%}",
            ]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
