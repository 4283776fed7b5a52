"""What a calibration knows: gain and offset with their uncertainty, and the verdict on using them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from truewrench.rig import Rig

__all__ = [
    "AXES",
    "AxisImprovement",
    "Bound",
    "Calibration",
    "LogReport",
    "Undetermined",
    "Verdict",
    "load_calibration",
]

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
"""The wrench axes, in order."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Undetermined:
    """A direction of the gain that the data say nothing about.

    Attributes:
        direction: (6n,) unit vector over the normalised gains, row by row.
        words: the same for a person, such as "moment about z: gains of all channels".
    """

    direction: FloatArray
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Whether the result may be used as it stands, and every reason why not."""

    usable: bool
    reasons: tuple[str, ...] = ()
    undetermined: tuple[Undetermined, ...] = ()


@dataclass(frozen=True, slots=True)
class AxisImprovement:
    """RMS residual of one wrench axis with the nominal and with the new gain [N or N m]."""

    nominal: float
    new: float
    held_out: bool
    better: Literal[True, False, "unsure"]


@dataclass(frozen=True, slots=True)
class Bound:
    """What no estimator can beat, as RMS over the normalised gains.

    Attributes:
        oracle_rms: of the Cramer-Rao sigma when the motion is known.
        rms: of the stated sigma.
    """

    oracle_rms: float
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class LogReport:
    """What one log contributed.

    Attributes:
        path: as it was given, None for a log that was not read from a file.
        sha256: of the file, empty likewise.
        payload: which payload of the rig the arm carried.
        offset: (n,) of this log [raw units].
        offset_std: (n,) its 1 sigma.
        time_offset: [s], t_motion = t_sensor + time_offset.
        used: samples that the estimate rests on.
        gated: samples left out one by one, by reason.
        rejected: samples left out with their whole window, by reason.
    """

    path: Path | None
    sha256: str
    payload: str
    offset: FloatArray
    offset_std: FloatArray
    time_offset: float = 0.0
    used: int = 0
    gated: Mapping[str, int] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Gain and offset of raw = gain @ w + offset, in SI and raw units, and everything said about them.

    Attributes:
        gain: (n, 6), w in the sign of the rig's `sensor.feels`.
        gain_std: (n, 6) 1 sigma.
        offset: (n,) of the last log at its end, at the reference temperature.
        offset_std: (n,) 1 sigma.
        inverse: (6, n) noise-weighted generalised inverse of `gain`.
        covariance: (7n, 7n) of [gain row by row, offset].
        verdict: whether and why (not) to use it.
        logs: one report per log.
        rig: the settings it was made with.
        estimator: `map`, `online`, `ekf` or `ls`.
        improvement: per wrench axis; empty when it was not judged.
        bound: None for estimators that do not compute it.
        offset_temperature: (n,) slope of the offset per K, None without a temperature column.
        time_offset: of the last log [s].
        time_offset_std: its 1 sigma [s].
        payload_posterior: what the data say of each payload, by name; empty when payloads are taken as exact.
        figures: what the estimator reports of its fit, by name.
        timings: seconds spent, by phase.
        version: of the package that made it.
        created: ISO 8601 time, UTC.
    """

    gain: FloatArray
    gain_std: FloatArray
    offset: FloatArray
    offset_std: FloatArray
    inverse: FloatArray
    covariance: FloatArray
    verdict: Verdict
    logs: tuple[LogReport, ...]
    rig: Rig
    estimator: str
    improvement: Mapping[str, AxisImprovement] = field(default_factory=dict)
    bound: Bound | None = None
    offset_temperature: FloatArray | None = None
    time_offset: float = 0.0
    time_offset_std: float = 0.0
    payload_posterior: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)
    version: str = ""
    created: str = ""

    @property
    def n(self) -> int:
        """Number of raw channels."""
        return int(self.gain.shape[0])

    def wrench(self, raw: npt.ArrayLike) -> FloatArray:
        """The true wrench, (N, 6) [N, N m], of raw samples (N, n); NaN where a channel has none."""
        wrench: FloatArray = (np.asarray(raw, dtype=np.float64) - self.offset) @ self.inverse.T
        return wrench

    def write_yaml(self, path: str | Path) -> None:
        """Write `calibration.yaml`; the file appears whole or not at all."""
        from truewrench.io.calibration_file import write_calibration

        write_calibration(self, path)


def load_calibration(path: str | Path) -> Calibration:
    """Read and validate a `calibration.yaml`.

    Raises:
        InputError: naming file, key, what was found and what was expected.
    """
    from truewrench.io.calibration_file import read_calibration

    return read_calibration(path)
