"""The whole chain in independent physics: an arm in MuJoCo follows a plan, and its log is recorded.

What is modelled and what is checked: docs/method.md, "The simulated arm".
"""

from truewrench.simulation.arm.run import ArmRun, simulate_arm, simulate_plan

__all__ = ["ArmRun", "simulate_arm", "simulate_plan"]
