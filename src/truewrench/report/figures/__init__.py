"""The figures of the demo: path, gain error and reading error (after [A00] 2-4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from truewrench.io.pictures import AXES_COLOURS, FONT, finish
from truewrench.model.arrays import Array


@dataclass(frozen=True, slots=True)
class Curve:
    """One estimator in a figure: a history, or, with a single point, the result of the whole record."""

    label: str
    time: Array  # (K,) [s]
    distance: Array  # (K,) ||C - Cest||_inf
    colour: str
    style: str = "-"
    marker: str = "o"
    drawstyle: Literal["default", "steps-post"] = "default"


@dataclass(frozen=True, slots=True)
class Panel:
    """Curves in one noise setting."""

    title: str
    curves: Sequence[Curve]


@dataclass(frozen=True, slots=True)
class ReadingError:
    """Wrench read through an estimated gain minus the true wrench: lengths of force and moment over time."""

    label: str
    time: Array  # (K,) [s]
    force: Array  # (K,) [N]
    moment: Array  # (K,) [N m]
    colour: str
    style: str = "-"


@dataclass(frozen=True, slots=True)
class ReadingPanels:
    """Reading errors in one noise setting, beside the noise of force [N] and moment [N m]."""

    title: str
    curves: Sequence[ReadingError]
    noise: tuple[float, float]


def path_figure(path: Path, time: Array, position: Array, rotation: Array, caption: str) -> None:
    """Draw the path of the sensor (N, 3) [m] in space, with its axes (N, 3, 3) every second."""
    figure = Figure(figsize=(7.2, 7.8))
    ax = figure.add_axes((0.0, 0.20, 0.88, 0.80), projection="3d")
    assert isinstance(ax, Axes3D)
    points = position[:, None, :]
    line = Line3DCollection(np.concatenate([points[:-1], points[1:]], axis=1), cmap="cividis", linewidths=2.6)
    line.set_array(time[:-1])
    ax.add_collection3d(line)
    low, high = position.min(axis=0), position.max(axis=0)
    span, margin = (high - low).max(), 0.08 * (high - low).max()
    for k in np.searchsorted(time, np.arange(0.0, time[-1] + 1e-9, 1.0)):
        for axis, colour in zip(rotation[k].T, AXES_COLOURS, strict=True):
            ends = np.stack([position[k], position[k] + 0.07 * span * axis])
            ax.plot(*ends.T, color=colour, linewidth=1.6)
    for k, name in ((0, "start"), (-1, f"{time[-1]:.0f} s")):
        ax.scatter(*position[k], color="black", s=26, depthshade=False)
        ax.text(*(position[k] + [0.10 * span, 0.0, 0.03 * span]), name, fontsize=FONT + 1)
    bounds = zip(low - margin, high + margin, strict=True)
    ax.set(**dict(zip(("xlim", "ylim", "zlim"), bounds, strict=True)))
    ax.set_box_aspect(high - low + 2 * margin, zoom=0.98)
    ax.set_xlabel("x [m]", labelpad=6)
    ax.set_ylabel("y [m]", labelpad=12)
    ax.set_zlabel("z [m]", labelpad=6)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MultipleLocator(1.0))
    ax.view_init(elev=20, azim=-52)
    bar = figure.colorbar(line, cax=figure.add_axes((0.86, 0.38, 0.025, 0.42)))
    bar.set_label("time [s]")
    finish(figure, path, caption)


def convergence_figure(path: Path, panels: Sequence[Panel], caption: str) -> None:
    """Draw ||C - Cest||_inf over time on a logarithmic axis, one panel per noise setting."""
    figure = Figure(figsize=(5.2 * len(panels), 6.3))
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    figure.subplots_adjust(left=0.085, right=0.985, top=0.935, bottom=0.365, wspace=0.07)
    for ax, panel in zip(axes, panels, strict=True):
        for curve in panel.curves:
            if curve.time.size == 1:
                ax.plot(curve.time, curve.distance, curve.marker, color=curve.colour, markersize=8,
                        markeredgecolor="white", label=curve.label, clip_on=False, zorder=5)  # fmt: skip
            else:
                ax.plot(
                    curve.time,
                    curve.distance,
                    curve.style,
                    color=curve.colour,
                    linewidth=2,
                    label=curve.label,
                    drawstyle=curve.drawstyle,
                )
        _logarithmic(ax)
        ax.set_title(panel.title, fontsize=FONT + 1)
        ax.set_xlabel("time [s]")
    axes[0].set_ylabel(r"gain error $\|C-\hat{C}\|_\infty$ [SI units]")
    _legend(figure, axes[0], 0.215)
    finish(figure, path, caption)


def reading_error_figure(path: Path, columns: Sequence[ReadingPanels], caption: str) -> None:
    """Draw lengths of force and moment reading errors over time, one column per noise setting."""
    figure = Figure(figsize=(5.2 * len(columns), 7.6))
    axes = figure.subplots(2, len(columns), sharex=True, sharey="row", squeeze=False)
    figure.subplots_adjust(left=0.085, right=0.985, top=0.945, bottom=0.285, wspace=0.07, hspace=0.10)
    for column, panels in zip(axes.T, columns, strict=True):
        for curve in panels.curves:
            for ax, values in zip(column, (curve.force, curve.moment), strict=True):
                ax.plot(curve.time, values, curve.style, color=curve.colour, linewidth=1.4, label=curve.label)
        for ax, noise in zip(column, panels.noise, strict=True):
            ax.axhline(noise, color="black", linestyle=":", linewidth=1.4, label="noise of the sensor")
            _logarithmic(ax)
        column[0].set_title(panels.title, fontsize=FONT + 1)
        column[1].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("force reading error [N]")
    axes[1, 0].set_ylabel("moment reading error [N m]")
    _legend(figure, axes[0, 0], 0.155)
    finish(figure, path, caption)


def _logarithmic(ax: Axes) -> None:
    ax.set_yscale("log")
    ax.grid(which="major", color="0.88", linewidth=0.8)
    ax.spines[["top", "right"]].set_visible(False)
    ax.margins(x=0.01)


def _legend(figure: Figure, ax: Axes, height: float) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", bbox_to_anchor=(0.53, height), ncols=3, frameon=False)
