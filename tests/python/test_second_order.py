"""Gain and body bend: estimates lie in the middle of the posterior, which sampling the body finds here."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from tool_cases import a_rig, pose_log, tensor_of

from truewrench import _core
from truewrench.estimation.estimator import estimate
from truewrench.estimation.static_poses import split_poses
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.simulation.free_body import simulate
from truewrench.tool.model_rows import Problem
from truewrench.tool.prior import make_prior
from truewrench.tool.solve import solve

Array = NDArray[np.float64]

P0 = 0.2  # 1 sigma of a gain
MASS, CENTER = 3.0, np.array([0.02, -0.03, 0.08])
INERTIA = np.array([0.02, 0.03, 0.012, 0.002, -0.001, 0.003])
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
STD = np.array([0.04, *[0.002] * 3, *(0.04 * np.sqrt(INERTIA[i] * INERTIA[j]) for i, j in PAIRS)])
SPAN = np.array([40.0, 40.0, 40.0, 4.0, 4.0, 4.0])


def spatial(b: Array) -> Array:
    """Wrench at the sensor of the body (log m, c, I) by the acceleration there."""
    m, (x, y, z), inertia = np.exp(b[0]), b[1:4], tensor_of(b[4:])
    lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.zeros((6, 6))
    out[:3, :3], out[:3, 3:], out[3:, :3] = m * np.eye(3), -m * lever, m * lever
    out[3:, 3:] = inertia - m * lever @ lever
    return out


def integrated(log_p: Callable[[Array], float], middle: Array, P: Array, count: int) -> tuple[Array, Array]:
    """Mean and 1 sigma of a density that is near N(middle, P), by weighted samples of a wider one."""
    u = np.random.default_rng(1).normal(size=(count, middle.size))
    b = middle + 1.2 * u @ np.linalg.cholesky(P).T
    log_w = np.array([log_p(x) for x in b]) + 0.5 * (u**2).sum(axis=1)
    w = np.exp(log_w - log_w.max())
    w /= w.sum()
    assert 1.0 / (w**2).sum() > 0.1 * count
    mean = w @ b
    return mean, np.sqrt(w @ (b - mean) ** 2)


def test_what_another_body_feels_is_the_derivative_of_its_spatial_inertia() -> None:
    b = np.concatenate([[np.log(MASS)], CENTER, INERTIA])
    L = _core.body_changes(_core.Payload(MASS, CENTER, tensor_of(INERTIA)))
    for k, step in enumerate(1e-6 * np.eye(10)):
        by = (spatial(b + step) - spatial(b - step)) / 2e-6
        np.testing.assert_allclose(L[k], by @ np.linalg.inv(spatial(b)), atol=1e-6 * np.abs(L[k]).max())


def test_a_calibration_whose_body_is_in_doubt_is_moved_to_the_middle_of_its_posterior() -> None:
    """Of exact data K = C M(b): 36 numbers of 46."""
    rng = np.random.default_rng(3)
    b0 = np.concatenate([[np.log(MASS)], CENTER, INERTIA])
    C = np.eye(6) + P0 * rng.normal(size=(6, 6))
    normal = SPAN[:, None]  # C here takes wrenches in fractions of range
    K = C @ (spatial(b0 + STD * rng.normal(size=10)) / normal)
    tight = 1e-4 * np.abs(K).max()

    def residuals(theta: Array) -> Array:
        gap = theta[:36].reshape(6, 6) @ (spatial(theta[36:]) / normal) - K
        return np.concatenate(
            [(gap / tight).ravel(), (theta[:36] - np.eye(6).ravel()) / P0, (theta[36:] - b0) / STD]
        )

    found = least_squares(residuals, np.append(C.ravel(), b0), x_scale="jac", xtol=1e-12)
    J, theta = np.asarray(found.jac), found.x
    P = np.linalg.inv(J.T @ J)
    felt = spatial(theta[36:]) @ spatial(theta[36:]).T
    body = _core.Payload(float(np.exp(theta[36])), theta[37:40], tensor_of(theta[40:]))
    carried = _core.Carried(list(range(36, 46)), body, felt)
    moved = theta + _core.to_the_middle(P, np.full(36, P0**2), SPAN, [carried])

    def log_p(b: Array) -> float:
        M = spatial(b) / normal
        away = (np.linalg.solve(M.T, K.T).T - np.eye(6)) / P0
        return float(
            -0.5 * (away**2).sum() - 6.0 * np.linalg.slogdet(M)[1] - 0.5 * (((b - b0) / STD) ** 2).sum()
        )

    mean, sigma = integrated(log_p, moved[36:], P[36:, 36:], 40_000)
    assert np.abs((theta[36:] - mean) / sigma).max() > 0.4
    assert np.abs((moved[36:] - mean) / sigma).max() < 0.12


@pytest.mark.parametrize("gain_prior", [0.02, 0.06])
def test_a_tool_from_poses_is_the_middle_of_its_posterior(gain_prior: float) -> None:
    rig = tool_rig(a_rig(sensor={"gain_prior": gain_prior, "time_offset_prior": 0}))
    rng, span = np.random.default_rng(5), rig.sensor.range_array
    gain = np.eye(6) + gain_prior * rng.normal(size=(6, 6)) * np.outer(span, 1.0 / span)
    log, _ = pose_log(rig, 1.5, np.array([0.02, -0.01, 0.09]), gain=gain, seed=5)
    prior = make_prior(rig, rig, mounting_sigma=0.0, tilt_sigma=0.0)
    split = split_poses(rig, [log])
    problem, walk, own = Problem(rig, prior, split.poses, split.end_ns), 1e-4, 1e-5
    found = solve(problem, None, np.log([walk, own]))
    body = np.r_[found.problem.vector.layout.log_mass, found.problem.vector.layout.center_of_mass]

    t = log.time_ns * 1e-9
    away = t[-1] - t
    noise, offset = rig.sensor.noise_array, rig.sensor.offset_prior_array
    fall = split.poses.R_sensor_root @ rig.gravity_array

    def log_p(b: Array) -> float:
        weight = rig.sensor.sign * np.exp(b[0]) * np.column_stack([fall, np.cross(b[1:], fall)])
        total = -0.5 * (((b - prior.mean[body]) ** 2) / np.diag(prior.covariance)[body]).sum()
        for i in range(6):
            sigma = gain_prior * span[i] / span
            V = (weight * sigma**2) @ weight.T + offset[i] ** 2
            V += (walk * span[i]) ** 2 * np.minimum.outer(away, away)
            V += (noise[i] ** 2 + (own * span[i]) ** 2) * np.eye(t.size)
            L = np.linalg.cholesky(V)
            z = np.linalg.solve(L, log.raw[:, i] - weight[:, i])
            total += float(-0.5 * z @ z - np.log(np.diag(L)).sum())
        return float(total)

    mean, sigma = integrated(log_p, found.x[body], found.covariance[np.ix_(body, body)], 3000)
    assert np.abs((found.x[body] - mean) / sigma).max() < 0.2
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance))[body], sigma, rtol=0.08)


def test_the_scale_of_gains_is_no_smaller_than_the_truth_where_the_mass_is_in_doubt(
    settings: dict[str, Any],
) -> None:
    """The likeliest gain and body together lie a sigma low, in mean, where the mass is known to 5%."""
    stated = deepcopy(settings)
    stated["sensor"] |= {"gain_prior": 0.3, "discrepancy": 0, "time_offset_prior": 0}
    stated["payloads"]["default"]["uncertainty"] = {"mass": 0.05, "center_of_mass": 0.002, "inertia": 0.05}
    stated["plan"] = {"duration": 10}
    stated["simulate"] = {"rate": 100, "gain": "random", "payload": "random"}
    rig = Rig.from_mapping(stated)
    units = (rig.sensor.range_array / rig.sensor.channel_scale[:, None]).ravel()
    scale = rig.sensor.nominal_gain_array.ravel() * units
    z = []
    for seed in range(20):
        run = simulate(rig, seed=seed)
        found = estimate(rig, [run.log])
        error = (found.gain - run.truth.gain).ravel() * units
        P = found.normalised_covariance[:36, :36]
        z.append(error @ scale / np.sqrt(scale @ P @ scale))
    assert abs(np.mean(z)) < 3.0 / np.sqrt(len(z))
