"""What an estimate is compared with before it is judged: data held out, and set-ups that would explain it."""

from __future__ import annotations

from dataclasses import dataclass

from truewrench.judging.setup_odds import Suspicion


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Held-out comparison, or why there is none, and suspected set-up errors.

    Attributes:
        worse: why, by that, the new gain should not replace the nominal one, in words.
        not_held_out: why nothing was held out, in words; empty where something was. It is always told.
        setup: `setup_errors` of the estimate.
        hopeless: why nothing was estimated, in words: `joint_faults`, `gross_errors`.
    """

    worse: tuple[str, ...] = ()
    not_held_out: str = ""
    setup: tuple[Suspicion, ...] = ()
    hopeless: tuple[str, ...] = ()
