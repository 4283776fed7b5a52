"""Whether logs of static poses tell the same sensor: each against the others (METHOD (10.11))."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truewrench.calibrating.reference_body import Known
from truewrench.calibrating.still_poses import StillEstimate
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.tool.agreement import apart, marginals
from truewrench.tool.parameters import Layout


def agreement_of_still(rig: Rig, logs: Sequence[Log], found: StillEstimate) -> Array:
    """(L,) how likely chance makes each log differ as much from the others in gain and gravity's tilt.

    About the estimate of all, each log with what the rig states and a walk of its own; payload and offset are
    integrated out. 1: of a single log.
    """
    p, layout = np.ones(len(logs)), Layout(rig.sensor.n)
    if len(logs) < 2:
        return p
    shared, poses = np.r_[layout.gain, layout.tilt], found.poses
    said = []
    for k, log in enumerate(logs):
        own = poses.of(poses.log == k)
        own = replace(own, log=np.zeros_like(own.log))
        problem, x = Known.stated(rig).problem(rig, log.payload, own, [int(log.time_ns[-1])])
        solution = found.solutions[log.payload]
        x[layout.gain], x[layout.offset] = found.estimate.gain.ravel(), found.estimate.offsets[k]
        for place in (layout.body, layout.tilt):
            x[place] = solution.x[place]
        mean, P = problem.prior_of_all()
        at = replace(solution, problem=problem, x=x, prior_mean=mean, prior_covariance=P)
        nothing = replace(problem, poses=own.of(own.log < 0))
        prior, says = marginals([nothing, problem], at, shared, together=False)
        said.append(says)
    return apart(prior, said, np.arange(shared.size))
