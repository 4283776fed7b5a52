"""What is lost where one factor per axis stands for the whole gain."""

from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration


@dataclass(frozen=True, slots=True, eq=False)
class Loss:
    """Error of a wrench computed with less than the gain, each (6,) [N, N m].

    Attributes:
        worst: largest within the sensor's range.
        rms: of loads spread evenly over the range, all axes at once; a tenth of the load has a tenth of it.
        worst_before: `worst` of the nominal gain.
        rms_before: `rms` of the nominal gain.
    """

    worst: Array
    rms: Array
    worst_before: Array
    rms_before: Array


def diagonal_nominal(calibration: Calibration) -> Array | None:
    """(6,) nominal factors where channel i is wrench axis i in a unit of its own, otherwise None."""
    nominal = calibration.rig.sensor.nominal_gain_array
    if nominal.shape != (6, 6) or np.any(nominal - np.diag(np.diag(nominal))):
        return None
    factors: Array = np.diag(nominal).copy()
    return factors


def best_factors(calibration: Calibration) -> Array:
    """(6,) factors of least RMS error over the range: E[w_i x_i] / E[x_i^2] of x = gain @ w."""
    felt = calibration.gain * calibration.rig.sensor.range_array
    factors: Array = np.diag(felt) * calibration.rig.sensor.range_array / (felt**2).sum(axis=1)
    return factors


def loss_of_factors(calibration: Calibration, factors: Array, before: Array) -> Loss:
    """Of the wrench (raw - offset) * factors, and of that with the factors `before`."""
    worst, rms = _errors(calibration, factors)
    worst_before, rms_before = _errors(calibration, before)
    return Loss(worst, rms, worst_before, rms_before)


def _errors(calibration: Calibration, factors: Array) -> tuple[Array, Array]:
    """Largest and RMS error over |w_j| <= range_j, w_j uniform and independent: variance range_j^2 / 3."""
    error = (factors[:, None] * calibration.gain - np.eye(6)) * calibration.rig.sensor.range_array
    return np.abs(error).sum(axis=1), np.sqrt((error**2).sum(axis=1) / 3.0)
