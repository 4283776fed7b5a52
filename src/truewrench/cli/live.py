"""Live: wrenches as samples arrive, or a calibration from them."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from truewrench.cli.common import DebugOption, JsonOption, Outcome, check_folder, check_output
from truewrench.model.errors import InputError, UnsupportedError

if TYPE_CHECKING:
    from truewrench.live.json_lines import Lines
    from truewrench.live.ros2 import Counts, Topics
    from truewrench.model.calibration import Calibration
    from truewrench.model.rig import Rig

_SHOWN = 10  # complaints of one kind before silence


def stream(
    calibration: Annotated[
        Path | None, typer.Argument(metavar="CALIBRATION", help="A calibration.yaml.", show_default=False)
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--calibrate", metavar="RIG", help="Make a calibration instead.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="--calibrate: folder of the result."),
    ] = None,
    payload: Annotated[
        str | None, typer.Option(metavar="NAME", help="--calibrate: what the arm carries.")
    ] = None,
    ros2: Annotated[
        bool, typer.Option("--ros2", help="Topics of ROS 2, which need not be installed.")
    ] = False,
    wrench_topic: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="--ros2: the sensor's; found by itself if the only one."),
    ] = None,
    joint_topic: Annotated[
        str | None, typer.Option(metavar="NAME", help="--ros2 --calibrate: the joints' (or the twist's).")
    ] = None,
    output_topic: Annotated[
        str | None, typer.Option(metavar="NAME", help="--ros2: corrected wrench; /truewrench/wrench.")
    ] = None,
    reliable: Annotated[
        bool, typer.Option("--reliable", help="--ros2: lose no message, where publishers are reliable.")
    ] = False,
    interface: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="--ros2: of the network; by default what the environment says."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--duration", min=0.0, help="--ros2: end after so many seconds.")
    ] = None,
    tool: Annotated[
        Path | None, typer.Option(metavar="TOOL", help="A tool.yaml: the contact wrench beyond it.")
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="--tool: half the kernels' length, 0.01; 0: none."),
    ] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Correct samples as they arrive, or calibrate from them: JSON lines from a pipe into one, or ROS 2.

    Ends with its input, after --duration, or at Ctrl-C, and then writes the last result.
    """
    if (calibration is None) == (rig is None):
        found = "neither" if calibration is None else "both"
        raise InputError.at(None, "arguments", found, "a CALIBRATION or --calibrate RIG")
    _check_belongs(
        "--calibrate",
        rig is not None,
        {"--output": output, "--payload": payload, "--joint-topic": joint_topic},
    )
    of_ros = {"--wrench-topic": wrench_topic, "--joint-topic": joint_topic, "--output-topic": output_topic}
    of_ros |= {"--interface": interface}
    _check_belongs("--ros2", ros2, {**of_ros, "--reliable": reliable or None, "--duration": seconds})
    _check_belongs("--tool", tool is not None, {"--delay": delay})
    if tool is not None:
        if rig is not None or calibration is None:
            raise UnsupportedError.at(None, "--tool", "--calibrate", "CALIBRATION or RIG as the argument")
        named = (wrench_topic, joint_topic, reliable, interface) if ros2 else None
        return _contact(calibration, tool, delay, as_json, named, math.inf if seconds is None else seconds)
    from truewrench.model.calibration import load_calibration
    from truewrench.model.rig import load_rig

    made = None if calibration is None else load_calibration(calibration)
    settings = load_rig(rig) if rig is not None else made.rig if made is not None else None
    assert settings is not None
    topics = None
    if ros2:
        from truewrench.live.ros2 import OUTPUT, Topics

        topics = Topics(
            wrench_topic or settings.recording.wrench_topic,
            joint_topic or settings.recording.joint_topic or settings.recording.twist_topic,
            output_topic or OUTPUT,
            reliable,
            interface,
        )
    limit = math.inf if seconds is None else seconds
    if made is not None:
        return _correct(made, topics, limit, as_json)
    if output is not None:
        check_folder(output, write=True)
        check_output(output / "calibration.yaml", rig, table=False)
    return _calibrate(settings, payload, output, topics, limit, as_json)


def _check_belongs(to: str, given: bool, options: Mapping[str, object]) -> None:
    for name, value in options.items():
        if value is not None and not given:
            raise UnsupportedError.at(None, name, f"without {to}", f"this option with {to} only")


