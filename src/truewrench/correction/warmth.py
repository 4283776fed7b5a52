"""What of a sensor's offset follows its temperature, while samples and readings arrive."""

from __future__ import annotations

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.temperature import where_apart


def where_told(calibration: Calibration) -> tuple[float, Array, Array] | None:
    """`where_apart` of a calibration; None where its offset follows nothing."""
    slope, n = calibration.offset_temperature_covariance, calibration.n
    if slope is None:
        return None
    scale = calibration.rig.sensor.channel_scale
    return where_apart(calibration.covariance, slice(6 * n, 7 * n), slope, scale)


class Warmth:
    """The offset by the latest reading; before there is one by the `first`, by default the reference."""

    def __init__(
        self,
        slope: Array | None,
        reference: float,
        first: float | None = None,
        spread: tuple[float, Array] | None = None,
    ) -> None:
        self._slope: Array = np.zeros(0) if slope is None else slope  # (n,) of the offset [per K]
        self.reference = reference  # temperature at which the offset is the calibration's [degC]
        self.latest = reference if first is None else first  # reading [degC]
        # what is not known of the slope: from which temperature on [degC], 1 sigma of a wrench (6,) [per K]
        self._middle, self._spread = (reference, np.zeros(6)) if spread is None else spread
        self.follows = bool(self._slope.any())  # whether the offset follows the temperature at all

    @classmethod
    def of(cls, calibration: Calibration, first: float | None = None) -> Warmth:
        """That of a calibration."""
        reference, told = calibration.rig.temperature.reference, where_told(calibration)
        spread = None
        if told is not None:
            above, _, std = told
            spread = reference + above, np.sqrt(np.nan_to_num(calibration.inverse) ** 2 @ std**2)
        return cls(calibration.offset_temperature, reference, first, spread)

    @property
    def shift(self) -> Array:
        """(n,) what the offset is beyond that at the reference, by the latest reading."""
        return np.asarray((self.latest - self.reference) * self._slope)

    @property
    def note(self) -> tuple[str, ...]:
        """What is worth saying where no temperature is known."""
        if not self.follows:
            return ()
        reference = f"{self.reference:g} degC"
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

    def widened(self, std: Array, celsius: Array | float) -> Array:
        """1 sigma (N, 6) or (6,) of wrenches, with what is not known of the slope, at (N,) or one [degC]."""
        away = np.asarray(celsius)[..., None] - self._middle
        return np.asarray(np.hypot(std, away * self._spread))

    def without(self, raw: Array, celsius: Array) -> Array:
        """Channels (N, n) at the reference temperature, of `held` ones (N,) [degC]."""
        return np.asarray(raw - np.outer(celsius - self.reference, self._slope))
