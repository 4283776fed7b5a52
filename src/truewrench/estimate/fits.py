"""How well residuals match their noise: chi-squares per stream, and how unlikely they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from truewrench import _core
from truewrench.estimate.window_estimate import GROUPS

__all__ = ["ENOUGH", "GroupFit", "chi_square_deviate", "fitted_share", "group_fits", "mostly_unexplained"]

ENOUGH = _core.EstimatorSettings().enough_fitted
"""Share of the samples in windows that fit, below which other ways to an estimate are tried."""


def chi_square_deviate(chi_square: float, freedom: float) -> float:
    """Standard normal deviate of a chi-square per degree of freedom (Wilson and Hilferty's cube root)."""
    v = 2.0 / (9.0 * freedom)
    return (math.cbrt(chi_square) - (1.0 - v)) / math.sqrt(v)


@dataclass(frozen=True, slots=True)
class GroupFit:
    """Residuals of one stream over their noise: chi-square per degree of freedom, and how unlikely it is."""

    chi_square: float
    deviate: float


def group_fits(windows: Sequence[_core.WindowReport], fitted: bool = True) -> dict[str, GroupFit]:
    """Per stream, over all fitted windows (or all that were rejected with residuals)."""
    fits = {}
    for k, name in enumerate(GROUPS):
        groups = [w.groups[k] for w in windows if (w.status == _core.WindowStatus.fitted) == fitted]
        total = sum(g.sum_of_squares for g in groups)
        freedom = sum(g.count - g.leverage for g in groups)
        if freedom < 1.0:
            continue
        fits[name] = GroupFit(total / freedom, chi_square_deviate(total / freedom, freedom))
    return fits


def fitted_share(windows: Sequence[_core.WindowReport]) -> float:
    """Share of the sensor's samples that lie in windows that fit."""
    fitted = sum(w.samples for w in windows if w.status == _core.WindowStatus.fitted)
    return fitted / max(1, sum(w.samples for w in windows))


def mostly_unexplained(windows: Sequence[_core.WindowReport]) -> bool:
    """Whether most samples of the sensor lie in windows that do not fit."""
    return fitted_share(windows) < 0.5
