"""Logs with known truth: a free-flying body, an arm in MuJoCo, imperfect hardware, and the truth of a log.

It computes wrenches by equations of its own, so that a mistake in the estimator's shows as a disagreement.
"""
