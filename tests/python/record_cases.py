"""What the tests of the new estimator's records begin with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench import _core
from truewrench.estimation.record import recorded_logs
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.truth import Truth

Array = np.ndarray[Any, np.dtype[np.float64]]
RigOf = Callable[..., Rig]

HONEST = 2.5  # NEES per gain of one record
G = [0, 0, -9.81]


def rig_with(settings: dict[str, Any], **changes: Any) -> Rig:
    """A twist rig of 8 s that states what its simulated truth is drawn from; sections changed."""
    start: dict[str, Any] = settings | {
        "sensor": {**settings["sensor"], "discrepancy": 0},
        "plan": {"duration": 8},
        "gravity_tilt_prior": 0,
        "simulate": {"payload": "random", "time_offset": "random", "seed": 1},
    }
    for section, values in changes.items():
        start[section] = {**start.get(section, {}), **values} if isinstance(values, dict) else values
    return Rig.from_mapping(start)


def estimate(rig: Rig, *logs: Log) -> Any:
    assumed, statement, streams = recorded_logs(rig, logs)
    settings = _core.Settings()
    settings.discrepancy = assumed.discrepancy
    return _core.estimate(statement, streams, settings)


def nees(found: Any, rig: Rig, truth: Truth) -> float:
    """Of the normalised gain, per gain; 1 is honest."""
    assert found.status == _core.Status.ok
    true = truth.gain * rig.sensor.range_array / rig.sensor.channel_scale[:, None]
    error = np.asarray(found.fit.theta)[: true.size] - true.ravel()
    return float(error @ np.linalg.solve(np.asarray(found.gain_covariance), error)) / true.size


def masked(found: Any) -> int:
    return int(np.sum(found.fit.rows(0)["masked"]))


def base_log(rig: Rig, time: Array, joints: int, *, hurry: float = 1.0) -> Log:
    """A base that turns and drifts, told at these times."""
    sped = hurry * time
    rate = np.column_stack([0.3 * np.cos(0.9 * sped + k) for k in range(6)])
    turn = Rotation.from_euler("xyz", np.column_stack([0.4 * np.sin(0.5 * sped + k) for k in range(3)]))
    return Log(
        None,
        next(iter(rig.payloads)),
        "",
        np.round(1e9 * time).astype(np.int64),
        np.zeros((time.size, rig.sensor.n)),
        position=np.zeros((time.size, joints)),
        base_twist=rate,
        base_attitude=turn.as_quat()[:, [3, 0, 1, 2]],
    )


def arm_with(arm_rig: RigOf, arm: str, **motion: Any) -> Rig:
    rig = arm_rig(arm, motion=motion, plan={"duration": 8}, gravity_tilt_prior=0)
    settings = rig.to_mapping()
    uncertain = {"mass": 1e-3, "center_of_mass": 5e-4, "inertia": 1e-2}
    for payload in settings["payloads"].values():
        payload["uncertainty"] = uncertain
    settings["sensor"] |= {"discrepancy": 0, "time_offset_prior": 5e-3}
    settings["simulate"] |= {"rate": 100, "sensor_rate": 100, "payload": "random", "time_offset": "random"}
    return Rig.from_mapping(settings, rig.path)


def light_rig(*, seconds: float, rate: float, **sensor: Any) -> Rig:
    """5 kg on a sensor of 100 N and 10 N m, twist and channels at one rate."""
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": [0.1] * 3 + [0.01] * 3,
                "range": [100] * 3 + [10] * 3,
                **sensor,
            },
            "payloads": {
                "default": {
                    "mass": 5,
                    "center_of_mass": [0.02, -0.01, 0.1],
                    "inertia": {"xx": 0.1, "yy": 0.12, "zz": 0.06},
                }
            },
            "motion": {"noise": [1e-3] * 6},
            "plan": {"duration": seconds},
            "simulate": {"rate": rate, "sensor_rate": rate, "seed": 4},
        }
    )
