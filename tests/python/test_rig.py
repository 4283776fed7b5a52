"""Every setting is read as it was meant, or refused with its place, its value and what was expected."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from truewrench.model.errors import InputError
from truewrench.model.rig import Rig, load_rig

RigOf = Callable[[Mapping[str, Any]], Rig]


def put(settings: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """The settings with one value replaced; the key is a path such as `sensor.noise[3]`."""
    here: Any = settings
    *parents, last = [int(part) if part.isdigit() else part for part in re.findall(r"[^.\[\]]+", key)]
    for part in parents:
        here = here.setdefault(part, {}) if isinstance(here, dict) else here[part]
    here[last] = value
    return settings


def test_defaults_are_those_of_the_format(settings: dict[str, Any]) -> None:
    del settings["motion"]["source"], settings["motion"]["of"]
    rig = Rig.from_mapping(settings)
    assert rig.sensor.gain_prior == 0.3
    assert rig.sensor.time_offset_prior == 5e-3
    assert not rig.sensor.pool_offsets
    assert rig.sensor.lowpass_hz is None
    np.testing.assert_array_equal(rig.sensor.nominal_gain_array, np.eye(6))
    np.testing.assert_allclose(rig.sensor.offset_prior_array, [50, 50, 50, 5, 5, 5], rtol=1e-15)
    uncertainty = rig.payloads["default"].uncertainty
    assert (uncertainty.mass, uncertainty.center_of_mass, uncertainty.inertia) == (1e-3, 5e-4, 1e-2)
    assert not rig.payloads["default"].exact
    assert (rig.motion.source, rig.motion.of) == ("twist", "com")
    assert not rig.in_gravity
    assert rig.required == 0.02
    assert (rig.temperature.reference, rig.temperature.prior) == (25, 0)
    assert rig.plan.model_dump() == {
        "duration": 20, "rate": 40, "harmonics": 6, "seed": 0, "rest_to_rest": True,
    }  # fmt: skip
    assert rig.simulate.model_dump() == {
        "rate": 100, "sensor_rate": 100, "seed": 0, "gain": "random", "offset": "random", "time_offset": 0,
        "payload": "nominal", "imperfections": None,
    }  # fmt: skip
    assert rig.recording.stamps == "header"


def test_every_key_of_a_joint_rig_is_known(settings: dict[str, Any], rig_of: RigOf, tmp_path: Path) -> None:
    settings["motion"] = {
        "source": "joints", "noise": [1e-4] * 7, "position_noise": [1e-5] * 7, "initial_position": [0] * 7,
        "acceleration_noise": [0.01] * 3, "robot": {"urdf": "arms/arm.urdf", "sensor_frame": "ft"},
    }  # fmt: skip
    settings |= {
        "gravity": [0, 0, -9.81], "reference_noise": [1] * 6, "temperature": {"reference": 20, "prior": 1e-3},
        "required": 0.01,
        "limits": {"position": [2] * 7, "velocity": [1] * 7, "acceleration": [2] * 7, "jerk": [9] * 7,
                   "wrench_fraction": 0.8, "workspace": [[-1, 1], [-1, 1], [0, 2]]},
        "plan": {"duration": 60, "rate": 100, "harmonics": 8, "seed": 3, "rest_to_rest": False},
        "simulate": {"rate": 500, "sensor_rate": 1000, "seed": 1, "gain": np.eye(6).tolist(),
                     "offset": [0] * 6, "time_offset": 2e-3, "payload": "random"},
        "recording": {"wrench_topic": "/ft", "joint_topic": "/joint_states", "stamps": "receive"},
    }  # fmt: skip
    settings["sensor"] |= {
        "nominal_gain": "identity", "gain_prior": 0.1, "offset_prior": [1] * 6, "pool_offsets": True,
        "time_offset_prior": 0, "lowpass_hz": 150, "compensated": False,
    }  # fmt: skip
    rig = rig_of(settings)
    assert rig.urdf_path == tmp_path / "arms/arm.urdf"
    assert Rig.from_mapping(rig.to_mapping()).to_mapping() == rig.to_mapping()


def test_channel_scale_is_the_nominal_gain_over_the_ranges(settings: dict[str, Any]) -> None:
    gain = np.random.default_rng(1).normal(size=(8, 6))
    settings["sensor"] |= {
        "channels": [f"gauge {i}" for i in range(8)], "noise": [0.1] * 8, "nominal_gain": gain.tolist(),
    }  # fmt: skip
    sensor = Rig.from_mapping(settings).sensor
    expected = [
        sum(abs(g) * r for g, r in zip(row, settings["sensor"]["range"], strict=True)) for row in gain
    ]
    np.testing.assert_allclose(sensor.channel_scale, expected, rtol=1e-14)
    np.testing.assert_allclose(sensor.offset_prior_array, 0.1 * np.array(expected), rtol=1e-14)


@pytest.mark.parametrize(("feels", "sign"), [("payload_on_sensor", 1), ("sensor_on_payload", -1)])
def test_sign_follows_what_the_sensor_feels(settings: dict[str, Any], feels: str, sign: int) -> None:
    settings["sensor"]["feels"] = feels
    assert Rig.from_mapping(settings).sensor.sign == sign


@pytest.mark.parametrize("prior", [0, 0.0, [0] * 6])
def test_offset_prior_of_zero_means_no_offset(settings: dict[str, Any], prior: object) -> None:
    settings["sensor"]["offset_prior"] = prior
    np.testing.assert_array_equal(Rig.from_mapping(settings).sensor.offset_prior_array, np.zeros(6))


@pytest.mark.parametrize(
    "key",
    [
        "sensor", "payloads", "motion", "sensor.channels", "sensor.feels", "sensor.noise", "sensor.range",
        "payloads.default.mass", "payloads.default.center_of_mass", "payloads.default.inertia",
        "payloads.default.inertia.yy",
    ],
)  # fmt: skip
def test_missing_required_key_is_named(settings: dict[str, Any], rig_of: RigOf, key: str) -> None:
    *parents, last = key.split(".")
    here = settings
    for part in parents:
        here = here[part]
    del here[last]
    with pytest.raises(InputError, match=rf"rig\.yaml.*: {re.escape(key)}: missing required key"):
        rig_of(settings)


def test_a_missing_word_is_named_with_those_that_it_may_be(settings: dict[str, Any], rig_of: RigOf) -> None:
    del settings["sensor"]["feels"]
    with pytest.raises(InputError, match=r"expected `payload_on_sensor` or `sensor_on_payload`"):
        rig_of(settings)


def test_names_that_a_terminal_obeys_are_refused(settings: dict[str, Any], rig_of: RigOf) -> None:
    settings["sensor"]["channels"][0] = "f\x1b[31mx"
    with pytest.raises(InputError, match=r"channels\[0\]: found '.*', expected a name without control"):
        rig_of(settings)


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("sensor.nois", "noise"),
        ("sensor.gain_pior", "gain_prior"),
        ("payloads.default.center_of_masss", "center_of_mass"),
        ("payloads.default.uncertainty.mas", "mass"),
        ("motion.sauce", "source"),
        ("limits.velocitty", "velocity"),
        ("gravitty", "gravity"),
        ("simulate.sede", "seed"),
    ],
)
def test_unknown_key_is_named_with_the_nearest_known_one(
    settings: dict[str, Any], rig_of: RigOf, key: str, near: str
) -> None:
    last = key.rpartition(".")[2]
    expected = rf"{re.escape(key)}: unknown key `{last}`; nearest known key: `{near}`"
    with pytest.raises(InputError, match=expected):
        rig_of(put(settings, key, 1))


@pytest.mark.parametrize(
    ("key", "value", "place", "found", "expected"),
    [
        ("sensor.noise[3]", 0, "sensor.noise[3]", "0", "greater than 0"),
        ("sensor.noise[3]", -0.1, "sensor.noise[3]", "-0.1", "greater than 0"),
        ("sensor.noise[2]", float("nan"), "sensor.noise[2]", "NaN", "finite"),
        ("sensor.range[0]", float("inf"), "sensor.range[0]", "inf", "finite"),
        ("sensor.noise[5]", "0.05", "sensor.noise[5]", "the text '0.05'", "a number"),
        ("sensor.noise", 0.5, "sensor.noise", "0.5", "a list"),
        ("sensor.noise", [0.5] * 5, "sensor.noise", "5 entries", "6"),
        ("sensor.range", [500] * 7, "sensor.range", "7 entries", "6"),
        ("sensor.channels", ["a"] * 6, "sensor.channels[1]", "'a'", "once"),
        ("sensor.channels", list("abcde"), "sensor.channels", "5 names", "6 to 32 names"),
        ("sensor.channels[2]", 3, "sensor.channels[2]", "3", "text"),
        (
            "sensor.feels",
            "payload",
            "sensor.feels",
            "'payload'",
            "`payload_on_sensor` or `sensor_on_payload`",
        ),
        ("sensor.gain_prior", 0, "sensor.gain_prior", "0", "greater than 0"),
        ("sensor.gain_prior", True, "sensor.gain_prior", "true", "a number"),
        ("sensor.offset_prior", 3, "sensor.offset_prior", "3", "0 for no offset"),
        ("sensor.offset_prior", [1] * 5, "sensor.offset_prior", "5 entries", "6"),
        ("sensor.offset_prior", [1] * 5 + [-1], "sensor.offset_prior[5]", "-1", "at least 0"),
        ("sensor.time_offset_prior", -1e-3, "sensor.time_offset_prior", "-0.001", "at least 0"),
        ("sensor.pool_offsets", 1, "sensor.pool_offsets", "1", "true or false"),
        ("sensor.compensated", True, "sensor.compensated", "true", "the sensor's raw output"),
        ("sensor.nominal_gain", "unity", "sensor.nominal_gain", "'unity'", "identity"),
        ("sensor.nominal_gain", np.eye(6)[:5].tolist(), "sensor.nominal_gain", "5 rows", "6 rows"),
        ("sensor.nominal_gain", np.eye(6)[:, :5].tolist(), "sensor.nominal_gain[0]", "5 entries", "6"),
        (
            "sensor.nominal_gain",
            np.diag([1, 1, 1, 1, 1, 0]).tolist(),
            "sensor.nominal_gain[5]",
            "[0",
            "feels",
        ),
        ("sensor.nominal_gain", np.ones((6, 6)).tolist(), "sensor.nominal_gain", "rank 1", "rank 6"),
        ("payloads", {}, "payloads", "a mapping with no key", "one entry at least"),
        ("payloads", [], "payloads", "[]", "a mapping"),
        ("payloads.default.mass", 0, "payloads.default.mass", "0", "greater than 0"),
        ("payloads.default.center_of_mass", [0, 0], "payloads.default.center_of_mass", "2 entries", "3"),
        ("payloads.default.inertia.zz", 3.1, "payloads.default.inertia", "1.5, 1.5, 3.1", "triangle"),
        ("payloads.default.inertia.xy", 1.6, "payloads.default.inertia", "-0.1", "positive definite"),
        ("payloads.default.inertia.zz", -0.4, "payloads.default.inertia.zz", "-0.4", "greater than 0"),
        (
            "payloads.default.uncertainty",
            {"mass": -1},
            "payloads.default.uncertainty.mass",
            "-1",
            "at least 0",
        ),
        ("motion.source", "encoders", "motion.source", "'encoders'", "`twist`, `joints` or `imu`"),
        ("motion.of", "flange", "motion.of", "'flange'", "`com` or `sensor`"),
        ("motion.noise", [1e-3] * 5, "motion.noise", "5 entries", "6"),
        ("motion.noise", 1e-3, "motion.noise", "0.001", "a list"),
        ("motion.position_noise", [1e-5] * 6, "motion.position_noise", "[1e-05", "`source: joints`"),
        ("motion.acceleration_noise", [1] * 4, "motion.acceleration_noise", "4 entries", "6"),
        ("motion.source", "joints", "motion.of", "'com'", "`source: twist`"),
        ("gravity", -9.81, "gravity", "-9.81", "a list"),
        ("gravity", [0, 0, 0, 1], "gravity", "4 entries", "3"),
        ("reference_noise", [1] * 5, "reference_noise", "5 entries", "6"),
        ("temperature", {"prior": -1}, "temperature.prior", "-1", "at least 0"),
        ("required", 0, "required", "0", "greater than 0"),
        ("sensor.noise[0]", 10**400, "sensor.noise[0]", "1000", "a number"),
        ("sensor.noise[0]", 1e-300, "sensor.noise[0]", "1e-300", "1e-30 to 1e+30"),
        ("sensor.range[0]", 1e200, "sensor.range[0]", "1e+200", "1e-30 to 1e+30"),
        ("motion.noise[0]", 1e200, "motion.noise[0]", "1e+200", "1e-30 to 1e+30"),
        (
            "payloads.default.uncertainty",
            {"inertia": 1e200},
            "payloads.default.uncertainty.inertia",
            "1e+200",
            "at most 1e+30",
        ),
        ("sensor.discrepancy", 2.0, "sensor.discrepancy", "2.0", "a fraction of range, 0 to 1"),
        ("sensor.discrepancy", 10**400, "sensor.discrepancy", "1000", "`auto` or a fraction of range"),
        ("required", 10**400, "required", "1000", "a number greater than 0"),
        ("required", [0.1] * 5 + [10**400], "required", "[0.1, ", "a number greater than 0"),
        ("limits", {"velocity": [1] * 7}, "limits.velocity", "7 entries", "6"),
        ("limits", {"velocity": [0] * 6}, "limits.velocity", "[0.0, ", "at least one that may move"),
        ("limits", {"wrench_fraction": 80}, "limits.wrench_fraction", "80", "a number of at most 1"),
        ("limits", {"wrench_fraction": 0}, "limits.wrench_fraction", "0", "greater than 0"),
        ("limits", {"workspace": [[0, 1], [1, 0], [0, 1]]}, "limits.workspace[1]", "[1.0, 0.0]", "min < max"),
        ("plan", {"harmonics": 2.5}, "plan.harmonics", "2.5", "a whole number"),
        ("simulate", {"gain": "wild"}, "simulate.gain", "'wild'", "`nominal` or `random`"),
        ("simulate", {"gain": np.eye(6)[:4].tolist()}, "simulate.gain", "4 rows", "6 rows"),
        ("simulate", {"offset": [0] * 7}, "simulate.offset", "7 entries", "6"),
        ("simulate", {"time_offset": "wild"}, "simulate.time_offset", "'wild'", "`random` or a number"),
        ("simulate", {"time_offset": True}, "simulate.time_offset", "true", "`random` or a number"),
        ("simulate", {"payload": "default"}, "simulate.payload", "'default'", "`nominal` or `random`"),
        ("recording", {"stamps": "now"}, "recording.stamps", "'now'", "`header` or `receive`"),
        ("sensor", None, "sensor", "nothing", "a mapping"),
    ],
)
def test_wrong_value_is_reported_with_place_value_and_expectation(
    settings: dict[str, Any], rig_of: RigOf, key: str, value: Any, place: str, found: str, expected: str
) -> None:
    with pytest.raises(InputError) as caught:
        rig_of(put(settings, key, value))
    pattern = (
        rf"rig\.yaml:\d+: {re.escape(place)}: found .*{re.escape(found)}.*, expected .*{re.escape(expected)}"
    )
    assert any(re.search(pattern, line) for line in caught.value.problems), str(caught.value)


def test_seven_channels_need_a_nominal_gain(settings: dict[str, Any], rig_of: RigOf) -> None:
    settings["sensor"] |= {"channels": list("abcdefg"), "noise": [1] * 7}
    with pytest.raises(InputError, match=r"sensor\.nominal_gain: .*expected 7 rows of 6"):
        rig_of(settings)


def test_joint_rig_needs_a_robot(settings: dict[str, Any], rig_of: RigOf) -> None:
    settings["motion"] = {"source": "joints", "noise": [1e-4] * 7}
    with pytest.raises(InputError, match=r"motion\.robot: found nothing"):
        rig_of(settings)


def test_joint_lists_have_one_length(settings: dict[str, Any], rig_of: RigOf) -> None:
    robot = {"urdf": "arm.urdf", "sensor_frame": "ft"}
    settings["motion"] = {
        "source": "joints",
        "noise": [1e-4] * 7,
        "position_noise": [1e-5] * 6,
        "robot": robot,
    }
    with pytest.raises(InputError, match=r"motion\.position_noise: found 6 entries, expected one per joint"):
        rig_of(settings)


def test_all_problems_are_reported_at_once(settings: dict[str, Any], rig_of: RigOf) -> None:
    settings["sensor"]["noise"][0] = -1
    settings["motion"]["sauce"] = "twist"
    del settings["payloads"]["default"]["mass"]
    with pytest.raises(InputError) as caught:
        rig_of(settings)
    assert len(caught.value.problems) == 3


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_exponents_without_a_point_are_numbers(settings: dict[str, Any], tmp_path: Path) -> None:
    text = yaml.safe_dump(settings).replace("- 0.5", "- 5e-1").replace("- 0.05", "- 5E-2")
    rig = load_rig(write(tmp_path / "rig.yaml", text))
    np.testing.assert_array_equal(rig.sensor.noise_array, [0.5, 0.5, 0.5, 0.05, 0.05, 0.05])


def test_leading_zeros_are_not_octal(settings: dict[str, Any], tmp_path: Path) -> None:
    text = yaml.safe_dump(settings).replace("mass: 50", "mass: 050")
    assert load_rig(write(tmp_path / "rig.yaml", text)).payloads["default"].mass == 50


def test_key_given_twice_is_an_error_with_both_lines(settings: dict[str, Any], tmp_path: Path) -> None:
    text = yaml.safe_dump(settings) + "gravity: [0, 0, 0]\ngravity: [0, 0, -9.81]\n"
    with pytest.raises(
        InputError, match=r"rig\.yaml: line (\d+), .*key `gravity` a second time \(first on line"
    ):
        load_rig(write(tmp_path / "rig.yaml", text))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "a mapping with sensor, payloads and motion"),
        ("5: 1\n", "text as a key"),
        ("- 1\n- 2\n", "a mapping with sensor, payloads and motion"),
        ("sensor: [1, 2\n", "line"),
        ("sensor: !!python/object:os.system x\n", "line 1"),
        ("a: 1\n---\nb: 2\n", "line"),
    ],
)
def test_what_is_no_yaml_mapping_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError, match=rf"rig\.yaml.*{expected}"):
        load_rig(write(tmp_path / "rig.yaml", text))


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read: No such file"):
        load_rig(tmp_path / "none.yaml")


positive = st.floats(1e-12, 1e12)


@given(st.lists(positive, min_size=6, max_size=6), positive, st.floats(0, 1e3), st.floats(-1e6, 1e6))
def test_any_rig_survives_its_own_mapping(
    valid_settings: dict[str, Any], noise: list[float], mass: float, prior: float, x: float
) -> None:
    settings = deepcopy(valid_settings)
    settings["sensor"] |= {"noise": noise, "time_offset_prior": prior}
    settings["payloads"]["default"] |= {"mass": mass, "center_of_mass": [x, 0, 0]}
    rig = Rig.from_mapping(settings)
    assert Rig.from_mapping(yaml.safe_load(yaml.safe_dump(rig.to_mapping()))) == rig
    assert rig.sensor.noise == tuple(noise)


def test_a_key_with_a_line_break_does_not_break_the_message(valid_settings: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"sensor\.noise: found a mapping with '\\n', expected a list"):
        Rig.from_mapping(put(deepcopy(valid_settings), "sensor.noise", {"\n": None}))


@given(
    st.sampled_from(["sensor.noise", "sensor.range", "motion.noise", "gravity"]),
    st.recursive(
        st.none() | st.booleans() | st.text(max_size=5) | st.just(float("nan")),
        lambda inner: st.lists(inner, max_size=7) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
        max_leaves=8,
    ),
)
def test_whatever_is_no_list_of_numbers_is_refused_with_its_key(
    valid_settings: dict[str, Any], key: str, value: Any
) -> None:
    with pytest.raises(InputError, match=rf"(?m)^{re.escape(key)}(\[\d+\])*: found .*, expected "):
        Rig.from_mapping(put(deepcopy(valid_settings), key, value))


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("simulate.rate", 1e30, "a number of at most 1e+06"),
        ("simulate.sensor_rate", 0, "a number greater than 0"),
        ("plan.duration", 1e-320, "a number of at least 0.001"),
        ("plan.duration", 1e9, "a number of at most 1e+06"),
    ],
)
def test_rates_and_durations_are_those_of_this_world(
    settings: dict[str, Any], key: str, value: float, expected: str
) -> None:
    section, name = key.split(".")
    settings[section] = {**settings.get(section, {}), name: value}
    with pytest.raises(InputError, match=re.escape(f"{key}: found")) as caught:
        Rig.from_mapping(settings)
    assert expected in str(caught.value)
