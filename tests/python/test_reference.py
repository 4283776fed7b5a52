"""Gain and offset from reference wrenches, against a fit of every unknown there is, and in Monte Carlo."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2

from truewrench.estimation.known_wrench import KnownWrenchEstimate, estimate_from_known_wrench
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig

Array = NDArray[np.float64]

SPAN = np.array([100.0, 100.0, 100.0, 10.0, 10.0, 10.0])


def rig_of(noise: float, n: int = 6, reference: float | None = None, **sensor: Any) -> Rig:
    """Sensor and reference with a noise in units of range; eight gauges are a random mixture."""
    nominal: Any = "identity"
    scale = SPAN
    if n != 6:
        rows = np.random.default_rng(99).normal(size=(n, 6)) / SPAN
        nominal, scale = rows.tolist(), np.abs(rows) @ SPAN
    body = {"mass": 1, "center_of_mass": [0, 0, 0], "inertia": {"xx": 1, "yy": 1, "zz": 1}}
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": [f"gauge_{i}" for i in range(n)],
                "feels": "payload_on_sensor",
                "noise": (noise * scale).tolist(),
                "range": SPAN.tolist(),
                "nominal_gain": nominal,
                **sensor,
            },
            "payloads": {"default": body},
            "motion": {"noise": [1e-3] * 6},
            "reference_noise": ((noise if reference is None else reference) * SPAN).tolist(),
        }
    )


def truth_of(rig: Rig, seed: int) -> tuple[Array, Array]:
    """Gain and offset drawn from the priors."""
    draw, sensor = np.random.default_rng([seed, 0]), rig.sensor
    departure = sensor.gain_prior * draw.normal(size=(sensor.n, 6))
    gain = sensor.nominal_gain_array + departure * sensor.channel_scale[:, None] / SPAN
    return gain, sensor.offset_prior_array * draw.normal(size=sensor.n)


def log_of(rig: Rig, wrench: Array, gain: Array, offset: Array, seed: int) -> Log:
    draw, rows = np.random.default_rng([seed, 1]), len(wrench)
    return Log(
        path=None,
        payload="default",
        sha256="",
        time_ns=np.arange(rows) * 10**9,
        raw=wrench @ gain.T + offset + rig.sensor.noise_array * draw.normal(size=(rows, rig.sensor.n)),
        reference=wrench + np.array(rig.reference_noise) * draw.normal(size=(rows, 6)),
    )


def wrenches(rows: int, seed: int = 0, rank: int = 6) -> Array:
    """Of 0.3 of range; with a rank of 3 the moment follows from the force, as that of a weight does."""
    draw = np.random.default_rng([seed, 2])
    loads = 0.3 * draw.normal(size=(rows, 6))
    if rank == 3:
        loads[:, 3:] = np.cross([0.4, -0.2, 0.5], loads[:, :3])
    return loads * SPAN


def everything_fitted(rig: Rig, log: Log, exact_offset: bool) -> tuple[Array, Array, Array]:
    """Gain, offset and covariance by a general solver over gain, offset and the wrench of every row."""
    sensor, rows = rig.sensor, len(log.raw)
    assert log.reference is not None
    raw, reference, n = log.raw, log.reference, sensor.n
    gain_std = sensor.gain_prior * sensor.channel_scale[:, None] / SPAN
    noise = np.array(rig.reference_noise)

    def split(x: Array) -> tuple[Array, Array, Array]:
        unknown = x[7 * n :].reshape(rows, 6) * SPAN
        offset = np.zeros(n) if exact_offset else x[6 * n : 7 * n] * sensor.channel_scale
        return x[: 6 * n].reshape(n, 6) * sensor.channel_scale[:, None] / SPAN, offset, unknown

    def residuals(x: Array) -> Array:
        C, b, w = split(x)
        parts = [
            ((raw - w @ C.T - b) / sensor.noise_array).ravel(),
            ((reference - w) / noise).ravel(),
            ((C - sensor.nominal_gain_array) / gain_std).ravel(),
            x[6 * n : 7 * n] if exact_offset else b / sensor.offset_prior_array,
        ]
        return np.concatenate(parts)

    start = np.concatenate(
        [(sensor.nominal_gain_array * SPAN / sensor.channel_scale[:, None]).ravel(), np.zeros(n)]
    )
    start = np.append(start, (reference / SPAN).ravel())
    found = least_squares(residuals, start, method="lm", jac="3-point", xtol=1e-10)
    C, b, _ = split(found.x)
    return C, b, np.linalg.inv(found.jac.T @ found.jac)[: 7 * n, : 7 * n]


@pytest.mark.parametrize(
    ("n", "offset_prior", "ratio"),
    [(6, None, 1.0), (6, 0, 1.0), (8, None, 1.0), (6, None, 0.05), (6, None, 20.0)],
)
def test_a_general_solver_over_all_wrenches_finds_the_same(n: int, offset_prior: Any, ratio: float) -> None:
    rig = rig_of(1e-3, n, 1e-3 * ratio, offset_prior=offset_prior, gain_prior=0.2)
    gain, offset = truth_of(rig, 1)
    log = log_of(rig, wrenches(12), gain, offset, 1)
    found = estimate_from_known_wrench(rig, [log])
    C, b, covariance = everything_fitted(rig, log, offset_prior == 0)
    std = np.sqrt(np.diag(found.covariance))
    assert found.converged
    # what is not noise of a wrench's scatter is a matter of its square, here 1e-5 to 5e-3
    assert np.abs((found.gain - C).ravel() / std[: 6 * n]).max() < 0.05
    if offset_prior != 0:
        assert np.abs((found.offsets[0] - b) / std[6 * n :]).max() < 0.05
        expected = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(np.sqrt(np.diag(found.normalised_covariance)), expected, rtol=0.03)
    else:
        assert not found.offsets.any()
        assert not std[6 * n :].any()


def deviation(rig: Rig, found: KnownWrenchEstimate, gain: Array, offset: Array) -> tuple[Array, float]:
    """Normalised errors of gain and offset, and their NEES."""
    scale = rig.sensor.channel_scale
    error = np.append(
        ((found.gain - gain) * SPAN / scale[:, None]).ravel(), (found.offsets[-1] - offset) / scale
    )
    return error, float(error @ np.linalg.solve(found.normalised_covariance, error))


@pytest.mark.parametrize(
    ("snr", "rows", "rank"), [(1000, 24, 6), (10, 24, 6), (10, 100, 3), (5, 400, 6), (3, 400, 6), (3, 400, 3)]
)
def test_errors_are_as_large_as_stated(snr: float, rows: int, rank: int) -> None:
    rig, trials = rig_of(0.3 / snr), 25
    nees, inside = [], []
    for seed in range(trials):
        gain, offset = truth_of(rig, seed)
        found = estimate_from_known_wrench(rig, [log_of(rig, wrenches(rows, seed, rank), gain, offset, seed)])
        error, squared = deviation(rig, found, gain, offset)
        nees.append(squared)
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diag(found.normalised_covariance)))
    low, high = chi2.ppf([0.001, 0.999], 42 * trials) / (42 * trials)
    assert low - 0.02 < np.mean(nees) / 42 < high + 0.05
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_noise_of_the_reference_does_not_shrink_the_gain() -> None:
    """Where regression loses 10% of it: noise over signal of a third."""
    rig = rig_of(0.1, gain_prior=1.0)
    gain = np.diag(np.ones(6))
    log = log_of(rig, wrenches(20_000), gain, np.zeros(6), 0)
    assert log.reference is not None
    design = np.column_stack([log.reference / SPAN, np.ones(len(log.raw))])
    plain = np.linalg.lstsq(design, log.raw / SPAN)[0][:6].T
    assert np.diag(plain).mean() == pytest.approx(0.9, abs=0.005)
    found = estimate_from_known_wrench(rig, [log])
    assert np.diag(found.gain).mean() == pytest.approx(1.0, abs=0.005)
    std = np.sqrt(np.diag(found.covariance))[:36]
    assert np.abs((found.gain - gain).ravel() / std).max() < 4.5


def test_loads_that_never_vary_alone_keep_the_prior() -> None:
    rig = rig_of(0.01)
    gain, offset = truth_of(rig, 3)
    found = estimate_from_known_wrench(rig, [log_of(rig, wrenches(2000, rank=3), gain, offset, 3)])
    values = np.linalg.eigvalsh(found.normalised_covariance[:36, :36])
    assert np.count_nonzero(values > (0.5 * 0.3) ** 2) == 18
    np.testing.assert_allclose(np.sqrt(values[18:]), 0.3, rtol=1e-3)


def test_every_log_has_an_offset_of_its_own_unless_they_are_pooled() -> None:
    rig = rig_of(1e-3)
    gain, _ = truth_of(rig, 4)
    offsets = 0.05 * SPAN * np.random.default_rng(4).normal(size=(3, 6))
    logs = [log_of(rig, wrenches(30, k), gain, offset, k) for k, offset in enumerate(offsets)]
    found = estimate_from_known_wrench(rig, logs)
    assert np.abs((found.offsets - offsets) / found.offsets_std).max() < 4.5
    pooled = rig_of(1e-3, pool_offsets=True)
    same = [log_of(pooled, wrenches(30, k), gain, offsets[0], k) for k in range(3)]
    found = estimate_from_known_wrench(pooled, same)
    assert np.ptp(found.offsets, axis=0).max() == 0.0
    assert np.abs((found.offsets[0] - offsets[0]) / found.offsets_std[0]).max() < 4.5


def test_an_offset_that_follows_temperature_is_told_from_the_gain() -> None:
    rig = Rig.from_mapping(rig_of(1e-3).to_mapping() | {"temperature": {"reference": 20, "prior": 1e-2}})
    gain, offset = truth_of(rig, 5)
    slope = 0.01 * SPAN * np.array([1, -1, 0.5, 0, 2, -0.5])
    temperature = np.linspace(18.0, 31.0, 60)
    log = log_of(rig, wrenches(60), gain, offset, 5)
    log = replace(log, raw=log.raw + (temperature[:, None] - 20.0) * slope, temperature=temperature)
    found = estimate_from_known_wrench(rig, [log])
    assert found.offset_temperature is not None
    np.testing.assert_allclose(found.offset_temperature, slope, atol=2e-4 * SPAN.max())
    assert np.abs((found.gain - gain).ravel() / np.sqrt(np.diag(found.covariance))[:36]).max() < 4.5
    seldom = np.where(np.arange(60) % 10 == 0, temperature, np.nan)  # a stream of its own
    seldom[-1] = temperature[-1]
    again = estimate_from_known_wrench(rig, [replace(log, temperature=seldom)])
    assert again.rows[0].size == 60
    np.testing.assert_allclose(again.gain, found.gain, atol=1e-9 * SPAN.max())


@pytest.mark.parametrize("count", [1, 3])
def test_a_weight_noted_wrongly_is_left_out_and_named(count: int) -> None:
    rig = rig_of(1e-3)
    gain, offset = truth_of(rig, 6)
    log = log_of(rig, wrenches(40), gain, offset, 6)
    assert log.reference is not None
    wrong = np.array([7, 21, 22])[:count]
    reference = log.reference.copy()
    reference[wrong, 2] += 9.81  # a kilogram
    found = estimate_from_known_wrench(rig, [replace(log, reference=reference)])
    np.testing.assert_array_equal(found.outliers[0], wrong)
    assert found.contradicting == 0
    without = estimate_from_known_wrench(rig, [replace(log, raw=np.delete(log.raw, wrong, 0),
        reference=np.delete(log.reference, wrong, 0), time_ns=np.delete(log.time_ns, wrong))])  # fmt: skip
    np.testing.assert_allclose(found.gain, without.gain, rtol=1e-9, atol=1e-12)


def test_good_rows_are_not_taken_for_outliers() -> None:
    rig = rig_of(1e-3)
    gain, offset = truth_of(rig, 7)
    left_out = [
        sum(
            map(
                len, estimate_from_known_wrench(rig, [log_of(rig, wrenches(24, k), gain, offset, k)]).outliers
            )
        )
        for k in range(40)
    ]
    assert sum(left_out) <= 1


def test_many_contradicting_rows_are_kept_and_counted() -> None:
    rig = rig_of(1e-3)
    gain, offset = truth_of(rig, 8)
    log = log_of(rig, wrenches(40), gain, offset, 8)
    assert log.reference is not None
    reference = log.reference.copy()
    reference[::4, 0] += 20.0
    found = estimate_from_known_wrench(rig, [replace(log, reference=reference)])
    assert found.outliers[0].size == 0
    assert found.contradicting > 4
    assert (found.sum_of_squares / found.freedom).max() > 10.0


def test_rows_that_lack_a_side_are_counted_and_a_log_of_them_refused() -> None:
    rig = rig_of(1e-3)
    gain, offset = truth_of(rig, 9)
    log = log_of(rig, wrenches(40), gain, offset, 9)
    assert log.reference is not None
    log.raw[3, 2] = np.nan
    log.reference[11] = np.nan
    found = estimate_from_known_wrench(rig, [log])
    assert (found.incomplete[0], found.rows[0].size) == (2, 38)
    log.reference[:, 4] = np.nan
    with pytest.raises(InputError, match="no row with all raw channels"):
        estimate_from_known_wrench(rig, [log])
