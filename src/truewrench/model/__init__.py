"""What people state and what they get, frozen and validated: rig, log, payload, calibration."""
