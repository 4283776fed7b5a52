"""A tool's file gives back what was written, to the last bit, and nothing that cannot be right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from tool_cases import a_rig, a_tool, newton_euler, tensor_of

from truewrench.model.errors import InputError
from truewrench.model.files import read_yaml, write_yaml
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import GAIN_PRIOR, TILT_PRIOR, load_tool_rig, tool_rig
from truewrench.planning.tool.plan import plan_tool
from truewrench.tool.bodies import nearest_physical
from truewrench.tool.model_rows import about_center
from truewrench.tool.motion import _widened
from truewrench.tool.parameters import (
    channel_turn,
    inertia_of,
    roll_pitch_yaw,
    second_moments,
    symmetric,
    tilted,
)
from truewrench.tool.prior import settings_of
from truewrench.tool.reading import read_tool
from truewrench.tool.words import correlations


def same(a: Any, b: Any) -> bool:
    """Equality to the last bit, through dataclasses, arrays and mappings."""
    if isinstance(a, Rig):
        return a.to_mapping() == b.to_mapping()
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, name), getattr(b, name)) for name in a.__dataclass_fields__)
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return bool(a == b)


def test_file_gives_back_every_field(tmp_path: Path) -> None:
    bands = np.array([[22.5, *(1e-3 * np.arange(6.0))], [0.0, *np.full(6, 2e-4)]])
    tool, path = replace(a_tool(), vibrations=bands), tmp_path / "new" / "tool.yaml"
    tool.write_yaml(path)
    assert same(read_tool(path), tool)


def changed(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    data, _ = read_yaml(path)
    change(data)
    write_yaml(path, data)
    return path


def _set(*keys: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: Any) -> None:
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_set("format", value="truewrench/1"), "format: found the text 'truewrench/1', expected"),
        (_set("mass", value=-1.0), "mass: found -1.0, expected a number greater than 0"),
        (_set("mass_std", value=0.5), "mass_std: found 0.5, expected what `covariance` says"),
        (
            _set("inertia", "xx", value="heavy"),
            "inertia.xx: found the text 'heavy', expected a finite number",
        ),
        (_set("inertia", "zx", value=0.0), "inertia.zx: found another element, expected only xx"),
        (_set("center_of_mass", 1, value=None), "center_of_mass[1]: found nothing, expected a finite number"),
        (_set("offset_walk", 2, value=-1e-3), "offset_walk: found -0.001, expected numbers of at least 0"),
        (_set("offset_time_ns", value=1.5), "offset_time_ns: found 1.5, expected a whole number"),
        (_set("offset_time_ns", value=2**63), "offset_time_ns: found 9223372036854775808, expected a whole"),
        (_set("covariance", "names", 0, value="gain"), "covariance.names: found 57 names, or another order"),
        (_set("covariance", "matrix", 0, 1, value=1.0), "covariance.matrix: found a matrix that is not symm"),
        (_set("determined", "center_of_mass", value=[True]), "expected a list of 3: true or false"),
        (_set("rig", "sensor", "feels", value="both"), "rig: sensor.feels: found the text 'both'"),
    ],
)
def test_what_cannot_be_right_is_refused_with_its_place(
    change: Callable[[dict[str, Any]], None], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "tool.yaml"
    a_tool().write_yaml(path)
    with pytest.raises(InputError) as error:
        read_tool(changed(path, change))
    assert words in str(error.value)
    assert str(path) in str(error.value)


def test_mounting_is_the_attitude_of_the_channels_axes_about_fixed_axes() -> None:
    mounting = np.array([0.3, -0.4, 0.5])
    R, derivative = channel_turn(mounting)
    np.testing.assert_allclose(R.T, Rotation.from_euler("xyz", mounting).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(roll_pitch_yaw(R), mounting, atol=1e-15)
    for i, step in enumerate(1e-6 * np.eye(3)):
        numeric = (channel_turn(mounting + step)[0] - channel_turn(mounting - step)[0]) / 2e-6
        np.testing.assert_allclose(derivative[i], numeric, atol=1e-9)


def test_second_moments_of_a_rod_lie_along_it() -> None:
    rod = np.array([1 / 12, 1 / 12, 0.0, 0.0, 0.0, 0.0])  # 1 kg, 1 m, along z
    S = second_moments(1.0, rod)
    np.testing.assert_allclose(symmetric(S), np.diag([0.0, 0.0, 1 / 12]), atol=1e-15)
    np.testing.assert_allclose(inertia_of(1.0, S), rod, atol=1e-15)


def test_tilt_turns_gravity_by_its_angle() -> None:
    gravity = np.array([0.3, -1.0, -9.7])
    turned, by_tilt = tilted(gravity, np.array([1e-4, 0.0]))
    angle = np.arccos(turned @ gravity / np.linalg.norm(turned) / np.linalg.norm(gravity))
    assert angle == pytest.approx(1e-4, rel=1e-3)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(gravity), rel=1e-12)
    there, back = tilted(gravity, np.array([2e-4, 0.0]))[0], tilted(gravity, np.zeros(2))[0]
    np.testing.assert_allclose(by_tilt[:, 0], (there - back) / 2e-4, rtol=1e-5, atol=1e-9)


def test_a_rig_for_an_unknown_tool_needs_neither_payloads_nor_a_motion(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(a_rig()))
    rig = load_tool_rig(path)
    assert (rig.sensor.gain_prior, rig.gravity_tilt_prior, rig.motion.of) == (
        GAIN_PRIOR,
        TILT_PRIOR,
        "sensor",
    )
    stated = tool_rig(a_rig(gravity_tilt_prior=0.01, required="whatever", sensor={"gain_prior": 0.05}))
    assert (stated.sensor.gain_prior, stated.gravity_tilt_prior) == (0.05, 0.01)


def test_a_twist_of_the_centre_of_mass_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    twist = {"source": "twist", "noise": [1e-3] * 6}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(a_rig(motion={**twist, "of": "com"})))
    with pytest.raises(InputError, match=r"rig\.yaml: motion\.of: found `com`, expected `sensor`, or no"):
        load_tool_rig(path)
    body = {"mass": 1, "center_of_mass": [0, 0, 0.1], "inertia": {"xx": 0.01, "yy": 0.01, "zz": 0.01}}
    stated, silent = (
        Rig.from_mapping(a_rig(motion=motion, payloads={"default": body}))
        for motion in ({**twist, "of": "com"}, twist)
    )
    for refuses in (settings_of, plan_tool):
        with pytest.raises(InputError, match=r"motion\.of: found `com`"):
            refuses(stated)
    assert settings_of(silent).motion.of == "sensor"


def test_what_widens_the_gain_of_a_motion_leaves_its_most_likely_point_where_it_was() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(60, 60))
    data, pull, part = root @ root.T, 30.0 * rng.normal(size=60), 0.025 * rng.normal(size=(36, 36))
    added = np.zeros((60, 60))
    added[:36, :36] = part @ part.T
    added[40, 40] = 0.3
    wide, drawn = _widened(data, pull, added)
    np.testing.assert_allclose(np.linalg.solve(wide, drawn), np.linalg.solve(data, pull), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.inv(wide), np.linalg.inv(data) + added, rtol=1e-6, atol=1e-9)


def test_gains_about_the_centre_of_mass_show_the_same_wrench_and_have_their_derivative() -> None:
    rng = np.random.default_rng(5)
    G, mass, center = rng.normal(size=(8, 6)), 1.7, np.array([0.02, -0.03, 0.09])
    inertia = np.array([0.02, 0.03, 0.015, 1e-3, -2e-3, 5e-4])
    y = np.concatenate([G.ravel(), [np.log(mass)], center, inertia, rng.normal(size=10)])
    moved, J = about_center(y, 8)
    omega, alpha, fall = rng.normal(size=(3, 1, 3))
    nothing = np.zeros((1, 3))
    nu, a = np.hstack([nothing, omega]), np.hstack([nothing, alpha])
    at_center = np.cross(alpha, center) + np.cross(omega, np.cross(omega, center)) - fall
    per_mass = tensor_of(moved[52:58])
    turning = alpha @ per_mass + np.cross(omega, omega @ per_mass)
    shown = -moved[:48].reshape(8, 6) @ np.hstack([at_center, turning])[0]
    wrench = newton_euler(mass, center, tensor_of(inertia), nu, a, fall)[0]
    np.testing.assert_allclose(shown, G @ wrench, rtol=1e-12)
    steps = 1e-6 * np.eye(y.size)
    by = [(about_center(y + e, 8)[0] - about_center(y - e, 8)[0]) / 2e-6 for e in steps]
    np.testing.assert_allclose(J, np.column_stack(by), atol=1e-8)


def test_what_stands_and_falls_together_is_said_in_words() -> None:
    tool = a_tool()
    layout = tool.layout
    covariance = np.diag(np.full(layout.size, 1e-4))
    mass, fz = layout.log_mass, layout.gain.start + 6 * 2 + 2
    covariance[mass, fz] = covariance[fz, mass] = -0.9e-4
    (said,) = correlations(replace(tool, covariance=covariance))
    assert said == "A larger mass goes with a smaller gain of channel fz by fz (-0.90)."


def test_the_nearest_physical_body_is_where_no_other_is_nearer() -> None:
    """By the conditions of Karush, Kuhn and Tucker: a gradient without negative eigenvalues, normal to S."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        S = 1e-3 * (
            rng.uniform(0.1, 2.0) * np.repeat([1.0, 0.0], 3) + rng.choice([0.3, 3.0]) * rng.normal(size=6)
        )
        root = rng.normal(size=(10, 10)) * 10.0 ** rng.uniform(-2.0, 0.0, size=(10, 1))
        P = 1e-4 * root @ root.T
        body, square = nearest_physical(np.concatenate([[0.1, 0.0, 0.0, 0.1], S]), P)
        step = body[4:] - S
        if square == 0.0:
            assert np.linalg.eigvalsh(symmetric(S))[0] > 0.0
            assert not step.any()
            continue
        inverse = np.linalg.inv(P[4:, 4:])
        assert square == pytest.approx(step @ inverse @ step, rel=1e-4)
        gradient = symmetric(inverse @ step * np.repeat([1.0, 0.5], 3))
        assert np.linalg.eigvalsh(symmetric(body[4:]))[0] > 0.0
        assert np.linalg.eigvalsh(gradient)[0] > -1e-3 * np.linalg.norm(gradient)
        assert abs(np.sum(gradient * symmetric(body[4:]))) < 1e-3 * square + 1e-4
        link = P[:4, 4:] @ inverse
        np.testing.assert_allclose(body[:4] - [0.1, 0.0, 0.0, 0.1], link @ step, rtol=1e-3, atol=1e-9)


def test_second_moments_of_a_log_in_millimetres_have_a_nearest_body() -> None:
    spread = np.diag([1.0, *[0.1] * 3, *[0.01] * 6]) ** 2
    for seed in range(20):
        rng = np.random.default_rng(seed)
        turn = Rotation.random(random_state=rng).as_matrix()
        values = rng.uniform([-300.0, 0.0, 500.0], [-1.0, 800.0, 2000.0])
        S = (turn @ np.diag(values) @ turn.T)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        body, square = nearest_physical(np.concatenate([[0.1, 0.0, 0.0, 0.1], S]), spread)
        assert np.linalg.eigvalsh(symmetric(body[4:]))[0] > 0.0
        assert square >= 0.5 * (values[0] / 0.01) ** 2  # of the elements, each once
