"""What of a sensor's offset follows its temperature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truewrench.log import Log

__all__ = ["offset_by_temperature", "temperature_at"]

Array = NDArray[np.float64]


def temperature_at(log: Log, time_ns: NDArray[np.int64]) -> Array | None:
    """(M,) temperatures [degC] at these stamps, linear between readings; None where the log has none."""
    if log.temperature is None:
        return None
    known = np.isfinite(log.temperature)
    if not known.any():
        return None
    origin = log.time_ns[0]  # stamps since 1970 have more digits than a double
    at, time = (time_ns - origin) * 1e-9, (log.time_ns[known] - origin) * 1e-9
    return np.asarray(np.interp(at, time, log.temperature[known]))


def offset_by_temperature(slope: Array | None, reference: float, log: Log) -> Array:
    """What the channels of a log read more than at the reference temperature, (N, n) raw units.

    Args:
        slope: (n,) of the offset per K, as a calibration holds it; None: nothing follows.
        reference: temperature [degC].
        log: whose rows are asked for; without a temperature nothing is known to follow.
    """
    at = None if slope is None else temperature_at(log, log.time_ns)
    return np.zeros_like(log.raw) if slope is None or at is None else np.outer(at - reference, slope)
