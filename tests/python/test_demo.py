"""Claims about the demo: what it writes, and what the case of the paper shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from truewrench import demo
from truewrench.estimation.estimator import estimate
from truewrench.io.tables import read_log
from truewrench.model.calibration import load_calibration
from truewrench.model.motion.trajectory import integrate_wrench
from truewrench.model.rig import load_rig

FILES = {
    "rig.yaml",
    "run.csv",
    "run.csv.truth.yaml",
    "calibration.yaml",
    "table.txt",
    "fig2_path.png",
    "fig3_gain_error.png",
    "fig4_reading_error.png",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo")


@pytest.fixture(scope="module")
def shown(folder: Path) -> dict[str, Any]:
    return demo.run(folder, seed=0)


def test_every_file_is_written_and_named(folder: Path, shown: dict[str, Any]) -> None:
    assert {file.name for file in folder.iterdir()} == FILES
    assert {Path(file).name for file in shown["outputs"]} == FILES
    assert all(file.stat().st_size > 0 for file in folder.iterdir())


def test_written_calibration_finds_the_written_truth(folder: Path, shown: dict[str, Any]) -> None:
    truth = np.array(yaml.safe_load((folder / "run.csv.truth.yaml").read_text())["gain"])
    calibration = load_calibration(folder / "calibration.yaml")
    assert np.linalg.norm(calibration.gain - truth, np.inf) < 0.05
    assert np.all(np.abs(calibration.gain - truth) < 5 * calibration.gain_std)


def test_written_rig_and_log_read_back(folder: Path, shown: dict[str, Any]) -> None:
    log = read_log(folder / "run.csv", load_rig(folder / "rig.yaml"))
    assert log.raw.shape == (10000, 6)


def test_gain_error_falls_from_about_2_to_below_5_hundredths(shown: dict[str, Any]) -> None:
    figures = shown["figures"]
    assert figures["good_sensor_online"] < 0.05
    assert figures["good_sensor_map"] < 0.05


def test_published_filter_works_with_the_coarse_sensor_and_not_with_the_good_one(
    shown: dict[str, Any],
) -> None:
    figures = shown["figures"]
    assert figures["coarse_sensor_ekf"] < 0.2
    assert figures["good_sensor_ekf_one_density"] > 1.0
    assert figures["good_sensor_ekf"] > 3 * figures["good_sensor_online"]


def test_every_choice_that_is_ours_is_said_to_be(shown: dict[str, Any]) -> None:
    assert "The paper gives no noise, rates, amplitudes or gain" in shown["text"]


@pytest.mark.slow
def test_median_error_of_online_over_20_seeds_is_below_5_hundredths() -> None:
    motion = integrate_wrench(demo.WRENCH, demo.TABLE_1, demo.DURATION)
    ends = []
    for seed in range(20):
        rig, run = demo.simulate_case("good sensor", motion, seed)
        found = estimate(rig, [run.log], online=True)
        ends.append(np.linalg.norm(found.gain - run.truth.gain, np.inf))
    assert np.median(ends) <= 0.05
