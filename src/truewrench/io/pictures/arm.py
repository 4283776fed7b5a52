"""An arm in space, and gains as a heat map: pictures that plans and calibrations have in common."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from truewrench.io.pictures import VERMILION, finish
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import AXES


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

    Postures (K, m, 3), of what `name` says, are points along the arm, root first, the earliest posture first
    [m]. At times (N,) [s], the sensor and the payload's centre of mass are at (N, 3) [m].
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
    ax.set_xticks(range(6), AXES)
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
