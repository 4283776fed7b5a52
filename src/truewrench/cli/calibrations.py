"""Commands about a calibration: make one, judge one, use one."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from truewrench.cli.common import (
    DebugOption,
    JsonOption,
    LogsArgument,
    MaxRowsOption,
    Outcome,
    OutputFolderOption,
    OutputLogOption,
    RigArgument,
    check_distinct,
    check_folder,
    check_output,
    progress_bar,
    report_left_out,
    report_notes,
    with_wrench_topic,
)
from truewrench.model.errors import UnsupportedError

if TYPE_CHECKING:
    from truewrench import Evidence
    from truewrench.model.calibration import Calibration


def calibrate(
    rig: RigArgument,
    logs: LogsArgument,
    output: OutputFolderOption,
    estimator: Annotated[
        Literal["map", "online", "ekf", "ls"], typer.Option(help="map, online; ekf and ls are references.")
    ] = "map",
    published: Annotated[bool, typer.Option("--published", help="ekf: start from P = I in SI.")] = False,
    smooth: Annotated[Literal["spline"] | None, typer.Option(help="ls: differentiate a spline.")] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="No effect on the result.")] = None,
    process_density: Annotated[
        float | None, typer.Option(min=0.0, max=1e12, help="ekf: of the acceleration.")
    ] = None,
    held_out: Annotated[
        bool,
        typer.Option("--held-out/--no-held-out", help="Compare with the nominal gain on unseen data."),
    ] = True,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write report.html.")] = True,
    max_rows: MaxRowsOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Calibrate gain and offset from one or more logs."""
    from truewrench import calibrate as run
    from truewrench.io.exports import write_exports
    from truewrench.io.tables import read_log
    from truewrench.model.rig import load_rig
    from truewrench.report.summary import calibration_summary, exports_summary

    check_folder(output)
    check_output(output / "calibration.yaml", rig, table=False)
    settings = load_rig(rig)
    found: list[Evidence] = []
    with progress_bar() as update:
        records = [read_log(log, settings, max_rows=max_rows) for log in logs]
        check_distinct(records)
        calibration = run(
            settings,
            records,
            estimator,
            threads=threads,
            held_out=held_out,
            published=published,
            smooth=smooth,
            process_density=process_density,
            progress=update,
            evidence=found.append if report else None,
        )
        target = output / "calibration.yaml"
        calibration.write_yaml(target)
        update("reporting", None)
        reports = write_report_beside(target, calibration, found)
    exports = write_exports(calibration, output)
    for record in records:
        report_left_out(record)
    return Outcome(
        outputs=[target, *reports, *exports.written],
        verdict=calibration.verdict.to_mapping(),
        figures={
            "gain": calibration.gain,
            "gain_std": calibration.gain_std,
            "offset": calibration.offset,
            "offset_std": calibration.offset_std,
            "axes": calibration.axes,
            "assumed": calibration.assumed,
            "quadratic": calibration.quadratic,
            "quadratic_std": calibration.quadratic_std,
            "discrepancy": calibration.discrepancy,
            "bound": calibration.bound,
            "improvement": calibration.improvement,
            "fit": calibration.figures,
            "timings": calibration.timings,
            "dropped_rows": {str(record.path): record.dropped_rows for record in records},
            "nan_counts": {str(record.path): record.nan_counts for record in records},
            "log_notes": {str(record.path): record.notes for record in records},
            "exports": {"left_out": exports.left_out, "loss": exports.loss},
        },
        words=lambda: chain(calibration_summary(calibration), exports_summary(exports)),
    )


