"""The noise of a log's twist, whatever it was measured with."""

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig


def twist_noise(rig: Rig, log: Log) -> Array:
    """1 sigma (6,) of a sample of `log.twist` [m/s, rad/s]; of joints, its RMS over the log."""
    return np.asarray(np.sqrt(np.diag(twist_covariance(rig, log))))


def twist_covariance(rig: Rig, log: Log) -> Array:
    """Covariance (6, 6) of a sample of `log.twist`; of joints, the mean of J Sigma J^T ([A00] 26).

    A twist that comes from positions alone has no noise of its own samples; it is given that of
    differences over the spacing of its reference.
    """
    if log.tracking is None:
        return np.diag(rig.motion.noise_array**2)
    tracking = log.tracking
    sigma = rig.motion.noise_array
    if tracking.reference is not None and tracking.velocity_departure is None:
        sigma = np.array(rig.motion.position_noise) / tracking.reference.spacing
    rows = np.isfinite(tracking.jacobian).all(axis=(1, 2))
    J = tracking.jacobian[rows]
    covariance = np.einsum("kij,j,klj->il", J, sigma**2, J) / max(len(J), 1)
    return np.asarray(covariance + 1e-12 * covariance.max() * np.eye(6))
