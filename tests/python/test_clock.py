"""Claims about the test of a clock that a rig calls exact."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from truewrench import _core
from truewrench.estimate.clock import clock_doubts
from truewrench.rig import Rig


def rig_of() -> Rig:
    exact = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    inertia = {"xx": 1.5, "yy": 1.5, "zz": 0.4}
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": [0.5] * 3 + [0.05] * 3,
                "range": [500] * 3 + [50] * 3,
                "time_offset_prior": 0,
            },
            "payloads": {
                "p": {"mass": 50, "center_of_mass": [0.2, 0, 0], "inertia": inertia, "uncertainty": exact}
            },
            "motion": {"noise": [1e-3] * 6},
        }
    )


def explained(
    offset: float, chi_square: float, samples: int = 12_000, intervals: int = 10, knot_dependence: float = 0.5
) -> Any:
    """An estimate with one window: its time offset (sigma 0.1 ms) and how well it explains the samples."""
    group = SimpleNamespace(sum_of_squares=chi_square * samples, count=samples)
    window = SimpleNamespace(status=_core.WindowStatus.fitted, intervals=intervals, groups=[group])
    return SimpleNamespace(
        solved=True, time_offsets=np.array([offset]), time_offsets_std=np.array([1e-4]), windows=[window],
        knot_dependence=knot_dependence,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("free", "doubted"),
    [
        (explained(3e-3, 0.99), True),  # a delay that explains the record better
        (explained(3e-3, 1.0), True),  # or as well
        (explained(3e-3, 1.0, samples=11_900), True),  # of a few samples fewer
        (explained(3e-3, 1.2), False),  # a search that went astray explains it worse
        (explained(3e-3, 1.0, intervals=300), False),  # or needs far more knots
        (explained(3e-3, 0.9, samples=6_000), False),  # or leaves half of it out
        (explained(3e-4, 0.99), False),  # three sigma
        (explained(3e-3, 0.99, knot_dependence=4.0), False),  # or a motion that does not tell the clock
    ],
)
def test_clock_is_doubted_where_another_explains_the_record_no_worse(free: Any, doubted: bool) -> None:
    def estimate(rig: Rig) -> Any:
        return free if rig.sensor.time_offset_prior > 0.0 else explained(0.0, 1.0)

    assert bool(clock_doubts(rig_of(), [], estimate)) == doubted
