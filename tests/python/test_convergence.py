"""A fit ends where Gauss-Newton and its sizes would move it no more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from record_cases import light_rig

import truewrench as tw
from truewrench import _core
from truewrench.estimation.record import recorded_logs


@pytest.mark.parametrize("rate", [100.0, 1000.0])
@pytest.mark.parametrize("gravity", [[0.0, 0.0, 0.0], [0.0, 0.0, -9.81]])
def test_a_fit_run_on_from_its_end_stays_there(rate: float, gravity: list[float]) -> None:
    settings = light_rig(seconds=10, rate=rate).to_mapping()
    rig = tw.Rig.from_mapping(settings | {"gravity": gravity})
    _, statement, streams = recorded_logs(rig, [tw.simulate(rig).log])
    fit: Any = _core.estimate(statement, streams, _core.Settings()).fit
    assert fit.converged
    theta, sigma, deviance = fit.theta.copy(), np.sqrt(np.diag(fit.P)), fit.deviance
    factor, q = fit.sizes(0).raw_factor.copy(), fit.sizes(0).q.copy()
    active = list(fit.active)

    for _ in range(3):  # to where it ends when it is not asked whether it has
        assert fit.linearise()
        assert fit.solve()
        fit.advance()
        fit.resize()
    assert fit.linearise()
    assert fit.solve()
    assert list(fit.active) == active
    moved = (fit.theta - theta)[active] / sigma[active]
    assert np.sqrt(np.mean(moved**2)) < 0.05
    assert np.sqrt(np.diag(fit.P))[:36] == pytest.approx(sigma[:36], rel=0.02)
    assert fit.sizes(0).raw_factor == pytest.approx(factor, rel=0.02)
    assert fit.sizes(0).q == pytest.approx(q, rel=0.02)
    assert fit.likelihood() == pytest.approx(deviance, abs=0.5)
