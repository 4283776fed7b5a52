"""Results in words and tables that a person reads in a terminal."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console, RenderableType
from rich.text import Text

from truewrench.io.exports import Exports
from truewrench.io.terminal import titled_table, verdict_text
from truewrench.judging.validation import Validation
from truewrench.model.arrays import Array
from truewrench.model.calibration import AXES, Calibration, LogReport
from truewrench.model.calibration_parts import UNITS

SHOWN = 10  # rows that are named one by one
FEW = 5  # remarks, likewise


def show(console: Console, parts: Iterator[RenderableType]) -> None:
    """Print the parts of a summary, an empty line between two."""
    for i, part in enumerate(parts):
        if i:
            console.print()
        console.print(part, markup=False)  # names from files are not ours to interpret


def with_uncertainty(value: float, std: float) -> str:
    """`1.0023 ± 0.0004`: as many digits as the uncertainty deserves, which is two of its own."""
    if std == 0 or not math.isfinite(std) or not math.isfinite(value):
        return f"{value:.6g} ± {std:.2g}"
    decimals = 1 - math.floor(math.log10(std))
    if decimals > 8 or abs(value) >= 1e7 or std >= 1e7:
        return f"{value:.4e} ± {std:.1e}"
    decimals = max(decimals, 0)
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {std:.{decimals}f}"  # + 0.0: no minus zero


def calibration_summary(calibration: Calibration) -> Iterator[RenderableType]:
    """The verdict first, then gain, offset, what they improve, and what they rest on."""
    yield _verdict(calibration)
    yield from _beside_the_model(calibration)
    for axes in (AXES[:3], AXES[3:]):
        yield _gain(calibration, axes)
    if not calibration.gain_determined.all():
        yield Text("In brackets: not determined by the data, believed as before.")
    yield _offset(calibration)
    if calibration.improvement:
        yield _improvement(calibration)
    yield _accuracy(calibration)
    if len(calibration.figures.get("limited_by", {})) > 1:
        yield _limits(calibration)
    yield _logs(calibration)
    for log in calibration.logs:
        if log.disturbances:
            yield _disturbances(log)
    if calibration.figures.get("outliers"):
        yield _outliers(calibration)
    if calibration.timings:
        spent = ", ".join(f"{phase} {seconds:.2f} s" for phase, seconds in calibration.timings.items())
        yield Text(f"Time: {spent}")


def _verdict(calibration: Calibration) -> RenderableType:
    verdict = calibration.verdict
    may = ": gain and offset may be used as they stand."
    text = verdict_text(verdict.usable, "USABLE", may, verdict.reasons)
    unfit = [axis for axis, fit in calibration.axes.items() if not fit]
    if unfit:
        text.append(f"\nAxes that may not be used: {', '.join(unfit)}.")
    if calibration.unused:
        text.append("\nNothing was estimated: gains and their sigma are what was known beforehand.")
    elif verdict.undetermined:
        text.append("\nThe data do not determine:")
        for words in verdict.undetermined_words:
            text.append(f"\n  - {words}")
    for note in calibration.figures.get("notes", ()):
        text.append(f"\nNote: {note}")
    return text


def _beside_the_model(calibration: Calibration) -> Iterator[RenderableType]:
    """What was assumed beside the rig as stated, and what would have left no trace; a few lines, or none."""
    lines = []
    for assumed in calibration.assumed:
        value = f"{assumed.value:.4g}"
        if assumed.sigma is not None:
            value = with_uncertainty(assumed.value, assumed.sigma)
        evidence = f" ({assumed.evidence})" if assumed.evidence else ""
        lines.append(f"{assumed.what}, {assumed.where}: {value}{evidence}")
    if lines:
        yield _items("Assumed beside the rig as stated:", lines)
    if calibration.verdict.blind_to:
        yield _items(
            "What this record could not have shown:", [b.words for b in calibration.verdict.blind_to]
        )


def _items(title: str, lines: Sequence[str]) -> RenderableType:
    more = [f"and {len(lines) - FEW} more, in calibration.yaml"] if len(lines) > FEW else []
    return Text("\n  - ".join([title, *lines[:FEW], *more]))


def _gain(calibration: Calibration, axes: Sequence[str]) -> RenderableType:
    table = titled_table(f"Gain, raw per {UNITS[axes[0]]} (± 1 sigma)", ["channel", *axes])
    columns = [AXES.index(axis) for axis in axes]
    for i, channel in enumerate(calibration.rig.sensor.channels):
        cells = [with_uncertainty(calibration.gain[i, j], calibration.gain_std[i, j]) for j in columns]
        known = calibration.gain_determined[i, columns]
        table.add_row(
            Text(channel),
            *(Text(cell if sure else f"({cell})") for cell, sure in zip(cells, known, strict=True)),
        )
    return table


def _offset(calibration: Calibration) -> RenderableType:
    table = titled_table("Offset, raw (± 1 sigma)", ["channel", "at the end of the last log"])
    for i, channel in enumerate(calibration.rig.sensor.channels):
        table.add_row(Text(channel), with_uncertainty(calibration.offset[i], calibration.offset_std[i]))
    return table


def _improvement(calibration: Calibration) -> RenderableType:
    held_out = all(axis.held_out for axis in calibration.improvement.values())
    data = "held-out data" if held_out else "the data it was fitted to"
    why = calibration.figures.get("held_out", {}).get("none_because")
    if why:
        data += f": {why}"
    table = titled_table(f"RMS error on {data}", ["axis", "nominal gain", "new gain", "better"])
    words = {True: "yes", False: "no", "unsure": "unsure"}
    for name, axis in calibration.improvement.items():
        unit = UNITS.get(name, "")
        better = words[axis.better]
        table.add_row(name, f"{axis.nominal:.4g} {unit}", f"{axis.new:.4g} {unit}", better)
    return table


def _accuracy(calibration: Calibration) -> RenderableType:
    stated = float(np.sqrt(np.mean(calibration.gain_std_normalised**2)))
    text = f"Accuracy: {100 * stated:.2g} % of full scale (1 sigma, RMS over the gains)"
    if calibration.bound is not None:
        ratio = stated / calibration.bound.oracle_rms
        known = "wrench" if calibration.estimator == "reference" else "motion"
        text += f", {ratio:.2f} times what a perfectly known {known} would give"
    return Text(text + ".")


def _limits(calibration: Calibration) -> RenderableType:
    """What each source of uncertainty contributes to the gains on a wrench axis."""
    sources = calibration.figures["limited_by"]
    names = [name.replace("_", " ").replace("center", "centre") for name in sources]
    table = titled_table("What limits the accuracy (1 sigma, % of range)", ["axis", *names])
    for axis in AXES:
        table.add_row(axis, *(f"{100 * by_axis[axis]:.2g}" for by_axis in sources.values()))
    return table


def _logs(calibration: Calibration) -> RenderableType:
    table = titled_table("Logs", ["path", "payload", "samples used", "left out"])
    for log in calibration.logs:
        reasons = {**log.masked, **log.rejected}
        left_out = ", ".join(f"{count} ({reason})" for reason, count in reasons.items() if count) or "none"
        table.add_row(Text(str(log.path or "-")), Text(log.payload), str(log.used), Text(left_out))
    return table


def _disturbances(log: LogReport) -> RenderableType:
    shown = ", ".join(f"{begin:.4g}-{end:.4g} s" for begin, end in log.disturbances[:SHOWN])
    more = len(log.disturbances) - SHOWN
    rest = f" and {more} more" if more > 0 else ""
    return Text(f"Left out of {log.path or 'the log'} as contact or outliers: {shown}{rest}.")


def _outliers(calibration: Calibration) -> RenderableType:
    found = [
        f"row {outlier['row']} ({outlier['time']:.6g} s) of {calibration.logs[outlier['log']].path or '-'}"
        for outlier in calibration.figures["outliers"]
    ]
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return Text(f"Rows left out because they contradict the others: {', '.join(found[:SHOWN])}{more}.")


def exports_summary(exports: Exports) -> Iterator[RenderableType]:
    """What files in the formats of others lose or could not hold; nothing where there is nothing to say."""
    lines = [
        f"{name} cannot hold the whole gain: within the range it errs by up to {_largest(loss.worst)}, "
        f"RMS {_largest(loss.rms)} (without calibration {_largest(loss.rms_before)})."
        for name, loss in exports.loss.items()
        if loss.worst.any()
    ]
    lines += [f"No {name}: {reason}." for name, reason in exports.left_out.items()]
    if lines:
        yield Text("\n".join(lines))


def _largest(error: Array) -> str:
    return f"{error[:3].max():.3g} N and {error[3:].max():.3g} N m"


def validation_summary(validation: Validation) -> Iterator[RenderableType]:
    """The verdict first, then the axes, and what the comparison rests on."""
    better = [name for name, axis in validation.axes.items() if axis.better is True]
    holds = f": better than the nominal gain on {', '.join(better) or 'no axis'}, worse on none."
    yield verdict_text(validation.verdict.usable, "HOLDS", holds, validation.verdict.reasons)
    data = "held-out data" if validation.held_out else "data it was calibrated with"
    columns = [
        "axis",
        "nominal gain",
        "new gain",
        "ratio (99 %)",
        "better",
        "square / claimed",
        "within 95 %",
        "keep",
    ]
    table = titled_table(f"RMS residual on {data}", columns)
    words = {True: "yes", False: "no", "unsure": "unsure"}
    for name, axis in validation.axes.items():
        unit = UNITS[name]
        table.add_row(
            name,
            f"{axis.nominal:.4g} {unit}",
            f"{axis.new:.4g} {unit}",
            f"{axis.ratio_low:.3f} - {axis.ratio_high:.3f}",
            words[axis.better],
            with_uncertainty(axis.nis, axis.nis_std),
            f"{100 * axis.coverage:.1f} %",
            "yes" if axis.keep else "no",
        )
    yield table
    basis = f"{validation.samples} samples in blocks of {validation.block:.3g} s"
    yield Text(
        f"Compared: {basis}, each log with a constant of its own." if validation.tared else f"{basis}."
    )
