"""Is a calibration better than the nominal gain, on data it has not seen, and is its sigma honest?

The corrected wrench is held against the payload's wrench by a motion that the velocities alone give
(inertial.py), so that no gain can bend the motion to its favour, or against reference wrenches where logs
have them. A payload that was calibrated with is the one that was found; gravity may be tilted in every log
as far as the rig states. Per wrench axis: the RMS residual of the nominal and of the new gain with a
confidence interval of their ratio by a moving-block bootstrap, and whether the residual is as large, and as
white, as the noise of sensor and motion (or reference) and the calibration's covariance say.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from truewrench.judging.validation.chance import (
    bootstrap,
    correlations,
    deviate,
    longest_block,
    probability_of,
    whiteness,
)
from truewrench.judging.validation.errors import was_seen
from truewrench.judging.validation.residuals import Residuals, residuals, systematic_columns
from truewrench.judging.validation.residuals import tared as is_tared
from truewrench.model.arrays import Array
from truewrench.model.calibration import AXES, AxisImprovement, Calibration, Verdict
from truewrench.model.errors import InputError
from truewrench.model.files import write_yaml
from truewrench.model.log import Log
from truewrench.model.repeats import without_marks, without_repeats
from truewrench.model.rig import Rig
from truewrench.robot.attitude import check_fall
from truewrench.robot.track import tracked

FORMAT = "truewrench-validation/1"
CONFIDENCE = 0.99  # of the interval of the ratio of residuals
CHANGE = 0.02  # a smaller relative gain counts as none,
LOSS = 0.1  # and a smaller loss: the price of any gain's own sigma where the nominal one happens to be right
WHITE = 1e-6  # probability of autocorrelations as large as found
CORRELATION = 0.1  # and the departure of one of them from what the motion explains
CONTRADICTED = 1e-6  # probability of a normalised residual as far from 1 as found,
TOO_LARGE, TOO_SMALL = 1.2, 0.8  # and its size, mean square over claimed variance
SIGMA_95 = 1.959964
COVERED = 0.90  # share of the samples within 95% limits that is still accepted, if it is
COVERED_DEVIATE = 5.0  # as far below 95% in sigma, and the limits are mostly noise:
TILTED = 4.0  # sigma of its prior, from which on gravity's tilt is a departure: 1 right log in 8,000
ANY_TILT = 0.1  # [rad] prior of a tilt by which a departure is tried to be explained: tolerance
NOISE_SHARE = 0.9  # an error of the gain, common to all samples, may take any share of them out at once


@dataclass(frozen=True, slots=True)
class AxisValidation:
    """One wrench axis.

    Attributes:
        nominal: RMS residual with the nominal gain [N, N m].
        new: with the calibration's.
        ratio: new over nominal.
        ratio_low: lower end of its confidence interval.
        ratio_high: upper end.
        better: true and false where the interval leaves no doubt and the change is worth it.
        nis: mean squared residual over its claimed variance; 1 is honest.
        nis_std: 1 sigma of that, by what is claimed.
        nis_probability: of one so large or small, by what is claimed.
        coverage: share of the samples within 1.96 claimed sigma.
        coverage_deviate: how far below 95% that is, in sigma of chance; 0 above it, and where the claimed
            sigma is mostly the gain's own.
        autocorrelation: the largest of the residual's at the first lags, beyond what the motion explains.
        white_probability: of autocorrelations at the first lags as large as found.
        keep: whether the new gain may be used on this axis: nothing found speaks against it.
    """

    nominal: float
    new: float
    ratio: float
    ratio_low: float
    ratio_high: float
    better: Literal[True, False, "unsure"]
    nis: float
    nis_std: float
    nis_probability: float
    coverage: float
    coverage_deviate: float
    autocorrelation: float
    white_probability: float
    keep: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Validation:
    """What held-out data say of a calibration.

    Attributes:
        verdict: usable, or every reason why not.
        axes: by wrench axis.
        samples: rows compared.
        block: length of the bootstrap's blocks [s].
        tared: whether a constant was removed from the residuals of every log: its offset may be another.
        time_offsets: per log, t_motion = t_sensor + time_offset [s].
        tilts: per log, how far its residuals ask for another direction of gravity, under its prior [rad].
        logs: paths of the logs, empty for those that are not files.
        held_out: whether none of the logs was calibrated with.
        payload_seen: whether the payloads of all logs are among those calibrated with.
    """

    verdict: Verdict
    axes: Mapping[str, AxisValidation]
    samples: int
    block: float
    tared: bool
    time_offsets: tuple[float, ...]
    tilts: tuple[float, ...]
    logs: tuple[str, ...]
    held_out: bool
    payload_seen: bool

    @property
    def improvement(self) -> dict[str, AxisImprovement]:
        """The same as a calibration holds it."""
        return {
            name: AxisImprovement(axis.nominal, axis.new, self.held_out, axis.better)
            for name, axis in self.axes.items()
        }

    def to_mapping(self) -> dict[str, Any]:
        """Plain numbers and texts, as validation.yaml holds them."""
        return {
            "format": FORMAT,
            "verdict": {"usable": self.verdict.usable, "reasons": list(self.verdict.reasons)},
            "axes": {name: asdict(axis) for name, axis in self.axes.items()},
            "samples": self.samples,
            "block": self.block,
            "confidence": CONFIDENCE,
            "tared": self.tared,
            "held_out": self.held_out,
            "payload_seen": self.payload_seen,
            "logs": [
                {"path": path, "time_offset": offset, "gravity_tilt": tilt}
                for path, offset, tilt in zip(self.logs, self.time_offsets, self.tilts, strict=True)
            ],
        }

    def write_yaml(self, path: str | Path) -> None:
        """Write validation.yaml; the file appears whole or not at all."""
        write_yaml(path, self.to_mapping())


def validate(calibration: Calibration, rig: Rig, logs: Log | Sequence[Log], *, seed: int = 0) -> Validation:
    """Judge a calibration by logs, which should not be those it was made with.

    Args:
        calibration: its gain, covariance and time offset are judged.
        rig: sensor noise, payloads and motion of these logs.
        logs: one or several; each keeps a constant and, where the rig has a prior for it, a time offset and
            a tilt of gravity of its own.
        seed: of the bootstrap.

    Raises:
        InputError: for a rig of another sensor, or logs without enough rows.
    """
    given = [logs] if isinstance(logs, Log) else list(logs)
    if not given:
        raise InputError.at(None, "", "no log", "at least one")
    for log in given:
        log.check_sizes()
    records = [without_marks(without_repeats(log)) for log in given]
    _check_same_sensor(calibration, rig)
    for log in records:
        log.check_channels()
    moving = [log for log in records if log.reference is None]
    if moving:
        rig.check_motion("by which a calibration is validated")
    for log in moving:
        if rig.in_gravity:
            check_fall(rig, log)
        if rig.payloads[log.payload].unknown:
            expected = "a known payload, by which the gains are compared"
            raise InputError.at(rig.path, f"payloads.{log.payload}", "an unknown body", expected)
    records = tracked(rig, records)
    parts = [residuals(calibration, rig, log) for log in records]
    used = {report.sha256 for report in calibration.logs if report.sha256}
    axes = _axes(calibration, parts, seed)
    reasons = [reason for name, axis in axes.items() for reason in _reasons(name, axis)]
    reasons += _of_gravity(calibration, rig, records, parts, axes, seed)
    if not np.isfinite(calibration.inverse).all():
        reasons = ["the gain of the calibration has no inverse"]
    if not calibration.verdict.usable:
        own = "; ".join(calibration.verdict.reasons) or "no reason given"
        reasons.insert(0, f"the calibration itself is not to be used as it stands: {own}")
    return Validation(
        Verdict(not reasons, tuple(reasons)),
        axes,
        samples=sum(len(part.new) for part in parts),
        block=longest_block(parts) * parts[0].period,
        tared=is_tared(rig),
        time_offsets=tuple(part.time_offset for part in parts),
        tilts=tuple(float(np.linalg.norm(part.tilt, axis=1).max()) for part in parts),
        logs=tuple("" if log.path is None else str(log.path) for log in records),
        held_out=not any(log.sha256 in used for log in records),
        payload_seen=all(was_seen(calibration, rig, log.payload) for log in records),
    )


def _axes(calibration: Calibration, parts: Sequence[Residuals], seed: int) -> dict[str, AxisValidation]:
    old, new = (np.concatenate([getattr(part, name) for part in parts]) for name in ("old", "new"))
    ratios = bootstrap(old, new, min(longest_block(parts), max(1, len(old) // 5)), seed)
    columns = systematic_columns(calibration, parts)
    return {
        name: _axis(i, parts, old[:, i], new[:, i], ratios[:, i], systematic)
        for i, (name, systematic) in enumerate(zip(AXES, columns, strict=True))
    }


def _of_gravity(
    calibration: Calibration,
    rig: Rig,
    logs: Sequence[Log],
    parts: Sequence[Residuals],
    axes: Mapping[str, AxisValidation],
    seed: int,
) -> list[str]:
    """What gravity's direction has to do with it: a tilt beyond its prior, or one that would explain it."""
    reasons = []
    stated = rig.gravity_tilt_prior
    for log, part in zip(logs, parts, strict=True):
        if np.abs(part.tilt).max() > TILTED * stated > 0.0:
            angle = float(np.linalg.norm(part.tilt, axis=1).max())
            reasons.append(
                f"gravity: in {log.path or 'a log'} it is tilted by {np.degrees(angle):.2g} deg, "
                f"{angle / stated:.2g} sigma of `gravity_tilt_prior`"
            )
    departing = [name for name, axis in axes.items() if _reasons("", axis)]
    if reasons or not departing or not rig.in_gravity or rig.motion.source == "imu":
        return reasons
    free = rig.model_copy(update={"gravity_tilt_prior": ANY_TILT})
    parts = [residuals(calibration, free, log) for log in logs]
    tilted = _axes(calibration, parts, seed)
    explained = [name for name in departing if not _reasons("", tilted[name])]
    if explained:
        angle = max(float(np.linalg.norm(part.tilt, axis=1).max()) for part in parts)
        reasons.append(
            f"gravity: tilted by {np.degrees(angle):.2g} deg it would explain {', '.join(explained)}; "
            f"`gravity_tilt_prior` is {np.degrees(stated):.2g} deg"
        )
    return reasons


