"""What a rig states, as the prior of the parameters that the windows share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.errors import InputError
from truewrench.estimate.streams import Part, links
from truewrench.log import Log
from truewrench.rig import Rig

__all__ = ["common_prior"]

Array = NDArray[np.float64]

_EXACT = 1e-9  # 1 sigma, normalised, that stands for a parameter without uncertainty


def common_prior(rig: Rig, logs: Sequence[Log], parts: Sequence[Part], nominal: Array) -> _core.CommonPrior:
    """Priors of the common parameters, normalised; what is exact and not needed is left out."""
    sensor = rig.sensor
    _check_temperature(rig, logs)
    names = list(dict.fromkeys(log.payload for log in logs))
    layout = _core.ParameterLayout()
    layout.channels = sensor.n
    layout.payload = not all(rig.payloads[name].exact for name in names)
    layout.offset = bool(sensor.offset_prior_array.any())
    layout.pool_offsets = sensor.pool_offsets
    layout.time_offset = sensor.time_offset_prior > 0.0
    layout.temperature = rig.temperature.prior > 0.0 and any(log.temperature is not None for log in logs)
    mean, sigma = np.zeros(layout.size), np.ones(layout.size)
    mean[: nominal.size] = nominal.ravel()
    sigma[: nominal.size] = sensor.gain_prior
    if layout.offset:
        sigma[layout.offset_begin : layout.offset_begin + sensor.n] = (
            sensor.offset_prior_array / sensor.channel_scale
        )
    if layout.temperature:
        sigma[layout.temperature_begin : layout.temperature_begin + sensor.n] = rig.temperature.prior
    if layout.time_offset:
        sigma[layout.time_offset_begin] = sensor.time_offset_prior
    prior = _core.CommonPrior()
    prior.layout = layout
    prior.mean = mean
    prior.information = np.maximum(sigma, _EXACT) ** -2.0
    prior.payload_of = [names.index(part.rows.payload) for part in parts]
    prior.gains_walk = sensor.gain_walk > 0.0
    if len(parts) > len(logs) or prior.gains_walk:
        prior.links = links(rig, parts, layout)
    known = []
    for name in names:
        u = rig.payloads[name].uncertainty
        known.append(
            np.maximum(np.array([u.mass] + [u.center_of_mass] * 3 + [u.inertia] * 6), _EXACT) ** -2.0
        )
    prior.payload_information = known
    return prior


def _check_temperature(rig: Rig, logs: Sequence[Log]) -> None:
    if not rig.temperature.prior > 0.0 or all(log.temperature is None for log in logs):
        return
    for log in logs:
        if log.temperature is None or not np.isfinite(log.temperature).any():
            found = "no such column" if log.temperature is None else "a column without a reading"
            raise InputError.at(log.path, "temperature", found, "one in every log, as in the others")
