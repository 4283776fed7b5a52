"""A tool from its file, validated: tool.yaml."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.rig.fields import Fields
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.model import FORMAT, Tool, names_of
from truewrench.tool.parameters import ELEMENTS, Layout, second_moments
from truewrench.tool.parts import Body, HeldOut, ToolVerdict, Unknown


def read_tool(path: str | Path) -> Tool:
    """Read and validate a `tool.yaml`.

    Raises:
        InputError: naming file, line, key, what was found and what was expected.
    """
    return _from_fields(Fields.of_file(path, FORMAT))


def _from_fields(top: Fields) -> Tool:
    try:
        rig = tool_rig(top.section("rig").data, f"{top.path}: rig")
    except InputError as error:
        raise InputError(f"{error}\n(the `rig` of a tool must be a valid rig)") from error
    n = rig.sensor.n
    exported, held, determined = top.section("exported"), top.section("held_out"), top.section("determined")
    names = names_of(Layout(n), "below" in top.data)
    tool = Tool(
        mass=top.positive("mass"),
        mass_std=top.size("mass_std"),
        center_of_mass=top.array("center_of_mass", (3,)),
        center_of_mass_std=top.sizes("center_of_mass_std", 3),
        inertia=_elements(top, "inertia"),
        inertia_std=_elements(top, "inertia_std", least=0.0),
        determined={
            "mass": determined.flag("mass"),
            "center_of_mass": _flags(determined, "center_of_mass", 3),
            "inertia": tuple(determined.section("inertia").flag(name) for name in ELEMENTS),
        },
        offset=top.array("offset", (n,)),
        offset_std=top.sizes("offset_std", n),
        offset_time_ns=top.whole("offset_time_ns"),
        offset_walk=top.sizes("offset_walk", n),
        pose_repeatability=top.sizes("pose_repeatability", n),
        # of files from before there were these keys, as stated, and none
        sample_noise=top.sizes("sample_noise", n) if "sample_noise" in top.data else rig.sensor.noise_array,
        vibrations=_vibrations(top, n),
        mounting=top.array("mounting", (3,)),
        mounting_std=top.sizes("mounting_std", 3),
        tilt=top.array("tilt", (2,)),
        tilt_std=top.sizes("tilt_std", 2),
        gain=top.array("gain", (n, 6)),
        covariance=_covariance(top, names),
        below=_below(top),
        exported=Body(
            mass=exported.positive("mass"),
            center_of_mass=exported.array("center_of_mass", (3,)),
            inertia=_elements(exported, "inertia"),
            inertia_assumed=exported.flag("inertia_assumed"),
        ),
        verdict=_verdict(top.section("verdict")),
        rig=rig,
        held_out=HeldOut(
            **{f.name: None if held.get(f.name) is None else held.size(f.name) for f in fields(HeldOut)}
        ),
        flange=top.array("flange", (6,)),
        housing=top.array("housing", (4,)),
        offset_temperature=None
        if top.get("offset_temperature") is None
        else top.array("offset_temperature", (n,)),
        offset_temperature_covariance=None
        if top.data.get("offset_temperature_covariance") is None
        else top.array("offset_temperature_covariance", (n, len(names) + n)),
        time_offset=top.number("time_offset"),
        time_offset_std=top.size("time_offset_std"),
        logs=tuple(log.data for log in top.sections("logs")),
        figures=top.section("figures").data,
        version=top.text("version"),
        created=top.text("created"),
    )
    _check_consistent(top, tool)
    return tool


def _check_consistent(top: Fields, tool: Tool) -> None:
    """Numbers that stand twice say the same: an edited mean beside an old covariance would mislead."""
    mass_std = tool.mass * np.sqrt(tool.covariance[6 * tool.n, 6 * tool.n])
    stated: dict[str, tuple[Any, Any]] = {
        "mass_std": (tool.mass_std, mass_std),
        "center_of_mass_std": (tool.center_of_mass_std, _std(tool, tool.layout.center_of_mass)),
        "offset_std": (tool.offset_std, _std(tool, tool.layout.offset)),
        "mounting_std": (tool.mounting_std, _std(tool, tool.layout.mounting)),
    }
    for key, (found, expected) in stated.items():
        if not np.allclose(found, expected, rtol=1e-6, atol=1e-15):
            raise top.error(key, "what `covariance` says")

    if tool.below is not None:
        below, expected = top.section("below"), tool.of_below()
        for key in ("mass_std", "center_of_mass_std"):
            if not np.allclose(
                below.array(key, np.shape(expected[key])), expected[key], rtol=1e-6, atol=1e-15
            ):
                raise below.error(key, "what `covariance` says")


def _std(tool: Tool, place: slice) -> Array:
    std: Array = np.sqrt(np.diag(tool.covariance)[place])
    return std


def _verdict(verdict: Fields) -> ToolVerdict:
    return ToolVerdict(
        usable=verdict.flag("usable"),
        reasons=tuple(verdict.texts("reasons")),
        undetermined=tuple(
            Unknown(one.text("direction"), one.text("words")) for one in verdict.sections("undetermined")
        ),
        needed=tuple(verdict.texts("needed")),
    )


def _vibrations(top: Fields, n: int) -> Array:
    bands = top.sections("vibrations") if "vibrations" in top.data else []
    return np.array([[band.size("hz"), *band.sizes("std", n)] for band in bands]).reshape(-1, 1 + n)


def _covariance(top: Fields, names: list[str]) -> Array:
    section = top.section("covariance")
    if section.texts("names") != names:
        found = f"{len(section.data['names'])} names, or another order"
        expected = f"the {len(names)} names of gain, log_mass, center_of_mass, S, offset, mounting, tilt"
        raise section.error("names", expected + (", below" if "below" in top.data else ""), found)
    return section.covariance("matrix", len(names))


def _below(top: Fields) -> Array | None:
    """What the tool sits on; None where that is the sensor, as in files from before there was a key."""
    if "below" not in top.data:
        return None
    below = top.section("below")
    mass, center = below.positive("mass"), below.array("center_of_mass", (3,))
    return np.concatenate([[np.log(mass)], center, second_moments(mass, _elements(below, "inertia"))])


def _elements(top: Fields, key: str, least: float | None = None) -> Array:
    section = top.section(key)
    for name in section.data:
        if name not in ELEMENTS:
            raise section.error(str(name), f"only {', '.join(ELEMENTS)}", "another element")
    values = np.array([section.number(name) for name in ELEMENTS])
    if least is not None and (values < least).any():
        raise top.error(key, f"numbers of at least {least:g}", f"{values.min():g}")
    return values


def _flags(top: Fields, key: str, count: int) -> tuple[bool, ...]:
    values = top.get(key)
    if not isinstance(values, list) or len(values) != count or not all(isinstance(v, bool) for v in values):
        raise top.error(key, f"a list of {count}: true or false")
    return tuple(values)
