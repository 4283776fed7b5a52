"""What a report shows of a calibration, section by section; what cannot be shown is replaced by why."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from bokeh.plotting import figure

from truewrench.estimation.assumptions import assumed_gain_prior
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.evidence import Evidence
from truewrench.judging.words import listed
from truewrench.model.arrays import Array
from truewrench.model.calibration import AXES, UNDETERMINED, Calibration
from truewrench.model.calibration_parts import UNITS
from truewrench.report import findings, found, plots, tables
from truewrench.report.consistency import CHANCE, consistency
from truewrench.report.convergence import convergence
from truewrench.report.series import Record, Series, record_of
from truewrench.report.statistics import Envelope, envelope, histogram, spectrum
from truewrench.report.tables import Table

_SHOWN = 200  # intervals and rows that are listed one by one
_HALVES = {"forces": slice(0, 3), "moments": slice(3, 6)}
_SHADES = (
    "Shaded orange: samples left out as contact or outliers; grey and hatched: outside of every stretch that "
    "could be estimated from; green line: a step of the offset."
)


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A plot, its name for those who cannot see it, and what to conclude from it."""

    key: str
    plot: figure
    label: str
    caption: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """One question."""

    key: str  # of the page's anchor
    title: str  # as heading
    words: tuple[str, ...] = ()  # paragraphs; what to conclude comes first
    tables: tuple[Table, ...] = ()  # after them
    # after these; a figure without a caption belongs to the next one that has
    figures: tuple[Figure, ...] = ()
    # end of the time axis [s] that figures over time share, where its buttons stand, else 0
    time_axis: float = 0.0
    lists: tuple[tuple[str, tuple[str, ...]], ...] = ()  # title and lines of lists that can be opened


def sections(calibration: Calibration, evidence: Evidence) -> list[Section]:
    """All sections behind verdict and gain, in order."""
    record = record_of(calibration, evidence)
    return [
        _found(calibration, evidence),
        _improvement(calibration),
        _limits(calibration),
        _wrench(record),
        _residuals(record),
        _noise(record),
        _consistency(calibration, evidence, record),
        _excitation(calibration, record),
        _convergence(calibration, evidence, record),
        _left_out(calibration, record),
    ]


def _found(c: Calibration, evidence: Evidence) -> Section:
    title, estimate = "What was found, and what was assumed", evidence.estimate
    assumed = found.assumed_table(c)
    words = ["Nothing had to be assumed beside the rig as stated."] if assumed is None else []
    shown = [assumed] if assumed is not None else []
    if isinstance(estimate, Estimate) and estimate.solved:
        shown.append(found.found_table(c, estimate))
        words += findings.agreement_words(c)
    elif not isinstance(estimate, Estimate) and assumed is None:
        words.append("This estimator finds nothing beside gain and offset.")
    return Section("found", title, tuple(words), tuple(shown))


def _improvement(c: Calibration) -> Section:
    table = tables.improvement_table(c)
    held_out = c.figures.get("held_out") or {}
    none_because = held_out.get("none_because")
    if table is None:
        why = none_because or "this estimator is a reference, and is not judged by held-out data"
        return Section("improvement", "What improves", (f"Nominal and new gain were not compared: {why}.",))
    better, worse = (
        listed([a for a, judged in c.improvement.items() if judged.better is so], "and") or "none"
        for so in (True, False)
    )
    words = [f"The new gain is better on {better}, and worse on {worse}."]
    if none_because:
        words.append(
            f"Nothing was held out ({none_because}): compared on what it was fitted to, it is flattered."
        )
    elif "nis" in held_out:
        words.append(
            "Judged on a part of the record that the judged gain has not seen. A mean square of 1 over "
            "what is claimed, and 95 % within limits, say that its stated sigma is honest."
        )
    return Section("improvement", "What improves", tuple(words), (table,))


def _limits(c: Calibration) -> Section:
    title, payload = "What limits the accuracy", tables.payload_table(c)
    if not any(log.used for log in c.logs):
        return Section("limits", title, ("Nothing of the record was used: all is as believed before.",))
    source = findings.dominating(c)
    words = ["This estimator does not tell the sources of its uncertainty apart."]
    if source:
        words = [
            f"On most axes {findings.source_words(source)} contributes most to the uncertainty; "
            f"{findings.CURES[source]} helps first. The sources add up in squares."
        ]
    if c.bound is not None:
        stated = float(np.sqrt(np.mean(c.gain_std_normalised**2)))
        known = "wrench" if c.estimator == "reference" else "motion and payload"
        words.append(
            f"The stated sigma, {100 * stated:.2g} % of full scale, is {stated / c.bound.oracle_rms:.3g} "
            f"times what a perfectly known {known} would give."
        )
    words += findings.pose_words(c)
    if payload is None:
        words.append("Payload: taken as exact, or not needed; nothing was learnt of it.")
    shown = tuple(t for t in (tables.limits_table(c), payload) if t)
    return Section("limits", title, tuple(words), shown)


