"""Which mistake of the set-up explains poses that do not fit: sign, axes, attitudes the other way round.

Asked only where something does not fit. A walk of the offset that is fast enough swallows any mistake, so the
recipe with a fixed offset judges: the reading as stated against the same with one mistake undone.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from truewrench.rig import Rig
from truewrench.tool.poses import Poses
from truewrench.tool.recipe import Recipe, recipe

__all__ = ["mistakes"]

Array = NDArray[np.float64]

_FITS = 0.5  # of what is left as stated: an explanation leaves less
_FEWEST = 6  # poses


def mistakes(rig: Rig, poses: Poses, gain_std: float) -> list[str]:
    """The likeliest mistake in words; none where no mistake explains the poses better than what is stated."""
    if len(poses) < _FEWEST or not rig.in_gravity:
        return []
    stated = recipe(rig, poses, np.arange(len(poses)))
    if stated.mass < 0.0 and _clear(rig, stated):
        return [_gains(2.0 / gain_std)]
    least = _FITS * _left(rig, stated)
    around = replace(poses, R_sensor_root=poses.R_sensor_root.transpose(0, 2, 1))
    found: list[tuple[float, str]] = []
    turned = recipe(rig, around, np.arange(len(poses)))
    if abs(turned.mass) > 0.0 and _left(rig, turned) < least:
        words = "The attitudes fit when taken the other way round (sensor to root, or root to sensor)."
        found.append((_left(rig, turned), words))
    back = np.linalg.pinv(rig.sensor.nominal_gain_array)
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.array_equal(turn, np.eye(3)):
                continue
            six = np.kron(np.eye(2), turn)
            raw = poses.raw @ back.T @ six.T @ rig.sensor.nominal_gain_array.T
            fit = recipe(rig, replace(poses, raw=raw), np.arange(len(poses)))
            if fit.mass > 0.0 and _left(rig, fit) < least:
                found.append((_left(rig, fit), _gains(float(np.abs(six - np.eye(6)).max()) / gain_std)))
    return [min(found)[1]] if found else []


def _gains(sigmas: float) -> str:
    return (
        f"The gains would have to be {sigmas:.0f} of their stated sigma away: sign, axes or units of the log "
        "are not as stated."
    )


def _left(rig: Rig, fit: Recipe) -> float:
    return float(np.sqrt(np.mean((fit.residual / rig.sensor.range_array) ** 2)))


def _clear(rig: Rig, fit: Recipe) -> bool:
    """Whether the weight stands out of what is left."""
    weight = abs(fit.mass) * float(np.linalg.norm(rig.gravity_array))
    return weight > 5.0 * float(np.sqrt(np.mean(fit.residual[:, :3] ** 2)))
