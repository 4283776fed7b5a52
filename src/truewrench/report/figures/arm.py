"""Pictures of a calibration with an arm: what the arm did, and how far off the gain is, with its sigma."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from truewrench.io.pictures import (
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
from truewrench.io.pictures.arm import colour_bar, heat_map
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import AXES

_JOINT_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, GREY, "black", "#56B4E9")


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

    At times (N,) [s], velocity (N, n) [rad/s, m/s] and its error, less the plan; the wrench is times (M,) [s]
    and wrench over range (M, 6).
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
                at, 100.0 * share[:, first + k], style, color=colour, linewidth=1.3, label=AXES[first + k]
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

    Sigma, with its titles, and error are (n, 6) normalised.
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
