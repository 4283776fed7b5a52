"""Whether the clocks agree as well as a rig says (docs/method.md, "A filter in the sensor")."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from truewrench.estimate.windows import WindowEstimate
from truewrench.rig import Rig

__all__ = ["clock_doubts"]

TRUSTED = 1e-3  # [s] 1 sigma below which a stated clock is put to the test
WIDE = 5e-3  # [s] 1 sigma of the clock in that test
DOUBT = 5.0  # sigma


def clock_doubts(rig: Rig, estimate: Callable[[Rig], WindowEstimate]) -> list[str]:
    """Logs whose time offset, when it is asked for, is not what a rig with exact clocks says.

    A delay of the sensor or of the velocities, by a filter or a driver, goes into the gain without a trace in
    the residuals where the rig says that there is none.

    Args:
        rig: whose clock is stated to be good.
        estimate: on the logs, for a rig.
    """
    stated = rig.sensor.time_offset_prior
    if stated >= TRUSTED:
        return []
    sensor = rig.sensor.model_copy(update={"time_offset_prior": WIDE})
    found = estimate(rig.model_copy(update={"sensor": sensor}))
    if not found.solved:
        return []
    doubts = []
    for k, (offset, std) in enumerate(zip(found.time_offsets, found.time_offsets_std, strict=True)):
        if abs(offset) > DOUBT * np.hypot(std, stated):
            doubts.append(
                f"suspected set-up error: the data put the time offset of log {k + 1} at {1e3 * offset:.3g} "
                f"ms (sigma {1e3 * std:.2g} ms), the rig at 0 within {1e3 * stated:.2g} ms: a filter or a "
                "driver delays one of the streams; state a `time_offset_prior` that allows for it"
            )
    return doubts
