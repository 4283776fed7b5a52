"""What a calibration knows: gain and offset with their uncertainty, and the verdict on using them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from truewrench import model
from truewrench.model.arrays import Array, Mask
from truewrench.model.calibration_parts import (
    AXES,
    KINDS,
    Assumed,
    AxisImprovement,
    BlindTo,
    Bound,
    LogReport,
    Undetermined,
    Verdict,
)
from truewrench.model.errors import InputError
from truewrench.model.files import write_yaml
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.elsewhere import within
from truewrench.model.rig.fields import Fields
from truewrench.model.rig.sections import ELEMENTS

__all__ = [
    "AXES",
    "FORMAT",
    "KINDS",
    "UNDETERMINED",
    "Assumed",
    "AxisImprovement",
    "BlindTo",
    "Bound",
    "Calibration",
    "LogReport",
    "Undetermined",
    "Verdict",
    "load_calibration",
]

FORMAT = "truewrench/1"  # what the first line of a calibration file says
UNDETERMINED = 0.5  # of the prior's sigma: what is less certain than that was not determined by the data


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Gain and offset of raw = gain @ w + offset, in SI and raw units, and everything said about them.

    Attributes:
        gain: (n, 6), w in the sign of the rig's `sensor.feels`.
        gain_std: (n, 6) 1 sigma.
        offset: (n,) of the last log at its end, at the reference temperature.
        offset_std: (n,) 1 sigma.
        inverse: (6, n) noise-weighted generalised inverse of `gain`; NaN when the gain has none.
        covariance: (7n, 7n) of [gain row by row, offset].
        verdict: whether and why (not) to use it.
        logs: one report per log.
        rig: the settings it was made with.
        estimator: `map`, `online`, `ekf` or `ls`.
        improvement: per wrench axis; empty when it was not judged.
        bound: None for estimators that do not compute it.
        offset_temperature: (n,) slope of the offset per K, None without a temperature column.
        offset_temperature_covariance: (n, 8n) of it with [gain row by row, offset, itself].
        time_offset: of the last log [s].
        time_offset_std: its 1 sigma [s].
        payload_posterior: what the data say of each payload, by name; empty when payloads are taken as exact.
            `covariance` (10, 10) of mass, centre of mass and inertia, `covariance_with_gain` (10, 6n).
        axes: which wrench axes may be used, by name; empty where the estimator does not say.
        assumed: every alternative that the estimate needed beside the rig as stated.
        quadratic: (n,) quadratic term of each channel at full scale, fraction of range; None where the
            estimator has none. `gain` is the tangent at w = 0.
        quadratic_std: (n,) its 1 sigma, likewise.
        discrepancy: (n,) what of each channel follows neither wrench nor noise, 1 sigma, fraction of range.
        figures: what the estimator reports of its fit, by name.
        timings: seconds spent, by phase.
        version: of the package that made it.
        created: ISO 8601 time, UTC.
    """

    gain: Array
    gain_std: Array
    offset: Array
    offset_std: Array
    inverse: Array
    covariance: Array
    verdict: Verdict
    logs: tuple[LogReport, ...]
    rig: Rig
    estimator: str
    improvement: Mapping[str, AxisImprovement] = field(default_factory=dict)
    bound: Bound | None = None
    offset_temperature: Array | None = None
    offset_temperature_covariance: Array | None = None
    time_offset: float = 0.0
    time_offset_std: float = 0.0
    payload_posterior: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    axes: Mapping[str, bool] = field(default_factory=dict)
    assumed: tuple[Assumed, ...] = ()
    quadratic: Array | None = None
    quadratic_std: Array | None = None
    discrepancy: Array | None = None
    figures: Mapping[str, Any] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)
    version: str = ""
    created: str = ""

    @property
    def n(self) -> int:
        """Number of raw channels."""
        return int(self.gain.shape[0])

    @property
    def gain_std_normalised(self) -> Array:
        """(n, 6) 1 sigma of the gains, in units of their channel's full scale over their axis' range."""
        sensor = self.rig.sensor
        return self.gain_std / sensor.gain_unit

    @property
    def gain_determined(self) -> Mask:
        """(n, 6) whether the data and not the prior say what the gain is: its sigma is at most half of it."""
        determined: Mask = self.gain_std_normalised <= UNDETERMINED * self.rig.sensor.gain_prior
        return determined

    def wrench(self, raw: npt.ArrayLike, temperature: npt.ArrayLike | None = None) -> Array:
        """The true wrench, (N, 6) [N, N m], of raw samples (N, n); NaN where a channel has none.

        NaN on `withheld` axes, too.

        Args:
            raw: samples.
            temperature: (N,) [degC], which the offset follows; None: that of the reference.
        """
        offset = self.offset
        if temperature is not None and self.offset_temperature is not None:
            above = np.asarray(temperature, dtype=np.float64) - self.rig.temperature.reference
            offset = offset + above[..., None] * self.offset_temperature
        wrench: Array = (np.asarray(raw, dtype=np.float64) - offset) @ self.inverse.T
        wrench[..., self.withheld] = np.nan
        return wrench

    @property
    def unused(self) -> bool:
        """Whether nothing of its logs was used: what it holds was known beforehand."""
        return bool(self.logs) and not any(log.used for log in self.logs)

    @property
    def withheld(self) -> Mask:
        """(6,) wrench axes that are not to be used, of a calibration that is good for others."""
        usable = np.array([self.axes.get(axis, False) for axis in AXES])
        return ~usable if usable.any() else np.zeros(6, dtype=np.bool_)

    def contact(self, log: Log, tool: Any, **options: Any) -> Any:
        """What the sensor felt beyond a tool, row by row: a `truewrench.correction.contact.log.Contact`.

        Args:
            log: with motion and, in gravity, its direction.
            tool: a `Tool`, identified on this sensor.
            **options: `delay` and `view` of `truewrench.correction.contact.log.contact`.
        """
        # by name: tools stand on calibrations, and not the other way round
        return model.contact(log, tool, self, **options)

    def write_yaml(self, path: str | Path) -> None:
        """Write `calibration.yaml`, every number to its last bit; the file appears whole or not at all."""
        mapping = self.to_mapping()
        write_yaml(path, mapping | {"rig": within(mapping["rig"], self.rig, path)})

    def to_mapping(self) -> dict[str, Any]:
        """Numbers, arrays and texts by the keys of `calibration.yaml`."""
        return {
            "format": FORMAT,
            "verdict": self.verdict.to_mapping(),
            "axes": self.axes,
            "assumed": [asdict(assumed) for assumed in self.assumed],
            "gain": self.gain,
            "gain_std": self.gain_std,
            "gain_determined": self.gain_determined.tolist(),
            "offset": self.offset,
            "offset_std": self.offset_std,
            "offset_temperature": self.offset_temperature,
            "time_offset": self.time_offset,
            "time_offset_std": self.time_offset_std,
            "inverse": self.inverse,
            "quadratic": self.quadratic,
            "quadratic_std": self.quadratic_std,
            "discrepancy": self.discrepancy,
            "improvement": {"axes": {axis: asdict(judged) for axis, judged in self.improvement.items()}},
            "bound": None if self.bound is None else asdict(self.bound),
            "payload_posterior": self.payload_posterior,
            "logs": [_of_log(log) for log in self.logs],
            "figures": self.figures,
            "timings": self.timings,
            "estimator": self.estimator,
            "version": self.version,
            "created": self.created,
            "rig": self.rig.to_mapping(),
            "covariance": self.covariance,
            "offset_temperature_covariance": self.offset_temperature_covariance,
        }


