"""Errors of gain and payload as a calibration claims them together, and what residuals say of a log's own.

The payload that a calibration was made with is taken as the calibration found it: what it could not tell of
the body is in its gain as well, so that the two are held against a log with their covariance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from truewrench import _core
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.payload import core_payload
from truewrench.model.rig import Rig
from truewrench.model.rig.sections import ELEMENTS, symmetric

_BODY = {f"{key}{std}" for key in ("mass", "center_of_mass", "inertia") for std in ("", "_std")}
_TOGETHER = {"covariance", "covariance_with_gain"}


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """A payload as a calibration knows it."""

    body: _core.Payload  # in sensor axes
    covariance: Array  # (10, 10) in the units of `payload_rates`
    with_gain: Array  # (10, 6n) covariance with the gain row by row, raw units


def was_seen(calibration: Calibration, rig: Rig, payload: str) -> bool:
    """Whether a calibration was made with a payload, the same that the rig states."""
    used = {report.payload for report in calibration.logs} if calibration.estimator != "reference" else set()
    stated = rig.payloads.get(payload)  # None: of known wrenches, which need none
    return payload in used and stated is not None and calibration.rig.payloads.get(payload) == stated


def carried(calibration: Calibration, rig: Rig, payload: str) -> Carried:
    """As the calibration found it, else as the rig states it.

    One that a reference estimator took as exact has no errors of its own: they are in both. InputError: the
    rig states none.
    """
    if payload not in rig.payloads:
        raise InputError.at(
            rig.path, "payloads", f"no `{payload}`", "a payload, by which a motion tells a wrench"
        )
    spec, apart = rig.payloads[payload], np.zeros((10, 6 * rig.sensor.n))
    if not was_seen(calibration, rig, payload):
        return Carried(core_payload(spec), np.diag(spec.uncertainty.of_each**2), apart)
    found = calibration.payload_posterior.get(payload, {})
    if not found.keys() >= _BODY:
        return Carried(core_payload(spec), np.zeros((10, 10)), apart)
    inertia = symmetric(np.array([found["inertia"][element] for element in ELEMENTS]))
    body = _core.Payload(found["mass"], np.array(found["center_of_mass"]), inertia)
    unit = spec.units
    if not found.keys() >= _TOGETHER:  # of a file from before there was a covariance
        return Carried(body, np.diag((_std(found) / unit) ** 2), apart)
    covariance = np.array(found["covariance"]) / np.outer(unit, unit)
    return Carried(body, covariance, np.array(found["covariance_with_gain"]) / unit[:, None])


def _std(found: Mapping[str, Any]) -> Array:
    elements = [found["inertia_std"][element] for element in ELEMENTS]
    return np.array([found["mass_std"], *found["center_of_mass_std"], *elements])


def joint_covariance(calibration: Calibration, payloads: Sequence[Carried]) -> Array:
    """(36 + 10 k, ...) of E = C^+ dC row by row, by which the residual is off by E w, and of k payloads.

    Payloads hang together through the gain alone.
    """
    size = 6 * calibration.n
    P = calibration.covariance[:size, :size]
    with_gain = np.concatenate([np.zeros((0, size)), *(payload.with_gain for payload in payloads)])
    scale = _scale(P)
    told = with_gain / scale
    between = told @ np.linalg.pinv(P / np.outer(scale, scale), rcond=1e-12, hermitian=True) @ told.T
    for k, payload in enumerate(payloads):
        at = slice(10 * k, 10 * k + 10)
        between[at, at] = payload.covariance
    T = np.kron(np.nan_to_num(calibration.inverse), np.eye(6))
    cross = T @ with_gain.T
    return np.block([[T @ P @ T.T, cross], [cross.T, between]])


def axis_covariance(joint: Array, axis: int) -> Array:
    """Of the errors that act on one wrench axis: (6 + 10 k, ...)."""
    at = _at(axis, len(joint))
    return np.asarray(joint[np.ix_(at, at)])


def _at(axis: int, size: int) -> Integers:
    return np.append(np.arange(6 * axis, 6 * axis + 6), np.arange(36, size))


def factor(covariance: Array) -> Array:
    """L of L L^T, of a covariance that need not have full rank."""
    scale = _scale(covariance)
    values, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * axes * np.sqrt(values.clip(min=0.0)))


def _scale(covariance: Array) -> Array:
    """1 sigma of each, 1 of what is exact."""
    std = np.sqrt(np.diag(covariance))
    return np.where(std > 0.0, std, 1.0)


def fitted(
    joint: Array,
    prior: Array,
    residual: Array,
    wrench: Array,
    by_payload: Array,
    by_own: Array,
    variance: Array,
) -> tuple[Array, Array]:
    """Mean (k,) and covariance of a log's own parameters, gain and payload as uncertain as they are claimed.

    Of residuals (M, 6), a constant apart, their variance (M, 6) by sensor and motion, the payload's wrench
    (M, 6) and its derivatives by payload (M, 6, 10) and parameters (M, 6, k); `prior` (k,) is 1 sigma of
    each, `joint` the `joint_covariance` with the log's payload.
    """
    whole = block_diag(joint, np.diag(prior**2))
    size = len(whole)
    information, told = np.zeros((size, size)), np.zeros(size)
    for axis in range(6):
        at = _at(axis, size)
        rates = np.column_stack([wrench, by_payload[:, axis], by_own[:, axis]])
        rates -= rates.mean(axis=0)
        weighted = rates / variance[:, axis, None]
        information[np.ix_(at, at)] += weighted.T @ rates
        told[at] += weighted.T @ (residual[:, axis] - residual[:, axis].mean())
    L = factor(whole)
    P = L @ np.linalg.solve(np.eye(size) + L.T @ information @ L, L.T)
    own = slice(len(joint), None)
    return P[own] @ told, P[own, own]
