"""A plan in words, for the terminal."""

from collections.abc import Iterable, Iterator

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from truewrench.io.terminal import titled_table, verdict_text
from truewrench.model.calibration_parts import AXES
from truewrench.planning.result import Plan

_SHOWN = 8  # limits, the ones that are used most


def plan_words(plan: Plan) -> Iterator[RenderableType]:
    """The verdict first, then what the motion promises and what it uses of the limits."""
    verdict = plan.verdict
    within = f"{plan.trajectory.duration:g} s within all limits."
    yield verdict_words(verdict.usable, within, verdict.reasons, plan.notes)
    if plan.prediction is not None:
        yield Text(_promise(plan))
        yield Text(_hidden(plan))
        yield _sigma(plan)
    if plan.usage:
        yield _limits(plan)
    yield Text(f"Time: {plan.seconds:.1f} s")


def verdict_words(feasible: bool, within: str, reasons: Iterable[str], notes: Iterable[str]) -> Text:
    """What every plan says first: `within` where it is feasible, why not where it is not, and its notes."""
    text = verdict_text(feasible, "FEASIBLE", f": {within}", reasons)
    for note in notes:
        text.append(f"\nNote: {note}")
    return text


def _promise(plan: Plan) -> str:
    found = plan.prediction
    assert found is not None
    sources = ", ".join(f"{name.replace('_', ' ')} {100 * s:.2g} %" for name, s in found.limited_by.items())
    longer = ", ".join(f"{times} times as long {100 * s:.2g} %" for times, s in found.longer.items())
    heavy = f"{100 * found.heavier_rms:.2g} %"
    if found.heavier_wrench > 1.0:
        heavy += f", but it would use {100 * found.heavier_wrench:.0f} % of what the wrench may reach"
    return (
        f"Predicted sigma of the gain: {100 * found.rms:.2g} % of full scale (RMS), at most "
        f"{100 * float(found.std.max()):.2g} %; {100 * found.oracle_rms:.2g} % if the motion were known.\n"
        f"By source: {sources}.\n"
        f"A record {longer}; a payload of twice the mass and inertia, moved alike: {heavy}.\n"
        f"Excitation alpha ([A00] 12): {plan.alpha['normalised']:.3g} s in units of range, "
        f"{plan.alpha['published']:.3g} in SI."
    )


def _hidden(plan: Plan) -> str:
    found = plan.prediction
    assert found is not None
    lines = "".join(f"\n  - {entry.words}" for entry in found.blind_to)
    return f"What no residual of this motion would show (A = {found.pose.A:.2f}):{lines}"


def _sigma(plan: Plan) -> RenderableType:
    found = plan.prediction
    assert found is not None
    table = titled_table("Predicted 1 sigma, % of full scale", ["channel", *AXES])
    for channel, row in zip(plan.rig.sensor.channels, found.std, strict=True):
        table.add_row(Text(channel), *(f"{100 * s:.2g}" for s in row))
    return table


def _limits(plan: Plan) -> RenderableType:
    table = titled_table("Limits used most", ["limit", "of", "used", "reached", "allowed", "at"])
    for use in sorted(plan.usage, key=lambda use: -use.share)[:_SHOWN]:
        share = f"{100 * use.share:.4g} %" if np.isfinite(use.share) else "-"
        table.add_row(
            use.limit, Text(use.axis), share, f"{use.value:.4g}", f"{use.bound:.4g}", f"{use.time:.2f} s"
        )
    return table
