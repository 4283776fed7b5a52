"""What is known of a tool and of the sensor that carries it, with their joint uncertainty (tool.yaml)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.files import write_yaml
from truewrench.model.rig import Rig
from truewrench.model.rig.elsewhere import within
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

__all__ = ["FORMAT", "Body", "HeldOut", "Tool", "ToolVerdict", "Unknown", "names_of"]

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
            **({} if self.below is None else {"below": self.of_below()}),  # `on` is true in YAML 1.1
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
            "covariance": {"names": names_of(self.layout, self.below is not None), "matrix": self.covariance},
        }

    def of_below(self) -> dict[str, Any]:
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


def names_of(layout: Layout, on: bool) -> list[str]:
    """Of what `covariance` is of, with what the tool sits on or without."""
    return [*layout.names, *(BELOW if on else ())]


def _by_element(values: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(ELEMENTS, values, strict=True)}
