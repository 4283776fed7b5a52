"""Whether logs of known wrenches tell one gain (METHOD 10.7): each by itself, its errors as found of all."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truewrench.estimation.known_wrench import KnownWrenchEstimate, estimate_from_known_wrench
from truewrench.estimation.reference_clock import ReferenceClock
from truewrench.estimation.together import Shared, Told
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig


def agreement_of_known_wrenches(
    rig: Rig, logs: Sequence[Log], found: KnownWrenchEstimate, clocks: Sequence[ReferenceClock | None]
) -> Array:
    """(L,) how likely chance makes each log depart as far from the others (10.11); 1 of a single one."""
    if len(logs) < 2:
        return np.ones(1)
    alone = []
    for k, (log, clock) in enumerate(zip(logs, clocks, strict=True)):
        errors = [replace(kind, logs=(0,)) for kind in found.errors if k in kind.logs]
        alone.append(_told(rig, estimate_from_known_wrench(rig, [log], errors, [clock])))
    shared = Shared(alone)
    gains = 6 * rig.sensor.n
    return np.array([shared.agreement(np.arange(len(logs)) == k, gains) for k in range(len(logs))])


def _told(rig: Rig, found: KnownWrenchEstimate) -> Told:
    sensor = rig.sensor
    gains = 6 * sensor.n
    unit = sensor.range_array / sensor.channel_scale[:, None]
    return Told(
        keys={j: j for j in range(gains)},
        first=gains,
        u=slice(0, 0),
        theta=(found.gain * unit).ravel(),
        mean=(sensor.nominal_gain_array * unit).ravel(),
        prior=np.full(gains, sensor.gain_prior**2),
        covariance=found.normalised_covariance[:gains, :gains],
        added=np.zeros((gains, gains)),
    )
