"""Injected contacts: how many are found, and what is left out of samples that have none.

    python benchmarks/contacts.py --runs 100 --out out/contacts

The rigs and motions of confident.py, with one push of `--size` times the noise and `--length` seconds
somewhere in the log: on all channels with random signs, as a wrench that has this size in the channel that
feels it most, or on one channel. `none` is the log as it is. Found: more than half of its samples left out.
"""

from __future__ import annotations

import confident  # first: it holds NumPy to one thread

# isort: split
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import runs

import truewrench as tw

SHAPES = "all channels", "wrench", "one channel", "none"


def run(shape: str, campaign: int, size: float, length: float, index: int) -> runs.Row:
    """One row."""
    rig, log, simulated, about = confident.problem("clean", campaign, index)
    rng = np.random.default_rng([campaign, SHAPES.index(shape), index])
    n = rig.sensor.n
    push = rng.choice([-1.0, 1.0], n)
    if shape == "wrench":
        push = confident.wrench_push(rig, rng, simulated.truth.gain)
    if shape == "one channel":
        push *= np.arange(n) == rng.integers(n)
    begin = rng.uniform(log.time[0], log.time[-1] - length)
    inside = (log.time >= begin) & (log.time < begin + length) & (shape != "none")
    raw = log.raw.copy()
    raw[inside] += size * push * rig.sensor.noise_array
    calibration = tw.calibrate(rig, replace(log, raw=raw), held_out=False, threads=1)
    left_out = np.zeros(len(log.time), dtype=bool)
    for first, last in calibration.logs[0].disturbances:
        left_out |= (log.time >= first) & (log.time <= last)
    return about | {
        "outcome": "calibrated",
        "usable": calibration.verdict.usable,
        "found": float(left_out[inside].mean() > 0.5) if inside.any() else np.nan,
        "dropped": float(left_out[~inside].mean()),
        "alarm": bool(left_out[~inside].any()),
    }


def line(shape: str, rows: list[runs.Row]) -> list[Any]:
    """A row of the table."""
    found, dropped = (np.array([r[key] for r in rows]) for key in ("found", "dropped"))
    return [
        shape,
        len(rows),
        "-" if shape == "none" else f"{100.0 * found.mean():.1f}%",
        f"{100.0 * dropped.mean():.2f}%",
        f"{100.0 * dropped.max():.1f}%",
        sum(r["alarm"] for r in rows),
        sum(r["usable"] for r in rows),
    ]


def main() -> None:
    parser = runs.arguments(__doc__, runs=100)
    parser.add_argument("--size", type=float, default=3.0, help="times the noise")
    parser.add_argument("--length", type=float, default=0.05, help="[s]")
    options = parser.parse_args()
    lines = []
    for shape in SHAPES:
        work = partial(run, shape, options.seed, options.size, options.length)
        settings = ["contacts", shape, options.seed, options.size, options.length]
        rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
        lines.append(line(shape, [r for r in rows if r["outcome"] != "fault"]))
    header = "push", "runs", "found", "clean samples left out", "at most", "logs that lose any", "usable"
    runs.table(header, lines)


if __name__ == "__main__":
    main()
