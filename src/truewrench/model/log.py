"""LOG: what was recorded, as arrays on the log's own time stamps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, CubicSpline

from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError

WIDE = 4.0  # [Hz] of a vibration, from which on it is told from where to where: words only


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A motion of the sensor's origin close to the true one."""

    origin_ns: int  # the time stamp that its times count from
    breakpoints: Array  # (K + 1,) of a quintic spline with clamped ends [s]
    twist: Array  # (K + 5, 6) its coefficients, sensor axes [m/s, rad/s]
    spacing: float  # of the knots of the joints' fit behind it [s]
    gravity_time: Array  # (M,) [s]
    gravity: Array | None  # (M, 3) free fall at these times in sensor axes [m/s^2], None on orbit
    # (2K,) begins and ends of pauses that it shortens, as the log has them, and by how much there [s]
    pause_edges: Array = field(default_factory=lambda: np.zeros(1))
    pause_cut: Array = field(default_factory=lambda: np.zeros(1))

    def motion(self, time: Array) -> tuple[Array, Array, Array]:
        """Twist (N, 6), its component-wise derivative and free fall (N, 3) at times (N,) since the origin."""
        time = time - np.interp(time, self.pause_edges, self.pause_cut)
        ends = np.repeat(self.breakpoints[[0, -1]], 5).reshape(2, 5)
        twist = BSpline(np.concatenate([ends[0], self.breakpoints, ends[1]]), self.twist, 5)
        gravity = np.zeros((len(time), 3))
        if self.gravity is not None:
            gravity = CubicSpline(self.gravity_time, self.gravity)(time)
        return np.asarray(twist(time)), np.asarray(twist(time, nu=1)), np.asarray(gravity)


@dataclass(frozen=True, slots=True)
class Vibration:
    """A band that has been taken out of the channels, and of the motion where that shows it too."""

    low: float  # [Hz]
    high: float  # infinite where it is `open`
    centre: float
    std: tuple[float, ...]  # 1 sigma of each of n channels, fraction of range
    channel: str  # that has the largest
    shown: bool  # by the motion

    @property
    def open(self) -> bool:
        """Whether all from a corner on was left out."""
        return self.high == np.inf

    @property
    def size(self) -> float:
        """The largest mean amplitude, were it of one frequency, fraction of range."""
        return float(np.sqrt(2.0) * max(self.std))

    @property
    def words(self) -> str:
        """For a person."""
        at = f"at {self.centre:.3g} Hz"
        if self.high - self.low > WIDE:
            at = f"from {self.low:.3g} {'Hz on' if self.open else f'to {self.high:.3g} Hz'}"
        seen = "shows too; left out of both" if self.shown else "does not show; left out"
        return f"a vibration {at}, {100 * self.size:.2g}% of range in {self.channel}, that the motion {seen}"


@dataclass(frozen=True, slots=True, eq=False)
class Tracking:
    """What the n joints say of the sensor's motion, per row of the log; NaN where there is no sample."""

    jacobian: Array  # (N, 6, n) of the sensor's origin, sensor axes; at the reference, if there is one
    jacobian_rate: Array | None = None  # (N, 6, n) its derivative by time; None without a reference
    # (N, n) of the positions from the reference [rad, m]; None without one
    position_departure: Array | None = None
    # (N, n) their noise at a few rows, where they are integrated velocities; else None
    position_sigma: Array | None = None
    # (N, n) of the tachometers; None without a reference, or without tachometers
    velocity_departure: Array | None = None
    reference: Reference | None = None  # None where positions are exact, and the twist is what was measured


@dataclass(frozen=True, slots=True)
class Whitened:
    """How the noise of a stream was filtered, which has been undone."""

    columns: str  # of the log, for a person
    growth: float  # of the noise's 1 sigma
    advance: float  # of what is slow [s]
    corner: float  # where the density of the noise had fallen to half [Hz]
    step: int  # samples of which one is left
    period: float  # [s] of the samples

    @property
    def words(self) -> str:
        """For a person."""
        words = f"the noise of {self.columns} looks filtered at {self.corner:.2g} Hz"
        words += f"; one of {self.step} samples read"
        if self.growth > 1.0:
            earlier = f"{1e3 * self.advance:.2g} ms earlier"
            words += f", without the filter: {self.growth:.2g} x the noise, {earlier}"
        return words


