"""Six tools swung by an independent simulator, identified with an exact gain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tool_cases import a_rig

import truewrench as tw
from truewrench.model.rig.tool_rig import tool_rig

NOISE = np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.005])
TWIST_NOISE = 1e-4  # m/s, rad/s


@pytest.mark.external
def test_mass_and_center_of_mass_of_six_tools(external_data: Path) -> None:
    rig = tool_rig(
        a_rig(
            sensor={
                "feels": "sensor_on_payload",
                "gain_prior": 1e-6,
                "noise": NOISE.tolist(),
                "discrepancy": 0,
                "time_offset_prior": 0.0,
            },
            motion={"source": "twist", "noise": [TWIST_NOISE] * 6},
        )
    )
    truth = yaml.safe_load((external_data / "utias" / "payloads.yaml").read_text())["payloads"]
    mass, center, z = [], [], []
    for k, (name, body) in enumerate(truth.items()):
        log = tw.read_log(external_data / "utias" / f"{name}.csv", rig)
        rng = np.random.default_rng(k)
        assert log.twist is not None
        log = replace(
            log,
            raw=log.raw + rng.normal(size=log.raw.shape) * NOISE + rng.normal(size=6) * NOISE,
            twist=log.twist + rng.normal(size=log.twist.shape) * TWIST_NOISE,
            acceleration=None,
        )
        tool = tw.identify_tool(rig, log, mounting_sigma=0.0, tilt_sigma=0.0)
        assert tool.verdict.usable, (name, tool.verdict.reasons)
        mass.append(tool.mass / body["mass"] - 1.0)
        center.append(tool.center_of_mass - body["center_of_mass"])
        z += [(tool.mass - body["mass"]) / tool.mass_std, *(center[-1] / tool.center_of_mass_std)]
        inertia = [body["inertia"][element] for element in ("xx", "yy", "zz", "xy", "xz", "yz")]
        z += ((tool.inertia - inertia) / tool.inertia_std).tolist()
    assert np.sqrt(np.mean(np.square(mass))) <= 1.2e-3
    assert np.sqrt(np.mean(np.square(center))) <= 1.2e-4
    assert np.mean(np.abs(z) < 1.96) > 0.85  # of 60, most of them of different records
