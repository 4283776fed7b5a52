"""Claims about the demonstration with an arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from truewrench import robots
from truewrench.demo_arm import _copy, run_arm
from truewrench.errors import InputError
from truewrench.figures_arm import driven_figure, gain_figure
from truewrench.rig import load_rig
from truewrench.robot import robot_of


def test_an_arm_that_is_neither_packaged_nor_a_rig_is_refused_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`pandas` \\(nearest: `panda`\\)"):
        run_arm("pandas", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_folder_of_results_holds_rig_and_robot(tmp_path: Path) -> None:
    packaged = load_rig(robots.path("panda"))
    copied = _copy(packaged, tmp_path / "out")
    assert copied.path == tmp_path / "out" / "rig.yaml"
    assert copied.urdf_path == tmp_path / "out" / "panda.urdf"
    assert robot_of(copied).joints == robot_of(packaged).joints
    _copy(copied, tmp_path / "out")  # a rig that is already there
    assert copied.to_mapping() == load_rig(tmp_path / "out" / "rig.yaml").to_mapping()


def test_pictures_of_any_number_of_joints_and_channels_can_be_drawn(tmp_path: Path) -> None:
    time, rng = np.linspace(0, 5, 100), np.random.default_rng(0)
    joints = [f"joint_{k}" for k in range(9)]
    motion = np.sin(time[:, None] + np.arange(9))
    wrench = time[:50], rng.uniform(-0.5, 0.5, (50, 6))
    driven_figure(tmp_path / "driven.png", joints, time, motion, 0.01 * motion, wrench, "Nine joints.")
    sigma = np.exp(rng.normal(size=(8, 6))) * 1e-3
    channels = [f"gauge {k}" for k in range(8)]
    gain_figure(tmp_path / "gain.png", channels, [("a", sigma), ("b", 2 * sigma)], sigma, "Eight gauges.")
    for name in ("driven", "gain"):
        picture = imread(tmp_path / f"{name}.png")
        assert picture.shape[0] > 500
        assert picture[:, :, :3].std() > 0.05
