"""A calibration that is good for some axes is used on these, and on no other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import truewrench as tw
from truewrench.cli import main
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig


def _rig(settings: dict[str, Any], required: Any) -> Rig:
    return Rig.from_mapping({**settings, "required": required, "plan": {"duration": 10}})


def test_axes_that_are_not_asked_for_refuse_nothing_and_stay_empty(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    rig = _rig(settings, [0.3, 0.3, 0.3, None, None, 0.3])
    run = tw.simulate(rig, seed=1)
    found = tw.calibrate(rig, run.log)
    assert found.verdict.usable, found.verdict.reasons
    assert [axis for axis, good in found.axes.items() if not good] == ["mx", "my"]
    wrench = found.wrench(run.log.raw)
    assert np.isnan(wrench[:, 3:5]).all()
    assert np.isfinite(wrench[:, [0, 1, 2, 5]]).all()

    log, _ = run.write(tmp_path / "run.csv")
    found.write_yaml(tmp_path / "calibration.yaml")
    out = tmp_path / "out.csv"
    status = main(["apply", str(tmp_path / "calibration.yaml"), str(log), "-o", str(out)])
    assert status == 0
    header, first, *_ = out.read_text().splitlines()
    cells = dict(zip(header.split(","), first.split(","), strict=True))
    assert [cells[k] for k in ("mx", "my", "mx_std", "my_std")] == [""] * 4
    assert float(cells["fx"]) == pytest.approx(wrench[0, 0])


def test_a_record_too_poor_for_one_axis_is_good_for_the_others(settings: dict[str, Any]) -> None:
    rig = _rig(settings, [0.3, 0.3, 0.3, 0.3, 0.3, 1e-6])
    found = tw.calibrate(rig, tw.simulate(rig, seed=1).log)
    assert not found.verdict.usable
    assert [axis for axis, good in found.axes.items() if not good] == ["mz"]


@pytest.mark.parametrize("required", [[None] * 6, [0.1] * 5, [0.1] * 5 + [0], "little", True])
def test_what_is_required_is_a_number_or_six(settings: dict[str, Any], required: Any) -> None:
    with pytest.raises(InputError, match="one per wrench axis"):
        _rig(settings, required)


def test_a_plan_speaks_of_the_axes_that_are_asked_for(settings: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(json.dumps({**settings, "required": [None, None, None, None, None, 10.0]}))
    assert tw.load_rig(path).required_array.tolist() == [np.inf] * 5 + [10.0]
