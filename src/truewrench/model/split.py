"""A part of the record held out of a calibration, to judge it by."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.model.errors import InputError
from truewrench.model.log import Log

SHORTEST = 100  # rows of a piece of a held-out log


def held_out(logs: Sequence[Log], fraction: float = 0.2, blocks: int = 4) -> tuple[list[Log], list[Log]]:
    """Split logs into a part to calibrate with and, one per log that was split, a part to validate by.

    Blocks of time are held out, not single rows: neighbours know too much of each other. They are spread over
    every log, so that what moves late is in both parts. A log too short to be split is calibrated with whole;
    there are fewer blocks where they would become shorter than 2 s or 200 rows.
    """
    if not 0.0 < fraction < 1.0:
        raise InputError.at(None, "fraction", f"{fraction:g}", "a number between 0 and 1")
    kept, out = [], []
    for log in logs:
        rows = np.arange(len(log.time_ns))
        duration = log.time[-1] if len(rows) else 0.0
        possible = int(min(fraction * duration / 2.0, fraction * len(rows) / 200.0))
        count = min(blocks, possible)
        if count == 0:
            kept.append(log)
            continue
        phase = log.time / duration * count % 1.0  # of each of `count` equal parts, the middle is held out
        chosen = np.abs(phase - 0.5) < 0.5 * fraction
        # a part has no hash: it is not the file
        kept.append(replace(rows_of(log, ~chosen), sha256=""))
        out.append(replace(rows_of(log, chosen), sha256="", nan_counts={}, dropped_rows=0))
    return kept, out


def between_jumps(log: Log) -> list[Log]:
    """A log cut where its offset begins anew, without what is shorter than a validation can use."""
    if not log.offset_jumps_ns:
        return [log]
    piece = np.searchsorted(np.array(log.offset_jumps_ns), log.time_ns, side="right")
    pieces = [rows_of(log, piece == k) for k in np.unique(piece) if np.count_nonzero(piece == k) >= SHORTEST]
    return [replace(part, offset_jumps_ns=()) for part in pieces]


def rows_of(log: Log, rows: Mask | slice) -> Log:
    """The log with some of its rows; views of those of a slice."""

    def pick(values: Array | None) -> Array | None:
        return None if values is None else values[rows]

    tracking = log.tracking
    if tracking is not None:
        tracking = replace(
            tracking,
            jacobian=tracking.jacobian[rows],
            jacobian_rate=pick(tracking.jacobian_rate),
            position_departure=pick(tracking.position_departure),
            position_sigma=pick(tracking.position_sigma),
            velocity_departure=pick(tracking.velocity_departure),
        )
    return replace(
        log,
        time_ns=log.time_ns[rows],
        raw=log.raw[rows],
        twist=pick(log.twist),
        angular_velocity=pick(log.angular_velocity),
        gravity=pick(log.gravity),
        attitude=pick(log.attitude),
        acceleration=pick(log.acceleration),
        specific_force=pick(log.specific_force),
        temperature=pick(log.temperature),
        reference=pick(log.reference),
        position=pick(log.position),
        velocity=pick(log.velocity),
        base_twist=pick(log.base_twist),
        base_attitude=pick(log.base_attitude),
        tracking=tracking,
    )
