"""Pictures of a plan: the motion and what the sensor will feel, the limits, the promise, and the path."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from truewrench.io.pictures import AXES_COLOURS, BLUE, GREY, LINE_STYLES, VERMILION, finish
from truewrench.io.pictures.arm import arm_figure, colour_bar, heat_map
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import AXES
from truewrench.planning.limits import Usage, wrench_fraction
from truewrench.planning.result import Plan

_POINTS = 4000  # of a curve, at most
_POSTURES = 5


def draw_plan(plan: Plan, path: str | Path) -> list[Path]:
    """Draw PATH.motion.png, PATH.limits.png, PATH.sigma.png and PATH.path.png, and say which were drawn.

    What does not move has no pictures; without limits there are none of limits.
    """
    target = Path(path)
    if plan.prediction is None:
        return []

    def named(kind: str) -> Path:
        return target.with_name(f"{target.name}.{kind}.png")

    drawn = [named("motion"), named("sigma"), named("path")]
    _draw_motion(drawn[0], plan)
    _draw_sigma(drawn[1], plan)
    _draw_path(drawn[2], plan)
    if plan.usage:
        drawn.append(named("limits"))
        _draw_limits(drawn[-1], plan.usage, plan.violations)
    return drawn


def _thin(count: int) -> slice:
    return slice(None, None, max(1, count // _POINTS))


def _draw_motion(path: Path, plan: Plan) -> None:
    preview, allowed = plan.design.preview, 100.0 * wrench_fraction(plan.rig)
    shown = _thin(preview.time.size)
    time, share = preview.time[shown], 100.0 * (preview.wrench / plan.rig.sensor.range_array)[shown]
    figure = Figure(figsize=(10.4, 7.6))
    axes = figure.subplots(2, 2, sharex=True)
    figure.subplots_adjust(left=0.08, right=0.985, top=0.95, bottom=0.17, wspace=0.2, hspace=0.16)
    _three(axes[0, 0], time, preview.twist[shown, :3], ("vx", "vy", "vz"))
    _three(axes[0, 1], time, preview.twist[shown, 3:], ("wx", "wy", "wz"))
    _three(axes[1, 0], time, share[:, :3], AXES[:3])
    _three(axes[1, 1], time, share[:, 3:], AXES[3:])
    for ax in axes[1]:
        reached = np.abs(ax.get_ylim()).max()
        for sign in (-1.0, 1.0) if reached > 0.5 * allowed else ():
            ax.axhline(sign * allowed, color="black", linestyle=":", linewidth=1.2)
        ax.set_xlabel("time [s]")
    axes[0, 0].set(ylabel="velocity [m/s]", title="centre of mass, sensor axes")
    axes[0, 1].set(ylabel="angular velocity [rad/s]", title="rotation, sensor axes")
    axes[1, 0].set(ylabel="force [% of range]", title="what the sensor will feel: force")
    axes[1, 1].set(ylabel="moment [% of range]", title="moment")
    largest = int(np.argmax(np.abs(share).max(axis=0)))
    smallest = int(np.argmin(np.abs(share).max(axis=0)))
    again = plan.trajectory.duration / preview.time[-1]
    repeats = f", which repeats itself {again:.0f} times" if again > 1.5 else ""
    caption = (
        f"The plan with `{plan.payload}` over {preview.time[-1]:.3g} s{repeats}. The sensor reaches "
        f"{np.abs(share).max():.2g} % of its range in {AXES[largest]} ({allowed:.0f} % is allowed) and only "
        f"{np.abs(share[:, smallest]).max():.2g} % in {AXES[smallest]}. Conclusion: an axis shows its gains "
        f"only as far as the sensor feels it; {AXES[smallest]} is felt least."
    )
    finish(figure, path, caption)


def _three(ax: Axes, time: Array, values: Array, names: Sequence[str]) -> None:
    for column, name, colour, style in zip(values.T, names, AXES_COLOURS, LINE_STYLES, strict=False):
        ax.plot(time, column, style, color=colour, linewidth=1.3, label=name)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.14 * (high - low))  # room for the legend
    ax.legend(frameon=False, ncols=3, loc="upper right")
    ax.grid(color="0.9", linewidth=0.8)
    ax.spines[["top", "right"]].set_visible(False)
    ax.margins(x=0.01)


def _draw_limits(path: Path, usage: Sequence[Usage], violations: Sequence[str]) -> None:
    groups: dict[str, list[Usage]] = {}
    for use in usage:
        groups.setdefault(use.limit, []).append(use)
    if "clearance" in groups:  # one for all pairs
        groups["clearance"] = [max(groups["clearance"], key=lambda use: use.share)]
    count = sum(len(group) for group in groups.values())
    figure = Figure(figsize=(max(6.4, 1.6 + 0.19 * (count + len(groups))), 5.4))
    ax = figure.add_axes((0.09, 0.44, 0.87, 0.5))
    at, ticks, labels = 0.0, [], []
    for name, group in groups.items():
        first = at
        for use in group:
            bad = use.violated
            ax.bar(at, 100.0 * use.share, 0.8, color=VERMILION if bad else BLUE, hatch="//" if bad else None)
            ticks.append(at)
            labels.append("closest" if name == "clearance" else use.axis)
            at += 1.0
        ax.text(0.5 * (first + at - 1.0), 1.01, name, transform=ax.get_xaxis_transform(), ha="center",
                va="bottom", fontsize=8.5)  # fmt: skip
        at += 0.8
    ax.axhline(100.0, color="black", linestyle="--", linewidth=1.2)
    ax.set_xticks(ticks, labels, rotation=90, fontsize=7.5)
    ax.set_ylabel("largest use of the limit [%]")
    ax.set_xlim(-0.8, at - 0.6)
    ax.set_ylim(0.0, max(112.0, 104.0 * max(use.share for use in usage if np.isfinite(use.share))))
    ax.grid(axis="y", color="0.9", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    full = [f"{use.limit} of {use.axis}" for use in usage if use.share > 0.99 and not use.violated]
    if violations:
        said = f"Conclusion: do not move like this. First: {violations[0]}."
    elif full:
        rest = f" and {len(full) - 4} more" if len(full) > 4 else ""
        said = (
            f"Conclusion: within all limits; {', '.join(full[:4])}{rest} hold the motion back: wider limits "
            "there would give a more certain gain."
        )
    else:
        said = "Conclusion: within all limits, none of which is reached."
    finish(figure, path, f"Largest use of every limit, looked at 1000 times a second. {said}")


def _draw_sigma(path: Path, plan: Plan) -> None:
    found = plan.prediction
    assert found is not None
    channels, std = plan.rig.sensor.channels, 100.0 * found.std
    height = 3.4 + 0.42 * len(channels)
    figure = Figure(figsize=(10.4, height))
    axes = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    figure.subplots_adjust(left=0.06, right=0.97, top=1 - 0.45 / height, bottom=1.75 / height, wspace=0.5)
    picture = heat_map(axes[0], channels, std, "{:.2g}")
    axes[0].set_title("predicted 1 sigma of every gain [% of full scale]")
    colour_bar(figure, axes[0], picture, "sigma of the normalised gain [%]")
    bars = [("this plan", found.rms), ("if the motion were known", found.oracle_rms)]
    bars += [(f"of it: {name.replace('_', ' ')}", value) for name, value in found.limited_by.items()]
    bars += [(f"{times} times as long", value) for times, value in found.longer.items()]
    bars += [("twice the mass", found.heavier_rms)]
    bars.reverse()
    colours = [BLUE if name == "this plan" else GREY for name, _ in bars]
    axes[1].barh([name for name, _ in bars], [100.0 * value for _, value in bars], color=colours)
    for k, (_, value) in enumerate(bars):
        axes[1].text(100.0 * value, k, f" {100.0 * value:.2g}", va="center", fontsize=8.5)
    axes[1].set_xlim(0.0, 118.0 * max(value for _, value in bars))
    axes[1].set(xlabel="RMS sigma [% of full scale]", title="what limits it, and what would help")
    axes[1].spines[["top", "right"]].set_visible(False)
    required = 100.0 * plan.rig.required_array
    worst, axis = np.unravel_index(int(np.argmax(std / required)), std.shape)
    enough = bool((std <= required).all())
    source = max(found.limited_by, key=lambda name: found.limited_by[name], default="noise")
    caption = (
        f"What a calibration with this motion will state, before anything moves: {100 * found.rms:.2g} % of "
        f"full scale (RMS), at worst {std[worst, axis]:.2g} % for {channels[int(worst)]} to "
        f"{AXES[int(axis)]}. Conclusion: {'enough' if enough else 'not enough'} for the {required[axis]:g} % "
        f"that the rig requires; what limits it most is {source.replace('_', ' ')}."
    )
    finish(figure, path, caption)


def _draw_path(path: Path, plan: Plan) -> None:
    preview = plan.design.preview
    center = plan.rig.payloads[plan.payload].center_of_mass_array
    sensor = preview.p_root_sensor
    payload = sensor + preview.R_root_sensor @ center
    at = np.linspace(0, preview.time.size - 1, _POSTURES).astype(np.int64)
    has_arm = preview.skeleton.shape[1] > 0
    postures = preview.skeleton[at] if has_arm else np.stack([sensor, payload], axis=1)[at]
    shown = _thin(preview.time.size)
    travel = np.ptp(payload, axis=0)
    what = "The arm" if has_arm else "The payload (a line from sensor to centre of mass)"
    caption = (
        f"{what} at {_POSTURES} times (light: later), and the paths of sensor and centre of mass in the "
        f"{'root frame' if has_arm else 'frame in which the sensor begins'}. The centre of mass needs a box "
        f"of {travel[0]:.2g} x {travel[1]:.2g} x {travel[2]:.2g} m. Conclusion: this room has to be "
        "free before anything moves."
    )
    name = "arm" if has_arm else "sensor to centre of mass"
    arm_figure(path, postures, preview.time[shown], sensor[shown], payload[shown], caption, name=name)
