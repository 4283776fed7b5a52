"""A whole arm from plan to verdict: plan -> MuJoCo -> calibrate -> validate, with pictures."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from truewrench import robots
from truewrench.calibrating.pipeline import calibrate
from truewrench.io.pictures.arm import arm_figure
from truewrench.io.tables import read_log
from truewrench.judging.validation import Validation, validate
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.errors import UnsupportedError
from truewrench.model.files import write_yaml
from truewrench.model.rig import Rig, load_rig
from truewrench.planning.planner import plan as make_plan
from truewrench.planning.result import Plan
from truewrench.report.figures.arm import driven_figure, gain_figure
from truewrench.robot.arm import robot_of
from truewrench.simulation.arm import ArmRun, simulate_arm, simulate_plan
from truewrench.simulation.arm.run import arm_with
from truewrench.simulation.truth import nees

_POSTURES = 6  # of the arm in its picture


def run_arm(
    arm: str, output: Path, seed: int = 0, progress: Callable[[str, float | None], None] | None = None
) -> dict[str, Any]:
    """Plan, simulate, calibrate and validate with an arm, and write every file and picture into a folder.

    The arm is the name of a packaged one, or the path of a rig; rig and URDF are copied into the folder.
    Another log of the same sensor validates. Returns `outputs`: the files; `figures`: numbers by name;
    `verdict`: of calibration and validation; `text`: for a person.
    """
    tell = progress or (lambda phase, share: None)
    rig = load_rig(arm if Path(arm).exists() else robots.path(arm))
    if rig.motion.source != "joints":
        raise UnsupportedError.at(rig.path, "motion.source", rig.motion.source, "`joints`: an arm")
    rig = _copy(rig, output)
    plan = make_plan(rig, progress=tell)
    plan_files = plan.write(output / "plan.csv")
    files = [output / "rig.yaml", *plan_files]
    if not plan.feasible:
        return _result(files, {"predicted_rms": plan.predicted_rms}, plan.violations, _no_motion(plan))
    tell("the arm moves", None)
    run = simulate_plan(rig, plan_files[0], seed=seed)
    log_path, truth_path = run.write(output / "run.csv")
    tell("calibration", None)
    calibration = calibrate(rig, read_log(log_path, rig))
    calibration_path = output / "calibration.yaml"
    calibration.write_yaml(calibration_path)
    tell("validation", None)
    other = simulate_arm(_same_sensor(rig, run), seed=seed + 1)
    other_path, other_truth = other.write(output / "validation.csv")
    validation = validate(calibration, rig, read_log(other_path, rig))
    validation_path = output / "validation.yaml"
    validation.write_yaml(validation_path)
    tell("figures", None)
    figures = _figures(rig, run, calibration) | {
        "predicted_rms": plan.predicted_rms,
        "planning_seconds": plan.seconds,
        "axes": {name: axis.ratio for name, axis in validation.axes.items()},
    }
    pictures = [output / name for name in ("arm.png", "driven.png", "gain.png")]
    _draw_arm(pictures[0], rig, run)
    _draw_driven(pictures[1], rig, run)
    _draw_gain(pictures[2], run, calibration, plan, figures)
    files += [log_path, truth_path, calibration_path, other_path, other_truth, validation_path, *pictures]
    reasons = [*calibration.verdict.reasons, *_own_reasons(calibration, validation)]
    return _result(files, figures, reasons, _text(rig, run, calibration, validation, figures))


def _result(
    files: Sequence[Path], figures: dict[str, Any], reasons: Sequence[str], text: str
) -> dict[str, Any]:
    return {
        "outputs": [str(file) for file in files],
        "figures": figures,
        "verdict": {"usable": not reasons, "reasons": list(reasons)},
        "text": text,
    }


def _copy(rig: Rig, output: Path) -> Rig:
    """The rig from the folder of the results, so that every step can be repeated there."""
    output.mkdir(parents=True, exist_ok=True)
    settings, target = rig.to_mapping(), output / "rig.yaml"
    if rig.urdf_path is not None:
        urdf = output / rig.urdf_path.name
        if not (urdf.exists() and urdf.samefile(rig.urdf_path)):
            shutil.copyfile(rig.urdf_path, urdf)
        settings["motion"]["robot"]["urdf"] = urdf.name
    write_yaml(target, settings)
    return load_rig(target)


def _same_sensor(rig: Rig, run: ArmRun) -> Rig:
    """The rig whose simulations have the sensor of a run."""
    settings, truth = rig.to_mapping(), run.truth
    settings["simulate"] |= {"gain": truth.gain.tolist(), "offset": truth.offset.tolist()}
    return Rig.from_mapping(settings, rig.path)


def _figures(rig: Rig, run: ArmRun, calibration: Calibration) -> dict[str, Any]:
    error, covariance = _error(rig, run, calibration)
    squared, freedom = nees(error, covariance)
    bound = calibration.bound
    return {
        **run.figures(),
        "rms_error": float(np.sqrt(np.mean(error**2))),
        "rms_stated": float(np.sqrt(np.mean(np.diag(covariance)))),
        "rms_bound": None if bound is None else bound.rms,
        "rms_start": float(
            np.sqrt(np.mean((_normalised(rig, run.truth.gain - rig.sensor.nominal_gain_array)) ** 2))
        ),
        "nees": squared / max(1, freedom),
        "largest_share_of_range": float(np.max(np.abs(run.moved.wrench) / rig.sensor.range_array)),
    }


def _normalised(rig: Rig, gain: Array) -> Array:
    return np.asarray(gain / rig.sensor.gain_unit)


def _error(rig: Rig, run: ArmRun, calibration: Calibration) -> tuple[Array, Array]:
    """Error (6n,) of the normalised gains, and their covariance."""
    unit = _normalised(rig, np.ones_like(run.truth.gain)).ravel()
    covariance = calibration.covariance[: unit.size, : unit.size] * np.outer(unit, unit)
    return (calibration.gain - run.truth.gain).ravel() * unit, covariance


def _draw_arm(path: Path, rig: Rig, run: ArmRun) -> None:
    time, joints = run.moved.stamps.motion, run.moved.joints
    body = run.truth.payloads[run.log.payload]
    arm = arm_with(rig, robot_of(rig), body)
    sensor = joints.reading.p_root_sensor
    payload = sensor + joints.reading.R_root_sensor @ body.center_of_mass
    postures = arm.skeleton(joints.position[np.linspace(0, len(time) - 1, _POSTURES).astype(np.int64)])
    travel = float(np.linalg.norm(payload - payload[0], axis=1).max())
    rate = float(np.linalg.norm(joints.reading.twist[:, 3:], axis=1).max())
    caption = (
        f"The arm at {_POSTURES} times (light: later), root, joints and sensor joined by lines, with the "
        f"paths of the sensor and of the centre of mass of {body.mass:.4g} kg over {time[-1]:.3g} s. The "
        f"payload moves by up to {travel:.2g} m and turns at up to {rate:.2g} rad/s. Conclusion: this is the "
        "room that the calibration needs; check it for what stands there."
    )
    arm_figure(path, postures, time, sensor, payload, caption)


def _draw_driven(path: Path, rig: Rig, run: ArmRun) -> None:
    joints, time = run.moved.joints, run.moved.stamps.motion
    error = joints.velocity - run.trajectory.velocity(time)
    share = run.moved.wrench / rig.sensor.range_array
    caption = (
        f"What the arm did in MuJoCo with {run.truth.payloads[run.log.payload].mass:.4g} kg: joint-velocity "
        f"servos follow the plan to {1e3 * np.abs(error).max():.2g} mrad/s. The wrench stays within "
        f"{100 * np.abs(share).max():.0f}% of the range, and agrees with Newton and Euler on the recorded "
        f"motion to {run.moved.disagreement:.0e}. Conclusion: the log is not the plan, but a motion with a "
        "wrench that belongs to it."
    )
    driven_figure(path, run.joints, time, joints.velocity, error, (run.moved.stamps.shown, share), caption)


def _draw_gain(
    path: Path, run: ArmRun, calibration: Calibration, plan: Plan, figures: dict[str, Any]
) -> None:
    error, covariance = _error(plan.rig, run, calibration)
    shape = run.truth.gain.shape
    sigma = np.sqrt(np.diag(covariance)).reshape(shape)
    largest = float(np.abs(error.reshape(shape) / sigma).max())
    caption = (
        f"Sigma of the {error.size} normalised gains and the errors of this run. Before, the gains were off "
        f"by {figures['rms_start']:.2g} (RMS), now by {figures['rms_error']:.2g}; the plan promised a sigma "
        f"of {figures['predicted_rms']:.2g}, the calibration states {figures['rms_stated']:.2g}. The largest "
        f"error is {largest:.1f} sigma, and all errors together are {figures['nees']:.2f} times as large "
        "(squared) as their covariance says. Conclusion: "
        + ("nothing in this run speaks against sigma." if figures["nees"] < 2.0 else "sigma is too small.")
    )
    promised = () if plan.prediction is None else (("sigma that the plan promised", plan.prediction.std),)
    both = [*promised, ("sigma that the calibration states", sigma)]
    gain_figure(path, plan.rig.sensor.channels, both, error.reshape(shape), caption)


def _own_reasons(calibration: Calibration, validation: Validation) -> tuple[str, ...]:
    """What the other motion says against the calibration, but not what that says of itself (the first)."""
    return validation.verdict.reasons[0 if calibration.verdict.usable else 1 :]


def _no_motion(plan: Plan) -> str:
    lines = ["no motion keeps to the limits:", *(f"  - {words}" for words in plan.violations)]
    return "\n".join(lines) + "\n"


def _text(
    rig: Rig, run: ArmRun, calibration: Calibration, validation: Validation, figures: dict[str, Any]
) -> str:
    body = rig.payloads[run.log.payload]
    where = "in gravity" if rig.in_gravity else "on orbit"
    lines = [
        f"{len(run.joints)} joints, {body.mass:g} kg {where}, {run.trajectory.duration:g} s of motion",
        f"servos: within {1e3 * figures['tracking_error_velocity']:.2g} mrad/s of the plan; "
        f"wrench up to {100 * figures['largest_share_of_range']:.0f}% of range, "
        f"Newton-Euler to {figures['newton_euler_disagreement']:.0e}",
        f"gains (normalised, RMS): off by {figures['rms_start']:.4f} before, "
        f"{figures['rms_error']:.5f} after; stated sigma {figures['rms_stated']:.5f}, promised "
        f"{figures['predicted_rms']:.5f}"
        + ("" if figures["rms_bound"] is None else f", bound {figures['rms_bound']:.5f}")
        + f"; NEES/{run.truth.gain.size} {figures['nees']:.2f}",
        "",
        "another motion, RMS residual with the nominal and the new gain:",
    ]
    lines += [
        f"  {name}  {axis.nominal:9.4g} {axis.new:9.4g}   better: {axis.better}"
        for name, axis in validation.axes.items()
    ]
    against = _own_reasons(calibration, validation)
    for what, usable, reasons in (
        ("calibration", calibration.verdict.usable, calibration.verdict.reasons),
        ("validation", not against, against),
    ):
        lines += ["", f"{what}: {'usable' if usable else 'NOT TO BE USED AS IT STANDS'}"]
        lines += [f"  - {reason}" for reason in reasons]
    return "\n".join(lines) + "\n"