def _of_log(log: LogReport) -> dict[str, Any]:
    return {
        "path": None if log.path is None else str(log.path),
        "sha256": log.sha256,
        "payload": log.payload,
        "offset": log.offset,
        "offset_std": log.offset_std,
        "time_offset": log.time_offset,
        "samples": {"used": log.used, "masked": log.masked, "rejected": log.rejected},
        "disturbances": [list(interval) for interval in log.disturbances],
        "dropped_rows": log.dropped_rows,
        "nan_counts": log.nan_counts,
    }


def load_calibration(path: str | Path) -> Calibration:
    """Read and validate a `calibration.yaml`.

    Raises:
        InputError: naming file, line, key, what was found and what was expected.
    """
    return _from_fields(Fields.of_file(path, FORMAT))


def _from_fields(top: Fields) -> Calibration:
    try:
        rig = Rig.from_mapping(top.section("rig").data, f"{top.path}: rig")
    except InputError as error:
        raise InputError(f"{error}\n(the `rig` of a calibration must be a valid rig)") from error
    n = rig.sensor.n
    verdict = top.section("verdict")
    calibration = Calibration(
        gain=top.array("gain", (n, 6)),
        gain_std=top.array("gain_std", (n, 6)),
        offset=top.array("offset", (n,)),
        offset_std=top.array("offset_std", (n,)),
        inverse=top.array("inverse", (6, n), nan_allowed=True),
        covariance=top.covariance("covariance", 7 * n),
        verdict=Verdict(
            usable=verdict.flag("usable"),
            reasons=tuple(verdict.texts("reasons")),
            undetermined=tuple(
                Undetermined(direction=item.array("direction", (6 * n,)), words=item.text("words"))
                for item in verdict.sections("undetermined")
            ),
            blind_to=tuple(_blind_to(item) for item in _listed(verdict, "blind_to")),
        ),
        logs=tuple(_log_report(log, n) for log in top.sections("logs")),
        rig=rig,
        estimator=top.text("estimator"),
        improvement={
            axis: _improvement(top.section("improvement").section("axes").section(axis))
            for axis in top.section("improvement").section("axes").data
        },
        bound=None
        if top.get("bound") is None
        else Bound(top.section("bound").number("oracle_rms"), top.section("bound").number("rms")),
        offset_temperature=None
        if top.get("offset_temperature") is None
        else top.array("offset_temperature", (n,)),
        offset_temperature_covariance=None
        if top.data.get("offset_temperature_covariance") is None
        else top.array("offset_temperature_covariance", (n, 8 * n)),
        time_offset=top.number("time_offset"),
        time_offset_std=top.number("time_offset_std"),
        payload_posterior=_payload_posterior(top.section("payload_posterior"), n),
        axes=_axes(top),
        assumed=tuple(_assumed(item) for item in _listed(top, "assumed")),
        quadratic=_per_channel(top, "quadratic", n),
        quadratic_std=_per_channel(top, "quadratic_std", n, positive=True),
        discrepancy=_per_channel(top, "discrepancy", n, positive=True),
        figures=top.section("figures").data if "figures" in top.data else {},
        timings=top.section("timings").data if "timings" in top.data else {},
        version=top.text("version"),
        created=top.text("created"),
    )
    for key in ("gain_std", "offset_std"):
        if (getattr(calibration, key) < 0.0).any():
            raise top.error(key, "numbers of at least 0", f"{getattr(calibration, key).min():g}")
    if "gain_determined" in top.data and top.data["gain_determined"] != calibration.gain_determined.tolist():
        expected = "n rows of six: true where `gain_std` is at most half of the prior"
        raise top.error("gain_determined", expected, "something else")
    if calibration.verdict.usable:
        scale = rig.sensor.range_array
        product = calibration.inverse @ calibration.gain * scale / scale[:, None]
        if not np.allclose(product, np.eye(6), atol=1e-6):
            raise top.error("inverse", "the generalised inverse of `gain`", "another matrix")
    return calibration