def _check_same_sensor(calibration: Calibration, rig: Rig) -> None:
    theirs, ours = calibration.rig.sensor, rig.sensor
    for key, found, expected in (
        ("sensor.channels", ours.n, theirs.n),
        ("sensor.feels", ours.feels, theirs.feels),
    ):
        if found != expected:
            raise InputError.at(rig.path, key, f"{found}", f"{expected}, as in the calibration")


def _axis(
    i: int, parts: Sequence[Residuals], old: Array, new: Array, ratios: Array, systematic: Array
) -> AxisValidation:
    nominal, rms = (float(np.sqrt(np.mean(x**2))) for x in (old, new))
    ratio = rms / max(nominal, np.finfo(np.float64).tiny)
    low, high = (float(np.quantile(ratios, q)) for q in ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2))
    noise = np.concatenate([part.noise[:, i] for part in parts])
    nominal_noise = np.concatenate([part.nominal_noise[:, i] for part in parts])
    # the right gain may turn more of the sensor's noise into this axis: that is no loss
    turned = max(1.0, float(np.sqrt(np.mean(noise) / np.mean(nominal_noise))))
    better: Literal[True, False, "unsure"] = "unsure"
    if high < 1.0 and ratio < 1.0 / (1.0 + CHANGE):
        better = True
    elif low > turned and ratio > turned * (1.0 + LOSS):
        better = False
    variance = noise + np.einsum("ij,ij->i", systematic, systematic)
    found, expected = correlations(parts, i)
    # cumulants of the mean of u^2: noise correlated in time, and errors common to the whole record
    share = float(np.mean(noise / variance))
    freedom = len(new) / (1.0 + 2.0 * float(np.sum(expected[1:] ** 2)))
    common = np.linalg.eigvalsh((systematic / variance[:, None]).T @ systematic / len(new))
    spread = 2.0 * share**2 / freedom + 2.0 * float(np.sum(common**2))
    skew = 8.0 * share**3 / freedom**2 + 8.0 * float(np.sum(common**3))
    nis = float(np.mean(new**2 / variance))
    lag, probability = whiteness(found, expected, len(new))
    coverage = float(np.mean(np.abs(new) <= SIGMA_95 * np.sqrt(variance)))
    axis = AxisValidation(
        nominal,
        rms,
        ratio,
        low,
        high,
        better,
        nis,
        float(np.sqrt(spread)),
        probability_of(nis, spread, skew, share, freedom),
        coverage,
        deviate(coverage, freedom) if share > NOISE_SHARE else 0.0,
        lag,
        probability,
    )
    return replace(axis, keep=not _reasons("", axis))


