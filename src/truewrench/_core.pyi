"""
Numerical core of truewrench (C++20). The public face is the truewrench package.
"""

from collections.abc import Callable, Sequence
import enum
from typing import Annotated, overload

import numpy
from numpy.typing import NDArray


class Status(enum.Enum):
    """Outcome of a call into the core."""

    ok = 0

    not_finite = 1

    not_positive = 2

    not_factorizable = 3

    wrong_size = 4

    not_increasing = 5

    unphysical_payload = 6

    singular = 7

    not_converged = 8

    not_configured = 9

    @property
    def words(self) -> str:
        """The outcome as a person would say it."""

class Payload:
    """
    A rigid payload: mass [kg], centre of mass [m] and inertia about it [kg m^2], sensor axes.
    """

    @overload
    def __init__(self) -> None: ...

    @overload
    def __init__(self, mass: float, center_of_mass: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], inertia: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')]) -> None: ...

    @property
    def mass(self) -> float: ...

    @mass.setter
    def mass(self, arg: float, /) -> None: ...

    @property
    def center_of_mass(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @center_of_mass.setter
    def center_of_mass(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def inertia(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')]: ...

    @inertia.setter
    def inertia(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], /) -> None: ...

def payload_wrench(payload: Payload, nu: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], a: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], gravity: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float64], dict(order='C')]:
    """
    The reaction of the payload on the sensor, (N, 6) [N, N m], from the twist of the centre of mass (N, 6), its
    component-wise derivative (N, 6) and gravity (N, 3), all in sensor axes.
    """

def payload_jacobians(payload: Payload, nu: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')]]:
    """
    Jacobians of payload_wrench, two (N, 6, 6): by the acceleration and by the twist.
    """

def twist_shift(r: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]:
    """
    6 x 6 map from the twist of a point to that of another of the same body, r [m] from the first to it.
    """

class Carried:
    """
    A payload that logs moved: places (10) of log mass, centre of mass, xx yy zz xy xz yz among the parameters,
    the body as found, and the sum of w w^T (6, 6) over its samples.
    """

    def __init__(self, places: Sequence[int], body: Payload, felt: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]) -> None: ...

def body_changes(body: Payload, inertia_std: float = 0.0) -> Annotated[NDArray[numpy.float64], dict(order='C')]:
    """
    (dM / db_k) M^-1 (10, 6, 6), M the spatial inertia about the sensor: w + L_k w db_k is felt of a body that is another.
    """

def to_the_middle(covariance: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], prior: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], range: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], carried: Sequence[Carried]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
    """
    How far from the likeliest parameters (p) those lie with which the bodies are likeliest, the gain integrated out:
    of their covariance (p, p), the gain normalised and first, and the gain's variances (6n) beforehand.
    """

def bend(gain: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], center: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], prior: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]:
    """
    What the product of gain of moment and centre of mass adds to the covariance of the gain (6n, 6n) [SI].
    """

class Conditioning:
    """How well a gain is posed, in range-normalised units."""

    @property
    def condition_number(self) -> float:
        """Of the gain; infinite when it is singular."""

    @property
    def departure_norm(self) -> float:
        """Induced 2-norm of Delta = C - I."""

    @property
    def departure_below_one(self) -> bool:
        """The paper's condition: sufficient for an inverse, not necessary."""

def generalised_inverse(gain: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], noise: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
    """
    The (6, n) inverse of a gain (n, 6) that gives the wrench of smallest variance, for 1-sigma noise (n,).

    Raises ValueError when the gain cannot be inverted.
    """

def conditioning(gain: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], noise: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], nominal: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], range: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]) -> Conditioning:
    """
    Condition number and departure from the nominal gain, with wrench axes counted in their ranges (6,).
    """

class Feels(enum.Enum):
    """Sign of the wrench in raw = gain w + offset."""

    payload_on_sensor = 1

    sensor_on_payload = -1

