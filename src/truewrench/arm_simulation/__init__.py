"""The whole chain in independent physics: an arm in MuJoCo follows a plan, and its log is recorded.

docs/method.md, section 16, says what is modelled and what is checked.
"""

from truewrench.arm_simulation.run import ArmRun, simulate_arm, simulate_plan

__all__ = ["ArmRun", "simulate_arm", "simulate_plan"]