@dataclass(frozen=True, slots=True)
class Log:
    """One recording: N rows, SI units, NaN where a stream has no sample at a row's time.

    Attributes:
        path: the file it was read from, None when it was not read.
        payload: which payload of the rig the arm carried.
        sha256: of the file, empty when it was not read.
        time_ns: (N,) int64, strictly increasing [ns].
        raw: (N, n) sensor channels in the order of the rig [raw units].
        twist: (N, 6) of the point `motion.of`, sensor axes [m/s, rad/s]; None with a reference instead, and
            where the motion is an IMU's.
        angular_velocity: (N, 3) of the sensor, sensor axes [rad/s]: an IMU's gyroscope, which with
            `specific_force` takes the place of the twist; None for other sources of motion.
        gravity: (N, 3) acceleration of free fall in sensor axes [m/s^2], as logged or by the attitude or the
            joints; None where nothing tells it.
        attitude: (N, 4) quaternion w, x, y, z from the sensor to the root frame, None when there is no such
            column.
        position: (N, n) joint positions in the order of the chain [rad, m], None likewise.
        velocity: (N, n) joint velocities [rad/s, m/s], None likewise.
        base_twist: (N, 6) of the robot's root, root axes [m/s, rad/s], None where the base is fixed.
        base_attitude: (N, 4) quaternion w, x, y, z from the root to the inertial frame, None likewise.
        acceleration: (N, 6) component-wise derivative of the twist, None likewise.
        specific_force: (N, 3) of the sensor origin, sensor axes: vdot + Omega x v - g [m/s^2], None likewise.
        temperature: (N,) [degC], None likewise.
        reference: (N, 6) wrench known from elsewhere, in the rig's sign [N, N m], None likewise.
        offset_jumps_ns: time stamps at which the offset begins anew.
        tracking: of a joint log, whose twist and gravity come from its joints; None likewise.
        whitened: fields of which a filter has been undone, as the estimate reads them.
        vibrations: that have been taken out, likewise.
        calmed: of its fields from which they were, what of the 1 sigma of white noise is left in a sample.
        clock_rate: how much faster than the motion's the sensor's clock ran, undone.
        clock_set: how much later than the motion's it was, undone [s].
        weight_offset: how much later than the sensor's stamps the motion was taken by which a weight that the
            driver had subtracted was added back [s]; None where none was.
        nan_counts: per column, how many cells held NaN and were left out; columns without any are absent.
        dropped_rows: rows without any measurement, which are not among the N.
        notes: what is no fault of the log but worth a look.
    """

    path: Path | None
    payload: str
    sha256: str
    time_ns: Integers
    raw: Array
    twist: Array | None = None
    gravity: Array | None = None
    angular_velocity: Array | None = None
    attitude: Array | None = None
    acceleration: Array | None = None
    specific_force: Array | None = None
    temperature: Array | None = None
    reference: Array | None = None
    position: Array | None = None
    velocity: Array | None = None
    base_twist: Array | None = None
    base_attitude: Array | None = None
    offset_jumps_ns: tuple[int, ...] = ()
    tracking: Tracking | None = None
    whitened: Mapping[str, Whitened] = field(default_factory=dict)
    vibrations: tuple[Vibration, ...] = ()
    calmed: Mapping[str, float] = field(default_factory=dict)
    clock_rate: float = 0.0
    clock_set: float = 0.0
    weight_offset: float | None = None
    nan_counts: Mapping[str, int] = field(default_factory=dict)
    dropped_rows: int = 0
    notes: tuple[str, ...] = ()

    def check_channels(self) -> None:
        """Refuse a channel without any sample where a wrench is needed, which takes all of them.

        Raises:
            InputError: naming it.
        """
        for i, channel in enumerate(self.raw.T):
            if not np.isfinite(channel).any():
                expected = "samples of every channel"
                raise InputError.at(self.path, f"column `raw_{i}`", "not one number", expected)

    def check_sizes(self, largest: float = 1e100, *, raw: bool = True) -> None:
        """Refuse numbers of which not even squares can be counted with; unless `raw`, but for the channels.

        Raises:
            InputError: naming the stream.
        """
        motion = ("twist", "position", "velocity", "gravity", "angular_velocity", "specific_force")
        for name in (*motion, "acceleration", "reference", *(["raw"] if raw else [])):
            values = getattr(self, name)
            most = 0.0 if values is None else float(np.nanmax(np.abs(values), initial=0.0))
            if most > largest:
                raise InputError.at(self.path, name, f"{most:.3g}", f"numbers of at most {largest:g}")

    @property
    def time(self) -> Array:
        """(N,) time since the first row [s]."""
        return np.asarray((self.time_ns - self.time_ns[:1]) * 1e-9, np.float64)

    @property
    def motion_period(self) -> float | None:
        """Of the fastest stream of the motion [s]; None where no stream has two samples."""
        streams = (self.position, self.velocity, self.twist, self.specific_force, self.angular_velocity)
        told = (np.isfinite(x).any(axis=1) for x in streams if x is not None)
        periods = [float(np.median(np.diff(self.time[rows]))) for rows in told if np.count_nonzero(rows) > 1]
        return min(periods, default=None)

    def advance(self, stream: str | None = None) -> float:
        """How far a clock that was set, and filters undone, advance the sensor against a field of motion [s].

        By default against the first that there is.
        """
        return self.clock_set + self.filters_advance(stream)

    def filters_advance(self, stream: str | None = None) -> float:
        """The same of filters undone alone [s]."""
        first = ("position", "velocity", "twist", "specific_force")  # the twist of joints is no stream
        of = stream or next((name for name in first if getattr(self, name) is not None), "")
        raw, motion = (self.whitened[x].advance if x in self.whitened else 0.0 for x in ("raw", of))
        return raw - motion

    def half_window(self, stream: str) -> float:
        """Half of the time [s] for which one sample of a field is read; 0 where the filter was undone."""
        found = self.whitened.get(stream)
        return 0.0 if found is None or found.growth > 1.0 else 0.5 * found.step * found.period


def log_name(logs: Sequence[Log], k: int) -> str:
    """How a log is called in a sentence."""
    path = logs[k].path if k < len(logs) else None
    number = f"log {k + 1}" if len(logs) > 1 else "the log"
    return number if path is None else f"{number} ({path.name})"
