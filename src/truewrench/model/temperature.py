"""What of a sensor's offset follows its temperature."""

from dataclasses import replace

import numpy as np

from truewrench.model.arrays import Array, Integers
from truewrench.model.log import Log
from truewrench.model.rig import Rig


def where_apart(P: Array, offset: slice, slope: Array, scale: Array) -> tuple[float, Array, Array]:
    """Where offset and slope tell nothing of each other: the middle of the temperatures that told them.

    P (p, p) is the covariance of parameters, the offset at the reference temperature among them, `slope`
    (n, p + n) that of the slope with these and itself, `scale` (n,) the channels' full scale. Given are how
    far above the reference it is [K], P with the offset there, and the slope's 1 sigma (n,) [per K].
    """
    p, n = len(P), len(slope)
    own = np.diag(slope[:, p:]) / scale**2
    above = -float(np.sum(np.diag(slope[:, offset]) / scale**2) / max(own.sum(), np.finfo(np.float64).tiny))
    A = np.eye(p, p + n)
    A[offset, p:] = above * np.eye(n)
    whole = np.block([[P, slope[:, :p].T], [slope]])
    return above, A @ whole @ A.T, np.sqrt(np.maximum(np.diag(slope[:, p:]), 0.0))


def temperature_at(log: Log, time_ns: Integers) -> Array | None:
    """(M,) temperatures [degC] at these stamps, linear between readings; None where the log has none."""
    if log.temperature is None:
        return None
    known = np.isfinite(log.temperature)
    if not known.any():
        return None
    origin = log.time_ns[0]  # stamps since 1970 have more digits than a double
    at, time = (time_ns - origin) * 1e-9, (log.time_ns[known] - origin) * 1e-9
    return np.asarray(np.interp(at, time, log.temperature[known]))


def at_reference_temperature(slope: Array | None, rig: Rig, log: Log) -> Log:
    """The log with channels that read what they would at the rig's reference temperature.

    The slope (n,) of the offset per K is None where nothing follows; a log without a temperature stays as it
    is.
    """
    at = None if slope is None else temperature_at(log, log.time_ns)
    if slope is None or at is None:
        return log
    return replace(log, raw=log.raw - np.outer(at - rig.temperature.reference, slope))
