"""The joints of an arm as streams of the window estimators (docs/method.md, "Joints")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.track import tracked_streams

__all__ = ["add_tracked_motion"]

Array = NDArray[np.float64]


def add_tracked_motion(streams: _core.RecordedLog, rig: Rig, log: Log, origin_ns: int, time: Array) -> None:
    """Add the motion of a joint log to its streams.

    Args:
        streams: that the motion is added to.
        rig: noise of the joints.
        log: with its tracking.
        origin_ns: that the times count from.
        time: (N,) of the log's rows [s].
    """
    assert log.tracking is not None
    reference = log.tracking.reference
    if reference is not None:
        later = (reference.origin_ns - origin_ns) * 1e-9
        streams.set_reference((reference.breakpoints + later).tolist(), reference.twist, reference.spacing)
        if reference.gravity is not None:
            streams.set_gravity(reference.gravity_time + later, reference.gravity)
    for stream in tracked_streams(rig, log):
        streams.add_motion(
            stream.order,
            np.ascontiguousarray(time[stream.rows]),
            np.ascontiguousarray(stream.value),
            np.ones(6),
            covariance=stream.covariance,
            coupling=stream.coupling,
        )
