"""What a report says in words: the verdict, what would help, and what each figure shows."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from truewrench import _core
from truewrench.estimation.estimate import AGREE
from truewrench.judging.words import listed
from truewrench.model.calibration import AXES, Calibration
from truewrench.report.consistency import CHANCE, Consistency
from truewrench.report.convergence import Convergence
from truewrench.report.statistics import Histogram, Spectrum
from truewrench.report.tables import SOURCES

CURES = {
    "noise": "a longer record, or one of larger wrenches (faster, heavier),",
    "mass": "a payload that is weighed more exactly",
    "center_of_mass": "a payload whose centre of mass is known better",
    "inertia": "a payload whose inertia is known better",
    "timing": "synchronising sensor and motion, or moving at several frequencies per axis,",
    "gravity": "a base that is levelled, or a motion that turns the payload more,",
    "slow": "a sensor that is warm, and nothing that sticks or slips,",
    "pose": "a motion of several frequencies per axis, or cables that hang free,",
}
"""What makes each source of uncertainty smaller."""

_HIDES = 0.9  # of the pose that the wrench repeats
_REFERENCES = ("ekf", "ls")
_COLOURED = 1.5  # of the density at low frequencies


def helps(calibration: Calibration) -> Iterator[str]:
    """What a person can do where a calibration is not usable, in the order of its effect."""
    c = calibration
    used = sum(log.used for log in c.logs)
    if c.estimator in _REFERENCES:
        yield (
            "Calibrate with the estimator `map` (the default): `ekf` and `ls` are there to be compared "
            "with, and are never usable."
        )
    if c.unused:
        yield (
            "Nothing of the record was used: what the reasons say comes first. Where they name nothing, look "
            "at units, axes, sign (`sensor.feels`) and clocks of the log with `truewrench inspect`, and at "
            "the motion's and the sensor's noise in the rig."
        )
    if c.verdict.undetermined and not c.unused:
        yield (
            "Move so that the directions that are not determined vary on their own, or add a log with "
            "another payload: several logs are pooled into one gain."
        )
    remedies = [r.partition("; ")[2] for r in c.verdict.reasons if r.startswith("accuracy:")]
    yield from (f"For the accuracy: {remedy}." for remedy in remedies if remedy)
    source = dominating(c)
    if source and used and remedies and not any(remedies):
        yield f"For the accuracy: {source_words(source)} limits it on most axes; {CURES[source]} helps."
    worse = [axis for axis, judged in c.improvement.items() if judged.better is False and judged.held_out]
    if worse:
        yield (
            f"On {listed(worse, 'and')} the nominal gain is better: check mass and centre of mass of the "
            "payload, and that nothing touches it."
        )
    if any(not p >= AGREE for p in (c.figures.get("parts_agree") or {}).values()):
        yield (
            "The parts of the record do not agree on the gain: something changed while it was taken. Look "
            "at wrench and residuals over time, fasten payload and cables, let the sensor warm up, and "
            "record again."
        )
    rejected = sum(sum(log.rejected.values()) for log in c.logs)
    masked = sum(sum(log.masked.values()) for log in c.logs)
    if used and rejected > 0.05 * (rejected + used):
        yield "Much of the record lies outside of every stretch of motion: look for gaps in its streams."
    if used and masked > _core.MOST_LOST * (masked + used):
        yield "Many samples were left out as contact or outliers: see that nothing touches the payload."


def dominating(calibration: Calibration) -> str:
    """What contributes most to the uncertainty on most axes; empty where that is not known."""
    sources = calibration.figures.get("limited_by") or {}
    largest = Counter(max(sources, key=lambda name: sources[name][axis]) for axis in AXES if sources)
    return str(largest.most_common(1)[0][0]) if largest else ""


def source_words(source: str) -> str:
    """With an article."""
    whose = "the payload's " if source in ("mass", "center_of_mass", "inertia") else ""
    article = {"timing": "the lateness of the ", "gravity": "the ", "slow": "a ", "pose": "a "}.get(
        source, ""
    )
    return f"{whose}{article}{SOURCES.get(source, source)}"


def agreement_words(calibration: Calibration) -> list[str]:
    """Whether the parts of the record give the same gain."""
    p = calibration.figures.get("parts_agree") or {}
    if not p:
        return []
    agree = all(value >= AGREE for value in p.values())
    of_logs = (
        f", one of its logs and the others in {100 * p['logs']:.2g} %" if len(calibration.logs) > 1 else ""
    )
    return [
        f"The parts of the record {'agree' if agree else 'do not agree'} on the gain: by chance its halves "
        f"differ as much in {100 * p['halves']:.2g} % of records, its quarters 1 + 3 and 2 + 4 in "
        f"{100 * p['quarters']:.2g} %{of_logs}; below {100 * AGREE:g} % something changed within the record."
    ]


def pose_words(calibration: Calibration) -> list[str]:
    """How well a force that follows the pose can hide in this motion."""
    share = calibration.figures.get("pose_share")
    if share is None:
        return []
    hides = "well" if share > _HIDES else "in part"
    return [
        f"The wrench of this motion repeats {100 * share:.0f} % of its pose (A): a force that follows the "
        f"pose, of a cable or hysteresis, hides {hides} in the gain. Several frequencies per axis lower it."
    ]


def spectrum_words(found: Spectrum) -> str:
    """What the density of the residuals says of their noise."""
    low = found.frequency <= max(found.frequency[0], found.frequency[-1] / 10.0)
    raised = np.greater(np.median(found.ratio[low], axis=0), _COLOURED)
    peaks = np.any(found.ratio > 2.5 * found.high[:, None], axis=0)
    slow = "at low frequencies: the noise is coloured (a filter, drift), or the motion is not resolved"
    sharp = "in some bands: look for mains, vibration or servo ripple there"
    for where, words in ((raised, slow), (peaks, sharp)):
        if np.any(where):
            names = [axis for axis, shows in zip(AXES, where, strict=True) if shows]
            return f"{listed(names, 'and')}: more than the expected noise {words}."
    return "All axes lie along 1: the noise is as large and as white as expected."


def histogram_words(found: Histogram) -> str:
    """Whether the residuals are distributed as their noise."""
    sizes = zip(AXES, found.size, found.within, strict=True)
    off = [f"{a} {size:.2f}" for a, size, part in sizes if abs(size - 1) > 0.1 or abs(part - 0.95) > 0.02]
    said = f"Not as expected (RMS in sigma): {', '.join(off)}" if off else "As expected"
    low, high = 100 * found.within.min(), 100 * found.within.max()
    return f"{said}; {low:.1f} to {high:.1f} % lie within 1.96 sigma (95 % expected)."


def consistency_words(found: tuple[Consistency, ...]) -> str:
    """How many values lie outside, and how many may."""
    parts = [f"{stream.name} {stream.outside} of {len(stream.value)}" for stream in found]
    surprising = [stream.name for stream in found if stream.outside > 3.0 + 3.0 * CHANCE * len(stream.value)]
    end = (
        f"More than chance allows in {', '.join(surprising)}: there the noise is not as expected all along, "
        "or something touched the payload."
        if surprising
        else "No more than chance allows: the noise is as expected all along."
    )
    return f"{end} Outside their bounds: {'; '.join(parts)}."


def convergence_words(found: Convergence, calibration: Calibration) -> str:
    """Whether a longer record would help."""
    half = found.time <= 0.5 * (found.time[0] + found.time[-1])
    moved, noise, final = (100 * float(x) for x in (found.distance[half][-1], found.sigma[-1], found.final))
    words = (
        f"Half of the record is {moved:.2g} % of full scale from the final gain, sigma {final:.2g} % (RMS)."
    )
    if noise > 0.5 * final:
        return f"{words} It is mostly noise: four times the record would halve it."
    rest = "; the rest comes from what else is uncertain, and a longer record would hardly help"
    known = rest if len(calibration.figures.get("limited_by") or {}) > 1 else ""
    return f"{words} With the motion (or reference) known, noise alone would leave {noise:.2g} %{known}."