def _listed(fields: Fields, key: str) -> list[Fields]:
    """A list of mappings; empty in files from before there was one."""
    return fields.sections(key) if key in fields.data else []


def _per_channel(top: Fields, key: str, n: int, *, positive: bool = False) -> Array | None:
    """As many numbers as channels; None where there are none, as in files from before there were any."""
    if top.data.get(key) is None:
        return None
    return top.sizes(key, n) if positive else top.array(key, (n,))


def _payload_posterior(payloads: Fields, n: int) -> dict[str, Any]:
    """Each body with what its file has of it; older ones have no covariance."""
    vectors = {"center_of_mass": (3,), "center_of_mass_std": (3,), "covariance_with_gain": (10, 6 * n)}
    for name in payloads.data:
        body = payloads.section(name)
        for key in body.data:
            if key in vectors:
                body.array(key, vectors[key])
            elif key == "covariance":
                body.covariance(key, 10)
            elif key in ("inertia", "inertia_std"):
                for element in ELEMENTS:
                    body.section(key).number(element)
            else:
                body.number(key)
    return payloads.data


def _axes(top: Fields) -> dict[str, bool]:
    if not top.data.get("axes"):
        return {}
    axes = top.section("axes")
    if set(axes.data) != set(AXES):
        raise top.error("axes", f"each of {', '.join(AXES)}, or none", ", ".join(map(str, axes.data)))
    return {axis: axes.flag(axis) for axis in AXES}


def _assumed(item: Fields) -> Assumed:
    sigma = None if item.data.get("sigma") is None else item.size("sigma")
    return Assumed(
        what=item.text("what"),
        where=item.text("where"),
        value=item.number("value"),
        sigma=sigma,
        evidence=item.text("evidence"),
    )


def _blind_to(item: Fields) -> BlindTo:
    kind = item.text("kind")
    if kind not in KINDS:
        raise item.error("kind", f"one of {', '.join(KINDS)}")
    return BlindTo(kind, item.size("size"), item.size("effect"), item.text("words"))


def _log_report(log: Fields, n: int) -> LogReport:
    samples = log.section("samples")
    return LogReport(
        path=None if log.get("path") is None else Path(log.text("path")),
        sha256=log.text("sha256"),
        payload=log.text("payload"),
        offset=log.array("offset", (n,)),
        offset_std=log.array("offset_std", (n,)),
        time_offset=log.number("time_offset"),
        used=samples.count("used"),
        # `gated` until masks were called so
        masked=_counts(samples.section("masked" if "masked" in samples.data else "gated")),
        rejected=_counts(samples.section("rejected")),
        disturbances=_intervals(log),
        dropped_rows=log.count("dropped_rows"),
        nan_counts=_counts(log.section("nan_counts")),
    )


def _intervals(log: Fields) -> tuple[tuple[float, float], ...]:
    if log.get("disturbances") is None:
        return ()
    rows = log.array("disturbances", (len(log.data["disturbances"]), 2))
    return tuple((float(begin), float(end)) for begin, end in rows)


def _counts(reasons: Fields) -> dict[str, int]:
    return {reason: reasons.count(reason) for reason in reasons.data}


def _improvement(axis: Fields) -> AxisImprovement:
    better = axis.get("better")
    if better is not True and better is not False and better != "unsure":
        raise axis.error("better", "true, false or `unsure`")
    return AxisImprovement(
        nominal=axis.number("nominal"), new=axis.number("new"), held_out=axis.flag("held_out"), better=better
    )
