"""report.html: one file that shows a calibration to a person, with its verdict first (docs/report.md)."""

from __future__ import annotations

from pathlib import Path

from truewrench.estimation.evidence import Evidence
from truewrench.model.calibration import Calibration
from truewrench.model.files import atomic_output
from truewrench.report.page import page

__all__ = ["write_report"]


def write_report(path: str | Path, calibration: Calibration, evidence: Evidence) -> None:
    """Write the report of a calibration; the file appears whole or not at all."""
    text = page(calibration, evidence)
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
