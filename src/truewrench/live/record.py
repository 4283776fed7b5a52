"""A log that grows: samples of several streams, each at its own times, and one table of them all."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from truewrench.model.errors import InputError


class _Stream:
    """Samples of the same columns."""

    def __init__(self) -> None:
        self.time = array("q")
        self.values = array("d")


class Record:
    """What has arrived so far."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, ...], _Stream] = {}

    def add(self, names: tuple[str, ...], time_ns: int, values: Iterable[float]) -> None:
        """One sample, its columns in order, NaN where one has none, after that of the same columns before."""
        stream = self._streams.get(names)
        if stream is None:
            stream = self._streams[names] = _Stream()
        if stream.time and time_ns <= stream.time[-1]:
            raise InputError(f"time: {time_ns} ns after {stream.time[-1]} ns, expected time that increases")
        stream.time.append(time_ns)
        stream.values.extend(values)

    @property
    def samples(self) -> int:
        """Of all streams together."""
        return sum(len(stream.time) for stream in self._streams.values())

    @property
    def seconds(self) -> float:
        """From the first sample to the last."""
        times = [stream.time for stream in self._streams.values()]
        return 1e-9 * (max(t[-1] for t in times) - min(t[0] for t in times)) if times else 0.0

    def columns(self) -> Mapping[str, npt.NDArray[Any]]:
        """A table by time, `time_ns` first; NaN where a stream has no sample."""
        streams = {
            names: (np.array(stream.time), np.array(stream.values).reshape(-1, len(names)))
            for names, stream in self._streams.items()
        }
        time = np.unique(np.concatenate([np.zeros(0, np.int64), *(time for time, _ in streams.values())]))
        table: dict[str, npt.NDArray[Any]] = {"time_ns": time}
        for names, (at, values) in streams.items():
            rows = np.searchsorted(time, at)
            for name, column in zip(names, values.T, strict=True):
                whole = table.setdefault(name, np.full(len(time), np.nan))
                whole[rows] = np.where(np.isnan(column), whole[rows], column)
        return table
