"""A log as the estimator reads it: every stream at its own stamps, nothing resampled (METHOD 10.1, 10.6).

Times are seconds since the log's first stamp; channels are fractions of R_i; the motion is in SI units.
"""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from truewrench import _core
from truewrench.estimation.accelerometer import at_sensor, noise_at_sensor, told_acceleration
from truewrench.estimation.assumptions import FIRST_POSITION_NOISE, Assumptions, statement
from truewrench.estimation.far_clock import GRID, bent
from truewrench.estimation.motion_noise import twist_noise
from truewrench.model.arrays import Array, Mask
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.motion.smooth import SILENT, segments
from truewrench.model.rig import Rig
from truewrench.model.rig.motion import ACCELEROMETER_BIAS_PRIOR
from truewrench.model.temperature import temperature_at
from truewrench.robot.arm import robot_of
from truewrench.robot.attitude import attitude_of, own_roots
from truewrench.robot.base_path import BasePath
from truewrench.robot.chain import chain_of
from truewrench.robot.lateness import in_step
from truewrench.robot.track import measured_twists

_NO_BIAS = 1e-9  # 1 sigma that holds a constant at zero
_SHORTEST_GAP = 0.05  # [s] that the attitude is not interpolated over, where it is more than 5 periods too
_LINEAR, _ANGULAR = slice(0, 3), slice(3, 6)


def recorded_logs(
    rig: Rig, logs: Sequence[Log], *, twists: bool = False, notes: list[str] | None = None
) -> tuple[Assumptions, _core.Statement, list[_core.RecordedLog]]:
    """What is assumed of a rig and its logs, the same for the core, and the logs' streams.

    A subtracted weight is added back already (`compensation.uncompensated`). With `twists`, what the
    tachometers measure of the sensor's twist stands in place of the joints. What was not read is added to
    the notes, for people. InputError: a log without motion, without samples of the sensor, or without gravity
    where it acts.
    """
    assumptions = Assumptions.of(rig, logs)
    streams = []
    for log in logs:
        of_log: list[str] = []
        streams.append(recorded(rig, assumptions, log, twists=twists, notes=of_log))
        if notes is not None:
            notes += [f"{log.path}: {note}" for note in of_log]
    return assumptions, statement(assumptions), streams


def recorded(
    rig: Rig, assumptions: Assumptions, log: Log, *, twists: bool = False, notes: list[str] | None = None
) -> _core.RecordedLog:
    """The streams of one log, as of `recorded_logs`.

    Samples of the sensor at which the attitude, or the motion of the base, is needed and not known are left
    out. The temperature between two readings is interpolated; before the first and after the last, it holds.
    A log may be too short to tell anything: that is for the estimator to say.
    """
    spec = rig.payloads[log.payload]
    out = _core.RecordedLog()
    out.payload = _core.Payload(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)
    out.body = assumptions.body(log.payload)
    of_com = rig.motion.source == "twist" and rig.motion.of == "com"
    out.point = spec.center_of_mass_array if of_com else np.zeros(3)
    if not np.isfinite(log.raw).any():
        raise InputError.at(log.path, "raw_*", "no samples of the sensor", "its channels")
    notes = [] if notes is None else notes
    known = np.ones(len(log.time_ns), dtype=np.bool_)
    joints = rig.motion.source == "joints"
    if rig.motion.source == "twist" or (joints and twists):
        out.source, out.arm = _core.Source.twist, joints
        fall: Array = np.zeros((len(log.time_ns), 3))
        if joints:
            moved, tau = in_step(log)
            log = measured_twists(rig, moved)
            if tau != 0.0:
                late = f"{abs(1e3 * tau):.2f} ms {'late' if tau > 0.0 else 'early'}"
                notes.append(
                    f"the velocities are {late} against the positions, which are read at their clock"
                )
        if rig.in_gravity:
            R_sensor_root = _attitude(rig, log)
            fall = R_sensor_root.reshape(-1, 3, 3) @ assumptions.gravity
            known, roots = np.isfinite(R_sensor_root[:, 0]), own_roots(rig, log, twists=twists)
            if len(roots):
                known &= ((log.time[:, None] >= roots[:, 0]) & (log.time[:, None] <= roots[:, 1])).any(axis=1)
            _leave_out(
                notes, log, known, "gx gy gz, qw qx qy qz", "the direction of gravity is not known then"
            )
            out.R_sensor_root = np.nan_to_num(R_sensor_root)
            out.own_roots = roots[:, 0].tolist()
        if joints:
            out.motion = _jacobian_streams(rig, assumptions, log)
        else:
            out.motion, out.point = _twist_streams(assumptions, log, out.point, fall, notes)
    elif rig.motion.source == "imu":
        out.source = _core.Source.imu
        out.motion = _imu_streams(assumptions, log)
    else:
        out.source = _core.Source.mapped
        chain, base = chain_of(robot_of(rig)), BasePath.of(rig, log)
        out.motion = _joint_streams(rig, assumptions, log, chain.joints, notes)
        known = base.covers(log.time)
        _leave_out(notes, log, known, "base_*", "the motion of the base is not known then")
        out.set_chain(chain, None if base.rests else base.carried, rig.in_gravity)
    out.time, out.half_window, out.clock_set = log.time, log.half_window("raw"), bent(log.clock_set)
    out.resolved = any(shakes.shown and shakes.open for shakes in log.vibrations)
    out.raw = np.where(known[:, None], log.raw / assumptions.channel_scale, np.nan)
    warm = temperature_at(log, log.time_ns) if assumptions.slope_prior > 0.0 else None
    if warm is not None:
        out.temperature = warm - assumptions.reference_temperature
    return out


