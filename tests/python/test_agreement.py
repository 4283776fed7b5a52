"""Whether parts of a record agree on the gain (10.11): by chance as often as p says, not where it changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_cases import rig_with
from scipy.stats import binom

import truewrench as tw
from truewrench.estimation.estimator import estimate

Array = np.ndarray[Any, np.dtype[np.float64]]
HALVES, QUARTERS = "p_halves", "p_quarters"


def test_parts_of_sound_records_differ_by_chance(settings: dict[str, Any]) -> None:
    """Of 60 comparisons a tenth has p below 0.1, and not fewer than chance allows above 0.5."""
    rig = rig_with(settings)
    p = []
    for seed in range(30):
        found = estimate(rig, [tw.simulate(rig, seed=seed).log])
        p += [found.p_halves, found.p_quarters]
    assert np.count_nonzero(np.array(p) < 0.1) <= binom.ppf(0.9999, len(p), 0.1)
    # (10.9) in V makes p larger
    assert np.count_nonzero(np.array(p) > 0.5) >= binom.ppf(1e-4, len(p), 0.5)


@pytest.mark.parametrize(
    ("changed", "told", "not_told"),
    [(lambda place: place < 0.5, HALVES, QUARTERS), (lambda place: (4 * place) % 2 < 1, QUARTERS, HALVES)],
)
def test_a_gain_that_changes_within_a_record_is_told(
    settings: dict[str, Any], changed: Callable[[Array], Array], told: str, not_told: str
) -> None:
    """A channel reads 10% more in two quarters of the record: comparing them with the others tells it."""
    rig = rig_with(settings)
    log = tw.simulate(rig, seed=1).log
    raw = log.raw.copy()
    raw[changed(log.time / log.time[-1]), 0] *= 1.1
    found = estimate(rig, [replace(log, raw=raw)])
    assert getattr(found, told) < 1e-6
    assert getattr(found, not_told) > 100 * getattr(found, told)
