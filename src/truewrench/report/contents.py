"""What a report shows of a calibration, section by section; what cannot be shown is replaced by why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from bokeh.plotting import figure
from numpy.typing import NDArray

from truewrench.calibration import AXES, UNDETERMINED, Calibration
from truewrench.evidence import Evidence
from truewrench.report import findings, plots, tables
from truewrench.report.consistency import CHANCE, consistency
from truewrench.report.convergence import convergence
from truewrench.report.series import Record, record_of
from truewrench.report.statistics import envelope, histogram, spectrum
from truewrench.report.tables import Table

__all__ = ["Figure", "Section", "sections"]

Array = NDArray[np.float64]

_SHOWN = 200  # intervals and rows that are listed one by one


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A plot, its name for those who cannot see it, and what to conclude from it."""

    key: str
    plot: figure
    label: str
    caption: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """One question.

    Attributes:
        key: of the page's anchor.
        title: as heading.
        words: paragraphs; what to conclude comes first.
        tables: after them.
        figures: after these; a figure without a caption belongs to the next one that has.
        time_axis: end of the time axis [s] that figures over time share, where its buttons stand, else 0.
        lists: title and lines of lists that can be opened.
    """

    key: str
    title: str
    words: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    time_axis: float = 0.0
    lists: tuple[tuple[str, tuple[str, ...]], ...] = ()


def sections(calibration: Calibration, evidence: Evidence) -> list[Section]:
    """All sections behind verdict and gain, in order."""
    record = record_of(calibration, evidence)
    end = max(1e-9, record.end, *(float(log.time[-1]) for log in evidence.logs))
    return [
        _improvement(calibration),
        _limits(calibration),
        _residuals(calibration, record, end),
        _noise(calibration, record),
        _consistency(calibration, evidence, record, end),
        _excitation(calibration, record),
        _convergence(calibration, evidence, record, end),
        _left_out(calibration, record),
    ]


def _improvement(c: Calibration) -> Section:
    table = tables.improvement_table(c)
    none_because = (c.figures.get("held_out") or {}).get("none_because")
    if table is None:
        why = none_because or "this estimator is a reference, and is not judged by held-out data"
        return Section("improvement", "What improves", (f"Nominal and new gain were not compared: {why}.",))
    better = [axis for axis, judged in c.improvement.items() if judged.better is True]
    worse = [axis for axis, judged in c.improvement.items() if judged.better is False]
    words = [
        f"The new gain is better on {findings.axes_listed(better) if better else 'no axis'}"
        + (f", and worse on {findings.axes_listed(worse)}." if worse else ", and worse on none.")
    ]
    if none_because:
        words.append(
            f"Nothing was held out ({none_because}): the new gain is compared on data that it was fitted "
            "to, which flatters it."
        )
    elif (c.figures.get("held_out") or {}).get("nis"):
        words.append(
            "Judged on a part of the record that the judged gain has not seen. A mean square of 1 over "
            "what is claimed, and 95 % within limits, say that its stated sigma is honest."
        )
    return Section("improvement", "What improves", tuple(words), (table,))


def _limits(c: Calibration) -> Section:
    if not any(log.used for log in c.logs):
        return Section(
            "limits",
            "What limits the accuracy",
            ("Nothing of the record was used: all is as believed before.",),
        )
    found = [tables.limits_table(c), tables.payload_table(c)]
    words = []
    source = findings.dominating(c)
    if source:
        known = {"noise": "noise", "timing": "the clocks"}.get(source, f"the payload's {source}")
        words.append(
            f"On most axes {known} contributes most to the uncertainty: improve that first. The sources add "
            "up in squares."
        )
    else:
        words.append("This estimator does not tell the sources of its uncertainty apart.")
    if c.bound is not None:
        stated = float(np.sqrt(np.mean(c.gain_std_normalised**2)))
        known = "wrench" if c.estimator == "reference" else "motion and payload"
        words.append(
            f"The stated sigma, {100 * stated:.2g} % of full scale, is {stated / c.bound.oracle_rms:.3g} "
            f"times what a perfectly known {known} would give."
        )
    if found[1] is None:
        words.append("Payload: taken as exact, or not needed; nothing was learnt of it.")
    if c.rig.sensor.time_offset_prior > 0.0 and c.estimator in ("map", "online"):
        found.append(tables.clock_table(c))
    else:
        words.append("Clocks: taken as one; no time offset was estimated.")
    return Section("limits", "What limits the accuracy", tuple(words), tuple(t for t in found if t))