def _wrench(record: Record) -> Section:
    title = "Wrench over time"
    if record.none_because:
        return Section("wrench", title, (f"None can be shown: {record.none_because}.",))
    curve = envelope(record, lambda series: np.hstack([series.measured, series.wrench]))
    words = (
        f"The corrected wrench, and {record.against}. Where they part by more than the residuals below, "
        "something beside the payload acted: it should lie within a shade.",
    )
    about = "" if record.source != "velocities" else "Both less their means where the offset is unknown. "
    caption = (
        "Blue: measured, as the new calibration corrects it; orange and dashed: expected [N, N m]. "
        f"{about}Where both curves lie on each other, the gain explains the record. {_SHADES} "
        f"{_decimation(curve)}"
    )
    drawn = plots.wrench_plots(curve, record)
    figures = _by_axis("wrench", drawn, [f"Measured and expected {axis} over time" for axis in AXES], caption)
    return Section("wrench", title, words, (), figures, time_axis=record.end)


def _residuals(record: Record) -> Section:
    title = "Residuals over time"
    if record.none_because:
        return Section("residuals", title, (f"No residuals: {record.none_because}.",))
    slow = any(series.discrepancy is not None for series in record.logs)

    def shown(series: Series) -> Array:
        if not slow:
            return series.residual
        none = np.zeros_like(series.residual)
        return np.hstack([series.residual, none if series.discrepancy is None else series.discrepancy])

    curve = envelope(record, shown)
    squares = [np.broadcast_to(s.sigma, s.residual.shape) ** 2 for s in record.logs if len(s.time)]
    sigma = np.sqrt(np.nanmean(np.concatenate(squares), axis=0))
    rms = np.sqrt(np.nanmean(np.concatenate([s.residual for s in record.logs]) ** 2, axis=0))
    least, most = (rms / sigma).min(), (rms / sigma).max()
    size = f"RMS over the expected sigma: {least:.2f} to {most:.2f}; 1 is noise alone."
    if record.source == "fit":
        size = "Their size is the noise found, which stands above beside the stated one."
    words = [
        f"Corrected wrench minus {record.against}" + (f", in {record.part}." if record.part else "."),
        f"{size} A pattern that repeats with the motion, or a step, is not noise: look at what the arm did.",
    ]
    if slow:
        words.append(
            "Orange and dashed: the slow disturbance that the fit holds beside the noise. What follows the "
            "motion is hysteresis or a cable, what creeps is drift; sigma of the gains contains its effect."
        )
    if len(record.logs) > 1:
        words.append("The logs stand one after the other, in their order, a grey line where each begins.")
    caption = (
        "Residuals of the six wrench axes [N, N m]. Dashed grey: ±2 expected sigma, between which 95 % of "
        f"single samples belong. {_SHADES} {_decimation(curve)}"
    )
    labels = [
        f"Residual of {axis} over time, RMS {value:.3g} {UNITS[axis]}"
        for axis, value in zip(AXES, rms, strict=True)
    ]
    figures = _by_axis("residual", plots.residual_plots(curve, record, sigma), labels, caption)
    return Section("residuals", title, tuple(words), (), figures)


def _by_axis(key: str, drawn: Sequence[figure], labels: Sequence[str], caption: str) -> tuple[Figure, ...]:
    """One figure a wrench axis; the caption below the last is for all."""
    figures = [Figure(f"{key}-{a}", p, label) for a, p, label in zip(AXES, drawn, labels, strict=True)]
    return (*figures[:-1], replace(figures[-1], caption=caption))


def _decimation(curve: Envelope) -> str:
    if not curve.bucket:
        return "Every sample is drawn."
    return (
        f"Each of {len(curve.time) // 2} stretches of {1e3 * curve.bucket:.3g} ms is drawn from its smallest "
        "to its largest sample, so that no peak is lost; zooming does not bring back the samples between."
    )


def _noise(record: Record) -> Section:
    title = "Residuals against the expected noise"
    if record.none_because:
        return Section("noise", title, (f"Neither spectra nor histograms: {record.none_because}.",))
    words: list[str] = []
    figures: list[Figure] = []
    white = record.source != "velocities"
    density, counts = spectrum(record) if white else None, histogram(record)

    def halves(name: str, draw: Callable[[slice], figure], caption: str) -> None:
        for half, axes in _HALVES.items():
            label = f"{name} of the {half}' residuals"
            figures.append(Figure(f"{name.lower()}-{half}", draw(axes), label))
        figures[-1] = replace(figures[-1], caption=caption)

    if density is None:
        why = "no run of 128 samples at equal distances has residuals"
        words.append(f"No spectra: {why if white else 'the noise of this motion is not white'}.")
    else:
        followed = " Below 1 at low frequencies is normal: there the fit follows some of the noise."
        halves(
            "Spectra",
            lambda axes: plots.spectrum_plot(density, axes),
            "Spectra: power density of the residuals over that of the expected noise, forces, then moments; "
            f"shaded: what chance does to 95 of 100. {findings.spectrum_words(density)}"
            + (followed if record.source == "fit" else ""),
        )
    halves(
        "Histograms",
        lambda axes: plots.histogram_plot(counts, axes),
        "Histograms of residuals in units of their expected sigma, forces, then moments; shaded: the normal "
        f"density. {findings.histogram_words(counts)} Samples beyond 5 sigma: {int(counts.outside.sum())}. "
        "Wider than the shade: noise stated too small, or gain and motion do not fit; tails alone: spikes or "
        "contact.",
    )
    if record.source == "fit":
        words.append("The expected noise is the one found, less what the fit follows of it.")
    return Section("noise", title, tuple(words), (), tuple(figures))


