"""Draws docs/figures/frames.svg and frames.png: the frames {O}, {S}, {C} and the vectors between them."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Wedge
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Vector = NDArray[np.float64]

AXIS_COLOURS = ("#c0392b", "#1e8449", "#1f5fae")  # x, y, z
INK, ARM, SENSOR, PAYLOAD = "#222222", "#c9ced6", "#a9b4c0", "#f7ecd4"
MOTION, WRENCH = "#7d3c98", "#d35400"

# Parallel projection of [x, y, z] onto the page: x to the right, y away from the reader, z up.
PROJECTION = np.array([[1.0, 0.42, 0.0], [0.0, 0.30, 1.0]])

# Attitude of {S} and {C} in {O}: turned about y and z so that no axis hides another.
TURN_Z, TURN_Y = np.radians(-14.0), np.radians(22.0)
R_O_C = np.array(
    [
        [np.cos(TURN_Z), -np.sin(TURN_Z), 0.0],
        [np.sin(TURN_Z), np.cos(TURN_Z), 0.0],
        [0.0, 0.0, 1.0],
    ]
) @ np.array(
    [
        [np.cos(TURN_Y), 0.0, np.sin(TURN_Y)],
        [0.0, 1.0, 0.0],
        [-np.sin(TURN_Y), 0.0, np.cos(TURN_Y)],
    ]
)


def page(point: Vector) -> Vector:
    """Where a point [x, y, z] in {O} lies on the page."""
    return PROJECTION @ point


def arrow(ax: Axes, start: Vector, end: Vector, colour: str, width: float = 2.0, **style: object) -> None:
    """An arrow between two points of the page."""
    ax.annotate(
        "",
        xy=tuple(end),
        xytext=tuple(start),
        arrowprops={
            "arrowstyle": "-|>,head_width=0.28,head_length=0.55",
            "color": colour,
            "linewidth": width,
            "shrinkA": 0,
            "shrinkB": 0,
            **style,
        },
        zorder=6,
    )


def frame(ax: Axes, origin: Vector, attitude: NDArray[np.float64], length: float) -> None:
    """The three axes of a frame."""
    for axis, name, colour in zip(attitude.T, "xyz", AXIS_COLOURS, strict=True):
        tip = page(origin + length * axis)
        arrow(ax, page(origin), tip, colour, 2.2)
        beyond = page(origin + 1.17 * length * axis)
        ax.text(
            beyond[0], beyond[1], f"${name}$", color=colour, ha="center", va="center", fontsize=12, zorder=8
        )


def turning_arrow(ax: Axes, centre: Vector, axis: Vector, radius: float, colour: str) -> None:
    """A circular arrow about an axis: an angular quantity."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angles = np.radians(np.linspace(20.0, 300.0, 60))
    ring = np.array([page(centre + radius * (np.cos(t) * u + np.sin(t) * v)) for t in angles])
    ax.plot(*ring[:-2].T, color=colour, linewidth=2.0, zorder=6)
    arrow(ax, ring[-4], ring[-1], colour, 2.0)


def centre_of_mass(ax: Axes, at: Vector, radius: float = 0.055) -> None:
    """The usual black and white disc."""
    ax.add_patch(Circle(tuple(at), radius, facecolor="white", edgecolor=INK, linewidth=1.2, zorder=9))
    for start in (0, 180):
        ax.add_patch(Wedge(tuple(at), radius, start, start + 90, facecolor=INK, zorder=9))


def outline(ax: Axes, points: NDArray[np.float64], colour: str, order: float) -> None:
    """A filled body whose outline is the convex hull of projected points."""
    flat = np.array([page(p) for p in points])
    hull = flat[ConvexHull(flat).vertices]
    ax.add_patch(
        Polygon(hull, facecolor=colour, edgecolor=INK, linewidth=1.1, joinstyle="round", zorder=order)
    )


def cylinder(centre: Vector, half_length: float, radius: float) -> NDArray[np.float64]:
    """Rim points of a cylinder along x of {S}."""
    angles = np.linspace(0.0, 2.0 * np.pi, 60)
    rim = radius * np.outer(np.cos(angles), R_O_C[:, 1]) + radius * np.outer(np.sin(angles), R_O_C[:, 2])
    along = half_length * R_O_C[:, 0]
    return np.vstack([centre + along + rim, centre - along + rim])


