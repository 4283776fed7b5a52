"""A tool in the forms that controllers take: the physical body of `Tool.exported`, in flange axes.

Inertia that was not determined is never handed on in silence: zeros where a target takes a point mass (UR,
ABB, KUKA), else that of the sphere which `exported` holds, each with a comment in the file.
"""

import json
from collections.abc import Callable, Container, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.files import atomic_output
from truewrench.tool.bodies import flange_body, flange_wrench
from truewrench.tool.model import Tool
from truewrench.tool.parameters import COLUMNS, ROWS, roll_pitch_yaw

_ASSUMED = "inertia: not determined"
_FLANGE = "flange"  # name of its frame, where it is not the sensor's
_UR_LARGEST = 133.0  # kg m^2: what the controller takes of any element

FILES = {
    "ur": ("tool_ur.script",),
    "franka": ("tool_franka.json",),
    "urdf": ("tool.urdf",),
    "abb": ("tool_abb.mod",),
    "kuka": ("tool_kuka.dat",),
    "ros": (
        "tool_ros/admittance_controller.yaml",
        "tool_ros/gravity_compensation_filter.yaml",
        "tool_ros/ft_tools.yaml",
        "tool_ros/force_torque_tools.yaml",
    ),
}
"""What each target's files are called, in the folder of tool.yaml."""

