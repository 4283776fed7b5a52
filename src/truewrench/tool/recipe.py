"""The recipe in use elsewhere: gain exact, offset fixed, ten linear parameters. A start, and a comparison."""

from dataclasses import dataclass

import numpy as np

from truewrench.estimation.static_poses import Poses
from truewrench.model.arrays import Array, Integers
from truewrench.model.motion.spatial import cross
from truewrench.model.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class Recipe:
    """Mass and mass times centre of mass."""

    mass: float  # [kg], of either sign
    moment: Array  # (3,) mass times centre of mass [kg m]
    residual: Array  # (T, 6) of all poses [N, N m]

    @property
    def center_of_mass(self) -> Array:
        """(3,) [m]."""
        return self.moment / (self.mass if abs(self.mass) > 1e-6 else 1e-6)


def recipe(rig: Rig, poses: Poses, chosen: Integers) -> Recipe:
    """Least squares on chosen poses by the nominal gain; what is left in all poses."""
    sensor = rig.sensor
    wrench = sensor.sign * poses.raw @ np.linalg.pinv(sensor.nominal_gain_array).T
    fall = poses.R_sensor_root @ rig.gravity_array
    T = len(poses)
    A = np.zeros((T, 6, 10))
    A[:, :3, 0] = fall
    for k, e in enumerate(np.eye(3)):
        A[:, 3:, 1 + k] = cross(e, fall)
    A[:, :, 4:] = np.eye(6)
    weight = 1.0 / sensor.range_array
    rows = (A[chosen] * weight[:, None]).reshape(-1, 10)
    found: Array = np.asarray(
        np.linalg.lstsq(rows, (wrench[chosen] * weight).ravel(), rcond=1e-9)[0], dtype=np.float64
    )
    return Recipe(float(found[0]), found[1:4], wrench - A @ found)
