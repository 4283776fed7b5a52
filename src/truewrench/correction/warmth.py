"""What of a sensor's offset follows its temperature, while samples and readings arrive."""

from __future__ import annotations

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration


class Warmth:
    """The offset by the latest reading; before there is one by the `first`, by default the reference."""

    def __init__(self, slope: Array | None, reference: float, first: float | None = None) -> None:
        self._slope: Array = np.zeros(0) if slope is None else slope  # (n,) of the offset [per K]
        self._reference = reference  # temperature at which the offset is the calibration's [degC]
        self.latest = reference if first is None else first  # reading [degC]
        self.follows = bool(self._slope.any())  # whether the offset follows the temperature at all

    @classmethod
    def of(cls, calibration: Calibration, first: float | None = None) -> Warmth:
        """That of a calibration."""
        return cls(calibration.offset_temperature, calibration.rig.temperature.reference, first)

    @property
    def shift(self) -> Array:
        """(n,) what the offset is beyond that at the reference, by the latest reading."""
        return np.asarray((self.latest - self._reference) * self._slope)

    @property
    def note(self) -> tuple[str, ...]:
        """What is worth saying where no temperature is known."""
        if not self.follows:
            return ()
        reference = f"{self._reference:g} degC"
        return (f"no `temperature`, which the offset follows: it is taken for that of {reference}",)

    @property
    def note_until(self) -> tuple[str, ...]:
        """What is worth saying before the first reading, where one may come."""
        return tuple(f"{words} until one arrives" for words in self.note)

    def held(self, readings: Array) -> Array:
        """(N,) the latest of each row [degC], of readings (N,) with NaN where there is none."""
        known = np.append(self.latest, readings)
        last = np.maximum.accumulate(np.where(np.isnan(known), 0, np.arange(known.size)))
        held = known[last]
        self.latest = float(held[-1])
        return np.asarray(held[1:])

    def without(self, raw: Array, readings: Array) -> Array:
        """Channels (N, n) at the reference temperature; readings (N,) [degC], NaN where there is none."""
        return np.asarray(raw - np.outer(self.held(readings) - self._reference, self._slope))
