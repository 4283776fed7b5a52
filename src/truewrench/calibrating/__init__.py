"""From rig and logs to a calibration and its verdict: the stages in their order."""
