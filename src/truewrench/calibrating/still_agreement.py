"""Whether static poses tell the same sensor: each log against the others, and its halves (METHOD (10.11))."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truewrench.calibrating.reference_body import Known
from truewrench.calibrating.still_poses import StillEstimate
from truewrench.model.arrays import Array, Integers
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.tool.agreement import FEWEST, differences
from truewrench.tool.model_rows import Problem
from truewrench.tool.parameters import Layout


def agreement_of_still(rig: Rig, logs: Sequence[Log], found: StillEstimate) -> tuple[Array, Array]:
    """How likely chance makes each log differ as much from the others in gain and gravity's tilt (L,).

    And, (L,), its last poses from the first. About the estimate of all, each part with what the rig states;
    payload and offset are integrated out. 1: of a single log, and of few poses.
    """
    layout = Layout(rig.sensor.n)
    shared = np.r_[layout.gain, layout.tilt]

    def part(k: int, chosen: Integers) -> tuple[Problem, Array]:
        own = found.poses.of(chosen)
        own, name = replace(own, log=np.zeros_like(own.log)), logs[k].payload
        problem, x = Known.stated(rig).problem(rig, name, own, [int(logs[k].time_ns[-1])])
        x[layout.gain], x[layout.offset] = found.estimate.gain.ravel(), found.estimate.offsets[k]
        for place in (layout.body, layout.tilt):
            x[place] = found.solutions[name].x[place]
        return problem, x

    rows = [np.flatnonzero(found.poses.log == k) for k in range(len(logs))]
    p_logs, p_halves = np.ones(len(logs)), np.ones(len(logs))
    nothing = part(0, rows[0][:0])
    if len(logs) > 1:
        p_logs = differences([nothing, *(part(k, own) for k, own in enumerate(rows))], shared, shared)
    for k, own in enumerate(rows):
        if own.size >= FEWEST:
            half = own.size // 2
            p_halves[k] = differences([nothing, part(k, own[:half]), part(k, own[half:])], shared, shared)[0]
    return p_logs, p_halves
