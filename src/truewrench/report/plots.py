"""The figures of a report as Bokeh models: no name from a log or a rig enters them.

Text, axes and grids take their colours from the page's CSS variables, which follow light, dark and print;
curves have colours of Okabe and Ito that stand out on both, and differ in their dashes as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from bokeh.models import BoxZoomTool, Legend, Range1d, Span, VStrip
from bokeh.models.ranges import DataRange1d
from bokeh.models.sources import ColumnDataSource
from bokeh.plotting import figure
from numpy.typing import NDArray

from truewrench.calibration import AXES
from truewrench.report.consistency import Consistency
from truewrench.report.convergence import Convergence
from truewrench.report.series import Record
from truewrench.report.statistics import Envelope, Histogram, Spectrum, steps

__all__ = [
    "consistency_plot",
    "convergence_plot",
    "histogram_plot",
    "information_plot",
    "residual_plots",
    "spectrum_plot",
]

Array = NDArray[np.float64]
Span_ = tuple[float, float]

BLUE, VERMILION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#808080"
_CURVES = ((BLUE, "solid"), (VERMILION, "dashed"), (GREEN, "dotdash"))
_UNITS = ("N", "N", "N", "N m", "N m", "N m")
_BAND = 2.0  # sigma
_POINTS = 300  # fewer are drawn as such
_LEGEND = ".bk-label { color: var(--ink) !important; }"  # it is no part of the canvas


def residual_plots(
    curve: Envelope, record: Record, sigma: Array, disturbed: Sequence[Span_], end: float
) -> list[figure]:
    """One figure per wrench axis; where samples were left out is shaded."""
    time = curve.time.astype(np.float32)
    rejected = [(s.begin + a, s.begin + b) for s in record.logs for a, b in s.rejected]
    plots = []
    for i, axis in enumerate(AXES):
        largest = np.nanmax(np.abs(curve.values[:, i]), initial=3.0 * sigma[i])
        p = _figure(
            190, _time(end), Range1d(-1.05 * largest, 1.05 * largest), "time [s]", f"{axis} [{_UNITS[i]}]"
        )
        _strips(p, rejected, GREY, 0.25, "/")
        _strips(p, disturbed, VERMILION, 0.3, "")
        p.line(time, curve.values[:, i].astype(np.float32), line_color=BLUE, line_width=1.2)
        if len(time) < _POINTS:
            p.scatter(time, curve.values[:, i], marker="circle", size=5, color=BLUE)
        for level in (-_BAND * sigma[i], _BAND * sigma[i]):
            p.add_layout(_level(level, GREY, "dashed"))
        for series in record.logs[1:]:
            p.add_layout(Span(location=series.begin, dimension="height", line_color=GREY, line_width=1))
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
    edges = np.repeat(found.edges, 2)[1:-1]
    heights = np.column_stack([steps(found.edges, column)[1] for column in found.density.T])
    _curves(p, edges, np.where(heights > 0.0, heights, np.nan)[:, axes], AXES[axes])
    return p


def consistency_plot(found: Consistency, end: float) -> figure:
    """Mean squares over time, round inside and triangular outside of their bounds."""
    largest = float(np.abs(np.concatenate([found.value, found.low, found.high]) - 1.0).max())
    if largest < 0.9:
        y, kind = Range1d(1.0 - 1.3 * largest, 1.0 + 1.3 * largest), "linear"
    else:
        least_value = float(found.value[found.value > 0.0].min(initial=0.5))
        y, kind = Range1d(0.8 * least_value, 1.3 * (1.0 + largest)), "log"
    p = _figure(190, _time(end), y, "time [s]", "mean square [1]", y_axis_type=kind)
    least = 0.002 * end  # what can still be seen
    p.quad(
        left=found.begin, right=np.maximum(found.end, found.begin + least),
        bottom=np.maximum(found.low, float(y.start)), top=found.high,
        fill_color=GREY, fill_alpha=0.3, line_color=None,
    )  # fmt: skip
    p.add_layout(_level(1.0, GREY, "dashed"))
    middle = 0.5 * (found.begin + found.end)
    inside = (found.value >= found.low) & (found.value <= found.high)
    shown = np.maximum(found.value, float(y.start))
    p.scatter(middle[inside], shown[inside], marker="circle", size=6, color=BLUE)
    p.scatter(middle[~inside], shown[~inside], marker="triangle", size=11, color=VERMILION)
    return p


def information_plot(shares: Array, undetermined: float) -> figure:
    """What the data left of the prior sigma, direction by direction, the best known first."""
    top, bottom = 1.6, min(0.5 * float(shares.min()), 0.1)
    p = _figure(
        280, Range1d(0, len(shares) + 1), Range1d(max(bottom, 1e-7), top), "direction of the gain [number]",
        "sigma / prior sigma [1]", y_axis_type="log",
    )  # fmt: skip
    x = np.arange(1, len(shares) + 1)
    known = shares <= undetermined
    p.scatter(x[known], shares[known], marker="circle", size=7, color=BLUE, legend_label="determined")
    if not known.all():
        p.scatter(
            x[~known],
            shares[~known],
            marker="triangle",
            size=11,
            color=VERMILION,
            legend_label="undetermined",
        )
    ends = [0, len(shares) + 1]
    p.line(
        ends, [undetermined] * 2, line_color=VERMILION, line_dash="dashed", line_width=2,
        legend_label="limit: half",
    )  # fmt: skip
    _legend_above(p)
    return p


def convergence_plot(found: Convergence, end: float) -> figure:
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
    p = _figure(300, _time(end), y, "time [s]", "share of full scale [1]", y_axis_type="log")
    for label, x, values, colour, dash in curves:
        shown = np.where(values > 0.0, values, np.nan)
        p.line(x, shown, line_color=colour, line_dash=dash, line_width=2, legend_label=label)
        if len(x) < 3:
            p.scatter(x, shown, color=colour, size=7)
    ends = [0.0, end]
    p.line(
        ends,
        [found.final] * 2,
        line_color=BLUE,
        line_dash="dotted",
        line_width=2,
        legend_label="stated sigma",
    )
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


def _time(end: float) -> Range1d:
    """The time axis of one figure; the page keeps those of this name alike."""
    return Range1d(0.0, end, name="time", bounds=(0.0, end))


def _level(at: float, colour: str, dash: str) -> Span:
    return Span(location=float(at), dimension="width", line_color=colour, line_dash=dash, line_width=1.5)


def _strips(p: figure, spans: Sequence[Span_], colour: str, alpha: float, hatch: str) -> None:
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
