"""Pictures of a calibration with an arm: what the arm did, and how far off the gain is, with its sigma."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from truewrench.figures import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, finish

__all__ = ["driven_figure", "gain_figure"]

Array = NDArray[np.float64]

_AXES = ("fx", "fy", "fz", "mx", "my", "mz")
_JOINT_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, GREY, "black", "#56B4E9")
_STYLES = ("-", "--", "-.", ":")


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
        colour, style = _JOINT_COLOURS[k % 8], _STYLES[k % 4]
        axes[0, 0].plot(time, velocity[:, k], style, color=colour, linewidth=1.3, label=name)
        axes[0, 1].plot(time, 1e3 * error[:, k], style, color=colour, linewidth=1.1)
    at, share = wrench
    for ax, first in ((axes[1, 0], 0), (axes[1, 1], 3)):
        for k in range(3):
            colour, style = (BLUE, VERMILION, GREEN)[k], _STYLES[k]
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
        picture = _heat_map(ax, channels, 1e3 * values, "{:.2f}", norm)
        ax.set_title(title)
        _bar(figure, ax, picture, "sigma of the normalised gain [0.001]")
    deviation = error / sigma[-1][1]
    largest = max(3.0, float(np.abs(deviation).max()))
    picture = _heat_map(
        axes[-1], channels, deviation, "{:+z.1f}", norm=Normalize(-largest, largest), cmap="RdBu_r"
    )
    axes[-1].set_title("error of this run over its sigma")
    _bar(figure, axes[-1], picture, "error / sigma [1]")
    finish(figure, path, caption)


def _heat_map(
    ax: Axes, channels: Sequence[str], values: Array, form: str, norm: Any, cmap: str = "cividis"
) -> Any:
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


def _bar(figure: Figure, ax: Axes, picture: Any, label: str) -> None:
    bar = figure.colorbar(picture, ax=ax, orientation="horizontal", fraction=0.06, pad=0.2)
    bar.set_label(label)
    if isinstance(picture.norm, LogNorm):
        low, high = float(picture.norm.vmin or 0.0), float(picture.norm.vmax or 0.0)
        ticks = [digit * 10.0**k for k in range(-6, 7) for digit in (1, 2, 5)]
        inside = [tick for tick in ticks if low <= tick <= high]
        bar.set_ticks(inside, labels=[f"{tick:g}" for tick in inside])
        bar.ax.minorticks_off()