def _stream(
    assumptions: Assumptions,
    log: Log,
    values: Array,
    sigma: Array,
    group: Sequence[int],
    *,
    field: str = "",
    derivative: int = 0,
) -> _core.MotionStream:
    """Measurements (N, M) of the log's rows, those without any left out; `field` of the log, if it is one."""
    rows = np.flatnonzero(np.isfinite(values).any(axis=1))
    out = _core.MotionStream()
    out.derivative = derivative
    out.time = log.time[rows]
    out.value = np.ascontiguousarray(values[rows])
    out.sigma = sigma
    out.group = np.array(group, dtype=np.int32)
    # where it was set, the stated prior does not hold: what is left is known to the steps of the search
    out.time_offset_prior = max(assumptions.time_offset_prior, GRID if log.clock_set != 0.0 else 0.0)
    out.clock_mean = assumptions.clock_mean
    out.kappa_mean = assumptions.kappa_mean
    out.half_window = log.half_window(field)
    return out


def _measured(log: Log, values: Array | None, expected: str) -> Array:
    if values is None or not np.isfinite(values).any():
        raise InputError.at(log.path, "", "no motion", expected)
    return values


def _twist_streams(
    assumptions: Assumptions, log: Log, point: Array, fall: Array, notes: list[str]
) -> tuple[list[_core.MotionStream], Array]:
    """Of the twist of a point (3,) from the sensor's origin [m], and that point.

    Of the twist's component-wise derivative, too, where its noise is stated; `fall` (N, 3) is the
    acceleration of free fall in sensor axes.
    """
    _measured(log, log.twist, "vx vy vz wx wy wz")
    noise, sigma, acceleration = assumptions.motion_noise, assumptions.acceleration_noise, log.acceleration
    assert noise is not None
    halves = (0, 0, 0, 1, 1, 1)
    told = None
    if sigma is not None and sigma.size == 3 and log.specific_force is not None:
        shared = noise_at_sensor(noise, point)
        if shared is None:
            notes.append(
                "accel_* not used: so far from the sensor, the velocity of the centre of mass does not tell "
                "the sensor's as well (log the twist `of: sensor`)"
            )
        else:
            log, noise, point = at_sensor(log, point), shared, np.zeros(3)
            told = told_acceleration(log, fall)
    assert log.twist is not None
    streams = [_stream(assumptions, log, log.twist, noise, halves, field="twist")]
    if told is not None and np.isfinite(told).any():
        assert sigma is not None
        bias = ACCELEROMETER_BIAS_PRIOR
        streams.append(_of_axes(assumptions, log, _LINEAR, told, sigma, bias, derivative=1))
    if sigma is not None and sigma.size == 6 and acceleration is not None and np.isfinite(acceleration).any():
        streams.append(_stream(assumptions, log, acceleration, sigma, halves, derivative=1))
    return streams, point


