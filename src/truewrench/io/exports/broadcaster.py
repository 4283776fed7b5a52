"""Parameters of ros2_control's `force_torque_sensor_broadcaster`.

It publishes (value + offset) * multiplier of every axis by itself (`apply_sensor_offset`, then
`apply_sensor_multiplier`), so that what one axis feels of another stays in. The multipliers here are those of
least error over the sensor's range.
"""

from pathlib import Path

import numpy as np
import yaml

from truewrench.io.exports.loss import Loss, best_factors, diagonal_nominal, loss_of_factors
from truewrench.io.exports.words import introduction, losses
from truewrench.model.arrays import Array
from truewrench.model.calibration import AXES, Calibration

_LEAST = 0.1  # of the nominal factor: a channel that feels less of its axis than that is another axis'


def unfit(calibration: Calibration) -> str | None:
    """Why one factor per axis cannot stand for a calibration at all."""
    nominal = diagonal_nominal(calibration)
    if nominal is None:
        return (
            "it knows six channels, each of them one wrench axis; a sensor with this nominal gain has others"
        )
    for axis, factor, believed in zip(AXES, np.diag(calibration.gain), nominal, strict=True):
        if factor / believed < _LEAST:
            return (
                f"the channel of {axis} hardly feels {axis}: one factor per axis cannot stand for this gain"
            )
    return None


def loss(calibration: Calibration) -> Loss:
    """What is lost against the whole gain."""
    nominal = diagonal_nominal(calibration)
    assert nominal is not None  # `unfit` has looked
    return loss_of_factors(calibration, best_factors(calibration), 1.0 / nominal)


def write(calibration: Calibration, path: Path) -> None:
    """Offsets and multipliers, to be merged with the controller's own parameters."""
    words = [
        *introduction(calibration),
        "ros2_controllers from 5.0 on (offset from 4.16). The first key is the controller's name: adapt it.",
        "Published is (raw + offset) * multiplier, axis by axis: what an axis feels of the others stays in.",
        *losses(loss(calibration)),
        "The whole gain: `truewrench apply` and `truewrench stream`, or matrix.txt in your own driver.",
    ]
    parameters = {
        "force_torque_sensor_broadcaster": {
            "ros__parameters": {
                "offset": _by_axis(-calibration.offset),
                "multiplier": _by_axis(best_factors(calibration)),
            }
        }
    }
    comment = "".join(f"# {line}\n" for line in words)
    path.write_text(comment + yaml.safe_dump(parameters, sort_keys=False), encoding="utf-8")


def _by_axis(values: Array) -> dict[str, dict[str, float]]:
    numbers = [float(value) + 0.0 for value in values]  # + 0.0: no minus zero
    return {
        "force": dict(zip("xyz", numbers[:3], strict=True)),
        "torque": dict(zip("xyz", numbers[3:], strict=True)),
    }
