"""Long records, taken part by part: the memory of an hour, and whether the parts say what the whole says.

    python benchmarks/long_records.py --hours 1
    python benchmarks/long_records.py --records 60

`--hours`: `truewrench calibrate` of a CSV of twists at 1 kHz, its largest memory and its processor time, with
report and held-out test. `--records`: ten minutes at 100 Hz, once at once and once in parts of 100 s; payload
known to 1%, 1 mm and 5%, lateness to 5 ms, all drawn, half of them in gravity tilted by up to 10 mrad.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from runs import interval

from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.estimation.parts import InParts
from truewrench.model.motion.trajectory import Body, HarmonicTwist
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate, wrench_on_sensor
from truewrench.simulation.truth import nees

Array = NDArray[np.float64]

SECONDS, RATE = 600.0, 100.0
MINUTE = 60_000  # rows that are written at once


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--hours", type=float, default=0.0, help="of one record at 1 kHz")
    parser.add_argument("--records", type=int, default=0, help="of ten minutes")
    arguments = parser.parse_args()
    if arguments.hours > 0.0:
        memory(arguments.hours)
    if arguments.records > 0:
        compare(arguments.records)


def rig_of(seed: int) -> Rig:
    gravity = seed % 2 == 1
    settings: dict[str, Any] = {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": "payload_on_sensor",
            "noise": [0.1] * 3 + [0.01] * 3,
            "range": [100] * 3 + [10] * 3,
            "discrepancy": 0,
            "time_offset_prior": 5e-3,
        },
        "payloads": {
            "default": {
                "mass": 5,
                "center_of_mass": [0.02, -0.01, 0.1],
                "inertia": {"xx": 0.1, "yy": 0.12, "zz": 0.06},
                "uncertainty": {"mass": 0.01, "center_of_mass": 1e-3, "inertia": 0.05},
            }
        },
        "motion": {"noise": [1e-3] * 6},
        "gravity": [0, 0, -9.81 * gravity],
        "gravity_tilt_prior": 5e-3 * gravity,
        "plan": {"duration": SECONDS},
        "simulate": {
            "rate": RATE,
            "sensor_rate": RATE,
            "gain": "random",
            "payload": "random",
            "time_offset": "random",
            "seed": seed,
        },
    }
    return Rig.from_mapping(settings)


def motion_of(seed: int, seconds: float) -> HarmonicTwist:
    """Six frequencies an axis, whose turns stay below a radian."""
    rng = np.random.default_rng([seed, 5])
    frequency = np.sort(rng.uniform(0.1, 1.2, (6, 6)), axis=0)
    size = 0.25 * rng.uniform(0.2, 0.7, (6, 6))
    size[:, 3:] *= frequency[:, 3:]
    return HarmonicTwist(size, frequency, rng.uniform(0, 2 * np.pi, (6, 6)), seconds)


def compare(records: int) -> None:
    ways: dict[str, list[tuple[float, float, Array, float, Array]]] = {"at once": [], "in parts": []}
    for seed in range(records):
        rig = rig_of(seed)
        run = simulate(rig, motion_of(seed, SECONDS))
        for way, of in ways.items():
            started = time.process_time()
            if way == "at once":
                found = estimate(rig, [run.log], threads=1)
            else:
                found = InParts(rig, [run.log], threads=1).estimate()
            spent = time.process_time() - started
            of.append((*_told(found, run.truth.gain), spent, found.gain.ravel()))
    print("| record | NEES / 36 | 95% intervals that hold the gain | sigma over at once | apart, sigma | s |")
    print("|---|---|---|---|---|---|")
    first = ways["at once"]
    sigma = np.array([x[1] for x in first])
    for way, of in ways.items():
        squares = np.array([x[0] for x in of])
        inside = int(sum(np.sum(np.abs(x[2]) < 1.96) for x in of))
        ratio = np.array([x[1] for x in of]) / sigma
        words = interval(inside, 36 * records)
        apart = np.sqrt(
            np.mean([np.mean(((x[4] - y[4]) / y[1]) ** 2) for x, y in zip(of, first, strict=True)])
        )
        seconds = np.mean([x[3] for x in of])
        print(
            f"| {way} | {squares.mean():.2f} | {words} | {ratio.mean():.3f} | {apart:.2f} | {seconds:.1f} |"
        )


def _told(found: Estimate, gain: Array) -> tuple[float, Array, Array]:
    """NEES per gain, sigma, and errors over it."""
    P, error = found.covariance[:36, :36], (found.gain - gain).ravel()
    squared, freedom = nees(error, P)
    sigma = np.sqrt(np.diag(P))
    return squared / freedom, sigma, error / sigma


def memory(hours: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        rig, log = Path(folder) / "rig.yaml", Path(folder) / "log.csv"
        settings = rig_of(0).to_mapping()
        settings["sensor"]["discrepancy"] = "auto"
        settings["payloads"]["default"]["uncertainty"] = {
            "mass": 1e-3,
            "center_of_mass": 2e-4,
            "inertia": 0.01,
        }
        rig.write_text(yaml.safe_dump(settings))
        gain, rows = write_hours(log, hours)
        command = [sys.executable, "-m", "truewrench", "calibrate", str(rig), str(log), "-o", f"{folder}/out"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # usable
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        found = np.load(f"{folder}/out/calibration.npz")
        error = (found["gain"] - gain).ravel()
        z = np.abs(error / np.sqrt(np.diag(found["covariance"])[:36])).max()
    print(
        "| rows | CSV, GB | largest memory, GB | processor, s | largest error, sigma |\n|---|---|---|---|---|"
    )
    size, peak = 1e-9 * rows[1], 1e-6 * used.ru_maxrss
    print(f"| {rows[0]:,} | {size:.2f} | {peak:.2f} | {used.ru_utime + used.ru_stime:.0f} | {z:.1f} |")


def write_hours(path: Path, hours: float) -> tuple[Array, tuple[int, int]]:
    """A log of the payload of `rig_of`, as stated, without gravity, whose centre of mass the twist is of."""
    rng = np.random.default_rng(1)
    count = int(3600e3 * hours)
    motion, spec = motion_of(0, 3600.0 * hours), rig_of(0).payloads["default"]
    unit = np.repeat([100.0, 10.0], 3)
    gain = (np.eye(6) + 0.05 * rng.standard_normal((6, 6))) * unit[:, None] / unit
    body = Body(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)
    with path.open("w") as file:
        file.write("time_ns," + ",".join(f"raw_{i}" for i in range(6)) + ",vx,vy,vz,wx,wy,wz\n")
        for begin in range(0, count, MINUTE):
            k = np.arange(begin, min(begin + MINUTE, count))
            twist, rate = motion.twist(1e-3 * k), motion.acceleration(1e-3 * k)
            wrench = wrench_on_sensor(body, body.center_of_mass, twist, rate, np.zeros((k.size, 3)))
            raw = wrench @ gain.T + 1e-3 * unit * rng.standard_normal((k.size, 6))
            rows = np.column_stack([1e6 * k, raw, twist + 1e-3 * rng.standard_normal((k.size, 6))])
            np.savetxt(file, rows, fmt=["%d"] + ["%.6g"] * 12, delimiter=",")
    return gain, (count, path.stat().st_size)


if __name__ == "__main__":
    main()
