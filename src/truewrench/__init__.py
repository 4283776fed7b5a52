"""Recalibrate a robot's six-axis force/torque sensor in place, from the motion of a known payload."""
