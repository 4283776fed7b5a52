"""Nominal and new gain compared as part of a calibration: on a part of the record that was held out.

The same estimator calibrates on the rest of the record, and that gain, not the final one, is judged by the
held-out part (validation.py): the final gain has seen it. A record too short to spare a part is compared on
what the gain was fitted to, and says so.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from truewrench import _core
from truewrench.estimation.estimate import Estimate
from truewrench.judging.validation import CHANGE, LOSS, validate, worse
from truewrench.model.arrays import Array
from truewrench.model.calibration import AXES, AxisImprovement, Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import between_jumps, held_out

SHARE, BLOCKS = 0.2, 4  # of every log that is held out; in so many pieces at most


@dataclass(frozen=True, slots=True)
class Comparison:
    """Nominal against new gain."""

    improvement: Mapping[str, AxisImprovement]  # by wrench axis
    reasons: tuple[str, ...]  # why the new gain should not replace the nominal one, in words
    figures: Mapping[str, Any]  # what the comparison rests on, or why nothing was held out


def compare_held_out(
    rig: Rig, logs: Sequence[Log], calibrated: Callable[[Sequence[Log]], Calibration | None]
) -> Comparison | str:
    """Compare on the held-out part of the logs, or say why that cannot be.

    `calibrated` is a calibration with some logs, None where they do not suffice for one.
    """
    kept, out = held_out(logs, SHARE, BLOCKS)
    if not out:
        return "the record is too short to hold a part of it out (10 s and 1000 rows are needed)"
    return compare_on(rig, out, calibrated(kept), SHARE)


def compare_on(
    rig: Rig, out: Sequence[Log], calibration: Calibration | None, share: float
) -> Comparison | str:
    """Compare on logs that a calibration with the rest has not seen, or say why that cannot be.

    It is None where the rest does not suffice for one; `share` of the record was held out.
    """
    if calibration is None or not np.isfinite(calibration.inverse).all():
        return "without the part to be held out, the record does not give a gain"
    try:
        found = validate(calibration, rig, [piece for log in out for piece in between_jumps(log)])
    except (InputError, np.linalg.LinAlgError) as error:
        return f"the part held out could not be compared: {' '.join(str(error).split())}"
    asked = dict(zip(AXES, np.isfinite(rig.required_array), strict=True))
    reasons = [worse(name, axis) for name, axis in found.axes.items() if axis.better is False and asked[name]]
    return Comparison(
        found.improvement,
        tuple(f"on the part of the record that was held out, {reason}" for reason in reasons),
        {
            "samples": found.samples,
            "share": share,
            "nis": {name: axis.nis for name, axis in found.axes.items()},
            "coverage": {name: axis.coverage for name, axis in found.axes.items()},
        },
    )


def compare_in_sample(
    rig: Rig, logs: Sequence[Log], estimate: Estimate, inverse: Array, why: str
) -> Comparison:
    """Compare on the data the gain was fitted to, with the payload's wrench by the fitted motion.

    The nominal gain has the mean of its errors taken off where offsets are unknown. Of the new gain all that
    remains of a sample beside gain, offset and steps counts: noise, slow disturbance and quadratic term. The
    inverse (6, n) is that of the gain; `why` says why nothing was held out.
    """
    old, new = _errors(rig, logs, estimate, inverse)
    if not old or not np.isfinite(inverse).all():
        return Comparison({}, (), {"none_because": why})
    before, after = (np.sqrt(np.mean(np.concatenate(x) ** 2, axis=0)) for x in (old, new))
    improvement = {}
    for axis, b, a in zip(AXES, before, after, strict=True):
        better: Literal[True, False, "unsure"] = "unsure"
        if a * (1.0 + CHANGE) < b:
            better = True
        elif a > b * (1.0 + LOSS):
            better = False
        improvement[axis] = AxisImprovement(float(b), float(a), held_out=False, better=better)
    return Comparison(improvement, (), {"none_because": why})


def _errors(
    rig: Rig, logs: Sequence[Log], estimate: Estimate, inverse: Array
) -> tuple[list[Array], list[Array]]:
    """Corrected minus expected wrench (M, 6) of each log, by the nominal and by the new gain."""
    sensor, scale = rig.sensor, rig.sensor.channel_scale
    nominal_inverse = _core.generalised_inverse(sensor.nominal_gain_array, sensor.noise_array)
    old, new = [], []
    for log, rows in zip(logs, estimate.rows, strict=True):
        used = ~rows.masked & np.isfinite(rows.residual).all(axis=1)
        if not used.any():
            continue
        wrench = rows.wrench[used]
        nominal = log.raw[rows.rows[used]] @ nominal_inverse.T - wrench
        if sensor.offset_prior_array.any():
            nominal -= nominal.mean(axis=0)
        old.append(nominal)
        quadratic = estimate.quadratic * (wrench @ estimate.gain.T / scale) ** 2
        new.append(((rows.residual + rows.discrepancy)[used] + quadratic) * scale @ inverse.T)
    return old, new