def _consistency(c: Calibration, evidence: Evidence, record: Record) -> Section:
    title, found = "Normalised squares (NIS)", consistency(evidence, record)
    if not found:
        white = record.source != "velocities"
        why = "nothing of the record was fitted" if white else "the noise of this motion is not white"
        return Section("nis", title, (f"None can be shown: {why}.",))
    figures = [
        Figure(
            f"nis-{k}",
            plots.consistency_plot(stream, record),
            f"Mean squares over time, {stream.name}",
            f"{stream.name[0].upper()}{stream.name[1:]}: mean squares; {stream.outside} outside.",
        )
        for k, stream in enumerate(found)
    ]
    what = "of the filter's innovations" if c.estimator == "ekf" else "of the residuals"
    noise = "the noise found" if record.source == "fit" else "their noise"
    words = (
        findings.consistency_words(found),
        f"Mean squares {what} over {noise}; 1 is expected. Shaded: the bounds between which chance keeps "
        f"{100 * (1 - CHANCE):.0f} %. Triangles lie outside.",
    )
    return Section("nis", title, words, (), tuple(figures))


def _excitation(c: Calibration, record: Record) -> Section:
    title, sensor = "Excitation, and what is not determined", c.rig.sensor
    words = ["The record determines every direction of the gain."]
    if c.verdict.undetermined:
        words = [
            f"The record does not determine {len(c.verdict.undetermined)} of {6 * sensor.n} directions of "
            "the gain; there the nominal gain is believed as before: "
            f"{'; '.join(c.verdict.undetermined_words)}."
        ]
    units = 1.0 / sensor.gain_unit.ravel()
    size = 6 * sensor.n
    covariance = c.covariance[:size, :size] * units[:, None] * units
    shares = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0)) / assumed_gain_prior(c.rig)
    shown: tuple[Table, ...] = ()
    if record.none_because:
        words.append(f"Of the wrench nothing can be said: {record.none_because}.")
    else:
        parts = [s.wrench - np.nanmean(s.wrench, axis=0) for s in record.logs if np.isfinite(s.wrench).any()]
        rms = np.sqrt(np.nanmean(np.concatenate(parts) ** 2, axis=0))
        shown = (tables.wrench_table(c, rms),)
    caption = (
        "What the record has left of the prior sigma in each direction of the gain (eigenvectors of its "
        f"covariance), the best known first. Triangles, above {UNDETERMINED:g}: not determined; the farther "
        "below the dashed line, the better the motion excites it."
    )
    plot = plots.information_plot(np.maximum(shares, 1e-7), UNDETERMINED)
    label = f"Sigma over prior sigma of {size} directions, from {shares.min():.2g} to {shares.max():.2g}"
    figures = (Figure("directions", plot, label, caption),)
    return Section("excitation", title, tuple(words), shown, figures)


def _convergence(c: Calibration, evidence: Evidence, record: Record) -> Section:
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
        f"Grey: its sigma by noise alone. Dotted: the stated sigma, with all that is uncertain.{own} Where "
        "the curve is flat, a longer record of the same kind changes nothing."
    )
    plot = plots.convergence_plot(found, record)
    label = f"Distance of the gain so far from the final gain, over time; stated sigma {found.final:.2g}"
    words = (findings.convergence_words(found, c),)
    return Section("convergence", title, words, (), (Figure("settling", plot, label, caption),))


def _left_out(c: Calibration, record: Record) -> Section:
    lists = []
    for k, series in enumerate(record.logs):
        for spans, what in ((series.left_out, "left out"), (series.outside, "outside of every stretch")):
            lines = [f"{begin:.4f} to {end:.4f} s" for begin, end in spans[:_SHOWN]]
            if len(spans) > _SHOWN:
                lines.append(f"and {len(spans) - _SHOWN} more")
            if lines:
                title = f"Log {k + 1}: {what}, seconds from its first row ({len(spans)})"
                lists.append((title, tuple(lines)))
    used = sum(log.used for log in c.logs)
    total = sum(sum(log.masked.values()) + sum(log.rejected.values()) for log in c.logs)
    words = [f"The gain rests on {used} samples; {total} were left out."]
    if not lists:
        words.append("No contact, spike or misfit has a time to be shown.")
    shown = (tables.left_out_table(c.logs),)
    return Section("left-out", "Contacts and samples left out", tuple(words), shown, lists=tuple(lists))