def worse(name: str, axis: AxisValidation) -> str:
    """The reason against a gain that is worse than the nominal one on an axis."""
    return (
        f"{name} is worse than with the nominal gain: residual {axis.ratio:.3g} times as large "
        f"({axis.ratio_low:.3g} to {axis.ratio_high:.3g})"
    )


def _reasons(name: str, axis: AxisValidation) -> list[str]:
    reasons = []
    if axis.better is False:
        reasons.append(worse(name, axis))
    if axis.nis_probability < CONTRADICTED and not TOO_SMALL < axis.nis < TOO_LARGE:
        how = "larger" if axis.nis > 1.0 else "smaller"
        reasons.append(
            f"the residual of {name} is {how} than its claimed sigma: normalised squares of {axis.nis:.3g} "
            f"instead of 1, {100 * axis.coverage:.0f} % of the samples within "
            "95 % limits"
        )
    elif axis.coverage < COVERED and axis.coverage_deviate > COVERED_DEVIATE:
        reasons.append(
            f"only {100 * axis.coverage:.0f} % of the residuals of {name} lie within 95 % limits: "
            "they are not normally distributed (contact, outliers, a jump of the offset)"
        )
    if axis.white_probability < WHITE and abs(axis.autocorrelation) > CORRELATION:
        reasons.append(
            f"the residual of {name} is not white: autocorrelation {axis.autocorrelation:+.2f} beyond what "
            "the motion explains (filtered sensor, contact, vibration, wrong clock)"
        )
    return reasons
