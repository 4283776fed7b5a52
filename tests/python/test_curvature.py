"""The uncertainty of a gain beyond the first order, against a posterior whose curve is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import eigh

from truewrench.estimate.curvature import Curvature, enlarged
from truewrench.estimate.sources import Sources

Array = NDArray[np.float64]

MASS, CENTER = 50.0, np.array([0.2, -0.05, 0.1])
INERTIA = np.array([[1.5, 0.1, -0.05], [0.1, 1.2, 0.02], [-0.05, 0.02, 0.6]])
RANGE = np.array([1500.0, 1500.0, 1500.0, 300.0, 300.0, 300.0])
GRAVITY = np.array([2.0, -3.0, -9.0])
UNCERTAINTY = np.array([0.01] + [0.002] * 3 + [0.05] * 6)
ELEMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
TAILS = 2.25  # (4.2 / 2.8)^2: what 0.5% of products of two normal deviates, and of one deviate, exceed


def cross(x: Array) -> Array:
    zero = np.zeros_like(x[..., 0])
    a, b, c = np.moveaxis(x, -1, 0)
    return np.stack([zero, -c, b, c, zero, -a, -b, a, zero], axis=-1).reshape(*x.shape[:-1], 3, 3)


def affine_wrench(p: Array) -> Array:
    """(..., 7, 7): [w; 1] by [a; 1] of a body that accelerates from rest in constant gravity."""
    mass = MASS * (1.0 + p[..., 0, None, None])
    center = CENTER + p[..., 1:4]
    inertia = np.broadcast_to(INERTIA, (*p.shape[:-1], 3, 3)).copy()
    for k, (i, j) in enumerate(ELEMENTS):
        inertia[..., i, j] += p[..., 4 + k] * np.sqrt(INERTIA[i, i] * INERTIA[j, j])
        inertia[..., j, i] = inertia[..., i, j]
    out = np.zeros((*p.shape[:-1], 7, 7))
    lever = cross(center)
    out[..., :3, :3] = -mass * np.eye(3)
    out[..., :3, 3:6] = mass * cross(p[..., 1:4])  # alpha x (c - c_stated), the point that is logged
    out[..., :3, 6] = mass[..., 0] * GRAVITY
    out[..., 3:6, :] = lever @ out[..., :3, :]
    out[..., 3:6, 3:6] -= inertia
    out[..., :6, :] /= RANGE[:, None]
    out[..., 6, 6] = 1.0
    return out


def bent(product: Array, p: Array) -> Array:
    """[C b] (..., n, 7) of what the data fix, [C b] T(p), and the payload."""
    return np.asarray(product @ np.linalg.inv(affine_wrench(p) @ np.linalg.inv(affine_wrench(np.zeros(10)))))


def flat(X: Array) -> Array:
    """Gain row by row, then the offset."""
    return np.concatenate([X[..., :6].reshape(*X.shape[:-2], -1), X[..., 6]], axis=-1)


class Posterior:
    """Normal in ([C b] T(p), p), with gains known to 1e-4 but for one direction: the truth of these tests."""

    def __init__(self, channels: int, seed: int = 0, uncertainty: Array = UNCERTAINTY) -> None:
        rng = np.random.default_rng(seed)
        self.n = channels
        C = np.vstack([np.eye(6), np.eye(6)])[:channels] + 0.2 * rng.standard_normal((channels, 6))
        self.X = np.column_stack([C, 0.1 * rng.standard_normal(channels)])
        size = 7 * channels
        sigma = np.append(0.05, np.full(size - 1, 1e-4))
        self.root = np.linalg.qr(rng.standard_normal((size, size)))[0] * sigma
        self.sigma = uncertainty
        # first order, by central differences of the exact curve
        step = 1e-5
        by_product = [
            (self.at(step * e, np.zeros(10)) - self.at(-step * e, np.zeros(10))) / (2.0 * step)
            for e in np.eye(size)
        ]
        by_payload = [
            (self.at(np.zeros(size), step * e) - self.at(np.zeros(size), -step * e)) / (2.0 * step)
            for e in np.eye(10)
        ]
        whole = np.block(
            [
                [np.array(by_product).T @ self.root, np.array(by_payload).T * self.sigma],
                [np.zeros((10, size)), np.diag(self.sigma)],
            ]
        )
        self.covariance = whole @ whole.T

    def at(self, product: Array, p: Array) -> Array:
        return flat(bent(self.X + product.reshape(*product.shape[:-1], self.n, 7), p))

    def draw(self, count: int) -> Array:
        """Departures of gain and offset from the estimate (count, 7n)."""
        rng = np.random.default_rng(1)
        product = rng.standard_normal((count, 7 * self.n)) @ self.root.T
        p = rng.standard_normal((count, 10)) * self.sigma
        return self.at(product, p) - flat(self.X)

    def curvature(self) -> Curvature:
        return Curvature.of(self.X[:, :6], self.covariance, MASS, MASS, INERTIA)


@pytest.mark.parametrize("channels", [6, 8])
@pytest.mark.parametrize(
    ("uncertainty", "too_small", "low", "high"),
    [(0.3 * UNCERTAINTY, 10.0, 0.88, 1.12), (UNCERTAINTY, 500.0, 0.75, 1.4)],  # at last fourth orders count
)
def test_covariance_with_the_second_moment_is_that_of_draws_from_the_curve(
    channels: int, uncertainty: Array, too_small: float, low: float, high: float
) -> None:
    posterior = Posterior(channels, uncertainty=uncertainty)
    drawn = posterior.draw(40_000)
    exact = drawn.T @ drawn / len(drawn)
    first = posterior.covariance[: 7 * channels, : 7 * channels]
    second = first + posterior.curvature().second_moment() / TAILS
    assert eigh(exact, first, eigvals_only=True)[-1] > too_small
    ratios = eigh(exact, second, eigvals_only=True)
    assert low < ratios.min() < ratios.max() < high


def test_errors_are_as_large_as_the_covariance_says_and_hardly_one_is_beyond_chance() -> None:
    posterior = Posterior(6, uncertainty=0.3 * UNCERTAINTY)
    drawn = posterior.draw(2_000)[:, :36]
    first = posterior.covariance[:36, :36]
    second = first + posterior.curvature().second_moment()[:36, :36]
    before, after = (
        np.einsum("ki,ki->k", drawn, np.linalg.solve(P, drawn.T).T) / 36 for P in (first, second)
    )
    assert before.mean() > 1.5
    assert 0.75 < after.mean() < 1.02
    beyond = 2.93  # 1e-8 of chi-square
    assert np.mean(before > beyond) > 0.2
    assert np.mean(after > beyond) < 0.002  # products of normal deviates have long tails


def test_mass_alone_bends_the_gain_as_its_inverse_does() -> None:
    sigma, C = 0.03, np.eye(6) + 0.1 * np.random.default_rng(2).standard_normal((6, 6))
    gain = 1e-4
    covariance = np.zeros((46, 46))
    covariance[:36, :36] = gain**2 * np.eye(36) + sigma**2 * np.outer(C, C)
    covariance[:36, 36] = covariance[36, :36] = -(sigma**2) * C.ravel()
    covariance[36:, 36:] = np.diag(np.append(sigma, np.full(9, 1e-9)) ** 2)
    found = Curvature.of(C, covariance, MASS, MASS, INERTIA).second_moment() / TAILS
    # brute force: (C + g) / (1 + m) - (C + g - C m) = C m^2 / (1 + m) - g m / (1 + m)
    m = sigma * np.linspace(-8.0, 8.0, 4001)
    weight = np.exp(-0.5 * (m / sigma) ** 2)
    weight /= weight.sum()
    along, across = weight @ (m**2 / (1 + m)) ** 2, weight @ (m / (1 + m)) ** 2
    expected = along * np.outer(C, C) + across * gain**2 * np.eye(36)
    np.testing.assert_allclose(np.diag(found), np.diag(expected), rtol=0.03)
    values = np.linalg.eigvalsh(found)
    np.testing.assert_allclose(values[:-1], across * gain**2, rtol=0.03)


def test_nothing_is_added_for_an_exact_payload() -> None:
    posterior = Posterior(6, uncertainty=np.full(10, 1e-9))
    assert np.abs(posterior.curvature().second_moment()).max() < 1e-16


def test_covariance_never_gets_smaller() -> None:
    for seed in range(5):
        moment = Posterior(6, seed).curvature().second_moment()
        np.testing.assert_array_equal(moment, moment.T)
        assert np.linalg.eigvalsh(moment)[0] > -1e-12 * np.linalg.norm(moment, 2)


def test_what_a_source_adds_alone_grows_with_the_fourth_power_of_its_sigma() -> None:
    small, large = (Posterior(6, uncertainty=s * UNCERTAINTY).curvature() for s in (1.0, 2.0))
    for source in ([0], [1, 2, 3], [4, 5, 6, 7, 8, 9]):
        np.testing.assert_allclose(large.alone(source), 16.0 * small.alone(source), rtol=1e-3, atol=1e-12)
    gains = np.diag(small.alone(range(10)))[:36]
    assert (gains < np.diag(small.second_moment())[:36] * 1.0001).all()


def test_moment_of_two_payloads_is_smaller_than_neither() -> None:
    rng = np.random.default_rng(3)
    first, other = (x @ x.T for x in rng.standard_normal((2, 8, 3)))
    both = enlarged(first, other[:5, :5], np.ones(5))
    assert np.linalg.eigvalsh(both - first)[0] > -1e-12
    assert np.linalg.eigvalsh(both[:5, :5] - other[:5, :5])[0] > -1e-12
    np.testing.assert_allclose(enlarged(first, first, np.ones(8)), first, atol=1e-12)
    apart = np.diag([1.0, 0.0]), np.diag([0.0, 4.0])
    np.testing.assert_allclose(enlarged(*apart, np.ones(2)), np.diag([1.0, 4.0]), atol=1e-12)


def test_sources_and_remedy_know_of_what_the_payload_adds() -> None:
    extra = np.full(6, 0.03**2)
    plain = Sources.of(np.diag([1e-4] * 6 + [1.0]), 6, {"mass": [6]}, np.ones(7), 0.3)
    found = replace(plain, bent=extra, bent_alone={"mass": extra})
    np.testing.assert_allclose(found.sigma()["mass"], 0.03)
    # 0.01 of noise stays; the rest of 0.02 is left to the payload
    factor = found.remedy(np.ones(6, dtype=bool), 0.02)["mass"]
    assert factor == pytest.approx(np.sqrt(0.02**2 - 0.01**2) / 0.03, rel=1e-3)
