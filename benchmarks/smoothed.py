"""Records that were filtered or smoothed before they were logged: usable, covered, wrong, and the time.

    python benchmarks/smoothed.py --runs 600 --workers 2 --out out/smoothed

Problems of imperfect.py on perfect hardware. Then channels, the motion (of joints the velocities) or all are
filtered, log-uniformly at 5 to 25 Hz of the noise's half power: causally, as sensors and drivers do it, or to
both sides, as whoever keeps a log does. The first second, in which filters settle, is cut off. Each stands
beside its twin, the same log unfiltered. Wrong is what imperfect.py calls so.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import runs
import twins
from imperfect import Array, Row
from scipy import signal
from scipy.ndimage import convolve1d, gaussian_filter1d
from scipy.optimize import brentq

from truewrench.model.log import Log
from truewrench.model.split import rows_of

SLOWEST, FASTEST = 5.0, 25.0  # [Hz]
STREAMS = {
    "channels": ("raw",),
    "motion": ("twist", "velocity"),
    "all": ("raw", "twist", "gravity", "position", "velocity"),
}

Filter = Callable[[Array], Array]


def poles(order: int, corner: float) -> Filter:
    """Butterworth's, causal; of one pole as `y += share * (x - y)`."""
    b, a = signal.butter(order, 2.0 * corner)
    return lambda x: np.asarray(signal.lfilter(b, a, x - x[0], axis=0) + x[0])


def both_ways(order: int, corner: float) -> Filter:
    b, a = signal.butter(order, 2.0 * corner)
    return lambda x: np.asarray(signal.filtfilt(b, a, x, axis=0))


def mean(corner: float) -> Filter:
    count = max(2, round(0.443 / corner))
    return lambda x: np.asarray(signal.lfilter(np.full(count, 1.0 / count), 1.0, x - x[0], axis=0) + x[0])


def centred_mean(corner: float) -> Filter:
    count = max(2, round(0.443 / corner))
    return lambda x: np.asarray(convolve1d(x, np.full(count, 1.0 / count), axis=0))


def gaussian(corner: float) -> Filter:
    return lambda x: np.asarray(gaussian_filter1d(x, np.sqrt(np.log(2.0)) / (2.0 * np.pi * corner), axis=0))


def savitzky_golay(corner: float) -> Filter:
    count = 2 * max(2, round(0.46 / corner)) + 1
    return lambda x: np.asarray(signal.savgol_filter(x, count, 3, axis=0))


FILTERS: dict[str, Callable[[float], Filter]] = {
    "one pole": partial(poles, 1),
    "two poles": partial(poles, 2),
    "four poles": partial(poles, 4),
    "mean": mean,
    "mean, centred": centred_mean,
    "Gaussian": gaussian,
    "Savitzky-Golay": savitzky_golay,
    "one pole, both ways": partial(both_ways, 1),
    "two poles, both ways": partial(both_ways, 2),
    "four poles, both ways": partial(both_ways, 4),
}


def at_half_power(make: Callable[[float], Filter], half: float) -> Filter:
    """The filter whose noise has half of its density at this share of the sampling rate."""
    impulse: Array = np.zeros((4096, 1))
    impulse[2048] = 1.0
    phase = np.exp(-2j * np.pi * half * np.arange(4096))

    def excess(stretch: float) -> float:
        return float(np.abs(phase @ make(stretch * half)(impulse)[:, 0]) ** 2) - 0.5

    most = min(2.4, 0.49 / half)
    return make(half * brentq(excess, 0.4, most, rtol=1e-3) if excess(0.4) * excess(most) < 0.0 else half)


def filtered(log: Log, made: Filter, streams: str) -> Log:
    logged = {name: getattr(log, name) for name in STREAMS[streams]}
    return replace(log, **{name: of_rows(made, x) for name, x in logged.items() if x is not None})


def of_rows(made: Filter, values: Array) -> Array:
    """A stream's own rows, filtered."""
    rows, out = np.isfinite(values).all(axis=1), values.copy()
    out[rows] = made(values[rows])
    return out


def run_one(seed: int, index: int) -> Row:
    """One record, and its twin."""
    rng = np.random.default_rng((seed, index))
    name, streams = list(FILTERS)[index % len(FILTERS)], list(STREAMS)[index // len(FILTERS) % 3]
    motion = ("six", "six", "one", "joints")[index // (3 * len(FILTERS)) % 4]
    rig, log, truth = twins.recorded(rng, motion, longer=1.0)
    rate = 1e9 / float(np.median(np.diff(log.time_ns)))
    half = float(np.exp(rng.uniform(np.log(SLOWEST), np.log(FASTEST))))
    made = at_half_power(FILTERS[name], half / rate)
    row: Row = {"filter": name, "streams": streams, "motion": motion, "hz": half, "rate": rate}
    settled = slice(round(rate), None)
    smooth = rows_of(filtered(log, made, streams), settled)
    return row | twins.compared(rig, smooth, rows_of(log, settled), truth)


def main() -> None:
    options = runs.arguments(__doc__, runs=600)
    chosen = options.parse_args()
    work = partial(run_one, chosen.seed)
    rows = runs.gather(work, range(chosen.runs), chosen.out, chosen.workers, [chosen.seed])
    lost = [r for r in rows if "filter" not in r]
    rows = [r for r in rows if "filter" in r]
    groups = [(name, [r for r in rows if r["filter"] == name]) for name in FILTERS]
    groups += [(name, [r for r in rows if r["streams"] == name]) for name in STREAMS]
    groups += [(name, [r for r in rows if r["motion"] == name]) for name in ("six", "one", "joints")]
    groups += [
        ("5 to 8 Hz", [r for r in rows if r["hz"] < 8.0]),
        ("faster", [r for r in rows if r["hz"] >= 8.0]),
    ]
    twins.table("filter", [*groups, ("all", rows)])
    print(f"\nlost: {len(lost)}")


if __name__ == "__main__":
    main()
