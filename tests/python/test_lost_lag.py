"""`online` where its lag cannot be solved gives it up: its memory is fixed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from record_cases import light_rig

import truewrench as tw
from truewrench import _core
from truewrench.estimation.record import recorded_logs


@pytest.mark.parametrize("size", [1e160, 1e200, 1e300])
def test_a_lag_that_cannot_be_solved_is_given_up(size: float) -> None:
    rig = light_rig(seconds=30, rate=100)
    _, statement, streams = recorded_logs(rig, [tw.simulate(rig).log])
    online: Any = _core.Incremental(statement, streams[0], _core.IncrementalSettings())
    motion, time = streams[0].motion[0], np.asarray(streams[0].time)
    velocity, raw = np.array(motion.value), np.array(streams[0].raw)
    broken = (time > 12.0) & (time < 20.0)  # far longer than the lag
    velocity[broken] = size * np.sign(velocity[broken])
    told = []
    for k, t in enumerate(time):
        told += online.push_motion(0, np.array([t]), velocity[k : k + 1])
        told += online.push_raw(np.array([t]), raw[k : k + 1])
        if k == np.searchsorted(time, 12.0):
            before = np.array(online.gain)
    online.finish()
    assert {str(s) for s in told} - {"Status.ok"}  # it is said
    assert online.status != _core.Status.ok
    assert np.isfinite(online.gain).all()
    assert np.isfinite(before).all()
