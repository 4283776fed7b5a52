"""The tables of a report: plain text in cells, with a class for shading and a mark for those who see none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from truewrench.calibration import AXES, Calibration, LogReport
from truewrench.summary import with_uncertainty

__all__ = [
    "UNITS",
    "Cell",
    "Row",
    "Table",
    "clock_table",
    "gain_table",
    "improvement_table",
    "left_out_table",
    "limits_table",
    "noise_table",
    "offset_table",
    "payload_table",
    "wrench_table",
]

UNITS = dict(zip(AXES, ["N"] * 3 + ["N m"] * 3, strict=True))
_NOTICED, _SMALL, _LARGE = 5e-4, 0.01, 0.05  # of full scale: departures that are named, shaded, and more so
_SOURCES = {"center_of_mass": "centre of mass", "timing": "clocks"}


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
    departure = (c.gain - sensor.nominal_gain_array) * sensor.range_array / sensor.channel_scale[:, None]
    rows = []
    for i, channel in enumerate(sensor.channels):
        cells = []
        for j in range(6):
            text = with_uncertainty(c.gain[i, j], c.gain_std[i, j])
            if not c.gain_determined[i, j]:
                cells.append(Cell(text, "○ not determined", "open"))
                continue
            share = float(departure[i, j])
            sign = "▲" if share > 0.0 else "▼"
            mark = f"{sign} {100 * share:+.2g} %" if abs(share) >= _NOTICED else "≈ nominal"
            side = "up" if share > 0.0 else "down"
            size = abs(share)
            shade = "" if size < _SMALL else f"{side}-{'much' if size > _LARGE else 'some'}"
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
    columns = ["channel", "offset [raw]"] + (["per K [raw/K]"] if slope is not None else [])
    rows = []
    for i, channel in enumerate(c.rig.sensor.channels):
        cells = [Cell(with_uncertainty(c.offset[i], c.offset_std[i]))]
        if slope is not None:
            cells.append(Cell(f"{slope[i]:.4g}"))
        rows.append(Row(channel, tuple(cells)))
    return Table("Offset at the end of the last log, ± 1 sigma", tuple(columns), tuple(rows))


def improvement_table(c: Calibration) -> Table | None:
    """Nominal against new gain; None where they were not compared."""
    if not c.improvement:
        return None
    held_out = c.figures.get("held_out") or {}
    nis, coverage = held_out.get("nis") or {}, held_out.get("coverage") or {}
    columns = ["axis", "nominal gain", "new gain", "times smaller", "better"]
    if nis:
        columns += ["mean square / claimed [1]", "within 95 % limits"]
    rows = []
    for axis, judged in c.improvement.items():
        word, shade = {True: ("✔ yes", "good"), False: ("✘ no", "bad"), "unsure": ("? unsure", "")}[
            judged.better
        ]
        unit = UNITS.get(axis, "")
        factor = judged.nominal / judged.new if judged.new > 0.0 else float("inf")
        cells = [
            Cell(f"{judged.nominal:.4g} {unit}"),
            Cell(f"{judged.new:.4g} {unit}"),
            Cell(f"{factor:.3g}"),
            Cell(word, shade=shade),
        ]
        if nis:
            share = coverage.get(axis)
            cells += [
                Cell(f"{nis[axis]:.3g}" if axis in nis else "-"),
                Cell("-" if share is None else f"{100 * share:.1f} %"),
            ]
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
        values = [by_axis[axis] for by_axis in sources.values()]
        top = int(np.argmax(values))
        rows.append(
            Row(
                axis,
                tuple(_share(value, k == top and len(values) > 1) for k, value in enumerate(values)),
            )
        )
    names = (_SOURCES.get(name, name) for name in sources)
    caption = "1 sigma of the gains on a wrench axis by each source alone, in % of full scale"
    return Table(caption, ("axis", *names), tuple(rows))


def _share(value: float, largest: bool) -> Cell:
    return Cell(f"{100 * value:.2g} %", *(("largest", "most") if largest else ()))


def payload_table(c: Calibration) -> Table | None:
    """Stated and found; None where payloads are exact."""
    if not c.payload_posterior:
        return None
    rows = []
    for name, found in c.payload_posterior.items():
        stated = c.rig.payloads[name]
        rows.append(_payload_row(name, "mass [kg]", stated.mass, found, "mass", None))
        for k, axis in enumerate("xyz"):
            rows.append(
                _payload_row(
                    name, f"centre of mass {axis} [m]", stated.center_of_mass[k], found, "center_of_mass", k
                )
            )
        for key in ("xx", "yy", "zz", "xy", "xz", "yz"):
            value = getattr(stated.inertia, key)
            rows.append(_payload_row(name, f"inertia {key} [kg m²]", value, found, "inertia", key))
    kept = tuple(row for row in rows if row is not None)
    return (
        Table(
            "Payload as stated, and as the record has it, ± 1 sigma",
            ("payload", "quantity", "stated", "found"),
            kept,
        )
        if kept
        else None
    )


def _payload_row(
    name: str, words: str, stated: float, found: Mapping[str, Any], key: str, at: int | str | None
) -> Row | None:
    value, std = found.get(key), found.get(f"{key}_std")
    if value is None or std is None:
        return None
    if at is not None:
        value, std = value[at], std[at]
    return Row(name, (Cell(words), Cell(f"{stated:.6g}"), Cell(with_uncertainty(value, std))))


def clock_table(c: Calibration) -> Table:
    """Time offset of every log."""
    rows = []
    for k, log in enumerate(c.logs):
        last = k == len(c.logs) - 1
        text = (
            with_uncertainty(1e3 * log.time_offset, 1e3 * c.time_offset_std)
            if last
            else f"{1e3 * log.time_offset:.6g}"
        )
        rows.append(Row(f"log {k + 1}", (Cell(text), Cell(f"{1e3 * c.rig.sensor.time_offset_prior:.4g}"))))
    return Table(
        "Clock of the motion minus that of the sensor",
        ("log", "found [ms]", "stated 1 sigma [ms]"),
        tuple(rows),
    )


def noise_table(c: Calibration) -> Table | None:
    """Stated and found noise of every channel; None where it was not measured."""
    noise: Mapping[str, Mapping[str, float | None]] = c.figures.get("noise") or {}
    rows = []
    for name, entry in noise.items():
        given, found, colour = entry.get("given"), entry.get("estimated"), entry.get("colour")
        off = given and found and not 0.8 < found / given < 1.25
        rows.append(
            Row(
                name,
                (
                    Cell("-" if given is None else f"{given:.4g}"),
                    Cell(
                        "-" if found is None else f"{found:.4g}",
                        "differs" if off else "",
                        "bad" if off else "",
                    ),
                    Cell("-" if colour is None else f"{colour:.3g}"),
                ),
            )
        )
    columns = ("stream", "stated [raw, m/s, rad/s]", "found [the same]", "colour [1]")
    return Table("Noise, 1 sigma per sample", columns, tuple(rows)) if rows else None


def wrench_table(c: Calibration, rms: np.ndarray[Any, np.dtype[np.float64]]) -> Table:
    """How much of each wrench axis the record holds, and what that made of its gains."""
    sigma = c.gain_std_normalised.max(axis=0)
    rows = []
    for j, (axis, unit) in enumerate(UNITS.items()):
        known = bool(c.gain_determined[:, j].all())
        rows.append(
            Row(
                axis,
                (
                    Cell(f"{rms[j]:.3g} {unit}"),
                    Cell(f"{100 * rms[j] / c.rig.sensor.range_array[j]:.2g} %"),
                    Cell(f"{100 * sigma[j]:.2g} %"),
                    Cell("✔ yes" if known else "○ no", shade="" if known else "open"),
                ),
            )
        )
    columns = ("axis", "RMS about its mean", "of range", "least certain gain, 1 sigma", "determined")
    return Table("Excitation: the wrench in the record, axis by axis", columns, tuple(rows))


def left_out_table(logs: tuple[LogReport, ...]) -> Table:
    """Samples used and left out of every log, by reason."""
    rows = []
    for k, log in enumerate(logs):
        one_by_one = ", ".join(f"{n} ({why})" for why, n in log.masked.items() if n) or "none"
        by_window = ", ".join(f"{n} ({why})" for why, n in log.rejected.items() if n) or "none"
        nan = ", ".join(f"{n} ({column})" for column, n in log.nan_counts.items() if n) or "none"
        rows.append(
            Row(
                f"log {k + 1}",
                (
                    Cell(str(log.used)),
                    Cell(one_by_one),
                    Cell(by_window),
                    Cell(str(log.dropped_rows)),
                    Cell(nan),
                ),
            )
        )
    columns = ("log", "used", "left out one by one", "left out with their window", "empty rows", "NaN")
    return Table("Samples of every log", columns, tuple(rows))
