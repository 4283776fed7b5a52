"""Everything numeric of a calibration as NumPy arrays (`numpy.load` reads it without pickle)."""

from pathlib import Path

import numpy as np

from truewrench.model.calibration import AXES, Calibration


def write(calibration: Calibration, path: Path) -> None:
    """Arrays by name, and the verdict: `usable` and `reasons`."""
    with path.open("wb") as file:
        np.savez(
            file,
            gain=calibration.gain,
            gain_std=calibration.gain_std,
            offset=calibration.offset,
            offset_std=calibration.offset_std,
            inverse=calibration.inverse,
            covariance=calibration.covariance,
            channels=np.array(calibration.rig.sensor.channels),
            axes=np.array(AXES),
            range=calibration.rig.sensor.range_array,
            feels=np.array(calibration.rig.sensor.feels),
            usable=np.array(calibration.verdict.usable),
            reasons=np.array(calibration.verdict.reasons, dtype=np.str_),
        )
