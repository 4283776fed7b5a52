"""What a calibration is made of besides its numbers: verdict, reports, and what the estimate assumed."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from truewrench.model.arrays import Array

AXES = ("fx", "fy", "fz", "mx", "my", "mz")  # the wrench axes, in order
UNITS = dict(zip(AXES, ["N"] * 3 + ["N m"] * 3, strict=True))  # of each

KINDS = (
    *("hysteresis", "nonlinearity", "cable", "filter", "delay", "clock", "jitter", "vibration"),
    *("gravity", "noise", "resolution", "drift", "step", "contact", "outliers"),
)
"""What a record may hold beside the model; whatever names it, names it by one of these."""


@dataclass(frozen=True, slots=True)
class Assumed:
    """An alternative that the estimate needed beside the rig as stated.

    Attributes:
        what: it is, with the unit of its value; what a record holds beside the model by one of `KINDS`.
        where: which log, channel, axis or time it concerns.
        value: of the alternative.
        sigma: its 1 sigma, None where none is known.
        evidence: what spoke for it, in words.
    """

    what: str
    where: str
    value: float
    sigma: float | None = None
    evidence: str = ""


@dataclass(frozen=True, slots=True)
class BlindTo:
    """What the record could not have shown.

    Attributes:
        kind: one of `KINDS`.
        size: of it: of a force that follows the pose a fraction of range, of a delay [s].
        effect: by how much it would move some gain and leave no trace, normalised.
        words: the same for a person.
    """

    kind: str
    size: float
    effect: float
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Undetermined:
    """A direction of the gain that the data say nothing about.

    Attributes:
        direction: (6n,) unit vector over the normalised gains, row by row.
        words: the same for a person, such as "moment about z: gains of all channels".
    """

    direction: Array
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Whether the result may be used as it stands.

    Attributes:
        usable: or not.
        reasons: every one why not.
        undetermined: directions that the data say nothing about.
        blind_to: what the record could not have shown.
    """

    usable: bool
    reasons: tuple[str, ...] = ()
    undetermined: tuple[Undetermined, ...] = ()
    blind_to: tuple[BlindTo, ...] = ()

    @property
    def undetermined_words(self) -> list[str]:
        """The directions of the gain that the data leave open, alike ones together."""
        count = Counter(direction.words for direction in self.undetermined)
        return [f"{words} ({n} directions)" if n > 1 else words for words, n in count.items()]

    def to_mapping(self) -> dict[str, Any]:
        """As every file and the command line have it."""
        unknown = [{"direction": u.direction.tolist(), "words": u.words} for u in self.undetermined]
        return {
            "usable": self.usable,
            "reasons": list(self.reasons),
            "undetermined": unknown,
            "blind_to": [asdict(blind) for blind in self.blind_to],
        }


@dataclass(frozen=True, slots=True)
class AxisImprovement:
    """RMS residual of one wrench axis with the nominal and with the new gain [N or N m]."""

    nominal: float
    new: float
    held_out: bool
    better: Literal[True, False, "unsure"]


@dataclass(frozen=True, slots=True)
class Bound:
    """What no estimator can beat, as RMS of sigma over the normalised gains."""

    oracle_rms: float  # when the motion is known
    rms: float  # when the motion has to be inferred from the log


@dataclass(frozen=True, slots=True, eq=False)
class LogReport:
    """What one log contributed."""

    path: Path | None  # as it was given, None for a log that was not read from a file
    sha256: str  # of the file, empty likewise
    payload: str  # which payload of the rig the arm carried
    offset: Array  # (n,) of this log [raw units]
    offset_std: Array  # (n,) its 1 sigma
    time_offset: float = 0.0  # [s], t_motion = t_sensor + time_offset
    used: int = 0  # samples that the estimate rests on
    masked: Mapping[str, int] = field(default_factory=dict)  # samples left out one by one, by reason
    # samples that the estimate could not use at all, by reason
    rejected: Mapping[str, int] = field(default_factory=dict)
    # (begin, end) of what was left out as contact or spike [s from the log's first row]
    disturbances: tuple[tuple[float, float], ...] = ()
    dropped_rows: int = 0  # rows of the log without any measurement
    # cells that held NaN and were left out, by column
    nan_counts: Mapping[str, int] = field(default_factory=dict)
