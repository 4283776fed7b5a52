"""Errors that last, against dense matrices written here: whitening, restricted likelihood, plateaus."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from truewrench.estimation.lasting_errors import (
    Chain,
    ErrorSize,
    find_sizes,
    predicted,
    spread_of_sizes,
    whitened,
)
from truewrench.estimation.plateaus import is_stepped, plateaus

Array = NDArray[np.float64]

PLACES = 60
SECOND = 25  # place at which the second log begins


@pytest.fixture
def draw() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def stamps(draw: np.random.Generator) -> Array:
    """Of two logs, at no rate."""
    return np.cumsum(draw.uniform(0.01, 0.5, PLACES))


@pytest.fixture
def chain(stamps: Array, draw: np.random.Generator) -> Chain:
    step = np.diff(stamps, prepend=stamps[0])
    step[[0, SECOND]] = np.inf
    return Chain(step, draw.integers(1, 6, PLACES).astype(np.float64), 0.1, 20.0)


def kernel(stamps: Array, time: float) -> Array:
    second = np.arange(len(stamps)) >= SECOND
    K = np.exp(-np.abs(stamps[:, None] - stamps) / time) if time else np.eye(len(stamps))
    return np.asarray(K * (second[:, None] == second))


def dense(chain: Chain, stamps: Array, size: ErrorSize) -> Array:
    return np.asarray(np.diag(size.white / chain.count) + size.lasting * kernel(stamps, size.time))


SIZES = [
    ErrorSize(0.7, 2.0, 1.3),
    ErrorSize(1e-6, 1.0, 5.0),
    ErrorSize(2.0, 0.0, 0.0),
    ErrorSize(1.0, 3.0, 0.0),
]


@pytest.mark.parametrize("size", SIZES)
def test_whitened_errors_have_the_covariance_of_a_dense_matrix(
    chain: Chain, stamps: Array, size: ErrorSize
) -> None:
    T = dense(chain, stamps, size)
    E, log_det = whitened(chain, size, np.eye(PLACES))
    np.testing.assert_allclose(E.T @ E @ T, np.eye(PLACES), atol=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(T)[1], abs=1e-9)


@pytest.mark.parametrize("size", [SIZES[0], SIZES[3]])
def test_what_lasts_is_predicted_as_by_a_dense_conditional(
    chain: Chain, stamps: Array, size: ErrorSize, draw: np.random.Generator
) -> None:
    x, known = draw.normal(size=PLACES), draw.random(PLACES) < 0.8
    mean, variance = predicted(chain, size, x, known)
    T, K = dense(chain, stamps, size), size.lasting * kernel(stamps, size.time)
    for k in range(0, PLACES, 7):
        others = known.copy()
        others[k] = False
        gain = np.linalg.solve(T[np.ix_(others, others)], K[others, k])
        assert mean[k] == pytest.approx(gain @ x[others], abs=1e-9)
        assert variance[k] == pytest.approx(K[k, k] - gain @ K[others, k], abs=1e-9)


def restricted(T: Array, Z: Array, y: Array, within: float, spare: int, white: float) -> float:
    """-2 log restricted likelihood, written out."""
    V = np.linalg.inv(T)
    A = Z.T @ V @ Z
    left = y @ V @ y - y @ V @ Z @ np.linalg.solve(A, Z.T @ V @ y)
    determinants = np.linalg.slogdet(T)[1] + np.linalg.slogdet(A)[1]
    return float(determinants + left + spare * np.log(white) + within / white)


def test_sizes_are_where_a_dense_restricted_likelihood_is_largest(
    chain: Chain, stamps: Array, draw: np.random.Generator
) -> None:
    truth = ErrorSize(1.0, 4.0, 1.5)
    Z = np.column_stack([draw.normal(size=(PLACES, 3)), np.ones(PLACES)])
    y = np.linalg.cholesky(dense(chain, stamps, truth)) @ draw.normal(size=PLACES)
    within = float(draw.chisquare(chain.spare))

    def value(size: ErrorSize) -> float:
        return restricted(dense(chain, stamps, size), Z, y, within, chain.spare, size.white)

    (found,), fall, lasting = find_sizes(chain, Z, y[:, None], np.array([within]))
    best = minimize(lambda u: value(ErrorSize(*np.exp(u))), [0.0, 1.0, 0.0], method="Nelder-Mead")
    assert value(found) == pytest.approx(best.fun, abs=0.05)
    np.testing.assert_allclose(np.log([found.white, found.lasting, found.time]), best.x, atol=0.2)
    assert fall[0] == pytest.approx(value(ErrorSize()) - value(found), abs=0.01)
    white = minimize(lambda u: value(ErrorSize(float(np.exp(u[0])))), [0.0], method="Nelder-Mead")
    assert lasting[0] == pytest.approx(white.fun - value(found), abs=0.01)


def test_too_few_places_tell_nothing() -> None:
    chain = Chain(np.array([np.inf, 1.0, 1.0, 1.0]), np.ones(4), 0.5, 8.0)
    Z = np.column_stack([np.arange(4.0), np.ones(4)])
    sizes, fall, _ = find_sizes(chain, Z, 100.0 * np.ones((4, 2)), np.zeros(2))
    assert sizes == [ErrorSize(), ErrorSize()]
    assert not fall.any()


def test_white_noise_as_stated_is_rarely_taken_for_more() -> None:
    """-2 log L falls by less than a chi-square of 2 a channel, and of 1 because something lasts."""
    chain = Chain(np.append(np.inf, np.ones(79)), np.ones(80), 0.5, 160.0)
    falls, lasting = [], []
    for seed in range(40):
        draw = np.random.default_rng([seed, 1])
        Z = np.column_stack([draw.normal(size=(80, 6)), np.ones(80)])
        _, fall, last = find_sizes(chain, Z, draw.normal(size=(80, 6)), np.zeros(6))
        falls.append(fall.sum())
        lasting.append(last.sum())
    assert np.mean(falls) < 12.5  # chi-square of 12
    assert np.mean(lasting) < 6.5
    assert min(lasting) >= 0.0


def test_the_spread_of_sizes_widens_what_few_plateaus_tell(draw: np.random.Generator) -> None:
    """Of 12 plateaus with 4 parameters, and of 120."""
    widened = []
    for places in (12, 120):
        chain = Chain(np.append(np.inf, np.full(places - 1, 2.0)), np.full(places, 50.0), 0.3, 4.0 * places)
        Z = np.column_stack([draw.normal(size=(places, 3)), np.ones(places)])
        y = 3.0 * draw.normal(size=places)
        within = float(draw.chisquare(chain.spare))
        (size,), _, _ = find_sizes(chain, Z, y[:, None], np.array([within]))
        E, _ = whitened(chain, size, Z)
        alone = np.linalg.inv(E.T @ E)
        y -= Z @ alone @ E.T @ whitened(chain, size, y[:, None])[0][:, 0]
        spread = spread_of_sizes(chain, Z, y, within, size, np.zeros((4, 4)))
        assert np.linalg.eigvalsh(spread.covariance).min() >= -1e-12
        widened.append(float(np.trace(spread.covariance) / np.trace(alone)))
    assert widened[0] > 2.0 * widened[1]
    assert widened[1] < 0.2


def held(rate: float, ramp: float = 0.0, seconds: float = 2.0, loads: int = 6) -> tuple[Array, Array]:
    """Times, and loads of 0 to 0.5 in one axis, with a way of `ramp` seconds to the next."""
    time = np.arange(round(seconds * loads * rate)) / rate
    values = np.random.default_rng(3).uniform(-0.5, 0.5, (loads + 1, 6))
    load = np.minimum((time / seconds).astype(int), loads - 1)
    way = np.clip((time - seconds * load) / ramp, 0.0, 1.0)[:, None] if ramp else np.zeros((time.size, 1))
    return time, values[load] * (1.0 - way) + values[load + 1] * way


@pytest.mark.parametrize("rate", [1.5, 10.0, 100.0])
@pytest.mark.parametrize("ramp", [0.0, 0.7])
def test_loads_that_are_held_are_plateaus(rate: float, ramp: float) -> None:
    time, wrench = held(rate, ramp)
    noisy = wrench + 1e-3 * np.random.default_rng(1).normal(size=wrench.shape)
    found = plateaus(time, noisy, np.full(6, 1e-3))
    assert is_stepped(found)
    still = np.all(wrench == wrench[np.minimum(np.arange(time.size) + 1, time.size - 1)], axis=1)
    for k in np.unique(found[found >= 0]):
        assert (
            np.ptp(wrench[found == k], axis=0).max() < 2e-2
        )  # the first rows of a way, which a window bears
    if rate > 2.0:
        assert np.unique(found[found >= 0]).size == 6
        assert np.mean(found[still] >= 0) > 0.9


@pytest.mark.parametrize("step", [6.0, 10.0, 30.0])
@pytest.mark.parametrize("pause", [0.0, 10.0])
def test_a_step_of_a_few_sigma_ends_a_plateau(step: float, pause: float) -> None:
    """Its first row is one of fifty in a window, and moves neither half nor scatter."""
    time = np.concatenate([np.arange(400) / 100.0, 4.0 + pause + np.arange(400) / 100.0])
    reference = np.zeros((800, 6))
    reference[400:, 0] = step
    found = plateaus(time, reference, np.ones(6))
    assert np.unique(found[:390]).size == np.unique(found[410:]).size == 1
    assert found[0] >= 0
    assert found[-1] > found[0]


def test_what_moves_is_no_plateau() -> None:
    draw = np.random.default_rng(1)
    time = np.arange(3000) / 100.0
    for period in (1.0, 10.0, 100.0):  # the last one moves by less than its noise in half a second
        wave = 0.3 * np.sin(2 * np.pi * time[:, None] / period + np.arange(6))
        found = plateaus(time, wave + 1e-2 * draw.normal(size=wave.shape), np.full(6, 1e-2))
        assert not is_stepped(found)
    weights = 0.5 * draw.uniform(-1, 1, (40, 6))
    assert not is_stepped(plateaus(30.0 * np.arange(40), weights, np.full(6, 1e-3)))
    twice = np.repeat(weights, 2, axis=0)
    assert is_stepped(plateaus(30.0 * np.arange(80), twice, np.full(6, 1e-3)))
    assert not is_stepped(plateaus(np.zeros(1), weights[:1], np.full(6, 1e-3)))
