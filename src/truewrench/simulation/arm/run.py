"""A log with known truth from an arm that MuJoCo moves: plan -> servos -> sensors -> columns."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from truewrench.io.plans import read_joint_plan
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import Body
from truewrench.model.motion.trajectory_joint import JointTrajectory
from truewrench.model.rig import Rig
from truewrench.robot.arm import Robot, robot_of
from truewrench.robot.track import track
from truewrench.simulation.arm.drive import Driven, drive, servo_for
from truewrench.simulation.arm.model import Arm, Reading, arm_of
from truewrench.simulation.arm.motion import default_motion
from truewrench.simulation.free_body import wrench_on_sensor
from truewrench.simulation.imperfect import FineMotion, Hardware, Readout
from truewrench.simulation.truth import Stamps, Truth, begin, noise_of, readings, stamps_of, stated, write_run

_AGREEMENT = 1e-6  # of the recorded wrench with Newton and Euler, relative to the largest
_CHECKED = 200  # samples of the sensor
_SPACING = 1e-3  # [s] of the recorded twists that are differentiated there
_STENCIL = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0  # of the polynomial through seven
_LEAST_WRENCH = 1e-4  # of range: below it, agreement is not asked for relative to the wrench
_OVER = 1e-3  # of a joint's range, forgiven to a plan


@dataclass(frozen=True, slots=True)
class Moved:
    """What the arm did: everything of a run that neither gain nor noise decides."""

    stamps: Stamps  # of the log
    joints: Driven  # positions, velocities and torques at `read`, with the readings of ideal sensors
    wrench: Array  # (M, 6) of the payload on the sensor at `shown`, sensor axes
    disagreement: float  # largest, relative, of the recorded wrench and Newton-Euler on the recorded twist
    hardware: Hardware | None = None  # that reads all this; perfect where there is none
    fine: FineMotion | None = None  # the run between the samples, where the hardware needs it

    @property
    def shown(self) -> Array:
        """(M,) times that the sensor's samples show [s]: ``stamps.shown`` but for jitter."""
        shown = self.stamps.shown
        return shown if self.hardware is None else self.hardware.read_at(shown, "sensor")

    @property
    def read(self) -> Array:
        """(K,) times at which the joints were read [s]: those of ``stamps.motion_ns`` but for jitter."""
        read = self.stamps.motion
        return read if self.hardware is None else self.hardware.read_at(read, "motion")

    def readout(self, gain: Array) -> Readout:
        """What the hardware makes of it, with a gain (n, 6)."""
        if self.hardware is None or self.fine is None:
            return Readout()
        return self.hardware.readout(gain, self.fine, self.shown, self.read)


@dataclass(frozen=True, slots=True)
class ArmRun:
    """A log, the truth it was made with, the plan behind it and what the arm made of it."""

    log: Log
    truth: Truth
    trajectory: JointTrajectory
    moved: Moved
    joints: tuple[str, ...]

    def write(self, path: str | Path) -> tuple[Path, Path]:
        """Write the log (CSV, or Parquet by its suffix) and PATH.truth.yaml beside it; return both paths."""
        return write_run(path, self.log, self.truth, self.joints)

    def figures(self) -> dict[str, float]:
        """How closely the servos follow, and whether wrench and motion of the record belong together."""
        joints, time = self.moved.joints, self.moved.read
        return {
            "tracking_error_position": float(np.abs(joints.position - self.trajectory.position(time)).max()),
            "tracking_error_velocity": float(np.abs(joints.velocity - self.trajectory.velocity(time)).max()),
            "newton_euler_disagreement": self.moved.disagreement,
        }


