"""What a planned motion promises: the sigma of every gain, before anything moves.

The estimator itself is asked, with a log simulated at the rig's rates and noise: its covariance contains what
is uncertain of motion, payload and clocks, and its windows are those that a real log would be cut into.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench.calibration import Undetermined
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.estimate.windows import estimate_windows
from truewrench.estimation.bound import bound
from truewrench.log import Log
from truewrench.rig import PayloadSpec, Rig, SimulateSpec
from truewrench.verdict import undetermined_directions

__all__ = ["HEAVIER", "LONGER", "Prediction", "figures", "predict"]

Array = NDArray[np.float64]

LONGER = (2, 5)
HEAVIER = 2.0
_FITTED = 0.95  # share of the samples in fitted windows below which a prediction is doubtful


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Sigma of the gain that a calibration with this motion will have.

    Attributes:
        std: (n, 6) 1 sigma of the normalised gain.
        gain_std: (n, 6) in raw units per N or N m.
        oracle_rms: RMS over the normalised gains if the motion were known, payload and clocks exact.
        bound_rms: if only payload and clocks were exact.
        limited_by: RMS sigma that noise and each thing that is uncertain account for.
        longer: RMS sigma of records that many times as long.
        heavier_rms: RMS sigma with a payload of twice the mass and inertia moved alike.
        heavier_wrench: what it would use of the wrench limits, 1 is all.
        undetermined: directions that stay less certain than half of their prior.
        fitted: share of the simulated samples in windows that fit.
    """

    std: Array
    gain_std: Array
    oracle_rms: float
    bound_rms: float
    limited_by: Mapping[str, float]
    longer: Mapping[int, float]
    heavier_rms: float
    heavier_wrench: float
    undetermined: tuple[Undetermined, ...]
    fitted: float

    @property
    def rms(self) -> float:
        """RMS over the normalised gains."""
        return rms(self.std)

    @property
    def doubtful(self) -> bool:
        """Whether many samples of the simulated log were in windows that did not fit."""
        return self.fitted < _FITTED


def rms(std: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(std))))


def _ideal(rig: Rig) -> Rig:
    """The rig whose simulated hardware is perfect and as nominal: gain, offset, clocks, payload as stated."""
    options = rig.simulate.model_dump() | {"gain": "nominal", "offset": "none", "time_offset": 0.0}
    options |= {"payload": "nominal", "imperfections": None}
    sensor = rig.sensor.model_copy(update={"lowpass_hz": None, "compensated": False})
    return rig.model_copy(update={"simulate": SimulateSpec.model_validate(options), "sensor": sensor})


def _with_heavier(rig: Rig, payload: str) -> Rig:
    """The rig with a payload of twice the mass and inertia."""
    spec = rig.payloads[payload]
    inertia = spec.inertia.model_copy(update={k: HEAVIER * v for k, v in spec.inertia.model_dump().items()})
    heavy: PayloadSpec = spec.model_copy(update={"mass": HEAVIER * spec.mass, "inertia": inertia})
    return rig.model_copy(update={"payloads": {**rig.payloads, payload: heavy}})


def predict(
    rig: Rig, payload: str, simulated: Callable[[Rig], Log], share: float, heavier_wrench: float
) -> Prediction:
    """Simulate a log and ask the estimator how sure it would be.

    Args:
        rig: the rig.
        payload: that is carried.
        simulated: log of an ideal rig that moves as planned.
        share: of the whole motion that the log holds; the rest repeats it.
        heavier_wrench: use of the wrench limits by the heavier payload.
    """
    nominal = _ideal(rig)
    log = simulated(nominal)
    estimate = estimate_windows(nominal, [log], "map")
    known = bound(nominal, [log], nominal.sensor.nominal_gain_array)
    std = np.sqrt(_variance(estimate, 1.0 / share)).reshape(-1, 6)
    heavy = _with_heavier(nominal, payload)
    heavy_estimate = estimate_windows(heavy, [simulated(heavy)], "map")
    sensor = rig.sensor
    covariance = estimate.normalised_covariance[: 6 * sensor.n, : 6 * sensor.n]
    shrink = std.ravel() / np.sqrt(np.diag(covariance))
    covariance = covariance * shrink[:, None] * shrink
    sources = {name: rms(sigma) for name, sigma in estimate.contributions.items()}
    if "noise" in sources:
        sources["noise"] *= np.sqrt(share)
    return Prediction(
        std=std,
        gain_std=std * sensor.channel_scale[:, None] / sensor.range_array,
        oracle_rms=known.oracle_rms * np.sqrt(share),
        bound_rms=known.rms * np.sqrt(share),
        limited_by=sources,
        longer={times: rms(np.sqrt(_variance(estimate, times / share))) for times in LONGER},
        heavier_rms=rms(np.sqrt(_variance(heavy_estimate, 1.0 / share))),
        heavier_wrench=heavier_wrench,
        undetermined=undetermined_directions(covariance, sensor.gain_prior, sensor.channels),
        fitted=_fitted(estimate, log),
    )


def _variance(estimate: WindowEstimate, times: float) -> Array:
    """(6n,) of the normalised gain after a record that many times as long.

    What noise accounts for falls with the length; a longer record is not counted on to tell payload and
    clock.
    """
    gains = estimate.gain.size
    total = np.diag(estimate.normalised_covariance)[:gains]
    if estimate.sources is None:
        return np.asarray(total)
    prior = estimate.sources.gain_prior**-2.0
    noise = estimate.sources.noise
    seen = np.maximum(1.0 / np.maximum(noise, np.finfo(np.float64).tiny) - prior, 0.0)
    return np.asarray(np.maximum(total - noise, 0.0) + 1.0 / (times * seen + prior))


def _fitted(estimate: WindowEstimate, log: Log) -> float:
    samples = np.count_nonzero(np.isfinite(log.raw).all(axis=1))
    used = sum(np.count_nonzero(np.isfinite(wrench).all(axis=1)) for wrench in estimate.wrench)
    return float(used) / max(float(samples), 1.0)


def figures(prediction: Prediction) -> dict[str, Any]:
    """What PLAN.plan.yaml holds besides the sigma."""
    return {
        "oracle_rms": prediction.oracle_rms,
        "bound_rms": prediction.bound_rms,
        "limited_by": dict(prediction.limited_by),
        "longer": {f"{times}x": value for times, value in prediction.longer.items()},
        "heavier": {
            "payload": f"{HEAVIER:g}x mass and inertia",
            "rms": prediction.heavier_rms,
            "wrench_percent": 100.0 * prediction.heavier_wrench,
        },
    }
