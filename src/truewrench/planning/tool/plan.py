"""From a rig to poses, or a motion, that determine a tool, and the files that hold them."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.estimation.static_poses import DWELL
from truewrench.io.plans import joint_table
from truewrench.io.table import ACCELERATION, GRAVITY, TWIST
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.calibration_parts import Verdict
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.motion.trajectory import SplineTwist, attitude
from truewrench.model.motion.trajectory_joint import SplineJoints
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import UNKNOWN
from truewrench.planning.check import check_twist
from truewrench.planning.joint_check import check_joints
from truewrench.planning.joint_space import joint_limits
from truewrench.planning.limits import Limits, Usage
from truewrench.planning.planner import check_limits, plan, simulated_log
from truewrench.planning.prediction import ideal
from truewrench.planning.result import FORMAT, Design, alpha_of, write_design
from truewrench.planning.tool.directions import abba, spread, spread_among
from truewrench.planning.tool.path import Timed, joint_path, route, twist_path
from truewrench.planning.tool.postures import Reach, Stand, postures_towards, reach_of
from truewrench.planning.tool.prediction import ToolPrediction, predict_motion, predict_poses
from truewrench.tool.judge import LIGHT
from truewrench.tool.prior import settings_of
from truewrench.tool.undetermined import NARROW, directions_of

Progress = Callable[[str, float | None], None]

POSES = 12  # how many, unless stated: more hardly tell more, and drift has more time

FEWEST, MOST = 4, 200
"""Poses at least and at most: time and memory of planning grow with their square."""

DWELL_DEFAULT = 3.0  # [s] at a pose, of which identification leaves out the first second
DWELL_MOST = 600.0  # [s] at a pose at most: averages have long ceased to gain on drift

EXPECTED: dict[str, Any] = {
    "mass": 1.5,
    "center_of_mass": [0.0, 0.0, 0.08],
    "inertia": {"xx": 0.006, "yy": 0.006, "zz": 0.003, "xy": 0.0, "xz": 0.0, "yz": 0.0},
}
"""The tool that is expected where the rig states none."""

_SMALLER = 0.93  # of the cone of a twist that exceeds a limit
_TRIES = 24
_SIMULATED = 60.0  # [s] of a motion, at most, whose log tells what it promises


@dataclass(frozen=True, slots=True, eq=False)
class ToolPlan:
    """Poses, or a motion, that determine a tool."""

    rig: Rig  # it is made for, with the expected tool as its only payload
    kind: str  # `poses` or `motion`
    design: Design  # motion, table and preview
    dwells: Array  # (T, 2) begin and end of each pose [s]
    fall: Array  # (T, 3) directions of gravity in the sensor, one a pose
    # of the cone about the direction at home whose rim is reached [rad]; 0 where it is no cone
    half_angle: float
    # what an identification with it promises; None where nothing can be done
    prediction: ToolPrediction | None
    seconds: float  # that planning took

    @property
    def usage(self) -> list[Usage]:
        """Use of every limit."""
        return self.design.preview.usage

    @property
    def violations(self) -> tuple[str, ...]:
        """Limits that are exceeded, and what the tool would not be determined for, in words."""
        over = (use.words() for use in sorted(self.usage, key=lambda use: use.first or 0.0) if use.violated)
        return (*self.design.obstacles, *over, *self._undetermined)

    @property
    def feasible(self) -> bool:
        """Whether every limit holds and mass and centre of mass will be determined."""
        return not self.violations

    @property
    def verdict(self) -> Verdict:
        """Whether to move like this, and every reason why not."""
        return Verdict(self.feasible, self.violations)

    @property
    def _undetermined(self) -> tuple[str, ...]:
        found, out = self.prediction, []
        if self.kind == "poses":
            apart, _, _ = directions_of(self.fall)
            if apart < 3:
                out.append(
                    f"the poses that can be reached show {apart} directions of gravity: three at least, "
                    "far apart, separate weight from offset; tilt further, or plan a motion (`--motion`)"
                )
        if found is None:
            return tuple(out)
        relative = found.mass_std / found.mass
        if not found.determined["mass"] or relative > LIGHT:
            out.append(f"the mass would not be determined: 1 sigma {100.0 * relative:.0f} %")
        lacking = [a for a, told in zip("xyz", found.determined["center_of_mass"], strict=True) if not told]
        if lacking:
            out.append(f"the centre of mass along {', '.join(lacking)} would not be determined")
        return tuple(out)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is no fault, but worth a look."""
        notes = list(self.design.notes)
        if self.kind == "poses":
            notes.append("poses do not tell the inertia: `--motion` plans what does")
            _, cone, _ = directions_of(self.fall)
            if cone < NARROW:
                notes.append(
                    f"gravity stays within {np.degrees(cone):.0f} deg of one direction: weight "
                    "and offset along it are hardly separated"
                )
        return tuple(notes)

    def to_mapping(self) -> dict[str, Any]:
        """As PLAN.plan.yaml holds it."""
        found, sensor = self.prediction, self.rig.sensor
        gain_std = np.full((sensor.n, 6), sensor.gain_prior) if found is None else found.gain_std
        units = 1.0 / sensor.gain_unit
        name, body = next(iter(self.rig.payloads.items()))
        return {
            "format": FORMAT,
            "of": "tool",
            "kind": self.kind,
            "expected": {"name": name, "mass": body.mass, "center_of_mass": list(body.center_of_mass)},
            "duration": float(self.design.motion.duration),
            "feasible": self.feasible,
            "violations": list(self.violations),
            "verdict": self.verdict.to_mapping(),
            "predicted": None if found is None else found.to_mapping(),
            "predicted_rms": sensor.gain_prior
            if found is None
            else float(np.sqrt(np.mean((gain_std * units) ** 2))),
            "predicted_gain_std": None if found is None else gain_std.tolist(),
            "alpha": alpha_of(self.rig, self.design),
            "poses": [
                {"begin": float(begin), "end": float(end), "gravity_direction": fall.tolist()}
                for (begin, end), fall in zip(self.dwells, self.fall, strict=True)
            ],
            "half_angle": self.half_angle,
            "limits_used": [use.to_mapping() for use in self.usage],
            "notes": list(self.notes),
            "search": dict(self.design.facts or {}),
            "seconds": self.seconds,
        }

    def write(self, path: str | Path) -> list[Path]:
        """Write the table (CSV, or Parquet by its suffix) and what stands beside it; return all paths."""
        return write_design(self.design, self.to_mapping(), path)


