"""Joint-velocity servos that make the arm follow a motion, integrated with errors far below any noise.

Every joint has the cascade of an industrial drive: position error -> velocity command -> torque, the latter
proportional and integral. The command is a continuous function of time, evaluated inside the stages of an
explicit Runge-Kutta method (of order 8, steps by its own error). Held over a step it would be a sawtooth, of
which the sensor sees the peaks and the velocities the mean; and MuJoCo's implicit integrators would report
the forces of another acceleration than the one they integrate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.linalg import eigh

from truewrench.model.arrays import Array, Integers
from truewrench.model.motion.trajectory_joint import JointTrajectory
from truewrench.simulation.arm.model import Arm, Reading

_FASTER = 40.0  # velocity loop, in units of the motion's own frequency
_BANDWIDTH = (5.0, 100.0)  # of the velocity loop, at least and at most [rad/s]
_POSITION, _INTEGRAL = 0.15, 0.25  # outer loop and integral part, in units of the velocity loop
_SET_POINTS = (
    2.5  # [Hz] per rad/s of the velocity loop: of the plan, between which drives interpolate smoothly
)
# Inertia of the rotor behind the gear, relative to what the joint moves. URDFs do not tell it. Without it the
# servos of near-parallel joints would be as stiff as the inertia matrix is near-singular.
_ROTOR = 1.0
_DEGREE = 5  # of the interpolation
_POSTURES = 50  # along the motion, at which the inertias are asked for
_TOLERANCE = 1e-9  # of a step, relative to the state
_STEP = 1.0  # at most, in units of the servos' fastest settling time: far inside what is stable


@dataclass(frozen=True, slots=True)
class Servo:
    """Torque = gain (e + integral * (its integral)), e = planned velocity + position * (error) - velocity."""

    gain: Array  # (n,) [N m s/rad]
    position: float  # of the outer loop [1/s]
    integral: float  # [1/s]
    set_points: float  # [Hz] of the plan
    fastest: float  # rate at which the stiffest combination of joints settles [1/s]


@dataclass(frozen=True, slots=True)
class Driven:
    """The motion that the servos made, at the times that were asked for."""

    position: Array  # (N, n) [rad, m]
    velocity: Array  # (N, n)
    torque: Array  # (N, n) of the drives [N m, N]
    reading: Reading  # of ideal sensors

    def at(self, rows: Integers) -> Driven:
        """Some of the rows."""
        return Driven(self.position[rows], self.velocity[rows], self.torque[rows], self.reading.at(rows))


def servo_for(arm: Arm, trajectory: JointTrajectory) -> Servo:
    """A servo that is fast enough for a motion, at the largest inertia that each joint sees along it.

    The rotors are set in the arm's model.
    """
    time = np.linspace(0.0, trajectory.duration, _POSTURES)
    arm.model.dof_armature[:] = 0.0
    inertias = np.array([arm.inertia(q) for q in trajectory.position(time)])
    rotors = _ROTOR * np.diagonal(inertias, axis1=1, axis2=2).max(axis=0)
    arm.model.dof_armature[:] = rotors
    bandwidth = float(np.clip(_FASTER * _frequency(trajectory), *_BANDWIDTH))
    gain = bandwidth * (1.0 + 1.0 / _ROTOR) * rotors
    fastest = max(float(eigh(np.diag(gain), m + np.diag(rotors), eigvals_only=True)[-1]) for m in inertias)
    return Servo(gain, _POSITION * bandwidth, _INTEGRAL * bandwidth, _SET_POINTS * bandwidth, fastest)


def _frequency(trajectory: JointTrajectory) -> float:
    """RMS acceleration over RMS velocity of the fastest joint [rad/s]; infinite when all are at rest."""
    time = np.linspace(0.0, trajectory.duration, 1000)
    velocity, acceleration = (
        np.sqrt(np.mean(values**2, axis=0))
        for values in (trajectory.velocity(time), trajectory.acceleration(time))
    )
    moving = velocity > 1e-3 * velocity.max(initial=1e-12)
    return float(np.max(acceleration[moving] / velocity[moving])) if moving.any() else np.inf


def drive(arm: Arm, servo: Servo, trajectory: JointTrajectory, time: Array) -> Driven:
    """Follow a motion from its first position and velocity on, the integrators holding the arm's weight.

    Times (N,) are increasing, within [0, duration] [s].
    """
    n, data = arm.n, mujoco.MjData(arm.model)
    q0 = trajectory.position(np.zeros(1))[0]
    qd0 = trajectory.velocity(np.zeros(1))[0]
    held = arm.holding_torque(q0) / (servo.gain * servo.integral)

    command = _Command(servo, trajectory)

    def apply(t: float, state: Array) -> Array:
        """Put state and torques into MuJoCo; returns the errors of the velocities (n,)."""
        q, qd = state[:n], state[n : 2 * n]
        error: Array = command(t) - servo.position * q - qd
        data.qpos[:], data.qvel[:] = q, qd
        data.qfrc_applied[:] = servo.gain * (error + servo.integral * state[2 * n :])
        return error

    def rate(t: float, state: Array) -> Array:
        error = apply(t, state)
        mujoco.mj_forwardSkip(arm.model, data, mujoco.mjtStage.mjSTAGE_NONE, True)
        return np.concatenate([state[n : 2 * n], data.qacc, error])

    states = _integrate(rate, np.concatenate([q0, qd0, held]), time, _STEP / servo.fastest)
    torques, rows = np.empty((time.size, n)), []
    for k, (t, state) in enumerate(zip(time, states, strict=True)):
        apply(float(t), state)
        mujoco.mj_forward(arm.model, data)
        torques[k] = data.qfrc_applied
        rows.append(arm.read(data))
    return Driven(states[:, :n], states[:, n : 2 * n], torques, arm.reading(np.array(rows)))


class _Command:
    """Planned velocity plus the outer loop's share of the planned position, (n,) at any time."""

    def __init__(self, servo: Servo, trajectory: JointTrajectory) -> None:
        count = max(_DEGREE + 1, 1 + math.ceil(trajectory.duration * servo.set_points))
        time = np.linspace(0.0, trajectory.duration, count)
        planned = trajectory.velocity(time) + servo.position * trajectory.position(time)
        spline = make_interp_spline(time, planned, k=_DEGREE)  # its knots are among these times
        orders = range(_DEGREE, -1, -1)
        self._step, self._last, self._powers = time[1], count - 2, np.arange(_DEGREE, -1, -1)
        self._coefficients = np.stack([spline(time[:-1], nu=m) / math.factorial(m) for m in orders], axis=1)

    def __call__(self, t: float) -> Array:
        # by hand: it is asked for in every stage of every step, one time at a time
        piece = min(int(t / self._step), self._last)
        return np.asarray((t - piece * self._step) ** self._powers @ self._coefficients[piece])


def _integrate(rate: Callable[[float, Array], Array], start: Array, time: Array, longest: float) -> Array:
    """States (N, k) at increasing times of `dx/dt = rate(t, x)` from time 0."""
    if time[-1] == 0.0:
        return start[None]
    ends = (0.0, float(time[-1]))
    found = solve_ivp(rate, ends, start, "DOP853", time, max_step=longest, rtol=_TOLERANCE, atol=_TOLERANCE)
    if not found.success:
        raise RuntimeError(f"the arm's motion could not be integrated: {found.message}")
    return np.ascontiguousarray(found.y.T)
