"""Rows of a log, all at once or as they come, to contact wrenches with their covariance."""

from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench import _core
from truewrench.correction.contact.motion import HELD, Columns, MotionColumns
from truewrench.correction.warmth import Warmth, where_told
from truewrench.estimation.static_poses import REPEATABILITY
from truewrench.model.arrays import Array, Integers
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError, check_word
from truewrench.model.rig import Rig
from truewrench.model.temperature import where_apart
from truewrench.robot.compensation import subtracted
from truewrench.tool.model import Tool
from truewrench.tool.parameters import channel_turn

DELAY = 0.01  # [s] half the length of the kernels: how long after a moment its wrench is known
CAPACITY = 32768  # rows after which one that has no wrench will never have one

_UNTOLD = (0, np.full(3, np.nan), np.zeros(3))  # stamp, free fall, Omega
NEWEST_WINDOW = 0.02  # [s] of the kernels without delay
LONGEST = 1.0  # [s] of a delay
_DRIFTED = 10.0  # times the noise of a sample, from which on what the offset may have done is said

_AXES = ("cfx", "cfy", "cfz", "cmx", "cmy", "cmz")
NEW_COLUMNS = (*_AXES, *(f"{axis}_std" for axis in _AXES), "contact_chi2")
"""What a log gets: the wrench [N, N m], its 1 sigma, and its square in units of its covariance."""

TARED = {
    "in_contact": "the contact test, drift included, says that there is contact",
    "nothing": "there is no contact wrench yet, or none since the last tare",
    "singular": "the gain that would follow cannot be inverted",
}


