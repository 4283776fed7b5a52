"""A tool in words: for the terminal, and correlations for its page."""

from collections.abc import Iterator

import numpy as np

from truewrench.model.calibration import AXES
from truewrench.tool.model import Tool
from truewrench.tool.parameters import ELEMENTS

_STRONG = 0.7


def tool_summary(tool: Tool) -> str:
    """Verdict first, then what was found; what was not determined is named and not printed as a number."""
    return "\n".join(_lines(tool))


def _lines(tool: Tool) -> Iterator[str]:
    yield "usable" if tool.verdict.usable else "NOT to be used as it stands"
    yield from (f"  {reason}" for reason in tool.verdict.reasons)
    known = tool.determined
    if known["mass"]:
        yield f"mass            {tool.mass:.5g} kg +- {tool.mass_std:.2g}"
    else:
        yield "mass            not determined"
    if tool.below is not None:
        yield f"sits on         {np.exp(tool.below[0]):.5g} kg; together {tool.whole.mass:.5g} kg"
    for axis, value, std, told in zip(
        "xyz", tool.center_of_mass, tool.center_of_mass_std, known["center_of_mass"], strict=True
    ):
        said = f"{1e3 * value:.5g} mm +- {1e3 * std:.2g}" if told else "not determined"
        yield f"centre of mass {axis} {said}"
    for name, value, std, told in zip(
        ELEMENTS, tool.inertia, tool.inertia_std, known["inertia"], strict=True
    ):
        said = f"{value:.4g} kg m^2 +- {std:.2g}" if told else "not determined"
        yield f"inertia {name}      {said}"
    yield (
        "offset          "
        + ", ".join(f"{v:.4g}" for v in tool.offset)
        + " +- "
        + ", ".join(f"{s:.2g}" for s in tool.offset_std)
    )
    held = tool.held_out
    if held.force is not None:
        yield (
            f"held-out poses  {held.force:.3g} N, {held.moment:.3g} N m left; the usual recipe leaves "
            f"{held.recipe_force:.3g} N, {held.recipe_moment:.3g} N m"
        )
    for kind in ("filters", "vibrations"):
        yield from (f"found: {words}" for words in tool.figures.get(kind, ()))
    yield from (f"  {one.words}" for one in tool.verdict.undetermined)
    yield from (f"next: {need}" for need in tool.verdict.needed)


def correlations(tool: Tool) -> list[str]:
    """Which quantities of the tool stand and fall with which of the sensor, strongest first, in words."""
    layout = tool.layout
    std = np.sqrt(np.maximum(np.diag(tool.covariance), 1e-300))
    rho = tool.covariance / np.outer(std, std)
    body = range(layout.body.start, layout.body.start + 4)
    of_sensor = _of_sensor(tool)
    pairs = sorted(((abs(rho[i, j]), i, j) for i in body for j in of_sensor), reverse=True)
    more = ("A larger mass", *(f"A centre of mass further along {axis}" for axis in "xyz"))
    return [
        f"{more[i - body.start]} goes with a {'larger' if rho[i, j] > 0.0 else 'smaller'} {of_sensor[j]} "
        f"({rho[i, j]:+.2f})."
        for size, i, j in pairs[:8]
        if size > _STRONG
    ]


def _of_sensor(tool: Tool) -> dict[int, str]:
    """What the parameters that are not the body's are called."""
    layout, channels = tool.layout, tool.rig.sensor.channels
    names = [f"gain of channel {channel} by {axis}" for channel in channels for axis in AXES]
    out = dict(enumerate(names, layout.gain.start))
    out |= dict(enumerate((f"offset of {channel}" for channel in channels), layout.offset.start))
    turns = ("roll", "pitch", "yaw")
    out |= dict(enumerate((f"mounting {turn}" for turn in turns), layout.mounting.start))
    return out | dict(enumerate(("first tilt of gravity", "second tilt of gravity"), layout.tilt.start))
