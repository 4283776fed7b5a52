"""The arm between root and sensor: kinematics, a joint log as a motion, attitude, a subtracted weight."""
