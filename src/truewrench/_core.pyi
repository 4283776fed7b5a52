"""
Numerical core of truewrench (C++20). The public face is the truewrench package.
"""

from collections.abc import Sequence
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
    def nis_raw(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """(N,) the part of the channels; the rest is the twist's, given them."""

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
    def __init__(self, gain: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], noise: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], covariance: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]) -> None:
        """
        gain (n, 6), offset (n,), 1-sigma noise per sample (n,) and the covariance (7n, 7n) of [gain row by row,
        offset]. Raises ValueError when the gain cannot be inverted.
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

class WindowStatus(enum.Enum):
    """What became of a window of motion."""

    fitted = 0

    too_short = 1

    motion_undetermined = 2

    not_converged = 3

    misfit = 4

    unresolved = 5

class KnotSettings:
    """How the knots of a window are chosen."""

    def __init__(self) -> None: ...

    @property
    def blocks_per_interval(self) -> int: ...

    @blocks_per_interval.setter
    def blocks_per_interval(self, arg: int, /) -> None: ...

    @property
    def samples_per_coefficient(self) -> float: ...

    @samples_per_coefficient.setter
    def samples_per_coefficient(self, arg: float, /) -> None: ...

    @property
    def interval_sigma(self) -> float: ...

    @interval_sigma.setter
    def interval_sigma(self, arg: float, /) -> None: ...

    @property
    def window_sigma(self) -> float: ...

    @window_sigma.setter
    def window_sigma(self, arg: float, /) -> None: ...

    @property
    def residual_sigma(self) -> float: ...

    @residual_sigma.setter
    def residual_sigma(self, arg: float, /) -> None: ...

    @property
    def reject_sigma(self) -> float: ...

    @reject_sigma.setter
    def reject_sigma(self, arg: float, /) -> None: ...

    @property
    def max_iterations(self) -> int: ...

    @max_iterations.setter
    def max_iterations(self, arg: int, /) -> None: ...

    @property
    def tolerance(self) -> float: ...

    @tolerance.setter
    def tolerance(self, arg: float, /) -> None: ...

    @property
    def max_levels(self) -> int: ...

    @max_levels.setter
    def max_levels(self, arg: int, /) -> None: ...

    @property
    def false_disturbances(self) -> float: ...

    @false_disturbances.setter
    def false_disturbances(self, arg: float, /) -> None: ...

    @property
    def false_pushes(self) -> float: ...

    @false_pushes.setter
    def false_pushes(self, arg: float, /) -> None: ...

    @property
    def disturbance_price(self) -> float: ...

    @disturbance_price.setter
    def disturbance_price(self, arg: float, /) -> None: ...

    @property
    def hopeless_sigma(self) -> float: ...

    @hopeless_sigma.setter
    def hopeless_sigma(self, arg: float, /) -> None: ...

    @property
    def hopeless_share(self) -> float: ...

    @hopeless_share.setter
    def hopeless_share(self, arg: float, /) -> None: ...

    @property
    def most_disturbed(self) -> float: ...

    @most_disturbed.setter
    def most_disturbed(self, arg: float, /) -> None: ...

class EstimatorSettings:
    """Settings of the window estimators, with their defaults."""

    def __init__(self) -> None: ...

    @property
    def knots(self) -> KnotSettings: ...

    @knots.setter
    def knots(self, arg: KnotSettings, /) -> None: ...

    @property
    def window(self) -> float: ...

    @window.setter
    def window(self, arg: float, /) -> None: ...

    @property
    def window_intervals(self) -> int: ...

    @window_intervals.setter
    def window_intervals(self, arg: int, /) -> None: ...

    @property
    def map_window_intervals(self) -> int: ...

    @map_window_intervals.setter
    def map_window_intervals(self, arg: int, /) -> None: ...

    @property
    def gap_periods(self) -> float: ...

    @gap_periods.setter
    def gap_periods(self, arg: float, /) -> None: ...

    @property
    def dependence_sigma(self) -> float: ...

    @dependence_sigma.setter
    def dependence_sigma(self, arg: float, /) -> None: ...

    @property
    def enough_fitted(self) -> float: ...

    @enough_fitted.setter
    def enough_fitted(self, arg: float, /) -> None: ...

    @property
    def few_samples(self) -> float: ...

    @few_samples.setter
    def few_samples(self, arg: float, /) -> None: ...

    @property
    def max_rounds(self) -> int: ...

    @max_rounds.setter
    def max_rounds(self, arg: int, /) -> None: ...

    @property
    def max_iterations(self) -> int: ...

    @max_iterations.setter
    def max_iterations(self, arg: int, /) -> None: ...

    @property
    def tolerance(self) -> float: ...

    @tolerance.setter
    def tolerance(self, arg: float, /) -> None: ...

    @property
    def settled(self) -> float: ...

    @settled.setter
    def settled(self, arg: float, /) -> None: ...

    @property
    def threads(self) -> int: ...

    @threads.setter
    def threads(self, arg: int, /) -> None: ...

class ParameterLayout:
    """
    Which common parameters a log has: [gains row by row | payload | slope with temperature | offset | time offset].
    """

    def __init__(self) -> None: ...

    @property
    def channels(self) -> int: ...

    @channels.setter
    def channels(self, arg: int, /) -> None: ...

    @property
    def payload(self) -> bool: ...

    @payload.setter
    def payload(self, arg: bool, /) -> None: ...

    @property
    def temperature(self) -> bool: ...

    @temperature.setter
    def temperature(self, arg: bool, /) -> None: ...

    @property
    def offset(self) -> bool: ...

    @offset.setter
    def offset(self, arg: bool, /) -> None: ...

    @property
    def pool_offsets(self) -> bool: ...

    @pool_offsets.setter
    def pool_offsets(self, arg: bool, /) -> None: ...

    @property
    def time_offset(self) -> bool: ...

    @time_offset.setter
    def time_offset(self, arg: bool, /) -> None: ...

    @property
    def payload_begin(self) -> int: ...

    @property
    def temperature_begin(self) -> int: ...

    @property
    def offset_begin(self) -> int: ...

    @property
    def time_offset_begin(self) -> int: ...

    @property
    def size(self) -> int: ...

class CommonPrior:
    """Independent priors of the common parameters, normalised."""

    def __init__(self) -> None: ...

    @property
    def layout(self) -> ParameterLayout: ...

    @layout.setter
    def layout(self, arg: ParameterLayout, /) -> None: ...

    @property
    def mean(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """Of one log's vector."""

    @mean.setter
    def mean(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def information(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """1 / variance; the payload's entries are not used."""

    @information.setter
    def information(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], /) -> None: ...

    @property
    def gains_walk(self) -> bool:
        """Every log has gains of its own."""

    @gains_walk.setter
    def gains_walk(self, arg: bool, /) -> None: ...

    @property
    def links(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]:
        """
        Per log, 1 / variance of the step of its own parameters from those of the log before, 0 where there is none; or an empty vector.
        """

    @links.setter
    def links(self, arg: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], /) -> None: ...

    @property
    def payload_of(self) -> list[int]:
        """Per log: which payload it carries."""

    @payload_of.setter
    def payload_of(self, arg: Sequence[int], /) -> None: ...

    @property
    def payload_information(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]:
        """
        Per payload, 1 / variance of [mass, relative; centre of mass [m]; xx yy zz xy xz yz of the inertia, relative to sqrt(I_ii I_jj)].
        """

    @payload_information.setter
    def payload_information(self, arg: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], /) -> None: ...

