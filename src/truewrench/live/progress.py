"""What a live calibration knows by now."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration


@dataclass(frozen=True, slots=True)
class Progress:
    """What a part of the record says."""

    time_ns: int  # of its last sample
    seconds: float  # its length
    samples: int  # how many there are
    calibration: Calibration | None = None  # None where there is not enough to estimate from
    reason: str = ""  # why there is none
    final: bool = False  # whether it is the result

    @property
    def usable(self) -> bool:
        """Whether the calibration may be used as it stands."""
        return self.calibration is not None and self.calibration.verdict.usable

    @property
    def reasons(self) -> list[str]:
        """Why not, if not."""
        return [self.reason] if self.calibration is None else list(self.calibration.verdict.reasons)

    def to_mapping(self) -> dict[str, Any]:
        """For programs."""
        data: dict[str, Any] = {
            "time_ns": self.time_ns,
            "seconds": self.seconds,
            "samples": self.samples,
            "final": self.final,
            "usable": self.usable,
            "reasons": self.reasons,
        }
        found = self.calibration
        if found is None:
            return data
        return data | {
            "undetermined": [direction.words for direction in found.verdict.undetermined],
            "rms": None if found.bound is None else _finite(found.bound.rms),
            "fits": found.figures.get("fits"),
            "knot_spacing": [_finite(h) for h in found.figures.get("knot_spacing") or ()],
            "gain": _lists(found.gain),
            "gain_std": _lists(found.gain_std),
            "offset": _lists(found.offset),
            "offset_std": _lists(found.offset_std),
        }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _lists(values: Array) -> Any:
    plain = values.astype(object)
    plain[~np.isfinite(values)] = None
    return plain.tolist()
