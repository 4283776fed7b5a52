"""The tables of a report: plain text in cells, with a class for shading and a mark for those who see none."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from truewrench.model.calibration import AXES, Calibration, LogReport
from truewrench.model.calibration_parts import UNITS
from truewrench.model.rig.sections import ELEMENTS
from truewrench.report.summary import with_uncertainty

_NOTICED, _SMALL, _LARGE = 5e-4, 0.01, 0.05  # of full scale: departures that are named, shaded, and more so
SOURCES = {
    "center_of_mass": "centre of mass",
    "timing": "clocks",
    "gravity": "direction of gravity",
    "slow": "slow disturbance",
    "pose": "force that follows the pose",
}
"""What limits an accuracy, by other names than those of the figures."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Text, a second line, and how the cell is shaded."""

    text: str
    mark: str = ""
    shade: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """A header and its cells."""

    header: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """Column headers, the first above the row headers."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]


def gain_table(c: Calibration) -> Table:
    """Value with its sigma, departure from the nominal gain, and what the data do not determine."""
    sensor = c.rig.sensor
    departure = (c.gain - sensor.nominal_gain_array) / sensor.gain_unit
    rows = []
    for i, channel in enumerate(sensor.channels):
        cells = []
        for j in range(6):
            text = with_uncertainty(c.gain[i, j], c.gain_std[i, j])
            if not c.gain_determined[i, j]:
                cells.append(Cell(text, "○ not determined", "open"))
                continue
            share = float(departure[i, j])
            sign, side = ("▲", "up") if share > 0.0 else ("▼", "down")
            mark = f"{sign} {100 * share:+.2g} %" if abs(share) >= _NOTICED else "≈ nominal"
            shade = f"{side}-{'much' if abs(share) > _LARGE else 'some'}" if abs(share) >= _SMALL else ""
            cells.append(Cell(text, mark, shade))
        rows.append(Row(channel, tuple(cells)))
    return Table(
        "Gain, raw units of a channel (row) per N or N m of a wrench axis (column), ± 1 sigma; below it "
        "the departure from the nominal gain in % of full scale",
        ("channel", *(f"{axis} [1/{unit}]" for axis, unit in UNITS.items())),
        tuple(rows),
    )


def offset_table(c: Calibration) -> Table:
    """Of the last log; and the slope with temperature."""
    slope = c.offset_temperature
    columns = ("channel", "offset [raw]", *(() if slope is None else ("per K [raw/K]",)))
    rows = []
    for i, channel in enumerate(c.rig.sensor.channels):
        cell = Cell(with_uncertainty(c.offset[i], c.offset_std[i]))
        rows.append(Row(channel, (cell,) if slope is None else (cell, Cell(f"{slope[i]:.4g}"))))
    return Table("Offset at the end of the last log, ± 1 sigma", columns, tuple(rows))


def improvement_table(c: Calibration) -> Table | None:
    """Nominal against new gain; None where they were not compared."""
    if not c.improvement:
        return None
    held_out = c.figures.get("held_out") or {}
    nis, coverage = held_out.get("nis") or {}, held_out.get("coverage") or {}
    columns = ["axis", "nominal gain", "new gain", "times smaller", "better"]
    if nis:
        columns += ["mean square / claimed [1]", "within 95 % limits"]
    verdicts = {
        True: Cell("✔ yes", shade="good"),
        False: Cell("✘ no", shade="bad"),
        "unsure": Cell("? unsure"),
    }
    rows = []
    for axis, judged in c.improvement.items():
        factor = judged.nominal / judged.new if judged.new > 0.0 else float("inf")
        cells = [Cell(f"{value:.4g} {UNITS.get(axis, '')}") for value in (judged.nominal, judged.new)]
        cells += [Cell(f"{factor:.3g}"), verdicts[judged.better]]
        if nis:
            cells.append(Cell(f"{nis[axis]:.3g}" if axis in nis else "-"))
            cells.append(Cell(f"{100 * coverage[axis]:.1f} %" if coverage.get(axis) is not None else "-"))
        rows.append(Row(axis, tuple(cells)))
    data = "held-out data" if all(j.held_out for j in c.improvement.values()) else "the data it was fitted to"
    return Table(f"RMS error of the wrench on {data}", tuple(columns), tuple(rows))


def limits_table(c: Calibration) -> Table | None:
    """What each source contributes; None where the estimator does not say."""
    sources: Mapping[str, Mapping[str, float]] = c.figures.get("limited_by") or {}
    if not sources:
        return None
    rows = []
    for axis in AXES:
        largest = max(by_axis[axis] for by_axis in sources.values()) if len(sources) > 1 else np.inf
        cells = (
            Cell(f"{100 * by_axis[axis]:.2g} %", *(("largest", "most") if by_axis[axis] == largest else ()))
            for by_axis in sources.values()
        )
        rows.append(Row(axis, tuple(cells)))
    names = (SOURCES.get(name, name) for name in sources)
    caption = "1 sigma of the gains on a wrench axis by each source alone, in % of full scale"
    return Table(caption, ("axis", *names), tuple(rows))


def payload_table(c: Calibration) -> Table | None:
    """Stated and found; None where payloads are exact."""
    rows = []
    for name, found in c.payload_posterior.items():
        stated = c.rig.payloads[name]
        quantities: list[tuple[str, float, str, int | str | None]] = [
            ("mass [kg]", stated.mass, "mass", None)
        ]
        for k, axis in enumerate("xyz"):
            at = f"centre of mass {axis} [m]"
            quantities.append((at, stated.center_of_mass[k], "center_of_mass", k))
        for key in ELEMENTS:
            quantities.append((f"inertia {key} [kg m²]", getattr(stated.inertia, key), "inertia", key))
        for words, believed, key, element in quantities:
            value, std = found.get(key), found.get(f"{key}_std")
            if value is None or std is None:
                continue
            if element is not None:
                value, std = value[element], std[element]
            cells = (Cell(words), Cell(f"{believed:.6g}"), Cell(with_uncertainty(value, std)))
            rows.append(Row(name, cells))
    caption = "Payload as stated, and as the record has it, ± 1 sigma"
    return Table(caption, ("payload", "quantity", "stated", "found"), tuple(rows)) if rows else None


def wrench_table(c: Calibration, rms: np.ndarray[Any, np.dtype[np.float64]]) -> Table:
    """How much of each wrench axis the record holds, and what that made of its gains."""
    sigma = c.gain_std_normalised.max(axis=0)
    rows = []
    for j, (axis, unit) in enumerate(UNITS.items()):
        known = bool(c.gain_determined[:, j].all())
        cells = (
            Cell(f"{rms[j]:.3g} {unit}"),
            Cell(f"{100 * rms[j] / c.rig.sensor.range_array[j]:.2g} %"),
            Cell(f"{100 * sigma[j]:.2g} %"),
            Cell("✔ yes" if known else "○ no", shade="" if known else "open"),
        )
        rows.append(Row(axis, cells))
    columns = ("axis", "RMS about its mean", "of range", "least certain gain, 1 sigma", "determined")
    return Table("Excitation: the wrench in the record, axis by axis", columns, tuple(rows))


def left_out_table(logs: tuple[LogReport, ...]) -> Table:
    """Samples used and left out of every log, by reason."""

    def counts(of: Mapping[str, int]) -> Cell:
        return Cell(", ".join(f"{n} ({why})" for why, n in of.items() if n) or "none")

    rows = []
    for k, log in enumerate(logs):
        lost = (counts(log.masked), counts(log.rejected), Cell(str(log.dropped_rows)), counts(log.nan_counts))
        rows.append(Row(f"log {k + 1}", (Cell(str(log.used)), *lost)))
    columns = ("log", "used", "left out", "could not be used", "empty rows", "NaN")
    return Table("Samples of every log", columns, tuple(rows))
