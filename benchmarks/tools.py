"""Five tools swung by an independent simulator, pooled: `truewrench calibrate` on motions that are not ours.

    python benchmarks/tools.py --draws 100
    python benchmarks/tools.py --unknown --draws 20   # six of them unknown, by `truewrench tool`, gain exact
    python benchmarks/tools.py --write tools       # one draw as files: tools/rig.yaml, tools/hammer.csv, ...

Gain, offsets and noise are put on the exact logs of the external data set (TRUEWRENCH_EXTERNAL_DATA, or the
folder shared/data beside the repository); acceleration columns are dropped and serve as truth of the bound.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import cases
import numpy as np
import yaml
from bound_oracle import MotionInformation, Rnea, covariance
from numpy.typing import NDArray
from runs import WITHIN_95, interval
from tool_recipe import recipe

import truewrench as tw
from truewrench.io.tables import GRAVITY, TWIST, read_log, write_table
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig

Array = NDArray[np.float64]

EXACT = 1e-6  # 1 sigma of a gain that is known
KNOT_SPACING = 0.05  # of the bound [s]: five samples per coefficient, which the stop-and-go motion needs


@dataclass(frozen=True)
class Result:
    """One draw."""

    within: float  # share of gains and offsets within 3 sigma
    nees: float  # of gain and last offset, over 42
    squared_error: float  # mean over the 36 normalised gains
    bound: float  # trace of the bound over 36
    usable: bool
    seconds: float


def data_folder() -> Path:
    """The external data set."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TRUEWRENCH_EXTERNAL_DATA") or beside) / "utias"
    if not folder.is_dir():
        raise SystemExit(f"no folder {folder}: set TRUEWRENCH_EXTERNAL_DATA to the folder that holds utias/")
    return folder


@cache
def rig() -> Rig:
    """The rig of the case: payloads of the data set, exact."""
    case = cases.load_case("tools")
    stated = yaml.safe_load((data_folder() / "payloads.yaml").read_text(encoding="utf-8"))["payloads"]
    exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "sensor_on_payload",
                "noise": case["noise"]["raw"],
                "range": case["range"],
                "gain_prior": case["gain_prior"],
                "offset_prior": case["offset"],
                "time_offset_prior": 0,
            },
            "payloads": {name: {**stated[name], "uncertainty": exact} for name in case["payloads"]},
            "motion": {"source": "twist", "of": "sensor", "noise": [case["noise"]["twist"]] * 6},
            "gravity": [0, 0, -9.81],
        }
    )


@cache
def exact_logs() -> tuple[Log, ...]:
    """The five logs as they are: noise-free, gain = identity."""
    return tuple(read_log(f"{data_folder() / name}.csv@{name}", rig()) for name in rig().payloads)


@cache
def information() -> tuple[MotionInformation, ...]:
    """What the five motions contribute to the bound."""
    out = []
    for log in exact_logs():
        payload = rig().payloads[log.payload]
        body = payload.mass, payload.center_of_mass_array, payload.inertia_matrix
        out.append(
            MotionInformation.of(
                Rnea(*body, np.zeros(3)),
                log.time,
                log.twist,
                log.acceleration,
                twist_noise=rig().motion.noise_array,
                scale=rig().sensor.range_array,
                spacing=KNOT_SPACING,
                gravity=log.gravity,
                sign=-1.0,
            )
        )
    return tuple(out)


def draw(seed: int) -> tuple[list[Log], Array, Array]:
    """Logs with gain, offsets and noise put on; the gain (6, 6) and the offsets (5, 6) in SI units."""
    case, sensor = cases.load_case("tools"), rig().sensor
    rng = np.random.default_rng(seed)
    scale = sensor.range_array
    gain = (np.eye(6) + case["spread"] * rng.standard_normal((6, 6))) * scale[:, None] / scale
    offsets = np.array(case["offset"]) * rng.standard_normal((len(exact_logs()), 6))
    logs = []
    for log, offset in zip(exact_logs(), offsets, strict=True):
        raw = log.raw @ gain.T + offset + sensor.noise_array * rng.standard_normal(log.raw.shape)
        twist = log.twist + rig().motion.noise_array * rng.standard_normal(log.twist.shape)
        logs.append(replace(log, raw=raw, twist=twist, acceleration=None))
    return logs, gain, offsets


def run(seed: int, estimator: str) -> Result:
    """Calibrate one draw and compare with its truth and bound."""
    logs, gain, offsets = draw(seed)
    sensor = rig().sensor
    scale = sensor.range_array
    start = time.perf_counter()
    calibration = tw.calibrate(rig(), logs, estimator=estimator, threads=1)
    seconds = time.perf_counter() - start
    within = [np.abs(calibration.gain - gain) <= 3 * calibration.gain_std]
    for report, offset in zip(calibration.logs, offsets, strict=True):
        within.append((np.abs(report.offset - offset) <= 3 * report.offset_std)[None])
    error = np.concatenate([(calibration.gain - gain).ravel(), calibration.offset - offsets[-1]])
    unit = np.concatenate([(scale / scale[:, None]).ravel(), 1 / scale])
    normalised = calibration.covariance * unit[:, None] * unit
    nees = float(unit * error @ np.linalg.solve(normalised, unit * error)) / 42
    bound = covariance(
        information(),
        gain * scale / scale[:, None],
        sensor.noise_array / scale,
        gain_prior=sensor.gain_prior,
        offset_prior=sensor.offset_prior_array / scale,
    )
    squared = float(np.mean((unit * error)[:36] ** 2))
    share = float(np.mean(np.concatenate(within)))
    return Result(
        share, nees, squared, float(np.trace(bound[:36, :36])) / 36, calibration.verdict.usable, seconds
    )