def plan_tool(
    source: Rig | Calibration,
    *,
    motion: bool = False,
    poses: int = POSES,
    dwell: float = DWELL_DEFAULT,
    cone: float = np.pi,
    payload: str | None = None,
    progress: Progress | None = None,
) -> ToolPlan:
    """Plan what determines a tool: poses, or a motion, which alone tells inertia, or where nothing weighs.

    The source is a rig, or a calibration, whose covariance of the gain then is what is believed beforehand.
    The payload, the first of the rig if left out, is the tool that is expected; of `tool_rig` it is
    `EXPECTED`. At each pose the arm dwells [s]; the cone is the largest angle of gravity, in the sensor, to
    where it points at first [rad].
    """
    started, tell = time.perf_counter(), progress or (lambda phase, share: None)
    rig, notes = _with_expected(source, payload)
    if rig.motion.source == "imu":
        expected = "`twist` or `joints`: a motion is planned in these"
        raise UnsupportedError.at(rig.path, "motion.source", "`imu`", expected)
    if not FEWEST <= poses <= MOST:
        raise InputError.at(None, "--poses", f"{poses}", f"at least {FEWEST} and at most {MOST}")
    if not DWELL < dwell <= DWELL_MOST:
        expected = f"more than {DWELL:g} s, the first left out, and at most {DWELL_MOST:g} s"
        raise InputError.at(None, "--dwell", f"{dwell:g}", expected)
    if not 0.0 < cone <= np.pi + 1e-9:
        raise InputError.at(None, "--cone", f"{np.degrees(cone):g}", "degrees, above 0 and up to 180")
    settings, name = settings_of(source), next(iter(rig.payloads))
    body = rig.payloads[name]
    if motion or not rig.in_gravity:
        if not motion:
            notes = (*notes, "nothing weighs here, and poses tell nothing: a motion is planned")
        planned = plan(rig, payload=name, progress=tell)
        design = replace(planned.design, notes=(*notes, *planned.design.notes))
        prediction = None
        if planned.prediction is not None:
            tell("prediction", None)
            span = min(design.motion.duration, max(design.period, _SIMULATED))
            log = simulated_log(ideal(rig), name, design.motion, span)
            prediction = predict_motion(source, settings, body, log)
        empty = np.empty((0, 2)), np.empty((0, 3))
        return ToolPlan(rig, "motion", design, *empty, 0.0, prediction, time.perf_counter() - started)
    if rig.motion.source == "joints":
        timed, design, half_angle = _arm(rig, name, poses, dwell, cone, tell)
    else:
        check_limits(rig)
        timed, design, half_angle = _turning(rig, name, poses, dwell, cone)
    design = replace(design, notes=(*notes, *design.notes))
    R_sensor_root = timed.R_root_sensor.transpose(0, 2, 1)
    fall = R_sensor_root @ (rig.gravity_array / np.linalg.norm(rig.gravity_array))
    prediction = None
    if len(fall):
        tell("prediction", None)
        prediction = predict_poses(source, settings, body, timed.dwells, R_sensor_root, timed.time[-1])
    seconds = time.perf_counter() - started
    return ToolPlan(rig, "poses", design, timed.dwells, fall, half_angle, prediction, seconds)


