"""What an estimate is compared with before it is judged: data held out, and set-ups that would explain it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from truewrench.judging.setup_odds import Suspicion
from truewrench.model.calibration_parts import AxisImprovement

__all__ = ["Comparisons"]


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Held-out comparison, or why there is none, and suspected set-up errors.

    Attributes:
        improvement: by wrench axis, on the part of the record that was held out; empty without one.
        worse: why, by that, the new gain should not replace the nominal one, in words.
        not_held_out: why nothing was held out, in words; empty where something was. It is always told.
        setup: `setup_errors` of the estimate.
        hopeless: why nothing was estimated, in words: `joint_faults`, `gross_errors`.
    """

    improvement: Mapping[str, AxisImprovement] = field(default_factory=dict)
    worse: tuple[str, ...] = ()
    not_held_out: str = ""
    setup: tuple[Suspicion, ...] = ()
    hopeless: tuple[str, ...] = ()
