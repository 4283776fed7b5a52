"""The picture of poses that determine a tool: where gravity points, and when, and what that promises."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truewrench.io.pictures import AXES_COLOURS, BLUE, GREY, LINE_STYLES, VERMILION, finish
from truewrench.model.arrays import Array
from truewrench.planning.tool.plan import ToolPlan

_POINTS = 4000  # of a curve, at most


def draw_tool_plan(plan: ToolPlan, path: str | Path) -> list[Path]:
    """Draw PATH.poses.png of a plan of poses; a motion, and what does not move, has none."""
    if plan.kind != "poses" or plan.prediction is None:
        return []
    target = Path(path)
    target = target.with_name(f"{target.name}.poses.png")
    found, preview = plan.prediction, plan.design.preview
    figure = Figure(figsize=(10.4, 7.4))
    box = {"left": 0.08, "right": 0.985, "top": 0.95, "bottom": 0.2, "hspace": 0.3, "wspace": 0.1}
    grid = figure.add_gridspec(2, 2, height_ratios=(1.35, 1.0), **box)
    draw_hemispheres((figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])), plan.fall)
    axes = figure.add_subplot(grid[1, :])
    thin = slice(None, None, max(1, preview.time.size // _POINTS))
    direction = preview.gravity / np.linalg.norm(preview.gravity, axis=1, keepdims=True)
    for k, (name, colour, style) in enumerate(zip("xyz", AXES_COLOURS, LINE_STYLES, strict=False)):
        axes.plot(preview.time[thin], direction[thin, k], color=colour, linestyle=style, label=name)
    for begin, end in plan.dwells:
        axes.axvspan(begin, end, color="0.9", linewidth=0)
    axes.set(xlabel="time [s]", ylabel="gravity in the sensor, unit vector", xlim=(0.0, preview.time[-1]))
    axes.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    center, contact = 1e3 * found.center_of_mass_std.max(), found.contact_std[:3].max()
    caption = (
        f"Above: directions of gravity in sensor axes that {len(plan.fall)} poses show, numbered in their "
        "order; opposite ones follow each other, so that a drifting offset cancels. Below: the same over "
        f"time, dwells grey. Predicted for {found.mass:.3g} kg, 1 sigma: mass {found.mass_std:.2g} kg, "
        f"centre of mass {center:.2g} mm, a contact force at rest {contact:.2g} N. Conclusion: "
        + (
            "mass and centre of mass will be known; the inertia needs a motion."
            if plan.feasible
            else "NOT to be used as it stands: " + "; ".join(plan.violations) + "."
        )
    )
    finish(figure, target, caption)
    return [target]


def draw_hemispheres(axes: tuple[Axes, Axes], fall: Array) -> None:
    """Directions (T, 3), seen along -z: the half with z up and that with z down, numbered in their order."""
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    for half, ax in enumerate(axes):
        ax.plot(np.cos(turn), np.sin(turn), color=GREY, linewidth=1.0)
        here = (fall[:, 2] >= 0.0) == (half == 0)
        colour = BLUE if half == 0 else VERMILION
        ax.plot(*fall[here, :2].T, "o" if half == 0 else "s", color=colour, markersize=5)
        for k in np.flatnonzero(here):
            x, y = fall[k, :2].tolist()
            ax.annotate(str(k + 1), (x, y), xytext=(5, 4), textcoords="offset points", fontsize=9)
        ax.set(aspect="equal", xlim=(-1.15, 1.15), ylim=(-1.15, 1.15), xlabel="x", ylabel="y")
        ax.set_title("gravity with z > 0" if half == 0 else "gravity with z < 0", fontsize=10)
