"""The true wrench of a log as a recording, beside what the sensor said and what the motion predicts."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from truewrench.correction.apply import Applied, Run
from truewrench.estimation.inertial import InertialMotion
from truewrench.io.recordings.writer import mcap_output
from truewrench.io.tables import named_payload, read_log
from truewrench.judging.validation.errors import carried
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.repeats import without_repeats
from truewrench.model.split import rows_of

RAW = "/truewrench/raw"
CORRECTED = "/truewrench/corrected"
STD = "/truewrench/corrected_std"
PREDICTED = "/truewrench/predicted"

_ROWS = 40_000  # of a log that are predicted at once
_EDGE = 4.0  # times the usual variance: ends of splines, not written


def apply_to_recording(
    calibration: Calibration,
    log: str | Path,
    output: str | Path,
    *,
    predict: bool = True,
    progress: Callable[[int], object] | None = None,
    max_rows: int | None = None,
) -> Applied:
    """Write the raw channels, the true wrench, its 1 sigma and the payload's wrench by the motion as MCAP.

    Raw channels are wrenches where there are six of them, otherwise arrays. The prediction comes from the
    motion alone, with the payload (`LOG@PAYLOAD` where there are several) as it was found, else as the rig
    states it; where motion or payload is not known, it is left out, and a note says why. Without it, memory
    does not grow with the log. The output appears whole or not at all; `progress` is told the number of rows
    done so far. `max_rows` is that of `read_log`.
    """
    rig = calibration.rig
    run = Run(calibration, named_payload(log, rig)[0], output, progress, max_rows)
    notes: tuple[str, ...] = ()
    predicted_time, predicted = np.empty(0, dtype=np.int64), np.empty((0, 6))
    if predict:
        try:
            predicted_time, predicted = _predicted(calibration, read_log(log, rig, max_rows=max_rows))
        except InputError as error:
            notes = (f"no {PREDICTED}: {error}",)
    frame = rig.motion.robot.sensor_frame if rig.motion.robot is not None else "sensor"
    done = 0
    with mcap_output(output, frame) as writer:
        for time, raw, new in run.samples():
            write_raw = writer.wrenches if raw.shape[1] == 6 else writer.arrays
            write_raw(RAW, time, raw)
            writer.wrenches(CORRECTED, time, new[:, :6])
            writer.wrenches(STD, time, new[:, 6:])
            until = int(np.searchsorted(predicted_time, time[-1], side="right")) if len(time) else done
            if until > done:
                writer.wrenches(PREDICTED, predicted_time[done:until], predicted[done:until])
                done = until
    return replace(run.applied, notes=(*run.applied.notes, *notes))


def _predicted(calibration: Calibration, log: Log) -> tuple[Integers, Array]:
    """Stamps (M,) and wrenches (M, 6) where the motion tells the acceleration."""
    rig, body = calibration.rig, carried(calibration, calibration.rig, log.payload).body
    log.check_sizes()
    log = without_repeats(log)
    times, wrenches = [np.empty(0, dtype=np.int64)], [np.empty((0, 6))]
    margin = _ROWS // 10  # where parts meet, neither ends
    for start in range(0, len(log.time_ns), _ROWS):
        first, end = max(0, start - margin), start + _ROWS
        rows = np.zeros(len(log.time_ns), dtype=bool)
        rows[first : end + margin] = True
        part = rows_of(log, rows)
        chunks = InertialMotion(rig, part, body).wrench(calibration.time_offset, 0)
        if not chunks:
            continue
        usual = np.median(np.concatenate([chunk.variance for chunk in chunks]), axis=0)
        for chunk in chunks:
            inside = (chunk.variance <= _EDGE * usual).all(axis=1)
            inside &= (chunk.rows >= start - first) & (chunk.rows < end - first)
            times.append(part.time_ns[chunk.rows[inside]])
            wrenches.append(chunk.wrench[inside])
    if len(times) == 1:
        raise InputError.at(
            log.path, "", "no stretch of motion and raw channels", "at least some tenths of a second"
        )
    time = np.concatenate(times)
    return time, np.concatenate(wrenches)
