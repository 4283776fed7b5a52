"""What many tests start from: a valid rig and a valid log, to be spoilt one fault at a time."""

from __future__ import annotations

import csv
import os
import random
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import settings as hypothesis_settings

from truewrench import robots
from truewrench.model.calibration import (
    AXES,
    Assumed,
    AxisImprovement,
    BlindTo,
    Bound,
    Calibration,
    LogReport,
    Undetermined,
    Verdict,
)
from truewrench.model.rig import Rig, load_rig

# On a busy machine a slow example is no fault; in CI the same examples come again, new ones are found at
# the desk.
hypothesis_settings.register_profile("desk", deadline=None)
hypothesis_settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis_settings.load_profile("ci" if os.environ.get("CI") else "desk")

SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
        "range": [500, 500, 500, 50, 50, 50],
    },
    "payloads": {
        "default": {
            "mass": 50,
            "center_of_mass": [0.2, 0, 0],
            "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4, "xy": 0, "xz": 0, "yz": 0},
        }
    },
    "motion": {"source": "twist", "of": "com", "noise": [1e-3] * 6},
}


@pytest.fixture
def ros2_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ROS 2 of its own for every test, on loopback, with patience: machines under test are busy."""
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(random.SystemRandom().randint(1, 99)))
    monkeypatch.setattr("truewrench.live.ros2._PATIENCE", 60.0)
    monkeypatch.setattr("truewrench.live.ros2_contact._PATIENCE", 60.0)


@pytest.fixture(scope="session")
def valid_settings() -> dict[str, Any]:
    """The settings of a valid rig, to be copied."""
    return SETTINGS


@pytest.fixture
def settings() -> dict[str, Any]:
    """The settings of a valid rig, free to change."""
    return deepcopy(SETTINGS)


@pytest.fixture
def rig_of(tmp_path: Path) -> Callable[[Mapping[str, Any]], Rig]:
    """Write settings to a file and load it."""

    def load(content: Mapping[str, Any]) -> Rig:
        path = tmp_path / "rig.yaml"
        path.write_text(yaml.safe_dump(dict(content)), encoding="utf-8")
        return load_rig(path)

    return load


@pytest.fixture
def rig(settings: dict[str, Any]) -> Rig:
    """A valid rig."""
    return Rig.from_mapping(settings)


@pytest.fixture(scope="session")
def arm_rig() -> Callable[..., Rig]:
    """The rig of a packaged arm with an exact payload and clock, sections changed; None takes a key out."""

    def rig_of(name: str, **changes: Any) -> Rig:
        path = robots.path(name)
        settings = load_rig(path).to_mapping()
        exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
        for payload in settings["payloads"].values():
            payload["uncertainty"] = exact
        settings["sensor"]["time_offset_prior"] = 0
        settings["required"] = 10.0
        for section, values in changes.items():
            changed = {**settings[section], **values} if isinstance(values, dict) else values
            if isinstance(changed, dict):
                changed = {key: value for key, value in changed.items() if value is not None}
            settings[section] = changed
        return Rig.from_mapping(settings, path)

    return rig_of


@pytest.fixture
def cells() -> dict[str, list[str]]:
    """The cells of a valid log of ten rows, column by column, as text."""
    draw = np.random.default_rng(0)
    names = [*(f"raw_{i}" for i in range(6)), "vx", "vy", "vz", "wx", "wy", "wz"]
    columns = {"time_ns": [str(10_000_000 * k) for k in range(10)]}
    return columns | {name: [repr(float(x)) for x in draw.normal(size=10)] for name in names}


@pytest.fixture
def csv_of(tmp_path: Path) -> Callable[..., Path]:
    """Write cells as a CSV file."""

    def write(columns: Mapping[str, Sequence[str]], name: str = "run.csv") -> Path:
        path = tmp_path / name
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
        return path

    return write


@pytest.fixture(scope="session")
def external_data() -> Path:
    """Recorded data that is not part of the repository."""
    default = Path(__file__).parents[2].parent / "shared" / "data"
    path = Path(os.environ.get("TRUEWRENCH_EXTERNAL_DATA") or default)
    if not path.is_dir():
        pytest.skip(f"no external data at {path} (set TRUEWRENCH_EXTERNAL_DATA)")
    return path


@pytest.fixture
def calibration(rig: Rig) -> Calibration:
    """A usable calibration with every field filled."""
    draw = np.random.default_rng(7)
    gain = np.eye(6) + 0.1 * draw.normal(size=(6, 6))
    factor = 1e-3 * draw.normal(size=(42, 42))
    covariance = factor @ factor.T
    covariance = (covariance + covariance.T) / 2
    std = np.sqrt(np.diag(covariance))
    offset = draw.normal(size=6)
    log = LogReport(
        path=Path("run.csv"), sha256="ab" * 32, payload="default", offset=offset, offset_std=std[36:],
        time_offset=1e-3, used=990, masked={"contact": 4}, rejected={"no fit": 6},
        dropped_rows=2, nan_counts={"vx": 1},
    )  # fmt: skip
    unit = np.zeros(36)
    unit[17] = 1.0
    return Calibration(
        gain=gain, gain_std=std[:36].reshape(6, 6), offset=offset, offset_std=std[36:],
        inverse=np.linalg.inv(gain), covariance=covariance,
        verdict=Verdict(
            usable=True, undetermined=(Undetermined(unit, "moment about z: gain of fz"),),
            blind_to=(BlindTo("delay", 1e-3, 4e-3, "a delay of 1 ms would move a gain by 0.4 %"),),
        ),
        logs=(log,), rig=rig, estimator="map",
        improvement={"fx": AxisImprovement(nominal=3.0, new=0.5, held_out=True, better=True),
                     "mz": AxisImprovement(nominal=0.1, new=0.1, held_out=True, better="unsure")},
        bound=Bound(oracle_rms=1e-3, rms=1.1e-3), offset_temperature=np.zeros(6), time_offset=1e-3,
        time_offset_std=1e-5, payload_posterior={"default": {"mass": 50.1}}, figures={"chi_square": 1.01},
        axes=dict.fromkeys(AXES, True),
        assumed=(Assumed("noise, factor on the stated", "all logs", 2.5, 0.1, "residuals"),
                 Assumed("step of the offset, fraction of range", "run.csv, fx, 3.2 s", 0.01)),
        quadratic=1e-3 * draw.normal(size=6), quadratic_std=np.full(6, 1e-4), discrepancy=np.full(6, 2e-4),
        timings={"estimate": 0.5}, version="0.1.0", created="2026-01-01T00:00:00+00:00",
    )  # fmt: skip