def _contact(
    source: Path,
    tool: Path,
    delay: float | None,
    as_json: bool,
    named: tuple[str | None, str | None, bool, str | None] | None,
    seconds: float,
) -> Outcome:
    from truewrench.cli.contacts import sensor_and_tool
    from truewrench.correction.contact.run import DELAY, ContactRun
    from truewrench.live.stop import Stop

    made, found, verdict = sensor_and_tool(source, tool)
    for reason in verdict["reasons"]:
        _say(f"not to be used as it stands: {reason}")
    run = ContactRun(found, None, calibration=made, delay=DELAY if delay is None else delay)
    with Stop() as stop:
        if named is not None:
            from truewrench.live.ros2 import Topics
            from truewrench.live.ros2_contact import contact_topics

            topics = Topics(named[0], named[1], reliable=named[2], interface=named[3])
            figures = _some_used(contact_topics(run, found.rig, topics, stop, _Complaints(), seconds))
        else:
            from truewrench.live.contact_lines import contact_lines
            from truewrench.live.lines import Output

            figures = _all_right(contact_lines(run, found.n, Output(as_json), stop, _Complaints()))
    return _counted(figures, verdict)


def _correct(calibration: Calibration, topics: Topics | None, seconds: float, as_json: bool) -> Outcome:
    from truewrench.live.stop import Stop

    for reason in calibration.verdict.reasons:
        _say(f"not to be used as it stands: {reason}")
    with Stop() as stop:
        if topics is not None:
            from truewrench.live.ros2 import correct_topic

            figures = _some_used(correct_topic(calibration, topics, stop, _Complaints(), seconds))
        else:
            from truewrench.live.json_lines import correct_lines
            from truewrench.live.lines import Output

            figures = _all_right(correct_lines(calibration, Output(as_json), stop, _Complaints()))
    return _counted(figures, calibration.verdict.to_mapping())


def _all_right(lines: Lines) -> dict[str, int]:
    """Figures of lines; InputError where some were refused."""
    from truewrench.live.json_lines import INPUT

    if lines.refused:
        found = f"{lines.refused} of {lines.read} lines refused, the first: {lines.first}"
        raise InputError(f"{INPUT}: {found}")
    return {"lines": lines.read}


def _some_used(counts: Counts) -> dict[str, int]:
    """Figures of topics; InputError where not one message could be used."""
    if not counts.used:
        told = f"{counts.received} received, {counts.refused} refused"
        raise InputError(f"ROS 2: no message could be used: {told}")
    return dataclasses.asdict(counts)


def _counted(figures: dict[str, int], verdict: dict[str, Any]) -> Outcome:
    words = ", ".join(f"{count} {name}" for name, count in figures.items())
    return Outcome((), figures, verdict, lambda: iter([words]), aside=True)


def _calibrate(
    rig: Rig, payload: str | None, folder: Path | None, topics: Topics | None, seconds: float, as_json: bool
) -> Outcome:
    from truewrench.cli.calibrations import write_report_beside
    from truewrench.io.exports import write_exports
    from truewrench.live.session import CALIBRATION, RECORD, LiveCalibration, payload_of
    from truewrench.live.stop import Stop
    from truewrench.report.summary import calibration_summary

    with Stop() as stop, LiveCalibration(rig, payload_of(rig, payload)) as session:
        if topics is not None:
            from truewrench.live.ros2 import calibrate_topics

            counts, final = calibrate_topics(session, folder, topics, stop, _Complaints(), seconds)
            figures = dataclasses.asdict(counts)
        else:
            from truewrench.live.json_lines import calibrate_lines
            from truewrench.live.lines import Output

            lines, final = calibrate_lines(session, folder, Output(as_json), stop, _Complaints())
            figures = {"lines": lines.read, "refused": lines.refused}
        calibration, outputs = final.calibration, list[Path]()
        assert calibration is not None
        if folder is not None:
            target = folder / CALIBRATION
            exports = write_exports(calibration, folder)
            reports = write_report_beside(target, calibration, session.evidence)
            outputs = [target, folder / RECORD, *reports, *exports.written]
    found = {key: value for key, value in final.to_mapping().items() if key not in ("usable", "reasons")}
    return Outcome(
        outputs,
        figures={**figures, **found},
        verdict=calibration.verdict.to_mapping(),
        words=lambda: calibration_summary(calibration),
        aside=True,
    )


class _Complaints:
    """Messages on standard error, the first of many."""

    def __init__(self) -> None:
        self._count = 0

    def __call__(self, message: str) -> None:
        self._count += 1
        if self._count <= _SHOWN:
            _say(message)
        elif self._count == _SHOWN + 1:
            _say("and so on: no more of these are told")


def _say(message: str) -> None:
    print(f"truewrench: {message}", file=sys.stderr, flush=True)  # noqa: T201
