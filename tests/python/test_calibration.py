"""A calibration file gives back what was written, to the last bit, and nothing that cannot be right."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from truewrench.model.calibration import Calibration, Verdict, load_calibration
from truewrench.model.errors import InputError
from truewrench.model.files import write_yaml
from truewrench.model.rig import Rig

finite = st.floats(-1e9, 1e9, allow_subnormal=False)


def test_wrench_undoes_gain_and_offset(calibration: Calibration) -> None:
    wrench = np.random.default_rng(3).normal(size=(50, 6))
    raw = np.array([calibration.gain @ w + calibration.offset for w in wrench])
    np.testing.assert_allclose(calibration.wrench(raw), wrench, atol=1e-12)


def test_wrench_without_a_sample_is_nan(calibration: Calibration) -> None:
    raw = np.zeros((3, 6))
    raw[1, 4] = np.nan
    np.testing.assert_array_equal(np.isnan(calibration.wrench(raw)).all(axis=1), [False, True, False])


def same(a: Any, b: Any) -> bool:
    """Equality to the last bit, through dataclasses, arrays and mappings."""
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, name), getattr(b, name)) for name in a.__dataclass_fields__)
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, Rig):
        return a.to_mapping() == b.to_mapping()
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return bool(a == b)


def test_file_gives_back_every_field(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "new" / "calibration.yaml"
    calibration.write_yaml(path)
    assert same(load_calibration(path), calibration)
    assert [entry.name for entry in path.parent.iterdir()] == ["calibration.yaml"]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30, deadline=None)
@given(offset=hnp.arrays(np.float64, 6, elements=finite), reason=st.text(max_size=20))
def test_file_keeps_every_bit_and_every_character(
    calibration: Calibration, tmp_path: Path, offset: Any, reason: str
) -> None:
    path = tmp_path / "calibration.yaml"
    verdict = replace(calibration.verdict, usable=False, reasons=(reason, "1e-3", "off", "2026-01-01"))
    written = replace(calibration, offset=offset, verdict=verdict, estimator=reason or "map")
    written.write_yaml(path)
    assert same(load_calibration(path), written)


def test_other_programs_read_the_same_numbers(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    calibration.write_yaml(path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert data["format"] == "truewrench/1"
    assert np.array(data["gain"]).tobytes() == calibration.gain.tobytes()
    assert np.array(data["covariance"]).tobytes() == calibration.covariance.tobytes()
    assert np.array(data["inverse"]).shape == (6, 6)
    assert data["verdict"]["usable"] is True
    assert data["improvement"]["axes"]["fx"] == {"nominal": 3.0, "new": 0.5, "held_out": True, "better": True}
    assert data["axes"] == {"fx": True, "fy": True, "fz": True, "mx": True, "my": True, "mz": True}
    noise = {"what": "noise, factor on the stated", "where": "all logs", "value": 2.5, "sigma": 0.1}
    assert data["assumed"][0] == noise | {"evidence": "residuals"}
    blind = {"kind": "delay", "size": 1e-3, "effect": 4e-3}
    assert data["verdict"]["blind_to"] == [blind | {"words": "a delay of 1 ms would move a gain by 0.4 %"}]
    assert np.array(data["quadratic"]).tobytes() == calibration.quadratic.tobytes()
    assert data["logs"][0]["samples"] == {"used": 990, "masked": {"contact": 4}, "rejected": {"no fit": 6}}


def edit(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        here: Any = data
        *parents, last = [int(part) if part.isdigit() else part for part in re.findall(r"[^.\[\]]+", key)]
        for part in parents:
            here = here[part]
        if value is None:
            del here[last]
        else:
            here[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edit("format", "truewrench/2"), r"format: found the text 'truewrench/2', expected `truewrench/1`"),
        (edit("format", None), r"format: found nothing, expected `truewrench/1`"),
        (edit("gain", None), r"gain: found nothing, expected this key"),
        (edit("gain[5]", None), r"gain: found 5 entries, expected a list of 6"),
        (edit("gain[2][1]", float("nan")), r"gain\[2\]\[1\]: found NaN, expected a finite number"),
        (edit("gain[2][1]", "1.0"), r"gain\[2\]\[1\]: found the text '1.0', expected a finite number"),
        (edit("gain[2][1]", 10**400), r"gain\[2\]\[1\]: found 1000.*, expected a finite number"),
        (edit("gain_std[0][0]", True), r"gain_std\[0\]\[0\]: found true, expected a finite number"),
        (edit("inverse[0][0]", 10**30), r"inverse: found another matrix"),
        (edit("offset", [0.0] * 7), r"offset: found 7 entries, expected a list of 6"),
        (edit("covariance[3][4]", 9.0), r"covariance: found a matrix that is not symmetric"),
        (edit("covariance[3][3]", -1.0), r"covariance: found .* expected a positive semidefinite matrix"),
        (edit("inverse[0][0]", 7.0), r"inverse: found another matrix"),
        (edit("verdict.usable", "yes!"), r"verdict\.usable: found the text 'yes!', expected true or false"),
        (edit("verdict.reasons", "none"), r"verdict\.reasons: found the text 'none', expected a list"),
        (
            edit("verdict.undetermined[0].direction", [1.0]),
            r"verdict\.undetermined\[0\]\.direction: found 1 en",
        ),
        (
            edit("improvement.axes.fx.better", "maybe"),
            r"improvement\.axes\.fx\.better: found the text 'maybe', expected true, false",
        ),
        (edit("logs[0].samples.used", -1), r"logs\[0\]\.samples\.used: found -1, expected a whole number"),
        (edit("axes.mz", "no"), r"axes\.mz: found the text 'no', expected true or false"),
        (edit("axes.mz", None), r"axes: found fx, fy, fz, mx, my, expected each of fx, .*, or none"),
        (edit("assumed", {}), r"assumed: found .*, expected a list"),
        (edit("assumed[0].where", None), r"assumed\[0\]\.where: found nothing, expected this key"),
        (edit("assumed[1].value", "much"), r"assumed\[1\]\.value: found the text 'much', expected a finite"),
        (
            edit("assumed[0].sigma", -0.1),
            r"assumed\[0\]\.sigma: found -0\.1, expected a number of at least 0",
        ),
        (edit("quadratic", [0.0] * 7), r"quadratic: found 7 entries, expected a list of 6"),
        (edit("discrepancy[2]", -1.0), r"discrepancy: found -1, expected numbers of at least 0"),
        (
            edit("verdict.blind_to[0].kind", "gremlins"),
            r"verdict\.blind_to\[0\]\.kind: found .*, expected one of hysteresis, nonlinearity, cable",
        ),
        (
            edit("verdict.blind_to[0].size", -1),
            r"verdict\.blind_to\[0\]\.size: found -1, expected a number of",
        ),
        (edit("rig.sensor.feels", "nothing"), r"sensor\.feels: found the text 'nothing', expected"),
        (edit("rig", "rig.yaml"), r"rig: found the text 'rig.yaml', expected a mapping"),
    ],
)
def test_file_that_cannot_be_right_is_refused_with_its_place(
    calibration: Calibration, tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    path = tmp_path / "calibration.yaml"
    calibration.write_yaml(path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    change(data)
    write_yaml(path, data)
    with pytest.raises(InputError, match=rf"calibration\.yaml.*: {message}"):
        load_calibration(path)


def test_file_of_an_earlier_version_is_read_as_saying_nothing_of_what_came_later(
    calibration: Calibration, tmp_path: Path
) -> None:
    path = tmp_path / "calibration.yaml"
    calibration.write_yaml(path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    for key in ("axes", "assumed", "quadratic", "quadratic_std", "discrepancy"):
        del data[key]
    del data["verdict"]["blind_to"]
    samples = data["logs"][0]["samples"]
    samples["gated"] = samples.pop("masked")
    write_yaml(path, data)
    expected = replace(
        calibration,
        verdict=replace(calibration.verdict, blind_to=()),
        axes={}, assumed=(), quadratic=None, quadratic_std=None, discrepancy=None,
    )  # fmt: skip
    assert same(load_calibration(path), expected)


def test_gains_as_uncertain_as_before_are_marked_in_the_file(
    calibration: Calibration, tmp_path: Path
) -> None:
    """Half of the prior is the limit, in units of range."""
    sensor = calibration.rig.sensor
    prior = sensor.gain_prior * sensor.channel_scale[:, None] / sensor.range_array
    share = np.full((6, 6), 0.49)
    share[1, 3], share[5, 0] = 0.51, 1.0
    marked = replace(calibration, gain_std=share * prior)
    path = tmp_path / "calibration.yaml"
    marked.write_yaml(path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    written = data["gain_determined"]
    assert [(i, j) for i in range(6) for j in range(6) if written[i][j] is not True] == [(1, 3), (5, 0)]
    assert load_calibration(path).gain_determined.tolist() == written
    data["gain_determined"][1][3] = True
    write_yaml(path, data)
    with pytest.raises(InputError, match="gain_determined"):
        load_calibration(path)


def test_gain_without_inverse_is_kept_as_evidence(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    nothing = np.full((6, 6), np.nan)
    verdict = Verdict(usable=False, reasons=("singular gain",))
    replace(calibration, gain=np.ones((6, 6)), inverse=nothing, verdict=verdict).write_yaml(path)
    assert np.isnan(load_calibration(path).inverse).all()
    replace(calibration, inverse=nothing).write_yaml(path)
    with pytest.raises(InputError, match="inverse: found another matrix"):
        load_calibration(path)


def test_failed_write_leaves_the_old_file_and_nothing_else(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    calibration.write_yaml(path)
    before = path.read_bytes()
    broken = replace(calibration, figures={"what": object()})
    with pytest.raises(yaml.YAMLError):
        broken.write_yaml(path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["calibration.yaml"]


def test_failed_write_leaves_no_folder_behind(calibration: Calibration, tmp_path: Path) -> None:
    broken = replace(calibration, figures={"what": object()})
    with pytest.raises(yaml.YAMLError):
        broken.write_yaml(tmp_path / "a" / "b" / "calibration.yaml")
    assert list(tmp_path.iterdir()) == []