def simulate_arm(
    rig: Rig,
    trajectory: JointTrajectory | None = None,
    *,
    payload: str | None = None,
    seed: int | None = None,
) -> ArmRun:
    """Simulate the log of a joint rig whose arm follows a plan, by the options of ``rig.simulate``.

    Args:
        rig: the rig; robot, noise, signs and gravity are its own. The base is fixed.
        trajectory: planned joints, in the order of the chain; `default_motion` if left out.
        payload: name of the payload that is carried; the first of the rig if left out.
        seed: of every random draw; ``rig.simulate.seed`` if left out.

    The sensor sample stamped t shows the motion at ``t + time_offset``.

    Raises:
        UnsupportedError: for a twist rig or a sensor with a filter of its own that is not simulated.
        InputError: for a payload that the rig does not have, a plan beyond the joints' ranges, or an
            imperfection that the motion cannot have.
        RuntimeError: if what MuJoCo reports breaks Newton's and Euler's laws.
    """
    if rig.motion.source != "joints":
        expected = "`joints`: twists are simulated by `simulate`"
        raise UnsupportedError.at(rig.path, "motion.source", rig.motion.source, expected)
    name, truth = begin(rig, payload, seed)
    robot = robot_of(rig)
    if trajectory is None:
        trajectory = default_joints(rig)
    moved = move(rig, robot, trajectory, truth.payloads[name], truth.time_offset, truth.seed)
    readout = moved.readout(truth.gain)
    log = record(rig, name, truth, moved, readout)
    return ArmRun(log, replace(truth, imperfections=readout.told), trajectory, moved, robot.joints)


def default_joints(rig: Rig) -> JointTrajectory:
    """The motion of an arm without a plan: `default_motion` with each of the rig's payloads."""
    robot = robot_of(rig)
    arms = {carried: arm_with(rig, robot, stated(spec)) for carried, spec in rig.payloads.items()}
    return default_motion(rig, robot, arms)


def simulate_plan(
    rig: Rig, plan: Path | None, *, payload: str | None = None, seed: int | None = None
) -> ArmRun:
    """As `simulate_arm`, with the plan of a file."""
    trajectory = None if plan is None else read_joint_plan(plan, robot_of(rig).joints)
    return simulate_arm(rig, trajectory, payload=payload, seed=seed)


def arm_with(rig: Rig, robot: Robot, payload: Body, gravity: Array | None = None) -> Arm:
    """The rig's arm with a payload, in the rig's gravity or another (3,)."""
    assert rig.urdf_path is not None  # robot_of has read it
    acting = rig.gravity_array if gravity is None else gravity
    return arm_of(rig.urdf_path, robot.sensor_frame, robot.joints, payload, acting)


def move(
    rig: Rig, robot: Robot, trajectory: JointTrajectory, payload: Body, time_offset: float, seed: int = 0
) -> Moved:
    """Let the arm follow a plan with a payload, and check what it reports before anyone calls it truth.

    Noise and gain play no part; the time offset is that of the clocks [s], the seed that of imperfections.
    """
    _check_range(rig, robot, trajectory)
    hardware = Hardware(rig, seed, trajectory.duration)
    stamps, fine = stamps_of(rig, trajectory.duration, time_offset), hardware.fine_time
    shown, read = hardware.read_at(stamps.shown, "sensor"), hardware.read_at(stamps.motion, "motion")
    arm = arm_with(rig, robot, payload, hardware.gravity)
    stencils = _stencils(stamps.shown, trajectory.duration)
    time = np.unique(np.concatenate([read, shown, stencils.ravel(), fine]))
    driven = drive(arm, servo_for(arm, trajectory), trajectory, time)
    error = disagreement(rig, payload, driven.reading, np.searchsorted(time, stencils))
    if not error < _AGREEMENT:
        raise RuntimeError(
            f"the simulated wrench departs by {error:.1e} from Newton-Euler on the simulated motion"
        )
    wrench = driven.reading.wrench
    between = np.searchsorted(time, fine)
    ideal = FineMotion(wrench[between], driven.velocity[between], driven.position[between])
    joints = driven.at(np.searchsorted(time, read))
    return Moved(stamps, joints, wrench[np.searchsorted(time, shown)], error, hardware, ideal)


