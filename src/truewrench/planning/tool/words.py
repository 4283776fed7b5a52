"""A plan for a tool in words, for the terminal."""

from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from truewrench.planning.tool.plan import ToolPlan
from truewrench.planning.words import verdict_words
from truewrench.tool.parameters import ELEMENTS


def tool_plan_words(plan: ToolPlan) -> Iterator[RenderableType]:
    """The verdict first, then what the poses or the motion promise."""
    seconds = plan.design.motion.duration
    what = (
        f"{len(plan.fall)} poses in {seconds:.3g} s" if plan.kind == "poses" else f"{seconds:g} s of motion"
    )
    yield verdict_words(plan.feasible, f"{what}, within all limits.", plan.violations, plan.notes)
    if plan.prediction is not None:
        yield Text(_promise(plan))
    yield Text(f"Time: {plan.seconds:.1f} s")


def _promise(plan: ToolPlan) -> str:
    found = plan.prediction
    assert found is not None
    center = " ".join(f"{1e3 * one:.2g}" for one in found.center_of_mass_std)
    lines = [
        f"Predicted 1 sigma, for a tool of {found.mass:.4g} kg:",
        f"  mass             {found.mass_std:.2g} kg ({100.0 * found.mass_std / found.mass:.2g} %)",
        f"  centre of mass   {center} mm",
    ]
    if found.inertia_std is None:
        lines.append("  inertia          not determined by poses")
    else:
        told = ", ".join(f"{name} {one:.2g}" for name, one in zip(ELEMENTS, found.inertia_std, strict=True))
        lines.append(f"  inertia          {told} kg m^2")
    for words, six in (
        ("contact, at rest, right after", found.contact_std),
        ("an hour later, without a tare", found.contact_std_later),
    ):
        force, moment = (" ".join(f"{one:.2g}" for one in part) for part in np.split(six, 2))
        lines.append(f"  {words}: {force} N, {moment} N m")
    return "\n".join(lines)
