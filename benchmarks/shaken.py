"""Arms that shake as they move: usable, covered, wrong, and the time.

    python benchmarks/shaken.py --runs 480 --workers 2 --out out/shaken

Problems of imperfect.py on perfect hardware, but for a structure of four modes of 8 to 80 Hz, damped by 1 to
5%, that noise as loud as the motion is fast excites, and whose accelerations the payload follows. The channel
that feels it most feels 0.01 to 0.5% of range (RMS, log-uniform). Half of the twists show it, as those of an
IMU or of cameras do; the other half, and joints, do not. Each stands beside its twin, the same log at rest
but for its motion. Wrong is what imperfect.py calls so.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import replace
from functools import partial

import numpy as np
import runs
import twins
from imperfect import Array, Row
from scipy import signal

from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.truth import Truth

SMALLEST, LARGEST = 1e-4, 5e-3  # fraction of range
SLOWEST, FASTEST = 8.0, 80.0  # [Hz]
MODES = 4
RATE = 4000.0  # [Hz] at which the structure is simulated


def shaking(rig: Rig, log: Log, truth: Truth, rng: np.random.Generator) -> tuple[Array, Array]:
    """Wrench (N, 6) on the sensor and twist (N, 6) of the centre of mass, of the structure alone, SI."""
    body = truth.payloads[log.payload]
    time = np.arange(-1.0, float(log.time[-1]) + 1.0, 1.0 / RATE)
    speed = envelope(log, time)
    wrench, twist = np.zeros((len(log.time), 6)), np.zeros((len(log.time), 6))
    for _ in range(MODES):
        omega = 2.0 * np.pi * np.exp(rng.uniform(np.log(SLOWEST), np.log(FASTEST)))
        structure = [1.0, 2.0 * rng.uniform(0.01, 0.05) * omega, omega**2]
        excited = speed * rng.normal(size=time.size)
        acceleration, velocity = (
            np.asarray(signal.lfilter(*signal.bilinear(b, structure, RATE), excited))
            for b in ([omega, 0.0], [omega])
        )
        scale = acceleration.std()
        felt = rng.normal(size=6) * rig.sensor.range_array
        linear = -felt[:3] / body.mass
        angular = -np.linalg.solve(body.inertia, felt[3:] - np.cross(body.center_of_mass, felt[:3]))
        wrench += np.outer(np.interp(log.time + truth.time_offset, time, acceleration) / scale, felt)
        twist += np.outer(np.interp(log.time, time, velocity) / scale, np.append(linear, angular))
    return wrench, twist


def envelope(log: Log, time: Array) -> Array:
    """How fast the motion is, beside its mean, over a fifth of a second."""
    values = log.velocity if log.twist is None else log.twist
    assert values is not None
    rows = np.isfinite(values).all(axis=1)
    known, at = values[rows], log.time[rows]
    size = np.sqrt(np.mean((known / np.sqrt(np.mean(known**2, axis=0))) ** 2, axis=1))
    count = max(1, round(0.2 / float(np.median(np.diff(at)))))
    return np.asarray(np.interp(time, at, np.convolve(size, np.full(count, 1.0 / count), "same")))


def shaken(rig: Rig, log: Log, truth: Truth, size: float, shown: bool, rng: np.random.Generator) -> Log:
    wrench, twist = shaking(rig, log, truth, rng)
    added = rig.sensor.sign * wrench @ truth.gain.T
    share = size / float((added / rig.sensor.channel_scale).std(axis=0).max())
    moved = log.twist + share * twist if shown and log.twist is not None else log.twist
    return replace(log, raw=log.raw + share * added, twist=moved)


def run_one(seed: int, index: int) -> Row:
    """One record, and its twin."""
    rng = np.random.default_rng((seed, index))
    motion = ("six", "six", "one", "joints")[index % 4]
    shown = motion != "joints" and bool(index // 4 % 2)
    rig, log, truth = twins.recorded(rng, motion)
    size = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
    row: Row = {"size": size, "shown": shown, "motion": motion}
    return row | twins.compared(rig, shaken(rig, log, truth, size, shown, rng), log, truth)


def main() -> None:
    options = runs.arguments(__doc__, runs=480)
    chosen = options.parse_args()
    work = partial(run_one, chosen.seed)
    rows = runs.gather(work, range(chosen.runs), chosen.out, chosen.workers, [chosen.seed])
    lost = [r for r in rows if "size" not in r]
    rows = [r for r in rows if "size" in r]
    groups = [(name, [r for r in rows if r["motion"] == name]) for name in ("six", "one", "joints")]
    groups += [
        ("the motion shows it", [r for r in rows if r["shown"]]),
        ("it does not", [r for r in rows if not r["shown"]]),
    ]
    groups += [
        (f"{100 * low:g} to {100 * high:g}%", [r for r in rows if low <= r["size"] < high])
        for low, high in ((1e-4, 4e-4), (4e-4, 1.5e-3), (1.5e-3, 5e-3))
    ]
    twins.table("records", [*groups, ("all", rows)])
    print(f"\nlost: {len(lost)}")


if __name__ == "__main__":
    main()