@cache
def unknown_rig() -> Rig:
    """An exact gain, and the noise of a good sensor."""
    return tool_rig(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "sensor_on_payload",
                "noise": [0.1] * 3 + [0.005] * 3,
                "range": [100] * 3 + [10] * 3,
                "gain_prior": EXACT,
                "discrepancy": 0,
                "time_offset_prior": 0,
            },
            "motion": {"source": "twist", "of": "sensor", "noise": [1e-4] * 6},
            "gravity": [0, 0, -9.81],
        }
    )


def identified(seed: int) -> list[Array]:
    """Relative error of mass, error of centre of mass [m], both in sigma, here and by the recipe (16,)."""
    bodies = yaml.safe_load((data_folder() / "payloads.yaml").read_text(encoding="utf-8"))["payloads"]
    rng, out, settings = np.random.default_rng(seed), [], unknown_rig()
    sensor = settings.sensor
    for name, body in bodies.items():
        log = read_log(data_folder() / f"{name}.csv", settings)
        offset = sensor.offset_prior_array * rng.standard_normal(6)
        raw = log.raw + offset + sensor.noise_array * rng.standard_normal(log.raw.shape)
        twist = log.twist + settings.motion.noise_array * rng.standard_normal(log.twist.shape)
        log = replace(log, raw=raw, twist=twist, acceleration=None)
        tool = tw.identify_tool(settings, log, mounting_sigma=0.0, tilt_sigma=0.0, threads=1)
        true = np.append(body["mass"], body["center_of_mass"])
        x, sigma = recipe(settings, [log], moving=True)
        row = []
        for found, std in (
            (np.append(tool.mass, tool.center_of_mass), np.append(tool.mass_std, tool.center_of_mass_std)),
            (x[:4], sigma[:4]),
        ):
            error = found - true
            row += [[error[0] / true[0]], error[1:], error / std]
        out.append(np.concatenate(row))
    return out


def unknown(draws: int, processes: int) -> None:
    """Table of six tools that nobody knows."""
    with ProcessPoolExecutor(processes) as pool:
        found = np.concatenate(list(pool.map(identified, range(draws))))
    print(f"Six tools, {draws} draws; RMS error of mass and centre of mass, held by 95% intervals:")
    for name, part in zip(("here", "recipe"), np.split(found, 2, axis=1), strict=True):
        mass, center = (np.sqrt(np.mean(of**2)) for of in (part[:, 0], part[:, 1:4]))
        share = float(np.mean(np.abs(part[:, 4:]) < WITHIN_95))
        print(f"{name}: {100 * mass:.3f}%, {1000 * center:.3f} mm, {interval(share * len(part), len(part))}")


def write(folder: Path) -> None:
    """Rig and logs of the first draw as files, for `truewrench calibrate`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig().to_mapping(), sort_keys=False), encoding="utf-8")
    for log in draw(0)[0]:
        columns: dict[str, NDArray[Any]] = {"time_ns": log.time_ns}
        columns |= {f"raw_{i}": channel for i, channel in enumerate(log.raw.T)}
        columns |= dict(zip(TWIST, log.twist.T, strict=True)) | dict(zip(GRAVITY, log.gravity.T, strict=True))
        write_table(folder / f"{log.payload}.csv", columns)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--estimators", default="map,online")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", type=Path, metavar="DIR", help="write one draw and its rig; run nothing")
    parser.add_argument("--unknown", action="store_true", help="six tools that nobody knows")
    options = parser.parse_args()
    if options.unknown:
        unknown(options.draws, options.processes)
        return
    if options.write:
        write(options.write)
        return
    print(f"Case `tools`, {options.draws} draws.\n")
    header = "estimator|within 3 sigma|NEES/42|worst|RMS|bound|RMS / bound|usable|s"
    print("| " + header.replace("|", " | ") + " |\n" + "|---" * 9 + "|")
    with ProcessPoolExecutor(options.processes) as pool:
        for estimator in options.estimators.split(","):
            results = list(pool.map(partial(run, estimator=estimator), range(options.draws)))
            rms = np.sqrt(np.mean([r.squared_error for r in results]))
            bound = np.sqrt(np.mean([r.bound for r in results]))
            nees = np.array([r.nees for r in results])
            cells = [
                estimator,
                f"{np.mean([r.within for r in results]):.2%}",
                f"{nees.mean():.3f}",
                f"{nees.max():.2f}",
                f"{rms:.5f}",
                f"{bound:.5f}",
                f"{rms / bound:.3f}",
                f"{np.mean([r.usable for r in results]):.0%}",
                f"{np.median([r.seconds for r in results]):.2f}",
            ]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
