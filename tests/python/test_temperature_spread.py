"""What is not known of the slope of an offset with temperature is part of sigma, wherever it is warm."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tool_cases import a_rig, pose_log, swing_log
from tool_cases import a_tool as any_tool

import truewrench as tw
from truewrench.correction.apply import corrector
from truewrench.correction.contact.log import contact
from truewrench.correction.warmth import Warmth
from truewrench.model.calibration import Calibration
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.temperature import where_apart
from truewrench.tool.reading import read_tool

Array = np.ndarray[Any, np.dtype[np.float64]]

REFERENCE, PRIOR = 25.0, 1e-3  # [degC], of range per K
MASS, CENTER, INERTIA = 3.0, np.array([0.02, -0.01, 0.1]), np.diag([0.03, 0.028, 0.02])


def rig_of(source: str) -> Rig:
    settings = a_rig(
        temperature={"reference": REFERENCE, "prior": PRIOR},
        motion={"source": "twist", "of": "sensor", "noise": [1e-3] * 6},
        reference_noise=[0.05] * 3 + [0.005] * 3,
    )
    if source != "tool":
        inertia = dict(zip(("xx", "yy", "zz"), np.diag(INERTIA).tolist(), strict=True))
        settings["payloads"] = {"tool": {"mass": MASS, "center_of_mass": CENTER.tolist(), "inertia": inertia}}
    return Rig.from_mapping(settings)


def log_of(rig: Rig, source: str, seed: int) -> Log:
    if source == "poses":
        return pose_log(rig, MASS, CENTER, poses=24, seed=seed)[0]
    if source == "motion":
        return swing_log(rig, MASS, CENTER, INERTIA, seed=seed)
    rng = np.random.default_rng(seed)
    w = rng.uniform(-0.5, 0.5, (60, 6)) * rig.sensor.range_array
    raw = w + rng.normal(size=w.shape) * rig.sensor.noise_array
    stamps = np.arange(60) * 10**9
    return Log(
        None, "tool", "", stamps, raw, reference=w + rng.normal(size=w.shape) * np.array(rig.reference_noise)
    )


def warm(rig: Rig, log: Log, celsius: float, slope: Array, seed: int) -> Log:
    """The log of a sensor whose offset follows the temperature, which is nearly constant."""
    readings = celsius + 0.05 * np.random.default_rng(seed).standard_normal(len(log.time_ns))
    return replace(log, raw=log.raw + np.outer(readings - REFERENCE, slope), temperature=readings)


def slope_of(rig: Rig, seed: int) -> Array:
    return PRIOR * rig.sensor.channel_scale * np.random.default_rng((seed, 7)).standard_normal(6)


def felt(calibration: Calibration, celsius: float) -> tuple[Array, Array]:
    """What a sensor without a load would read at a temperature, by what is found, and its 1 sigma."""
    warmth = Warmth.of(calibration)
    raw = warmth.without(np.zeros((1, 6)), np.array([celsius]))
    wrench, std = corrector(calibration, "here").correct(raw)
    return wrench[0], warmth.widened(std, np.array([celsius]))[0]


@pytest.mark.parametrize(("source", "count"), [("reference", 40), ("motion", 6), ("poses", 12)])
def test_sigma_holds_where_the_log_was_warm_and_elsewhere(source: str, count: int) -> None:
    rig, there = rig_of(source), 35.0
    errors: dict[float, list[Array]] = {25.0: [], 35.0: [], 55.0: []}
    sigma = {at: np.zeros(6) for at in errors}
    for seed in range(count):
        slope = slope_of(rig, seed)
        log = log_of(rig, source, seed)
        found = tw.calibrate(rig, warm(rig, log, there, slope, seed), held_out=False)
        # the offset at the end of the log, by what the log reads there less the load
        quiet = replace(log, temperature=np.full(len(log.time_ns), REFERENCE))
        cold = tw.calibrate(rig, quiet, held_out=False).offset if source != "reference" else np.zeros(6)
        for at in errors:
            wrench, std = felt(found, at)
            truth = -(cold + (at - REFERENCE) * slope) @ found.inverse.T
            errors[at].append((wrench - truth) / std)
            sigma[at] += std / count
    for at, z in errors.items():
        rms = float(np.sqrt(np.mean(np.square(z))))
        assert rms < 1.3, at
        if at != there and source == "reference":
            assert rms > 0.7
    if source != "poses":  # whose offset is known as well as their gain
        assert (sigma[25.0] > 3.0 * sigma[35.0]).all()
        assert (sigma[55.0] > 1.8 * sigma[25.0]).all()


def test_where_apart_is_where_the_offset_is_known_best() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(11, 11))
    whole = root @ root.T
    P, slope = whole[:8, :8], whole[8:, :]
    above, there, std = where_apart(P, slice(4, 7), slope, np.ones(3))

    def offset(at: float) -> Array:
        A = np.hstack([np.eye(8)[4:7], at * np.eye(3)])
        return np.asarray(A @ whole @ A.T)

    np.testing.assert_allclose(there[4:7, 4:7], offset(above), rtol=1e-12)
    np.testing.assert_allclose(std**2, np.diag(whole)[8:])
    traces = [np.trace(offset(above + by)) for by in (-1e-3, 0.0, 1e-3)]
    assert traces[1] < min(traces[0], traces[2])


def test_a_tool_that_was_found_cold_is_no_contact_where_it_is_warm() -> None:
    """chi^2 of the contact is that of the slope's error, six degrees of freedom; it was some thousands."""
    rig, chi2 = rig_of("tool"), []
    for seed in range(6):
        slope, log = slope_of(rig, seed), swing_log(rig, MASS, CENTER, INERTIA, seed=seed)
        tool = tw.identify_tool(rig, warm(rig, log, 25.0, slope, seed))
        assert tool.offset_temperature is not None
        found = contact(warm(rig, log, 45.0, slope, seed + 100), tool)
        chi2.append(float(np.nanmedian(found.chi2)))
    assert 3.0 < np.mean(chi2) < 11.0


def test_files_hold_it(tmp_path: Path, calibration: Calibration) -> None:
    rng = np.random.default_rng(1)
    known = replace(calibration, offset_temperature_covariance=rng.normal(size=(6, 48)))
    known.write_yaml(tmp_path / "calibration.yaml")
    again = tw.load_calibration(tmp_path / "calibration.yaml")
    np.testing.assert_array_equal(again.offset_temperature_covariance, known.offset_temperature_covariance)
    tool = any_tool()
    tool = replace(tool, offset_temperature_covariance=rng.normal(size=(6, len(tool.covariance) + 6)))
    tool.write_yaml(tmp_path / "tool.yaml")
    np.testing.assert_array_equal(
        read_tool(tmp_path / "tool.yaml").offset_temperature_covariance, tool.offset_temperature_covariance
    )
