"""Pictures of a calibration with an arm: what the arm did, and how far off the gain is, with its sigma."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from truewrench.report.figures import (
    AXES_COLOURS,
    BLUE,
    GREEN,
    GREY,
    LINE_STYLES,
    ORANGE,
    PURPLE,
    VERMILION,
    finish,
)

__all__ = ["arm_figure", "colour_bar", "driven_figure", "gain_figure", "heat_map"]

Array = NDArray[np.float64]

_AXES = ("fx", "fy", "fz", "mx", "my", "mz")
_JOINT_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, GREY, "black", "#56B4E9")


def arm_figure(
    path: Path,
    postures: Array,
    time: Array,
    sensor: Array,
    payload: Array,
    caption: str,
    *,
    name: str = "arm",
) -> None:
    """Draw an arm in space: some postures, and the paths of sensor and payload.

    Args:
        path: of the picture.
        postures: (K, m, 3) points along the arm, root first, the earliest posture first [m].
        time: (N,) of the paths [s].
        sensor: (N, 3) positions of the sensor [m].
        payload: (N, 3) positions of the payload's centre of mass [m].
        caption: what it shows.
        name: of what the postures are.
    """
    figure = Figure(figsize=(8.2, 8.0))
    ax = figure.add_axes((0.0, 0.14, 0.84, 0.86), projection="3d")
    assert isinstance(ax, Axes3D)
    for k, posture in enumerate(postures):
        shade = f"{0.25 + 0.5 * k / max(1, len(postures) - 1):.2f}"
        ax.plot(*posture.T, "-o", color=shade, linewidth=2.4, markersize=4, label=name if k == 0 else None)
    ax.plot(*postures[0, :1].T, "s", color="black", markersize=9, label="root")
    ax.plot(*sensor.T, color=VERMILION, linewidth=1.2, label="sensor")
    points = payload[:, None, :]
    line = Line3DCollection(np.concatenate([points[:-1], points[1:]], axis=1), cmap="cividis", linewidths=2.4)
    line.set_array(time[:-1])
    ax.add_collection3d(line)
    every = np.concatenate([postures.reshape(-1, 3), sensor, payload])
    low, high = every.min(axis=0), every.max(axis=0)
    middle, half = 0.5 * (low + high), 0.55 * (high - low) + 0.03 * float((high - low).max())
    ends = [(float(a), float(b)) for a, b in zip(middle - half, middle + half, strict=True)]
    ax.set(xlim=ends[0], ylim=ends[1], zlim=ends[2], xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.set_box_aspect(2.0 * half, zoom=0.94)
    ax.view_init(elev=22, azim=-58)
    ax.legend(frameon=False, loc="upper left", ncols=3)
    bar = figure.colorbar(line, cax=figure.add_axes((0.9, 0.36, 0.022, 0.42)))
    bar.set_label("payload, time [s]")
    finish(figure, path, caption)


def driven_figure(
    path: Path,
    joints: Sequence[str],
    time: Array,
    velocity: Array,
    error: Array,
    wrench: tuple[Array, Array],
    caption: str,
) -> None:
    """Draw joint velocities and how far they are from the plan, and the wrench in percent of range.

    Args:
        path: of the picture.
        joints: n names.
        time: (N,) of the joints [s].
        velocity: (N, n) [rad/s, m/s].
        error: (N, n) velocity minus plan.
        wrench: times (M,) [s] and wrench over range (M, 6).
        caption: what it shows.
    """
    figure = Figure(figsize=(10.4, 8.6))
    axes = figure.subplots(2, 2, sharex=True)
    figure.subplots_adjust(left=0.08, right=0.985, top=0.95, bottom=0.255, wspace=0.2, hspace=0.16)
    for k, name in enumerate(joints):
        colour, style = _JOINT_COLOURS[k % 8], LINE_STYLES[k % 4]
        axes[0, 0].plot(time, velocity[:, k], style, color=colour, linewidth=1.3, label=name)
        axes[0, 1].plot(time, 1e3 * error[:, k], style, color=colour, linewidth=1.1)
    at, share = wrench
    for ax, first in ((axes[1, 0], 0), (axes[1, 1], 3)):
        for k in range(3):
            colour, style = AXES_COLOURS[k], LINE_STYLES[k]
            ax.plot(
                at, 100.0 * share[:, first + k], style, color=colour, linewidth=1.3, label=_AXES[first + k]
            )
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.12 * (high - low))  # room for the legend
        ax.legend(frameon=False, ncols=3, loc="upper right")
        ax.set_xlabel("time [s]")
    axes[0, 0].set(ylabel="joint velocity [rad/s]", title="what the joints did")
    axes[0, 1].set(ylabel="velocity minus plan [mrad/s]", title="how far that is from the plan")
    axes[1, 0].set(ylabel="force [% of range]", title="what the sensor felt: force")
    axes[1, 1].set(ylabel="moment [% of range]", title="moment")
    for ax in axes.ravel():
        ax.grid(color="0.9", linewidth=0.8)
        ax.spines[["top", "right"]].set_visible(False)
        ax.margins(x=0.01)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="lower center", bbox_to_anchor=(0.53, 0.12), ncols=4,
        frameon=False, columnspacing=1.2,
    )  # fmt: skip
    finish(figure, path, caption)


def gain_figure(
    path: Path, channels: Sequence[str], sigma: Sequence[tuple[str, Array]], error: Array, caption: str
) -> None:
    """Draw sigma of every gain, one heat map per prediction, and the errors in units of the last of them.

    Args:
        path: of the picture.
        channels: n names.
        sigma: titles and normalised sigma (n, 6).
        error: (n, 6) normalised.
        caption: what it shows.
    """
    n, count = len(channels), len(sigma) + 1
    height = 3.1 + 0.45 * n
    figure = Figure(figsize=(4.4 * count, height))
    axes = figure.subplots(1, count, squeeze=False)[0]
    figure.subplots_adjust(left=0.05, right=0.985, top=1.0 - 0.45 / height, bottom=1.75 / height, wspace=0.12)
    every = 1e3 * np.concatenate([values.ravel() for _, values in sigma])
    for ax, (title, values) in zip(axes, sigma, strict=False):
        norm = LogNorm(float(every.min()), float(every.max()))  # one for all
        picture = heat_map(ax, channels, 1e3 * values, "{:.2f}", norm)
        ax.set_title(title)
        colour_bar(figure, ax, picture, "sigma of the normalised gain [0.001]")
    deviation = error / sigma[-1][1]
    largest = max(3.0, float(np.abs(deviation).max()))
    picture = heat_map(
        axes[-1], channels, deviation, "{:+z.1f}", norm=Normalize(-largest, largest), cmap="RdBu_r"
    )
    axes[-1].set_title("error of this run over its sigma")
    colour_bar(figure, axes[-1], picture, "error / sigma [1]")
    finish(figure, path, caption)


def heat_map(
    ax: Axes,
    channels: Sequence[str],
    values: Array,
    form: str,
    norm: Any = None,
    cmap: str = "cividis",
) -> Any:
    """Draw values (n, 6) of gains, each with its number; logarithmic colours unless a norm is given."""
    if norm is None:
        norm = LogNorm(float(values.min()), float(values.max()) * 1.0001)
    picture = ax.imshow(values, norm=norm, cmap=cmap, aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        red, green, blue, _ = picture.cmap(norm(value))
        dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        colour = "white" if dark else "black"
        ax.text(j, i, form.format(value), ha="center", va="center", color=colour, fontsize=8.5)
    ax.set_xticks(range(6), _AXES)
    ax.set_yticks(range(len(channels)), channels)
    ax.set_xlabel("wrench axis")
    return picture


def colour_bar(figure: Figure, ax: Axes, picture: Any, label: str) -> None:
    """Draw the scale of a heat map below it."""
    bar = figure.colorbar(picture, ax=ax, orientation="horizontal", fraction=0.06, pad=0.2)
    bar.set_label(label)
    if isinstance(picture.norm, LogNorm):
        low, high = float(picture.norm.vmin or 0.0), float(picture.norm.vmax or 0.0)
        ticks = [digit * 10.0**k for k in range(-6, 7) for digit in (1, 2, 5)]
        inside = [tick for tick in ticks if low <= tick <= high]
        bar.set_ticks(inside, labels=[f"{tick:g}" for tick in inside])
        bar.ax.minorticks_off()
