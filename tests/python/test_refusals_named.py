"""What a refusal names: slow disturbances, beside mistakes of the set-up, and what was left out."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from test_judging import departed, estimate_of, play, rig_of

from truewrench import robots
from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation.estimate import Estimate, Event, FoundNoise, Slow
from truewrench.judging import Comparisons, Suspicion, judge
from truewrench.judging.attribution import _changes, _misfit, slow_looks
from truewrench.judging.words import motion_scatter
from truewrench.model.calibration_parts import KINDS
from truewrench.model.rig import Rig, load_rig
from truewrench.simulation.free_body import simulate

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


def test_samples_left_out_from_some_time_on_look_like_a_step() -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig)
    [rows] = estimate.rows
    push = Event(2.0, 9.0, rows.masked.size // 2, True, np.full(6, 0.1))

    def kinds(masked: NDArray[np.bool_]) -> str:
        lost = replace(estimate, rows=(replace(rows, masked=masked),), events=((push,),))
        (reason, *_) = judge(lost, Comparisons(), rig, [log]).verdict.reasons
        return reason[reason.index("left out as") :]

    place = np.arange(rows.masked.size) / rows.masked.size
    assert kinds(place > 0.5).startswith("left out as step or contact")
    assert kinds(place < 0.4).startswith("left out as step or contact")
    assert kinds(np.abs(place - 0.5) < 0.2).startswith("left out as contact")


def test_a_mistake_is_not_sure_beside_something_slow_that_the_fit_is_without() -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig)
    sure = replace(MISTAKE, log_odds=100.0)
    comparisons = Comparisons(setup=(sure,))
    parts = replace(estimate, p_halves=1e-9)
    assert judge(parts, comparisons, rig, [log]).verdict.reasons[0] == sure.words
    beside = (Slow("force", 1.2e-3, 1e-4, 0.3, 12.0, "none"),)
    first = judge(replace(parts, slow=(beside,)), comparisons, rig, [log]).verdict.reasons[0]
    assert first.startswith("parts of the record disagree")


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


def walk_of(estimate: Estimate) -> Estimate:
    """With a random walk in the fit, from which gains have a sigma as large."""
    slow = (Slow("force", 4e-3, None, 9.0, 40.0, "walk"), Slow("moment", 4e-3, None, 9.0, 40.0, "walk"))
    wide = estimate.normalised_covariance.copy()
    wide[np.diag_indices(36)] += 0.1**2
    pose = {**estimate.sources, "pose": np.full((6, 6), 0.1)}
    return replace(estimate, slow=(slow,), normalised_covariance=wide, sources=pose)


def test_a_disturbance_that_costs_accuracy_is_named_and_not_to_be_denied() -> None:
    rig = rig_of()
    disturbed, log = estimate_of(rig, disturbed=lambda t, w, felt: play(felt, 2e-3))
    (found,) = judge(walk_of(disturbed), Comparisons(), rig, [log]).verdict.reasons
    assert "limited by what disturbs it slowly (hysteresis" in found
    assert "times less of what disturbs it" in found
    assert "`discrepancy: 0`" not in found
    clean, log = estimate_of(rig)
    unseen = replace(walk_of(clean), slow=clean.slow)
    (unseen_only,) = judge(unseen, Comparisons(), rig, [log]).verdict.reasons
    assert "`discrepancy: 0` where nothing but the payload pulls" in unseen_only
    assert "disturbs" not in unseen_only


def refused_for_accuracy(source: str, *noise: FoundNoise) -> str:
    """The reason, where one source costs it and such noise was found."""
    rig = rig_of()
    estimate, log = estimate_of(rig)
    wide = estimate.normalised_covariance.copy()
    wide[np.diag_indices(36)] += 0.1**2
    costs = {source: np.full((6, 6), 0.1)}
    estimate = replace(estimate, normalised_covariance=wide, noise=(noise,), sources=costs)
    (reason,) = judge(estimate, Comparisons(), rig, [log]).verdict.reasons
    return reason


def test_noise_that_costs_accuracy_is_named() -> None:
    reason = refused_for_accuracy("noise", FoundNoise("force", 4.2), FoundNoise("moment", 1.0))
    assert "the scatter of the samples, 4.2 times the stated (noise): a record" in reason


def test_what_else_is_larger_than_stated_is_named_beside_what_limits_the_accuracy() -> None:
    reason = refused_for_accuracy("inertia", FoundNoise("force", 4.2), FoundNoise("velocities v", 3.1))
    assert reason.endswith(
        "; found beside it: the scatter of the samples, 4.2 times the stated (noise) and the scatter of the "
        "motion, 3.1 times the stated (noise)"
    )


def test_noise_of_positions_that_nobody_stated_is_none_beyond_the_stated() -> None:
    estimate, log = estimate_of(rig_of())
    estimate = replace(estimate, noise=((FoundNoise("positions", 30.0), FoundNoise("velocities", 1.2)),))
    arm = load_rig(robots.path("ur10_ground"))
    log = replace(log, position=np.zeros((log.time.size, 6)))
    stated, unstated = (
        arm.model_copy(update={"motion": arm.motion.model_copy(update={"position_noise": noise})})
        for noise in ((1e-4,) * 6, None)
    )
    assert motion_scatter(estimate, stated, [log]) == 30.0
    assert motion_scatter(estimate, unstated, [log]) == 1.2


def test_a_random_walk_is_a_drift_and_a_cable_a_cable() -> None:
    """A walk resembles a few of many slow regressors; ten of each, the likeliest kind."""
    rig = rig_of()
    first: dict[str, list[str]] = {"walk": [], "cable": []}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        steps = 2e-4 * np.cumsum(rng.standard_normal((1500, 6)), axis=0)
        walks = estimate_of(rig, seed=seed, disturbed=lambda t, w, felt, steps=steps: steps)
        stiff = 5e-2 * rng.standard_normal((6, 6))
        twist = estimate_of(rig, seed=seed)[0].rows[0].twist
        pose = np.cumsum(twist, axis=0) / 100.0
        cables = estimate_of(rig, seed=seed, disturbed=lambda t, w, felt, pull=pose @ stiff.T: pull)
        for kind, (estimate, log) in {"walk": walks, "cable": cables}.items():
            first[kind].append(slow_looks(estimate, rig, [log])[0].kind)
    assert first["walk"].count("drift") >= 9
    assert first["cable"].count("cable") >= 9


def test_the_score_is_that_of_the_dense_likelihood() -> None:
    """-2 log L of y ~ N(Z b + level, s^2 (rho K + I)), b, level and s integrated out, by the textbook."""
    rng = np.random.default_rng(3)
    M, p = 40, 3
    Z, y = rng.standard_normal((M, p)), rng.standard_normal((M, 2)).cumsum(axis=0)
    K = np.minimum.outer(np.arange(M), np.arange(M)).astype(float)  # of a walk
    X = np.column_stack([np.ones(M), Z])
    sizes = np.array([0.0, 0.01, 1.0, 100.0])
    power = 4.0 * np.sin(0.5 * np.pi * np.arange(1, M) / M) ** 2
    ours = _misfit(_changes(Z), _changes(y), np.sqrt(sizes[:, None] + power))
    dense = np.zeros((4, 2))
    for g, size in enumerate(sizes):
        V = size * K + np.eye(M)
        A = np.linalg.solve(V, X)
        S = X.T @ A
        left = np.einsum("mi,mi->i", y, np.linalg.solve(V, y)) - np.einsum(
            "pi,pi->i", A.T @ y, np.linalg.solve(S, A.T @ y)
        )
        freedom = M - p - 1
        dense[g] = freedom * np.log(left / freedom) + np.linalg.slogdet(V)[1] + np.linalg.slogdet(S)[1]
    np.testing.assert_allclose(ours, dense, rtol=0.0, atol=1e-8)


def test_no_more_than_three_kinds_are_named_over_all_reasons() -> None:
    rig = rig_of()
    disturbed, log = estimate_of(rig, disturbed=lambda t, w, felt: play(felt, 2e-3))
    masked = np.arange(1500) % 3 == 0
    event = Event(0.0, 15.0, int(masked.sum()), True, np.full(6, 2e-3))
    noise = (FoundNoise("force", 4.2), FoundNoise("moment", 1.0))
    rows = replace(disturbed.rows[0], masked=masked)
    estimate = replace(walk_of(disturbed), noise=(noise,), events=((event,),), rows=(rows,), p_halves=1e-9)
    reasons = judge(estimate, Comparisons(), rig, [log]).verdict.reasons
    assert len(reasons) == 3
    assert len({kind for kind in KINDS if re.search(rf"\b{kind}\b", " ".join(reasons))}) <= 3


def test_halves_that_differ_more_than_quarters_are_a_change_partway() -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig)
    for halves, quarters, changed in ((1e-40, 1e-6, True), (1e-40, 1e-30, False), (1e-6, 0.5, False)):
        told = replace(estimate, p_halves=halves, p_quarters=quarters)
        (reason, *_) = judge(told, Comparisons(), rig, [log]).verdict.reasons
        assert ("the payload slipped or the sensor changed partway" in reason) == changed


def test_a_gain_of_which_nothing_was_told_is_not_usable_however_little_is_required() -> None:
    """A prior below `required` is accurate by itself, and no more than believed."""
    rig = rig_of(gain_prior=0.01, required=0.02)
    estimate, log = estimate_of(rig)
    assert judge(estimate, Comparisons(), rig, [log]).verdict.usable
    P = estimate.normalised_covariance.copy()
    np.fill_diagonal(P[:36, :36], (0.9 * 0.01) ** 2)  # by what may follow the pose: before it, it was known
    verdict = judge(replace(estimate, normalised_covariance=P), Comparisons(), rig, [log]).verdict
    assert not verdict.usable
    assert "nothing was told of any gain" in verdict.reasons[0]


def test_a_mass_in_grams_is_named_where_moments_are_all_lever() -> None:
    rig = load_rig(Path(__file__).parents[2] / "examples" / "rig.yaml")
    wrong = rig.to_mapping()
    wrong["payloads"]["default"]["mass"] *= 1000
    found = calibrate(Rig.from_mapping(wrong), simulate(rig).log, held_out=False)
    words = "mass of the payload 1000 times too large (g for kg, or mm/s for m/s in v)"
    assert words in found.verdict.reasons[0]
    assert not any("centre of mass" in reason for reason in found.verdict.reasons)
