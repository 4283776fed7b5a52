"""The largest departure of a record from the model: which stream, when, how large."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truewrench.estimation.estimate import Estimate
from truewrench.judging.words import CHANNELS, log_name
from truewrench.model.log import Log
from truewrench.model.rig import Rig

LOUD = 2.0  # times the stated noise, from which on a motion stream is the one that departs: words only


def largest_departure(estimate: Estimate, rig: Rig, logs: Sequence[Log]) -> str:
    """Of a channel at its worst sample, or of a motion stream that is noisier than the sensor is."""
    sensor = rig.sensor
    noise = sensor.noise_array / sensor.channel_scale
    worst, words = 0.0, "no departure stands out"
    for k, rows in enumerate(estimate.rows):
        y = np.abs(np.nan_to_num(rows.residual + rows.discrepancy, nan=0.0, posinf=0.0, neginf=0.0))
        if y.size == 0:
            continue
        row, i = np.unravel_index(int(np.argmax(y / noise)), y.shape)
        if y[row, i] / noise[i] > worst:
            worst = float(y[row, i] / noise[i])
            words = (
                f"largest departure: channel {sensor.channels[i]}, {100 * y[row, i]:.2g}% of range at"
                f" {rows.time[row]:.4g} s of {log_name(logs, k)}, {worst:.2g} x its sigma"
            )
    factors = [(found.factor, found.what, k) for k, of in enumerate(estimate.noise) for found in of]
    sensed = max((f for f, what, _ in factors if what in CHANNELS and np.isfinite(f)), default=1.0)
    moved = max(((f, w, k) for f, w, k in factors if w not in CHANNELS and np.isfinite(f)), default=None)
    if moved is not None and moved[0] > max(LOUD, sensed):
        words = (
            f"largest departure: the motion, {moved[1]} of {log_name(logs, moved[2])} scatter "
            f"{moved[0]:.2g} times as stated all along"
        )
    return words