class EkfSettings:
    """
    Noise and start of the published filter; by default its published start.
    """

    def __init__(self) -> None: ...

    @property
    def feels(self) -> Feels: ...

    @feels.setter
    def feels(self, arg: Feels, /) -> None: ...

    @property
    def raw_covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]:
        """(6, 6) of one sample of the channels."""

    @raw_covariance.setter
    def raw_covariance(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')], /) -> None: ...

    @property
    def twist_covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]:
        """(6, 6) of one sample of the twist."""

    @twist_covariance.setter
    def twist_covariance(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')], /) -> None: ...

    @property
    def process_density(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]:
        """(6,) spectral density of the derivative of a."""

    @process_density.setter
    def process_density(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], /) -> None: ...

    @property
    def twist_variance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]:
        """(6,) of nu at the start."""

    @twist_variance.setter
    def twist_variance(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], /) -> None: ...

    @property
    def acceleration_variance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]:
        """(6,) of a at the start."""

    @acceleration_variance.setter
    def acceleration_variance(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], /) -> None: ...

    @property
    def gain(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]:
        """(6, 6) at the start."""

    @gain.setter
    def gain(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')], /) -> None: ...

    @property
    def offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]:
        """(6,) at the start."""

    @offset.setter
    def offset(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], /) -> None: ...

    @property
    def parameter_covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(42, 42), order='F')]:
        """(42, 42) of [gain row by row, offset] at the start."""

    @parameter_covariance.setter
    def parameter_covariance(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(42, 42), order='F')], /) -> None: ...