_WITH_OFFSET = FILES["ros"][2:]
_AT_FLANGE = ("ur", "franka", "urdf", "abb", "kuka")


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """What an export holds, in flange axes."""

    mass: float
    center: Array
    inertia: Array
    assumed: bool
    words: tuple[str, ...]

    @property
    def elements(self) -> list[float]:
        """Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
        return list(self.inertia[ROWS, COLUMNS].tolist())

    def comment(self, mark: str) -> str:
        """Its words, line by line, for a format that holds a point mass where the inertia is assumed."""
        lines = (*self.words, *([f"{_ASSUMED}: zeros, a point mass"] if self.assumed else []))
        return "".join(f"{mark} {line}\n" for line in lines)

    @property
    def principal(self) -> tuple[Array, Array]:
        """Principal moments (3,) and right-handed axes, columns (3, 3); of a point mass where assumed."""
        if self.assumed:
            return np.zeros(3), np.eye(3)
        values, axes = np.linalg.eigh(self.inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 2] *= -1.0
        return np.maximum(values, 0.0), axes


def tool_exports(tool: Tool, targets: Sequence[str]) -> dict[str, str]:
    """The text of a tool's files for some of `TARGETS`, by their names in the folder of tool.yaml.

    InputError: a target is not known, or cannot take the body.
    """
    for target in targets:
        if target not in TARGETS:
            raise InputError.at(None, "export", f"`{target}`", f"one of {', '.join(TARGETS)}")
    held = _held(tool)
    texts: dict[str, str] = {}
    for target in targets:
        texts |= zip(FILES[target], TARGETS[target](tool, held), strict=False)  # what is left out comes last
    return texts


def left_out(tool: Tool, targets: Sequence[str]) -> dict[str, str]:
    """Files of some targets that cannot hold a tool, by name, and why."""
    if "ros" not in targets or _reads_wrenches(tool):
        return {}
    reason = "it wants the offset in N and N m; the raw channels of this sensor are something else"
    return dict.fromkeys(_WITH_OFFSET, reason)


def frames_note(tool: Tool, targets: Sequence[str]) -> str:
    """What is worth saying of the frame of what was exported; nothing where the flange was told."""
    told = [target for target in targets if target in _AT_FLANGE]
    if not told or np.any(tool.flange):
        return ""
    return (
        f"{', '.join(told)}: the sensor frame is taken for the flange, which these controllers have in mind; "
        "--flange says where it stands"
    )


def write_tool_exports(tool: Tool, targets: Sequence[str], folder: str | Path) -> list[Path]:
    """Write a tool for some targets, as `tool_exports` has it, beside tool.yaml; the files are returned."""
    written = []
    for name, text in tool_exports(tool, targets).items():
        path = Path(folder) / name
        with atomic_output(path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
        written.append(path)
    return written


def remove_exports(folder: str | Path, kept: Container[str] = ()) -> None:
    """Remove what an earlier tool left in a folder for any target: it would be taken for this one's.

    A file that does not say that it is from here, such as an arm of one's own in `tool.urdf`, stays.
    """
    for name in (name for names in FILES.values() for name in names if name not in kept):
        path = Path(folder) / name
        if path.is_file() and b"truewrench" in path.read_bytes():
            path.unlink()
    with suppress(OSError):  # none there, or something else in it
        (Path(folder) / "tool_ros").rmdir()


def _reads_wrenches(tool: Tool) -> bool:
    """Whether the raw channels are a wrench in N and N m, and so is the offset."""
    return np.array_equal(tool.rig.sensor.nominal_gain_array, np.eye(tool.n, 6))


def _held(tool: Tool) -> _Held:
    body = tool.exported
    center, inertia = flange_body(body.center_of_mass, body.inertia_matrix, tool.flange)
    whole = tool.whole
    words = [
        f"truewrench {tool.version}, {tool.created}: mass {whole.mass:.6g} kg, "
        f"1 sigma {whole.mass_std:.2g} kg",
        "Flange axes; the sensor frame stands at x y z roll pitch yaw = "
        + " ".join(f"{value:.6g}" for value in tool.flange)
        + ("" if np.any(tool.flange) else ": taken for the flange"),
    ]
    if tool.below is not None:
        words.append(f"With the tool below it, of {np.exp(tool.below[0]):.6g} kg.")
    if tool.housing[0] > 0.0:
        words.append(f"With the sensor's housing of {tool.housing[0]:.6g} kg.")
    if not tool.verdict.usable:
        words.append("NOT to be used as it stands: " + " ".join(tool.verdict.reasons))
    words = [" ".join(word.split()) for word in words]
    return _Held(body.mass, center, inertia, body.inertia_assumed, tuple(words))


def _numbers(values: Sequence[float] | Array) -> str:
    return ", ".join(f"{float(value):.9g}" for value in values)


def _ur(tool: Tool, held: _Held) -> list[str]:
    inertia = [0.0] * 6 if held.assumed else held.elements
    if max(map(abs, inertia)) > _UR_LARGEST:
        raise InputError.at(
            None, "export ur", f"an inertia of {max(map(abs, inertia)):.4g} kg m^2", "133 at most"
        )
    text = (
        held.comment("#")
        + "# [Ixx, Iyy, Izz, Ixy, Ixz, Iyz] about the centre of gravity. Calling this zeroes the sensor.\n"
        + f"set_target_payload({held.mass:.9g}, [{_numbers(held.center)}], [{_numbers(inertia)}])\n"
    )
    return [text]


def _franka(tool: Tool, held: _Held) -> list[str]:
    comment = " ".join(held.words)
    if held.assumed:
        comment += f" {_ASSUMED}: assumed, a solid sphere."
    document = {
        "mass": held.mass,
        "F_x_Cload": held.center.tolist(),
        "load_inertia": held.inertia.ravel(order="F").tolist(),  # column-major
        "comment": comment + " For setLoad, on top of the end effector; not while moving.",
    }
    return [json.dumps(document, indent=2) + "\n"]


def _urdf(tool: Tool, held: _Held) -> list[str]:
    ixx, iyy, izz, ixy, ixz, iyz = held.elements
    words = [*held.words, *([f"{_ASSUMED}: assumed, a solid sphere."] if held.assumed else [])]
    comment = "\n".join(f"  <!-- {word.replace('--', '- -')} -->" for word in words)
    text = f"""<?xml version="1.0"?>
<robot name="tool">
{comment}
  <link name="tool">
    <inertial>
      <origin xyz="{" ".join(f"{v:.12g}" for v in held.center)}" rpy="0 0 0"/>
      <mass value="{held.mass:.12g}"/>
      <inertia ixx="{ixx:.12g}" ixy="{ixy:.12g}" ixz="{ixz:.12g}" iyy="{iyy:.12g}" iyz="{iyz:.12g}" \
izz="{izz:.12g}"/>
    </inertial>
  </link>
