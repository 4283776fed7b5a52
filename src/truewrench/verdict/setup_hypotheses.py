"""What somebody could have set up wrongly, as matrices between the nominal gain and the true one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "MOMENT_SCALES",
    "PAYLOAD_SCALES",
    "PRIOR_ODDS",
    "SCALES",
    "Hypothesis",
    "Kind",
    "payload_units",
    "scales",
]

Array = NDArray[np.float64]
Kind = Literal["scale", "axes", "payload", "departure", "parameter"]

SCALES: tuple[tuple[float, str], ...] = (
    (1e3, "mN for N, or t for kg in the payload"),
    (1e-3, "kN for N, or g for kg in the payload"),
    (9.80665, "N for kgf"),
    (1 / 9.80665, "kgf for N"),
    (4.4482216, "N for lbf"),
    (1 / 4.4482216, "lbf for N"),
    (180 / math.pi, "radians for degrees"),
    (math.pi / 180, "degrees for radians"),
    (1e6, "micro-units for units"),
    (1e-6, "units for micro-units"),
    (1e2, "per cent for fractions, or N cm for N m"),
    (1e-2, "fractions for per cent, or N m for N cm"),
)
"""What multiplies the raw output, and the mistake that does it: on all axes, on forces or on moments."""

MOMENT_SCALES: tuple[tuple[float, str], ...] = (
    (1e3, "N mm for N m"),
    (1e-3, "kN m for N m"),
    (1e2, "N cm for N m"),
    (1e-2, "N m for N cm"),
    (8.8507458, "in lbf for N m"),
    (1 / 8.8507458, "N m for in lbf"),
    (39.370079, "inches for metres"),
    (1 / 39.370079, "metres for inches"),
    (12.0, "in lbf for ft lbf"),
    (1 / 12.0, "ft lbf for in lbf"),
)
"""The same where only moments are concerned; words here go before those of `SCALES`."""

PAYLOAD_SCALES: dict[str, tuple[tuple[float, str], ...]] = {
    "mass": ((1e3, "g for kg"), (1e-3, "t for kg"), (2.2046226, "lb for kg")),
    "centre of mass": ((1e3, "mm for m"), (1e2, "cm for m"), (39.370079, "inches for metres")),
    "inertia": (
        (1e6, "kg mm^2 for kg m^2"),
        (1e4, "kg cm^2 for kg m^2"),
        (1e3, "g m^2 for kg m^2"),
        (1e9, "g mm^2 for kg m^2"),
        (1e7, "g cm^2 for kg m^2"),
        (23.730360, "lb ft^2 for kg m^2"),
        (3417.1719, "lb in^2 for kg m^2"),
        (180 / math.pi, "or degrees for radians in Omega"),
    ),
}
"""What a stated property of the payload is multiplied by."""

# Prior odds against a correct set-up: about one rig in ten is wired or scaled wrongly at first. Each is
# shared out evenly over its hypotheses, those of axes by how much they change (`signed_axes.log_prior`).
# Drifts are rated low because a healthy sensor, too, may depart by something like a common factor.
PRIOR_ODDS: dict[str, float] = {"scale": 0.05, "axes": 0.1, "payload": 0.05, "drift": 1e-4, "departure": 0.01}
FACTOR = 0.2  # spread of a common factor that no named unit explains
LEVER = 0.1  # and of a centre of mass [m]


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """C = left (C_nom + Delta) right, in normalised units."""

    kind: Kind
    words: str  # empty: in the words of `signed`
    log_prior: float
    left: Array  # (n, n)
    right: Array  # (6, 6)
    signed: Array | None = None  # (6, 6) permutation: one sign per row
    drift: Array | None = None  # (6, 6): C_nom drift is added, times a number of spread 1


@cache
def scales(n: int) -> tuple[Hypothesis, ...]:
    """A common factor on all axes, on forces or on moments; with six channels also on theirs."""
    cases: list[tuple[Array, str]] = []
    for factor, words in SCALES:
        whole = f"all axes {_size(factor)} ({words})"
        cases.append((np.full(6, factor), whole))
        cases.append((np.full(6, -factor), f"{whole}, and of the wrong sign"))
        cases.append((np.repeat([factor, 1.0], 3), f"forces {_size(factor)} ({words})"))
    of_moments = dict(SCALES) | dict(MOMENT_SCALES)
    for factor, words in of_moments.items():
        cases.append((np.repeat([1.0, factor], 3), f"moments {_size(factor)} ({words})"))
    log_prior = math.log(PRIOR_ODDS["scale"] / len(cases))
    found = []
    for scale, words in cases:
        diagonal, sides = np.diag(scale), 1 if n != 6 or np.ptp(scale) == 0.0 else 2
        each = log_prior - math.log(sides)
        found.append(Hypothesis("scale", words, each, np.eye(n), diagonal))
        if sides == 2:
            found.append(Hypothesis("scale", words, each, diagonal, np.eye(6)))
    return tuple(found)


def drifts(n: int, span: Array, centers_of_mass: Sequence[Array]) -> list[Hypothesis]:
    """A factor or a lever of any size, common to many gains: a mass that was misread, a wrong centre."""
    one, zero = np.eye(3), np.zeros((3, 3))
    cases: list[tuple[Kind, str, Array]] = [
        ("scale", "all gains depart by one common factor", FACTOR * np.eye(6)),
        ("scale", "all gains to forces depart by one common factor", FACTOR * _blocks(one, zero, zero)),
        ("scale", "all gains to moments depart by one common factor", FACTOR * _blocks(zero, zero, one)),
    ]
    for center in centers_of_mass:
        lever = _cross(center)
        cases += [
            ("payload", "the mass of the payload is not as stated", FACTOR * _blocks(one, lever, zero)),
            ("payload", "the inertia of the payload is not as stated", FACTOR * _blocks(zero, -lever, one)),
        ]
    if centers_of_mass:
        cases += [
            (
                "payload",
                f"the centre of mass of the payload along {axis}",
                LEVER * _blocks(zero, _cross(e), zero),
            )
            for axis, e in zip("xyz", np.eye(3), strict=True)
        ]
    log_prior = math.log(PRIOR_ODDS["drift"] / len(cases))
    return [
        Hypothesis(kind, words, log_prior, np.eye(n), np.eye(6), drift=drift * span / span[:, None])
        for kind, words, drift in cases
    ]


def _blocks(ff: Array, mf: Array, mm: Array) -> Array:
    return np.block([[ff, np.zeros((3, 3))], [mf, mm]])


def _cross(c: Array) -> Array:
    x, y, z = c
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _size(factor: float) -> str:
    return f"{factor:.4g} times too large" if factor > 1.0 else f"{1.0 / factor:.4g} times too small"


def payload_units(n: int, span: Array, centers_of_mass: Sequence[Array]) -> list[Hypothesis]:
    """Wrong units of one property of the payload.

    With f and the moment c x f + n_c of the stated payload, the true one pulls with f / k and c x f / k + n_c
    (mass stated k times too large), f and c x f / k + n_c (centre of mass), f and c x f + n_c / k (inertia).
    """
    count = sum(map(len, PAYLOAD_SCALES.values())) * max(1, len(centers_of_mass))
    found, one = [], np.eye(3)
    for center in centers_of_mass:
        lever = _cross(center)
        for what, scales in PAYLOAD_SCALES.items():
            for factor, words in scales:
                less = 1.0 / factor
                right = {
                    "mass": _blocks(less * one, (less - 1.0) * lever, one),
                    "centre of mass": _blocks(one, (less - 1.0) * lever, one),
                    "inertia": _blocks(one, (1.0 - less) * lever, less * one),
                }[what]
                found.append(
                    Hypothesis(
                        "payload",
                        f"{what} of the payload {_size(factor)} ({words})",
                        math.log(PRIOR_ODDS["payload"] / count),
                        np.eye(n),
                        right * span / span[:, None],
                    )
                )
    return found