def _with_expected(source: Rig | Calibration, payload: str | None) -> tuple[Rig, tuple[str, ...]]:
    """The rig with the expected tool alone, its twists those of the sensor, and what to say of it."""
    rig = source.rig if isinstance(source, Calibration) else source
    data = rig.to_mapping()
    notes: tuple[str, ...] = ()
    if tuple(rig.payloads) == (UNKNOWN,):
        data["payloads"] = {UNKNOWN: EXPECTED}
        notes = (f"no payload is stated: a tool of {EXPECTED['mass']:g} kg is expected",)
        if payload is not None:
            raise InputError.at(rig.path, "payloads", f"no `{payload}`", "that name, or no --payload")
    else:
        name = rig.payload_named(payload)
        data["payloads"] = {name: data["payloads"][name]}
        if rig is source and rig.motion.of == "com":
            notes = (
                "the twist is that of the sensor, as `tool` reads it; `simulate` and `calibrate` take what "
                "this rig logs for `com`, which stands where nothing is stated: state `motion.of: sensor`",
            )
    if rig.motion.source == "twist":
        data["motion"]["of"] = "sensor"
    return Rig.from_mapping(data, rig.path), notes


def _arm(
    rig: Rig, payload: str, count: int, dwell: float, cone: float, tell: Progress
) -> tuple[Timed, Design, float]:
    tell("postures within the limits", None)
    stand = Stand.of(rig, payload)
    reach = reach_of(stand, cone, rig.plan.seed)
    options = _options(reach, count)
    tell("ways between them", None)
    moves, kept = route(stand, options)
    timed = joint_path(stand, moves, len(kept), dwell, rig.plan.rate)
    motion = SplineJoints.through(timed.time, timed.position, timed.velocity, timed.acceleration)
    names = stand.robot.joints
    columns = joint_table(names, timed.time, timed.position, timed.velocity, timed.acceleration)
    tell("last look at the limits", None)
    preview = check_joints(rig, payload, stand.robot, joint_limits(rig, stand.robot), motion, motion.duration)
    notes = []
    if len(kept) < count:
        notes.append(f"{len(kept)} of {count} poses can be reached within the limits")
    touching = stand.collisions
    if touching is not None and touching.missing:
        notes.append(f"{len(touching.missing)} meshes of the URDF were not found: they may touch")
    elif touching is None:
        notes.append(
            "the URDF has no collision geometry: distances between sensor, tool and links are looked at, and "
            "nothing else"
        )
    facts = {"collision_pairs": 0 if touching is None else touching.pairs, "postures": len(reach.samples)}
    design = Design(motion, columns, preview, motion.duration, tuple(notes), facts, (), names)
    return timed, design, reach.half_angle


def _options(reach: Reach, count: int) -> list[Array]:
    """Postures of each pose, in the order in which they are visited."""
    if reach.half_angle > 0.0:
        wanted = spread(count, reach.axis, reach.half_angle)
    else:
        wanted = reach.fall[spread_among(reach.fall, count)]
    found = [postures_towards(reach, direction) for direction in wanted[abba(wanted)]]
    return [postures for postures in found if len(postures)]


def _turning(rig: Rig, payload: str, count: int, dwell: float, cone: float) -> tuple[Timed, Design, float]:
    """Of a rig without an arm: the sensor turns on the spot."""
    limits = Limits.of(rig, 6)
    down = rig.gravity_array / np.linalg.norm(rig.gravity_array)
    angle = min(cone, float(limits.upper[3:].min()))
    for _ in range(_TRIES):
        falls = spread(count, down, angle)
        timed = twist_path(falls[abba(falls)], down, limits, dwell, rig.plan.rate)
        motion = SplineTwist.through(timed.time, timed.velocity)
        preview = check_twist(rig, payload, limits, motion, motion.duration)
        if not any(use.violated and use.limit in ("position", "workspace") for use in preview.usage):
            break
        angle *= _SMALLER
    columns = {"time_s": timed.time}
    columns |= dict(zip(TWIST, timed.velocity.T, strict=True))
    columns |= dict(zip(ACCELERATION, timed.acceleration.T, strict=True))
    R = attitude(motion, timed.time)
    columns |= dict(zip(GRAVITY, (rig.gravity_array @ R).T, strict=True))
    notes = ("the twist is that of the sensor's origin, and the sensor starts along the axes of the root",)
    return timed, Design(motion, columns, preview, motion.duration, notes), angle
