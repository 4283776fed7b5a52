"""What a calibration rests on, kept for those who want to look into it; a calibration alone is small."""

from dataclasses import dataclass

from truewrench.estimation.ekf import EkfEstimate
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.known_wrench import KnownWrenchEstimate
from truewrench.estimation.least_squares import LeastSquaresEstimate
from truewrench.model.log import Log


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Logs and estimate behind a calibration.

    Attributes:
        logs: in the order of the calibration's reports, their joints followed.
        estimate: what the estimator found, with the motion behind it.
    """

    logs: tuple[Log, ...]
    estimate: Estimate | KnownWrenchEstimate | EkfEstimate | LeastSquaresEstimate
