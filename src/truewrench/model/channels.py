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
MOST_RANGES = 3.0  # times its range that a sensor reads in 1% of its samples: tolerance


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
    found = Rail()
    found.add(values)
    return found.words


class Rail:
    """Whether a channel stands at a rail, from its samples part by part, in constant memory."""

    def __init__(self) -> None:
        self._samples = 0
        self._top: dict[float, dict[float, int]] = {
            1.0: {},
            -1.0: {},
        }  # by sign: extreme values and how often
        self._in_a_row = {1.0: 0, -1.0: 0}

    def add(self, values: Array) -> None:
        """Samples (N,) that follow those before; NaN: none."""
        known = values[np.isfinite(values)]
        self._samples += known.size
        if known.size == 0:
            return
        distinct, counts = np.unique(known, return_counts=True)
        for sign, top in self._top.items():
            last = float(max(top, key=lambda x: sign * x)) if top else -sign * np.inf
            extreme = float(distinct[-1] if sign > 0.0 else distinct[0])
            if sign * extreme >= sign * last:
                row = _longest(known == extreme)
                self._in_a_row[sign] = max(row, self._in_a_row[sign] if extreme == last else 0)
            part = slice(-1 - NEIGHBOURS, None) if sign > 0.0 else slice(0, 1 + NEIGHBOURS)
            for value, count in zip(distinct[part].tolist(), counts[part].tolist(), strict=True):
                top[value] = top.get(value, 0) + count
            for value in sorted(top, key=lambda x: sign * x)[: -1 - NEIGHBOURS]:
                del top[value]  # of which no later part can make one of the most extreme

    @property
    def words(self) -> str:
        """What a person reads; nothing where it does not."""
        for sign, top in self._top.items():
            if not top:
                continue
            extreme, *near = sorted(top, key=lambda x: -sign * x)
            count = top[extreme]
            few = count < max(FEWEST, AT_RAIL * self._samples) or self._in_a_row[sign] < IN_A_ROW
            if not few and near and count >= PILED * max(top[value] for value in near):
                share = 100.0 * count / self._samples
                return f"stands at {extreme:.6g}, its extreme value, for {share:.2g} % of the samples"
        return ""


class Rails:
    """The rails of all channels of a log that is read part by part, and readings beyond all ranges."""

    def __init__(self, rig: Rig) -> None:
        self._of = {name: Rail() for name in rig.sensor.channels}
        self._scale = rig.sensor.channel_scale
        self._samples, self._beyond = 0, np.zeros(rig.sensor.n, dtype=np.int64)

    def add(self, raw: Array) -> None:
        """Samples (N, n)."""
        self._samples += len(raw)
        self._beyond += np.count_nonzero(np.abs(raw) > MOST_RANGES * self._scale, axis=0)
        for rail, column in zip(self._of.values(), raw.T, strict=True):
            rail.add(column)

    @property
    def notes(self) -> tuple[str, ...]:
        """Of channels that stand at a rail, or read what no sensor of this range does."""
        far = [
            f"{beyond_range(name)} in {100.0 * count / self._samples:.2g}% of the samples"
            for name, count in zip(self._of, self._beyond.tolist(), strict=True)
            if count > 0.01 * self._samples
        ]
        return *far, *(
            f"channel {name} {rail.words}: overload, or range of the driver; no wrench is right there"
            for name, rail in self._of.items()
            if rail.words
        )


class Ranges:
    """Says once, of samples as they come, that one is beyond what any sensor of this range reads."""

    def __init__(self, rig: Rig) -> None:
        self._names = rig.sensor.channels
        self._most = MOST_RANGES * rig.sensor.channel_scale
        self._silent = False

    def told(self, raw: Array) -> str:
        """What to say after this sample (n,); mostly nothing."""
        if self._silent or not (far := np.abs(raw) > self._most).any():
            return ""
        self._silent = True
        return f"{beyond_range(self._names[int(np.argmax(far))])}; told once"


def beyond_range(channel: str) -> str:
    """What is said of a reading that no sensor of this range has."""
    return f"channel {channel} is beyond {MOST_RANGES:g} times its range (other units than the rig's?)"


def _longest(at: Mask) -> int:
    """Most consecutive true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
