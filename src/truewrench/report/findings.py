"""What a report says in words: the verdict, what would help, and what each figure shows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from truewrench.calibration import AXES, Calibration
from truewrench.report.consistency import CHANCE, Consistency
from truewrench.report.convergence import Convergence
from truewrench.report.statistics import Histogram, Spectrum

__all__ = [
    "axes_listed",
    "consistency_words",
    "convergence_words",
    "dominating",
    "helps",
    "histogram_words",
    "spectrum_words",
    "undetermined_words",
]

_CHI_SQUARE = 1.05  # above it residuals are larger than the noise
_REFERENCES = ("ekf", "ls")
_COLOURED = 1.5  # of the density at low frequencies


def undetermined_words(calibration: Calibration) -> list[str]:
    """The directions of the gain that the data leave open, alike ones together."""
    count = Counter(direction.words for direction in calibration.verdict.undetermined)
    return [f"{words} ({n} directions)" if n > 1 else words for words, n in count.items()]


def helps(calibration: Calibration) -> Iterator[str]:
    """What a person can do where a calibration is not usable, in the order of its effect."""
    c = calibration
    if c.estimator in _REFERENCES:
        yield (
            "Calibrate with the estimator `map` (the default): `ekf` and `ls` are there to be compared "
            "with, and are never usable."
        )
    if not any(log.used for log in c.logs):
        yield (
            "Nothing of the record was used. Look at units, axes, sign (`sensor.feels`) and clocks of the "
            "log with `truewrench inspect`, and at the motion's and the sensor's noise in the rig."
        )
    if c.verdict.undetermined:
        yield (
            "Move so that the directions that are not determined vary on their own, or add a log with "
            "another payload: several logs are pooled into one gain."
        )
    for reason in c.verdict.reasons:
        what, _, remedy = reason.partition("; ")
        if what.startswith("accuracy:") and remedy:
            yield f"For the accuracy: {remedy}."
    worse = [axis for axis, judged in c.improvement.items() if judged.better is False and judged.held_out]
    if worse:
        yield (
            f"On {axes_listed(worse)} the nominal gain is better: check mass and centre of mass of the "
            "payload, and that nothing touches it."
        )
    rejected = sum(sum(log.rejected.values()) for log in c.logs)
    used = sum(log.used for log in c.logs)
    if used and rejected > 0.05 * (rejected + used):
        yield (
            "Much of the motion did not fit: move more smoothly or sample faster, fix what vibrates, and "
            "state the noise as it is."
        )
    disturbed = sum(sum(log.masked.values()) for log in c.logs)
    if used and disturbed > 0.2 * (disturbed + used):
        yield (
            "Many samples were left out as contact or spikes: record again with nothing touching the payload."
        )
    fits = c.figures.get("chi_square")
    if (
        isinstance(fits, dict)
        and any(fit > _CHI_SQUARE for fit in fits.values())
        and c.estimator != "reference"
    ):
        yield (
            "Residuals are larger than the stated noise: state the noise found (section Residuals), or let "
            "it be taken from the residuals (`--rescale-noise`)."
        )


def dominating(calibration: Calibration) -> str:
    """What contributes most to the uncertainty on most axes; empty where that is not known."""
    sources = calibration.figures.get("limited_by") or {}
    if not sources:
        return ""
    largest = Counter(max(sources, key=lambda name: sources[name][axis]) for axis in AXES)
    return str(largest.most_common(1)[0][0]).replace("_", " ").replace("center", "centre")


def spectrum_words(found: Spectrum) -> str:
    """What the density of the residuals says of their noise."""
    low = found.frequency <= found.frequency[-1] / 10.0
    peaks = found.ratio > 2.5 * found.high[:, None]
    raised = [axis for i, axis in enumerate(AXES) if low.any() and np.median(found.ratio[low, i]) > _COLOURED]
    sharp = [axis for i, axis in enumerate(AXES) if peaks[~low, i].any()]
    slow = [axis for i, axis in enumerate(AXES) if peaks[low, i].any()]
    if raised:
        return (
            f"{axes_listed(raised)} {_has(raised)} more than the expected noise at low frequencies: the "
            "noise is coloured (a filter, drift), or the motion is not resolved."
        )
    if sharp:
        return (
            f"{axes_listed(sharp)} {_has(sharp)} more than the expected noise in some bands: look for "
            "mains, vibration or servo ripple at these frequencies."
        )
    if slow:
        return (
            f"{axes_listed(slow)} {_has(slow)} more than the expected noise at the frequencies of the "
            "motion alone: what is still uncertain of gain and payload shows there, or the motion is not "
            "resolved."
        )
    return "All axes lie along 1: the noise is as large and as white as the rig states."


def histogram_words(found: Histogram) -> str:
    """Whether the residuals are distributed as their noise."""
    off = [
        axis
        for axis, size, within in zip(AXES, found.size, found.within, strict=True)
        if not 0.9 < size < 1.1 or not 0.93 < within < 0.97
    ]
    low, high = 100 * found.within.min(), 100 * found.within.max()
    shares = f"{low:.1f} to {high:.1f} % lie within 1.96 sigma (95 % expected)"
    if not off:
        return f"As expected: {shares}."
    sizes = ", ".join(f"{axis} {found.size[AXES.index(axis)]:.2f}" for axis in off)
    return f"Not as expected on {axes_listed(off)} (RMS in sigma: {sizes}); {shares}."


def consistency_words(found: tuple[Consistency, ...]) -> str:
    """How many values lie outside, and how many may."""
    parts = [f"{stream.name} {stream.outside} of {len(stream.value)}" for stream in found]
    surprising = [stream.name for stream in found if stream.outside > 3.0 + 3.0 * CHANCE * len(stream.value)]
    end = (
        f"More than chance allows in {', '.join(surprising)}: there the noise is not as stated, or "
        "something touched the payload."
        if surprising
        else "No more than chance allows: the noise is as stated all along."
    )
    return f"{end} Outside their bounds: {'; '.join(parts)}."


def convergence_words(found: Convergence, calibration: Calibration) -> str:
    """Whether a longer record would help."""
    half = found.time <= 0.5 * (found.time[0] + found.time[-1])
    moved, noise, final = (100 * float(x) for x in (found.distance[half][-1], found.sigma[-1], found.final))
    words = (
        f"Half of the record is {moved:.2g} % of full scale from the final gain; the stated sigma is "
        f"{final:.2g} % (RMS)."
    )
    if noise > 0.5 * final:
        return f"{words} It is mostly noise: four times the record would halve it."
    if len(calibration.figures.get("limited_by") or {}) > 1:
        return (
            f"{words} Noise alone would leave {noise:.2g} %: the rest comes from what is uncertain of "
            "payload and clock, and a longer record of the same kind would hardly help."
        )
    return f"{words} With the motion (or reference wrench) known, noise alone would leave {noise:.2g} %."


def axes_listed(names: list[str]) -> str:
    """`fx, fy and fz`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _has(names: list[str]) -> str:
    return "has" if len(names) == 1 else "have"
