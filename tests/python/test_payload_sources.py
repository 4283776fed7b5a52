"""A payload stated elsewhere is the same body, seen from the sensor; Pinocchio is the oracle."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray

from truewrench.model.errors import InputError
from truewrench.model.rig import PayloadSpec, Rig, load_rig

RigOf = Callable[[Mapping[str, Any]], Rig]
Array = NDArray[np.float64]

# The moving link has no mass of its own: all that the joint carries is payload.
TOOL = """<robot name="arm">
  <link name="base"/><link name="wrist"/><link name="ft"/>
  <link name="plate"><inertial><mass value="0.7"/><origin xyz="0.01 0 0.02" rpy="0.3 0.1 0.2"/>
    <inertia ixx="0.002" ixy="0.0001" ixz="0" iyy="0.003" iyz="-0.0002" izz="0.004"/></inertial></link>
  <link name="hand"><inertial><mass value="1.3"/>
    <inertia ixx="0.01" ixy="0" ixz="0.001" iyy="0.012" iyz="0" izz="0.008"/></inertial></link>
  <link name="finger"><inertial><mass value="0.2"/><origin xyz="0 0.03 0.05"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="wrist"/>
    <origin xyz="0.4 0 0.2" rpy="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="mount" type="fixed"><parent link="wrist"/><child link="ft"/>
    <origin xyz="0 0.01 0.1" rpy="0.2 -0.4 0.8"/></joint>
  <joint name="bolted" type="fixed"><parent link="wrist"/><child link="plate"/>
    <origin xyz="0 0 0.12" rpy="0 0 1"/></joint>
  <joint name="held" type="fixed"><parent link="ft"/><child link="hand"/>
    <origin xyz="0.02 0.03 0.05" rpy="-0.7 0.2 0.1"/></joint>
  <joint name="grip" type="prismatic"><parent link="hand"/><child link="finger"/>
    <origin xyz="0 0 0.1" rpy="0 0.4 0"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" velocity="1" effort="1"/></joint>
