"""What campaigns share whose records stand beside a twin, the same log without what disturbs it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import imperfect
import numpy as np
import runs
from imperfect import Row

import truewrench as tw
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.truth import Truth


def recorded(rng: np.random.Generator, motion: str, longer: float = 0.0) -> tuple[Rig, Log, Truth]:
    """A problem of imperfect.py on perfect hardware, so many seconds longer."""
    settings, path = imperfect.settings_of(rng, motion, bool(rng.uniform() < 0.5), 6)
    settings["plan"]["duration"] += longer
    trajectory = imperfect.motion_of(rng, motion, settings["plan"]["duration"])
    rig = tw.Rig.from_mapping(settings, path)
    simulate = tw.simulate if motion != "joints" else tw.simulate_arm
    run = simulate(rig, trajectory, seed=int(rng.integers(2**31)))
    log = run.log if motion != "joints" else replace(run.log, twist=None, gravity=None, tracking=None)
    return rig, log, run.truth


def compared(rig: Rig, disturbed: Log, twin: Log, truth: Truth) -> Row:
    """What `calibrate` makes of a log, and of its twin (`twin_...`); wrong is what imperfect.py calls so."""
    row: Row = {}
    for prefix, of in (("", disturbed), ("twin_", twin)):
        found, calibration = runs.calibrated(rig, of, truth.gain, held_out=False)
        if calibration is not None:
            found["wrong"] = found["beyond"]
        row |= {prefix + key: value for key, value in found.items()}
    return row


def table(first: str, groups: Sequence[tuple[str, Sequence[Row]]]) -> None:
    """Print what became of groups of rows."""
    header = (
        first,
        "runs",
        "usable",
        "usable and wrong",
        "coverage",
        "NEES/36, median",
        "time over the twin's",
    )
    runs.table(header, [_line(name, rows) for name, rows in groups])


def _line(name: str, rows: Sequence[Row]) -> list[str]:
    done = [r for r in rows if r["outcome"] == "calibrated" and r["twin_outcome"] == "calibrated"]
    twins = [r for r in done if r["twin_usable"]]
    usable = [r for r in twins if r["usable"]]
    wrong = sum(bool(r["usable"] and r["wrong"]) for r in done)
    ratio = [r["seconds"] / r["twin_seconds"] for r in done]
    return [
        name,
        str(len(rows)),
        runs.interval(len(usable), len(twins)),
        str(wrong),
        f"{np.mean([r['covered'] for r in usable]):.3f}" if usable else "-",
        f"{np.median([r['nees'] for r in usable]):.2f}" if usable else "-",
        f"{np.median(ratio):.1f}, {np.max(ratio):.0f}" if ratio else "-",
    ]
