"""What a record could not have shown: a force that follows the pose, a delay (METHOD 10.1, 10.4)."""

import numpy as np

from truewrench import _core
from truewrench.estimation import pose
from truewrench.estimation.estimate import Estimate
from truewrench.model.calibration_parts import BlindTo
from truewrench.model.rig import Rig

STILL = 1e-9  # fraction of range: a wrench that moves by less shows nothing, and hides nothing: tolerance
FEWEST = 12  # samples of a stretch, of which a rate is formed: tolerance


def blind_to(estimate: Estimate, rig: Rig) -> tuple[BlindTo, ...]:
    """What a force of 0.1% of range that follows the pose, and 1 ms, would do to the gains unseen.

    Empty where the record could not be solved, or nothing moved: it then showed nothing at all.
    """
    sensor = rig.sensor
    moved = np.isfinite(estimate.ww).all() and np.trace(estimate.ww) > STILL**2
    if not estimate.solved or not moved or not np.isfinite(estimate.A):
        return ()
    rates, wrenches = [], []
    for rows in estimate.rows:
        w = rows.wrench / sensor.range_array
        for stretch in np.unique(rows.stretch):
            at = np.flatnonzero(rows.stretch == stretch)
            if at.size < FEWEST or not np.isfinite(w[at]).all() or not np.all(np.diff(rows.time[at]) > 0.0):
                continue
            used = ~rows.masked[at]
            rates.append(np.gradient(w[at], rows.time[at], axis=0)[used])
            wrenches.append(w[at][used])
    if not wrenches or not any(len(w) for w in wrenches):
        return ()
    unit = 1.0 / sensor.gain_unit
    with np.errstate(over="ignore", invalid="ignore"):  # a gain beyond all numbers is held by the ceiling
        return pose.blind_to(
            _core.PoseShare(estimate.A, estimate.ww),
            pose.pooled_delay_share(rates, wrenches),
            gain=estimate.gain * unit,
            ceiling=float(np.max(estimate.gain_prior, initial=0.0)),
        )