@dataclass(frozen=True, slots=True)
class View:
    """Where and how a wrench is expressed.

    Attributes:
        at: (6,) x, y, z, roll, pitch, yaw of the point, and of its axes, in the sensor frame [m, rad].
        axes: those of the sensor (of `at`), or of the root frame.
    """

    at: tuple[float, ...] = (0.0,) * 6
    axes: Literal["sensor", "base"] = "sensor"

    def __post_init__(self) -> None:
        """InputError for what is no point, or no axes."""
        check_word("axes", self.axes, ("sensor", "base"))
        if np.shape(self.at) != (6,) or not np.isfinite(self.at).all():
            raise InputError.at(
                None, "at", f"{self.at}", "six numbers: x, y, z, roll, pitch, yaw in m and rad"
            )

    @property
    def plain(self) -> bool:
        """Whether it is that of the sensor's origin and axes."""
        return not any(self.at) and self.axes == "sensor"

    def maps(self, R_sensor_root: Array) -> Array:
        """(N, 6, 6) maps of wrenches at the sensor's origin, sensor axes; R_sensor_root is (N, 3, 3)."""
        point, angles = np.array(self.at[:3]), np.array(self.at[3:])
        R = channel_turn(angles)[0][None] if self.axes == "sensor" else R_sensor_root.transpose(0, 2, 1)
        shift = np.eye(6)
        x, y, z = point
        shift[3:, :3] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.zeros((len(R), 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = R
        return np.broadcast_to(turn @ shift, (len(R_sensor_root), 6, 6))


@dataclass(frozen=True, slots=True, eq=False)
class ContactEvent:
    """A contact; what is closer than 0.1 s in time is one.

    Attributes:
        begin_ns: stamp of its first row above the limit.
        end_ns: of its last one.
        peak_force: largest norm of the force [N].
        point: (3,) at the peak, of the wrench's axis, nearest to the tool's centre of mass; sensor frame [m].
    """

    begin_ns: int
    end_ns: int
    peak_force: float
    point: tuple[float, ...]

    def to_mapping(self) -> dict[str, object]:
        """By the keys of a line of `stream`."""
        return {"event": "contact", **asdict(self)}


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Contact wrenches of M rows, in the sign of the rig's `sensor.feels`.

    Attributes:
        rows: (M,) their numbers, from 0 on.
        time_ns: (M,) moments: centres of the kernels; without delay their newest samples.
        wrench: (M, 6) [N, N m].
        covariance: (M, 6, 6) of it.
        chi2: (M,) wrench^T covariance^-1 wrench; above `_core.contact_limit` a contact.
    """

    rows: Integers
    time_ns: Integers
    wrench: Array
    covariance: Array
    chi2: Array

    @property
    def columns(self) -> Array:
        """(M, 13) in the order of `NEW_COLUMNS`."""
        std = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return np.hstack([self.wrench, std, self.chi2[:, None]])


class ContactRun:
    """One pass over rows; twice the same rows give twice the same numbers, however they are cut into blocks.

    Args:
        tool: gain, offset, body and gravity with their joint covariance.
        names: columns that the rows have; None where any may come.
        calibration: of the sensor, for its quadratic terms and its offset's slope by temperature.
        delay: half the length of the kernels [s]; 0: they end at the row.
        view: where and how to express the wrench.
        place: of the rows, for messages.

    Raises:
        InputError: columns are missing, or tool and calibration are of two sensors.
    """

    def __init__(
        self,
        tool: Tool,
        names: Collection[str] | None,
        *,
        calibration: Calibration | None = None,
        delay: float = DELAY,
        view: View | None = None,
        place: Path | None = None,
    ) -> None:
        if not 0.0 <= delay <= LONGEST:
            raise InputError.at(None, "--delay", f"{delay:g}", f"seconds from 0 to {LONGEST:g}")
        self.motion = MotionColumns(tool.rig, names, place)
        self._view, self._n, self._rig = view or View(), tool.n, tool.rig
        self._place, self._delay, self._time_offset = place, delay, tool.time_offset
        self._told = _UNTOLD
        self._offset = tool.offset_time_ns, tool.offset_walk
        self._drifted: tuple[str, ...] = ()
        self._read = 0  # rows so far,
        self._bases: dict[int, Array] = {}  # and how the base is turned in those whose wrench is to come
        if self._view.axes == "base" and not self.motion.attitude_known:
            expected = "joints, or the attitude qw qx qy qz: gravity alone leaves the turn about it open"
            raise InputError.at(place, "--axes", "`base` without an attitude", expected)
        settings = contact_settings(tool, calibration, self.motion, delay)
        self._warmth = Warmth(np.asarray(settings.temperature_slope), tool.rig.temperature.reference)
        self._warm = self._warmth.follows and (names is None or "temperature" in names)
        if self._warm and names is not None:
            self._warmth.latest = np.nan
        raw = tuple(f"raw_{i}" for i in range(tool.n))
        self.columns = (*raw, *self.motion.columns, *(("temperature",) if self._warm else ()))
        window = 2.0 * delay or NEWEST_WINDOW
        try:
            self._rows = _core.ContactRows(settings, window, delay == 0.0, self.motion.imu, CAPACITY)
        except ValueError as error:
            raise InputError(f"the tool cannot be used: {error}") from error

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth saying of all rows so far."""
        return (*self._drifted, *(() if self._warm else self._warmth.note))

    @property
    def lag(self) -> int:
        """Rows after which one has its wrench, as far as known."""
        return int(self._rows.lag)

    @property
    def due(self) -> int:
        """Number of the row that has its wrench with the latest one, at the earliest; -1: none yet."""
        return int(self._rows.due)

    @property
    def in_contact(self) -> bool:
        """Whether an event lasts."""
        return bool(self._rows.in_contact)

    def feed(self, time_ns: Integers, raw: Array, columns: Columns) -> Contacts:
        """The wrenches that the next rows complete, of these and of earlier ones.

        Args:
            time_ns: (N,) stamps, increasing.
            raw: (N, n) channels, NaN where there is no sample.
            columns: (N,) each, of `self.columns`; those that are absent hold no sample.

        Raises:
            InputError: a stamp is beyond what is counted with, or an attitude is none.
        """
        late = np.flatnonzero(np.abs(time_ns) >= _core.FARTHEST_NS)
        if late.size:
            expected = f"less than {_core.FARTHEST_NS} ns on either side of zero"
            raise InputError.at(self._place, "time", f"{time_ns[late[0]]} ns", expected)
        if not self._read and len(time_ns):
            self._drifted = self._drift(int(time_ns[0]))
        motion = self.motion.read(time_ns, columns)
        if motion.base is not None and self._view.axes == "base":
            self._bases |= {self._read + k: R for k, R in enumerate(motion.base)}
        self._read += len(time_ns)
        if self._rig.sensor.subtracted is not None:
            fall = self.motion.gravity(time_ns, columns)[0] if self.motion.imu else motion.fall
            raw = raw + subtracted(self._rig, self._fall_felt(time_ns, fall, motion.twist[:, 3:]))
        untold = np.full(len(time_ns), np.nan)
        celsius = self._warmth.held(columns.get("temperature", untold) if self._warm else untold)
        args = (raw, motion.twist, motion.fall, motion.turn, celsius, motion.noise)
        stamps = np.ascontiguousarray(time_ns, dtype=np.int64)
        return self._seen(self._rows.feed(stamps, *map(np.ascontiguousarray, args)))

    def _drift(self, first_ns: int) -> tuple[str, ...]:
        """Where the offset was told so long before or after a first row that small contacts do not show."""
        offset_ns, walk = self._offset
        since = 1e-9 * abs(first_ns - offset_ns)
        drift, noise = walk * np.sqrt(since), self._rig.sensor.noise_array
        i = int(np.argmax(drift / noise))
        if not drift[i] > _DRIFTED * noise[i]:
            return ()
        when, channel = "before" if first_ns > offset_ns else "after", self._rig.sensor.channels[i]
        return (
            f"the tool's offset was told {since:.3g} s {when} the first row: by its walk it may be "
            f"{drift[i]:.3g} off in {channel}, {drift[i] / noise[i]:.2g} times the noise, and only larger "
            "contacts are told (a clock that counts from another moment? else identify it again, or tare)",
        )

    def _fall_felt(self, time_ns: Integers, told: Array, turning: Array) -> Array:
        """Free fall (N, 3) where the motion was at the sensor's stamps, turned on from its last row."""
        known = np.isfinite(told).all(axis=1) & np.isfinite(turning).all(axis=1)
        stamps = np.append(self._told[0], time_ns)
        fall, omega = (
            np.vstack([before, values])
            for before, values in zip(self._told[1:], (told, turning), strict=True)
        )
        last = np.maximum.accumulate(np.append(0, np.where(known, np.arange(1, known.size + 1), 0)))
        self._told = stamps[last[-1]], fall[last[-1]], omega[last[-1]]
        last = last[1:]
        since = 1e-9 * (time_ns - stamps[last])
        turned = Rotation.from_rotvec(-omega[last] * (since + self._time_offset)[:, None]).apply(fall[last])
        return np.where(since[:, None] <= HELD, turned, np.nan)

    def finish(self) -> Contacts:
        """Those of the rows that still waited for others.

        Raises:
            InputError: the delay holds more samples than are kept.
        """
        found = self._seen(self._rows.finish())
        if self._rows.too_long:
            expected = f"kernels of at most {CAPACITY // 3} samples: less at this rate"
            raise InputError.at(self._place, "--delay", f"{self._delay:g} s", expected)
        return found

    def restart(self) -> None:
        """As if no row had come yet, where stamps begin again; what tares have taught stays."""
        self._rows.restart()
        self.motion.restart()
        self._told = _UNTOLD

    def events(self) -> list[ContactEvent]:
        """Contacts that have ended since the last call."""
        return [
            ContactEvent(begin, end, peak, tuple(point.tolist()))
            for begin, end, peak, point in self._rows.ended()
        ]

    def tare(self) -> tuple[bool, str]:
        """Take the last wrench for that of no contact; whether that was accepted, and why not."""
        answer = self._rows.tare()
        return answer == "accepted", TARED.get(answer, "")

    def _seen(self, found: tuple[Any, ...]) -> Contacts:
        rows, time_ns, wrench, covariance, chi2, R_sensor_root, heading = found
        if self._view.axes == "base" and not np.all(heading):  # the root's axes are not known there
            told = heading > 0.0
            rows, time_ns, wrench = rows[told], time_ns[told], wrench[told]
            covariance, chi2, R_sensor_root = covariance[told], chi2[told], R_sensor_root[told]
        if not self._view.plain and len(wrench):
            if self._bases:  # the root frame turns in the inertial one, which the motion is told in
                R_inertial_root = np.array([self._bases.get(int(row), np.eye(3)) for row in rows])
                R_sensor_root = R_sensor_root @ R_inertial_root
                kept = range(int(rows[-1]), self._read)
                self._bases = {row: self._bases[row] for row in kept if row in self._bases}
            X = self._view.maps(R_sensor_root)
            wrench = np.einsum("kij,kj->ki", X, wrench)
            covariance = X @ covariance @ X.transpose(0, 2, 1)
        return Contacts(rows.astype(np.int64), time_ns.astype(np.int64), wrench, covariance, chi2)


def contact_settings(
    tool: Tool, calibration: Calibration | None, motion: MotionColumns, delay: float
) -> _core.ContactSettings:
    """What the core needs to know; InputError if tool and calibration are of two sensors."""
    sensor, tool = tool.rig.sensor, tool.whole
    slope = tool.offset_temperature
    settings, offset = _core.ContactSettings(), tool.offset
    settings.mass, settings.center_of_mass, settings.S = tool.mass, tool.center_of_mass, tool.S
    settings.mounting, settings.tilt = tool.mounting, tool.tilt
    settings.gravity, settings.covariance = tool.rig.gravity_array, tool.covariance
    settings.offset_time_ns, settings.offset_walk = tool.offset_time_ns, tool.offset_walk
    settings.pose_repeatability = tool.pose_repeatability
    # hysteresis, creep or a cable leave as much elsewhere as they did where the tool was identified, and so
    # does what shakes the sensor
    usual = REPEATABILITY * sensor.channel_scale
    slow = np.maximum(tool.pose_repeatability**2 - usual**2, 0.0)
    shaking = tool.vibrations[:, 1:] * _passed(tool.vibrations[:, :1], delay)
    settings.slow_error = np.sqrt(slow + (shaking**2).sum(axis=0))
    settings.time_offset, settings.time_offset_std = tool.time_offset, tool.time_offset_std
    settings.twist_noise, settings.gravity_noise = motion.twist_noise, motion.gravity_noise
    if calibration is not None:
        check_same_sensor(tool, calibration.rig)
        slope = calibration.offset_temperature if slope is None else slope
        if calibration.quadratic is not None and calibration.quadratic_std is not None:
            # the tool's gain is no tangent: what the curve adds is uncertain by its size
            settings.quadratic_std = np.hypot(calibration.quadratic, calibration.quadratic_std)
            settings.full_scale = sensor.channel_scale
    if slope is not None:
        settings.temperature_slope = slope
        settings.temperature_reference = tool.rig.temperature.reference
        if tool.offset_temperature_covariance is not None:
            scale, at = sensor.channel_scale, tool.layout.offset
            found = where_apart(tool.covariance, at, tool.offset_temperature_covariance, scale)
            above, settings.covariance, settings.temperature_slope_std = found
            settings.temperature_reference += above
            offset = offset + above * slope
        elif calibration is not None and (told := where_told(calibration)) is not None:
            settings.temperature_slope_std = told[2]
    gain, feels = np.ascontiguousarray(tool.gain), sensor.feels == "payload_on_sensor"
    settings.set_sensor(gain, offset, tool.sample_noise, feels)
    return settings


def _passed(hz: Array, delay: float) -> Array:
    """Share of an amplitude that the kernel of the wrench passes; all of it where it ends at the row."""
    x = np.maximum(2.0 * np.pi * hz * delay, 1e-3)
    return np.asarray(np.abs(3.0 * (np.sin(x) - x * np.cos(x)) / x**3))


def check_same_sensor(tool: Tool, rig: Rig, place: Path | None = None, *, arm: bool = False) -> None:
    """Refuse a tool, of the file `place`, of another sensor than the rig's, or with `arm` on another arm.

    What a calibration was made with need not be the arm, or the place, that the tool was identified on.
    """
    keys = ["channels", "feels", "range", "nominal_gain", "compensated"]
    theirs, ours = tool.rig, rig
    pairs = {f"sensor.{key}": (getattr(theirs.sensor, key), getattr(ours.sensor, key)) for key in keys}
    pairs["temperature.reference"] = theirs.temperature.reference, ours.temperature.reference
    if arm:
        pairs["gravity"] = theirs.gravity, ours.gravity
        pairs["motion.source"] = theirs.motion.source, ours.motion.source
    for key, (of_tool, given) in pairs.items():
        if of_tool != given:
            by = rig.path or "the rig beside it"
            raise InputError.at(place, f"rig.{key}", f"{of_tool}", f"{given}, as {by} says")