def _residuals(c: Calibration, record: Record, end: float) -> Section:
    title = "Residuals over time"
    if record.none_because:
        return Section("residuals", title, (f"No residuals: {record.none_because}.",))
    curve = envelope(record)
    sigma = np.sqrt(
        np.nanmean([np.nanmean(np.broadcast_to(s.sigma, s.residual.shape) ** 2, axis=0)
                    for s in record.logs if len(s.time)], axis=0)
    )  # fmt: skip
    rms = np.sqrt(np.nanmean(np.concatenate([s.residual for s in record.logs]) ** 2, axis=0))
    worst = int(np.argmax(rms / sigma))
    words = [
        f"Corrected wrench minus {record.against}" + (f", in {record.part}." if record.part else "."),
        f"RMS over the expected sigma: {float((rms / sigma).min()):.2f} to {float((rms / sigma).max()):.2f} "
        f"(largest on {AXES[worst]}); 1 is noise alone. A pattern that repeats with the motion, or a step, "
        "is not noise: look at what the arm did then.",
    ]
    if len(record.logs) > 1:
        words.append(
            "The logs stand one after the other, in the order of the table of logs, a grey line where each "
            "begins."
        )
    if c.rig.sensor.offset_walk_array.any():
        words.append("The drift of the offset within a log is contained in these residuals.")
    decimated = (
        f"Each of {len(curve.time) // 2} stretches of {1e3 * curve.bucket:.3g} ms is drawn from its "
        "smallest to its largest sample, so that no peak is lost; zooming does not bring back the samples "
        "between."
        if curve.bucket
        else "Every sample is drawn."
    )
    caption = (
        "Residuals of the six wrench axes [N, N m]. Dashed: ±2 expected sigma, between which 95 % of "
        "single samples belong. Shaded orange: samples left out as contact or spikes; grey and hatched: "
        f"stretches whose motion did not fit. {decimated}"
    )
    disturbed = [
        (s.begin + a, s.begin + b)
        for s, log in zip(record.logs, c.logs, strict=True)
        for a, b in log.disturbances
    ]
    drawn = plots.residual_plots(curve, record, sigma, disturbed, end)
    figures = [
        Figure(
            f"residual-{axis}", plot, f"Residual of {axis} over time, RMS {value:.3g} {tables.UNITS[axis]}"
        )
        for axis, plot, value in zip(AXES, drawn, rms, strict=True)
    ]
    figures[-1] = replace(figures[-1], caption=caption)
    return Section("residuals", title, tuple(words), (), tuple(figures), time_axis=end)


def _noise(c: Calibration, record: Record) -> Section:
    title, table = "Residuals against the expected noise", tables.noise_table(c)
    shown = (table,) if table else ()
    words: list[str] = []
    figures: list[Figure] = []
    if record.none_because:
        words.append(f"Neither spectra nor histograms: {record.none_because}.")
    else:
        halves = ((slice(0, 3), "forces"), (slice(3, 6), "moments"))
        density, counts = spectrum(record), histogram(record)
        if density is None:
            words.append("No spectra: no run of 128 samples at equal distances has residuals.")
        else:
            conclusion = findings.spectrum_words(density)
            for axes, name in halves:
                figures.append(
                    Figure(
                        f"spectrum-{name}",
                        plots.spectrum_plot(density, axes),
                        f"Spectra of the {name}' residuals",
                    )
                )
            taken_up = (
                " Below 1 at the lowest frequencies is normal: the fitted motion takes up some noise there."
                if record.fitted
                else ""
            )
            caption = (
                "Spectra: power density of the residuals over that of the expected noise, forces, then "
                f"moments; shaded: what chance does to 95 of 100. {conclusion}{taken_up}"
            )
            figures[-1] = replace(figures[-1], caption=caption)
        conclusion = findings.histogram_words(counts)
        for axes, name in halves:
            figures.append(
                Figure(
                    f"histogram-{name}",
                    plots.histogram_plot(counts, axes),
                    f"Histograms of the {name}' residuals",
                )
            )
        outside = int(counts.outside.sum())
        caption = (
            "Histograms of residuals in units of their expected sigma, forces, then moments; shaded: the "
            f"normal density. {conclusion} Samples beyond 5 sigma: {outside}. Wider than the shade: noise "
            "stated too small, or gain and motion do not fit; tails alone: spikes or contact."
        )
        figures[-1] = replace(figures[-1], caption=caption)
    if table:
        words.append(
            "Found noise is what the residuals show, corrected for what the fit took up; colour is its "
            "density at the frequencies of the motion over that of white noise (1), and is contained in "
            "sigma."
        )
    return Section("noise", title, tuple(words), shown, tuple(figures))


def _consistency(c: Calibration, evidence: Evidence, record: Record, end: float) -> Section:
    title, found = "Normalised squares (NIS)", consistency(c, evidence, record)
    if not found:
        return Section("nis", title, ("None can be shown: nothing of the record was fitted.",))
    figures = [
        Figure(
            f"nis-{k}",
            plots.consistency_plot(stream, end),
            f"Mean squares over time, {stream.name}",
            f"{stream.name[0].upper()}{stream.name[1:]}: mean squares; {stream.outside} outside.",
        )
        for k, stream in enumerate(found)
    ]
    what = {
        "map": "of the residuals in every window of motion",
        "online": "of the residuals in every window of motion",
        "ekf": "of the filter's innovations",
        "reference": "of the rows' residuals",
    }.get(c.estimator, "of the residuals; their bounds are approximate, as their noise is correlated in time")
    words = (
        findings.consistency_words(found),
        f"Mean squares {what}, over what their noise stands for; 1 is expected. Shaded: the bounds between "
        f"which chance keeps {100 * (1 - CHANCE):.0f} %. Triangles lie outside.",
    )
    return Section("nis", title, words, (), tuple(figures))