class RecordedLog:
    """The streams of one log, each at its own times [s]."""

    def __init__(self) -> None: ...

    @property
    def payload(self) -> Payload:
        """As stated."""

    @payload.setter
    def payload(self, arg: Payload, /) -> None: ...

    @property
    def point(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]:
        """The point whose twist is logged, fixed to the sensor [m]."""

    @point.setter
    def point(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def gravity_constant(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @gravity_constant.setter
    def gravity_constant(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    def add_motion(self, order: int, time: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], value: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], sigma: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], combination: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='F')] | None = None, covariance: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None), order='C', device='cpu', writable=False)] | None = None, coupling: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        Measurements (N, 6) of the order-th derivative of the twist, or about a reference of the displacement, or of a combination (6, 6) of its components; NaN where missing. `covariance` (N, 6, 6) instead of sigma; `coupling` (N, 6, 6): plus so much of the derivative of the order below.
        """

    def set_reference(self, breakpoints: Sequence[float], twist: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], spacing: float) -> None:
        """
        The motion is then a displacement from this one: coefficients (K + 5, 6) of the quintic spline of the logged point's twist, and the spacing of the knots of the fit behind it [s].
        """

    def set_wrench(self, time: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], raw: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], temperature: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        Raw sensor samples (N, n), NaN where missing, and the departure from the reference temperature (N,) [K].
        """

    def set_gravity(self, time: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], value: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> None:
        """Gravity (N, 3) in sensor axes on the clock of the motion."""

