"""Live: samples corrected as they arrive, or a calibration made from them (docs/live.md)."""
