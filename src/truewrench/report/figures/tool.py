"""Pictures of a tool: what was found beside the truth, and the contact wrench in time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from truewrench.io.pictures import AXES_COLOURS, BLUE, GREY, LINE_STYLES, ORANGE, finish
from truewrench.model.arrays import Array


def body_figure(
    path: Path, names: Sequence[str], errors: Array, found: Array, promised: Array, caption: str
) -> None:
    """Errors of a body's figures and their sigma, each in percent of what stands in its name.

    Of K figures: errors, found less true, the sigma that the identification states, and that which the plan
    promised, NaN where it promised none.
    """
    figure = Figure(figsize=(9.2, 5.6))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.255, right=0.98, top=0.9, bottom=0.33)
    rows = np.arange(len(names))[::-1]
    axes.barh(
        rows, 200.0 * promised, left=-100.0 * promised, height=0.75, color="0.88", label="plan, 1 sigma"
    )
    axes.barh(
        rows, 200.0 * found, left=-100.0 * found, height=0.4, color=ORANGE, alpha=0.7, label="found, 1 sigma"
    )
    axes.plot(100.0 * errors, rows, "o", color=BLUE, label="found less true")
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.set_yticks(rows, list(names))
    axes.set(xlabel="% of what is named on the left")
    axes.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    finish(figure, path, caption)


def contact_figure(
    path: Path,
    time: Array,
    contact: Array,
    std: Array,
    true: Array,
    tared: Array,
    caption: str,
) -> None:
    """The contact wrench in time: force and moment, and beside them the wrench that was only tared.

    At times (N,) [s]: the wrench found (N, 6) [N, N m], its 1 sigma, that with which the tool was pressed,
    and the raw one less that of the first row.
    """
    figure = Figure(figsize=(10.4, 7.6))
    grid = figure.subplots(2, 2, sharex=True)
    figure.subplots_adjust(left=0.08, right=0.985, top=0.93, bottom=0.21, wspace=0.2, hspace=0.14)
    for row, (part, unit, names) in enumerate(
        ((slice(0, 3), "N", ("fx", "fy", "fz")), (slice(3, 6), "N m", ("mx", "my", "mz")))
    ):
        for k, name in enumerate(names):
            colour, style = AXES_COLOURS[k], LINE_STYLES[k]
            values, sigma = contact[:, part][:, k], std[:, part][:, k]
            grid[row, 0].plot(time, tared[:, part][:, k], color=colour, linestyle=style, label=name)
            ax = grid[row, 1]
            ax.fill_between(
                time, values - 2.0 * sigma, values + 2.0 * sigma, color=colour, alpha=0.25, linewidth=0
            )
            ax.plot(time, true[:, part][:, k], color="0.75", linewidth=3.5, label="true" if k == 0 else None)
            ax.plot(time, values, color=colour, linestyle=style, linewidth=1.0, label=name)
        for ax in grid[row]:
            ax.set_ylabel(f"{'force' if row == 0 else 'moment'} [{unit}]")
            ax.legend(frameon=False, ncols=4, loc="upper left", fontsize=9)
            low, high = ax.get_ylim()
            ax.set_ylim(low, high + 0.25 * (high - low))
    grid[0, 0].set_title("tared at the start: weight and inertia of the tool remain", fontsize=10)
    grid[0, 1].set_title("contact wrench, 2 sigma shaded", fontsize=10)
    for ax in grid[1]:
        ax.set(xlabel="time [s]", xlim=(time[0], time[-1]))
    finish(figure, path, caption)
