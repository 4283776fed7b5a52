"""What follows the pose, in static poses: as much of it may hide in the gain as shows in their scatter."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truewrench.estimation.estimate import Estimate
from truewrench.estimation.static_poses import REPEATABILITY
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import Assumed
from truewrench.model.rig import Rig
from truewrench.tool.following import hidden_gain
from truewrench.tool.solve import Solution

PLAIN = 2.0  # times what sensors do, from which on it is said: words only


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
        units = np.append(rig.sensor.gain_unit.ravel(), scale)
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

    What hides as a gain K (`hidden_gain`) moves the estimate by (1 - P_after P_before^-1) K.
    """
    K, f2 = hidden_gain(rig, solutions)
    told = np.eye(len(after)) - np.linalg.solve(before, after).T
    return Following(told @ K @ told.T, f2)
