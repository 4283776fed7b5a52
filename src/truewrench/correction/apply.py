"""The true wrench beside the raw channels of a log, in one pass and constant memory."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truewrench import _core
from truewrench.correction.added import Added, check_added, write_added
from truewrench.correction.warmth import Warmth, where_told
from truewrench.io.cells import numbers
from truewrench.io.table import Chunk, Table
from truewrench.io.tables import TimeReader, named_payload, open_table, raw_columns
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration import AXES, Calibration
from truewrench.model.channels import Rails
from truewrench.model.errors import InputError

NEW_COLUMNS = (*AXES, *(f"{axis}_std" for axis in AXES))


@dataclass(frozen=True, slots=True)
class Applied:
    """What was done: rows of the log, how many of them have a wrench, and what is worth a look."""

    rows: int
    corrected: int
    notes: tuple[str, ...] = ()


def apply(
    calibration: Calibration,
    log: str | Path,
    output: str | Path,
    *,
    progress: Callable[[int], object] | None = None,
    max_rows: int | None = None,
) -> Applied:
    """Write a log with the columns fx ... mz and fx_std ... mz_std added [N, N m].

    The wrench acts at the sensor origin, along the sensor axes, in the sign of the rig's `sensor.feels`. All
    columns of the log are kept as they are, from CSV to CSV to the letter; rows in which a raw channel has no
    sample get empty cells. An offset that follows temperature is that of the latest reading in the column
    `temperature`; before the first one no wrench is told, and without the column it is that of the reference.
    The rows of a recording are the union of the stamps of its streams. The output, CSV, or Parquet where its
    name ends so, appears whole or not at all; `progress` is told the number of rows done so far. `max_rows`
    is that of `read_log`.
    """
    source = named_payload(log, calibration.rig)[0]
    run = Run(calibration, source, output, progress, max_rows)
    check_added(output, run.table, NEW_COLUMNS)
    write_added(output, run.table, NEW_COLUMNS, run.read, run.added)
    return run.applied


class Run:
    """One pass over a log, without a payload; refused if it lacks channels or is the output."""

    def __init__(
        self,
        calibration: Calibration,
        source: Path,
        output: str | Path,
        progress: Callable[[int], object] | None,
        max_rows: int | None = None,
    ) -> None:
        self.table: Table = open_table(source, calibration.rig, whole=False, max_rows=max_rows)
        check_added(output, self.table)
        self._rows = 0
        self._corrected = 0
        self._corrector = corrector(calibration, source)
        self._withheld = np.tile(calibration.withheld, 2)
        self._raw = raw_columns(self.table, calibration.n)
        self._rails = Rails(calibration.rig)
        self._time = TimeReader(self.table)
        self._warmth = Warmth.of(calibration, np.nan)
        told = self._warmth.follows and "temperature" in self.table.names
        self._celsius = ("temperature",) if told else ()
        self._weighed = without_weight(calibration)
        self._in_part = used_in_part(calibration)
        self._progress = progress

    @property
    def applied(self) -> Applied:
        """What has been done so far."""
        untold = () if self._celsius else self._warmth.note
        notes = (*self.table.notes, *untold, *self._weighed, *self._in_part, *self._rails.notes)
        return Applied(self._rows, self._corrected, notes)

    @property
    def read(self) -> list[str]:
        """Columns that a wrench takes."""
        return [*self._time.columns, *self._raw, *self._celsius]

    def samples(self) -> Iterator[tuple[Integers, Array, Array]]:
        """Stamps (N,), raw (N, n), wrenches and their sigma (N, 12), where all channels have a sample."""
        for chunk in self.table.chunks(self.read):
            time, raw, new = self._correct(chunk)
            complete = ~np.isnan(new).all(axis=1)
            yield time[complete], raw[complete], new[complete]
        self._check_rows()

    def added(self, names: list[str] | None) -> Added:
        """Chunks of the columns named, each with wrenches and their sigma."""
        for chunk in self.table.chunks(names):
            yield chunk, self._correct(chunk)[2]
        self._check_rows()

    def _correct(self, chunk: Chunk) -> tuple[Integers, Array, Array]:
        time = self._time.read(chunk)
        raw = np.column_stack([numbers(chunk.column(name))[0] for name in self._raw])
        self._rails.add(raw)
        new = np.full((chunk.rows, len(NEW_COLUMNS)), np.nan)
        compensated, celsius = raw, np.full(chunk.rows, self._warmth.reference)
        if self._celsius:
            celsius = self._warmth.held(numbers(chunk.column("temperature"))[0])
            compensated = self._warmth.without(raw, celsius)
        complete = ~np.isnan(compensated).any(axis=1)
        wrench, std = self._corrector.correct(compensated[complete])
        new[complete] = np.hstack([wrench, self._warmth.widened(std, celsius[complete])])
        self._rows += chunk.rows
        self._corrected += int(np.isfinite(new[:, 0]).sum())
        new[:, self._withheld] = np.nan
        if self._progress is not None:
            self._progress(self._rows)
        return time, raw, new

    def _check_rows(self) -> None:
        if self._rows == 0:
            raise InputError.at(self.table.path, "", "no row", "at least one row below the header")
        if self._corrected == 0:
            known = " and a temperature" if self._celsius else ""
            raise InputError.at(self.table.path, "", f"no row with all raw channels{known}", "at least one")


def used_in_part(calibration: Calibration) -> tuple[str, ...]:
    """What is worth saying where some axes of a calibration may be used and others not."""
    axes = [axis for axis, held in zip(AXES, calibration.withheld, strict=True) if held]
    return (f"{', '.join(axes)}: left empty, the calibration may not be used on them",) if axes else ()


def without_weight(calibration: Calibration) -> tuple[str, ...]:
    """What is worth saying where samples are corrected from which the driver has subtracted a weight."""
    body = calibration.rig.sensor.subtracted
    if body is None:
        return ()
    return (
        f"the driver has subtracted the weight of {body.mass:g} kg (sensor.compensated), which is not added "
        "back here: the wrench lacks it, and is off by that weight times what the gain departs from nominal",
    )


def corrector(calibration: Calibration, source: str | Path) -> _core.Corrector:
    """What turns raw samples into wrenches and their 1 sigma: of noise, gain, offset, u (10.3), d (10.2).

    An offset that follows temperature is as well known as in the middle of the temperatures that told it.

    The gain is the tangent at no wrench; what a channel departs from it is part of sigma, and not corrected.
    A gain that cannot be inverted is an InputError, which names the source of the samples.
    """
    scale, nothing = calibration.rig.sensor.channel_scale, np.zeros(calibration.n)
    quadratic = discrepancy = nothing
    if calibration.quadratic is not None and calibration.quadratic_std is not None:
        quadratic = np.hypot(calibration.quadratic, calibration.quadratic_std) / scale
    if calibration.discrepancy is not None:
        discrepancy = calibration.discrepancy * scale
    noise, told = calibration.rig.sensor.noise_array, where_told(calibration)
    covariance = calibration.covariance if told is None else told[1]  # away from there: `Warmth.widened`
    try:
        return _core.Corrector(
            calibration.gain, calibration.offset, noise, covariance, quadratic, discrepancy
        )
    except ValueError as error:
        raise InputError(f"{source}: cannot be corrected: {error}") from error
