"""A planned motion with its verdict and its promise, and the files that hold them (docs/formats.md)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.io.joint_trajectory import write_joint_trajectory
from truewrench.io.plans import joint_columns
from truewrench.io.tables import write_table
from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import AXES, Verdict
from truewrench.model.files import write_yaml
from truewrench.model.motion.trajectory import SplineTwist, Trajectory, excitation_alpha
from truewrench.model.motion.trajectory_joint import JointTrajectory, SplineJoints
from truewrench.model.rig import Rig
from truewrench.planning.check import Preview
from truewrench.planning.limits import Usage, violations
from truewrench.planning.prediction import Prediction, figures
from truewrench.robot.arm import robot_of, turning

FORMAT = "truewrench-plan/1"  # what a plan's file says it is

_UNITS = {  # of what moves along an axis, and of what turns about one
    "position": ("m", "rad"),
    "velocity": ("m/s", "rad/s"),
    "acceleration": ("m/s^2", "rad/s^2"),
}
_MOST = 0.8  # share of the pose that a motion may hide without a word on it
_HARMONICS = 6  # beyond which more of them no longer help: words only
_ROWS = 12.0  # of the motion per period of its fastest frequency: a spline has three samples a coefficient


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """A motion before anything is promised of it."""

    motion: Trajectory | JointTrajectory  # twist of the rig's point, or joints
    columns: Mapping[str, Array]  # of the table: names and values (N,)
    preview: Preview  # at 1 kHz
    period: float  # after which the motion repeats itself [s]
    notes: tuple[str, ...] = ()  # what is worth a look
    facts: Mapping[str, Any] | None = None  # how it was found
    obstacles: tuple[str, ...] = ()  # why no motion is possible at all, in words
    joints: tuple[str, ...] = ()  # n names, if it is a motion of joints


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A motion that calibrates.

    Attributes:
        rig: it is made for.
        payload: that is carried.
        method: `optimal` or `wrench`.
        criterion: `A` or `D`.
        design: motion, table and preview.
        prediction: what a calibration with it promises; None where nothing moves.
        seconds: that planning took.
    """

    rig: Rig
    payload: str
    method: str
    criterion: str
    design: Design
    prediction: Prediction | None
    seconds: float

    @property
    def trajectory(self) -> Trajectory | JointTrajectory:
        """The motion as a function of time."""
        return self.design.motion

    @property
    def usage(self) -> Sequence[Usage]:
        """Use of every limit."""
        return self.design.preview.usage

    @property
    def violations(self) -> tuple[str, ...]:
        """Limits that are exceeded, the earliest first, in words."""
        return (*self.design.obstacles, *(use.words() for use in violations(self.usage)))

    @property
    def feasible(self) -> bool:
        """Whether every limit holds at all times."""
        return not self.violations

    @property
    def predicted_gain_std(self) -> Array | None:
        """(n, 6) 1 sigma of the gain after a calibration, raw units per N or N m."""
        return None if self.prediction is None else self.prediction.gain_std

    @property
    def predicted_rms(self) -> float:
        """RMS of the predicted sigma over the normalised gains; that of the prior where nothing moves."""
        return self.rig.sensor.gain_prior if self.prediction is None else self.prediction.rms

    @property
    def alpha(self) -> dict[str, float]:
        """Smallest eigenvalue of the integral of w w^T ([A00] 12): of w over range [s], and of w in SI."""
        return alpha_of(self.rig, self.design)

    @property
    def verdict(self) -> Verdict:
        """Whether to move like this, and every reason why not."""
        reasons = list(self.violations)
        undetermined = () if self.prediction is None else self.prediction.undetermined
        if undetermined:
            words = dict.fromkeys(direction.words for direction in undetermined)
            reasons.append("the motion would not determine: " + "; ".join(words))
        blind = () if self.prediction is None else self.prediction.blind_to
        return Verdict(not reasons, tuple(reasons), undetermined, blind)

    @property
    def fastest(self) -> float:
        """Highest frequency of the series or of the sinusoids [Hz], 0 where nothing moves."""
        facts = self.design.facts or {}
        if "k" in facts:
            return float(max(facts["k"]) / facts["tau"])
        return float(facts.get("harmonics", 0.0) / self.design.period)

    @property
    def unlimited(self) -> dict[str, list[float]]:
        """Largest values of what no limit holds back but the sensor's range, axis by axis or joint by joint.

        Of `position` (the integral of the twist; not of joints, nor within a workspace), `velocity` and
        `acceleration` those that neither rig nor URDF limits.
        """
        motion, time = self.design.motion, self.design.preview.time
        limited = {use.limit for use in self.usage}
        values: dict[str, Array] = {}
        if isinstance(motion, SplineTwist):
            values = {"velocity": motion.twist(time), "acceleration": motion.acceleration(time)}
            if "workspace" not in limited:
                values["position"] = motion.spline.antiderivative()(time)
        elif isinstance(motion, SplineJoints):
            values = {"velocity": motion.velocity(time), "acceleration": motion.acceleration(time)}
        return {name: np.abs(x).max(axis=0).tolist() for name, x in values.items() if name not in limited}

    @property
    def notes(self) -> tuple[str, ...]:
        """What is no fault, but worth a look."""
        notes, found = list(self.design.notes), self.prediction
        for name, reached in self.unlimited.items():
            turns = turning(robot_of(self.rig)) if self.design.joints else np.arange(6) > 2
            values = " and ".join(
                f"{np.max(reached, where=which, initial=0.0):.3g} {unit}"
                for which, unit in zip((~turns, turns), _UNITS[name], strict=True)
                if which.any()
            )
            notes.append(f"no limit of the {name} is stated: the motion reaches {values}")
        if found is not None and not found.undetermined:
            required = self.rig.required_array
            channel, axis = np.unravel_index(int(np.argmax(found.std / required)), found.std.shape)
            largest = float(found.std[channel, axis])
            if largest > required[axis]:
                notes.append(
                    f"the largest sigma, {largest:.3g} of the gain of "
                    f"{self.rig.sensor.channels[channel]} to {AXES[axis]}, would exceed `required` "
                    f"({required[axis]:g}): one record of this motion is not enough"
                )
        if found is not None and found.pose.A > _MOST and self.method == "optimal":
            few = self.rig.plan.harmonics < _HARMONICS
            helps = "more `plan.harmonics`" if few else "a longer `plan.duration` or wider limits"
            notes.append(
                f"the motion can hide {100 * found.pose.A:.0f} % of its pose: {helps} may hide less, "
                "and `sensor.discrepancy: 0` states that nothing follows it"
            )
        rate = self.rig.simulate.rate
        if self.fastest > rate / _ROWS:
            notes.append(
                f"`simulate.rate`, {rate:g} Hz, is too low for the {self.fastest:.3g} Hz of this motion: "
                "the prediction is doubtful"
            )
        return tuple(notes)

    def to_mapping(self) -> dict[str, Any]:
        """As PLAN.plan.yaml holds it."""
        found = self.prediction
        return {
            "format": FORMAT,
            "method": self.method,
            "criterion": self.criterion,
            "payload": self.payload,
            "duration": float(self.design.motion.duration),
            "period": self.design.period,
            "feasible": self.feasible,
            "violations": list(self.violations),
            "verdict": self.verdict.to_mapping(),
            "predicted_rms": self.predicted_rms,
            "predicted_gain_std": None if found is None else found.gain_std.tolist(),
            "predicted_normalised_gain_std": None if found is None else found.std.tolist(),
            **({} if found is None else figures(found)),
            "alpha": self.alpha,
            "unlimited": self.unlimited,
            "limits_used": [use.to_mapping() for use in self.usage],
            "rates": {"motion": self.rig.simulate.rate, "sensor": self.rig.simulate.sensor_rate},
            "notes": list(self.notes),
            "search": dict(self.design.facts or {}),
            "seconds": self.seconds,
        }

    def write(self, path: str | Path) -> list[Path]:
        """Write the table (CSV, or Parquet by its suffix) and what stands beside it; return all paths.

        PATH.plan.yaml holds the verdict and the promise; PATH.trajectory.yaml, of joints, is one
        `trajectory_msgs/msg/JointTrajectory`.
        """
        return write_design(self.design, self.to_mapping(), path)


def write_design(design: Design, facts: Mapping[str, Any], path: str | Path) -> list[Path]:
    """Write the table of a motion, and beside it `facts` as PATH.plan.yaml and the joints' trajectory."""
    target = Path(path)
    write_table(target, dict(design.columns))
    written = [target, target.with_name(target.name + ".plan.yaml")]
    write_yaml(written[1], dict(facts))
    if design.joints:
        written.append(target.with_name(target.name + ".trajectory.yaml"))
        blocks = [
            np.column_stack([design.columns[name] for name in names])
            for names in joint_columns(design.joints)
        ]
        write_joint_trajectory(written[-1], design.joints, design.columns["time_s"], *blocks)
    return written


def alpha_of(rig: Rig, design: Design) -> dict[str, float]:
    """Smallest eigenvalue of the integral of w w^T ([A00] 12): of w over range [s], and of w in SI."""
    preview = design.preview
    times = design.motion.duration / preview.time[-1]
    return {
        "normalised": times * excitation_alpha(preview.time, preview.wrench / rig.sensor.range_array),
        "published": times * excitation_alpha(preview.time, preview.wrench),
    }
