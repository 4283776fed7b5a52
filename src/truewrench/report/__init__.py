"""A calibration for a person: the page (docs/report.md), its pictures, and words for a terminal."""