class GroupStatistics:
    """Residuals of one stream against their noise."""

    @property
    def sum_of_squares(self) -> float: ...

    @property
    def count(self) -> float: ...

    @property
    def leverage(self) -> float: ...

    @property
    def deviate(self) -> float: ...

class ComponentStatistics:
    """
    Residuals of one channel or component of the motion over their noise, and of their means over runs of 2, 4, 8 ... samples.
    """

    @property
    def all(self) -> GroupStatistics: ...

    @property
    def run_squares(self) -> list[float]: ...

    @property
    def runs(self) -> list[float]: ...

class WindowReport:
    """One window: where it lies, its knots and how well it fits."""

    @property
    def log(self) -> int: ...

    @log.setter
    def log(self, arg: int, /) -> None: ...

    @property
    def begin(self) -> float: ...

    @property
    def end(self) -> float: ...

    @property
    def status(self) -> WindowStatus: ...

    @property
    def intervals(self) -> int: ...

    @property
    def samples_per_coefficient(self) -> float: ...

    @property
    def samples(self) -> int: ...

    @property
    def groups(self) -> list[GroupStatistics]: ...

    @property
    def components(self) -> list[ComponentStatistics]:
        """
        ComponentStatistics of the channels, then of the six components of the motion; empty for a window without a fit.
        """

    @property
    def nested(self) -> float: ...

    @property
    def nested_expected(self) -> float: ...

class HistoryEntry:
    """The common parameters after a window of `online`, normalised."""

    @property
    def log(self) -> int: ...

    @log.setter
    def log(self, arg: int, /) -> None: ...

    @property
    def time(self) -> float: ...

    @property
    def mean(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    @property
    def sigma(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

class Estimate:
    """
    Result of `online` or `map`, normalised: the common parameters of every log.
    """

    @property
    def solved(self) -> bool: ...

    @property
    def converged(self) -> bool: ...

    @property
    def mean(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]: ...

    @property
    def covariance(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]]: ...

    @property
    def windows(self) -> list[WindowReport]: ...

    @property
    def history(self) -> list[HistoryEntry]: ...

    @property
    def wrench(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
        """
        Per log: the payload's wrench (rows of set_wrench, 6), SI, NaN where no window fits.
        """

    @property
    def left_out(self) -> list[Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C')]]:
        """Per log: whether a row of set_wrench was left out as a disturbance."""

    @property
    def motion_left_out(self) -> list[list[int]]:
        """
        Per log and series of the motion: how many rows were left out as disturbances.
        """

    @property
    def knot_dependence(self) -> float: ...

    @property
    def window_dependence(self) -> float: ...

    @property
    def spacing(self) -> list[float]:
        """Per log: typical knot spacing [s]."""

    @property
    def iterations(self) -> int: ...

class Start:
    """Where `map` may begin: per log."""

    def __init__(self) -> None: ...

    @property
    def mean(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]:
        """Common parameters, normalised."""

    @mean.setter
    def mean(self, arg: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], /) -> None: ...

    @property
    def covariance(self) -> list[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]]:
        """Of them."""

    @covariance.setter
    def covariance(self, arg: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]], /) -> None: ...

    @property
    def spacing(self) -> list[float]:
        """Of the knots [s]."""

    @spacing.setter
    def spacing(self, arg: Sequence[float], /) -> None: ...

def estimate(method: str, logs: Sequence[RecordedLog], channel_scale: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], sigma: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], wrench_scale: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], prior: CommonPrior, settings: EstimatorSettings, start: Start | None = None) -> Estimate:
    """
    Estimate the normalised gain and what else is common from windows of motion ('online' or 'map').
    """

variant: str
"""Which variant is loaded: baseline or avx2."""
