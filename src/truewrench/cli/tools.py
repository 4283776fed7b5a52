"""The commands about a tool: plan what determines one, identify one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from truewrench.cli.common import (
    DebugOption,
    JsonOption,
    MaxRowsOption,
    Outcome,
    OutputFolderOption,
    check_distinct,
    check_folder,
    check_output,
    progress_bar,
    report_left_out,
)
from truewrench.model.errors import InputError

if TYPE_CHECKING:
    from truewrench.model.calibration import Calibration
    from truewrench.model.rig import Rig
    from truewrench.tool.identify import Evidence


def tool(
    source: Annotated[
        Path,
        typer.Argument(metavar="(CALIBRATION|RIG)", help="A calibration.yaml, or a rig without payloads."),
    ],
    logs: Annotated[list[str], typer.Argument(metavar="LOG...", help="Poses, motion or both.")],
    output: OutputFolderOption,
    known: Annotated[
        list[str] | None, typer.Option(help="NAME=VALUE:SIGMA of mass, center_of_mass.x, inertia.xx ...")
    ] = None,
    mounting_sigma: Annotated[
        float | None,
        typer.Option(min=0.0, max=np.pi, help="Of the channels' axes in the sensor frame, radians."),
    ] = None,
    tilt_sigma: Annotated[
        float | None, typer.Option(min=0.0, max=np.pi, help="Of gravity's direction, radians.")
    ] = None,
    flange: Annotated[
        str | None, typer.Option(help="x,y,z,roll,pitch,yaw of the sensor frame on the flange, m and rad.")
    ] = None,
    housing: Annotated[
        str | None, typer.Option(help="mass,x,y,z of the sensor's housing in the sensor frame, kg and m.")
    ] = None,
    on: Annotated[
        Path | None, typer.Option(metavar="TOOL", help="A tool.yaml that this one sits on.")
    ] = None,
    export: Annotated[str | None, typer.Option(metavar="LIST", help="ur,franka,urdf,abb,kuka,ros.")] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="No effect on the result.")] = None,
    max_rows: MaxRowsOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> Outcome:
    """Identify an unknown tool from static poses or motion."""
    from truewrench.io.tables import read_log
    from truewrench.tool.checks import check_known, check_options
    from truewrench.tool.exports import (
        FILES,
        TARGETS,
        frames_note,
        left_out,
        remove_exports,
        tool_exports,
        write_tool_exports,
    )
    from truewrench.tool.identify import identify_tool
    from truewrench.tool.page import write_page
    from truewrench.tool.prior import settings_of
    from truewrench.tool.reading import read_tool
    from truewrench.tool.words import tool_summary

    check_folder(output)
    told = [_known(text) for text in known or []]
    stated = dict(told)
    if len(stated) < len(told):
        names = [name for name, _ in told]
        twice = next(name for k, name in enumerate(names) if name in names[:k])
        raise InputError.at(None, "--known", f"`{twice}` a second time", "every name once")
    check_known(stated)
    place, shell = _list("--flange", flange, 6), _list("--housing", housing, 4)
    check_options(place, shell)
    targets = [part.strip() for part in (export or "").split(",") if part.strip()]
    for target in targets:
        if target not in TARGETS:
            raise InputError.at(None, "--export", f"`{target}`", f"a list of {', '.join(TARGETS)}")
    before = None if on is None else read_tool(on)
    sensor = read_sensor(source)
    settings = settings_of(sensor)
    if before is not None and before.n != settings.sensor.n:
        found, expected = f"a tool on {before.n} channels", f"{settings.sensor.n} channels, as in {source}"
        raise InputError.at(on, "gain", found, expected)
    target_file, page = output / "tool.yaml", output / "tool.html"
    for path in [target_file, *(output / name for target in targets for name in FILES[target])]:
        check_output(path, source, *logs, on, settings.urdf_path, table=False)
    evidence: list[Evidence] = []
    with progress_bar() as update:
        records = [read_log(log, settings, max_rows=max_rows) for log in logs]
        check_distinct(records)
        found_tool = identify_tool(
            sensor,
            records,
            known=stated,
            mounting_sigma=mounting_sigma,
            tilt_sigma=tilt_sigma,
            flange=place,
            housing=shell,
            on=before,
            threads=threads,
            progress=update,
            evidence=evidence.append,
        )
    kept = tool_exports(found_tool, targets)  # what one cannot take is told before anything is written
    page.unlink(missing_ok=True)
    remove_exports(output, kept)
    found_tool.write_yaml(target_file)
    outputs = [target_file]
    try:
        write_page(page, found_tool, evidence[0])
        outputs.append(page)
    except Exception as error:  # the result stands without its page
        print(f"{page}: not written: {type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201
    outputs += write_tool_exports(found_tool, targets, output)
    unfit = left_out(found_tool, targets)
    for record in records:
        report_left_out(record)
    if note := frames_note(found_tool, targets):
        print(f"truewrench: {note}", file=sys.stderr)  # noqa: T201
    figures = found_tool.to_mapping()
    verdict = figures.pop("verdict")
    for key in ("covariance", "rig"):
        figures.pop(key)
    said = [tool_summary(found_tool), *(f"No {name}: {reason}." for name, reason in unfit.items())]
    return Outcome(
        outputs=outputs,
        verdict=verdict,
        figures=figures | {"exports": {"left_out": unfit}},
        words=lambda: iter(said),
    )


def plan_for_tool(
    source: Path,
    output: Path,
    payload: str | None,
    motion: bool,
    poses: int | None,
    dwell: float | None,
    cone: float | None,
    pictures: bool,
) -> Outcome:
    """`plan --tool`."""
    from truewrench.model.files import read_yaml
    from truewrench.model.rig import load_rig
    from truewrench.planning.tool.plan import DWELL_DEFAULT, POSES, plan_tool
    from truewrench.planning.tool.words import tool_plan_words

    data, _ = read_yaml(source)
    stated = isinstance(data, dict) and "format" not in data and data.get("payloads")
    with progress_bar() as update:
        planned = plan_tool(
            load_rig(source) if stated else read_sensor(source),
            motion=motion,
            poses=POSES if poses is None else poses,
            dwell=DWELL_DEFAULT if dwell is None else dwell,
            cone=float(np.radians(180.0 if cone is None else cone)),
            payload=payload,
            progress=update,
        )
    figures = planned.to_mapping()
    outputs = planned.write(output)
    if pictures:
        from truewrench.planning.tool.pictures import draw_tool_plan

        outputs += draw_tool_plan(planned, output)
    verdict = figures.pop("verdict")
    return Outcome(outputs=outputs, verdict=verdict, figures=figures, words=lambda: tool_plan_words(planned))


def read_sensor(source: Path) -> Calibration | Rig:
    """A calibration or a rig, told apart by its `format`."""
    from truewrench.model.calibration import load_calibration
    from truewrench.model.files import read_yaml
    from truewrench.model.rig.tool_rig import tool_rig

    data, _ = read_yaml(source)
    if isinstance(data, dict) and "format" in data:
        return load_calibration(source)
    return tool_rig(data, source)


def _known(text: str) -> tuple[str, tuple[float, float]]:
    name, _, rest = text.partition("=")
    value, _, sigma = rest.partition(":")
    try:
        return name.strip(), (float(value), float(sigma))
    except ValueError:
        expected = "NAME=VALUE:SIGMA such as mass=1.234:0.002"
        raise InputError.at(None, "--known", f"`{text}`", expected) from None


def _list(option: str, text: str | None, count: int) -> np.ndarray | None:
    if text is None:
        return None
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.size != count or not np.isfinite(values).all():
        raise InputError.at(None, option, f"`{text}`", f"{count} numbers with commas between them")
    return values