</robot>
"""


def payload_of(rig_of: RigOf, settings: dict[str, Any], payload: Mapping[str, Any]) -> PayloadSpec:
    settings["payloads"] = {"tool": payload}
    return rig_of(settings).payloads["tool"]


def same(payload: PayloadSpec, expected: pin.Inertia) -> None:
    assert payload.mass == pytest.approx(expected.mass, rel=1e-12)
    np.testing.assert_allclose(payload.center_of_mass_array, expected.lever, atol=1e-13)
    np.testing.assert_allclose(payload.inertia_matrix, expected.inertia, atol=1e-13)


def carried(text: str) -> pin.Inertia:
    """All that the joint `turn` carries, seen from `ft`, the gripper at zero."""
    model = pin.buildModelFromXML(text)
    model = pin.buildReducedModel(model, [model.getJointId("grip")], pin.neutral(model))
    placement = model.frames[model.getFrameId("ft")].placement
    return placement.inverse().act(model.inertias[model.getJointId("turn")])


def test_links_of_a_urdf_sum_up_to_one_body_at_the_sensor(
    settings: dict[str, Any], rig_of: RigOf, tmp_path: Path
) -> None:
    (tmp_path / "tool.urdf").write_text(TOOL, encoding="utf-8")
    everything = payload_of(rig_of, settings, {"urdf": "tool.urdf", "frame": "ft", "link": "wrist"})
    same(everything, carried(TOOL))
    beyond = payload_of(rig_of, settings, {"urdf": "tool.urdf", "frame": "ft"})
    start, end = TOOL.index('<link name="plate">'), TOOL.index('<link name="hand">')
    same(beyond, carried(TOOL[:start] + '<link name="plate"/>' + TOOL[end:]))
    assert payload_of(rig_of, settings, {"urdf": "tool.urdf", "frame": "mount"}) == beyond
    assert everything.uncertainty.mass == 1e-3  # the default holds for every source


def wrenched(mass: float, c: Array, inertia: Array, xyz: Array, rpy: Array) -> pin.Inertia:
    """A body given in flange axes, seen from a sensor that stands at xyz, rpy in the flange."""
    T_flange_sensor = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
    return T_flange_sensor.inverse().act(pin.Inertia(mass, c, inertia))


BODY = np.array([[0.03, 0.002, -0.001], [0.002, 0.04, 0.003], [-0.001, 0.003, 0.02]])
C = np.array([0.01, -0.02, 0.08])
XYZ, RPY = np.array([0.005, 0.0, 0.04]), np.array([0.1, -0.2, 0.785])


@pytest.mark.parametrize("key", ["F_x_center_load", "center_of_mass"])
def test_load_of_a_franka_arm_is_seen_from_the_sensor(
    settings: dict[str, Any], rig_of: RigOf, key: str
) -> None:
    franka = {"mass": 1.5, key: C.tolist(), "load_inertia": BODY.flatten(order="F").tolist()}
    franka["flange_to_sensor"] = {"xyz": XYZ.tolist(), "rpy": RPY.tolist()}
    uncertainty = {"mass": 0.02, "center_of_mass": 2e-3, "inertia": 0.1}
    payload = payload_of(rig_of, settings, {"franka": franka, "uncertainty": uncertainty})
    same(payload, wrenched(1.5, C, BODY, XYZ, RPY))
    assert payload.uncertainty.model_dump() == uncertainty


def test_payload_of_a_ur_arm_is_seen_from_the_sensor(settings: dict[str, Any], rig_of: RigOf) -> None:
    inertia = [BODY[0, 0], BODY[1, 1], BODY[2, 2], BODY[0, 1], BODY[0, 2], BODY[1, 2]]
    ur = {"mass": 4.0, "center_of_gravity": C.tolist(), "inertia": [float(x) for x in inertia]}
    ur["flange_to_sensor"] = {"xyz": XYZ.tolist()}
    same(payload_of(rig_of, settings, {"ur": ur}), wrenched(4.0, C, BODY, XYZ, np.zeros(3)))


def test_a_rig_that_is_written_holds_the_body_itself(
    settings: dict[str, Any], rig_of: RigOf, tmp_path: Path
) -> None:
    (tmp_path / "tool.urdf").write_text(TOOL, encoding="utf-8")
    payload = payload_of(rig_of, settings, {"urdf": "tool.urdf", "frame": "ft"})
    written = rig_of(settings).to_mapping()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "rig.yaml").write_text(yaml.safe_dump(written), encoding="utf-8")
    assert load_rig(elsewhere / "rig.yaml").payloads["tool"] == payload


FRANKA = {"mass": 1.0, "F_x_center_load": [0, 0, 0.1], "load_inertia": [0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01]}
FRANKA["flange_to_sensor"] = {"xyz": [0, 0, 0]}
UR = {
    "mass": 1.0,
    "center_of_gravity": [0, 0, 0.1],
    "inertia": [0.0] * 6,
    "flange_to_sensor": {"xyz": [0, 0, 0]},
}
URDF = {"urdf": "tool.urdf", "frame": "ft"}


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (URDF | {"urdf": "tol.urdf"}, ["tol.urdf: cannot be read"]),
        (URDF | {"frame": "fd"}, ["payloads.tool.frame", "'fd'", "nearest: `ft`"]),
        (URDF | {"link": "hnd"}, ["payloads.tool.link", "'hnd'", "nearest: `hand`"]),
        (URDF | {"frme": "ft"}, ["payloads.tool.frme", "nearest known key: `frame`"]),
        ({"urdf": "light.urdf", "frame": "ft"}, ["payloads.tool.urdf", "no mass in `ft`", "<inertial>"]),
        ({"urdf": "odd.urdf", "frame": "ft"}, ["odd.urdf: link `hand`: <mass>", 'value="heavy"', "a finite"]),
        ({"urdf": "bent.urdf", "frame": "ft"}, ["bent.urdf", "rpy=\"0 0.4\"", "three numbers"]),
        ({"urdf": "flat.urdf", "frame": "ft"}, ["payloads.tool.urdf", "triangle inequality"]),
        ({"franka": FRANKA | {"load_inertia": [1, 0, 0]}}, ["franka.load_inertia", "3 entries", "9: a 3"]),
        (
            {"franka": FRANKA | {"load_inertia": [1, 0.1, 0, 0, 1, 0, 0, 0, 1]}},
            ["franka.load_inertia", "a symmetric matrix"],
        ),
        ({"franka": FRANKA | {"mass": 0}}, ["franka.mass", "found 0", "greater than 0"]),
        ({"franka": FRANKA, "mass": 2}, ["unknown key `mass`", "nearest known key: `franka`"]),
        ({"ur": UR}, ["payloads.tool.ur", "inertia.xx = 0", "controllers take zero for unknown"]),
        ({"ur": {"mass": 1.0}}, ["ur.center_of_gravity: missing", "ur.flange_to_sensor: missing"]),
    ],
)  # fmt: skip
def test_faults_of_a_source_are_named(
    settings: dict[str, Any], rig_of: RigOf, tmp_path: Path, payload: dict[str, Any], words: list[str]
) -> None:
    (tmp_path / "tool.urdf").write_text(TOOL, encoding="utf-8")
    bare = re.sub("<inertial>.*?</inertial>", "", TOOL, flags=re.DOTALL)
    (tmp_path / "light.urdf").write_text(bare, encoding="utf-8")
    (tmp_path / "odd.urdf").write_text(TOOL.replace('value="1.3"', 'value="heavy"'), encoding="utf-8")
    flat = TOOL.replace('izz="0.008"', 'izz="0.8"')
    (tmp_path / "flat.urdf").write_text(flat, encoding="utf-8")
    (tmp_path / "bent.urdf").write_text(TOOL.replace('rpy="0 0.4 0"', 'rpy="0 0.4"'), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        payload_of(rig_of, settings, payload)
    for word in words:
        assert word in str(caught.value)


SECOND = '<joint name="x" type="fixed"><parent link="ft"/><child link="hand"/></joint></robot>'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('joint name="bolted"', "joint", "joint 3: found no name, expected <joint name=...>"),
        ('link name="plate"', "link", "link 4: found no name, expected <link name=...>"),
        ('joint name="held"', 'joint name="bolted"', "joint `bolted`: found a second one of this name"),
        ('link name="hand"', 'link name="plate"', "link `plate`: found a second one of this name"),
        ("</robot>", SECOND, "joint `x`: found a second parent of the link `hand`"),
        ('parent link="ft"', 'parent link="finger"', "link `hand`: found a loop of joints through it"),
        ("</robot>", '<link name="x"/></robot>', "found links without a parent: `base`, `x`, expected one"),
        ('mass value="0.2"', 'mass value="-0.2"', "link `finger`: <mass>: found -0.2, expected 0 kg or more"),
        ('mass value="0.2"', 'mass value="1e400"', 'link `finger`: <mass>: found value="1e400"'),
        ('iyz="-0.0002"', "", "link `plate`: <inertia>: found no iyz, expected a finite number"),
        ('upper="0.04"', 'upper="-1"', "joint `grip`: <limit>: found lower 0 above upper -1"),
    ],
)  # fmt: skip
def test_a_urdf_that_says_no_single_body_is_refused(
    settings: dict[str, Any], rig_of: RigOf, tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in TOOL
    (tmp_path / "tool.urdf").write_text(TOOL.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        payload_of(rig_of, settings, URDF)
    assert f"tool.urdf: {message}" in str(caught.value)


@pytest.mark.parametrize("encoding", ["klingon", "gb2312"])
def test_an_encoding_that_is_not_read_is_named(
    settings: dict[str, Any], rig_of: RigOf, tmp_path: Path, encoding: str
) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?>{TOOL}'
    (tmp_path / "tool.urdf").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"tool\.urdf: found an encoding that cannot be read .*XML in UTF-8"):
        payload_of(rig_of, settings, URDF)


def test_a_chain_may_have_any_length(settings: dict[str, Any], rig_of: RigOf, tmp_path: Path) -> None:
    n = 1500
    body = TOOL[TOOL.index("<inertial>") : TOOL.index("</inertial>")] + "</inertial>"
    links = "".join(f'<link name="l{k}">{body}</link>' for k in range(n))
    joints = "".join(
        f'<joint name="j{k}" type="fixed"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(n - 1)
    )
    (tmp_path / "tool.urdf").write_text(f'<robot name="chain">{links}{joints}</robot>', encoding="utf-8")
    payload = payload_of(rig_of, settings, {"urdf": "tool.urdf", "frame": "l0"})
    assert payload.mass == pytest.approx(0.7 * n)
    np.testing.assert_allclose(payload.center_of_mass_array, [0.01, 0, 0.02], atol=1e-12)
