"""The contact wrench beside the columns of a log, in one pass and constant memory."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truewrench.correction.added import Added, check_added, write_added
from truewrench.correction.contact.run import (
    CAPACITY,
    DELAY,
    NEW_COLUMNS,
    NEWEST_WINDOW,
    ContactEvent,
    ContactRun,
    Contacts,
    View,
)
from truewrench.io.cells import numbers
from truewrench.io.recordings.writer import mcap_output
from truewrench.io.table import Chunk, Table
from truewrench.io.tables import TimeReader, named_payload, open_table, raw_columns
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.channels import Rails
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.tool.model import Tool

TOPIC = "/truewrench/contact"
STD = "/truewrench/contact_std"
_NONE = "no row has the contact wrench: around none are there samples of sensor and motion within {:g} ms"


@dataclass(frozen=True, slots=True)
class ContactApplied:
    """What was done.

    Attributes:
        rows: of the log.
        found: how many of them have a contact wrench.
        events: contacts, in their order.
        notes: what is worth a look.
    """

    rows: int
    found: int
    events: tuple[ContactEvent, ...]
    notes: tuple[str, ...] = ()


def apply_contact(
    tool: Tool,
    log: str | Path,
    output: str | Path,
    *,
    calibration: Calibration | None = None,
    delay: float = DELAY,
    view: View | None = None,
    progress: Callable[[int], object] | None = None,
    max_rows: int | None = None,
) -> ContactApplied:
    """Write a log with the columns cfx ... cmz, cfx_std ... cmz_std and contact_chi2 added.

    All columns of the log are kept as they are, from CSV to CSV to the letter. Rows around which the kernels
    lack samples get empty cells.

    Args:
        tool: identified on the log's sensor.
        log: CSV, Parquet, or a recording, whose rows are the union of the stamps of its streams.
        output: CSV, Parquet or MCAP by its name; appears whole or not at all.
        calibration: of the sensor, for what its offset does with temperature.
        delay: half the length of the kernels [s], 0: they end at the row.
        view: where and how to express the wrench; the sensor's origin and axes by default.
        progress: called with the number of rows done so far.
        max_rows: that of `read_log`.

    Raises:
        InputError: naming file, row and column.
    """
    source = named_payload(log, tool.rig)[0]
    table: Table = open_table(source, tool.rig, max_rows=max_rows)
    check_added(output, table, NEW_COLUMNS)
    run = ContactRun(tool, table.names, calibration=calibration, delay=delay, view=view, place=source)
    done = _Pass(table, run, tool.rig, progress)
    if Path(output).suffix.lower() == ".mcap":
        robot = tool.rig.motion.robot
        with mcap_output(output, "sensor" if robot is None else robot.sensor_frame) as writer:
            for _, found in done.blocks(done.read):
                if len(found.rows):
                    writer.wrenches(TOPIC, found.time_ns, found.wrench)
                    writer.wrenches(STD, found.time_ns, found.columns[:, 6:12])
    else:
        write_added(output, table, NEW_COLUMNS, done.read, done.whole)
    lacking = () if done.found else (_NONE.format(1e3 * (2.0 * delay or NEWEST_WINDOW)),)
    return ContactApplied(
        done.rows, done.found, tuple(done.events), (*table.notes, *run.notes, *done.rails.notes, *lacking)
    )


class _Pass:
    """One pass over a table; a chunk is written once none of its rows can get a wrench any more."""

    def __init__(
        self, table: Table, run: ContactRun, rig: Rig, progress: Callable[[int], object] | None
    ) -> None:
        self.rows = self.found = 0
        self.events: list[ContactEvent] = []
        self._table, self._run, self._progress = table, run, progress
        self._raw = raw_columns(table, rig.sensor.n)
        self.rails = Rails(rig)
        self._time = TimeReader(table)
        self.read = list(dict.fromkeys([*self._time.columns, *(c for c in run.columns if c in table.names)]))

    def blocks(self, names: list[str] | None) -> Iterator[tuple[Chunk | None, Contacts]]:
        """Chunks in their order, each with the wrenches known with it; a last one without rows."""
        for chunk in self._table.chunks(names):
            time = self._time.read(chunk)
            columns = {
                name: numbers(chunk.column(name))[0]
                for name in self._run.columns
                if name in self._table.names
            }
            raw = np.column_stack([columns[name] for name in self._raw])
            self.rails.add(raw)
            found = self._run.feed(time, raw, columns)
            self.rows += chunk.rows
            yield chunk, self._counted(found)
            if self._progress is not None:
                self._progress(self.rows)
        if self.rows == 0:
            raise InputError.at(self._table.path, "", "no row", "at least one row below the header")
        yield None, self._counted(self._run.finish())

    def _counted(self, found: Contacts) -> Contacts:
        self.found += len(found.rows)
        self.events += self._run.events()
        return found

    def whole(self, names: list[str] | None) -> Added:
        """Chunks with their new columns (rows, 13)."""
        waiting: deque[tuple[Chunk, int, Array]] = deque()
        for chunk, found in self.blocks(names):
            if chunk is not None:
                waiting.append(
                    (chunk, self.rows - chunk.rows, np.full((chunk.rows, len(NEW_COLUMNS)), np.nan))
                )
            columns = found.columns
            for held, first, cells in waiting:
                here = (found.rows >= first) & (found.rows < first + held.rows)
                cells[found.rows[here] - first] = columns[here]
            while waiting and (chunk is None or waiting[0][1] + waiting[0][0].rows + CAPACITY < self.rows):
                held, _, cells = waiting.popleft()
                yield held, cells
