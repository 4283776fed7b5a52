"""What a refusal names: slow disturbances, beside mistakes of the set-up, and what was left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_judging import departed, estimate_of, play, rig_of

from truewrench.estimation.estimate import Event, Slow
from truewrench.judging import Comparisons, Suspicion, judge

MISTAKE = Suspicion("axes", "suspected set-up error: axes mixed up", 3.0)


def test_a_slow_disturbance_is_named_where_a_mistake_of_the_set_up_speaks_alone() -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig, departed(10), disturbed=lambda t, w, felt: play(felt, 2e-3))
    slow = (Slow("force", 1.2e-3, None, 9.0, 40.0, "walk"), Slow("moment", 1e-3, None, 9.0, 40.0, "walk"))
    estimate = replace(estimate, slow=(slow,))
    comparisons = Comparisons(setup=(MISTAKE,))
    (alone, *_) = judge(estimate, comparisons, rig, [log]).verdict.reasons
    assert alone.startswith(f"{MISTAKE.words}; or a slow disturbance that looks like one: hysteresis")
    parts, beside, *_ = judge(replace(estimate, p_halves=1e-9), comparisons, rig, [log]).verdict.reasons
    assert "does not fit the model (hysteresis" in parts
    assert beside == MISTAKE.words


def test_where_nothing_is_slow_parts_disagree_by_what_was_left_out() -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig)
    push = Event(2.0, 2.3, 30, True, np.full(6, 0.1))
    estimate = replace(estimate, events=((push,),), p_halves=1e-9)
    (reason, *_) = judge(estimate, Comparisons(), rig, [log]).verdict.reasons
    assert "does not fit the model (contact" in reason


def test_two_slow_kinds_stand_before_what_was_left_out() -> None:
    rig = rig_of()
    drift = 2e-2 * (1 - np.exp(-np.arange(1500) / 800.0))[:, None] * np.ones(6)
    estimate, log = estimate_of(rig, departed(10), disturbed=lambda t, w, felt: drift + play(felt, 2e-3))
    slow = (Slow("force", 1.2e-3, None, 9.0, 40.0, "walk"), Slow("moment", 1e-3, None, 9.0, 40.0, "walk"))
    masked = np.arange(1500) % 3 == 0
    event = Event(0.0, 15.0, int(masked.sum()), True, np.full(6, 2e-3))
    rows = replace(estimate.rows[0], masked=masked)
    estimate = replace(estimate, slow=(slow,), events=((event,),), rows=(rows,))
    (reason, *_) = judge(estimate, Comparisons(), rig, [log]).verdict.reasons
    named = reason.split("left out as ")[1].split(":")[0].replace(" or ", ", ").split(", ")
    assert named[-1] == "contact"
    assert set(named[:-1]) == {"drift", "hysteresis"}
