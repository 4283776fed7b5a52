"""What a planned motion promises, before anything moves: the Cramer-Rao sigma of every gain.

A log is simulated at the rig's rates and noise, and the bound (docs/method.md, "The bound") taken of it: the
motion has to be inferred from what measures it, and payload, clocks and gravity are as uncertain as the rig
says. What follows the pose is added at the `discrepancy` that the rig states (10.10); where it is left to be
found, nothing is, and how much of it the motion can hide is said instead.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from truewrench import _core
from truewrench.estimation.bound import Information, information, oracle_rms
from truewrench.estimation.pose import DelayShare, blind_to, delay_share
from truewrench.estimation.undetermined import undetermined_directions
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import BlindTo, Undetermined
from truewrench.model.log import Log
from truewrench.model.motion.spatial import at_point
from truewrench.model.motion.trajectory import SplineTwist, Trajectory
from truewrench.model.motion.trajectory_joint import JointTrajectory
from truewrench.model.rig import PayloadSpec, Rig, SimulateSpec
from truewrench.planning.check import Preview

LONGER = (2, 5)
HEAVIER = 2.0
POSE = "pose"  # source of uncertainty: what follows the pose


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Sigma of the gain that a calibration with this motion will have."""

    std: Array  # (n, 6) 1 sigma of the normalised gain
    gain_std: Array  # (n, 6) in raw units per N or N m
    # RMS over the normalised gains if the motion were known, payload, clocks and gravity exact
    oracle_rms: float
    bound_rms: float  # if only payload, clocks and gravity were exact
    limited_by: Mapping[str, float]  # RMS sigma that noise and each thing that is uncertain account for
    longer: Mapping[int, float]  # RMS sigma of records that many times as long
    heavier_rms: float  # RMS sigma with a payload of twice the mass and inertia moved alike
    heavier_wrench: float  # what it would use of the wrench limits, 1 is all
    undetermined: tuple[Undetermined, ...]  # directions that stay less certain than half of their prior
    pose: _core.PoseShare  # how much of the pose the motion can hide
    blind_to: tuple[BlindTo, ...]  # what a record of this motion could not show

    @property
    def rms(self) -> float:
        """RMS over the normalised gains."""
        return rms(self.std)


def rms(std: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(std))))


def hidden(
    rig: Rig, payload: str, motion: Trajectory | JointTrajectory, preview: Preview
) -> tuple[_core.PoseShare, DelayShare]:
    """What of the pose, and of a delay, a planned motion can hide."""
    wrench = preview.wrench / rig.sensor.range_array
    arm = not isinstance(motion, SplineTwist)
    if isinstance(motion, SplineTwist):
        twist = motion.twist(preview.time)
    else:
        twist = at_point(preview.twist, -rig.payloads[payload].center_of_mass_array)
    return _core.pose_share(preview.time, twist, wrench, arm), delay_share(preview.time, wrench)


def ideal(rig: Rig) -> Rig:
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
    rig: Rig,
    payload: str,
    motion: Trajectory | JointTrajectory,
    preview: Preview,
    simulated: Callable[[Rig], Log],
    share: float,
) -> Prediction:
    """The bound on a log simulated without faults, and what no log of this motion could show.

    `simulated` gives the log of an ideal rig that moves as planned; a log holds a share of the whole motion,
    and the rest repeats it.
    """
    nominal, sensor = ideal(rig), rig.sensor
    pose, delay = hidden(rig, payload, motion, preview)
    known, wrenches = _told(nominal, simulated)
    stated = 0.0 if sensor.discrepancy == "auto" else sensor.discrepancy

    def sigma(told: Information, times: float) -> Array:
        """(6n,) after so many records."""
        prior = np.full(told.gains, sensor.gain_prior**2)
        covariance = _core.with_pose(told.covariance(times), prior, pose, np.full(sensor.n, stated**2))
        return np.sqrt(np.diag(covariance))

    std = sigma(known, 1.0 / share).reshape(-1, 6)
    sources = {name: rms(of) for name, of in known.contributions(1.0 / share).items()}
    if stated > 0.0:
        before = np.diag(known.covariance(1.0 / share))
        sources[POSE] = rms(np.sqrt(np.maximum(std.ravel() ** 2 - before, 0.0)))
    heavier, _ = _told(_with_heavier(nominal, payload), simulated)
    used = max(use.share for use in preview.usage if use.limit == "wrench")
    return Prediction(
        std=std,
        gain_std=std * sensor.gain_unit,
        oracle_rms=oracle_rms(nominal, wrenches) * np.sqrt(share),
        bound_rms=rms(np.sqrt(np.diag(known.known(1.0 / share)))),
        limited_by=sources,
        longer={times: rms(sigma(known, times / share)) for times in LONGER},
        heavier_rms=rms(sigma(heavier, 1.0 / share)),
        heavier_wrench=HEAVIER * used,
        undetermined=undetermined_directions(
            known.covariance(1.0 / share), np.full(6 * sensor.n, sensor.gain_prior), sensor.channels
        ),
        pose=pose,
        blind_to=blind_to(pose, delay, ceiling=sensor.gain_prior),
    )


def _told(rig: Rig, simulated: Callable[[Rig], Log]) -> tuple[Information, list[Array]]:
    return information(rig, [simulated(rig)], rig.sensor.nominal_gain_array)


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
        "A": prediction.pose.A,
    }
