"""JSON lines with the contact wrench: an answer a line, the numbers of `apply`; tares and events between."""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from truewrench.correction.contact.run import NEW_COLUMNS, ContactRun, Contacts
from truewrench.live.json_lines import Lines, in_order
from truewrench.live.json_rows import LineError, Row, motion_of, read_row, tare_of
from truewrench.live.lines import Output
from truewrench.live.stamps import Order
from truewrench.live.stop import Stop
from truewrench.model.errors import InputError

Complain = Callable[[str], None]


class LiveContact:
    """Rows one by one, of a run that has seen none yet."""

    def __init__(self, run: ContactRun) -> None:
        self.run = run

    def feed(self, time_ns: int, raw: tuple[float, ...], motion: dict[str, float]) -> Contacts | None:
        """The wrench of the row that is a constant number of rows with samples earlier, where it has one."""
        columns = {name: np.array([value]) for name, value in motion.items()}
        found = self.run.feed(np.array([time_ns], dtype=np.int64), np.array([raw]), columns)
        # the first of all, and missing samples, bring older ones too, whose rows have been answered
        if not len(found.rows) or found.rows[-1] < self.run.due:
            return None
        return Contacts(
            found.rows[-1:], found.time_ns[-1:], found.wrench[-1:], found.covariance[-1:], found.chi2[-1:]
        )

    def events(self) -> list[dict[str, Any]]:
        """Contacts that have ended, as lines."""
        return [event.to_mapping() for event in self.run.events()]

    def tare(self) -> dict[str, Any]:
        """Tare now: the answer as a line."""
        accepted, reason = self.run.tare()
        return {"event": "tare", "accepted": accepted, "reason": reason}


def contact_lines(
    run: ContactRun, n: int, output: Output, stop: Stop, complain: Complain, source: int | None = None
) -> Lines:
    """Write the contact wrench for every line, until the input ends or `stop`.

    A line has raw channels, motion, or both. `{"tare": true}` is answered by a line with `event`; contacts
    that have ended have such lines, too. The run has seen no row yet; `complain` is told of wrong lines; the
    source is a file descriptor, by default of standard input.
    """
    for note in run.notes:
        complain(note)
    live, lines, order = LiveContact(run), Lines(output, complain), Order()
    nothing = (math.nan,) * n

    def use(line: bytes) -> None:
        if tare_of(line):
            output.write(json.dumps(live.tare()))
            return
        row = read_row(line, n)
        motion = motion_of(row)
        if row.raw is None and not motion:
            raise LineError("found neither channels nor motion, expected columns of a log")
        if in_order(row, order, complain):
            run.restart()
        try:
            found = live.feed(row.time_ns, row.raw or nothing, motion)
        except InputError as error:
            raise LineError(str(error)) from None
        order.last = row.time_ns
        output.write(_line(row, found))
        for event in live.events():
            output.write(json.dumps(event))

    lines.run(use, source, stop)
    run.finish()
    for event in live.events():
        output.write(json.dumps(event))
    return lines


def _line(row: Row, found: Contacts | None) -> str:
    data: dict[str, float | int | None] = dict([row.stamp])
    if found is None:
        return json.dumps(data | dict.fromkeys(NEW_COLUMNS) | {"contact_time_ns": None})
    data.update(zip(NEW_COLUMNS, found.columns[0].tolist(), strict=True))
    return json.dumps(data | {"contact_time_ns": int(found.time_ns[0])})
