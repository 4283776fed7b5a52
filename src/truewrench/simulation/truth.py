"""What every simulated log shares: the truth behind it, its stamps, what the sensor reads, its files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.io.table import GRAVITY, TWIST
from truewrench.io.tables import write_table
from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.files import write_yaml
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import Body
from truewrench.model.rig import PayloadSpec, Rig
from truewrench.model.rig.fields import Fields
from truewrench.model.rig.sections import COLUMNS, ELEMENTS, ROWS, symmetric
from truewrench.simulation.imperfect import Readout

_PERFECT = Readout()
_MOST_ROWS = 1e8  # a day at 1 kHz
_NO_ERROR = 1e-6  # sigma, over the largest: a direction without any


@dataclass(frozen=True, slots=True)
class Truth:
    """What a log was made with: gain (n, 6) and offset (n,) [raw units], clock offset [s], payloads.

    `imperfections` holds those of the hardware as applied, by kind, with all that was drawn
    (docs/imperfections.md); gain and offset are what they come on top of.
    """

    gain: Array
    offset: Array
    time_offset: float
    payloads: dict[str, Body]
    seed: int
    imperfections: Mapping[str, Any] = field(default_factory=dict)

    def to_mapping(self) -> dict[str, Any]:
        """Plain numbers and lists, as LOG.truth.yaml holds them."""
        imperfect = {"imperfections": dict(self.imperfections)} if self.imperfections else {}
        return {
            "gain": self.gain.tolist(),
            "offset": self.offset.tolist(),
            "time_offset": self.time_offset,
            "payloads": {
                name: {
                    "mass": body.mass,
                    "center_of_mass": body.center_of_mass.tolist(),
                    "inertia": dict(zip(ELEMENTS, body.inertia[ROWS, COLUMNS].tolist(), strict=True)),
                }
                for name, body in self.payloads.items()
            },
            "seed": self.seed,
            **imperfect,
        }


def read_truth(path: str | Path) -> Truth:
    """Read a LOG.truth.yaml.

    Raises:
        InputError: naming file, line, key, what was found and what was expected.
    """
    fields = Fields.of_file(path)
    n = len(fields.get("offset"))
    payloads = {}
    for name in fields.section("payloads").data:
        body = fields.section("payloads").section(name)
        inertia = symmetric(np.array([body.section("inertia").number(element) for element in ELEMENTS]))
        payloads[name] = Body(body.number("mass"), body.array("center_of_mass", (3,)), inertia)
    return Truth(
        gain=fields.array("gain", (n, 6)),
        offset=fields.array("offset", (n,)),
        time_offset=fields.number("time_offset"),
        payloads=payloads,
        seed=fields.count("seed"),
        imperfections=fields.section("imperfections").data if "imperfections" in fields.data else {},
    )


@dataclass(frozen=True, slots=True)
class Stamps:
    """When the streams of a log have their samples."""

    time_ns: Integers  # (N,) of the rows, both streams together [ns]
    motion_ns: Integers  # (K,) of the motion
    sensor_ns: Integers  # (M,) of the sensor
    shown: Array  # (M,) motion time that the sensor's samples show, ``t_sensor + time_offset`` [s]

    @property
    def time(self) -> Array:
        """(N,) [s]."""
        return _seconds(self.time_ns)

    @property
    def motion(self) -> Array:
        """(K,) [s]."""
        return _seconds(self.motion_ns)

    def rows_of(self, stamps: Integers, values: Array) -> Array:
        """Values (K or M, ...) of one stream on all rows (N, ...), NaN where it has no sample."""
        rows = np.full((self.time_ns.size, *values.shape[1:]), np.nan)
        rows[np.searchsorted(self.time_ns, stamps)] = values
        return rows


def begin(rig: Rig, payload: str | None, seed: int | None) -> tuple[str, Truth]:
    """The payload that is carried, the rig's first if none is named, and the truth of the run.

    UnsupportedError: the sensor has a filter of its own that is not simulated.
    """
    imperfect = rig.simulate.imperfections
    if rig.sensor.lowpass_hz is not None and (imperfect is None or imperfect.sensor_filter is None):
        expected = "null, or the filter that is simulated (`simulate.imperfections.sensor_filter`)"
        raise UnsupportedError.at(rig.path, "sensor.lowpass_hz", f"{rig.sensor.lowpass_hz}", expected)
    if rig.sensor.subtracted is not None:
        expected = "false: a driver that subtracts a weight is not simulated"
        raise UnsupportedError.at(rig.path, "sensor.compensated", "a weight", expected)
    rig.check_motion("which a simulation needs")
    name = rig.payload_named(payload)
    if rig.payloads[name].unknown:
        raise InputError.at(rig.path, f"payloads.{name}", "an unknown body", "one that is known, to simulate")
    return name, draw_truth(rig, rig.simulate.seed if seed is None else seed)


def stamps_of(rig: Rig, duration: float, time_offset: float) -> Stamps:
    """The stamps of a motion that begins at time 0, at the rates of ``rig.simulate``.

    InputError: the time offset leaves the sensor nothing of the motion, or there are more rows than anybody
    can hold.
    """
    rows = duration * max(rig.simulate.rate, rig.simulate.sensor_rate)
    if rows > _MOST_ROWS:
        raise InputError.at(rig.path, "simulate.rate", f"{rows:.2g} rows", f"at most {_MOST_ROWS:.2g}")
    motion_ns = _stamps(duration, rig.simulate.rate)
    sensor_ns = _stamps(duration, rig.simulate.sensor_rate)
    shown = _seconds(sensor_ns) + time_offset
    inside = (shown >= 0.0) & (shown <= duration)
    if not inside.any():
        expected = f"less than the {duration} s of motion"
        raise InputError.at(rig.path, "simulate.time_offset", f"{time_offset:g} s", expected)
    sensor_ns = sensor_ns[inside]
    return Stamps(np.union1d(motion_ns, sensor_ns), motion_ns, sensor_ns, shown[inside])


def readings(
    rig: Rig,
    truth: Truth,
    stamps: Stamps,
    wrench: Array,
    rng: np.random.Generator,
    readout: Readout = _PERFECT,
) -> Array:
    """Raw channels (N, n) on all rows, from the wrench (M, 6) of the payload on the sensor at its samples."""
    noise = rig.sensor.noise_array * rng.standard_normal((len(wrench), rig.sensor.n))
    ideal = rig.sensor.sign * wrench @ truth.gain.T + truth.offset
    return stamps.rows_of(stamps.sensor_ns, readout.channels(ideal, noise))


def write_run(path: str | Path, log: Log, truth: Truth, joints: Sequence[str] = ()) -> tuple[Path, Path]:
    """Write a log (CSV, or Parquet by its suffix) and PATH.truth.yaml beside it: both paths.

    Joints are named where the log has any.
    """
    target = Path(path)
    columns: dict[str, Integers | Array] = {"time_ns": log.time_ns}
    columns |= {f"raw_{i}": channel for i, channel in enumerate(log.raw.T)}
    for names, block in (
        (TWIST, log.twist if log.tracking is None else None),  # which the joints tell
        (GRAVITY, log.gravity if log.tracking is None else None),
        (tuple(f"q_{name}" for name in joints), log.position),
        (tuple(f"dq_{name}" for name in joints), log.velocity),
    ):
        if block is not None:
            columns |= dict(zip(names, block.T, strict=True))
    write_table(target, columns)
    truth_path = target.with_name(target.name + ".truth.yaml")
    write_yaml(truth_path, truth.to_mapping())
    return target, truth_path


def _stamps(duration: float, rate: float) -> Integers:
    """Stamps k/rate of a stream in [0, duration) [ns]."""
    count = int(np.ceil(duration * rate - 1e-6))
    stamps: Integers = np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64)
    return stamps


def _seconds(time_ns: Integers) -> Array:
    return np.asarray(time_ns * 1e-9, dtype=np.float64)


def noise_of(rig: Rig, payload: str, seed: int) -> np.random.Generator:
    """What draws the noise of a log: of each payload its own, since logs of one seed are pooled."""
    place = list(rig.payloads).index(payload)
    return np.random.default_rng([seed, 1, place] if place else [seed, 1])


def draw_truth(rig: Rig, seed: int) -> Truth:
    """Gain, offset, clock and payloads by the options of ``rig.simulate``; the seed decides them all."""
    sensor, options = rig.sensor, rig.simulate
    rng = np.random.default_rng([seed, 0])
    # drawn whether used or not, so that one option does not change what another draws
    departure = sensor.gain_prior * rng.standard_normal((sensor.n, 6))
    drawn_offset = sensor.offset_prior_array * rng.standard_normal(sensor.n)
    gain = sensor.nominal_gain_array
    if options.gain == "random":
        # not by `gain_unit`: a seed keeps its bits
        gain = gain + departure * sensor.channel_scale[:, None] / sensor.range_array
    elif options.gain != "nominal":
        gain = np.array(options.gain)
    if options.offset == "random":
        offset = drawn_offset
    elif isinstance(options.offset, tuple):
        offset = np.array(options.offset)
    else:
        offset = np.zeros(sensor.n)
    draw = options.payload == "random"
    payloads = {
        name: _draw_payload(spec, rng) if draw and not spec.unknown else stated(spec)
        for name, spec in rig.payloads.items()
    }
    time_offset = options.time_offset
    if time_offset == "random":
        time_offset = sensor.time_offset_prior * float(np.random.default_rng([seed, 2]).standard_normal())
    return Truth(gain, offset, time_offset, payloads, seed)


def stated(spec: PayloadSpec) -> Body:
    """The payload as the rig states it."""
    return Body(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)


def _draw_payload(spec: PayloadSpec, rng: np.random.Generator) -> Body:
    """A payload from the stated uncertainty; inertias that no body can have are drawn again."""
    sigma, nominal = spec.uncertainty, stated(spec)
    diagonal = np.sqrt(np.diag(nominal.inertia))
    for _ in range(1000):
        mass = nominal.mass * (1.0 + sigma.mass * rng.standard_normal())
        center = nominal.center_of_mass + sigma.center_of_mass * rng.standard_normal(3)
        upper = np.triu(rng.standard_normal((3, 3)))
        symmetric = upper + np.triu(upper, 1).T
        inertia = nominal.inertia + sigma.inertia * symmetric * np.outer(diagonal, diagonal)
        principal = np.linalg.eigvalsh(inertia)
        if mass > 0.0 and principal[0] > 0.0 and principal[0] + principal[1] >= principal[2]:
            return Body(float(mass), center, inertia)
    raise InputError.at(
        None, "payloads: uncertainty", f"{sigma}", "an uncertainty that leaves physical bodies likely"
    )


def nees(error: Array, covariance: Array) -> tuple[float, int]:
    """Normalised estimation error squared, e^T P^-1 e, and its degrees of freedom, the rank of P.

    NaN where P is not a covariance, infinite for an error that P rules out. P is scaled to correlations
    first: its rank must not depend on units.
    """
    scale = np.sqrt(np.diag(covariance))
    if not (np.isfinite(covariance).all() and np.isfinite(error).all() and (scale > 0.0).all()):
        return float("nan"), 0
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > _NO_ERROR**2 * values[-1]
    parts = vectors.T @ (error / scale)
    if (np.abs(parts[~kept]) > _NO_ERROR).any():
        return float("inf"), int(kept.sum())
    return float(np.sum(parts[kept] ** 2 / values[kept])), int(kept.sum())
