"""What a motion must keep to, and how much of it a motion uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.rig import Rig

Kind = Literal["position", "velocity", "acceleration", "jerk", "torque", "wrench", "workspace", "clearance"]

DEFAULT_WRENCH_FRACTION = 0.8  # the rest of the range is for tracking errors, offset and a gain that is off
TOLERANCE = 1e-6  # by which a limit may be exceeded, of the limit
SMALLEST = 1e-9  # limit: what must not move at all
_SPARE = 5e-4  # of a limit that is tightened: what is planned with it is to keep to the limit at once


def wrench_fraction(rig: Rig) -> float:
    """Share of the sensor's range that a motion may use."""
    stated = rig.limits.wrench_fraction
    return DEFAULT_WRENCH_FRACTION if stated is None else stated


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of n coordinates, infinite where there is none."""

    lower: Array  # (n,) of the positions: joints, or the integral of the twist by component from the start
    upper: Array  # (n,)
    velocity: Array  # (n,) of joints or twist
    acceleration: Array  # (n,) of their derivatives
    jerk: Array  # (n,) of their second derivatives
    torque: Array  # (n,) of the joints [N m, N]
    wrench: Array  # (6,) [N, N m]
    workspace: Array  # (3, 2) smallest and largest x, y, z of sensor and centre of mass in the root frame [m]
    clearance: float = 0.0  # smallest distance between parts that must not touch [m]

    @classmethod
    def of(cls, rig: Rig, n: int) -> Limits:
        """The limits that a rig states."""
        limits = rig.limits

        def array(values: tuple[float, ...] | None) -> Array:
            return np.full(n, np.inf) if values is None else np.maximum(values, SMALLEST)

        box = np.tile([-np.inf, np.inf], (3, 1))
        position = array(limits.position)
        return cls(
            lower=-position,
            upper=position,
            velocity=array(limits.velocity),
            acceleration=array(limits.acceleration),
            jerk=array(limits.jerk),
            torque=np.full(n, np.inf),
            wrench=wrench_fraction(rig) * rig.sensor.range_array,
            workspace=box if limits.workspace is None else np.array(limits.workspace),
        )

    def with_acceleration(self, acceleration: Array) -> Limits:
        """The same with other limits of the acceleration (n,)."""
        return replace(self, acceleration=acceleration)

    def tightened(self, usage: Sequence[Usage]) -> Limits:
        """Limits to plan with, so that what was exceeded between the nodes no longer is."""
        names = ("lower", "upper", "velocity", "acceleration", "jerk", "torque", "wrench", "workspace")
        found = {name: np.array(getattr(self, name)) for name in names}
        clearance = self.clearance
        for use in usage:
            if use.share <= 1.0:
                continue
            factor, k = (1.0 - _SPARE) / use.share, use.index
            if use.limit == "position":
                middle = 0.5 * (self.lower[k] + self.upper[k])
                found["lower"][k] = middle + factor * (self.lower[k] - middle)
                found["upper"][k] = middle + factor * (self.upper[k] - middle)
            elif use.limit == "workspace":
                middle = self.workspace[k].mean()
                found["workspace"][k] = (
                    np.minimum(abs(found["workspace"][k] - middle), factor * abs(self.workspace[k] - middle))
                    * [-1.0, 1.0]
                    + middle
                )
            elif use.limit == "clearance":
                clearance = max(clearance, self.clearance / factor)
            else:
                found[use.limit][k] *= factor
        return replace(self, clearance=clearance, **found)


@dataclass(frozen=True, slots=True)
class Usage:
    """The largest use of one limit."""

    limit: Kind  # what is limited
    axis: str  # of which axis, joint or body
    index: int  # of the axis
    share: float  # largest value over the limit; above 1 the limit is violated
    time: float  # when it is reached [s]
    first: float | None  # when the limit is first exceeded [s], None where it never is
    value: float  # that is reached
    bound: float  # the limit

    @property
    def violated(self) -> bool:
        """Whether the limit is exceeded by more than rounding."""
        return self.first is not None

    def words(self) -> str:
        """What is exceeded, by how much and since when."""
        since = "" if self.first is None else f", first at {self.first:.3f} s"
        least = "at least " if self.limit == "clearance" else ""
        return (
            f"{self.limit} of {self.axis}: {self.value:.4g} where {least}{self.bound:.4g} is allowed "
            f"({100 * self.share:.4g} %){since}"
        )

    def to_mapping(self) -> dict[str, Any]:
        """As PLAN.plan.yaml holds it."""
        return {
            "limit": self.limit,
            "axis": self.axis,
            "used_percent": 100.0 * self.share,
            "time": self.time,
            "value": self.value,
            "bound": self.bound,
        }


def usage_of(
    limit: Kind, axes: Sequence[str], time: Array, values: Array, lower: Array, upper: Array
) -> list[Usage]:
    """Use of the limits of n axes by values (N, n) at times (N,) [s].

    An axis without both a smallest and a largest value allowed is left out.
    """
    found = []
    for k, (axis, x, low, high) in enumerate(zip(axes, values.T, lower, upper, strict=True)):
        if np.isfinite(low) and np.isfinite(high):
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            share = np.abs(x - middle) / half
            at = int(np.argmax(share))
            bound = high if x[at] >= middle else low
            found.append(_usage(limit, axis, k, time, share, at, x, bound))
    return found


def clearance_usage(bodies: Sequence[str], time: Array, distance: Array, least: float) -> list[Usage]:
    """Use of a smallest distance [m] by those (N, n) between pairs of bodies."""
    found = []
    for k, (pair, x) in enumerate(zip(bodies, distance.T, strict=True)):
        share = least / np.maximum(x, SMALLEST)
        found.append(_usage("clearance", pair, k, time, share, int(np.argmax(share)), x, least))
    return found


def _usage(
    limit: Kind, axis: str, k: int, time: Array, share: Array, at: int, x: Array, bound: float
) -> Usage:
    beyond = np.flatnonzero(share > 1.0 + TOLERANCE)
    first = float(time[beyond[0]]) if beyond.size else None
    return Usage(limit, axis, k, float(share[at]), float(time[at]), first, float(x[at]), float(bound))


def violations(usage: Sequence[Usage]) -> list[Usage]:
    """What is exceeded, the earliest first."""
    return sorted((use for use in usage if use.violated), key=lambda use: (use.first, -use.share))
