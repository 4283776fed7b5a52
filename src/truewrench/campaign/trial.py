"""One trial of a campaign: draw a truth, simulate, calibrate, and say in one row how far off it is."""

import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import pyarrow as pa
from scipy.special import ndtri

from truewrench.calibrating.pipeline import EstimatorName, calibrate
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.motion.trajectory import Trajectory
from truewrench.model.motion.trajectory_joint import JointTrajectory
from truewrench.model.rig import Rig
from truewrench.simulation.arm.run import ArmRun, simulate_arm
from truewrench.simulation.free_body import SimulatedRun, simulate
from truewrench.simulation.truth import Truth, nees

STREAMS = {"force": "force", "moment": "moment", "v": "velocities v", "Omega": "velocities Omega"}

Outcome = Literal["calibrated", "refused", "fault"]
Row = dict[str, Any]

_WITHIN_95 = float(ndtri(0.975))

_NUMBERS = (
    *("rms_error", "rms_stated", "rms_oracle", "nees", "largest_deviation", "coverage"),
    *(f"noise_{stream}" for stream in STREAMS),
    "masked",
    *("time_offset_error", "time_offset_std", "seconds"),
)
SCHEMA = pa.schema(
    [
        pa.field("trial", pa.int64()),
        pa.field("seed", pa.int64()),
        pa.field("outcome", pa.string()),
        pa.field("usable", pa.bool_()),
        pa.field("reasons", pa.list_(pa.string())),
        *(pa.field(name, pa.float64()) for name in _NUMBERS),
        pa.field("nees_dof", pa.int64()),
        # normalised, row by row of the gain
        pa.field("error", pa.list_(pa.float64())),
        pa.field("std", pa.list_(pa.float64())),
    ]
)


Planned = Trajectory | JointTrajectory


def run_trial(
    rig: Rig, trajectory: Planned, estimator: EstimatorName, seed: int, trial: int
) -> Row | UnsupportedError:
    """One row: what a simulated calibration found, was refused for, or stumbled over.

    A combination of settings that is not supported is returned, since it holds for every trial alike.
    """
    drawn = trial_seed(seed, trial)
    try:
        run = simulated(rig, trajectory, drawn)
        started = time.perf_counter()
        found = calibrate(rig, run.log, estimator, threads=1, held_out=False)
        seconds = time.perf_counter() - started
        return make_row(
            trial, drawn, "calibrated", found.verdict.reasons, **_judge(found, run.truth), seconds=seconds
        )
    except UnsupportedError as error:
        return error
    except InputError as error:
        return make_row(trial, drawn, "refused", error.problems)
    except Exception as error:  # any: a fault is a finding of the campaign, with its place
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return make_row(trial, drawn, "fault", (f"{type(error).__name__}: {error} ({where})",))


def simulated(rig: Rig, trajectory: Planned, seed: int) -> SimulatedRun | ArmRun:
    """As `truewrench simulate` does: a free body, or an arm in MuJoCo."""
    if rig.motion.source == "joints":
        return simulate_arm(rig, cast(JointTrajectory, trajectory), seed=seed)
    return simulate(rig, cast(Trajectory, trajectory), seed=seed)


def trial_seed(seed: int, trial: int) -> int:
    """The seed with which `simulate` repeats the log of a trial; campaigns of other seeds share none."""
    return int(np.random.SeedSequence((seed, trial)).generate_state(1, np.uint64)[0] >> np.uint64(1))


def make_row(trial: int, seed: int, outcome: Outcome, reasons: Sequence[str], **values: Any) -> Row:
    """A row of these values, null in every other column."""
    empty: Row = dict.fromkeys(SCHEMA.names)
    identity = {"trial": trial, "seed": seed, "outcome": outcome, "usable": False, "reasons": list(reasons)}
    return empty | identity | values


def _judge(found: Calibration, truth: Truth) -> Row:
    """The columns of a calibration whose truth is known."""
    sensor, n = found.rig.sensor, found.rig.sensor.n
    normalise = 1.0 / sensor.gain_unit.ravel()
    error = (found.gain - truth.gain).ravel() * normalise
    covariance = found.covariance[: 6 * n, : 6 * n] * np.outer(normalise, normalise)
    std = np.sqrt(np.diag(covariance))
    deviation = np.abs(error) / std
    squared, freedom = nees(error, covariance)
    noise = (found.figures.get("noise_found") or [{}])[-1]
    left_out = sum(sum(log.masked.values()) for log in found.logs)
    total = left_out + sum(log.used for log in found.logs)
    values: Row = {
        "rms_error": np.sqrt(np.mean(error**2)),
        "rms_stated": np.sqrt(np.mean(std**2)),
        "rms_oracle": None if found.bound is None else found.bound.oracle_rms,
        "nees": squared,
        "largest_deviation": deviation.max(),
        "coverage": np.mean(deviation <= _WITHIN_95),
        "time_offset_error": found.time_offset - truth.time_offset,
        "time_offset_std": found.time_offset_std,
    }
    values |= {f"noise_{stream}": noise.get(name) for stream, name in STREAMS.items()}
    values["masked"] = left_out / total if total else None
    known = {name: float(x) for name, x in values.items() if x is not None and np.isfinite(x)}
    return known | {
        "usable": found.verdict.usable,
        "nees_dof": freedom,
        "error": error.tolist(),
        "std": std.tolist(),
    }
