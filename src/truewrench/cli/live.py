"""Live: wrenches as samples arrive, or a calibration from them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from truewrench.cli.common import DebugOption, JsonOption, Outcome, check_folder, verdict_of
from truewrench.errors import InputError, UnsupportedError

if TYPE_CHECKING:
    from truewrench.calibration import Calibration
    from truewrench.rig import Rig
    from truewrench.stream.session import Progress

__all__ = ["stream"]

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
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Correct samples as they arrive, as JSON lines on standard input and output; or calibrate from them."""
    if (calibration is None) == (rig is None):
        found = "neither" if calibration is None else "both"
        raise InputError.at(None, "arguments", found, "a CALIBRATION or --calibrate RIG")
    if rig is None:
        for name, value in (("--output", output), ("--payload", payload)):
            if value is not None:
                raise UnsupportedError.at(None, name, "without --calibrate", "this option with --calibrate")
        assert calibration is not None
        from truewrench.calibration import load_calibration

        return _correct(load_calibration(calibration), as_json)
    from truewrench.rig import load_rig

    if output is not None:
        check_folder(output)
    return _calibrate(load_rig(rig), payload, output, as_json)


def _correct(calibration: Calibration, as_json: bool) -> Outcome:
    from truewrench.stream.json_lines import INPUT, correct_lines
    from truewrench.stream.lines import Output
    from truewrench.stream.stop import Stop

    for reason in calibration.verdict.reasons:
        _say(f"not to be used as it stands: {reason}")
    with Stop() as stop:
        lines = correct_lines(calibration, Output(silent=as_json), stop, _Complaints())
    if lines.refused:
        found = f"{lines.refused} of {lines.read} lines that are none, the first: {lines.first}"
        raise InputError(f"{INPUT}: {found}")
    return Outcome(verdict=verdict_of(calibration), figures={"lines": lines.read}, aside=True)


def _calibrate(rig: Rig, payload: str | None, folder: Path | None, as_json: bool) -> Outcome:
    from truewrench.stream.json_lines import calibrate_lines, progress_line
    from truewrench.stream.lines import Output
    from truewrench.stream.session import LiveCalibration, payload_of
    from truewrench.stream.stop import Stop

    out = Output(silent=as_json)
    with Stop() as stop, LiveCalibration(rig, payload_of(rig, payload)) as session:
        lines = calibrate_lines(session, out, stop, _Complaints())
        final = session.finish(folder)
        out.write(progress_line(final))
    return _result(final, folder, {"lines": lines.read, "refused": lines.refused})


def _result(final: Progress, folder: Path | None, figures: dict[str, Any]) -> Outcome:
    from truewrench.stream.session import CALIBRATION, RECORD
    from truewrench.summary import calibration_summary

    calibration = final.calibration
    assert calibration is not None
    found = {key: value for key, value in final.to_mapping().items() if key not in ("usable", "reasons")}
    return Outcome(
        outputs=[] if folder is None else [folder / CALIBRATION, folder / RECORD],
        figures={**figures, **found},
        verdict=verdict_of(calibration),
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
