"""Gross set-up errors are recognised by the gain they leave, and healthy rigs are left alone."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from truewrench.rig import Rig
from truewrench.simulation.free_body import simulate
from truewrench.verdict.setup_errors import (
    Suspicion,
    parameters_off_their_priors,
    setup_errors_in_estimate,
    setup_errors_in_logs,
    suspected_setup_errors,
)
from truewrench.verdict.signed_axes import _same_trace

PRIOR, DEPARTURE, NOISE = 0.3, 0.15, 0.01
SPAN = np.array([500.0, 500, 500, 50, 50, 50])
CENTER = np.array([0.2, 0.0, 0.05])
ONE = np.eye(6)


def departed(rng: np.random.Generator) -> np.ndarray:
    return ONE + DEPARTURE * rng.standard_normal((6, 6))


def judged(gain: np.ndarray, rng: np.random.Generator, noise: float = NOISE) -> tuple[Suspicion, ...]:
    measured = gain + noise * rng.standard_normal(gain.shape)
    covariance = noise**2 * np.eye(36)
    return suspected_setup_errors(
        measured, covariance, ONE, PRIOR, SPAN, SPAN, centers_of_mass=[CENTER], prior_in_estimate=False
    )


def in_normalised(si: np.ndarray) -> np.ndarray:
    return si * SPAN / SPAN[:, None]


def nearest_to_correct() -> list[np.ndarray]:
    """All signed permutations next to the identity: one sign, or two axes swapped with any signs."""
    found = []
    for i in range(6):
        found.append(np.diag(np.where(np.arange(6) == i, -1.0, 1.0)))
    for i, j in itertools.combinations(range(6), 2):
        for a, b in itertools.product((1.0, -1.0), repeat=2):
            swapped = ONE.copy()
            swapped[[i, j]] = 0.0
            swapped[i, j], swapped[j, i] = a, b
            found.append(swapped)
    return found


def test_healthy_rigs_raise_no_suspicion() -> None:
    rng = np.random.default_rng(0)
    assert not any(judged(departed(rng), rng) for _ in range(30))


@pytest.mark.parametrize("factor", [1000.0, 9.81, 4.448, 57.3, 0.001])
@pytest.mark.parametrize("where", ["all axes", "forces", "moments"])
@pytest.mark.parametrize("side", ["channels", "axes"])
def test_named_scales_are_found_where_they_act(factor: float, where: str, side: str) -> None:
    rng = np.random.default_rng(1)
    scale = np.diag(
        {"all axes": [factor] * 6, "forces": [factor] * 3 + [1.0] * 3, "moments": [1.0] * 3 + [factor] * 3}[
            where
        ]
    )
    gain = scale @ departed(rng) if side == "channels" else departed(rng) @ scale
    found = judged(gain, rng, noise=1e-5)
    assert found
    assert found[0].kind == "scale"
    assert where in found[0].words
    size = f"{factor:.3g} times too large" if factor > 1 else f"{1 / factor:.3g} times too small"
    assert size.split(" ", 1)[1] in found[0].words
    assert found[0].log_odds > 20


def test_permutations_next_to_the_identity_are_found() -> None:
    rng = np.random.default_rng(2)
    for signed in nearest_to_correct()[::2]:
        found = judged(signed @ departed(rng), rng)
        assert found, signed
        assert found[0].kind == "axes"


@pytest.mark.parametrize("units", ["normalised", "SI"])
@pytest.mark.parametrize("side", ["channels", "axes"])
def test_any_signed_permutation_is_found(units: str, side: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(12):
        signed = np.zeros((6, 6))
        signed[np.arange(6), rng.permutation(6)] = rng.choice([-1.0, 1.0], 6)
        if np.array_equal(signed, ONE):
            continue
        T = in_normalised(signed) if units == "SI" else signed
        found = judged(T @ departed(rng) if side == "channels" else departed(rng) @ T, rng)
        assert found, signed
        assert found[0].kind == "axes"


@pytest.mark.parametrize(
    ("T", "words"),
    [
        (-ONE, "wrong sign of the whole wrench"),
        (np.diag([-1.0, -1, -1, 1, 1, 1]), "wrong sign of all forces"),
        (np.diag([1.0, 1, 1, 1, 1, -1]), "wrong sign of mz"),
        (ONE[[1, 0, 2, 3, 4, 5]], "fx and fy swapped"),
        (np.kron(np.eye(2), [[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), "axes turned (fx holds -fy, fy holds fx"),
        (np.kron(np.eye(2), [[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]), "axes mirrored"),
        (-4.448 * ONE, "all axes 4.448 times too large (N for lbf), and of the wrong sign"),
    ],
)
def test_what_is_wrong_is_said_in_words_with_its_odds(T: np.ndarray, words: str) -> None:
    rng = np.random.default_rng(4)
    found = judged(T @ departed(rng), rng)
    assert words in found[0].words
    assert "posterior odds" in found[0].words


def test_wrong_units_of_inertia_are_told_from_those_of_moments() -> None:
    # n = c x f + n_c with n_c stated 1e4 times too large: raw = C [f; c x f + (n - c x f) / 1e4]
    rng = np.random.default_rng(5)
    x, y, z = CENTER
    lever = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.block([[np.eye(3), np.zeros((3, 3))], [(1 - 1e-4) * lever, 1e-4 * np.eye(3)]])
    found = judged(departed(rng) @ in_normalised(T), rng, noise=1e-6)
    assert found[0].kind == "payload"
    assert "kg cm^2 for kg m^2" in found[0].words


@pytest.mark.parametrize("factor", [1.05, 0.9])
def test_misread_mass_shows_where_the_gain_prior_is_tight(factor: float) -> None:
    rng = np.random.default_rng(6)
    x, y, z = CENTER
    lever = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.block([[factor * np.eye(3), np.zeros((3, 3))], [(factor - 1) * lever, np.eye(3)]])
    gain = (ONE + 0.01 * rng.standard_normal((6, 6))) @ in_normalised(T)
    tight = suspected_setup_errors(gain, 1e-6 * np.eye(36), ONE, 0.01, SPAN, SPAN, centers_of_mass=[CENTER])
    assert "mass of the payload" in tight[0].words
    assert not judged(departed(rng) @ in_normalised(T), rng)  # a sensor that may be off by 30% may be off so


def test_a_gain_that_nothing_explains_is_still_refused() -> None:
    rng = np.random.default_rng(7)
    found = judged(2.5 * rng.standard_normal((6, 6)), rng)
    assert found[0].kind == "departure"


def test_pull_of_the_prior_is_taken_out_before_judging() -> None:
    # an estimate half-way between -1 and the prior's 1, as uncertain as such a pull says
    rng = np.random.default_rng(8)
    data = 0.1  # 1 sigma of the data alone
    share = PRIOR**2 / (PRIOR**2 + data**2)
    seen = -departed(rng) + data * rng.standard_normal((6, 6))
    covariance = share * data**2 * np.eye(36)
    found = suspected_setup_errors(ONE + share * (seen - ONE), covariance, ONE, PRIOR, SPAN, SPAN)
    assert "whole wrench" in found[0].words


def test_directions_that_the_data_did_not_see_accuse_nobody() -> None:
    nothing = suspected_setup_errors(ONE, PRIOR**2 * np.eye(36), ONE, PRIOR, SPAN, SPAN)
    assert nothing == ()
    # forces seen as negative, moments at their prior
    rng = np.random.default_rng(9)
    seen = np.tile([True] * 3 + [False] * 3, 6)
    gain = np.where(seen.reshape(6, 6), -departed(rng), ONE)
    found = suspected_setup_errors(gain, np.diag(np.where(seen, 1e-4, PRIOR**2)), ONE, PRIOR, SPAN, SPAN)
    assert any("whole wrench" in s.words or "all forces" in s.words for s in found)


def test_more_channels_than_axes_are_judged_by_their_nominal_gain() -> None:
    rng = np.random.default_rng(10)
    nominal = rng.standard_normal((8, 6))
    scale = np.abs(nominal).sum(axis=1)
    nominal = nominal / scale[:, None]
    prior = 0.02
    gain = nominal + 0.01 * rng.standard_normal((8, 6))
    common = {
        "covariance": 1e-8 * np.eye(48),
        "nominal": nominal,
        "prior": prior,
        "span": SPAN,
        "channel_scale": scale,
    }
    assert suspected_setup_errors(gain, **common) == ()
    assert "whole wrench" in suspected_setup_errors(-gain, **common)[0].words
    swapped = suspected_setup_errors(gain[:, [1, 0, 2, 3, 4, 5]], **common)
    assert "fx and fy swapped" in swapped[0].words
    assert "1000 times too small" in suspected_setup_errors(1e-3 * gain, **common)[0].words


def test_all_signed_permutations_are_counted() -> None:
    assert sum(_same_trace().values()) == 46_080
    assert _same_trace()[6] == 1
    assert _same_trace()[4] == len(nearest_to_correct())


def test_parameters_beyond_three_sigma_are_named() -> None:
    found = parameters_off_their_priors(
        ["mass of payload `tool`", "time offset of run.csv", "inertia xx"],
        np.array([0.05, -0.02, 1.0]),
        np.array([0.01, 0.01, 0.0]),
    )
    assert len(found) == 1
    assert found[0].kind == "parameter"
    assert "mass of payload `tool` is 5.0 sigma from what the rig states" in found[0].words


SETTINGS: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.1, 0.1, 0.1, 0.01, 0.01, 0.01],
        "range": [500, 500, 500, 50, 50, 50],
    },
    "payloads": {
        "default": {"mass": 50, "center_of_mass": [0.2, 0, 0], "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4}}
    },
    "motion": {"noise": [1e-4] * 6},
    "simulate": {"rate": 100, "sensor_rate": 100},
    "plan": {"duration": 5},
}


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (1.0, None),
        (1e-3, "all axes 1000 times too small (kN for N"),
        (-1.0, "wrong sign of the whole wrench"),
    ],
)
def test_plain_least_squares_recognise_a_log_that_no_estimator_fits(scale: float, words: str | None) -> None:
    rng = np.random.default_rng(11)
    gain = scale * (ONE + DEPARTURE * rng.standard_normal((6, 6))) * SPAN[:, None] / SPAN
    rig = Rig.from_mapping({**SETTINGS, "simulate": {"gain": gain.tolist(), "sensor_rate": 160}})
    log = simulate(rig).log
    found = setup_errors_in_logs(rig, [log])
    assert (found == ()) if words is None else (words in found[0].words)
    assert setup_errors_in_logs(rig, [replace(log, twist=np.full_like(log.raw, np.nan))]) == ()


def test_si_gains_are_judged_in_units_of_range() -> None:
    rng = np.random.default_rng(12)
    rig = Rig.from_mapping(SETTINGS)
    log = simulate(rig).log
    gain = departed(rng) * SPAN[:, None] / SPAN
    covariance = np.diag(np.append(np.outer(SPAN, 1 / SPAN).ravel() ** 2 * 1e-6, np.ones(6)))
    assert setup_errors_in_estimate(rig, [log], gain, covariance) == ()
    assert (
        "all moments"
        in setup_errors_in_estimate(rig, [log], gain * [1, 1, 1, -1, -1, -1], covariance)[0].words
    )
