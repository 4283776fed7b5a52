"""A calibration put together from what was estimated and judged."""

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from truewrench import _core
from truewrench.estimation.assumptions import growth_of
from truewrench.estimation.bound import oracle_rms
from truewrench.estimation.estimate import Estimate, PayloadDeparture
from truewrench.model.arrays import Array
from truewrench.model.calibration import AXES, Bound, Calibration, LogReport, Verdict
from truewrench.model.log import Log
from truewrench.model.rig import PayloadSpec, Rig
from truewrench.model.rig.sections import COLUMNS, ELEMENTS, ROWS


def assemble_motion(
    rig: Rig, logs: Sequence[Log], estimator: str, estimate: Estimate, verdict: Verdict, **rest: Any
) -> Calibration:
    """The calibration that an estimate from motion is; `rest` as for `assemble`."""
    n = rig.sensor.n
    stated = np.diag(estimate.normalised_covariance)[: 6 * n]
    wrenches = [rows.wrench[~rows.masked] for rows in estimate.rows]
    return assemble(
        rig,
        estimator,
        estimate.gain,
        estimate.covariance,
        verdict,
        [_motion_report(log, k, estimate) for k, log in enumerate(logs)],
        offset_temperature=estimate.offset_temperature,
        offset_temperature_covariance=estimate.slope_covariance,
        time_offset=float(estimate.time_offsets[-1]),
        time_offset_std=float(estimate.time_offsets_std[-1]),
        payload_posterior={
            name: _posterior(rig.payloads[name], departure) for name, departure in estimate.payloads.items()
        },
        quadratic=estimate.quadratic,
        quadratic_std=estimate.quadratic_std,
        discrepancy=estimate.discrepancy,
        bound=Bound(growth_of(logs, "raw") * oracle_rms(rig, wrenches), float(np.sqrt(stated.mean()))),
        **rest,
    )


def motion_figures(rig: Rig, estimate: Estimate) -> dict[str, Any]:
    """Figures of a calibration from motion, as calibration.yaml has them."""
    sensor = rig.sensor
    posed = _core.conditioning(
        estimate.gain, sensor.noise_array, sensor.nominal_gain_array, sensor.range_array
    )
    return {
        "knot_spacing": estimate.spacing.tolist(),
        "fits": estimate.fits,
        "iterations": estimate.iterations,
        "noise_found": [{f.what: f.factor for f in found} for found in estimate.noise],
        "pose_share": estimate.A,
        "parts_agree": {
            "halves": estimate.p_halves,
            "quarters": estimate.p_quarters,
            "logs": estimate.p_worst_log,
        },
        "condition_number": posed.condition_number,
        "departure_norm": posed.departure_norm,
        "limited_by": {
            source: dict(zip(AXES, np.sqrt(np.mean(sigma**2, axis=0)).tolist(), strict=True))
            for source, sigma in estimate.sources.items()
        },
    }


def _motion_report(log: Log, k: int, estimate: Estimate) -> LogReport:
    rows = estimate.rows[k]
    masked = Counter[str]()
    for event in estimate.events[k]:
        masked["contact" if event.lasting else "outliers"] += event.samples
    sensed = int(np.isfinite(log.raw).any(axis=1).sum())
    outside = max(0, sensed - rows.samples)
    return log_report(
        log,
        estimate.offsets[k],
        estimate.offsets_std[k],
        rows.samples - rows.left_out,
        time_offset=float(estimate.time_offsets[k]),
        masked=dict(masked),
        rejected={"outside every stretch of motion": outside} if outside else {},
        disturbances=tuple((e.begin, e.end) for e in estimate.events[k]),
    )


def log_notes(logs: Sequence[Log]) -> list[str]:
    """What their readers have to say of logs."""
    return [f"{log.path}: {note}" for log in logs for note in log.notes]


def log_report(log: Log, offset: Array, offset_std: Array, used: int, **rest: Any) -> LogReport:
    """What a log contributed: so many samples, and `rest`, further fields of it."""
    rest |= {"dropped_rows": log.dropped_rows, "nan_counts": log.nan_counts}
    return LogReport(log.path, log.sha256, log.payload, offset, offset_std, used=used, **rest)


def assemble(
    rig: Rig,
    estimator: str,
    gain: Array,
    covariance: Array,
    verdict: Verdict,
    logs: Sequence[LogReport],
    **rest: Any,
) -> Calibration:
    """The calibration that a gain and what is said about it are, `rest` further fields of it.

    The covariance (7n, 7n) is of [gain row by row, offset of the last log].
    """
    n = rig.sensor.n
    std = np.sqrt(np.diag(covariance))
    return Calibration(
        gain=gain,
        gain_std=std[: 6 * n].reshape(n, 6),
        offset=logs[-1].offset,
        offset_std=std[6 * n :],
        covariance=covariance,
        inverse=_inverse(rig, gain),
        verdict=verdict,
        logs=tuple(logs),
        rig=rig,
        estimator=estimator,
        version=version("truewrench"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        **rest,
    )


def _inverse(rig: Rig, gain: Array) -> Array:
    """Noise-weighted generalised inverse (6, n); NaN when the gain has none."""
    try:
        return _core.generalised_inverse(np.ascontiguousarray(gain), rig.sensor.noise_array)
    except ValueError:
        return np.full((6, rig.sensor.n), np.nan)


def _posterior(stated: PayloadSpec, departure: PayloadDeparture) -> dict[str, Any]:
    """What the data say of a payload, in the terms of the rig."""
    inertia = stated.inertia_matrix[ROWS, COLUMNS]
    unit = stated.units
    body = np.concatenate([[stated.mass], stated.center_of_mass_array, inertia]) + unit * departure.mean
    std = unit * departure.std
    return {
        "mass": float(body[0]),
        "mass_std": float(std[0]),
        "center_of_mass": body[1:4].tolist(),
        "center_of_mass_std": std[1:4].tolist(),
        "inertia": dict(zip(ELEMENTS, body[4:].tolist(), strict=True)),
        "inertia_std": dict(zip(ELEMENTS, std[4:].tolist(), strict=True)),
        "covariance": (departure.covariance * np.outer(unit, unit)).tolist(),
        "covariance_with_gain": (departure.with_gain * unit[:, None]).tolist(),
    }
