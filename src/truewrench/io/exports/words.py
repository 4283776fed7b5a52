"""What every export says of itself, where its format has room for words."""

from collections.abc import Iterator

import numpy as np

from truewrench.io.exports.loss import Loss
from truewrench.model.arrays import Array
from truewrench.model.calibration import AXES, Calibration


def introduction(calibration: Calibration) -> Iterator[str]:
    """Who made it of what, in which units and with which sign, and whether to use it, line by line."""
    sensor = calibration.rig.sensor
    yield f"TrueWrench {calibration.version}, {calibration.created}, estimator {calibration.estimator}"
    yield from warning(calibration)
    yield f"Wrench [{' '.join(AXES)}] in N and N m, at the sensor's origin along its axes, {sensor.feels}."
    yield f"Raw channels: {' '.join(line(name) for name in sensor.channels)}"


def warning(calibration: Calibration) -> Iterator[str]:
    """Why not to use it; nothing for a calibration that is usable."""
    if not calibration.verdict.usable:
        yield "NOT TO BE USED AS IT STANDS:"
        yield from (f"- {line(reason)}" for reason in calibration.verdict.reasons)


def losses(loss: Loss) -> Iterator[str]:
    """What a file that holds less than the gain loses against it."""
    yield f"Lost against the whole gain, for {' '.join(AXES)} [N, N m]:"
    yield f"- at worst within the sensor's range: {numbers(loss.worst, 4)}"
    yield f"- RMS over loads spread evenly over the range: {numbers(loss.rms, 4)}"
    if not np.array_equal(loss.rms, loss.rms_before):
        yield f"- without any calibration, at worst: {numbers(loss.worst_before, 4)}"
        yield f"- without any calibration, RMS: {numbers(loss.rms_before, 4)}"


def numbers(values: Array, digits: int = 17) -> str:
    """Numbers, a space between two; with 17 digits to the last bit."""
    return " ".join(f"{float(value):.{digits}g}" for value in values)


def line(text: str) -> str:
    """Text of a user on one line, so that it ends no comment."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())
