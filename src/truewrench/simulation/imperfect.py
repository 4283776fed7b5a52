"""Imperfect hardware: ``simulate.imperfections`` of a rig, drawn from the seed and applied to ideal signals.

The order is that of the hardware. Cable, vibration and contact are wrenches that reach the sensor beside the
payload's; the element that feels them is not linear and lags behind; its offset drifts, walks and jumps; the
sensor's filter smooths all of it and the noise; then samples are taken, late or early by the jitter, and some
are wrong. The logged motion is filtered, read with a jitter of its own, and rounded.

Whatever does not depend on the samples is computed at `FINE` or faster and added to the ideal signals, which
stay exact: without imperfections a log has the bits that it always had. Every kind draws from a generator of
its own, so that one kind changes nothing that another draws.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.model.rig.imperfections import FilterSpec, ImperfectionsSpec
from truewrench.simulation.effects import (
    LowPass,
    dahl,
    half_sine,
    nonlinearity,
    play,
    pose_force,
    products,
    wandering,
)

Rng = np.random.Generator

FINE = 1000.0  # [Hz] rate of the truth, at least

_SETTLING = 8.0  # [s] of a drift
_PER_PERIOD = 40.0  # samples of the truth, of a vibration: linear between them to 0.3%
_VIBRATION = (12.0, 40.0)  # [Hz] where the rig leaves it open
_CONTACT = (0.2, 2.0)  # [s], log-uniform
_LONGEST = 0.4  # of the record, of a drawn contact
_WHEN = (0.15, 0.85)  # of the record, of a drawn step; a drawn contact begins and ends within
_CONTINUOUS = {  # kinds that need the truth between the samples
    *("hysteresis", "nonlinearity", "cable", "drift", "random_walk", "vibration", "contact", "step"),
    *("velocity_filter", "sensor_filter"),
}


@dataclass(frozen=True, slots=True, eq=False)
class FineMotion:
    """The ideal run at ``Hardware.fine_time``, F samples."""

    wrench: Array  # (F, 6) of the payload on the sensor, sensor axes [N, N m]
    velocity: Array  # (F, d) what is logged of the motion: twist or joint velocities
    pose: Array  # (F, d) what a cable follows: the twist's integral by component, or joint positions


@dataclass(frozen=True, slots=True, eq=False)
class Readout:
    """What the hardware makes of ideal signals, at the samples of one log."""

    departure: Array | float = 0.0  # (M, n) of the channels at the sensor's samples [raw units]
    lag: Array | float = 0.0  # (K, d) of the velocities at the samples of the motion
    sensor_filter: LowPass | None = None  # that the sensor's noise passes
    rate: float = 0.0  # of the sensor [Hz]
    seed: int = 0  # of the run
    noise: float = 1.0  # factor on the stated noise
    quantisation: float = 0.0  # steps of the logged motion, in sigmas
    # the imperfections as applied, with all that was drawn, as LOG.truth.yaml holds them
    told: Mapping[str, Any] = field(default_factory=dict)

    def channels(self, ideal: Array, noise: Array) -> Array:
        """Raw channels (M, n) from ideal ones and the sensor's white noise (M, n) of the stated size."""
        if self.sensor_filter is not None:
            noise = self.sensor_filter.of_noise(noise, self.rate, _rng(self.seed, "sensor_filter"))
        return np.asarray(ideal + self.departure + self.noise * noise)

    def velocity(self, ideal: Array, sigma: Array, white: Array) -> Array:
        """Logged velocities (K, d) from true ones at the times that are read, and unit white noise."""
        return self.position(ideal + self.lag, sigma, white)

    def position(self, ideal: Array, sigma: Array, white: Array) -> Array:
        """Logged positions (K, d), likewise; 1 sigma (d,)."""
        noisy = ideal + self.noise * (sigma * white)
        if self.quantisation == 0.0:
            return np.asarray(noisy)
        grid = self.quantisation * sigma
        return np.asarray(np.round(noisy / grid) * grid)


