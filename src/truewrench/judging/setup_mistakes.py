"""What somebody could have set up wrongly: matrices between the nominal gain and the true one (METHOD 8)."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import AXES

Kind = Literal["scale", "axes", "payload", "departure"]

# Prior odds against a correct set-up: about one rig in ten is wired or scaled wrongly at first. Each is
# shared out evenly over its hypotheses. Drifts are rated low because a healthy sensor, too, may depart by
# something like a common factor. The rates that they set: benchmarks/setup_sweep.py.
PRIOR_ODDS: dict[str, float] = {"scale": 0.05, "axes": 0.1, "turn": 0.05, "payload": 0.05, "drift": 1e-4}
TURNED = 4.0  # sigma of the angle by the departures alone: without it 2 of 1,000 sound rigs are suspected
QUARTER = math.radians(10.0)  # a turn so near to quarter turns is one: words only
FACTOR, LEVER = 0.2, 0.1  # spread of a common factor that no named unit explains, of a centre of mass [m]

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
    (1e2, "per cent for fractions, N cm for N m, or gf for N"),
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
    "mass": ((1e3, "g for kg, or mm/s for m/s in v"), (1e-3, "t for kg"), (2.2046226, "lb for kg")),
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


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """C = left (C_nom + Delta) right + C_nom drift, normalised; drift times a number of spread 1."""

    kind: Kind
    words: str
    log_prior: float
    left: Array  # (n, n)
    right: Array  # (6, 6)
    drift: Array | None = None  # (6, 6)


def scales(n: int) -> Iterator[Hypothesis]:
    """A common factor on all axes, on forces or on moments; with six channels also on theirs."""
    cases: list[tuple[Array, str]] = []
    for factor, why in SCALES:
        whole = f"all axes {_size(factor)} ({why})"
        cases.append((np.full(6, factor), whole))
        cases.append((np.full(6, -factor), f"{whole}, and of the wrong sign"))
        cases.append((np.repeat([factor, 1.0], 3), f"forces {_size(factor)} ({why})"))
    for factor, why in (dict(SCALES) | dict(MOMENT_SCALES)).items():
        cases.append((np.repeat([1.0, factor], 3), f"moments {_size(factor)} ({why})"))
    log_prior = math.log(PRIOR_ODDS["scale"] / len(cases))
    for scale, words in cases:
        if n != 6 or np.ptp(scale) == 0.0:
            yield Hypothesis("scale", words, log_prior, np.eye(n), np.diag(scale))
        else:
            yield Hypothesis("scale", words, log_prior - math.log(2), np.eye(n), np.diag(scale))
            yield Hypothesis("scale", words, log_prior - math.log(2), np.diag(scale), np.eye(6))


def payload_units(n: int, span: Array, centers_of_mass: Sequence[Array]) -> Iterator[Hypothesis]:
    """Wrong units of one property of the payload.

    With f and the moment c x f + n_c of the stated payload, the true one pulls with f / k and c x f / k + n_c
    (mass stated k times too large), f and c x f / k + n_c (centre of mass), f and c x f + n_c / k (inertia).
    """
    count = sum(map(len, PAYLOAD_SCALES.values())) * max(1, len(centers_of_mass))
    log_prior, one = math.log(PRIOR_ODDS["payload"] / count), np.eye(3)
    for lever in map(_cross, centers_of_mass):
        for what, units in PAYLOAD_SCALES.items():
            for factor, why in units:
                less = 1.0 / factor
                right = {
                    "mass": _blocks(less * one, (less - 1.0) * lever, one),
                    "centre of mass": _blocks(one, (less - 1.0) * lever, one),
                    "inertia": _blocks(one, (1.0 - less) * lever, less * one),
                }[what]
                words = f"{what} of the payload {_size(factor)} ({why})"
                yield Hypothesis("payload", words, log_prior, np.eye(n), _normalised(right, span))


def drifts(n: int, span: Array, centers_of_mass: Sequence[Array]) -> Iterator[Hypothesis]:
    """A factor or a lever of any size, common to many gains: a mass that was misread, a wrong centre."""
    one, zero, levers = np.eye(3), np.zeros((3, 3)), list[Array]()
    factor = "depart by one common factor"
    cases: list[tuple[Kind, str, Array]] = [
        ("scale", f"all gains {factor}", FACTOR * np.eye(6)),
        ("scale", f"all gains to forces {factor}", FACTOR * _blocks(one, zero, zero)),
        ("scale", f"all gains to moments {factor}", FACTOR * _blocks(zero, zero, one)),
    ]
    for center in centers_of_mass:
        mass, inertia, *levers = payload_directions(np.ones(6), center)
        cases.append(("payload", "mass of the payload not as stated", FACTOR * mass))
        cases.append(("payload", "inertia of the payload not as stated", FACTOR * inertia))
    for axis, along in zip("xyz" if len(centers_of_mass) else "", levers, strict=True):
        words = f"centre of mass of the payload along {axis} not as stated"
        cases.append(("payload", words, LEVER * along))
    log_prior = math.log(PRIOR_ODDS["drift"] / len(cases))
    for kind, words, drift in cases:
        yield Hypothesis(kind, words, log_prior, np.eye(n), np.eye(6), _normalised(drift, span))


def payload_directions(span: Array, center_of_mass: Array) -> list[Array]:
    """What errors of a payload turn gains by, C (1 + error * direction), normalised, (6, 6) each.

    Of the mass, relative; of the inertia, relative; of the centre of mass along x, y, z [m].
    """
    one, zero, lever = np.eye(3), np.zeros((3, 3)), _cross(center_of_mass)
    found = [_blocks(one, lever, zero), _blocks(zero, -lever, one)]
    return [_normalised(d, span) for d in (*found, *(_blocks(zero, _cross(e), zero) for e in one))]


def turns(n: int, transform: Array, span: Array, spread: float) -> Iterator[Hypothesis]:
    """Forces and moments both turned about x, y or z, or about any axis, as comes nearest to a matrix.

    That is the transform (6, 6) C_nom^+ C of n channels, normalised by the span (6,), the range of the wrench
    axes. A turn that is nearly a permutation of the axes is left to these, and one that the departures Delta
    of a sound sensor, 1 sigma `spread`, may well look like accuses nobody.
    """
    si = transform * span[:, None] / span
    M = si[:3, :3] + si[3:, 3:]
    u, _, vt = np.linalg.svd(M)
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    # Laplace's integral over the rotation: 1 sigma of each angle is spread / |d blkdiag(R, R)| = spread / 2;
    # a priori all rotations (8 pi^2) are alike, or all angles (2 pi) about an axis
    cases = [(_TURNS["any"], R, 3, 8 * math.pi**2)]
    for k, axis in enumerate("xyz"):
        i, j = (k + 1) % 3, (k + 2) % 3
        about = math.atan2(M[j, i] - M[i, j], M[i, i] + M[j, j])
        cases.append((_TURNS[axis], Rotation.from_rotvec(about * np.eye(3)[k]).as_matrix(), 1, 2 * math.pi))
    for share, R, free, all_of_them in cases:
        near = np.rint(R)
        quarter = abs(np.linalg.det(near)) == 1.0 and not np.array_equal(near, np.eye(3))
        if quarter and np.trace(near.T @ R) > 1.0 + 2.0 * math.cos(QUARTER):
            continue
        angle = float(np.linalg.norm(Rotation.from_matrix(R).as_rotvec()))
        if angle < TURNED * 0.5 * spread:
            continue
        width = free * math.log(math.sqrt(2.0 * math.pi) * 0.5 * spread) - math.log(all_of_them)
        log_prior = math.log(PRIOR_ODDS["turn"] * share) + width
        right = _normalised(_blocks(R, np.zeros((3, 3)), R), span)
        yield Hypothesis("axes", _turn_in_words(R), log_prior, np.eye(n), right)


_TURNS = {"z": 0.5, "x": 0.125, "y": 0.125, "any": 0.25}  # a flange is turned about its own axis


def mixed_axes(
    T: Array, variance: Array, spread: Array, factor: Array, most: int
) -> list[tuple[Array, float]]:
    """Signed permutations (6, 6) of one family that are most likely, with the logarithm of their prior.

    Row i of T (6, 6) is compared with sign * factor_ij e_j; its elements have the variance (6, 6), and the
    departures one of factor_ij^2 spread (6,) along the row. Of orders, there are at most `most`.
    """
    total = factor[:, :, None] ** 2 * spread + variance[:, None, :]  # (i, j, k)
    meant = np.array([1.0, -1.0])[:, None, None, None] * factor[:, :, None] * np.eye(6)  # (sign, i, j, k)
    score = -0.5 * np.sum((T[:, None, :] - meant) ** 2 / total + np.log(total), axis=-1)  # (sign, i, j)
    orders, rows = np.array(list(permutations(range(6)))), np.arange(6)
    best = orders[np.argsort(-score.max(axis=0)[rows, orders].sum(axis=1))[:most]]
    found = [np.diag(np.repeat(signs, 3)) for signs in _FREQUENT]
    for order in best:
        sign = np.where(score[0, rows, order] >= score[1, rows, order], 1.0, -1.0)
        found.append(sign[:, None] * np.eye(6)[order])
    unique = {signed.tobytes(): signed for signed in found if not np.array_equal(signed, np.eye(6))}
    return [(signed, _log_prior(signed)) for signed in unique.values()]


_FREQUENT = ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0))  # sign of the whole wrench, of forces, of moments


def _log_prior(signed: Array) -> float:
    """Half for the three frequent ones; of the rest, one row more that is wrong is half as likely."""
    if np.array_equal(signed, np.diag(np.diag(signed))) and any(
        np.array_equal(np.diag(signed), np.repeat(signs, 3)) for signs in _FREQUENT
    ):
        return math.log(0.5 / len(_FREQUENT))
    k = 6 - int(np.sum(np.diag(signed) > 0.5))
    # signed permutations of k rows that leave none as it was, by inclusion and exclusion
    derangements = sum(
        (-1) ** j * math.comb(k, j) * 2 ** (k - j) * math.factorial(k - j) for j in range(k + 1)
    )
    return math.log(0.5 ** (k + 1) / (math.comb(6, k) * derangements))


def axes_in_words(signed: Array) -> str:
    """What output i reads, for a matrix with one sign per row."""
    order, sign = np.abs(signed).argmax(axis=1), signed.sum(axis=1)
    if np.array_equal(order, np.arange(6)):
        flipped = [axis for axis, s in zip(AXES, sign, strict=True) if s < 0]
        groups = {AXES: "the whole wrench (`feels`)", AXES[:3]: "all forces", AXES[3:]: "all moments"}
        return f"wrong sign of {groups.get(tuple(flipped), ' and '.join(flipped))}"
    reads = [
        f"{AXES[i]} holds {'-' if sign[i] < 0 else ''}{AXES[order[i]]}"
        for i in range(6)
        if order[i] != i or sign[i] < 0
    ]
    moved = np.flatnonzero(order != np.arange(6))
    if len(moved) == 2 and len(reads) == 2 and np.all(sign > 0):
        return f"{AXES[moved[0]]} and {AXES[moved[1]]} swapped"
    force = signed[:3, :3]
    if np.array_equal(force, signed[3:, 3:]) and abs(round(np.linalg.det(force))) == 1:
        return f"axes {'turned' if np.linalg.det(force) > 0 else 'mirrored'} ({', '.join(reads)})"
    return f"axes mixed up ({', '.join(reads)})"


def _turn_in_words(R: Array) -> str:
    turn = Rotation.from_matrix(R).as_rotvec()
    angle = max(float(np.linalg.norm(turn)), 1e-12)
    k = int(np.argmax(np.abs(turn)))
    if abs(turn[k]) > 0.98 * angle:
        return f"axes turned by {math.degrees(math.copysign(angle, turn[k])):.0f} deg about {'xyz'[k]}"
    about = ", ".join(f"{x:.2f}" for x in turn / angle)
    return f"axes turned by {math.degrees(angle):.0f} deg about ({about})"


def _normalised(matrix: Array, span: Array) -> Array:
    return np.asarray(matrix * span / span[:, None])


def _blocks(ff: Array, mf: Array, mm: Array) -> Array:
    return np.block([[ff, np.zeros((3, 3))], [mf, mm]])


def _cross(c: Array) -> Array:
    x, y, z = c
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _size(factor: float) -> str:
    return f"{factor:.4g} times too large" if factor > 1.0 else f"{1.0 / factor:.4g} times too small"
