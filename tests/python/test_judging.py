"""One function judges an estimate; words are apart from it. Estimates are built here, without the core."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from truewrench.estimation.estimate import Clock, Estimate, Event, FoundNoise, LogRows, Slow, Step, Tilt
from truewrench.judging import Comparisons, Judgement, blind_to, findings, judge, setup_errors
from truewrench.judging.setup_mistakes import payload_directions
from truewrench.judging.setup_odds import payload_errors, suspected_setup_errors
from truewrench.model.calibration_parts import KINDS
from truewrench.model.log import Log
from truewrench.model.rig import Rig

SPAN = np.array([500.0, 500, 500, 50, 50, 50])
ONE = np.eye(6)


def rig_of(**sensor: Any) -> Rig:
    top = {k: sensor.pop(k) for k in ("required", "gravity", "motion") if k in sensor}
    noise = sensor.pop("noise", [0.1, 0.1, 0.1, 0.01, 0.01, 0.01])
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": noise,
                "range": SPAN.tolist(),
                **sensor,
            },
            "payloads": {
                "default": {
                    "mass": 50,
                    "center_of_mass": [0.2, 0, 0],
                    "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
                }
            },
            "motion": {"noise": [1e-4] * 6},
            **top,
        }
    )


def estimate_of(
    rig: Rig, gain: np.ndarray = ONE, *, rows: int = 1500, seed: int = 0, disturbed: Any = None
) -> tuple[Estimate, Log]:
    """Exact posterior of gain and offset, the wrench being known; `disturbed(t, w, felt)` comes on top."""
    rng = np.random.default_rng(seed)
    n, prior = rig.sensor.n, rig.sensor.gain_prior
    t = np.arange(rows) / 100.0
    phase = rng.uniform(0.0, 2 * np.pi, (6, 6))
    omega = 2 * np.pi * np.array([0.15, 0.3, 0.45, 0.65, 0.85, 1.1])[:, None, None]
    angle = omega * t[:, None] + phase[:, None, :]
    twist, acceleration = 0.1 * np.sin(angle).sum(axis=0), 0.1 * (omega * np.cos(angle)).sum(axis=0)
    w = 0.2 * acceleration @ (ONE + 0.2 * rng.standard_normal((6, 6)))  # normalised
    scale = rig.sensor.channel_scale
    noise = rig.sensor.noise_array / scale
    nominal = rig.sensor.nominal_gain_array * SPAN / scale[:, None]
    felt = w @ gain.T
    extra = np.zeros((rows, n)) if disturbed is None else disturbed(t, w, felt)
    raw = felt + noise * rng.standard_normal((rows, n)) + extra
    X = np.column_stack([w, np.ones(rows)])
    P, C, b = np.zeros((7 * n, 7 * n)), np.zeros((n, 6)), np.zeros(n)
    order = [[*range(6 * i, 6 * i + 6), 6 * n + i] for i in range(n)]
    for i in range(n):
        mean = np.append(nominal[i], 0.0)
        V = np.linalg.inv(X.T @ X / noise[i] ** 2 + np.diag([prior**-2.0] * 6 + [100.0]))
        estimate = mean + V @ X.T @ (raw[:, i] - X @ mean) / noise[i] ** 2
        C[i], b[i] = estimate[:6], estimate[6]
        P[np.ix_(order[i], order[i])] = V
    units = np.append((scale[:, None] / SPAN).ravel(), scale)
    log = Log(None, "default", "", np.arange(rows) * 10_000_000, raw * scale, twist=twist)
    fitted = LogRows(
        np.arange(rows),
        t,
        np.zeros(rows, dtype=bool),
        raw - X @ np.column_stack([C, b]).T,
        np.zeros((rows, n)),
        w * SPAN,
        twist,
        acceleration,
        np.zeros(rows, np.int64),
    )
    found = Estimate(
        solved=True,
        gain=C * scale[:, None] / SPAN,
        covariance=P * np.outer(units, units),
        normalised_covariance=P,
        before_pose=P[: 6 * n, : 6 * n].copy(),
        gain_prior=np.full(6 * n, prior),
        offsets=(b * scale)[None],
        offsets_std=np.full((1, n), 1e-3),
        clocks=((Clock("twist", 0.0, 1e-4, 5e-3),),),
        payloads={},
        tilts=(),
        offset_temperature=None,
        quadratic=np.zeros(n),
        quadratic_std=np.full(n, 1e-4),
        discrepancy=np.zeros(n),
        noise=((FoundNoise("force", 1.0), FoundNoise("moment", 1.0), FoundNoise("velocities v", 1.0)),),
        slow=((Slow("force", 0.0, 1e-5, 0.3, 0.0, "none"),),),
        events=((),),
        steps=((),),
        spacing=np.array([0.05]),
        unexplained=np.zeros(1),
        unresolved=np.array([False]),
        dropped=np.array([0]),
        rows=(fitted,),
        sources={"noise": np.sqrt(np.diag(P)[: 6 * n]).reshape(n, 6)},
        A=0.4,
        ww=w.T @ w / max(rows, 1),
        p_halves=0.5,
        p_quarters=0.5,
        p_logs=np.ones(1),
        converged=True,
        iterations=5,
        fits=2,
        history_time=np.zeros(0),
        history_log=np.zeros(0, np.int64),
        history_gain=np.zeros((0, n, 6)),
    )
    return found, log


def at_clock(estimate: Estimate, log: Log, clock: Clock) -> tuple[Estimate, Log]:
    """The same with the motion logged by that clock."""
    rows = estimate.rows[0]
    shifted = rows.twist + clock.late * rows.acceleration
    shifted += 0.5 * clock.late**2 * np.gradient(rows.acceleration, rows.time, axis=0)
    noise = 1e-2 * np.random.default_rng(3).standard_normal(shifted.shape)
    return replace(estimate, clocks=((clock,),)), replace(log, twist=shifted + noise)


def judged(rig: Rig, estimate: Estimate, log: Log, **changes: Any) -> Judgement:
    return judge(estimate, Comparisons(setup=setup_errors(estimate, rig, [log]), **changes), rig, [log])


def kinds_in(text: str) -> set[str]:
    return {kind for kind in KINDS if re.search(rf"\b{kind}\b", text)}


def departed(seed: int, size: float = 0.1) -> np.ndarray:
    return ONE + size * np.random.default_rng(seed).standard_normal((6, 6))


def test_a_good_record_is_usable_on_all_axes_and_nothing_is_found() -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(1))
    found = judged(rig, estimate, log)
    assert found.verdict.usable
    assert found.verdict.reasons == ()
    assert all(found.axes.values())
    assert found.verdict.undetermined == ()
    assert findings(estimate, rig, [log]) == ()
    assert "cable" in [blind.kind for blind in found.verdict.blind_to]


@pytest.mark.parametrize("prior", [0.05, 0.3, 1.0, 10.0, 1e3, 1e200])
@pytest.mark.parametrize("departure", [0.0, 0.02])
def test_widening_the_gain_prior_never_refuses(prior: float, departure: float) -> None:
    for seed in range(3):
        rig = rig_of(gain_prior=prior, required=0.05)
        estimate, log = estimate_of(rig, departed(seed, departure))
        assert judged(rig, estimate, log).verdict.reasons == ()


def test_an_undetermined_direction_is_words_and_no_reason_where_the_prior_is_accurate_enough() -> None:
    rig = rig_of(gain_prior=0.01, required=0.02, noise=[5.0] * 3 + [0.5] * 3)
    estimate, log = estimate_of(rig, rows=300)
    estimate = replace(estimate, before_pose=0.8e-4 * np.eye(36) * np.tile([1, 1, 1, 1, 1, 0.01], 6))
    found = judged(rig, estimate, log)
    assert found.verdict.usable
    assert len(found.verdict.undetermined) == 30
    assert any("30 of 36 directions" in note for note in found.notes)


def test_accuracy_refuses_its_own_axis_only() -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(2))
    P = estimate.normalised_covariance.copy()
    P[8, 8] = 0.05**2  # the gain of fy on fz
    found = judged(rig, replace(estimate, normalised_covariance=P), log)
    assert not found.verdict.usable
    (reason,) = found.verdict.reasons
    assert "the gain of fy on fz has a sigma of 0.05 of range, more than the required 0.02" in reason
    assert [axis for axis, usable in found.axes.items() if not usable] == ["fz"]


def test_requirements_by_axis_and_axes_that_are_not_asked_for() -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(2))
    P = estimate.normalised_covariance.copy()
    P[8, 8] = 0.05**2
    estimate = replace(estimate, normalised_covariance=P)

    asked = rig.model_copy(update={"required": (0.02, 0.02, None, 0.02, 0.02, 0.02)})
    found = judge(estimate, Comparisons(), asked, [log])
    assert found.verdict.usable
    assert [axis for axis, usable in found.axes.items() if not usable] == ["fz"]
    looser = rig.model_copy(update={"required": (0.02, 0.02, 0.06, 0.02, 0.02, 0.02)})
    assert all(judge(estimate, Comparisons(), looser, [log]).axes.values())


def test_permuting_channels_permutes_the_judgement() -> None:
    order = [3, 0, 5, 1, 4, 2]
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(3))
    P = estimate.normalised_covariance.copy()
    P[8, 8] = 0.05**2
    estimate = replace(estimate, normalised_covariance=P)
    names = [rig.sensor.channels[i] for i in order]
    other = rig_of(
        required=0.02,
        channels=names,
        nominal_gain=ONE[order].tolist(),
        noise=rig.sensor.noise_array[order].tolist(),
    )
    at = np.concatenate([[6 * i + j for j in range(6)] for i in order])
    both = np.concatenate([at, 36 + np.array(order)])
    rows = estimate.rows[0]
    permuted = replace(
        estimate,
        gain=estimate.gain[order],
        normalised_covariance=P[np.ix_(both, both)],
        before_pose=estimate.before_pose[np.ix_(at, at)],
        rows=(replace(rows, residual=rows.residual[:, order], discrepancy=rows.discrepancy[:, order]),),
        sources={"noise": estimate.sources["noise"][order]},
    )
    before = judged(rig, estimate, log)
    after = judged(other, permuted, replace(log, raw=log.raw[:, order]))
    assert after.axes == before.axes
    assert after.verdict.reasons == before.verdict.reasons


@pytest.mark.parametrize(
    ("change", "words", "named"),
    [
        ({"p_halves": 1e-6}, "parts of the record disagree on the gain (halves, p = 1e-06)", True),
        ({"p_quarters": np.nan}, "quarters 1 + 3 and 2 + 4, p = nan", True),
        ({"unresolved": np.array([True])}, "the motion of the log is not resolved", True),
        ({"gain": np.zeros((6, 6))}, "singular", False),
    ],
)
def test_each_thing_that_speaks_against_a_result_refuses_it_on_all_axes(
    change: dict[str, Any], words: str, named: bool
) -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(4))
    found = judge(replace(estimate, **change), Comparisons(), rig, [log])
    assert not found.verdict.usable
    assert not any(found.axes.values())
    (reason,) = found.verdict.reasons
    assert words in reason
    if named:
        assert 1 <= len(kinds_in(reason)) <= 3
        assert "largest departure: channel" in reason


@pytest.mark.parametrize("usable", [True, False])
def test_a_refused_record_without_its_noise_may_be_smoothed(usable: bool) -> None:
    """Else a table run through filtfilt was told of an inertia 26 sigma from what the rig states."""
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(4))
    quiet = (FoundNoise("force", 0.3), FoundNoise("moment", 0.04))
    p_halves = estimate.p_halves if usable else 1e-6
    reasons = judge(
        replace(estimate, noise=(quiet,), p_halves=p_halves), Comparisons(), rig, [log]
    ).verdict.reasons
    assert len(reasons) == (0 if usable else 2)
    assert usable or "noise of the moments of the log is 0.04 x the stated: smoothed after" in reasons[0]


def test_a_record_most_of_which_was_left_out_is_refused() -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(5))
    masked = np.arange(1500) % 4 == 0
    event = Event(3.0, 6.8, int(masked.sum()), True, np.full(6, 0.1))
    estimate = replace(estimate, rows=(replace(estimate.rows[0], masked=masked),), events=((event,),))
    (reason,) = judged(rig, estimate, log).verdict.reasons
    assert "25% of the sensor's samples were left out as contact" in reason


def test_what_was_held_out_decides_or_is_said_to_be_missing() -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(6))
    found = judged(rig, estimate, log, not_held_out="the rest of the record did not give a gain")
    assert found.verdict.usable
    assert any("the rest of the record did not give a gain" in note for note in found.notes)
    worse = judged(rig, estimate, log, worse=("on the part that was held out, fx is worse",))
    assert worse.verdict.reasons == ("on the part that was held out, fx is worse",)


def test_a_dead_channel_is_one_reason_not_many() -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(7))
    raw = log.raw.copy()
    raw[:, 2] = 4.0
    P, before = estimate.normalised_covariance.copy(), estimate.before_pose.copy()
    P[12:18, :], P[:, 12:18] = 0.0, 0.0
    P[12:18, 12:18] = 0.09 * ONE
    before[12:18], before[:, 12:18] = 0.0, 0.0
    before[12:18, 12:18] = 0.09 * ONE
    estimate = replace(estimate, normalised_covariance=P, before_pose=before)
    found = judged(rig, estimate, replace(log, raw=raw))
    (reason,) = found.verdict.reasons
    assert "channel fz is constant (4)" in reason
    assert {u.words for u in found.verdict.undetermined} == {"gains of fz, which has no signal"}


def test_nothing_learnt_is_refused_whatever_is_required() -> None:
    rig = rig_of(gain_prior=0.01, required=0.5)
    estimate, log = estimate_of(rig, rows=40)
    nothing = replace(
        estimate, normalised_covariance=1e-4 * np.eye(42), before_pose=1e-4 * np.eye(36), ww=np.zeros((6, 6))
    )
    (reason,) = judge(nothing, Comparisons(), rig, [log]).verdict.reasons
    assert "nothing was learnt" in reason
    still = replace(log, twist=np.zeros_like(log.raw))
    (reason,) = judge(nothing, Comparisons(), rig, [still]).verdict.reasons
    assert "nothing moved: every column of the motion is constant" in reason


@pytest.mark.parametrize("rows", [0, 1, 2, 5, 12])
@pytest.mark.parametrize("broken", [np.nan, np.inf, 0.0, 1e300])
@pytest.mark.parametrize("solved", [True, False])
def test_nothing_crashes_the_judgement(rows: int, broken: float, solved: bool) -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig, rows=12)
    of = estimate.rows[0]
    cut = {
        name: values[:rows]
        for name in LogRows.__dataclass_fields__
        if isinstance(values := getattr(of, name), np.ndarray)
    }
    estimate = replace(
        estimate,
        solved=solved,
        rows=(LogRows(**cut),),
        normalised_covariance=np.full((42, 42), broken),
        before_pose=np.full((36, 36), broken),
        gain_prior=np.full(36, broken),
        gain=np.full((6, 6), broken),
        p_halves=broken,
        A=broken,
        quadratic=np.full(6, broken),
        ww=np.full((6, 6), broken),
        dropped=np.array([2]),
    )
    part = replace(log, raw=log.raw[:rows], twist=None, time_ns=log.time_ns[:rows])
    found = judged(rig, estimate, part)
    assert not found.verdict.usable
    assert found.verdict.reasons
    assert not any(found.axes.values())
    findings(estimate, rig, [part])
    blind_to(estimate, rig)


def test_a_turn_of_the_axes_is_named() -> None:
    for degrees, axis in ((45.0, 2), (-30.0, 0), (130.0, 1)):
        a = np.radians(degrees)
        about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        R = np.roll(about_z, (axis + 1, axis + 1), (0, 1))
        rig = rig_of(gain_prior=0.05)
        estimate, log = estimate_of(rig_of(gain_prior=0.3), departed(8, 0.02) @ np.kron(np.eye(2), R))
        suspicions = setup_errors(replace(estimate, gain_prior=np.full(36, 0.05)), rig, [log])
        angle = re.search(rf"axes turned by (-?\d+) deg about {'xyz'[axis]} \(", suspicions[0].words)
        assert angle is not None
        assert float(angle[1]) == pytest.approx(degrees, abs=2.0)


def test_the_payloads_uncertainty_is_in_the_odds() -> None:
    """Forces seen 2.2 times too large: a mass in pounds, unless the mass was hardly known."""
    center = np.array([0.2, 0.0, 0.0])
    gain = departed(9, 0.03) @ np.diag([2.2046226] * 3 + [1.0] * 3)
    seen = 1e-6 * np.eye(36)
    u = np.kron(ONE, np.diag([1.0] * 3 + [0.0] * 3)) @ ONE.ravel()
    for sigma, suspected in ((1e-3, True), (1.5, False)):
        P = np.linalg.inv(np.linalg.inv(seen + sigma**2 * np.outer(u, u)) + np.eye(36) / 0.3**2)
        pulled = ONE.ravel() + P @ np.linalg.solve(seen + sigma**2 * np.outer(u, u), (gain - ONE).ravel())
        found = suspected_setup_errors(
            pulled.reshape(6, 6), P, ONE, 0.3, SPAN, SPAN, centers_of_mass=[center]
        )
        assert bool(found) == suspected


@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("prior", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("size", [0.0, 0.3])
def test_a_payload_that_is_hardly_known_is_not_in_other_units(
    sigma: float, prior: float, size: float
) -> None:
    """A sound sensor, size of its departures in priors; mass and inertia known to sigma, all else exactly."""
    center = np.array([0.2, 0.0, 0.0])
    gain = departed(3, size * prior)
    of = [gain @ d for d in payload_directions(SPAN, center)[:2]]
    data = 1e-8 * np.eye(36) + sigma**2 * sum(np.outer(u, u) for u in (x.ravel() for x in of))
    P = np.linalg.inv(np.linalg.inv(data) + np.eye(36) / prior**2)
    pulled = ONE.ravel() + P @ np.linalg.solve(data, (gain - ONE).ravel())
    for relative in ([], [(sigma, sigma)]):
        assert not suspected_setup_errors(
            pulled.reshape(6, 6), P, ONE, prior, SPAN, SPAN, centers_of_mass=[center], relative=relative
        )


def test_least_squares_name_the_units_where_the_estimate_is_lost() -> None:
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig, departed(11))
    exact = 1e-6 * np.eye(36) * np.outer(np.outer(SPAN, 1 / SPAN).ravel(), np.outer(SPAN, 1 / SPAN).ravel())
    plain = 1e3 * departed(11) * SPAN[:, None] / SPAN, exact
    assert setup_errors(estimate, rig, [log], lambda: plain) == ()  # which describes its record
    noisy = replace(estimate, noise=((FoundNoise("force", 300.0),),))
    assert setup_errors(noisy, rig, [log], lambda: plain) == ()  # vibration: its gain is known all the same
    lost = replace(noisy, before_pose=np.diag(estimate.gain_prior**2))
    assert "1000 times too large" in setup_errors(lost, rig, [log], lambda: plain)[0].words
    forces = replace(noisy, before_pose=np.diag(np.repeat([1.0, 1e-6], 18) * estimate.gain_prior**2))
    assert "1000 times too large" in setup_errors(forces, rig, [log], lambda: plain)[0].words
    moments = replace(forces, noise=((FoundNoise("moment", 300.0),),))
    assert setup_errors(moments, rig, [log], lambda: plain) == ()  # whose gains are known
    assert setup_errors(replace(estimate, solved=False), rig, [log], lambda: None) == ()


def test_a_payload_far_from_its_statement_is_named_and_a_clock_is_not() -> None:
    stated = np.array([1e-3] + [5e-4] * 3 + [1e-2] * 6)
    assert payload_errors("tool", 3.0 * stated, stated) == ()
    (found,) = payload_errors("tool", np.where(np.arange(10) == 0, 6.0, 0.0) * stated, stated)
    assert "mass of payload `tool` is 6.0 sigma from what the rig states" in found.words
    rig = rig_of(required=0.02)
    estimate, log = estimate_of(rig)
    late, log = at_clock(estimate, log, Clock("twist", 0.02, 1e-4, 5e-3))
    assert judged(rig, late, log).verdict.usable
    (told,) = findings(late, rig, [log])
    assert told.what.startswith("clock, delay, filter: ")
    assert told.evidence == "the sensor is 20.0 +- 0.1 ms late against the velocities"


def test_filters_are_told_from_clocks_by_their_second_moment() -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig)
    of_velocities = Clock("twist", -7.9e-3, 1e-4, 5e-3, 1.0, 0.02)
    found, late = at_clock(estimate, log, of_velocities)
    (told,) = findings(found, rig, [late])
    assert told.what.startswith("filter")
    assert "the velocities are late by 7.9 +- 0.2 ms and look filtered at 20 Hz" in told.evidence
    of_sensor = Clock("twist", 4e-3, 1e-5, 5e-3, 0.0, 0.02)
    found, late = at_clock(estimate, log, of_sensor)
    (told,) = findings(found, rig, [late])
    assert "the sensor's channels are late by 4.00 +- 0.08 ms and look filtered at 40 Hz" in told.evidence
    both = Clock("twist", 1.342e-3, 5e-6, 5e-3, None, None, 2.55, 0.02)
    found, late = at_clock(estimate, log, both)
    first, second = findings(found, rig, [late])
    assert first.value == pytest.approx(2.08e-3, rel=0.01)  # 76 Hz
    assert second.value == pytest.approx(3.42e-3, rel=0.01)
    assert second.what.startswith("clock")


def play(felt: np.ndarray, size: float) -> np.ndarray:
    out = felt.copy()
    for k in range(1, len(out)):
        out[k] = np.clip(out[k - 1], felt[k] - size, felt[k] + size)
    return out - felt


@pytest.mark.parametrize(
    ("kind", "disturbed"),
    [
        ("hysteresis", lambda t, w, felt: play(felt, 2e-3)),
        ("nonlinearity", lambda t, w, felt: 1e-2 * (w[:, [0]] * w[:, [1]] + w**2)),
        ("drift", lambda t, w, felt: 3e-3 * (1 - np.exp(-t / 8.0))[:, None] * np.ones(6)),
    ],
)
def test_slow_disturbances_are_named_by_what_they_follow(kind: str, disturbed: Any) -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig, departed(10), disturbed=disturbed)
    slow = (Slow("force", 1.2e-3, 1e-4, 0.3, 40.0, "none"), Slow("moment", 1e-3, 1e-4, 0.3, 40.0, "none"))
    found = findings(replace(estimate, slow=(slow,)), rig, [log])
    assert found[0].what.startswith(kind)
    assert found[0].evidence.startswith(f"slow disturbance of 0.6 N, correlated over 0.3 s: {kind}")


def test_fast_disturbances_are_named_by_their_spectrum_growth_and_steps() -> None:
    rig = rig_of()
    plain, log = estimate_of(rig)
    shaken = 2e-3 * np.sin(2 * np.pi * 23.0 * plain.rows[0].time)[:, None]
    estimate, log = estimate_of(rig, disturbed=lambda t, w, felt: shaken * np.ones(6))
    estimate = replace(estimate, noise=((FoundNoise("force", 7.0),),))
    noise, vibration = findings(estimate, rig, [log])
    assert noise.what.startswith("vibration, noise: ")
    assert noise.evidence == "noise of the forces is 7 x the stated"
    assert "0.2% of range at 23 Hz" in vibration.evidence
    rate = np.gradient(plain.rows[0].wrench / SPAN, plain.rows[0].time, axis=0)
    stamps = 2e-3 * np.random.default_rng(1).standard_normal((1500, 1))
    estimate, log = estimate_of(rig, disturbed=lambda t, w, felt: stamps * rate)
    (jitter,) = findings(estimate, rig, [log])
    assert jitter.what.startswith("jitter")
    assert jitter.value == pytest.approx(2e-3, rel=0.3)
    twist = np.round(plain.rows[0].twist / 5e-3) * 5e-3
    found = findings(plain, rig, [replace(log, twist=twist)])
    assert any(told.what.startswith("resolution") for told in found)


def test_events_steps_noise_and_curvature_are_told_in_sentences() -> None:
    rig = rig_of(gravity=[0, 0, -9.81])
    estimate, log = estimate_of(rig)
    estimate = replace(
        estimate,
        events=(
            (
                Event(12.3, 13.1, 80, True, np.array([0.0, 0, 0.2, 0, 0, 0])),
                Event(1.0, 1.0, 1, False, np.ones(6)),
            ),
        ),
        steps=((Step(5.25, np.array([0, 0.009, 0, 0, 0, 0]), np.full(6, 1e-4)),),),
        quadratic=np.array([0, 0, 4e-3, 0, 0, 0]),
        tilts=(Tilt((0,), np.array([0.0, 9e-3]), np.full(2, 1e-4)),),
        noise=((FoundNoise("moment", 2.1), FoundNoise("force", 1.9)),),
    )
    told = {a.what.split(":")[0]: a.evidence for a in findings(estimate, rig, [log])}
    assert told == {
        "contact": "contact from 12.3 to 13.1 s left out, up to 20% of range on fz",
        "step": "the offset of fy steps by 0.9% of range at 5.25 s",
        "nonlinearity": "channel fz departs from linear by 0.4% of range",
        "gravity": "gravity is tilted by 0.516 +- 0.006 deg, 2.6 sigma of what the rig states",
        "noise": "noise of the moments is 2.1 x the stated",
    }
    assert judged(rig, estimate, log).verdict.usable  # words change no verdict


def test_what_is_assumed_names_its_kinds_from_the_list() -> None:
    rig = rig_of()
    estimate, log = estimate_of(rig, disturbed=lambda t, w, felt: play(felt, 2e-3))
    slow = (Slow("force", 1e-3, None, 0.3, 40.0, "walk", True),)
    event = Event(2.0, 2.1, 10, True, np.full(6, 2e-3))
    estimate = replace(estimate, slow=(slow,), events=((event,) * 12,), noise=((FoundNoise("force", 0.3),),))
    found = findings(estimate, rig, [log])
    assert len(found) > 10
    for told in found:
        named = told.what.split(":")[0].split(", ")
        assert 1 <= len(named) <= 3
        assert set(named) <= set(KINDS)
        assert len(set(named)) == len(named)


def test_what_a_record_could_not_have_shown_is_told_in_gains() -> None:
    rig = rig_of()
    estimate, _ = estimate_of(rig)
    (cable, *_) = blind_to(estimate, rig)
    assert cable.kind in KINDS
    assert cable.size == 1e-3
    A, inverse = estimate.A, np.linalg.inv(estimate.ww)
    assert cable.effect == pytest.approx(1e-3 * np.sqrt(A / (1 - A) * np.diag(inverse).max() / 6))
    w = np.stack([np.sin(2 * np.pi * estimate.rows[0].time + k) for k in range(6)], axis=1)
    one = replace(
        estimate, rows=(replace(estimate.rows[0], wrench=w * SPAN),), ww=w.T @ w / len(w) + 1e-9 * ONE, A=0.99
    )
    assert [blind.kind for blind in blind_to(one, rig)] == ["cable", "delay"]