</robot>
"""
    return [text]


def _abb(tool: Tool, held: _Held) -> list[str]:
    moments, axes = held.principal
    x, y, z, w = Rotation.from_matrix(axes).as_quat()
    text = (
        "MODULE tool_load\n"
        + held.comment("  !")
        + "  ! mass [kg], centre of gravity [mm], axes of moment, principal moments [kg m^2]\n"
        + f"  PERS loaddata tool_load := [{held.mass:.9g}, [{_numbers(1e3 * held.center)}], "
        + f"[{_numbers([w, x, y, z])}], {_numbers(moments)}];\n"
        + "ENDMODULE\n"
    )
    return [text]


def _kuka(tool: Tool, held: _Held) -> list[str]:
    moments, axes = held.principal
    roll, pitch, yaw = np.degrees(roll_pitch_yaw(axes.T))  # A about z, B about y', C about x''
    x, y, z = 1e3 * held.center
    text = (
        "DEFDAT tool_load\n"
        + held.comment(";")
        + "; kg; mm; degrees; principal moments about the centre of mass [kg m^2]\n"
        + f"DECL LOAD TOOL_LOAD={{M {held.mass:.9g},CM {{X {x:.9g},Y {y:.9g},Z {z:.9g},"
        + f"A {yaw:.9g},B {pitch:.9g},C {roll:.9g}}},J {{X {moments[0]:.9g},Y {moments[1]:.9g},"
        + f"Z {moments[2]:.9g}}}}}\n"
        + "ENDDAT\n"
    )
    return [text]


def _ros(tool: Tool, held: _Held) -> list[str]:
    """What compensates gravity on a wrench at the flange, along its axes: the same body as everywhere."""
    robot = tool.rig.motion.robot
    sensor = robot.sensor_frame if robot else "ft_sensor"
    frame = _FLANGE if np.any(tool.flange) else sensor
    size = float(np.linalg.norm(tool.gravity))
    mass, center = held.mass, held.center.tolist()
    feels = tool.rig.sensor.feels
    at_flange, felt = [], []
    if frame == _FLANGE:
        at_flange.append(
            f"For a wrench at the flange, along its axes (frame `{_FLANGE}`: rename it to yours); without "
            "--flange this file is for the sensor's own."
        )
    if tool.housing[0] > 0.0:
        felt.append("The sensor does not feel its housing: for its own wrench leave --housing out.")

    def document(content: object, *more: str, own: bool = False) -> str:
        head = [*held.words, *([] if own else at_flange), *felt]
        comment = "".join(f"# {line}\n" for line in (*head, *more))
        return comment + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)

    admittance = {
        "admittance_controller": {
            "ros__parameters": {
                "ft_sensor": {"frame": {"id": frame}},  # the controller turns the centre of mass, no more
                "fixed_world_frame": {"frame": {"id": "world"}},
                "gravity_compensation": {
                    "frame": {"id": frame},
                    "CoG": {"pos": center, "force": mass * size},
                },
            }
        }
    }
    gravity_filter = {
        "name": "gravity_compensation",
        "type": "control_filters/GravityCompensationWrench",
        "params": {
            "world_frame": "world",
            "sensor_frame": frame,
            "tool": {"CoG": center, "gravity_field": tool.gravity.tolist(), "mass": mass},
        },
    }
    toolbox = {
        "force_torque_sensor_broadcaster": {
            "ros__parameters": {"sensor_filter_chain": {"filter1": gravity_filter}}
        }
    }
    texts = [
        document(
            admittance,
            "Expects a tared wrench with the sign payload_on_sensor, and gravity along -z of",
            f"fixed_world_frame. This sensor: {feels}.",
        ),
        document(toolbox, f"For payload_on_sensor; knows no offset. This sensor: {feels}."),
    ]
    if _reads_wrenches(tool):  # an offset in N and N m is all that these know; `bias` is the sensor's own
        force, torque = flange_wrench(tool.offset, tool.flange).reshape(2, 3).tolist()
        ft_tools = {
            "mass": mass,
            "sensor_frame_to_com": center,
            "force_offset": force,
            "torque_offset": torque,
        }
        ft_calib = {
            "bias": tool.offset.tolist(),
            "gripper_com_child_frame_id": "gripper_com",
            "gripper_com_frame_id": frame,
            "gripper_com_pose": [*center, 0.0, 0.0, 0.0],
            "gripper_mass": mass,
        }
        release = {
            "payload_on_sensor": "the sources of May 2021 and later, not releases up to 1.2.0",
            "sensor_on_payload": "releases up to 1.2.0, not the sources of May 2021 and later",
        }[feels]
        weight = "Subtracts offset and [m g; c x m g]: for payload_on_sensor."
        texts += [
            document(ft_tools, weight, f"This sensor: {feels}."),
            document(
                ft_calib,
                f"`bias` is what the sensor itself reads, the centre of mass is in frame `{frame}`.",
                f"gravity_compensation of {release}.",
                own=True,
            ),
        ]
    return texts


TARGETS: dict[str, Callable[[Tool, _Held], list[str]]] = {
    "ur": _ur,
    "franka": _franka,
    "urdf": _urdf,
    "abb": _abb,
    "kuka": _kuka,
    "ros": _ros,
}
"""What `--export` takes, and how it is written."""
