"""The figures of a report as Bokeh models: no name from a log or a rig enters them.

Text, axes and grids take their colours from the page's CSS variables, which follow light, dark and print;
curves have colours of Okabe and Ito that stand out on both, and differ in their dashes as well.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from bokeh.models import BoxZoomTool, Legend, Range1d, Span, VStrip
from bokeh.models.ranges import DataRange1d
from bokeh.models.sources import ColumnDataSource
from bokeh.plotting import figure

from truewrench.model.arrays import Array, Mask
from truewrench.model.calibration import AXES
from truewrench.model.calibration_parts import UNITS
from truewrench.report.consistency import Consistency
from truewrench.report.convergence import Convergence
from truewrench.report.series import Record
from truewrench.report.statistics import Envelope, Histogram, Spectrum

BLUE, VERMILION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#808080"
_CURVES = ((BLUE, "solid"), (VERMILION, "dashed"), (GREEN, "dotdash"))
_BAND = 2.0  # sigma
_POINTS = 300  # fewer are drawn as such
_LEGEND = ".bk-label { color: var(--ink) !important; }"  # it is no part of the canvas


def wrench_plots(curve: Envelope, record: Record) -> list[figure]:
    """One figure per wrench axis: 6 columns measured, then 6 of what they are held against."""
    plots = []
    for i in range(6):
        expected = curve.values[:, 6 + i]
        low, high = np.nanmin(expected), np.nanmax(expected)
        span = max(float(high - low), 1e-9)
        measured = np.clip(curve.values[:, i], low - span, high + span)  # a spike hides nothing
        y = Range1d(np.nanmin(measured) - 0.05 * span, np.nanmax(measured) + 0.05 * span)
        curves = (("measured", measured), ("expected", expected))
        plots.append(_of_axis(curve.time, record, i, y, curves))
    return plots


def residual_plots(curve: Envelope, record: Record, sigma: Array) -> list[figure]:
    """One figure per wrench axis: 6 columns of residuals, and 6 of a slow disturbance where there are 12."""
    plots = []
    for i in range(6):
        shown = curve.values[:, i::6].T
        largest = 1.05 * np.nanmax(np.abs(shown), initial=3.0 * sigma[i])
        curves = tuple(zip(("residual", "slow disturbance"), shown, strict=False))
        p = _of_axis(curve.time, record, i, Range1d(-largest, largest), curves)
        for level in (-_BAND * sigma[i], _BAND * sigma[i]):
            p.add_layout(_level(level, GREY, "dashed"))
        plots.append(p)
    return plots


def spectrum_plot(found: Spectrum, axes: slice) -> figure:
    """Density over the expected one, three axes."""
    top = max(3.0, 1.2 * float(found.ratio.max()))
    bottom = min(0.3, 0.8 * max(1e-4, float(found.ratio.min())))
    p = _figure(
        280, DataRange1d(range_padding=0.02), Range1d(bottom, top), "frequency [Hz]",
        "density / expected [1]", x_axis_type="log", y_axis_type="log",
    )  # fmt: skip
    low = np.maximum(found.low, bottom)
    p.varea(x=found.frequency, y1=low, y2=found.high, fill_color=GREY, fill_alpha=0.3)
    _curves(p, found.frequency, found.ratio[:, axes], AXES[axes])
    p.add_layout(_level(1.0, GREY, "dashed"))
    return p


def histogram_plot(found: Histogram, axes: slice) -> figure:
    """Outlines of three histograms beside the normal density, on a logarithmic axis."""
    top, bottom = max(1.0, 1.3 * float(found.density.max())), 1e-5
    p = _figure(
        280, Range1d(-5, 5), Range1d(bottom, top), "residual / sigma [1]", "share per sigma [1]",
        y_axis_type="log",
    )  # fmt: skip
    x = np.linspace(-5.0, 5.0, 101)
    normal = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
    p.varea(x=x, y1=np.full_like(x, bottom), y2=np.maximum(normal, bottom), fill_color=GREY, fill_alpha=0.3)
    outline = np.repeat(np.where(found.density > 0.0, found.density, np.nan), 2, axis=0)
    _curves(p, np.repeat(found.edges, 2)[1:-1], outline[:, axes], AXES[axes])
    return p


def consistency_plot(found: Consistency, record: Record) -> figure:
    """Mean squares over time, round inside and triangular outside of their bounds."""
    bottom = 0.8 * float(min(found.low.min(), found.value[found.value > 0.0].min(initial=0.5)))
    y = Range1d(bottom, 1.3 * float(max(found.high.max(), found.value.max())))
    p = _time_figure(190, record, y, "mean square [1]", y_axis_type="log")
    least = 0.002 * record.end  # what can still be seen
    p.quad(
        left=found.begin, right=np.maximum(found.end, found.begin + least),
        bottom=found.low, top=found.high,
        fill_color=GREY, fill_alpha=0.3, line_color=None,
    )  # fmt: skip
    p.add_layout(_level(1.0, GREY, "dashed"))
    inside = (found.value >= found.low) & (found.value <= found.high)
    _judged(p, 0.5 * (found.begin + found.end), np.maximum(found.value, bottom), inside)
    return p


def information_plot(shares: Array, undetermined: float) -> figure:
    """What the data left of the prior sigma, direction by direction, the best known first."""
    top, bottom = 1.6, min(0.5 * float(shares.min()), 0.1)
    p = _figure(
        280, Range1d(0, len(shares) + 1), Range1d(max(bottom, 1e-7), top), "direction of the gain [number]",
        "sigma / prior sigma [1]", y_axis_type="log",
    )  # fmt: skip
    _judged(p, np.arange(1.0, len(shares) + 1), shares, shares <= undetermined)
    p.add_layout(_level(undetermined, VERMILION, "dashed"))
    return p


def convergence_plot(found: Convergence, record: Record) -> figure:
    """Distance from the final gain and sigma of the gain so far, over time."""
    curves = [
        ("distance from final", found.time, found.distance, BLUE, "solid"),
        ("sigma, noise alone", found.time, found.sigma, GREY, "dashed"),
    ]
    if found.history.size:
        curves.append(("the estimator's own", found.history_time, found.history, VERMILION, "dotdash"))
    values = np.concatenate([curve[2] for curve in curves])
    values = values[values > 0.0]
    low = max(1e-3 * found.final, float(values.min()))
    y = Range1d(0.5 * min(low, found.final), 2.0 * max(float(values.max()), found.final))
    p = _time_figure(300, record, y, "share of full scale [1]", y_axis_type="log")
    for label, x, values, colour, dash in curves:
        shown = np.where(values > 0.0, values, np.nan)
        p.line(x, shown, line_color=colour, line_dash=dash, line_width=2, legend_label=label)
        if len(x) < 3:
            p.scatter(x, shown, color=colour, size=7)
    ends, level = [0.0, record.end], [found.final] * 2
    p.line(ends, level, line_color=BLUE, line_dash="dotted", line_width=2, legend_label="stated sigma")
    _legend_above(p)
    return p


def _figure(
    height: int, x: Range1d | DataRange1d, y: Range1d, x_label: str, y_label: str, **kinds: Any
) -> figure:
    zoom = BoxZoomTool(dimensions="width")
    p = figure(
        height=height, sizing_mode="stretch_width", x_range=x, y_range=y, tools=[zoom], toolbar_location=None,
        active_drag=None, background_fill_color=None, border_fill_color=None, outline_line_color=None,
        min_border_left=78, min_border_right=8, min_border_top=4, x_axis_label=x_label, y_axis_label=y_label,
        **kinds,
    )  # fmt: skip
    for axis in (p.xaxis, p.yaxis):
        axis.axis_label_text_font_size = axis.major_label_text_font_size = "13px"
        axis.axis_label_text_font = axis.major_label_text_font = "system-ui, sans-serif"
        axis.axis_label_text_font_style = "normal"
        axis.minor_tick_line_color = None
    p.xaxis.ticker.desired_num_ticks = 5
    p.yaxis.ticker.desired_num_ticks = 4
    p.xgrid.grid_line_color = None
    return p


def _of_axis(
    time: Array, record: Record, axis: int, y: Range1d, curves: Sequence[tuple[str, Array]]
) -> figure:
    """Curves of one wrench axis over time; two are named above the first axis, which is higher by that."""
    named = axis == 0 and len(curves) > 1
    p = _time_figure(190 + 28 * named, record, y, f"{AXES[axis]} [{UNITS[AXES[axis]]}]")
    x = time.astype(np.float32)
    for (colour, dash), (name, values) in zip(_CURVES, curves, strict=False):
        named_so = {"legend_label": name} if named else {}
        p.line(x, values.astype(np.float32), line_color=colour, line_dash=dash, line_width=1.2, **named_so)
        if len(x) < _POINTS:
            p.scatter(x, values, marker="circle", size=5, color=colour)
    if named:
        _legend_above(p)
    return p


def _time_figure(height: int, record: Record, y: Range1d, label: str, **kinds: Any) -> figure:
    """With what was left out shaded, and lines where a log begins or an offset steps."""
    end = record.end
    p = _figure(height, Range1d(0.0, end, name="time", bounds=(0.0, end)), y, "time [s]", label, **kinds)
    _strips(p, record.spans("outside"), GREY, 0.25, "/")
    _strips(p, record.spans("left_out"), VERMILION, 0.3, "")
    lines = [(series.begin, GREY, "solid") for series in record.logs[1:]]
    lines += [(s.begin + time, GREEN, "dotdash") for s in record.logs for time in s.steps]
    for at, colour, dash in lines:
        p.add_layout(Span(location=at, dimension="height", line_color=colour, line_dash=dash, line_width=1.5))
    return p


def _judged(p: figure, x: Array, y: Array, good: Mask) -> None:
    """Round where good, triangular elsewhere."""
    p.scatter(x[good], y[good], marker="circle", size=6, color=BLUE)
    p.scatter(x[~good], y[~good], marker="triangle", size=11, color=VERMILION)


def _level(at: float, colour: str, dash: str) -> Span:
    return Span(location=float(at), dimension="width", line_color=colour, line_dash=dash, line_width=1.5)


def _strips(p: figure, spans: Sequence[tuple[float, float]], colour: str, alpha: float, hatch: str) -> None:
    """Shaded stretches of time, none narrower than can be seen."""
    if not spans:
        return
    least = 0.003 * float(p.x_range.end)
    begin, end = np.array(spans).T
    glyph = VStrip(
        x0="x0", x1="x1", fill_color=colour, fill_alpha=alpha, line_color=None,
        hatch_pattern=hatch or None, hatch_color=colour, hatch_alpha=0.8,
    )  # fmt: skip
    p.add_glyph(ColumnDataSource({"x0": begin, "x1": np.maximum(end, begin + least)}), glyph)


def _curves(p: figure, x: Array, columns: Array, names: Iterable[str]) -> None:
    for (colour, dash), y, name in zip(_CURVES, columns.T, names, strict=True):
        p.line(x, y, line_color=colour, line_dash=dash, line_width=2, legend_label=name)
    _legend_above(p)


def _legend_above(p: figure) -> None:
    legend: Legend = p.legend[0]
    p.add_layout(legend, "above")
    legend.orientation, legend.ncols = "horizontal", 3
    legend.background_fill_color = legend.border_line_color = None
    legend.stylesheets = [_LEGEND]
    legend.spacing, legend.label_text_font_size, legend.padding, legend.margin = 14, "13px", 2, 0
