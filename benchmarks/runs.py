"""What the campaigns share: runs kept on disk and taken up again, and the errors of a calibration."""

from __future__ import annotations

import argparse
import hashlib
import json
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.stats import beta, chi2

import truewrench as tw
from truewrench import _core
from truewrench.campaign.trial import nees
from truewrench.campaign.workers import Lost, in_processes
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig

Array = NDArray[np.float64]
Row = dict[str, Any]

SAVE_EVERY = 30.0  # [s]
WITHIN_95 = 1.959964
SIX_SIGMA = 6.0
FIVE_SIGMA, SMALL = 5.0, 2e-3  # and of range: what is beyond both is wrong
TAIL = 1e-8  # of chi-square: a NEES beyond it is not chance


def arguments(description: str | None, *, runs: int) -> argparse.ArgumentParser:
    """The options that every campaign has."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=runs)
    parser.add_argument("--seed", type=int, default=0, help="of the campaign: others share no run")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument(
        "--out", type=Path, help="folder of rows (Parquet); runs found in it are not repeated"
    )
    return parser


def gather(
    function: Callable[[int], Row],
    indices: Sequence[int],
    out: Path | None,
    workers: int,
    settings: Any,
    seconds: float = 0.0,
) -> list[Row]:
    """Rows of `function(index)` in the order of the indices; on disk as they come, and from there if present.

    Args:
        function: picklable; a row is a flat mapping of numbers, words and lists of them.
        indices: of the runs.
        out: folder; None keeps nothing.
        workers: processes.
        settings: what the rows depend on beside index and code. Rows of other settings, or of another build
            of the package, stay in the folder and are not used.
        seconds: of processor time that a run may take, else it is a fault; 0: no limit.
    """
    rows: dict[int, Row] = {}
    key = hashlib.sha256(json.dumps([settings, build()], sort_keys=True, default=str).encode()).hexdigest()[
        :12
    ]
    path = None if out is None else out / f"rows-{key}.parquet"
    if path is not None and path.exists():
        rows = {row["index"]: json.loads(row["row"]) for row in pq.read_table(path).to_pylist()}
    saved = time.monotonic()
    missing = [i for i in indices if i not in rows]
    work = partial(_guarded, function, seconds)
    results = in_processes(work, missing, workers, attempts=1 if seconds else 2)
    for done, (index, row) in enumerate(results, 1):
        rows[index] = {"outcome": "fault", "reasons": [row.reason]} if isinstance(row, Lost) else row
        if path is not None and (done == len(missing) or time.monotonic() - saved > SAVE_EVERY):
            _save(path, rows)
            saved = time.monotonic()
    return [{"index": i, **rows[i]} for i in indices]


def _save(path: Path, rows: Mapping[int, Row]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # one column of text: the columns of a row depend on what happened in it
    table = pa.table({"index": list(rows), "row": [json.dumps(row) for row in rows.values()]})
    partial_file = path.with_suffix(".part")
    pq.write_table(table, partial_file)
    partial_file.replace(path)


def _guarded(function: Callable[[int], Row], seconds: float, index: int) -> Row:
    signal.setitimer(signal.ITIMER_PROF, seconds)  # ends the process: the core does not listen meanwhile
    try:
        return function(index)
    except Exception as error:  # any: a fault is a finding of the campaign, with its place
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return {"outcome": "fault", "reasons": [f"{type(error).__name__}: {error} ({where})"]}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def build() -> str:
    """Digest of the installed package, so that rows of two states of it are not mixed."""
    digest = hashlib.sha256()
    core = find_spec(f"truewrench._core_{_core.variant}")
    assert core is not None
    for path in [*sorted(Path(tw.__file__).parent.rglob("*.py")), Path(str(core.origin))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def calibrate_row(rig: Rig, logs: Log | Sequence[Log], gain: Array, **options: Any) -> Row:
    """A row that says what `calibrate` made of logs of known gain (n, 6)."""
    return calibrated(rig, logs, gain, **options)[0]


def calibrated(
    rig: Rig, logs: Log | Sequence[Log], gain: Array, **options: Any
) -> tuple[Row, Calibration | None]:
    """The same, with the calibration."""
    start = time.process_time()  # which other work on the machine does not change
    try:
        found = tw.calibrate(rig, logs, threads=1, **options)
    except InputError as error:
        return {"outcome": "refused", "usable": False, "reasons": list(error.problems)}, None
    seconds = time.process_time() - start
    used, total = 0, 0
    for report in found.logs:
        used += report.used
        total += report.used + sum(report.rejected.values()) + sum(report.masked.values())
    figures = found.figures
    return {
        "outcome": "calibrated",
        "usable": found.verdict.usable,
        "reasons": list(found.verdict.reasons),
        "seconds": seconds,
        "used": used / max(1, total),
        "knot_spacing": figures.get("knot_spacing"),
        "iterations": figures.get("iterations"),
        **score(found, gain),
    }, found


def score(found: Calibration, gain: Array) -> Row:
    """Error of a calibration against the true gain (n, 6), in normalised units."""
    sensor = found.rig.sensor
    unit = (sensor.range_array / sensor.channel_scale[:, None]).ravel()
    error = (found.gain - gain).ravel() * unit
    covariance = found.covariance[: unit.size, : unit.size] * np.outer(unit, unit)
    std = np.sqrt(np.diag(covariance))
    squared, freedom = nees(error, covariance)
    deviation = np.abs(error) / std
    log_tail = float(chi2.logsf(squared, max(1, freedom))) if np.isfinite(squared) else -np.inf
    wrong = bool(deviation.max() > SIX_SIGMA or log_tail < np.log(TAIL))
    return {
        "rms": float(np.sqrt(np.mean(error**2))),
        "stated": float(np.sqrt(np.mean(std**2))),
        "nees": float(squared / max(1, freedom)),
        "largest_deviation": float(deviation.max()),
        "log10_tail": max(-1e6, log_tail / np.log(10.0)),
        "covered": float(np.mean(deviation <= WITHIN_95)),
        "wrong": wrong,
        "beyond": bool(np.any((deviation > FIVE_SIGMA) & (np.abs(error) > SMALL))),
        "wrong_and_confident": wrong and found.verdict.usable,
    }


def interval(count: float, total: int) -> str:
    """A rate and its 95% interval (Clopper and Pearson)."""
    if not total:
        return "-"
    low = beta.ppf(0.025, count, total - count + 1) if count > 0 else 0.0
    high = beta.ppf(0.975, count + 1, total - count) if count < total else 1.0
    return f"{100 * count / total:.1f}% [{100 * low:.1f}, {100 * high:.1f}]"


REASONS = (
    ("could not be solved", "not solved"),
    ("is not resolved", "not resolved"),
    ("were left out as", "too many left out"),
    ("parts of the record disagree", "parts disagree"),
    ("nothing was learnt", "nothing learnt"),
    ("singular", "singular"),
    ("accuracy", "accuracy"),
    ("suspected set-up error", "suspected set-up error"),
)


def kind_of(reason: str) -> str:
    """A reason of a verdict in two words, for counting."""
    return next((short for text, short in REASONS if text in reason), reason[:60])


def reasons_of(rows: Iterable[Row]) -> Counter[str]:
    """How many rows give each kind of reason."""
    return Counter(kind for row in rows for kind in {kind_of(r) for r in row["reasons"]})


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a markdown table."""
    print("| " + " | ".join(header) + " |\n|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(str(cell) for cell in row) + " |")
