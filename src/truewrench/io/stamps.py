"""Stamps of receipt: samples that travel in packets have those of their packets, not their own.

A serial adapter that waits 16 ms hands over sixteen samples of a sensor of 1 kHz at once. They were taken
evenly all the same, the last of a packet when it left; what the transport takes is a constant delay, which
the estimate finds.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.model.arrays import Array, Integers, Mask

APART = _core.PACKETS_APART  # [ns] between packets at most: what is silent for longer is a gap
CLOSE = _core.PACKETS_CLOSE  # of the mean interval, below which two samples came together

SHARE = _core.PACKETS_SHARE
"""Of the intervals that are so short, from which on samples come in packets, of two and more: stamps that
scatter by the period itself have 0.1."""

FEWEST = 8  # packets
SAMPLES = _core.PACKETS_LEARNED  # of a piece, below which nothing is done
WAITED = 4  # intervals in a row that are so short, in a stream that comes one by one: of a stall

LOST = 0.5
"""Of a packet's time, by which one and those after it come later than their samples say: another was lost."""


def with_even_stamps(
    time_ns: Integers, columns: dict[str, Array]
) -> tuple[Integers, dict[str, Array], tuple[str, ...]]:
    """A table in which the samples of each stream that comes in packets are spaced evenly.

    Stamps (N,) increase [ns]; columns (N,) are NaN where there is no sample; those that share half of their
    rows are one stream. The same ones come back, and nothing is said of it, where no stream comes in packets.
    """
    rows, of = _streams(columns.values())
    even = [in_packets(time_ns[at]) for at in rows]
    if all(found is None for found in even):
        return time_ns, columns, ()
    stamps = [time_ns[at] if found is None else found for at, found in zip(rows, even, strict=True)]
    merged = np.unique(np.concatenate(stamps))
    out = {}
    for (name, values), i in zip(columns.items(), of, strict=True):
        out[name] = np.full(merged.size, np.nan)
        out[name][np.searchsorted(merged, stamps[i])] = values[rows[i]]
    notes = [_said(i, list(columns), of, found) for i, found in enumerate(even) if found is not None]
    return merged, out, tuple(notes)


def _said(stream: int, columns: Sequence[str], of: Sequence[int], even: Integers) -> str:
    names = [name for name, i in zip(columns, of, strict=True) if i == stream]
    told = ", ".join(names if len(names) < 3 else [names[0], "...", names[-1]])
    period = 1e-6 * float(np.median(np.diff(even)))
    return f"{told}: samples come in packets, stamped on receipt; those taken as {period:.3g} ms apart"


def in_packets(time_ns: Integers) -> Integers | None:
    """Even stamps (N,) of samples that came in packets; None where they did not, or hardly."""
    out, found = time_ns.copy(), False
    cuts = np.flatnonzero(np.diff(time_ns) > APART) + 1
    for piece in np.split(np.arange(time_ns.size), cuts):
        if piece.size >= SAMPLES and (even := _even(time_ns[piece])) is not None:
            out[piece], found = even, True
    return out if found and (np.diff(out) > 0).all() else None


def _even(time_ns: Integers) -> Integers | None:
    """Of samples without a gap: a line from one place where a packet was lost to the next."""
    steps = np.diff(time_ns)
    together = steps < CLOSE * (time_ns[-1] - time_ns[0]) / steps.size
    last = np.append(np.flatnonzero(~together), time_ns.size - 1)  # of each packet
    time = (time_ns - time_ns[0]).astype(np.float64)
    if np.mean(together) < SHARE or last.size < FEWEST:
        return _after_stalls(time_ns, together)
    size, lasted = np.diff(last), np.diff(time[last])
    period, packet = float(np.median(lasted / size)), float(np.median(lasted))
    late = time[last] - period * last
    scatter = 1.48 * float(np.median(np.abs(np.diff(late))))
    jump = max(LOST * packet, 3.0 * scatter)
    lost = [
        k
        for k in np.flatnonzero(lasted - period * size > LOST * packet) + 1
        if k + FEWEST // 2 <= last.size
        and np.median(late[k : k + FEWEST]) - np.median(late[max(k - FEWEST, 0) : k]) > jump
    ]
    parts = np.split(last, lost)
    begins = [0, *(int(part[-1]) + 1 for part in parts[:-1])]
    even = [_line(time, begin, part, period, jump) for begin, part in zip(begins, parts, strict=True)]
    return np.asarray(time_ns[0] + np.rint(np.concatenate(even)).astype(np.int64))


def _after_stalls(time_ns: Integers, together: Mask) -> Integers | None:
    """With samples that waited, several at once, spread over the time in which nothing came."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], together.astype(int), [0]])))
    waited = [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= WAITED]
    if not waited or together.all():
        return None
    out, period = time_ns.copy(), float(np.median(np.diff(time_ns)[~together]))
    for first, last in waited:
        later = np.arange(last - first, -1, -1)  # samples
        back = period * later
        if first > 0:
            silent = float(time_ns[last] - time_ns[first - 1])
            back = np.minimum(back, silent * later / (last - first + 1))
        out[first : last + 1] = time_ns[last] - np.rint(back).astype(np.int64)
    return out


def _line(time: Array, begin: int, last: NDArray[np.intp], period: float, apart: float) -> Array:
    """Times of the samples from `begin` to the last: on the line through the last ones of their packets.

    Where these lie further apart from it, as the clock was set, or few are left: packet by packet.
    """
    index = np.arange(begin, last[-1] + 1)
    if last.size >= FEWEST:
        slope, start = np.polyfit(last, time[last], 1)
        if np.quantile(np.abs(start + slope * last - time[last]), 0.9) < apart:
            return np.asarray(start + slope * index)
    last = np.append(begin - 1, last)
    ends = np.append(time[last[1]] - period * (last[1] - last[0]), time[last[1:]])
    return np.asarray(np.interp(index, last, ends))


def _streams(columns: Iterable[Array]) -> tuple[list[NDArray[np.intp]], list[int]]:
    """Rows of every stream, and which one each column is of."""
    known: list[Mask] = []
    of = []
    for column in columns:
        here = np.isfinite(column)
        shared = (i for i, rows in enumerate(known) if 2 * np.sum(here & rows) >= np.sum(here))
        stream = next(shared, len(known))
        if stream == len(known):
            known.append(here)
        known[stream] |= here
        of.append(stream)
    return [np.flatnonzero(rows) for rows in known], of