def ellipsoid(centre: Vector, half_axes: tuple[float, float, float]) -> NDArray[np.float64]:
    """Surface points of an ellipsoid with the axes of {C}."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 80), np.linspace(0, np.pi, 40))
    local = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1).reshape(-1, 3)
    return np.asarray(centre + (local * np.array(half_axes)) @ R_O_C.T)


def draw(ax: Axes) -> None:
    """The whole scene."""
    origin = np.array([0.0, 0.0, 0.0])
    sensor = np.array([2.55, 0.2, 1.62])
    com = sensor + R_O_C @ np.array([1.40, 0.0, -0.42])

    # The arm: base, two links, the last of which carries the sensor.
    base, shoulder = np.array([1.15, 0.2, 0.0]), np.array([1.15, 0.2, 0.75])
    elbow = np.array([1.35, 0.2, 1.95])
    wrist = sensor - 0.20 * R_O_C[:, 0]
    joints = np.array([page(p) for p in (base, shoulder, elbow, wrist)])
    for width, colour, order in ((19, INK, 1.0), (16.5, ARM, 1.1)):
        ax.plot(*joints.T, color=colour, linewidth=width, solid_capstyle="round", zorder=order)
    for joint in joints[1:3]:
        ax.add_patch(Circle(tuple(joint), 0.075, facecolor="white", edgecolor=INK, linewidth=1.1, zorder=1.3))
    ground = page(base)
    ax.plot([ground[0] - 0.34, ground[0] + 0.34], [ground[1] - 0.14] * 2, color=INK, linewidth=3, zorder=1.5)
    ax.text(ground[0], ground[1] - 0.30, "arm", color="#5d6673", fontsize=11, ha="center", va="center")

    outline(ax, ellipsoid(com, (1.30, 0.8, 0.98)), PAYLOAD, 2.0)
    outline(ax, cylinder(sensor, 0.13, 0.36), SENSOR, 3.0)

    # Places: pose of {C} in {O}, and c from {S} to {C}.
    arrow(ax, page(origin), page(com), INK, 1.2, linestyle=(0, (5, 3)))
    arrow(ax, page(sensor), page(com), INK, 2.6)

    frame(ax, origin, np.eye(3), 0.62)
    frame(ax, sensor, R_O_C, 0.72)
    frame(ax, com, R_O_C, 0.72)
    centre_of_mass(ax, page(com))
    for at in (sensor, origin):
        ax.add_patch(Circle(tuple(page(at)), 0.035, facecolor=INK, zorder=9))

    # Motion at {C}, wrench at {S}, gravity.
    velocity = com + R_O_C @ np.array([0.15, -0.1, -0.78])
    arrow(ax, page(com), page(velocity), MOTION, 2.8)
    spin = R_O_C @ np.array([0.95, -0.15, 0.42])
    spin /= np.linalg.norm(spin)
    arrow(ax, page(com), page(com + 0.95 * spin), MOTION, 2.8)
    turning_arrow(ax, com + 0.66 * spin, spin, 0.17, MOTION)
    force = sensor + R_O_C @ np.array([-0.55, -0.1, 0.72])
    arrow(ax, page(sensor), page(force), WRENCH, 2.8)
    moment = R_O_C @ np.array([-0.35, -0.25, -0.9])
    moment /= np.linalg.norm(moment)
    arrow(ax, page(sensor), page(sensor + 0.95 * moment), WRENCH, 2.8)
    turning_arrow(ax, sensor + 0.66 * moment, moment, 0.17, WRENCH)
    above = np.array([0.25, 3.05])
    arrow(ax, above, above - [0.0, 0.62], INK, 2.0)

    def write(at: Vector, text: str, colour: str = INK, size: int = 14) -> None:
        ax.text(at[0], at[1], text, color=colour, fontsize=size, ha="center", va="center", zorder=10)

    write(page(origin) + [-0.24, -0.10], r"$\{O\}$")
    write(page(sensor) + [0.80, 0.17], r"$\{S\}$")
    write(page(com) + [-0.30, -0.22], r"$\{C\}$")
    write(0.5 * (page(sensor) + page(com)) + [-0.10, -0.12], r"$c$", size=16)
    write(page(0.57 * com) + [0.0, 0.14], r"$r,\ R$", size=16)
    write(page(velocity) + [0.15, -0.05], r"$v$", MOTION, 16)
    write(page(com + 1.1 * spin) + [0.04, 0.08], r"$\Omega$", MOTION, 16)
    write(page(force) + [-0.03, 0.15], r"$f$", WRENCH, 16)
    write(page(sensor + 1.1 * moment) + [0.0, -0.03], r"$n$", WRENCH, 16)
    write(above + [0.17, -0.35], r"$g$", size=16)


def explain(ax: Axes) -> None:
    """The words beside the scene."""
    lines = (
        (INK, r"$\{O\}$", "inertial frame"),
        (INK, r"$\{S\}$", "sensor centre; every wrench acts\nhere and is given in these axes"),
        (INK, r"$\{C\}$", "payload's centre of mass,\naxes parallel to $\\{S\\}$"),
        (INK, r"$c$", "from $\\{S\\}$ to $\\{C\\}$, in $\\{S\\}$ [m]"),
        (INK, r"$r,\ R$", "position and attitude of $\\{C\\}$ in $\\{O\\}$"),
        (MOTION, r"$\nu = [v;\ \Omega]$", "twist of $\\{C\\}$, in $\\{C\\}$"),
        (WRENCH, r"$w = [f;\ n]$", "what the payload does to\nthe sensor, at $\\{S\\}$"),
        (INK, r"$g$", "free fall; zero on orbit"),
    )
    y = 3.05
    for colour, symbol, words in lines:
        ax.text(6.45, y, symbol, color=colour, fontsize=14, ha="right", va="top", zorder=10)
        ax.text(6.62, y, words, color=INK, fontsize=11, ha="left", va="top", linespacing=1.35)
        y -= 0.34 + 0.17 * words.count("\n")


def main() -> None:
    """Writes both files beside this script."""
    matplotlib.rcParams["svg.hashsalt"] = "truewrench"  # the same file from the same drawing
    figure = Figure(figsize=(11, 4.4))
    ax = figure.subplots()
    ax.set_aspect("equal")
    ax.axis("off")
    draw(ax)
    explain(ax)
    ax.set_xlim(-0.5, 9.0)
    ax.set_ylim(-0.4, 3.25)
    figure.tight_layout(pad=0.3)
    here = Path(__file__).parent
    figure.savefig(here / "frames.svg", metadata={"Date": None})
    figure.savefig(here / "frames.png", dpi=110)


if __name__ == "__main__":
    main()
