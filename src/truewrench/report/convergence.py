"""How the gain settled as the record went on.

The gain from the first part of the record alone, motion (or reference) taken as the whole record gave it:
sums over the rows in the order of time, solved again and again. That costs almost nothing beside a second
estimate, and leaves out what payload and clock add to the uncertainty, which no longer record takes away.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from truewrench.estimation.assumptions import assumed_gain_prior, assumed_offset_prior
from truewrench.estimation.ekf import EkfEstimate
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.evidence import Evidence
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.report.series import Record

_STEPS = 80
_MOST = 400  # points of an estimator's own history


@dataclass(frozen=True, slots=True, eq=False)
class Convergence:
    """RMS over the normalised gains, as shares of full scale."""

    time: Array  # (K,) on the common time axis [s]
    distance: Array  # (K,) of the gain so far from that of all rows
    sigma: Array  # (K,) of the gain so far, by noise alone
    final: float  # stated 1 sigma of the final gain, with all that is uncertain
    history_time: Array  # (H,) of the estimator's own history, empty where it has none
    history: Array  # (H,) distance of its gain from its final one


def convergence(calibration: Calibration, evidence: Evidence, record: Record) -> Convergence | None:
    """None where no row of the record has residuals."""
    if record.none_because:
        return None
    sensor = calibration.rig.sensor
    n, logs, units = sensor.n, len(record.logs), 1.0 / sensor.gain_unit
    size = 6 + logs * bool(sensor.offset_prior_array.any())
    prior = np.full((n, size), assumed_gain_prior(calibration.rig))
    prior[:, 6:] = assumed_offset_prior(calibration.rig)[:, None]
    gram, right = np.zeros((size, size)), np.zeros((size, n))
    times, gains, sigmas = [], [], []
    for k, series in enumerate(record.logs):
        known = np.isfinite(series.residual).all(axis=1)
        rows = np.zeros((int(known.sum()), size))
        rows[:, :6] = series.wrench[known] / sensor.range_array
        rows[:, 6 + k : size] = np.arange(6 + k, size) == 6 + k
        felt = (series.measured @ calibration.gain.T - series.wrench @ sensor.nominal_gain_array.T)[known]
        stamps = series.time[known] + series.begin
        edges = np.searchsorted(stamps, np.linspace(0.0, record.end, _STEPS + 1)[1:], side="right")
        for first, last in pairwise((0, *edges.tolist(), len(stamps))):
            if first == last:
                continue
            gram += rows[first:last].T @ rows[first:last]
            right += rows[first:last].T @ (felt[first:last] / sensor.channel_scale)
            gain, variance = _solved(gram, right, series.noise / sensor.channel_scale, prior)
            times.append(float(stamps[last - 1]))
            gains.append(gain)
            sigmas.append(float(np.sqrt(np.mean(variance))))
    distance = np.sqrt(np.mean((np.array(gains) - gains[-1]) ** 2, axis=(1, 2))) if gains else np.zeros(0)
    final = float(np.sqrt(np.mean(calibration.gain_std_normalised**2)))
    own = _history(calibration, evidence, record, units)
    return Convergence(np.array(times), distance, np.array(sigmas), final, *own)


def _solved(gram: Array, right: Array, noise: Array, prior: Array) -> tuple[Array, Array]:
    """Departure of the gain (n, 6) and its variance, channel by channel, with the rig's priors."""
    gain, variance = np.zeros((len(noise), 6)), np.zeros((len(noise), 6))
    for i, sigma in enumerate(noise):
        exists = prior[i] > 0.0
        information = gram / sigma**2 + np.diag(np.where(exists, prior[i], 1.0) ** -2.0)
        inverse = np.linalg.inv(information[np.ix_(exists, exists)])
        gain[i] = (inverse @ (right[exists, i] / sigma**2))[:6]
        variance[i] = np.diag(inverse)[:6]
    return gain, variance


def _history(
    calibration: Calibration, evidence: Evidence, record: Record, units: Array
) -> tuple[Array, Array]:
    estimate = evidence.estimate
    if not isinstance(estimate, Estimate | EkfEstimate) or not estimate.history_time.size:
        return np.zeros(0), np.zeros(0)
    every = slice(None, None, max(1, estimate.history_time.size // _MOST))
    begins = np.array([series.begin for series in record.logs])
    departure = (estimate.history_gain[every] - calibration.gain) * units
    times = estimate.history_time[every] + begins[estimate.history_log[every]]
    return times, np.sqrt(np.mean(departure**2, axis=(1, 2)))