def _jacobian_streams(rig: Rig, assumptions: Assumptions, log: Log) -> list[_core.MotionStream]:
    """Twist of the sensor's origin, J qdot, with the noise J Sigma J^T of its mean row ([A00] 26)."""
    twist = _measured(log, log.twist, "velocities `dq_*`")
    halves = (0, 0, 0, 1, 1, 1)
    return [_stream(assumptions, log, twist, twist_noise(rig, log), halves, field="velocity")]


def _imu_streams(assumptions: Assumptions, log: Log) -> list[_core.MotionStream]:
    """[a_s, Omega] of the sensor's origin, each with a constant error of its own."""
    force = _measured(log, log.specific_force, "accel_x accel_y accel_z")
    omega = _measured(log, log.angular_velocity, "wx wy wz")
    assert assumptions.motion_noise is not None
    assert assumptions.acceleration_noise is not None
    of_force, of_omega = assumptions.accelerometer_bias_prior, assumptions.gyro_bias_prior
    return [
        _of_axes(
            assumptions, log, _LINEAR, force, assumptions.acceleration_noise, of_force, field="specific_force"
        ),
        _of_axes(
            assumptions, log, _ANGULAR, omega, assumptions.motion_noise, of_omega, field="angular_velocity"
        ),
    ]


def _of_axes(
    assumptions: Assumptions,
    log: Log,
    axes: slice,
    values: Array,
    sigma: Array,
    bias: float,
    *,
    field: str = "",
    derivative: int = 0,
) -> _core.MotionStream:
    """Measurements (N, 3) of three of the six components, each with a constant error of its own."""
    six, sigmas, biases = np.full((len(values), 6), np.nan), np.ones(6), np.full(6, _NO_BIAS)
    six[:, axes], sigmas[axes], biases[axes] = values, sigma, max(bias, _NO_BIAS)
    out = _stream(assumptions, log, six, sigmas, (0,) * 6, field=field, derivative=derivative)
    out.bias_prior = biases
    return out


def _joint_streams(
    rig: Rig, assumptions: Assumptions, log: Log, joints: int, notes: list[str]
) -> list[_core.MotionStream]:
    """Encoders and tachometers as they are, each with its own clock; velocities alone from a known start."""
    for name, values in (("q_*", log.position), ("dq_*", log.velocity)):
        if values is not None and values.shape[1] != joints:
            raise InputError.at(log.path, name, f"{values.shape[1]} joints", f"{joints}")
    _say_unused_accelerometer(assumptions, log, notes)
    together = (0,) * joints
    position, velocity = log.position, log.velocity
    told = position is not None and np.isfinite(position).any()
    streams = []
    if told:
        assert position is not None
        assert assumptions.position_noise is not None
        streams.append(
            _stream(assumptions, log, position, assumptions.position_noise, together, field="position")
        )
    if velocity is not None and np.isfinite(velocity).any() and assumptions.motion_noise is not None:
        sigma = assumptions.motion_noise
        starts: list[tuple[Array, Array]] = []
        if not told:
            velocity, starts = _from_start(rig, log, velocity, sigma, notes)
        streams.append(_stream(assumptions, log, velocity, sigma, together, field="velocity", derivative=1))
        streams += [_stream(assumptions, log, at, of, together) for at, of in starts]
    if not streams:
        _measured(log, None, "positions `q_*`, or velocities `dq_*` with `motion.noise`")
    return streams


