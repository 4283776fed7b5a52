"""Whether the clocks agree as well as a rig says (docs/method.md, "A filter in the sensor")."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from truewrench import _core
from truewrench.estimate.clock_information import ClockInformation
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.estimate.windows import with_clock
from truewrench.log import Log
from truewrench.rig import Rig

__all__ = ["clock_doubts", "clock_overclaimed", "delay_excluded"]

TRUSTED = 1e-3  # [s] 1 sigma below which a stated clock is put to the test
WIDE = 5e-3  # [s] 1 sigma of the clock in that test
DOUBT = 5.0  # sigma
OVERCLAIMED = 0.6  # of the best possible sigma
FEWER = 0.9  # share of the samples that a free clock must explain of those that the stated one does
DEPENDENCE = _core.EstimatorSettings().dependence_sigma
_COORDINATES, _DEGREE = 6, 5


def clock_doubts(rig: Rig, logs: Sequence[Log], estimate: Callable[[Rig], WindowEstimate]) -> list[str]:
    """Logs whose time offset, when it is asked for, is not what a rig with exact clocks says.

    A delay of the sensor or of the velocities, by a filter or a driver, goes into the gain without a trace in
    the residuals where the rig says that there is none.

    Args:
        rig: whose clock is stated to be good.
        logs: of the estimate.
        estimate: on the logs, for a rig.
    """
    stated = rig.sensor.time_offset_prior
    if stated >= TRUSTED:
        return []
    free = with_clock(rig, WIDE)
    found = estimate(free)
    if not found.solved:
        return []
    least, sigma = 0.0, np.hypot(found.time_offsets_std, stated)
    if found.knot_dependence > DEPENDENCE:  # and so may clock and sigma: only what is far off counts
        told = ClockInformation.of(free.sensor, logs[0], found.gain) if len(logs) == 1 else None
        if told is None:
            return []
        least, sigma = TRUSTED, np.hypot(sigma, told.sigma)
    suspected = np.abs(found.time_offsets) > np.maximum(DOUBT * sigma, least)
    if not suspected.any() or _worse(found, estimate(rig)):
        return []  # or the search with a free clock went astray
    doubts = []
    for k, (offset, std) in enumerate(zip(found.time_offsets, found.time_offsets_std, strict=True)):
        if suspected[k]:
            doubts.append(
                f"suspected set-up error: the data put the time offset of log {k + 1} at {1e3 * offset:.3g} "
                f"ms (sigma {1e3 * std:.2g} ms), the rig at 0 within {1e3 * stated:.2g} ms: a filter or a "
                "driver delays one of the streams; state a `time_offset_prior` that allows for it"
            )
    return doubts


def delay_excluded(rig: Rig, delay: float, estimate: Callable[[Rig], WindowEstimate]) -> bool:
    """Whether a clock that is asked for shows that nothing delays the sensor by so much, nor by half of it.

    Args:
        rig: whose clock is stated to be much better than the delay.
        delay: that the colour of the noise suggests [s].
        estimate: on the logs, for a rig.
    """
    found = estimate(with_clock(rig, max(WIDE, 2.0 * delay)))
    if not found.solved or found.knot_dependence > DEPENDENCE or found.clock_untold:
        return False
    sigma = np.hypot(found.time_offsets_std, rig.sensor.time_offset_prior)
    return bool((np.abs(found.time_offsets) + DOUBT * sigma < 0.5 * delay).all())


def clock_overclaimed(rig: Rig, logs: Sequence[Log], estimate: WindowEstimate) -> list[str]:
    """Whether the clock of one log is claimed better than it could be if all the motion were known."""
    if len(logs) != 1 or not rig.sensor.time_offset_prior > 0.0 or not estimate.solved:
        return []
    best = ClockInformation.of(rig.sensor, logs[0], estimate.gain)
    claimed = float(estimate.time_offsets_std[0])
    if best is None or claimed > OVERCLAIMED * best.sigma:
        return []
    return [
        f"the time offset is claimed to {1e3 * claimed:.2g} ms, and the log tells it no better than to "
        f"{1e3 * best.sigma:.2g} ms: in this motion a change of time looks like a change of the gain; state "
        "a smaller `time_offset_prior`, or move with more frequencies"
    ]


def _worse(free: WindowEstimate, stated: WindowEstimate) -> bool:
    """Whether a free clock explains the same logs clearly worse, which no true departure does.

    What an explanation costs, residuals and twice the coefficients (Akaike), is compared per sample used:
    a clock that is not known leaves out samples at the ends of windows.
    """
    (free_cost, free_used), (cost, used) = _cost(free), _cost(stated)
    if free_used < FEWER * used:
        return True
    if used == 0.0:
        return False
    chance = 1.0 + np.sqrt(2.0 * abs(used - free_used))
    return bool(free_cost * used / free_used - cost > DOUBT * chance)


def _cost(estimate: WindowEstimate) -> tuple[float, float]:
    """Chi-square and twice the coefficients of the windows that fit, and the samples in them."""
    fitted = [w for w in estimate.windows if w.status == _core.WindowStatus.fitted]
    coefficients = sum(_COORDINATES * (window.intervals + _DEGREE) for window in fitted)
    groups = [group for window in fitted for group in window.groups]
    cost = 2.0 * coefficients + sum(group.sum_of_squares for group in groups)
    return cost, float(sum(group.count for group in groups))