@dataclass(frozen=True, slots=True)
class Hardware:
    """The hardware of one simulated run."""

    rig: Rig  # its ``simulate.imperfections`` say what is imperfect
    seed: int  # of the run
    duration: float  # of the motion [s]

    def __post_init__(self) -> None:
        """Refuse what would begin after the motion ends."""
        step, contact = self.spec.step, self.spec.contact
        for place, begin in (
            ("step.time", None if step is None else step.time),
            ("contact.start", None if contact is None else contact.start),
        ):
            if begin is not None and begin >= self.duration:
                where, expected = _at(place), f"less than the {self.duration:g} s of motion"
                raise InputError.at(self.rig.path, where, f"{begin:g} s", expected)

    @property
    def spec(self) -> ImperfectionsSpec:
        """What is imperfect."""
        return self.rig.simulate.imperfections or ImperfectionsSpec()

    @property
    def fine_time(self) -> Array:
        """(F,) times from 0 to the end of the motion [s]; none where samples are all that is needed."""
        if _CONTINUOUS.isdisjoint(self.spec.stated):
            return np.zeros(0)
        return np.linspace(0.0, self.duration, 1 + int(np.ceil(self.duration * self._least_rate())))

    def _least_rate(self) -> float:
        options, rate = self.rig.simulate, FINE
        if self.spec.vibration is not None:
            rate = max(rate, _PER_PERIOD * self._vibration_hz())
        return max(rate, options.rate, options.sensor_rate)

    @property
    def gravity(self) -> Array:
        """(3,) true acceleration of free fall in the root frame [m/s^2]: the stated one, tilted."""
        stated = self.rig.gravity_array
        if self.spec.gravity_tilt is None:
            return stated
        return np.asarray(Rotation.from_rotvec(self._tilt()).apply(stated))

    def _tilt(self) -> Array:
        """Rotation vector (3,) [rad], perpendicular to gravity, root axes."""
        down = self.rig.gravity_array / np.linalg.norm(self.rig.gravity_array)
        first = np.cross(down, np.eye(3)[np.argmin(np.abs(down))])
        first /= np.linalg.norm(first)
        rng, size = _rng(self.seed, "gravity_tilt"), self.spec.gravity_tilt
        if size == "random":
            about = self.rig.gravity_tilt_prior * rng.standard_normal(2)
        else:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            about = np.array([np.cos(angle), np.sin(angle)]) * (size or 0.0)
        return np.asarray(about[0] * first + about[1] * np.cross(down, first))

    def read_at(self, time: Array, stream: Literal["sensor", "motion"]) -> Array:
        """Times (N,) that a stream's samples show, meant for the times (N,); within the motion [s]."""
        if self.spec.jitter is None:
            return time
        off = self.spec.jitter * _rng(self.seed, f"jitter {stream}").standard_normal(time.size)
        return np.clip(time + off, 0.0, self.duration)

    def readout(self, gain: Array, fine: FineMotion, shown: Array, read: Array) -> Readout:
        """What becomes of the signals of a run with the true gain (n, 6).

        The ideal run is that at `fine_time`. The samples of the sensor show the times (M,), and those of the
        motion are read at (K,) [s]. InputError: a cable where nothing moves.
        """
        spec, time = self.spec, self.fine_time
        told: dict[str, Any] = {}
        departure: Array | float = 0.0
        lag: Array | float = 0.0
        if time.size:
            departure = _between(time, self._channels(gain, time, fine, told), shown)
        if spec.spikes is not None:
            departure = departure + self._spikes(shown.size, told)
        if spec.velocity_filter is not None:
            slow = _filter(spec.velocity_filter).of_motion(fine.velocity, 1.0 / time[1])
            lag = _between(time, slow - fine.velocity, read)
        if spec.gravity_tilt is not None:
            tilt = self._tilt()
            told["gravity_tilt"] = {"angle": float(np.linalg.norm(tilt)), "gravity": self.gravity.tolist()}
        stated = spec.model_dump(exclude_none=True)
        return Readout(
            departure=departure,
            lag=lag,
            sensor_filter=None if spec.sensor_filter is None else _filter(spec.sensor_filter),
            rate=self.rig.simulate.sensor_rate,
            seed=self.seed,
            noise=1.0 if spec.noise is None else spec.noise,
            quantisation=spec.quantisation or 0.0,
            told={kind: told.get(kind, stated[kind]) for kind in spec.stated},
        )

    def _channels(self, gain: Array, time: Array, fine: FineMotion, told: dict[str, Any]) -> Array:
        """Departures (F, n) of the channels from ``gain @ w + offset`` [raw units]."""
        spec, sensor = self.spec, self.rig.sensor
        scale, rate = sensor.channel_scale, 1.0 / time[1]
        normalised = gain / sensor.gain_unit
        load = sensor.sign * fine.wrench / sensor.range_array  # fractions of range from here on
        ideal = load @ normalised.T
        load = load + self._forces(time, fine, told)
        signal = load @ normalised.T
        if spec.nonlinearity is not None:
            own = np.argmax(np.abs(sensor.nominal_gain_array) * sensor.range_array, axis=1)
            coefficients = nonlinearity(own, _rng(self.seed, "nonlinearity"))
            signal = signal + spec.nonlinearity * products(load) @ coefficients.T
            told["nonlinearity"] = {"size": spec.nonlinearity, "coefficients": coefficients.tolist()}
        if spec.hysteresis is not None:
            size = spec.hysteresis.size
            played = spec.hysteresis.form == "play"
            signal = play(signal, size) if played else signal + dahl(signal, size)
        signal = signal + self._offsets(time, told)
        departure = np.asarray(signal - ideal)
        if spec.sensor_filter is not None:
            low_pass = _filter(spec.sensor_filter)
            late = low_pass.of_motion(ideal, rate) - ideal
            departure = late + low_pass.of_rough(departure, rate)
        return departure * scale

    def _forces(self, time: Array, fine: FineMotion, told: dict[str, Any]) -> Array:
        """Wrench (F, 6) on the sensor beside the payload's, fractions of range."""
        spec, total = self.spec, np.zeros((time.size, 6))
        if spec.cable is not None:
            found = pose_force(fine.pose, _rng(self.seed, "cable"))
            if found is None:
                expected = "a motion: nothing moves that a cable could follow"
                raise InputError.at(self.rig.path, _at("cable"), f"{spec.cable:g}", expected)
            total += spec.cable * found.force
            linear = (spec.cable * found.linear).tolist()
            told["cable"] = {"size": spec.cable, "linear": linear, "pose_std": found.spread.tolist()}
        if spec.vibration is not None:
            rng, hz = _rng(self.seed, "vibration"), self._vibration_hz()
            total += spec.vibration.size * wandering(time, hz, rng)
            told["vibration"] = {"size": spec.vibration.size, "hz": hz}
        if spec.contact is not None:
            rng = _rng(self.seed, "contact")
            direction = _direction(6, rng)
            start, duration = self._contact(rng)
            total += spec.contact.size * np.outer(half_sine(time, start, duration), direction)
            told["contact"] = {
                "size": spec.contact.size, "start": start, "duration": duration,
                "direction": direction.tolist(),
            }  # fmt: skip
        return total

    def _vibration_hz(self) -> float:
        assert self.spec.vibration is not None
        drawn = float(_rng(self.seed, "vibration hz").uniform(*_VIBRATION))
        return drawn if self.spec.vibration.hz is None else self.spec.vibration.hz

    def _contact(self, rng: Rng) -> tuple[float, float]:
        """Start and duration [s], drawn where the rig leaves them open."""
        assert self.spec.contact is not None
        start, duration = self.spec.contact.start, self.spec.contact.duration
        drawn, share = float(np.exp(rng.uniform(*np.log(_CONTACT)))), float(rng.uniform())
        if duration is None:
            duration = min(drawn, _LONGEST * self.duration)
        if start is None:
            first, last = _WHEN[0] * self.duration, _WHEN[1] * self.duration - duration
            start = first + share * max(0.0, last - first)
        return start, duration

    def _offsets(self, time: Array, told: dict[str, Any]) -> Array:
        """What is added to the offset (F, n), fractions of each channel's scale."""
        spec, n = self.spec, self.rig.sensor.n
        total = np.zeros((time.size, n))
        if spec.drift is not None:
            end = spec.drift * _rng(self.seed, "drift").standard_normal(n)
            total += np.outer(1.0 - np.exp(-time / _SETTLING), end)
            told["drift"] = {"size": spec.drift, "time_constant": _SETTLING, "end": end.tolist()}
        if spec.random_walk is not None:
            # at one rate whatever the truth has, so that the same seed walks the same way
            when = np.linspace(0.0, self.duration, 1 + int(np.ceil(self.duration * FINE)))
            steps = _rng(self.seed, "random_walk").standard_normal((when.size - 1, n))
            walk = np.zeros((when.size, n))
            walk[1:] = spec.random_walk * np.sqrt(when[1]) * np.cumsum(steps, axis=0)
            total += _between(when, walk, time)
            told["random_walk"] = {"size": spec.random_walk, "end": walk[-1].tolist()}
        if spec.step is not None:
            rng = _rng(self.seed, "step")
            direction, share = _direction(n, rng), float(rng.uniform(*_WHEN))
            begin = share * self.duration if spec.step.time is None else spec.step.time
            total += spec.step.size * np.outer(time >= begin, direction)
            told["step"] = {"size": spec.step.size, "time": begin, "direction": direction.tolist()}
        return total

    def _spikes(self, samples: int, told: dict[str, Any]) -> Array:
        """What is added to single samples (M, n) [raw units]."""
        assert self.spec.spikes is not None
        size, share = self.spec.spikes.size, self.spec.spikes.share
        rng, scale = _rng(self.seed, "spikes"), self.rig.sensor.channel_scale
        hit = rng.uniform(size=samples) < share
        told["spikes"] = {"size": size, "share": share, "samples": int(hit.sum())}
        return np.where(hit[:, None], size * scale * rng.standard_normal((samples, scale.size)), 0.0)


def _rng(seed: int, kind: str) -> Rng:
    # named, so that a kind more or less leaves what the others draw
    return np.random.default_rng([seed, *kind.encode()])


def _direction(n: int, rng: Rng) -> Array:
    """(n,) random numbers, the largest 1 or -1."""
    drawn = rng.standard_normal(n)
    return np.asarray(drawn / np.abs(drawn).max())


def _filter(spec: FilterSpec) -> LowPass:
    return LowPass(spec.hz, spec.order)


def _between(time: Array, values: Array, wanted: Array) -> Array:
    """Columns (N, k) at other times, linear between the samples."""
    return np.stack([np.interp(wanted, time, column) for column in values.T], axis=1)


def _at(key: str) -> str:
    return f"simulate.imperfections.{key}"
