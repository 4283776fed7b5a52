"""Estimators of the gain: windows of motion, and the references they are compared with."""
