"""Estimates, what none of them can beat, and what none of them can see (docs/method.md)."""