class EkfRecord:
    """What the filter leaves of a record of N rows."""

    @property
    def state(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """(48,) or (54,): nu, a, gain row by row and offset."""

    @property
    def covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """Of the state."""

    @property
    def innovation(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """(N, 12): channels, twist; NaN where there is no sample."""

    @property
    def nis(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """(N,) innovation^T S^-1 innovation."""

    @property
    def degrees_of_freedom(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')]:
        """(N,) samples used in each row."""

    @property
    def history_row(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')]:
        """(M,) rows of history_gain."""

    @property
    def history_gain(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """(M, 36) gain row by row after those rows."""

    @property
    def status(self) -> Status: ...

    @property
    def rows_done(self) -> int:
        """Rows taken in before `status` stopped the filter."""

def ekf_run(payload: Payload, settings: EkfSettings, with_offset: bool, time_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], raw: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], twist: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], gravity: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], history_every: int = 1) -> EkfRecord:
    """
    Run the published filter over a record: time (N,) int64, raw (N, 6), twist (N, 6) of the centre of mass and
    gravity (N, 3) in sensor axes. NaN in raw or twist: no sample there.
    """

class Corrector:
    """Raw channels to the true wrench and its uncertainty."""

    @overload
    def __init__(self) -> None:
        """
        Without a calibration: `status` says so, and correcting raises ValueError.
        """

    @overload
    def __init__(self, gain: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], noise: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], covariance: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], quadratic: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] = ..., discrepancy: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] = ...) -> None:
        """
        gain (n, 6), offset (n,), 1-sigma noise per sample (n,) and the covariance (7n, 7n) of [gain row by row,
        offset]; quadratic (n,), 1 sigma of a channel's departure from linear over (raw - offset)^2;
        discrepancy (n,), 1 sigma of a sample beside the noise. Raises ValueError when the gain cannot be inverted.
        """

    @property
    def status(self) -> Status:
        """`ok`, or `not_configured` without a calibration."""

    def correct(self, raw: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')]]:
        """
        The true wrench (N, 6) [N, N m] of raw samples (N, n), and its 1 sigma (N, 6); NaN where a channel has none.
        """

    def covariance(self, wrench: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]:
        """Covariance (6, 6) of one corrected wrench (6,)."""

contact_limit: float = 48.4

FARTHEST_NS: int = 4611686016427387904

PACKETS_APART: int = 250000000

PACKETS_CLOSE: float = 0.1

PACKETS_SHARE: float = 0.4

PACKETS_LEARNED: int = 64

class ContactSettings:
    """What is known of sensor and tool (truewrench.tool.Tool)."""

    def __init__(self) -> None: ...

    def set_sensor(self, gain: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], noise: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], payload_on_sensor: bool) -> None: ...

    @property
    def mass(self) -> float: ...

    @mass.setter
    def mass(self, arg: float, /) -> None: ...

    @property
    def center_of_mass(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @center_of_mass.setter
    def center_of_mass(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def S(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]: ...

    @S.setter
    def S(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], /) -> None: ...

    @property
    def mounting(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @mounting.setter
    def mounting(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def tilt(self) -> Annotated[NDArray[numpy.float64], dict(shape=(2), order='C')]: ...

    @tilt.setter
    def tilt(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(2), order='C')], /) -> None: ...

    @property
    def gravity(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @gravity.setter
    def gravity(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @covariance.setter
    def covariance(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], /) -> None: ...

    @property
    def offset_time_ns(self) -> int: ...

    @offset_time_ns.setter
    def offset_time_ns(self, arg: int, /) -> None: ...

    @property
    def offset_walk(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @offset_walk.setter
    def offset_walk(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def pose_repeatability(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @pose_repeatability.setter
    def pose_repeatability(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def slow_error(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @slow_error.setter
    def slow_error(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def time_offset(self) -> float: ...

    @time_offset.setter
    def time_offset(self, arg: float, /) -> None: ...

    @property
    def time_offset_std(self) -> float: ...

    @time_offset_std.setter
    def time_offset_std(self, arg: float, /) -> None: ...

    @property
    def temperature_slope(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @temperature_slope.setter
    def temperature_slope(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def temperature_slope_std(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @temperature_slope_std.setter
    def temperature_slope_std(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def temperature_reference(self) -> float: ...

    @temperature_reference.setter
    def temperature_reference(self, arg: float, /) -> None: ...

    @property
    def quadratic_std(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @quadratic_std.setter
    def quadratic_std(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def full_scale(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @full_scale.setter
    def full_scale(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def twist_noise(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]: ...

    @twist_noise.setter
    def twist_noise(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')], /) -> None: ...

    @property
    def gravity_noise(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')]: ...

    @gravity_noise.setter
    def gravity_noise(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], /) -> None: ...

class ContactRows:
    """Contact wrenches of the rows of a log, in their order."""

    def __init__(self, settings: ContactSettings, window: float, newest: bool, imu: bool = False, capacity: int = 1024) -> None:
        """
        Kernels of `window` seconds around each row, or, `newest`, that end at it.
        """

    def feed(self, time_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], raw: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], twist: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], fall: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], turn: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], temperature: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], twist_noise: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')]]:
        """
        Rows: stamps (N,), channels (N, n), twist (N, 6), free fall (N, 3), R_sensor_root (N, 9), temperature (N,) and,
        or none of it, the covariance of the twist (N, 36). Gives the M rows that have their contact wrench now: their
        numbers (M,), moments (M,), wrench (M, 6), covariance (M, 6, 6), chi2 (M,), R_sensor_root (M, 3, 3), and
        (M,) 1 where its turn about gravity is known, else 0.
        """

    def finish(self) -> tuple[Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')]]:
        """The rows that waited for others, as `feed` gives them."""

    def restart(self) -> None:
        """As if no row had come yet, where stamps begin again; tares stay."""

    def tare(self) -> str:
        """`accepted`, or why not: `in_contact`, `nothing`, `singular`."""

    def ended(self) -> list[tuple[int, int, float, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]]]:
        """
        Events that have ended since the last call: begin and end [ns], peak force [N], point (3,) [m].
        """

    @property
    def in_contact(self) -> bool: ...

    @property
    def lag(self) -> int:
        """Rows after which one has its wrench."""

    @property
    def too_long(self) -> bool: ...

    @property
    def due(self) -> int:
        """
        Number of the row that has its wrench with the latest one, at the earliest; -1: none yet.
        """

    @property
    def delay(self) -> float:
        """The same in seconds."""

    @property
    def theta(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """The parameters, which a tare moves."""

    @property
    def center_of_mass(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

class Source(enum.Enum):
    """What the components of the motion spline are."""

    twist = 0

    imu = 1

    mapped = 2

class MotionStream:
    """Measurements of a derivative of the motion spline (NaN: missing)."""

    def __init__(self) -> None: ...

    @property
    def derivative(self) -> int: ...

    @derivative.setter
    def derivative(self, arg: int, /) -> None: ...

    @property
    def time(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @time.setter
    def time(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def value(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

    @value.setter
    def value(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], /) -> None: ...

    @property
    def sigma(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @sigma.setter
    def sigma(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def group(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')]: ...

    @group.setter
    def group(self, arg: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def bias_prior(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @bias_prior.setter
    def bias_prior(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def time_offset_prior(self) -> float: ...

    @time_offset_prior.setter
    def time_offset_prior(self, arg: float, /) -> None: ...

    @property
    def clock_mean(self) -> float: ...

    @clock_mean.setter
    def clock_mean(self, arg: float, /) -> None: ...

    @property
    def kappa_mean(self) -> float: ...

    @kappa_mean.setter
    def kappa_mean(self, arg: float, /) -> None: ...

    @property
    def half_window(self) -> float: ...

    @half_window.setter
    def half_window(self, arg: float, /) -> None: ...

class RecordedLog:
    """A log as the estimator reads it; channels in fractions of their scale."""

    def __init__(self) -> None: ...

    @property
    def source(self) -> Source: ...

    @source.setter
    def source(self, arg: Source, /) -> None: ...

    @property
    def payload(self) -> Payload: ...

    @payload.setter
    def payload(self, arg: Payload, /) -> None: ...

    @property
    def point(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @point.setter
    def point(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def body(self) -> int: ...

    @body.setter
    def body(self, arg: int, /) -> None: ...

    @property
    def arm(self) -> bool: ...

    @arm.setter
    def arm(self, arg: bool, /) -> None: ...

    @property
    def offset_knots(self) -> list[float]: ...

    @offset_knots.setter
    def offset_knots(self, arg: Sequence[float], /) -> None: ...

    @property
    def offset_walk(self) -> float: ...

    @offset_walk.setter
    def offset_walk(self, arg: float, /) -> None: ...

    @property
    def time(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @time.setter
    def time(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def raw(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

    @raw.setter
    def raw(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], /) -> None: ...

    @property
    def R_sensor_root(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

    @R_sensor_root.setter
    def R_sensor_root(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], /) -> None: ...

    @property
    def own_roots(self) -> list[float]: ...

    @own_roots.setter
    def own_roots(self, arg: Sequence[float], /) -> None: ...

    @property
    def temperature(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @temperature.setter
    def temperature(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def half_window(self) -> float: ...

    @half_window.setter
    def half_window(self, arg: float, /) -> None: ...

    @property
    def clock_set(self) -> float: ...

    @clock_set.setter
    def clock_set(self, arg: float, /) -> None: ...

    @property
    def resolved(self) -> bool: ...

    @resolved.setter
    def resolved(self, arg: bool, /) -> None: ...

    @property
    def motion(self) -> list[MotionStream]: ...

    @motion.setter
    def motion(self, arg: Sequence[MotionStream], /) -> None: ...

    def __copy__(self) -> RecordedLog: ...

    def set_chain(self, chain: Chain, carried: Callable[..., object] | None, gravity: bool) -> None:
        """
        The arm of a mapped motion; `carried`: of times (K,) what `Chain.motion` takes of its root, or None.
        """

class Chain:
    """
    The joints from the root to the sensor frame, as a product of exponentials.
    """

    def __init__(self, xi: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], R: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], p: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> None:
        """
        xi: (M, 6) twists of unit joint speed at q = 0, of the root's origin, root axes; R (3, 3) and p (3,): pose of the
        sensor frame in the root, there.
        """

    @property
    def joints(self) -> int: ...

    def motion(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], qd: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], qdd: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], twist: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], rate: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], R_inertial_root: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
        """
        Motion of the sensor's origin, sensor axes.

        twist, rate (K, 6): of the root's origin, root axes, and its derivative, or none: at rest. R_inertial_root (K, 9)
        row by row, or none. Returns nu (K, 6), a (K, 6), R_sensor_inertial (K, 9) row by row, and the Jacobian
        (K, 12 * 3M), row by row, of [nu; a] by (q, qd, qdd).
        """

class Statement:
    """What a rig states, normalised."""

    def __init__(self) -> None: ...

    @property
    def range(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]: ...

    @range.setter
    def range(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], /) -> None: ...

    @property
    def sign(self) -> float: ...

    @sign.setter
    def sign(self, arg: float, /) -> None: ...

    @property
    def noise(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @noise.setter
    def noise(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def nominal(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

    @nominal.setter
    def nominal(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], /) -> None: ...

    @property
    def gain_prior(self) -> float: ...

    @gain_prior.setter
    def gain_prior(self, arg: float, /) -> None: ...

    @property
    def offset_prior(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @offset_prior.setter
    def offset_prior(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def pool_offsets(self) -> bool: ...

    @pool_offsets.setter
    def pool_offsets(self, arg: bool, /) -> None: ...

    @property
    def gravity(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @gravity.setter
    def gravity(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def tilt_prior(self) -> float: ...

    @tilt_prior.setter
    def tilt_prior(self, arg: float, /) -> None: ...

    @property
    def gamma_mean(self) -> float: ...

    @gamma_mean.setter
    def gamma_mean(self, arg: float, /) -> None: ...

    @property
    def slope_prior(self) -> float: ...

    @slope_prior.setter
    def slope_prior(self, arg: float, /) -> None: ...

    @property
    def body_prior(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]]: ...

    @body_prior.setter
    def body_prior(self, arg: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]], /) -> None: ...

class Form(enum.Enum):
    """Where the discrepancy's process comes from."""

    none = 0

    matern = 1

    walk = 2

    bridge = 3

class Sizes:
    """The sizes of one log's nuisances."""

    @property
    def raw_factor(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @raw_factor.setter
    def raw_factor(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def motion_factor(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]: ...

    @motion_factor.setter
    def motion_factor(self, arg: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], /) -> None: ...

    @property
    def q(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @q.setter
    def q(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def delta(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @delta.setter
    def delta(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def cap(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @cap.setter
    def cap(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def k(self) -> float: ...

    @k.setter
    def k(self, arg: float, /) -> None: ...

    @property
    def form(self) -> Form: ...

    @form.setter
    def form(self, arg: Form, /) -> None: ...

class Columns:
    """Where the parameters of one log stand; -1: there is none."""

    @property
    def C(self) -> int: ...

    @property
    def b(self) -> int: ...

    @property
    def u(self) -> int: ...

    @property
    def body_in_theta(self) -> int: ...

    @property
    def slope(self) -> int: ...

    @property
    def tilt(self) -> int: ...

    @property
    def roots(self) -> list[float]: ...

    @property
    def gamma(self) -> int: ...

    @property
    def clock(self) -> list[int]: ...

    @property
    def bias(self) -> list[int]: ...

    @property
    def ramps(self) -> list[int]: ...

    @property
    def steps(self) -> list[int]: ...

    @property
    def step_times(self) -> list[float]: ...

    @property
    def at(self) -> list[int]:
        """Places in theta."""

class Moment:
    """Size of a slow discrepancy by moments, of one group of channels."""

    @property
    def tau(self) -> float: ...

    @property
    def delta2(self) -> float: ...

    @property
    def sd(self) -> float: ...

    @property
    def z(self) -> float: ...

class Agreement:
    """Whether two parts of a record agree."""

    @property
    def p(self) -> float: ...

    @property
    def chi2(self) -> float: ...

    @property
    def freedom(self) -> int: ...

class PoseShare:
    """How far a force that follows the pose can hide in the gain."""

    def __init__(self, A: float, ww: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]) -> None: ...

    @property
    def A(self) -> float: ...

    @property
    def ww(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]: ...

    @property
    def period(self) -> float: ...

    @property
    def unit_covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')]:
        """
        A / (1 - A) (E w w^T)^-1 / 6 (6, 6) of (10.10): of a row of C, for a force of unit size.
        """

def pose_share(time: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], twist: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], wrench: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], arm: bool = False) -> PoseShare:
    """
    Of one gap-free record: times (N,) [s], twist (N, 6) of the sensor in its axes, wrench (N, 6) over the range; arm: its motion is one's.
    """

def with_pose(covariance: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], prior: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], share: PoseShare, size2: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]:
    """
    The covariance (6n, 6n) of the normalised gain, row by row, with (10.10), for a force of variance size2 (n,) in every channel; no variance rises above its prior's (6n,).
    """

class Fit:
    """One fit of the model to one or several logs."""

    @property
    def theta(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @theta.setter
    def theta(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def failed(self) -> bool: ...

    @property
    def prior(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @prior.setter
    def prior(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def lagged(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

    @lagged.setter
    def lagged(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], /) -> None: ...

    @property
    def deviance(self) -> float: ...

    @property
    def iterations(self) -> int: ...

    @property
    def converged(self) -> bool: ...

    @property
    def mean(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def stated(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def active(self) -> list[int]: ...

    @property
    def P(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def S(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def step(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def columns(self, arg: int, /) -> Columns: ...

    def sizes(self, arg: int, /) -> Sizes: ...

    def spacing(self, arg: int, /) -> float: ...

    def pieces(self, arg: int, /) -> list[list[float]]: ...

    def motion(self, arg0: int, arg1: int, /) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

    def set_motion(self, arg0: int, arg1: int, arg2: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], /) -> None: ...

    def discrepancy(self, arg0: int, arg1: int, /) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

    def set_discrepancy(self, arg0: int, arg1: int, arg2: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], /) -> None: ...

    def set_mask(self, arg0: int, arg1: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C')], /) -> None: ...

    def predict(self) -> None: ...

    def reweigh(self) -> None: ...

    def linearise(self) -> bool: ...

    def solve(self, frozen: bool = False) -> bool: ...

    def advance(self, share: float = 1.0) -> None: ...

    def resize(self) -> float: ...

    def run(self) -> None: ...

    def objective(self) -> float: ...

    def likelihood(self) -> float: ...

    def log_determinant(self) -> float: ...

    def slope_of_determinant(self, places: Sequence[int]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """d log |H_xx| / d theta at places of theta."""

    def traces(self, log: int, stretch: int, /) -> dict[str, object]: ...

    def gradient(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def rows(self, log: int, /) -> dict[str, object]: ...

    def motion_residual(self, arg0: int, arg1: int, /) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

def make_fit(rig: Statement, logs: Sequence[RecordedLog], h: Sequence[float], steps: Sequence[Sequence[float]], form: Form = Form.none) -> Fit:
    """A fit of given knots that stands at START: for tests, stage by stage."""

def fit_of_sizes(rig: Statement, logs: Sequence[RecordedLog], h: Sequence[float], sizes: Sequence[Sizes]) -> Fit:
    """
    A fit of given knots and sizes: its motion that of its own measurements, theta at its prior's mean.
    """

class Settings:
    """Of the estimator."""

    def __init__(self) -> None: ...

    @property
    def threads(self) -> int: ...

    @threads.setter
    def threads(self, arg: int, /) -> None: ...

    @property
    def discrepancy(self) -> float: ...

    @discrepancy.setter
    def discrepancy(self, arg: float, /) -> None: ...

    @property
    def brief(self) -> bool: ...

    @brief.setter
    def brief(self, arg: bool, /) -> None: ...

class Estimate:
    """What the estimator found."""

    @property
    def fit(self) -> Fit: ...

    @property
    def status(self) -> Status: ...

    @property
    def moments(self) -> list[list[Moment]]: ...

    @property
    def covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def added(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def gain_covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def discrepancy2(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def pose(self) -> PoseShare: ...

    @property
    def halves(self) -> Agreement: ...

    @property
    def quarters(self) -> Agreement: ...

    @property
    def logs(self) -> list[Agreement]: ...

    @property
    def unresolved(self) -> list[bool]: ...

    @property
    def unexplained(self) -> list[float]: ...

    @property
    def dropped(self) -> list[int]: ...

    @property
    def fits(self) -> int: ...

MOST_LOST: float = 0.2

DEPARTURE_FLOOR: float = 0.0001

DOUBT: float = 0.001

UNDETERMINED: float = 0.5

NOISE_TOLD: float = 2.0

MASK_SHORTEST: float = 0.03

def coarsest_spacing(period: float) -> float:
    """h of (10.2) at its coarsest [s], for this period of the motion [s]."""

def estimate(rig: Statement, logs: Sequence[RecordedLog], settings: Settings) -> Estimate: ...

class Part:
    """The fit of a part of a long record, put away."""

    def settle(self, log: RecordedLog, first: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> bool:
        """
        At these values of the first parameters, with a step of all from there.
        """

    @property
    def theta(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """Where the step leads."""

    @property
    def covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

def put_away(found: Estimate) -> Part:
    """The fit behind an estimate of one log, which has none from here on."""

class IncrementalSettings:
    """Of the estimator as samples arrive."""

    def __init__(self) -> None: ...

    @property
    def lag(self) -> float: ...

    @lag.setter
    def lag(self, arg: float, /) -> None: ...

    @property
    def rate(self) -> float: ...

    @rate.setter
    def rate(self, arg: float, /) -> None: ...

    @property
    def spacing(self) -> float: ...

    @spacing.setter
    def spacing(self, arg: float, /) -> None: ...

    @property
    def finest(self) -> float: ...

    @finest.setter
    def finest(self, arg: float, /) -> None: ...

    @property
    def discrepancy(self) -> float: ...

    @discrepancy.setter
    def discrepancy(self, arg: float, /) -> None: ...

class Incremental:
    """The estimator as samples arrive: fixed lag, fixed memory."""

    def __init__(self, rig: Statement, about: RecordedLog, settings: IncrementalSettings) -> None: ...

    def push_motion(self, stream: int, time: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], value: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> list[Status]: ...

    def push_raw(self, time: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], raw: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], R_sensor_root: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)] | None = None) -> list[Status]: ...

    def finish(self) -> Status: ...

    def next_log(self, arg: RecordedLog, /) -> Status: ...

    @property
    def status(self) -> Status: ...

    @property
    def gain(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]: ...

class OnlineEstimate:
    """What the estimator found as samples arrived."""

    @property
    def status(self) -> Status: ...

    @property
    def theta(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def mean(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def prior(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def active(self) -> list[int]: ...

    @property
    def covariance(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]]: ...

    @property
    def added(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def gain_covariance(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]: ...

    @property
    def discrepancy2(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def moments(self) -> list[list[Moment]]: ...

    @property
    def pose(self) -> PoseShare: ...

    @property
    def halves(self) -> Agreement: ...

    @property
    def quarters(self) -> Agreement: ...

    @property
    def logs(self) -> list[Agreement]: ...

    @property
    def unresolved(self) -> list[bool]: ...

    @property
    def dropped(self) -> list[int]: ...

    @property
    def spacing(self) -> list[float]: ...

    @property
    def sizes(self) -> list[Sizes]: ...

    @property
    def own(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]: ...

    @property
    def tilts(self) -> list[list[float]]: ...

    @property
    def masked(self) -> list[Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C')]]: ...

    @property
    def history_time(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]: ...

    @property
    def history_gain(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]: ...

    @property
    def samples(self) -> list[int]: ...

    @property
    def columns(self) -> list[Columns]: ...

    @property
    def blocks(self) -> int: ...

def estimate_online(rig: Statement, logs: Sequence[RecordedLog], settings: IncrementalSettings) -> OnlineEstimate:
    """
    Logs through the estimator as samples arrive, each in the order of time.
    """

variant: str
"""Which variant is loaded: baseline or avx2."""