def _excitation(c: Calibration, record: Record) -> Section:
    title, sensor = "Excitation, and what is not determined", c.rig.sensor
    open_ones = findings.undetermined_words(c)
    if open_ones:
        words = [
            f"The record does not determine {len(c.verdict.undetermined)} of {6 * sensor.n} directions of "
            "the gain; there the nominal gain is believed as before:"
        ]
    else:
        words = ["The record determines every direction of the gain."]
    units = (sensor.range_array / sensor.channel_scale[:, None]).ravel()
    size = 6 * sensor.n
    covariance = c.covariance[:size, :size] * units[:, None] * units
    shares = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0)) / sensor.gain_prior
    shown: tuple[Table, ...] = ()
    if record.none_because:
        words.append(f"Of the wrench nothing can be said: {record.none_because}.")
    else:
        parts = [s.wrench - np.nanmean(s.wrench, axis=0) for s in record.logs if np.isfinite(s.wrench).any()]
        rms = np.sqrt(np.nanmean(np.concatenate(parts) ** 2, axis=0))
        shown = (tables.wrench_table(c, rms),)
    caption = (
        "What the record has left of the prior sigma in each direction of the gain (eigenvectors of its "
        f"covariance), the best known first. Above {UNDETERMINED:g} a direction counts as not determined; "
        "the farther below, the better the motion excites it."
    )
    plot = plots.information_plot(np.maximum(shares, 1e-7), UNDETERMINED)
    label = f"Sigma over prior sigma of {size} directions, from {shares.min():.2g} to {shares.max():.2g}"
    lists = (("Directions that are not determined", tuple(open_ones)),) if open_ones else ()
    return Section(
        "excitation", title, tuple(words), shown, (Figure("directions", plot, label, caption),), lists=lists
    )


def _convergence(c: Calibration, evidence: Evidence, record: Record, end: float) -> Section:
    title, found = "Convergence of the gain", convergence(c, evidence, record)
    if found is None or not found.time.size:
        return Section("convergence", title, (f"Cannot be shown: {record.none_because or 'no rows'}.",))
    own = (
        " Dash-dotted: what the estimator itself said at that time, without knowing the rest."
        if found.history.size
        else ""
    )
    caption = (
        "The gain that the record up to a time gives when the motion (or reference wrench) of the whole "
        "record is taken for known, beside the final gain: RMS over all gains, as a share of full scale. "
        f"Grey: its sigma by noise alone. Dotted: the stated sigma, with payload and clocks.{own} Where the "
        "curve is flat, a longer record of the same kind changes nothing."
    )
    plot = plots.convergence_plot(found, end)
    label = f"Distance of the gain so far from the final gain, over time; stated sigma {found.final:.2g}"
    words = (findings.convergence_words(found, c),)
    return Section("convergence", title, words, (), (Figure("settling", plot, label, caption),))


def _left_out(c: Calibration, record: Record) -> Section:
    lists = []
    total = 0
    for k, log in enumerate(c.logs):
        total += sum(log.masked.values()) + sum(log.rejected.values())
        name = f"Log {k + 1}"
        lists += _listed(f"{name}: contacts and spikes, seconds from its first row", log.disturbances)
        if k < len(record.logs):
            lists += _listed(
                f"{name}: stretches whose motion did not fit, seconds from its first row",
                record.logs[k].rejected,
            )
    outliers = c.figures.get("outliers") or []
    if outliers:
        lines = [f"log {o['log'] + 1}, row {o['row']}, {o['time']:.6g} s" for o in outliers]
        lists.append((f"Rows that contradict the others ({len(lines)})", _shortened(lines)))
    used = sum(log.used for log in c.logs)
    words = [f"The gain rests on {used} samples; {total} were left out."]
    if not lists:
        words.append("No contact, spike or misfit has a time to be shown.")
    return Section(
        "left-out",
        "Contacts and rejected samples",
        tuple(words),
        (tables.left_out_table(c.logs),),
        lists=tuple(lists),
    )


def _listed(title: str, spans: Sequence[tuple[float, float]]) -> list[tuple[str, tuple[str, ...]]]:
    lines = [f"{begin:.4f} to {end:.4f} s" for begin, end in spans]
    return [(f"{title} ({len(lines)})", _shortened(lines))] if lines else []


def _shortened(lines: list[str]) -> tuple[str, ...]:
    more = [f"and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []
    return (*lines[:_SHOWN], *more)
