"""Noise that a filter has coloured, made white again before anything is estimated.

Sensors and drivers filter what they log, noise and all. Taken for white, such noise seems smaller than it is
at the frequencies of a motion, and its slow part seems to be a motion or a disturbance. Where no motion is,
its spectrum tells the filter (filter_model.py): a mean of so many samples, one of which tells all that they
do; or an autoregressive model A(z), whose inverse A(z) / A(1) leaves white noise of the same density and
undoes the delay (docs/method.md, M12a). Where no model holds, so many samples are one (thinning.py).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from truewrench.estimation.evenly import (
    at_places,
    hann,
    noise_spectrum,
    places_of,
    present,
)
from truewrench.estimation.filter_model import BEGIN, END, SHARES, TOLD, Colour, Tails, filter_model, levels
from truewrench.estimation.thinning import GROWS, Thinning, thinning_of
from truewrench.model.arrays import Array
from truewrench.model.log import Log, Whitened
from truewrench.model.motion.smooth import segments
from truewrench.model.rig import Rig

FEWEST = 512  # samples of a stretch, and of a spectrum
HOLDS = 1.5  # times a model below `BEGIN`, from which on it is thinned, where that makes it white: tolerance

STREAMS = {
    "raw": "raw_*",
    "twist": "vx ... wz",
    "position": "q_*",
    "velocity": "dq_*",
    "angular_velocity": "wx wy wz",
    "specific_force": "accel_*",
}


def without_filters(rig: Rig, log: Log) -> Log:
    """The log with its streams as they would be without the filters that colour their noise; else itself."""
    changed: dict[str, Any] = {}
    whitened: dict[str, Whitened] = {}
    for name, columns in STREAMS.items():
        values = getattr(log, name)
        if values is None or (name == "twist" and log.tracking is not None):  # of joints, which made it
            continue
        time, values, rows = present(log.time, values)
        taken = log.vibrations if name == "raw" else ()
        find = thinned_of if name == "position" else colour_of
        colour = find(time, values, _stated(rig, name), [(x.low, x.high) for x in taken])
        if colour is None:
            continue
        out = np.full((len(log.time_ns), values.shape[1]), np.nan)
        for piece in segments(time):
            places = places_of(time[piece])
            out[rows[piece]] = colour.whitened(at_places(places, values[piece]))[places]
        period = float(np.median(np.diff(time)))
        changed[name] = out
        corner = colour.corner / period
        whitened[name] = Whitened(
            columns, colour.growth, colour.advance * period, corner, colour.step, period
        )
    return replace(log, **changed, whitened=whitened) if changed else log


def _stated(rig: Rig, stream: str) -> Array | None:
    """1 sigma (M,) of its noise; None where the rig does not say."""
    if stream == "raw":
        return rig.sensor.noise_array
    motion = rig.motion
    other = {"position": motion.position_noise, "specific_force": motion.acceleration_noise}
    told = other.get(stream, motion.noise)
    return None if told is None else np.array(told)


def colour_of(
    time: Array, values: Array, stated: Array | None = None, without: Sequence[tuple[float, float]] = ()
) -> Colour | None:
    """Of samples (N, M) at times (N,); None where their noise is white, or no model holds.

    `stated` (M,) is 1 sigma of that noise, None where it is not known; `without` are bands that have been
    taken out [Hz].
    """
    found = noise_spectrum(time, values, BEGIN, END, hann(FEWEST), without)
    if found is None:
        return None
    negligible = np.log(1.0 + 0.5 * (GROWS - 1.0))
    if np.abs(levels(found.power, 1.0)).max() < negligible:
        return None
    white, tails = Tails(found, np.zeros(1)), Tails(found, SHARES)
    unfiltered = np.ones(found.hz.size)
    if np.abs(levels(found.power, tails.fitted(unfiltered)[1](found.hz))).max() < negligible:
        return None
    lowest = min(white.cost(unfiltered), tails.cost(unfiltered) + TOLD)
    alone = filter_model(found, white, lowest)
    if alone is not None and alone.below(time, values, without) < HOLDS:  # else what is steeper is no corner
        return alone.colour
    beside = filter_model(found, tails, lowest - TOLD)
    # else a steep filter's slope was taken for a tail, which goes on below as motions do
    believed = beside is not None and beside.explains(stated, found.period)
    if beside is not None and believed and beside.below(time, values, without) > 1.0 / HOLDS:
        return beside.colour
    thinned = thinning_of(time, values, stated, without)
    if thinned is not None:
        return _one_of(thinned)
    return None if alone is None else alone.colour


def thinned_of(
    time: Array, values: Array, stated: Array | None, without: Sequence[tuple[float, float]]
) -> Colour | None:
    """As `colour_of` of what a motion is 100,000 times as large as: models take its slope for a filter's."""
    thinned = thinning_of(time, values, stated, without)
    return None if thinned is None else _one_of(thinned)


def _one_of(thinned: Thinning) -> Colour:
    return Colour(np.ones(1), thinned.step, 1.0, thinned.corner)
