"""What is known of a tool and of the sensor that carries it, with their joint uncertainty (tool.yaml)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.files import read_yaml, write_yaml
from truewrench.model.rig import Rig
from truewrench.model.rig.elsewhere import within
from truewrench.model.rig.fields import Fields
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.bodies import inertia_std, one_body
from truewrench.tool.parameters import (
    BELOW,
    ELEMENTS,
    Layout,
    channel_turn,
    inertia_of,
    second_moments,
    tilted,
)
from truewrench.tool.parts import Body, HeldOut, ToolVerdict, Unknown

__all__ = ["FORMAT", "Body", "HeldOut", "Tool", "ToolVerdict", "Unknown", "read_tool"]

FORMAT = "truewrench-tool/1"  # what the first line of a tool's file says


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """A tool on a sensor, raw = gain R(mounting) w(body, motion, gravity) + offset, and how well it is known.

    One that sits on another (`--on`) is the upper body alone, with the lower one beside it: what the sensor
    carries is `whole`.

    Attributes:
        mass: [kg].
        mass_std: 1 sigma [kg].
        center_of_mass: (3,) seen from the sensor's origin, sensor axes as the logged motion has them [m].
        center_of_mass_std: (3,) 1 sigma [m].
        inertia: (6,) elements about the centre of mass, in the order of `ELEMENTS` [kg m^2].
        inertia_std: (6,) 1 sigma.
        determined: `mass`, `center_of_mass` (3), `inertia` (6): posterior sigma below half the prior's.
        offset: (n,) of the last log at `offset_time_ns` [raw units].
        offset_std: (n,) 1 sigma.
        offset_time_ns: stamp of the end of the last log.
        offset_walk: (n,) [raw units per sqrt(s)].
        pose_repeatability: (n,) 1 sigma of what a pose, or slowly a motion, adds by itself [raw units].
        sample_noise: (n,) 1 sigma of a sample [raw units], as found and at least as stated.
        vibrations: (B, 1 + n) [Hz] and 1 sigma of each channel [raw units] of what shakes the sensor.
        mounting: (3,) roll, pitch, yaw of the channels' axes in the sensor frame [rad].
        mounting_std: (3,) 1 sigma.
        tilt: (2,) of gravity against the rig's [rad].
        tilt_std: (2,) 1 sigma.
        gain: (n, 6) posterior, w in the rig's sign, channel axes.
        covariance: of theta, in the order of `Layout`: 7n + 15, and ten more of `below`.
        exported: the physical body that exports hold: all that the sensor carries, and its housing where one
            was stated.
        verdict: whether and why (not) to use it.
        rig: the settings it was made with, `payloads` and `required` passed over.
        below: (10,) log mass, centre of mass, S of what it sits on; None: on the sensor itself.
        held_out: beside the usual recipe.
        flange: (6,) x, y, z, roll, pitch, yaw of the sensor frame on the flange [m, rad].
        housing: (4,) mass and centre of mass of the sensor's housing, sensor axes [kg, m]; zeros: none.
        offset_temperature: (n,) slope of the offset per K, None where no temperature was logged.
        offset_temperature_covariance: (n, p + n) of it with what `covariance` (p, p) is of, and itself.
        time_offset: of the last log of motion [s].
        time_offset_std: its 1 sigma [s].
        logs: per log: path, sha256, poses, moving seconds.
        figures: of the fit, by name.
        version: of the package that made it.
        created: ISO 8601 time, UTC.
    """

    mass: float
    mass_std: float
    center_of_mass: Array
    center_of_mass_std: Array
    inertia: Array
    inertia_std: Array
    determined: Mapping[str, Any]
    offset: Array
    offset_std: Array
    offset_time_ns: int
    offset_walk: Array
    pose_repeatability: Array
    sample_noise: Array
    vibrations: Array
    mounting: Array
    mounting_std: Array
    tilt: Array
    tilt_std: Array
    gain: Array
    covariance: Array
    exported: Body
    verdict: ToolVerdict
    rig: Rig
    below: Array | None = None
    held_out: HeldOut = field(default_factory=HeldOut)
    flange: Array = field(default_factory=lambda: np.zeros(6))
    housing: Array = field(default_factory=lambda: np.zeros(4))
    offset_temperature: Array | None = None
    offset_temperature_covariance: Array | None = None
    time_offset: float = 0.0
    time_offset_std: float = 0.0
    logs: tuple[Mapping[str, Any], ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    version: str = ""
    created: str = ""

    @property
    def n(self) -> int:
        """Number of raw channels."""
        return int(self.gain.shape[0])

    @property
    def layout(self) -> Layout:
        """Where the parameters stand in `theta` and `covariance`."""
        return Layout(self.n)

    @property
    def S(self) -> Array:
        """(6,) second moments per mass about the centre of mass [m^2]."""
        return second_moments(self.mass, self.inertia)

    @property
    def theta(self) -> Array:
        """The estimate in the order of `covariance`."""
        body = np.concatenate([[np.log(self.mass)], self.center_of_mass, self.S])
        below = np.zeros(0) if self.below is None else self.below
        return np.concatenate([self.gain.ravel(), body, self.offset, self.mounting, self.tilt, below])

    @property
    def whole(self) -> Self:
        """The same with all that the sensor carries as one body: this tool and what it sits on."""
        if self.below is None:
            return self
        layout = self.layout
        body, J = one_body(np.stack([self.theta[layout.body], self.below]))
        T = np.eye(layout.size, layout.below.stop)
        T[layout.body, layout.body], T[layout.body, layout.below] = J[:, :10], J[:, 10:]
        P = T @ self.covariance @ T.T
        P = 0.5 * (P + P.T)
        mass, std = float(np.exp(body[0])), np.sqrt(np.diag(P))
        S = self.offset_temperature_covariance
        return replace(
            self,
            mass=mass,
            mass_std=mass * float(std[layout.log_mass]),
            center_of_mass=body[1:4],
            center_of_mass_std=std[layout.center_of_mass],
            inertia=inertia_of(mass, body[4:]),
            inertia_std=inertia_std(body, P[layout.body, layout.body]),
            covariance=P,
            offset_temperature_covariance=None
            if S is None
            else np.hstack([S[:, : T.shape[1]] @ T.T, S[:, T.shape[1] :]]),
            below=None,
        )

    @property
    def gain_std(self) -> Array:
        """(n, 6) 1 sigma of the gains."""
        return np.sqrt(np.diag(self.covariance)[self.layout.gain]).reshape(self.n, 6)

    @property
    def channel_turn(self) -> Array:
        """R (3, 3): from sensor axes to those of the channels."""
        return channel_turn(self.mounting)[0]

    @property
    def gravity(self) -> Array:
        """(3,) free fall in the root frame as it was found [m/s^2]."""
        return tilted(self.rig.gravity_array, self.tilt)[0]

    @property
    def gravity_direction(self) -> Array:
        """(3,) its unit vector; zeros on orbit."""
        size = np.linalg.norm(self.gravity)
        return self.gravity / size if size > 0.0 else self.gravity

    @property
    def gravity_direction_std(self) -> Array:
        """(3,) 1 sigma of the unit vector's elements."""
        size = float(np.linalg.norm(self.rig.gravity_array)) or 1.0
        by_tilt = tilted(self.rig.gravity_array, self.tilt)[1] / size
        place = self.layout.tilt
        variance: Array = np.einsum("ij,jk,ik->i", by_tilt, self.covariance[place, place], by_tilt)
        return np.sqrt(np.maximum(variance, 0.0))

    def write_yaml(self, path: str | Path) -> None:
        """Write `tool.yaml`, every number to its last bit; the file appears whole or not at all."""
        mapping = self.to_mapping()
        write_yaml(path, mapping | {"rig": within(mapping["rig"], self.rig, path)})

    def to_mapping(self) -> dict[str, Any]:
        """Numbers, arrays and texts by the keys of `tool.yaml`."""
        return {
            "format": FORMAT,
            "verdict": self.verdict.to_mapping(),
            "mass": self.mass,
            "mass_std": self.mass_std,
            "center_of_mass": self.center_of_mass,
            "center_of_mass_std": self.center_of_mass_std,
            "inertia": _by_element(self.inertia),
            "inertia_std": _by_element(self.inertia_std),
            "determined": {
                "mass": bool(self.determined["mass"]),
                "center_of_mass": [bool(one) for one in self.determined["center_of_mass"]],
                "inertia": {
                    name: bool(one) for name, one in zip(ELEMENTS, self.determined["inertia"], strict=True)
                },
            },
            "offset": self.offset,
            "offset_std": self.offset_std,
            "offset_time_ns": self.offset_time_ns,
            "offset_walk": self.offset_walk,
            "offset_temperature": self.offset_temperature,
            "offset_temperature_covariance": self.offset_temperature_covariance,
            "pose_repeatability": self.pose_repeatability,
            "sample_noise": self.sample_noise,
            "vibrations": [{"hz": band[0], "std": band[1:]} for band in self.vibrations],
            "mounting": self.mounting,
            "mounting_std": self.mounting_std,
            "gravity_direction": self.gravity_direction,
            "gravity_direction_std": self.gravity_direction_std,
            "tilt": self.tilt,
            "tilt_std": self.tilt_std,
            "time_offset": self.time_offset,
            "time_offset_std": self.time_offset_std,
            **({} if self.below is None else {"below": self._of_below()}),  # `on` is true in YAML 1.1
            "exported": asdict(self.exported) | {"inertia": _by_element(self.exported.inertia)},
            "flange": self.flange,
            "housing": self.housing,
            "held_out": asdict(self.held_out),
            "logs": [dict(log) for log in self.logs],
            "figures": dict(self.figures),
            "version": self.version,
            "created": self.created,
            "gain": self.gain,
            "gain_std": self.gain_std,
            "rig": {key: value for key, value in self.rig.to_mapping().items() if key != "payloads"},
            "covariance": {"names": _names(self.layout, self.below is not None), "matrix": self.covariance},
        }

    def _of_below(self) -> dict[str, Any]:
        """What it sits on, by the keys of a body."""
        assert self.below is not None
        place, mass = self.layout.below, float(np.exp(self.below[0]))
        P = self.covariance[place, place]
        std = np.sqrt(np.diag(P))
        return {
            "mass": mass,
            "mass_std": mass * float(std[0]),
            "center_of_mass": self.below[1:4],
            "center_of_mass_std": std[1:4],
            "inertia": _by_element(inertia_of(mass, self.below[4:])),
            "inertia_std": _by_element(inertia_std(self.below, P)),
        }


