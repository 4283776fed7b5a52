"""What `apply` and `stream` share about a tool and the contact wrench beyond it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from truewrench.cli.common import Outcome, progress_bar, report_notes, with_wrench_topic
from truewrench.model.errors import InputError

if TYPE_CHECKING:
    from truewrench.correction.contact.apply import ContactApplied
    from truewrench.correction.contact.run import View
    from truewrench.model.calibration import Calibration
    from truewrench.tool.model import Tool


def sensor_and_tool(source: Path, tool: Path) -> tuple[Calibration | None, Tool, dict[str, Any]]:
    """The calibration, if `source` is one and no rig, the tool, and the verdict on using both."""
    from truewrench.cli.tools import read_sensor
    from truewrench.correction.contact.run import check_same_sensor
    from truewrench.model.rig import Rig
    from truewrench.tool.reading import read_tool

    sensor, found = read_sensor(source), read_tool(tool)
    made = None if isinstance(sensor, Rig) else sensor
    of_rig = isinstance(sensor, Rig)
    rig = sensor if isinstance(sensor, Rig) else sensor.rig
    check_same_sensor(found, rig, tool, arm=of_rig)
    # topics are of what is read now, not of what the tool was found from
    topics = {key: getattr(rig.recording, key) for key in rig.recording.model_fields_set}
    recording = found.rig.recording.model_copy(update=topics)
    found = dataclasses.replace(found, rig=found.rig.model_copy(update={"recording": recording}))
    reasons = [*found.verdict.reasons, *(() if made is None else made.verdict.reasons)]
    usable = found.verdict.usable and (made is None or made.verdict.usable)
    return made, found, {"usable": usable, "reasons": reasons}


def view_of(at: str | None, axes: Literal["sensor", "base"] | None) -> View:
    """Where and how to express the wrench; InputError if `at` is not six numbers."""
    from truewrench.correction.contact.run import View
    from truewrench.tool.checks import check_place

    values: list[float] = [0.0] * 6
    if at is not None:
        try:
            values = [float(word) for word in at.split(",")]
        except ValueError:
            values = []
        if len(values) != 6 or not all(map(math.isfinite, values)):
            raise InputError.at(None, "--at", f"`{at}`", "six numbers: x,y,z,roll,pitch,yaw in m and rad")
        check_place("--at", np.array(values))
    return View(tuple(values), axes or "sensor")


def apply_tool(
    source: Path,
    log: str,
    output: Path,
    tool: Path,
    delay: float | None,
    at: str | None,
    axes: Literal["sensor", "base"] | None,
    wrench_topic: str | None,
    max_rows: int | None,
) -> Outcome:
    """`apply --tool`."""
    from truewrench.correction.contact.apply import apply_contact
    from truewrench.correction.contact.run import DELAY

    made, found, verdict = sensor_and_tool(source, tool)
    if wrench_topic is not None:
        found = dataclasses.replace(found, rig=with_wrench_topic(found.rig, log, wrench_topic))
    with progress_bar() as update:
        done = apply_contact(
            found,
            log,
            output,
            calibration=made,
            delay=DELAY if delay is None else delay,
            view=view_of(at, axes),
            progress=lambda rows: update(f"{rows} rows", None),
            max_rows=max_rows,
        )
    report_notes(log, done.notes)
    return Outcome(
        outputs=[output],
        verdict=verdict,
        figures={
            "rows": done.rows,
            "contact_rows": done.found,
            "events": [dataclasses.asdict(event) for event in done.events],
            "notes": done.notes,
        },
        words=lambda: _words(output, done, verdict["reasons"]),
    )


def _words(output: Path, done: ContactApplied, reasons: list[str]) -> Iterator[str]:
    yield f"{output}: {done.found} of {done.rows} rows with the contact wrench"
    yield f"{len(done.events)} contacts" if len(done.events) != 1 else "1 contact"
    for event in done.events[:20]:
        x, y, z = event.point
        seconds = 1e-9 * (event.end_ns - event.begin_ns)
        yield (
            f"from {1e-9 * event.begin_ns:.3f} s for {seconds:.3f} s: at most {event.peak_force:.3g} N, "
            f"near ({x:.3f}, {y:.3f}, {z:.3f}) m of the sensor frame"
        )
    if len(done.events) > 20:
        yield f"and {len(done.events) - 20} more"
    for reason in reasons:
        yield f"not to be used as it stands: {reason}"
