"""Messages of several topics as rows of one table, in the order of their stamps."""

import heapq
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from truewrench.live.stamps import RESTART
from truewrench.model.errors import InputError

_PATIENCE = 0.05  # [s] after which a topic that is late is no longer waited for


@dataclass(order=True)
class MergedRow:
    """What was measured at one time."""

    time_ns: int  # stamp
    values: dict[str, float] = field(default_factory=dict, compare=False)  # by column
    # of the sensor's message; None where it has none at this time
    header: Any = field(default=None, compare=False)
    # when its first message came, on the clock of the caller [s]
    arrived: float = field(default=0.0, compare=False)


class Merger:
    """Rows come out once every topic that is waited for has gone past them, or after some patience.

    Awaited are sensor, motion and gravity. What comes from other topics (a temperature) goes with the next
    row.
    """

    def __init__(self, awaited: Sequence[str]) -> None:
        self._carried: dict[str, float] = {}
        self._begin(awaited)

    def _begin(self, awaited: Iterable[str]) -> None:
        self._newest: dict[str, float] = dict.fromkeys(awaited, -math.inf)
        self._heap: list[MergedRow] = []
        self._at: dict[int, MergedRow] = {}
        self._last = -math.inf

    def add(
        self,
        topic: str,
        time_ns: int,
        columns: Sequence[str],
        values: Sequence[float],
        header: Any,
        now: float,
    ) -> bool:
        """A message; whether with it stamps begin again, far back: rows that were not out yet are gone.

        InputError: rows after it have come out already.
        """
        if topic not in self._newest:
            self._carried.update(zip(columns, values, strict=True))
            return False
        again = time_ns <= self._last - RESTART
        if again:
            self._begin(list(self._newest))
        if time_ns <= self._last:
            raise InputError(
                f"stamp: found {time_ns} ns after {self._last:.0f} ns, expected time that increases"
            )
        row = self._at.get(time_ns)
        if row is None:
            row = self._at[time_ns] = MergedRow(time_ns, arrived=now)
            heapq.heappush(self._heap, row)
        row.values.update(zip(columns, values, strict=True))
        row.header = header or row.header
        self._newest[topic] = max(self._newest[topic], time_ns)
        return again

    def rows(self, now: float) -> Iterator[MergedRow]:
        """Those that are complete by now."""
        until = min(self._newest.values())
        while self._heap and (self._heap[0].time_ns <= until or now - self._heap[0].arrived > _PATIENCE):
            row = heapq.heappop(self._heap)
            del self._at[row.time_ns]
            self._last = row.time_ns
            row.values.update(self._carried)
            self._carried.clear()
            yield row
