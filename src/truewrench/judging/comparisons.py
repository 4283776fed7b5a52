"""What an estimate is compared with before it is judged: data held out, and set-ups that would explain it."""

from __future__ import annotations

from dataclasses import dataclass

from truewrench.judging.setup_odds import Suspicion


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Held-out comparison, or why there is none, and suspected set-up errors."""

    worse: tuple[str, ...] = ()  # why, by that, the new gain should not replace the nominal one, in words
    # why nothing was held out, in words; empty where something was. It is always told.
    not_held_out: str = ""
    setup: tuple[Suspicion, ...] = ()  # `setup_errors` of the estimate
    hopeless: tuple[str, ...] = ()  # why nothing was estimated, in words: `joint_faults`, `gross_errors`