def disagreement(rig: Rig, payload: Body, reading: Reading, stencils: Integers) -> float:
    """Largest departure of recorded wrenches from Newton and Euler on the derivative of recorded twists.

    It is relative to the largest force, or moment, at the stencils: (K, 7) rows of the record, spaced evenly
    by `_SPACING`, the wrench being checked in the middle. The rig's range says what is a small wrench.
    """
    if not len(stencils):
        return 0.0
    rate = np.einsum("s,ksc->kc", _STENCIL, reading.twist[stencils]) / _SPACING
    middle = stencils[:, 3]
    expected = wrench_on_sensor(payload, np.zeros(3), reading.twist[middle], rate, reading.gravity[middle])
    off, size = np.abs(reading.wrench[middle] - expected), np.abs(expected)
    floor = _LEAST_WRENCH * rig.sensor.range_array
    return max(
        float(off[:, axes].max() / max(size[:, axes].max(), floor[axes].min()))
        for axes in (slice(0, 3), slice(3, 6))
    )


def record(rig: Rig, payload: str, truth: Truth, moved: Moved, readout: Readout | None = None) -> Log:
    """The log of a movement: gain, offset, noise and imperfections on what ideal sensors read.

    Positions are logged unless the rig states where the joints start and no noise of positions; velocities
    where it states their noise.
    """
    stamps, motion = moved.stamps, rig.motion
    rng = noise_of(rig, payload, truth.seed)
    readout = moved.readout(truth.gain) if readout is None else readout
    raw = readings(rig, truth, stamps, moved.wrench, rng, readout)
    # drawn whether logged or not, so that one stream's noise does not depend on the other
    deviates = rng.standard_normal((2, *moved.joints.position.shape))
    position, velocity = None, None
    if motion.position_noise is not None:
        noisy = readout.position(moved.joints.position, np.array(motion.position_noise), deviates[1])
        position = stamps.rows_of(stamps.motion_ns, noisy)
    elif motion.initial_position is None:
        position = stamps.rows_of(stamps.motion_ns, moved.joints.position)
    if motion.noise is not None:
        noisy = readout.velocity(moved.joints.velocity, motion.noise_array, deviates[0])
        velocity = stamps.rows_of(stamps.motion_ns, noisy)
    log = Log(
        path=None, payload=payload, sha256="", time_ns=stamps.time_ns, raw=raw,
        position=position, velocity=velocity,
    )  # fmt: skip
    return track(rig, log)


def _stencils(shown: Array, duration: float) -> Array:
    """(K, 7) times about some of the sensor's samples, as many as fit into the motion."""
    reach = 3.0 * _SPACING
    possible = shown[(shown >= reach) & (shown <= duration - reach)]
    middle = possible[:: max(1, possible.size // _CHECKED)]
    return np.asarray(middle[:, None] + _SPACING * np.arange(-3.0, 4.0))


def _check_range(rig: Rig, robot: Robot, trajectory: JointTrajectory) -> None:
    time = np.linspace(0.0, trajectory.duration, 1 + max(100, round(100.0 * trajectory.duration)))
    planned = trajectory.position(time)
    if planned.shape[1] != robot.n:
        expected = f"{robot.n}: {', '.join(robot.joints)}"
        raise InputError.at(rig.path, "plan", f"{planned.shape[1]} joints", expected)
    span = np.where(np.isfinite(robot.upper - robot.lower), robot.upper - robot.lower, 1.0)
    over = np.maximum(robot.lower - planned, planned - robot.upper) - _OVER * span
    row, joint = (int(i) for i in np.unravel_index(np.argmax(over), over.shape))
    if over[row, joint] > 0.0:
        place = f"plan: joint `{robot.joints[joint]}` at {time[row]:.2f} s"
        expected = f"within [{robot.lower[joint]:.4g}, {robot.upper[joint]:.4g}], its limits in the URDF"
        raise InputError.at(rig.path, place, f"{planned[row, joint]:.4g}", expected)
    start = rig.motion.initial_position if rig.motion.position_noise is None else None
    if start is not None and np.abs(planned[0] - start).max() > 1e-6:
        joint = int(np.argmax(np.abs(planned[0] - start)))
        expected = f"{planned[0, joint]:.6g}, where the plan starts"
        raise InputError.at(rig.path, f"motion.initial_position[{joint}]", f"{start[joint]:.6g}", expected)
