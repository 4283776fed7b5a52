"""A log of static poses as rows that can be held against what the payload weighs.

A pose is one row: the mean of what it lasts. Between poses the offset walks, and each comes back a little
otherwise (docs/tool.md). How much, one rate and one repeatability for all channels as fractions of range, is
what the poses themselves make likeliest with any gain that the rig's prior allows, so that an error of the
gain that is judged is not taken for either.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize

from truewrench.estimation.static_poses import REPEATABILITY, SIZE_SPREAD, WALK, Poses, split_poses
from truewrench.estimation.unknowns import horizontal_axes
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.attitude import own_roots

FEWEST = 8  # poses: fewer tell the sizes apart from the gain by nothing but their priors


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """T poses."""

    variance: Array  # (T, n) of the channels, but for the walk [raw units]
    walk: Array  # (T, T) covariance of the walk about its mean over the poses, fraction of range
    by_tilt: Array  # (2, T, 3) of free fall in sensor axes, by gravity's tilt about two axes, 1 sigma
    common: bool  # whether the tilt is the same in all: something tells how poses are turned about gravity


def poses_of(rig: Rig, log: Log) -> tuple[Log, Poses]:
    """A log of static poses with a row for each."""
    poses = split_poses(rig, [log]).poses
    if len(poses) < FEWEST:
        expected = f"at least {FEWEST}, or 2 s of motion"
        raise InputError.at(log.path, "", f"{len(poses)} static poses with raw channels", expected)
    fall = poses.R_sensor_root @ rig.gravity_array
    still = np.zeros((len(poses), 6))
    return Log(log.path, log.payload, log.sha256, poses.time_ns, poses.raw, twist=still, gravity=fall), poses


def at_rest(rig: Rig, log: Log, poses: Poses, wrench: Array) -> AtRest:
    """The `poses_of` a log; `wrench` (T, 6) is what the payload weighs in them [N, N m]."""
    seconds = 1e-9 * (poses.time_ns - poses.time_ns[0])
    K = np.minimum(seconds[:, None], seconds)
    scale = rig.sensor.channel_scale
    rate, repeatability = _sizes(rig, poses, K, wrench)
    centred = K - K.mean(axis=0)
    centred = centred - centred.mean(axis=1)[:, None]
    turns = [
        poses.R_sensor_root @ np.cross(axis, rig.gravity_array) for axis in horizontal_axes(rig.gravity_array)
    ]
    return AtRest(
        poses.variance + (repeatability * scale) ** 2,
        rate**2 * centred,
        rig.gravity_tilt_prior * np.array(turns),
        len(own_roots(rig, log)) == 0,
    )


def _sizes(rig: Rig, poses: Poses, K: Array, wrench: Array) -> tuple[float, float]:
    """Rate and repeatability that are likeliest, gain and constant integrated out."""
    sensor, scale = rig.sensor, rig.sensor.channel_scale
    Q = null_space(np.ones((1, len(K)))).T  # (T - 1, T) what a constant leaves
    y = Q @ (poses.raw - wrench @ sensor.nominal_gain_array.T) / scale  # (T - 1, n)
    X = Q @ wrench / sensor.range_array
    free, walk = sensor.gain_prior**2 * X @ X.T, Q @ K @ Q.T
    given = np.einsum("at,tn,bt->nab", Q, poses.variance / scale**2, Q)
    start = np.log([WALK, REPEATABILITY])

    def evidence(sizes: Array) -> float:
        rate, own = np.exp(sizes)
        root = np.linalg.cholesky(free + given + rate**2 * walk + own**2 * np.eye(len(walk)))
        white = np.linalg.solve(root, y.T[:, :, None])
        logdet = 2.0 * float(np.log(np.diagonal(root, axis1=1, axis2=2)).sum())
        return float(np.sum(white**2)) + logdet + float(np.sum(((sizes - start) / SIZE_SPREAD) ** 2))

    found = minimize(evidence, start, method="Nelder-Mead", options={"xatol": 0.05, "fatol": 0.02})
    rate, own = np.exp(found.x)
    return float(rate), float(own)
