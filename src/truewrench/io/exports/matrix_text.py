"""The matrix that a driver multiplies raw samples with, as plain text (`numpy.loadtxt` reads it)."""

from pathlib import Path

import numpy as np

from truewrench.io.exports.words import introduction, numbers
from truewrench.model.calibration import Calibration


def write(calibration: Calibration, path: Path) -> None:
    """Six rows of n numbers below a comment with units, sign and offset."""
    words = [
        *introduction(calibration),
        "wrench = matrix @ (raw - offset)",
        f"offset: {numbers(calibration.offset)}",
    ]
    np.savetxt(path, calibration.inverse, fmt="%.17g", header="\n".join(words), encoding="utf-8")