def _from_start(
    rig: Rig, log: Log, velocity: Array, sigma: Array, notes: list[str]
) -> tuple[Array, list[tuple[Array, Array]]]:
    """Velocities alone (N, M), as far as they go without a gap, and of each stretch a position.

    The spline carries a position on. It begins where the sensor does, and anew where that was silent; there
    the position, (N, M) in one row, is the integral of the velocities, which walks away with their noise by
    sigma sqrt(t dt), its 1 sigma (M,). Across a gap of the velocities nobody knows where the joints went:
    what follows is left out.
    """
    if rig.motion.initial_position is None:
        expected = "joint positions: the log has none"
        raise InputError.at(rig.path, "motion.initial_position", "nothing", expected)
    rows = np.flatnonzero(np.isfinite(velocity).all(axis=1))
    if not rows.size:
        raise InputError.at(log.path, "dq_*", "no row with all joints", "velocities of all joints")
    rows = rows[segments(log.time[rows], SILENT)[0]]
    known = velocity.copy()
    known[rows[-1] + 1 :] = np.nan
    lost = int(np.count_nonzero(np.isfinite(velocity[rows[-1] + 1 :]).any(axis=1)))
    if lost:
        notes.append(f"{lost} rows of dq_* left out: after a gap nothing tells the joints' positions")
    time = log.time[rows]
    moved = np.zeros((1, velocity.shape[1]))
    if rows.size > 1:
        moved = make_interp_spline(time, velocity[rows], k=min(3, rows.size - 1)).antiderivative()(time)
    period = float(np.median(np.diff(time))) if rows.size > 1 else 0.0
    sensed = log.time[np.isfinite(log.raw).any(axis=1)]
    starts = []
    for piece in segments(sensed, SILENT):
        first = int(np.searchsorted(time, sensed[piece][0]))
        if first == rows.size:
            break
        position = np.full_like(velocity, np.nan)
        position[rows[first]] = rig.motion.initial_position + moved[first] - moved[0]
        walked = sigma * np.sqrt(period * (time[first] - time[0]))
        starts.append((position, np.hypot(FIRST_POSITION_NOISE, walked)))
    return known, starts


def _attitude(rig: Rig, log: Log) -> Array:
    """R_sensor_root (N, 9) of all rows, row by row, NaN where it is not known."""
    told = attitude_of(rig, log)
    if told is None or len(told[0]) < 2:
        found = "no gravity" if told is None else "gravity in 1 row"
        raise InputError.at(log.path, "", found, "gx gy gz or qw qx qy qz, which a twist in gravity needs")
    return _between(*told, log.time)


def _between(time: Array, R: Array, at: Array) -> Array:
    """Rotations (M, 9) row by row at times (M,), cubic in the quaternions of (K, 3, 3) at times (K,).

    NaN before the first, after the last, and in gaps.
    """
    quaternion = Rotation.from_matrix(R).as_quat()
    turned = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
    quaternion[1:] *= np.cumprod(np.where(turned, -1.0, 1.0))[:, None]
    out: Array = np.full((at.size, 9), np.nan)
    for piece in segments(time, _SHORTEST_GAP):
        known = time[piece]
        inside = (at >= known[0]) & (at <= known[-1])
        if inside.any() and known.size > 1:
            path = make_interp_spline(known, quaternion[piece], k=min(3, known.size - 1))
            out[inside] = Rotation.from_quat(path(at[inside])).as_matrix().reshape(-1, 9)
    return out


def _leave_out(notes: list[str], log: Log, known: Mask, columns: str, why: str) -> None:
    """Say how many samples of the sensor are lost for want of something that these columns tell."""
    sensed = np.isfinite(log.raw).any(axis=1)
    lost = int(np.count_nonzero(sensed & ~known))
    if lost == np.count_nonzero(sensed):
        found = "no sample of the sensor while they are known"
        raise InputError.at(log.path, columns, found, "some, or a reading around them")
    if lost:
        notes.append(f"{lost} samples of the sensor left out: {why}")


def _say_unused_accelerometer(assumptions: Assumptions, log: Log, notes: list[str]) -> None:
    """What a log tells of accelerations, and the estimator does not read beside this motion."""
    sigma = assumptions.acceleration_noise
    if sigma is None:
        return
    if sigma.size == 3 and log.specific_force is not None:
        notes.append("accel_* not used: specific force is not read beside joints")
    if sigma.size == 6 and log.twist is None and log.acceleration is not None:
        notes.append("ax ... alz not used: they are read only with `motion.source: twist`")
