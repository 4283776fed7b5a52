"""Streams that say nothing: channels that are constant, missing or at a rail, and twists that do not move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truewrench.log import Log
from truewrench.rig import Rig

__all__ = ["ChannelFault", "channel_faults", "still_bases", "still_twists"]

Array = NDArray[np.float64]

_FEWEST = 10  # samples from which on a repeated value is no coincidence
_AT_RAIL = 1e-3  # share of the samples at one extreme value from which on it counts as a rail,
_PILED = 10  # if it is so many times as frequent as its neighbours, which coarse readings and pauses are not
_NEIGHBOURS = 3
_IN_A_ROW = 3

_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True, slots=True)
class ChannelFault:
    """A raw channel that cannot be calibrated from.

    Attributes:
        channel: its place.
        silent: whether it says nothing in any log, so that its gains are not determined.
        words: what a person reads.
    """

    channel: int
    silent: bool
    words: str


def channel_faults(rig: Rig, logs: Sequence[Log]) -> list[ChannelFault]:
    """Channels that are constant, without samples, or at a rail, in any log."""
    found = []
    for i, name in enumerate(rig.sensor.channels):
        silent = [_silence(log.raw[:, i]) for log in logs]
        for k, (log, words) in enumerate(zip(logs, silent, strict=True)):
            where = f" in log {k + 1}" if len(logs) > 1 and not all(silent) else ""
            if words and (where or k == 0):
                found.append(ChannelFault(i, all(silent), f"channel {name} {words}{where}: cable, or driver"))
            elif not words and (rail := _rail(log.raw[:, i])):
                where = f" in log {k + 1}" if len(logs) > 1 else ""
                found.append(
                    ChannelFault(i, False, f"channel {name} {rail}{where}: overload, or range of the driver")
                )
    return found


def still_twists(logs: Sequence[Log]) -> list[str]:
    """Notes on twist columns that stay the same while others move, which the motion may well be like."""
    notes = []
    for k, log in enumerate(logs):
        if log.twist is None or log.tracking is not None:
            continue
        still = [_silence(column) for column in log.twist.T]
        if all(still):
            continue
        where = f" of log {k + 1}" if len(logs) > 1 else ""
        notes += [
            f"column {name}{where} {words}: the motion has no such component, or it was not recorded"
            for name, words in zip(_TWIST, still, strict=True)
            if words
        ]
    return notes


def still_bases(logs: Sequence[Log]) -> list[str]:
    """A note on logs of joints that say nothing of their base."""
    silent = [str(k + 1) for k, log in enumerate(logs) if log.tracking is not None and log.base_twist is None]
    if not silent:
        return []
    where = f" in log {', '.join(silent)}" if len(logs) > 1 else ""
    return [f"no columns base_vx ... base_wz{where}: the robot's base is taken to stand still"]


def _silence(values: Array) -> str:
    known = values[np.isfinite(values)]
    if known.size == 0:
        return "has no samples"
    if known.size >= _FEWEST and known.min() == known.max():
        return f"is constant ({known[0]:.6g})"
    return ""


def _rail(values: Array) -> str:
    known = values[np.isfinite(values)]
    if known.size < _FEWEST:
        return ""
    for sign in (1.0, -1.0):
        extreme = (sign * known).max() * sign
        at = known == extreme
        count = int(np.count_nonzero(at))
        if count < max(_FEWEST, _AT_RAIL * known.size) or _longest(at) < _IN_A_ROW:
            continue
        _, counts = np.unique(sign * known, return_counts=True)
        near = counts[-1 - _NEIGHBOURS : -1]
        if near.size > 0 and count >= _PILED * near.max():
            share = 100.0 * count / known.size
            return f"stands at {extreme:.6g}, its extreme value, for {share:.2g} % of the samples"
    return ""


def _longest(at: NDArray[np.bool_]) -> int:
    """Most consecutive true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
