"""Motions that calibrate well within the limits of a rig, and what they promise (docs/method.md)."""
