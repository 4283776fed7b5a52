"""What is believed before the logs: of the gain what a calibration or a rig says, of the body little."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truewrench.estimation.known_wrench import estimate_from_known_wrench
from truewrench.estimation.reference_clock import with_reference_on_time
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import TILT_PRIOR, UNKNOWN, tool_rig
from truewrench.tool.model import Tool
from truewrench.tool.parameters import Layout

MOUNTING_PRIOR = float(np.radians(3.0))
"""[rad] 1 sigma of each angle between channels and sensor frame, where the gain has not seen it."""

LOG_MASS = (float(np.log(1.5)), 1.5)
CENTER_STD = 0.15  # [m]
S_MEAN, S_STD, S_CROSS_STD = 0.0025, 0.004, 0.002  # [m^2]
_RIG_TILT = 3.5e-3  # [rad] what a calibration's rig holds where nobody stated it
_EXACT = 1e-9  # of a unit: 1 sigma that holds a parameter


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """N(mean, covariance) of the parameters that all logs share."""

    # (7n + 15,) in the order of `Layout`, after it the ten of a known body (`--on`) and, in one session, its
    # offset (n)
    mean: Array
    covariance: Array  # of the same
    gain_std: float  # the largest normalised 1 sigma of a gain
    # value and sigma of what is stated of the tool: `mass`, `center_of_mass.x`, `inertia.xx` ...
    known: Mapping[str, tuple[float, float]]
    on: bool = False  # whether ten parameters of a body that was there before end the vector
    # when that offset was (`sensor.pool_offsets`); None where offsets start anew
    session_ns: int | None = None


def settings_of(source: Rig | Calibration) -> Rig:
    """The rig that a tool is identified with: one placeholder for a payload, twists of the sensor."""
    if isinstance(source, Calibration):
        data = source.rig.to_mapping()
        if data.get("gravity_tilt_prior") == _RIG_TILT:
            data.pop("gravity_tilt_prior")
        data.get("motion", {}).pop("of", None)  # of the logs that were calibrated with
        path = source.rig.path
    else:
        if tuple(source.payloads) == (UNKNOWN,):
            return source
        data, path = source.to_mapping(), source.path
        if "gain_prior" not in source.sensor.model_fields_set:
            data["sensor"].pop("gain_prior")
        if "gravity_tilt_prior" not in source.model_fields_set:
            data.pop("gravity_tilt_prior")
        if "of" not in source.motion.model_fields_set:
            data.get("motion", {}).pop("of", None)
    return tool_rig(data, path)


def make_prior(
    source: Rig | Calibration,
    rig: Rig,
    *,
    mounting_sigma: float | None = None,
    tilt_sigma: float | None = None,
    on: Tool | None = None,
    known: Mapping[str, tuple[float, float]] | None = None,
) -> Prior:
    """The prior, in SI and raw units, for the rig of `settings_of`.

    Of a calibration as the source, the covariance of the gain is taken whole. The sigmas are of each angle of
    the mounting, and of gravity's direction about two axes [rad]. The unknown body sits `on` a tool
    identified before; of it, value and 1 sigma may be `known` by name.
    """
    sensor, n = rig.sensor, rig.sensor.n
    layout = Layout(n)
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    gain_units = sensor.gain_unit.ravel()
    calibrated = isinstance(source, Calibration)
    if isinstance(source, Calibration):
        mean[layout.gain] = source.gain.ravel()
        covariance[layout.gain, layout.gain] = source.covariance[: 6 * n, : 6 * n]
    else:
        mean[layout.gain] = sensor.nominal_gain_array.ravel()
        covariance[layout.gain, layout.gain] = np.diag((sensor.gain_prior * gain_units) ** 2)
    std = np.zeros(layout.size)
    mean[layout.log_mass], std[layout.log_mass] = LOG_MASS
    std[layout.center_of_mass] = CENTER_STD
    mean[layout.S] = [S_MEAN] * 3 + [0.0] * 3
    std[layout.S] = [S_STD] * 3 + [S_CROSS_STD] * 3
    std[layout.offset] = sensor.offset_prior_array
    std[layout.mounting] = (
        mounting_sigma if mounting_sigma is not None else 0.0 if calibrated else MOUNTING_PRIOR
    )
    if rig.in_gravity:
        std[layout.tilt] = tilt_sigma if tilt_sigma is not None else rig.gravity_tilt_prior or TILT_PRIOR
        if tilt_sigma is None and "gravity_tilt_prior" in rig.model_fields_set:
            std[layout.tilt] = rig.gravity_tilt_prior
    held = np.arange(layout.gain.stop, layout.size)
    covariance[held, held] = np.maximum(std[held], _EXACT) ** 2
    session_ns = None
    if on is not None:
        mean, covariance = _on(layout, mean, covariance, on, sensor.pool_offsets)
        session_ns = on.offset_time_ns if sensor.pool_offsets else None
    relative = np.sqrt(np.diag(covariance)[layout.gain]) / gain_units
    return Prior(mean, covariance, float(relative.max()), dict(known or {}), on is not None, session_ns)


def _on(
    layout: Layout, mean: Array, covariance: Array, tool: Tool, same_session: bool
) -> tuple[Array, Array]:
    """The posterior of a tool before: gain, mounting, tilt and its body jointly, in one session its offset.

    Else the offset starts anew: a sensor may have been zeroed, or off, in between.
    """
    tool = tool.whole
    more = 10 + layout.n * same_session
    size = layout.size
    out, P = np.append(mean, np.zeros(more)), np.zeros((size + more, size + more))
    P[:size, :size] = covariance
    shared = np.r_[layout.gain, layout.mounting, layout.tilt]  # stand at the same place in both
    places = np.concatenate([shared, size + np.arange(more)])
    theirs = np.concatenate([shared, np.r_[layout.body], np.r_[layout.offset][: more - 10]])
    out[places] = tool.theta[theirs]
    P[np.ix_(places, places)] = tool.covariance[np.ix_(theirs, theirs)]
    return out, P


def with_known_wrenches(rig: Rig, prior: Prior, logs: Sequence[Log]) -> Prior:
    """The prior of the gain after logs whose whole wrench is known from elsewhere (`ref_*`)."""
    if not logs:
        return prior
    n, place = rig.sensor.n, Layout(rig.sensor.n).gain
    stated = rig.sensor.gain_prior * rig.sensor.gain_unit.ravel()
    on_time = [with_reference_on_time(rig, log) for log in logs]
    found = estimate_from_known_wrench(rig, [log for log, _ in on_time], clocks=[c for _, c in on_time])
    P = found.covariance[: 6 * n, : 6 * n]
    told = np.linalg.inv(P)
    data = told - np.diag(stated**-2)  # what the logs add
    pull = told @ found.gain.ravel() - rig.sensor.nominal_gain_array.ravel() / stated**2
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    before = covariance[place, place]
    gap = pull - data @ mean[place]
    after = before - before @ data @ np.linalg.solve(np.eye(6 * n) + before @ data, before)
    # what is correlated with the gain follows it
    rest = covariance[:, place] @ np.linalg.solve(np.eye(6 * n) + data @ before, np.eye(6 * n))
    mean = mean + rest @ gap
    covariance = covariance - rest @ data @ covariance[place, :]
    covariance[place, place] = 0.5 * (after + after.T)
    covariance = 0.5 * (covariance + covariance.T)
    units = stated / rig.sensor.gain_prior
    return replace(
        prior,
        mean=mean,
        covariance=covariance,
        gain_std=float((np.sqrt(np.diag(covariance)[place]) / units).max()),
    )


def widening(gain_std: float) -> float:
    """Factor on every variance where gains are so uncertain that gain times mass bends (1 up to 5%)."""
    return float(max(1.0, gain_std / 0.05) ** 2.5)
