"""JSON lines on standard input and output: wrenches of samples, or a calibration from them."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truewrench.correction.apply import corrector, used_in_part, without_weight
from truewrench.correction.warmth import Warmth
from truewrench.live.json_rows import LineError, Row, motion_of, read_row, stamp_of, temperature_of
from truewrench.live.lines import Output, batches
from truewrench.live.progress import Progress
from truewrench.live.stamps import Order
from truewrench.live.stop import Stop
from truewrench.model.calibration import AXES, Calibration
from truewrench.model.channels import Ranges
from truewrench.model.errors import InputError

if TYPE_CHECKING:  # all that an estimate needs takes a second to import
    from truewrench.live.session import LiveCalibration

INPUT = "standard input"

_KEYS = (*AXES, *(f"{axis}_std" for axis in AXES))
_POLL = 0.2  # [s] between looks at a running estimate, where no line arrives

Complain = Callable[[str], None]


class Lines:
    """What every line goes through."""

    def __init__(self, output: Output, complain: Complain) -> None:
        self.read = 0  # lines so far, blank ones left out
        self.refused = 0  # how many of them were wrong
        self.first = ""  # number and fault of the first of these
        self._number = 0
        self._output = output
        self._complain = complain

    def run(
        self,
        use: Callable[[bytes], None],
        source: int | None,
        stop: Stop,
        between: Callable[[], None] | None = None,
    ) -> None:
        """Use the lines of a source, by default standard input, until it, or the output, ends or `stop`.

        What is `between` batches is done every `_POLL` at the latest.
        """
        wait = None if between is None else _POLL
        for batch in batches(sys.stdin.fileno() if source is None else source, stop, wait):
            for line in batch:
                self._take(line, use)
            if between is not None:
                between()
            if self._output.closed:
                break

    def _take(self, line: bytes, use: Callable[[bytes], None]) -> None:
        """Use one line; where it is wrong, say so in its place."""
        self._number += 1
        if not line.strip():
            return
        self.read += 1
        try:
            use(line)
        except LineError as error:
            words = f"line {self._number}: {error}"
            self.first = self.first or words
            self.refused += 1
            self._output.write(json.dumps({"line": self._number, **stamp_of(line), "error": str(error)}))
            self._complain(f"{INPUT}: {words}")


def in_order(row: Row, order: Order, complain: Complain) -> bool:
    """Whether stamps begin again with a row, which is told; LineError: it is out of order."""
    try:
        again = order.check(row.time_ns, f"`{row.stamp[0]}`")
    except InputError as error:
        raise LineError(str(error)) from None
    if again:
        complain(f"{INPUT}: stamps begin again at {row.time_ns} ns")
    return again


def correct_lines(
    calibration: Calibration, output: Output, stop: Stop, complain: Complain, source: int | None = None
) -> Lines:
    """Write the true wrench and its 1 sigma for every line, until the input ends or `stop`.

    A line that is wrong gives `{"line": ..., "error": ...}` with its time in its place, and no wrench. One
    whose channels are null, which have no sample, gives nulls; so does one that tells a `temperature` alone,
    the latest of which counts where the offset follows it.
    """
    correct = corrector(calibration, INPUT).correct
    withheld = [*calibration.withheld, *calibration.withheld]
    warmth = Warmth.of(calibration)
    for note in (*warmth.note_until, *without_weight(calibration), *used_in_part(calibration)):
        complain(note)
    n = calibration.n
    sample = np.empty((1, n))
    lines, order, ranges = Lines(output, complain), Order(), Ranges(calibration.rig)

    def use(line: bytes) -> None:
        row = read_row(line, n)
        celsius = temperature_of(row) if warmth.follows else math.nan
        if row.raw is None and math.isnan(celsius):
            raise LineError(f"found no channel, expected `raw`, or raw_0 to raw_{n - 1}")
        in_order(row, order, complain)
        if not math.isnan(celsius):
            warmth.latest = celsius
        if row.raw is None or math.isnan(sum(row.raw)):
            values: list[float] = [math.nan] * len(_KEYS)
        else:
            sample[0] = row.raw
            wrench, std = correct(sample - warmth.shift if warmth.follows else sample)
            values = [*wrench[0].tolist(), *warmth.widened(std[0], warmth.latest).tolist()]
            if not all(map(math.isfinite, values)):
                raise LineError("found channels of such a size that no wrench can be told")
            if far := ranges.told(sample[0]):
                complain(f"{INPUT}: {far}")
            values = [math.nan if held else x for held, x in zip(withheld, values, strict=True)]
        order.last = row.time_ns
        output.write(_line(row, values))

    lines.run(use, source, stop)
    return lines


def _line(row: Row, values: list[float]) -> str:
    data: dict[str, float | None] = dict([row.stamp])
    data.update((key, None if math.isnan(x) else x) for key, x in zip(_KEYS, values, strict=True))
    return json.dumps(data)


def calibrate_lines(
    session: LiveCalibration,
    folder: Path | None,
    output: Output,
    stop: Stop,
    complain: Complain,
    source: int | None = None,
) -> tuple[Lines, Progress]:
    """Feed a calibration until the input ends or `stop`, then finish it in a folder.

    What is known on the way, and the result, go to the output. InputError: no calibration can be made of it.
    """
    n = session.rig.sensor.n
    channels = tuple(f"raw_{i}" for i in range(n))
    lines = Lines(output, complain)

    def use(line: bytes) -> None:
        row = read_row(line, n)
        values = motion_of(row)
        if row.raw is not None:
            values |= zip(channels, row.raw, strict=True)
        if not values:
            raise LineError("found neither channels nor motion, expected columns of a log")
        try:
            alone = session.record.add(tuple(values), row.time_ns, values.values())
        except InputError as error:
            raise LineError(str(error)) from None
        if alone:
            complain(f"{INPUT}: {alone}")

    def tell() -> None:
        if (progress := session.poll()) is not None:
            output.write(_progress(progress))

    try:
        lines.run(use, source, stop, between=tell)
    except OSError:  # of the output, whose disk is full, say: what has arrived is not lost with it
        session.finish(folder)
        raise
    final = session.finish(folder)
    output.write(_progress(final))
    return lines, final


def _progress(progress: Progress) -> str:
    return json.dumps(progress.to_mapping(), allow_nan=False)
