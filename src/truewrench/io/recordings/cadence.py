"""Count, order, rate and pauses of the stamps of a stream, in one pass."""

import numpy as np
import numpy.typing as npt

from truewrench.model.arrays import Array, Integers, Mask

_NEVER = np.iinfo(np.int64).min
_OCTAVE = 16  # bins of the lengths of periods, to a factor of two
_BINS = 64 * _OCTAVE
_PAUSE = 37  # bins that make five times the ordinary period
_RARE = 1 / 30  # share of the steps that may be pauses; what is more frequent belongs to the rate


class Cadence:
    """What stamps [ns] say, however they come: in packets, with pauses, out of order.

    The rate is that of samples over the time that they span. Left out are steps, either way, of more than
    five times the ordinary one, which all but the rarest stay below: one in thirty, in long streams no more
    than their square root, in shorter ones none. So the wait between packets counts, and a pause, a clock
    that was set and a wrong stamp do not.
    """

    def __init__(self) -> None:
        self.samples = 0
        self.late = 0  # samples with an earlier stamp than one before them
        self.repeated = 0  # samples with the latest stamp before them
        self.first = self.last = 0  # the earliest and the latest stamp [ns]
        self._before = 0
        # by the size of steps to the sample before: their number, sum [ns] and sum of squares [ns^2]
        self._steps = np.zeros((3, _BINS))
        self._periods = np.zeros(_BINS, dtype=np.int64)  # likewise, to the latest before: their number

    def add(self, stamps: Integers) -> Integers:
        """Stamps (N,) as they came; returns the latest before each."""
        if not len(stamps):
            return stamps
        latest = self.last if self.samples else _NEVER
        earlier = np.maximum.accumulate(np.concatenate([[latest], stamps[:-1]]))
        self.late += int((stamps < earlier).sum())
        self.repeated += int((stamps == earlier).sum())
        begin = 0 if self.samples else 1  # the first has no period
        step = np.diff(stamps, prepend=self._before)[begin:]
        size = _bin(np.abs(step))
        for row, weights in zip(self._steps, (None, step, np.square(step, dtype=np.float64)), strict=True):
            row += np.bincount(size, weights, _BINS)
        period = (stamps - earlier)[begin:]
        self._periods += np.bincount(_bin(period[period > 0]), minlength=_BINS)
        self.first = min(self.first, int(stamps.min())) if self.samples else int(stamps.min())
        self.last = int(max(stamps[-1], earlier[-1]))
        self._before = int(stamps[-1])
        self.samples += len(stamps)
        return earlier

    def is_pause(self, period: Integers) -> Mask:
        """Which periods [ns] are left out of the rate."""
        return _bin(period) > self._longest

    @property
    def pauses(self) -> int:
        """How many there are, in order of time."""
        return int(self._periods[self._longest + 1 :].sum())

    @property
    def rate(self) -> float:
        """Samples a second; 0 while there is none."""
        count, span, _ = self._kept
        return float(1e9 * count / span) if span else 0.0

    @property
    def jitter(self) -> float:
        """Standard deviation of the period over its mean, pauses left out."""
        count, span, squares = self._kept
        return float(np.sqrt(max(squares * count / span**2 - 1.0, 0.0))) if span else 0.0

    @property
    def _longest(self) -> int:
        """Size of the longest steps that are no pause."""
        below = np.cumsum(self._steps[0])
        count = below[-1]
        rare = np.floor(min(_RARE * count, np.sqrt(count)))
        return int(np.searchsorted(below, count - rare)) + _PAUSE if count else _BINS

    @property
    def _kept(self) -> Array:
        """Of steps that are no pause: number, sum, sum of squares."""
        kept: Array = self._steps[:, : self._longest + 1].sum(axis=1)
        # the last that came need not be the latest; what is between pauses is as long as its steps say
        kept[1] = self.last - self.first if kept[0] == self.samples - 1 else abs(kept[1])
        return kept


def _bin(size: Integers) -> npt.NDArray[np.intp]:
    """Of sizes [ns] from 0 on: 0 has one of its own."""
    return np.where(size > 0, 1 + (_OCTAVE * np.log2(np.maximum(size, 1))).astype(np.intp), 0)