def _names(layout: Layout, on: bool) -> list[str]:
    return [*layout.names, *(BELOW if on else ())]


def _by_element(values: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(ELEMENTS, values, strict=True)}


def read_tool(path: str | Path) -> Tool:
    """Read and validate a `tool.yaml`.

    Raises:
        InputError: naming file, line, key, what was found and what was expected.
    """
    data, locate = read_yaml(path)
    return _from_fields(Fields(data, path, locate))


def _from_fields(top: Fields) -> Tool:
    if top.data.get("format") != FORMAT:
        raise top.error("format", f"`{FORMAT}`")
    try:
        rig = tool_rig(top.section("rig").data, f"{top.path}: rig")
    except InputError as error:
        raise InputError(f"{error}\n(the `rig` of a tool must be a valid rig)") from error
    n = rig.sensor.n
    exported, held, determined = top.section("exported"), top.section("held_out"), top.section("determined")
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
        covariance=_covariance(top, Layout(n)),
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
        else top.array("offset_temperature_covariance", (n, len(_names(Layout(n), "below" in top.data)) + n)),
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
        below, expected = top.section("below"), tool._of_below()
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


def _covariance(top: Fields, layout: Layout) -> Array:
    section, names = top.section("covariance"), _names(layout, "below" in top.data)
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
