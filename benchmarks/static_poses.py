"""A log of one payload held still in 24 poses, and its rig: what can be known without motion.

    python benchmarks/static_poses.py -o static
    truewrench calibrate static/rig.yaml static/poses.csv -o static/result

Sensor of 10 N and 1 N m, payload exact, sensor noise 2e-3 of range; a pose is held for 1 s at 100 Hz, and
nothing is logged while the arm moves on.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from truewrench.io.tables import GRAVITY, TWIST, write_table
from truewrench.model.rig import Rig

Array = NDArray[np.float64]

POSES = 24
HELD = 1.0  # [s]
PAUSE = 2.0  # [s] between poses
RATE = 100
SEED = 0

SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.02, 0.02, 0.02, 0.002, 0.002, 0.002],
        "range": [10, 10, 10, 1, 1, 1],
        "gain_prior": 0.3,
        "time_offset_prior": 0,
    },
    "payloads": {
        "default": {
            "mass": 0.8,
            "center_of_mass": [0.02, -0.01, 0.08],
            "inertia": {"xx": 4.0e-3, "yy": 4.0e-3, "zz": 1.0e-3},
            "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
        }
    },
    "motion": {"source": "twist", "of": "sensor", "noise": [1.0e-4] * 6},
    "gravity": [0, 0, -9.81],
}


def directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere (a Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    around = np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.column_stack([np.sqrt(1.0 - z**2) * np.cos(around), np.sqrt(1.0 - z**2) * np.sin(around), z])


def columns(rig: Rig, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
    """The log: gain and offset drawn from the rig's priors."""
    sensor, payload = rig.sensor, rig.payloads["default"]
    held = round(HELD * RATE)
    start = np.arange(POSES) * (HELD + PAUSE)
    time = (start[:, None] + np.arange(held) / RATE).ravel()
    gravity = np.repeat(9.81 * directions(POSES), held, axis=0)
    force = payload.mass * gravity  # what a payload at rest does to the sensor
    wrench = np.column_stack([force, np.cross(payload.center_of_mass_array, force)])
    scale = sensor.channel_scale
    gain = sensor.nominal_gain_array + sensor.gain_prior * rng.standard_normal((sensor.n, 6)) * (
        scale[:, None] / sensor.range_array
    )
    offset = sensor.offset_prior_array * rng.standard_normal(sensor.n)
    raw = wrench @ gain.T + offset + sensor.noise_array * rng.standard_normal((time.size, sensor.n))
    twist = rig.motion.noise_array * rng.standard_normal((time.size, 6))
    found: dict[str, NDArray[Any]] = {"time_ns": np.rint(time * 1e9).astype(np.int64)}
    found |= {f"raw_{i}": channel for i, channel in enumerate(raw.T)}
    found |= dict(zip(TWIST, twist.T, strict=True)) | dict(zip(GRAVITY, gravity.T, strict=True))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.yaml").write_text(yaml.safe_dump(SETTINGS, sort_keys=False), encoding="utf-8")
    write_table(folder / "poses.csv", columns(Rig.from_mapping(SETTINGS), np.random.default_rng(SEED)))


if __name__ == "__main__":
    main()
