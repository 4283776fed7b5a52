"""What follows the pose, and a delay: how much of either a motion can hide in the gain (docs/method.md).

Misfit that lies in the span of the wrench is taken for gain and leaves nothing in the residuals. A cable's
pull follows the pose; where every axis moves at one frequency the pose is minus the acceleration, and the
cable's stiffness IS a gain. Wrenches are normalised throughout: over the range of their axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truewrench import _core
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import BlindTo

FORCE = 1e-3  # fraction of range: the force that follows the pose whose effect is told
DELAY = 1e-3  # [s] whose effect is told
HIDDEN_DELAY = 0.9
"""Share of what a delay does to the raw channels, from which on the gain is said to hide it."""

_RANK = 1e-10  # of singular values, relative to the largest: a tolerance


@dataclass(frozen=True, slots=True, eq=False)
class DelayShare:
    """What a small delay tau of the sensor looks like: raw changes by -tau C dw/dt."""

    share: float  # R^2 of dw/dt on (w, 1), all axes together
    slope: Array  # (6, 6) M of the regression dw/dt = M w + const [1/s]: the gain moves by -tau C M


def delay_share(time: Array, wrench: Array) -> DelayShare:
    """What a delay looks like in one gap-free record; arguments as for `pose_share`."""
    return pooled_delay_share([np.gradient(wrench, time, axis=0)], [wrench])


def pooled_delay_share(rates: Sequence[Array], wrenches: Sequence[Array]) -> DelayShare:
    """The same of several records, from dw/dt (N, 6) [1/s] and w (N, 6) of each."""
    rate, w = (np.concatenate([_centred(x) for x in rows]) for rows in (rates, wrenches))
    total = float(np.sum(rate**2))
    if not total > 0.0:
        return DelayShare(0.0, np.zeros((6, 6)))
    slope = np.linalg.lstsq(w, rate, rcond=_RANK)[0].T
    return DelayShare(1.0 - float(np.sum((rate - w @ slope.T) ** 2)) / total, slope)


def blind_to(
    pose: _core.PoseShare,
    delay: DelayShare,
    *,
    gain: Array | None = None,
    ceiling: float = np.inf,
) -> tuple[BlindTo, ...]:
    """What would move some gain and leave no trace.

    A delay is named where the normalised gain (n, 6), the identity if left out, hides most of it: elsewhere
    the data show it. Nothing moves a gain beyond `ceiling`, 1 sigma that is known of it beforehand.
    """
    # (10.10): f sqrt( largest diagonal of A / (1 - A) (E w w^T)^-1 / 6 )
    effect = min(FORCE * float(np.sqrt(np.diag(pose.unit_covariance).max())), ceiling)
    found = [
        BlindTo(
            "cable",
            FORCE,
            effect,
            f"a force of {100 * FORCE:.2g} % of range that follows the pose (a cable) would move some gain "
            f"by {100 * effect:.2g} % and leave no trace: the motion can hide {100 * pose.A:.0f} % of "
            "its pose",
        )
    ]
    if delay.share >= HIDDEN_DELAY:
        moved = delay.slope if gain is None else gain @ delay.slope
        effect = min(DELAY * float(np.abs(moved).max()), ceiling)
        found.append(
            BlindTo(
                "delay",
                DELAY,
                effect,
                f"a delay of {1e3 * DELAY:.2g} ms between sensor and motion would move some gain by "
                f"{100 * effect:.2g} % and leave no trace: {100 * delay.share:.0f} % of it looks like a gain",
            )
        )
    return tuple(found)


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean(axis=0)) if len(values) else values
