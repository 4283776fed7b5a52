"""What follows the pose, in static poses: as much of it may hide in the gain as shows in their scatter.

At rest the pose is the wrench. Of hysteresis, creep or a cable, a part is linear in the weight and is taken
for gain; what is left scatters the poses. The hidden part is taken to be as large as what scatters them
beyond what sensors do, f, along any direction of the weight (METHOD (10.10), where A / (1 - A) is 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truewrench.estimation.estimate import Estimate
from truewrench.estimation.static_poses import REPEATABILITY
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import Assumed
from truewrench.model.rig import Rig
from truewrench.tool.bodies import weight
from truewrench.tool.parameters import Layout
from truewrench.tool.solve import Solution

PLAIN = 2.0  # times what sensors do, from which on it is said: words only
_RANK = 1e-9  # of the squares of weights, relative to the largest: tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Following:
    """What may hide beside the covariance that poses tell."""

    gain: Array  # (6n, 6n) normalised covariance of the gain
    offset: float  # variance of an offset of poses, of range: what follows these poses may have a mean

    def assumed(self) -> tuple[Assumed, ...]:
        """What is said of it, where sensors do not scatter as much."""
        size = float(np.sqrt(self.offset))
        if size < PLAIN * REPEATABILITY:
            return ()
        words = (
            f"poses come back to {100.0 * size:.2g}% of range, of sensors {100.0 * REPEATABILITY:.2g}%: "
            "hysteresis, creep or a cable, of which as much may follow the pose unseen; sigma covers it"
        )
        what = "hysteresis, cable: scatter of the poses, fraction of range"
        return (Assumed(what, "static poses", size, None, words),)

    def beside(self, rig: Rig, estimate: Estimate, at_rest: Sequence[int]) -> Estimate:
        """The estimate with it, some of whose logs are poses."""
        scale = rig.sensor.channel_scale
        added = np.zeros_like(estimate.normalised_covariance)
        added[: len(self.gain), : len(self.gain)] = self.gain
        offsets_std = estimate.offsets_std.copy()
        offsets_std[at_rest] = np.sqrt(offsets_std[at_rest] ** 2 + self.offset * scale**2)
        if len(offsets_std) - 1 in at_rest:
            added[len(self.gain) :, len(self.gain) :] = self.offset * np.eye(len(scale))
        units = np.append((scale[:, None] / rig.sensor.range_array).ravel(), scale)
        sigma = np.sqrt(np.maximum(np.diag(self.gain), 0.0)).reshape(-1, 6)
        return replace(
            estimate,
            sources=estimate.sources | ({"poses": sigma} if self.offset > 0.0 else {}),
            covariance=estimate.covariance + added * np.outer(units, units),
            normalised_covariance=estimate.normalised_covariance + added,
            offsets_std=offsets_std,
        )


def following(rig: Rig, solutions: Sequence[Solution], before: Array, after: Array) -> Following:
    """Of poses that took the normalised covariance (6n, 6n) of the gain from `before` to `after`.

    What hides as a gain K moves the estimate by (1 - P_after P_before^-1) K. The rows of K have the
    covariance f^2 / r (E w w^T)^+, of a force of size f along each of the r directions of the weights w. A
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
    K = np.kron(
        np.eye(rig.sensor.n),
        (vector[:, seen] * (f2 / max(int(seen.sum()), 1) / value[seen])) @ vector[:, seen].T,
    )
    told = np.eye(len(after)) - np.linalg.solve(before, after).T
    return Following(told @ K @ told.T, f2)


def weights(rig: Rig, solution: Solution) -> Array:
    """(T, 6) wrench of the payload as it was found, with the rig's sign."""
    layout, x = Layout(rig.sensor.n), solution.x
    fall = solution.problem.poses.R_sensor_root @ rig.gravity_array
    return rig.sensor.sign * weight(float(np.exp(x[layout.log_mass])), x[layout.center_of_mass], fall)


def _about_means(solution: Solution, w: Array) -> Array:
    """Each log has an offset of its own."""
    out, log = w.copy(), solution.problem.poses.log
    for k in np.unique(log):
        out[log == k] -= w[log == k].mean(axis=0)
    return out
