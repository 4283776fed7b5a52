"""What would make a calibration accurate enough, in numbers a person can act on."""

import math
from dataclasses import dataclass

import numpy as np

from truewrench import _core
from truewrench.estimation.estimate import Estimate
from truewrench.judging.words import listed
from truewrench.model.arrays import Array
from truewrench.model.rig import Rig

_GENERAL = (
    "a longer, faster or heavier motion of that axis helps",
    "more or larger wrenches along that axis help",
)
_UNSEEN = (
    "a motion, or a second payload, that loads that axis by itself helps",
    "reference wrenches that load that axis by itself help",
)
_BISECTIONS = 60  # tolerance


@dataclass(frozen=True, slots=True)
class Disturbed:
    """What was found in a record beside the model: which costs accuracy, as large as it was found."""

    slow: str  # what disturbs slowly, and what it looks like
    found: bool = False  # whether it stands out: (10.10) is then of its size
    in_fit: bool = False  # whether it is a part of the scatter of the samples
    scatter: str = ""  # by how much, and by what kinds, the samples scatter more than stated
    others: tuple[str, ...] = ()  # what else is larger than stated


def advice(
    estimate: Estimate,
    rig: Rig,
    required: Array,
    payload: str | None,
    disturbed: Disturbed,
    by_reference: bool = False,
) -> str:
    """What takes the gains of an estimate to what is required of them, where they are not there yet.

    The largest contributions to sigma are cut down to one level at which the worst gain is accurate enough;
    that they are independent makes of it a good guess and no promise. `required` (6,) is sigma of each wrench
    axis' gains; the payload is that of the last log; `by_reference`: wrenches are known from elsewhere, and
    no motion.
    """
    n = rig.sensor.n
    std = np.sqrt(np.maximum(np.diag(estimate.normalised_covariance)[: 6 * n], 0.0)).reshape(n, 6)
    prior = estimate.gain_prior.reshape(n, 6)
    worst = np.unravel_index(int(np.argmax(np.where(np.isfinite(required), std / required, 0.0))), std.shape)
    before_pose = np.sqrt(np.maximum(np.diag(estimate.before_pose), 0.0)).reshape(n, 6)
    less = f"less of {disturbed.slow}, or " if disturbed.found else ""
    if not before_pose[worst] <= _core.UNDETERMINED * prior[worst]:
        return less + _UNSEEN[by_reference]
    parts = {name: float(sigma[worst]) for name, sigma in estimate.sources.items()}
    parts = {name: s for name, s in parts.items() if np.isfinite(s) and s > 0.0}
    if not parts:
        return less + _GENERAL[by_reference]
    low, high = 0.0, max(parts.values())
    for _ in range(_BISECTIONS):
        level = 0.5 * (low + high)
        if sum(min(s, level) ** 2 for s in parts.values()) > required[worst[1]] ** 2:
            high = level
        else:
            low = level
    factors = {name: low / s for name, s in sorted(parts.items(), key=lambda p: -p[1]) if s > low}
    words = _words(estimate, rig, factors, payload, disturbed) if factors and low > 0.0 else ""
    return words or less + _GENERAL[by_reference]


def _words(
    estimate: Estimate, rig: Rig, factors: dict[str, float], payload: str | None, disturbed: Disturbed
) -> str:
    stated = rig.payloads.get(payload or next(iter(rig.payloads)))
    slow = disturbed.slow
    causes: list[str] = []
    cures: list[str] = []
    for source, factor in factors.items():
        times, longer = _up(1.0 / factor), _up(factor**-2.0)
        if source == "noise":
            causes += [slow] if disturbed.in_fit and slow not in causes else []
            causes.append(f"the scatter of the samples{disturbed.scatter}")
            cures.append(f"a record {longer} times as long, or wrenches {times} times as large")
        elif source == "timing":
            causes.append("timing")
            cures.append(f"streams synchronised {times} times better, or more frequencies an axis")
        elif source == "gravity":
            causes.append("the direction of free fall")
            known = _stated(rig.gravity_tilt_prior, factor, 1e3, "mrad")
            cures.append(f"its tilt known to {known}, or more rotation")
        elif source == "slow":
            causes += [slow] if slow not in causes else []
            cures.append(f"{times} times less of it, or a record {longer} times as long")
        elif source == "poses":
            causes.append("what may follow the pose by as much as poses scatter")
            cures.append(f"{times} times less of what scatters them (hysteresis, creep, a cable)")
        elif source == "pose":
            hidden = f"this one hides {100 * estimate.A:.0f} % of its pose"
            moved = f"a motion of several frequencies an axis ({hidden})"
            if disturbed.found:  # to state that there is none would be wrong
                causes += [slow] if slow not in causes else []
                causes.append("as much of it as may follow the pose unseen")
                cures.append(f"{moved}, or {times} times less of what disturbs it")
            else:
                causes.append("what may follow the pose unseen")
                cures.append(
                    f"{moved}, or `discrepancy: 0` where nothing but the payload pulls on the sensor"
                )
        elif stated is not None and source in _PAYLOAD:
            name, unit, size = _PAYLOAD[source]
            of = "" if payload is None else f" of payload `{payload}`"
            causes.append(f"the {name}{of}")
            cures.append(
                f"the {name} known to {_stated(getattr(stated.uncertainty, source), factor, size, unit)}"
            )
    if not causes:
        return ""
    beside = [slow] if disturbed.found and slow not in causes else []
    beside += (
        [f"the scatter of the samples{disturbed.scatter}"]
        if disturbed.scatter and "noise" not in factors
        else []
    )
    beside += disturbed.others
    found = f"; found beside it: {listed(beside, 'and')}" if beside else ""
    return f"limited by {listed(causes, 'and')}: {listed(cures, 'and')} would do{found}"


_PAYLOAD = {
    "mass": ("mass", "%", 1e2),
    "center_of_mass": ("centre of mass", "mm", 1e3),
    "inertia": ("inertia", "%", 1e2),
}


def _stated(value: float, factor: float, size: float, unit: str) -> str:
    return f"{_down(size * value * factor)} {unit} (stated: {size * value:.3g} {unit})"


def _up(value: float) -> str:
    return _two_digits(value, up=True)


def _down(value: float) -> str:
    return _two_digits(value, up=False)


def _two_digits(value: float, *, up: bool) -> str:
    """Rounded to the side on which it still suffices."""
    if not 0.0 < value < math.inf:
        return f"{value:g}"
    digits = 1 - math.floor(math.log10(value))
    scaled = value * 10.0**digits
    rounded = (math.ceil(scaled * (1.0 - 1e-9)) if up else math.floor(scaled * (1.0 + 1e-9))) / 10.0**digits
    return f"{rounded:.{max(digits, 0)}f}".rstrip("0").rstrip(".") if digits > 0 else f"{rounded:.0f}"
