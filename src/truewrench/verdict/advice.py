"""What would make a calibration accurate enough, in numbers a person can act on."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping

import numpy as np

from truewrench.calibration import UNDETERMINED
from truewrench.estimate.sources import NOISE
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.rig import Rig

__all__ = ["advice"]

_GENERAL = "a longer, faster or heavier motion of that axis helps"
_UNSEEN = "a motion, or a second payload, that loads that axis by itself helps"


def advice(rig: Rig, estimate: WindowEstimate, payload: str | None, silent: Collection[int] = ()) -> str:
    """What takes all gains of an estimate to the `required` of the rig, if they are not there yet.

    Args:
        rig: `required`, and what it states of payload and clock.
        estimate: gain and what its uncertainty is made of.
        payload: of the last log.
        silent: channels that do not count.
    """
    n = rig.sensor.n
    std = np.sqrt(np.diag(estimate.normalised_covariance)[: 6 * n])
    std.reshape(n, 6)[list(silent)] = 0.0
    if std.max() <= rig.required:
        return ""
    if std.max() > UNDETERMINED * rig.sensor.gain_prior:
        return _UNSEEN
    if estimate.sources is None:
        return _GENERAL
    remedy = estimate.sources.remedy(std > 0.0, rig.required)
    return _words(rig, remedy, payload) if remedy else _GENERAL


def _words(rig: Rig, remedy: Mapping[str, float], payload: str | None) -> str:
    stated = rig.payloads[payload or next(iter(rig.payloads))].uncertainty
    of_payload = "the payload" if payload is None else f"payload `{payload}`"
    causes, cures = [], []
    for source, factor in remedy.items():
        if source == NOISE:
            longer = factor**-2.0
            causes.append("noise")
            cures.append(
                f"a record {_up(longer)} times as long, or wrenches {_up(math.sqrt(longer))} times as large "
                "(faster, heavier)"
            )
        elif source == "timing":
            causes.append("the clocks")
            known = _stated(rig.sensor.time_offset_prior, factor, 1e3, "ms")
            cures.append(f"sensor and motion synchronised to {known}")
        else:
            value, unit, size = {
                "mass": (stated.mass, "%", 1e2),
                "center_of_mass": (stated.center_of_mass, "mm", 1e3),
                "inertia": (stated.inertia, "%", 1e2),
            }[source]
            name = {"center_of_mass": "centre of mass"}.get(source, source)
            causes.append(f"the {name} of {of_payload}")
            cures.append(f"the {name} known to {_stated(value, factor, size, unit)}")
    limit = "limits" if len(causes) == 1 and causes != ["the clocks"] else "limit"
    return f"{_listed(causes)} {limit} it: {_listed(cures)} would do"


def _stated(value: float, factor: float, size: float, unit: str) -> str:
    return f"{_down(size * value * factor)} {unit} (stated: {size * value:.3g} {unit})"


def _up(value: float) -> str:
    return _two_digits(value, math.ceil)


def _down(value: float) -> str:
    return _two_digits(value, math.floor)


def _two_digits(value: float, whole: Callable[[float], int]) -> str:
    """Rounded to the side on which it still suffices."""
    digits = 1 - math.floor(math.log10(value))
    rounded = whole(value * 10.0**digits * (1.0 + 1e-9 if whole is math.floor else 1.0 - 1e-9)) / 10.0**digits
    return f"{rounded:.{max(digits, 0)}f}".rstrip("0").rstrip(".") if digits > 0 else f"{rounded:.0f}"


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
