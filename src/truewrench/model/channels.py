"""Streams that say nothing: channels that are constant, missing or at a rail, motions that stand still."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.model.log import Log, log_name
from truewrench.model.rig import Rig

FEWEST = 10  # samples from which on a repeated value is no coincidence: tolerance
AT_RAIL = 1e-3  # share of the samples at one extreme value from which on it counts as a rail,
PILED = 10  # if it is so many times as frequent as its neighbours, which coarse readings and pauses are not
NEIGHBOURS = 3
IN_A_ROW = 3


@dataclass(frozen=True, slots=True)
class ChannelFault:
    """A raw channel that cannot be calibrated from."""

    channel: int  # its place
    silent: bool  # whether it says nothing in any log, so that its gains are not determined
    words: str  # what a person reads


def channel_faults(rig: Rig, logs: Sequence[Log]) -> list[ChannelFault]:
    """Channels that are constant, without samples, or at a rail, in any log."""
    found = []
    for i, name in enumerate(rig.sensor.channels):
        silent = [_silence(log.raw[:, i]) for log in logs]
        for k, (log, words) in enumerate(zip(logs, silent, strict=True)):
            where = f" in log {k + 1}" if len(logs) > 1 else ""
            if words and not all(silent):
                found.append(ChannelFault(i, False, f"channel {name} {words}{where}: wiring, or driver"))
            elif words and k == 0:
                found.append(ChannelFault(i, True, f"channel {name} {words}: wiring, or driver"))
            elif not words and (rail := _rail(log.raw[:, i])):
                words = f"channel {name} {rail}{where}: overload, or range of the driver"
                found.append(ChannelFault(i, False, words))
    return found


def motion_columns(log: Log) -> Iterator[tuple[str, Array]]:
    """Name and samples of every column of a log's motion, as logged."""
    twist = None if log.tracking is not None else log.twist
    for values, names in (
        (twist, ("vx", "vy", "vz", "wx", "wy", "wz")),
        (log.angular_velocity, ("wx", "wy", "wz")),
        (log.specific_force, ("accel_x", "accel_y", "accel_z")),
        (log.position, None),
        (log.velocity, None),
    ):
        if values is not None:
            prefix = "q" if values is log.position else "dq"
            for i, column in enumerate(values.T):
                yield (names[i] if names else f"{prefix} of joint {i + 1}"), column


def still_motion(logs: Sequence[Log]) -> list[str]:
    """What says in words that nothing moved: logs whose columns of motion all stay the same."""
    found = []
    for k, log in enumerate(logs):
        columns = [_silence(column) for _, column in motion_columns(log)]
        if columns and all(columns):
            where = f" in log {k + 1}" if len(logs) > 1 else ""
            found.append(f"nothing moved{where}: every column of the motion {columns[0]}")
    return found


def still_bases(logs: Sequence[Log]) -> list[str]:
    """A note on logs of joints that say nothing of their base."""
    silent = [
        log_name(logs, k)
        for k, log in enumerate(logs)
        if (log.position is not None or log.velocity is not None)
        and log.base_twist is None
        and log.base_attitude is None
    ]
    if not silent:
        return []
    where = f" in {', '.join(silent)}" if len(logs) > 1 else ""
    return [f"no columns base_vx ... base_wz{where}: the robot's base is taken to stand still"]


def _silence(values: Array) -> str:
    known = values[np.isfinite(values)]
    if known.size == 0:
        return "has no samples"
    if known.size >= FEWEST and known.min() == known.max():
        return f"is constant ({known[0]:.6g})"
    return ""


def _rail(values: Array) -> str:
    known = values[np.isfinite(values)]
    if known.size < FEWEST:
        return ""
    for sign in (1.0, -1.0):
        extreme = (sign * known).max() * sign
        at = known == extreme
        count = int(np.count_nonzero(at))
        if count < max(FEWEST, AT_RAIL * known.size) or _longest(at) < IN_A_ROW:
            continue
        _, counts = np.unique(sign * known, return_counts=True)
        near = counts[-1 - NEIGHBOURS : -1]
        if near.size > 0 and count >= PILED * near.max():
            share = 100.0 * count / known.size
            return f"stands at {extreme:.6g}, its extreme value, for {share:.2g} % of the samples"
    return ""


def _longest(at: Mask) -> int:
    """Most consecutive true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
