"""Many simulated calibrations of one rig: whether the estimator keeps what it states (docs/formats.md)."""