def write_report_beside(
    calibration_file: Path, calibration: Calibration, evidence: Sequence[Evidence]
) -> list[Path]:
    """Write report.html, if there is evidence for one; its failure costs no more than the report."""
    target = calibration_file.with_name("report.html")
    try:
        target.unlink(missing_ok=True)  # of an earlier calibration: it would contradict this one
        from truewrench.report.page import write_report

        for found in evidence:
            write_report(target, calibration, found)
    except Exception as error:
        print(f"{target}: not written: {type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201
        return []
    return [target for _ in evidence]


def validate(
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="A calibration.yaml.")],
    rig: RigArgument,
    logs: LogsArgument,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder of validation.yaml.")
    ] = None,
    max_rows: MaxRowsOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Judge a calibration by logs it was not made with: is it better than the nominal gain?"""
    from truewrench import validate as run
    from truewrench.io.tables import read_log
    from truewrench.model.calibration import load_calibration
    from truewrench.model.rig import load_rig
    from truewrench.report.summary import validation_summary

    if output is not None:
        check_folder(output)
    loaded, settings = load_calibration(calibration), load_rig(rig)
    with progress_bar() as update:
        records = [read_log(log, settings, max_rows=max_rows) for log in logs]
        check_distinct(records)
        update("validating", None)
        validation = run(loaded, settings, records)
    for record in records:
        report_left_out(record)
    outputs = [] if output is None else [output / "validation.yaml"]
    for target in outputs:
        validation.write_yaml(target)
    figures = validation.to_mapping()
    return Outcome(
        outputs=outputs,
        verdict=figures.pop("verdict"),
        figures=figures,
        words=lambda: validation_summary(validation),
    )


def apply(
    calibration: Annotated[
        Path, typer.Argument(metavar="CALIBRATION", help="A calibration.yaml; with --tool, or the RIG.")
    ],
    log: Annotated[str, typer.Argument(metavar="LOG", help="CSV, Parquet, or a recording.")],
    output: OutputLogOption,
    predict: Annotated[
        bool, typer.Option(help="Of MCAP: with what the motion predicts, which needs memory for the log.")
    ] = True,
    wrench_topic: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Of a recording: the sensor's; by default the rig's, or the only one."
        ),
    ] = None,
    tool: Annotated[
        Path | None, typer.Option(metavar="TOOL", help="A tool.yaml: the contact wrench instead.")
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="--tool: half the kernels' length, 0.01; 0: they end at the row."
        ),
    ] = None,
    at: Annotated[
        str | None, typer.Option(metavar="x,y,z,roll,pitch,yaw", help="--tool: at this point of the tool.")
    ] = None,
    axes: Annotated[
        Literal["sensor", "base"] | None, typer.Option(help="--tool: axes of the sensor, or of the root.")
    ] = None,
    max_rows: MaxRowsOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Write a log with the true wrench and its 1 sigma added, or, as FILE.mcap, a recording of both.

    With --tool it is the contact wrench, tool removed.
    """
    check_output(output, calibration, log, tool, recording=True)
    if tool is not None:
        from truewrench.cli.contacts import apply_tool

        return apply_tool(calibration, log, output, tool, delay, at, axes, wrench_topic, max_rows)
    for name, value in {"--delay": delay, "--at": at, "--axes": axes}.items():
        if value is not None:
            raise UnsupportedError.at(None, name, "without --tool", "this option with --tool only")
    from truewrench.correction.apply import apply as run
    from truewrench.model.calibration import load_calibration

    loaded = load_calibration(calibration)
    if wrench_topic is not None:
        loaded = dataclasses.replace(loaded, rig=with_wrench_topic(loaded.rig, log, wrench_topic))
    with progress_bar() as update:
        show = lambda rows: update(f"{rows} rows", None)  # noqa: E731
        if output.suffix.lower() == ".mcap":
            from truewrench.correction.apply_recording import apply_to_recording

            done = apply_to_recording(loaded, log, output, predict=predict, progress=show, max_rows=max_rows)
        else:
            done = run(loaded, log, output, progress=show, max_rows=max_rows)
    report_notes(log, done.notes)
    return Outcome(
        outputs=[output],
        verdict=loaded.verdict.to_mapping(),
        figures={"rows": done.rows, "corrected": done.corrected, "notes": done.notes},
        words=lambda: iter(
            [
                f"{output}: {done.corrected} of {done.rows} rows with the true wrench",
                *(f"not to be used as it stands: {reason}" for reason in loaded.verdict.reasons),
            ]
        ),
    )
