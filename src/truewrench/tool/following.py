"""What follows the pose in static poses, unseen: at rest the pose is the wrench.

Of hysteresis, creep or a cable, a part is linear in the weight: poses take it for gain, or for a body. What
is left scatters them. The hidden part is taken to be as large as what scatters them beyond what sensors do,
f, along any direction of the weight (METHOD (10.10), where A / (1 - A) is 1).
"""

from collections.abc import Sequence

import numpy as np

from truewrench.estimation.static_poses import REPEATABILITY
from truewrench.model.arrays import Array
from truewrench.model.rig import Rig
from truewrench.tool.bodies import weight
from truewrench.tool.solve import Solution

_RANK = 1e-9  # of the squares of weights, relative to the largest: tolerance


def hidden_gain(rig: Rig, solutions: Sequence[Solution]) -> tuple[Array, float]:
    """Covariance (6n, 6n), normalised, of the gain K that a force of size f looks like; and f^2.

    Its rows have the covariance f^2 / r (E w w^T)^+ along each of the r directions of the weights w. A
    discrepancy that is stated is the least f; 0 states that nothing follows the pose.
    """
    count = sum(len(s.problem.poses) for s in solutions)
    squares = sum(len(s.problem.poses) * s.repeatability**2 for s in solutions) / max(count, 1)
    noise = np.concatenate([s.problem.poses.variance for s in solutions]) / rig.sensor.channel_scale**2
    by_noise = float(noise.mean()) * np.sqrt(2.0 / max(noise.size, 1))  # 1 sigma of the scatter that it shows
    stated = rig.sensor.discrepancy
    f2 = max(squares - REPEATABILITY**2 - by_noise, 0.0)
    if stated != "auto":
        f2 = max(f2, stated**2) if stated > 0.0 else 0.0
    w = np.vstack([_about_means(s, weights(rig, s)) / rig.sensor.range_array for s in solutions])
    value, vector = np.linalg.eigh(w.T @ w / max(count, 1))
    seen = value > _RANK * max(float(value[-1]), np.finfo(np.float64).tiny)
    row = (vector[:, seen] * (f2 / max(int(seen.sum()), 1) / value[seen])) @ vector[:, seen].T
    return np.kron(np.eye(rig.sensor.n), row), f2


def beside_poses(solution: Solution) -> Array:
    """(p, p) what it adds to the covariance of what poses, and whatever else there is, told of x.

    K stands in the poses alone: it moves the estimate by P S K, S the information of the poses.
    """
    problem, rig = solution.problem, solution.problem.rig
    v = problem.vector
    out = np.zeros_like(solution.covariance)
    if not len(problem.poses):
        return out
    K, f2 = hidden_gain(rig, [solution])
    moved = solution.by_gain_of_poses * rig.sensor.gain_unit.ravel()
    out += moved @ K @ moved.T
    for log in np.unique(problem.poses.log).tolist():  # what follows these poses may have a mean
        place = v.offset(log)
        out[place, place] += f2 * np.diag(rig.sensor.channel_scale**2)
    return out


def weights(rig: Rig, solution: Solution) -> Array:
    """(T, 6) wrench of the body as it was found, with the rig's sign."""
    body, _ = solution.problem.total(solution.x)
    fall = solution.problem.poses.R_sensor_root @ rig.gravity_array
    return rig.sensor.sign * weight(float(np.exp(body[0])), body[1:4], fall)


def _about_means(solution: Solution, w: Array) -> Array:
    """Each log has an offset of its own."""
    out, log = w.copy(), solution.problem.poses.log
    for k in np.unique(log):
        out[log == k] -= w[log == k].mean(axis=0)
    return out
