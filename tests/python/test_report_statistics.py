"""What a report draws is what the residuals are, and what becomes of a calibration whose report fails."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import truewrench as tw
from truewrench.cli import main
from truewrench.estimation.assembly import assemble_motion, motion_figures
from truewrench.estimation.estimate import Clock, Estimate, Event, FoundNoise, LogRows, Slow, Step, Tilt
from truewrench.estimation.evidence import Evidence
from truewrench.judging.validation.comparison import compare_in_sample
from truewrench.model.calibration import AXES, Calibration, Verdict, load_calibration
from truewrench.model.log import Log
from truewrench.model.rig import Rig, load_rig
from truewrench.model.split import rows_of
from truewrench.report import page as package
from truewrench.report.consistency import consistency
from truewrench.report.convergence import convergence
from truewrench.report.findings import helps
from truewrench.report.found import found_table
from truewrench.report.series import Record, Series
from truewrench.report.series import record_of as series_of
from truewrench.report.statistics import _powers, envelope, histogram, spectrum
from truewrench.simulation.free_body import simulate

ROOT = Path(__file__).resolve().parents[2]


def record_of(residual: Any, period: float = 1e-3, sigma: float = 1.0) -> Record:
    """Residuals of one log and nothing else."""
    time: Any = period * np.arange(len(residual))
    one = np.full(6, sigma)
    nothing = np.zeros_like(residual)
    return Record(
        (Series(0.0, float(time[-1]), time, nothing, residual, residual, residual, one, one, np.ones(6)),)
    )


def rows_of_noise(noise: Any) -> LogRows:
    """Samples at 100 Hz whose residuals, fractions of range, are noise; the 200th to 219th are masked."""
    count = len(noise)
    wrench = np.random.default_rng(2).normal(size=(count, 6)) * [50, 50, 50, 5, 5, 5]
    masked = np.zeros(count, dtype=bool)
    masked[200:220] = True
    nothing = np.zeros((count, 6))
    index = np.arange(count)
    time: Any = 0.01 * index
    stretch = np.zeros(count, np.int64)
    return LogRows(index, time, masked, noise, nothing, wrench, nothing, nothing, stretch)


@pytest.fixture
def rig() -> Rig:
    return load_rig(ROOT / "examples" / "rig.yaml")


def found_in(rig: Rig, rows: LogRows, **changes: Any) -> tuple[Calibration, Evidence]:
    """A calibration with the nominal gain whose samples are these."""
    n = rig.sensor.n
    raw = rows.wrench @ rig.sensor.nominal_gain_array.T
    raw += (rows.residual + rows.discrepancy) * rig.sensor.channel_scale
    log = Log(None, "default", "", 10**7 * rows.rows, raw)
    small = 1e-8 * np.eye(7 * n)
    none = np.zeros(n)
    unit = np.append(
        (rig.sensor.channel_scale[:, None] / rig.sensor.range_array).ravel(), rig.sensor.channel_scale
    )
    fields: dict[str, Any] = dict.fromkeys(f.name for f in dataclasses.fields(Estimate))
    fields |= {
        "solved": True, "gain": rig.sensor.nominal_gain_array, "covariance": small * unit[:, None] * unit,
        "normalised_covariance": small, "offsets": none[None], "offsets_std": none[None], "clocks": ((),),
        "payloads": {}, "tilts": (), "quadratic": none, "quadratic_std": none + 1e-3, "discrepancy": none,
        "noise": ((FoundNoise("force", 2.5), FoundNoise("moment", 1.0)),), "slow": ((),), "events": ((),),
        "steps": ((),), "spacing": np.array([0.05]), "unresolved": np.array([False]), "rows": (rows,),
        "sources": {}, "A": 0.4, "p_halves": 0.5, "p_quarters": 0.5, "p_logs": np.ones(1), "iterations": 3,
        "fits": 2, "history_time": np.zeros(0), "history_log": np.zeros(0, np.int64),
    }  # fmt: skip
    estimate = Estimate(**(fields | changes))
    figures = motion_figures(rig, estimate)
    calibration = assemble_motion(rig, [log], "map", estimate, Verdict(True), figures=figures)
    return calibration, Evidence((log,), estimate)


def noise_of(rig: Rig, count: int = 3000, seed: int = 1) -> Any:
    """As the rig states, but 2.5 times on the forces; a tenth is what a fit follows of its variance."""
    factor = np.array([2.5] * 3 + [1.0] * 3) * rig.sensor.noise_array / rig.sensor.channel_scale
    return np.sqrt(0.9) * factor * np.random.default_rng(seed).normal(size=(count, 6))


def test_masked_samples_are_seen_in_the_measured_wrench_and_not_in_the_residual(rig: Rig) -> None:
    noise = noise_of(rig)
    noise[200:220, 2] += 0.3
    calibration, evidence = found_in(
        rig, rows_of_noise(noise), events=((Event(2.0, 2.19, 20, True, noise[0]),),)
    )
    record = series_of(calibration, evidence)
    (series,) = record.logs
    assert np.isnan(series.residual[200:220]).all()
    assert np.isfinite(series.residual[:200]).all()
    apart = series.measured - series.wrench
    assert (apart[200:220, 2] > 0.2 * rig.sensor.range_array[2]).all()
    np.testing.assert_allclose(apart[:200], series.residual[:200], atol=1e-9)
    assert record.spans("left_out") == [(2.0, 2.19)]
    assert np.nanstd(series.normalised, axis=0) == pytest.approx(np.ones(6), rel=0.05)


def test_measured_wrench_holds_the_slow_disturbance_and_the_residual_does_not(rig: Rig) -> None:
    rows = rows_of_noise(noise_of(rig))
    slow = 0.01 * np.sin(0.3 * rows.time)[:, None] * np.ones(6)
    calibration, evidence = found_in(rig, dataclasses.replace(rows, discrepancy=slow))
    (series,) = series_of(calibration, evidence).logs
    assert series.discrepancy is not None
    expected = slow * rig.sensor.channel_scale @ calibration.inverse.T
    np.testing.assert_allclose(series.discrepancy, expected, atol=1e-12)
    kept = ~rows.masked
    np.testing.assert_allclose(
        (series.measured - series.wrench - series.discrepancy)[kept], series.residual[kept], atol=1e-9
    )


def test_gaps_break_the_lines(rig: Rig) -> None:
    rows = rows_of_noise(noise_of(rig, 1000))
    rows = dataclasses.replace(rows, stretch=(rows.time > 4.0).astype(np.int64))
    (series,) = series_of(*found_in(rig, rows)).logs
    assert np.flatnonzero(np.isnan(series.time)).tolist() == [401]
    assert series.time[400] == pytest.approx(4.0)


def test_squares_are_those_of_the_noise_found_and_show_when_it_was_another(rig: Rig) -> None:
    noise = noise_of(rig)
    calibration, evidence = found_in(rig, rows_of_noise(noise))
    streams = consistency(evidence, series_of(calibration, evidence))
    assert [stream.name for stream in streams] == ["sensor, forces", "sensor, moments"]
    for stream in streams:
        assert np.mean(stream.value) == pytest.approx(1.0, abs=0.02)
        assert stream.outside < 8
    noise[1500:1800] *= 3.0
    calibration, evidence = found_in(rig, rows_of_noise(noise))
    for stream in consistency(evidence, series_of(calibration, evidence)):
        outside = (stream.value > stream.high) & (stream.begin > 14.9) & (stream.end < 18.1)
        assert outside.sum() >= 14


def test_tables_name_what_was_found(rig: Rig) -> None:
    clock = Clock("twist", 0.004, 1e-4, 0.002, kappa=0.05, kappa_std=0.1)
    calibration, evidence = found_in(
        rig,
        rows_of_noise(noise_of(rig)),
        clocks=((clock,),),
        slow=((Slow("force", 0.004, None, 0.3, 9.0, "matern", capped=True),),),
        steps=((Step(3.0, 0.01 * np.arange(6.0), np.full(6, 1e-3)),),),
        unresolved=np.array([True]),
    )
    assert isinstance(evidence.estimate, Estimate)
    rows = {
        row.header: (" ".join(cell.text for cell in row.cells), row.cells[-1].shade)
        for row in found_table(calibration, evidence.estimate).rows
    }
    assert "2.5 × stated" in rows["noise, force"][0]
    assert "larger than stated" in rows["noise, force"][0]
    assert "bad" in rows["noise, force"][1]
    assert "larger" not in rows["noise, moment"][0]
    assert "4.00 ± 0.10 ms ± 2 ms most like a filter of the sensor" in rows["sensor late against twist"][0]
    assert "as large as it may be" in rows["slow disturbance, force"][0]
    assert "5.00 ± 0.10 % of range" in rows["step of the offset at 3 s"][0]
    assert "not resolved" in rows["knots of the motion, spacing"][0]
    held = Clock("twist", -5.7e-15, 1e-9, 0.0)  # what a `time_offset_prior` of 0 leaves
    level = Tilt((0,), np.array([1e-14, -7e-15]), np.full(2, 1e-9))
    estimate = dataclasses.replace(evidence.estimate, clocks=((held,),), tilts=(level,))
    shown = {row.header: [cell.text for cell in row.cells] for row in found_table(calibration, estimate).rows}
    assert shown["sensor late against twist"][1:] == ["as stated", "± 0 ms", ""]
    assert shown["gravity turned about axis 1"][1] == "as stated"


def test_help_follows_what_limits_and_what_disagrees(rig: Rig) -> None:
    calibration, _ = found_in(rig, rows_of_noise(noise_of(rig)))
    by_pose = {"noise": dict.fromkeys(AXES, 1e-3), "pose": dict.fromkeys(AXES, 0.2)}
    apart = {"halves": 1e-6, "quarters": 0.5}
    poor = dataclasses.replace(
        calibration,
        gain_std=np.ones_like(calibration.gain),
        verdict=Verdict(False, ("accuracy: not yet",)),
        figures={**calibration.figures, "limited_by": by_pose, "parts_agree": apart},
    )
    told = " ".join(helps(poor))
    assert "a force that follows the pose limits it on most axes; a motion of several frequencies" in told
    assert "The parts of the record do not agree" in told
    assert "do not agree" not in " ".join(helps(calibration))


def test_history_of_an_estimator_is_its_distance_from_the_end(rig: Rig) -> None:
    gain = rig.sensor.nominal_gain_array
    calibration, evidence = found_in(
        rig,
        rows_of_noise(noise_of(rig)),
        history_time=np.array([5.0, 20.0]),
        history_log=np.zeros(2, np.int64),
        history_gain=gain * np.array([1.2, 1.1])[:, None, None],
    )
    found = convergence(calibration, evidence, series_of(calibration, evidence))
    assert found is not None
    np.testing.assert_array_equal(found.history_time, [5.0, 20.0])
    assert found.history[0] == pytest.approx(2.0 * found.history[1])
    assert found.distance[-1] == 0.0
    assert found.distance[0] > found.distance[len(found.distance) // 2]


def test_what_was_fitted_is_compared_without_what_was_left_out(rig: Rig) -> None:
    noise = noise_of(rig)
    noise[200:220] += 0.3
    calibration, evidence = found_in(rig, rows_of_noise(noise))
    assert isinstance(evidence.estimate, Estimate)
    found = compare_in_sample(rig, evidence.logs, evidence.estimate, calibration.inverse, "too short")
    assert found.figures == {"none_because": "too short"}
    kept = noise[~evidence.estimate.rows[0].masked] * rig.sensor.channel_scale @ calibration.inverse.T
    for i, axis in enumerate(found.improvement.values()):
        assert axis.new == pytest.approx(np.sqrt(np.mean(kept[:, i] ** 2)))
        assert axis.nominal == pytest.approx(axis.new, rel=0.01)  # it is the nominal gain
        assert axis.better == "unsure"
        assert not axis.held_out
    none = np.full((6, rig.sensor.n), np.nan)
    assert compare_in_sample(rig, evidence.logs, evidence.estimate, none, "so").figures == {
        "none_because": "so"
    }


def test_white_noise_of_the_stated_size_lies_along_one() -> None:
    residual = 0.3 * np.random.default_rng(6).normal(size=(60_000, 6))
    found = spectrum(record_of(residual, sigma=0.3))
    assert found is not None
    inside = (found.ratio >= found.low[:, None]) & (found.ratio <= found.high[:, None])
    assert 0.9 < inside.mean() < 0.99
    assert np.mean(found.ratio[found.frequency > 10.0]) == pytest.approx(1.0, abs=0.02)
    counts = histogram(record_of(residual, sigma=0.3))
    np.testing.assert_allclose(counts.within, 0.95, atol=0.005)
    np.testing.assert_allclose(counts.size, 1.0, atol=0.01)


@pytest.mark.parametrize("size", [2048, 301])
def test_powers_are_welchs(size: int) -> None:
    from scipy.signal import welch

    u = np.cumsum(np.random.default_rng(8).normal(size=(5000, 6)), axis=0)
    _, density = welch(u, 1.0, nperseg=size, detrend="constant", axis=0)
    inner = slice(1, size // 2)  # the ends stand for one side only
    np.testing.assert_allclose(_powers(u, size).mean(axis=0)[inner], density[inner] / 2.0, rtol=1e-9)


def test_peaks_survive_decimation() -> None:
    draw = np.random.default_rng(5)
    residual = draw.normal(size=(60_000, 6))
    residual[31_234, 2], residual[777, 5] = 40.0, -30.0
    residual[40_000:45_000] = np.nan
    drawn = envelope(record_of(residual), lambda series: series.residual)
    assert drawn.bucket == pytest.approx(60.0 / 1000, rel=1e-4)
    assert len(drawn.time) < 2100
    np.testing.assert_array_equal(np.nanmax(drawn.values, axis=0), np.nanmax(residual, axis=0))
    np.testing.assert_array_equal(np.nanmin(drawn.values, axis=0), np.nanmin(residual, axis=0))
    gap = (drawn.time > 40.05) & (drawn.time < 44.9)
    assert np.isnan(drawn.values[gap]).all()
    peak = drawn.time[np.nanargmax(drawn.values[:, 2])]
    assert abs(peak - 31.234) < drawn.bucket


def test_a_report_that_fails_leaves_the_calibration(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def broken(*_: Any) -> str:
        raise RuntimeError("no paper")

    monkeypatch.setattr(package, "page", broken)
    rig = ROOT / "examples" / "rig.yaml"
    simulate(load_rig(rig)).write(tmp_path / "run.csv")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("of an earlier calibration")
    words = ["calibrate", rig, tmp_path / "run.csv", "-o", tmp_path / "out", "--no-held-out"]
    assert main([*map(str, words)]) == 0
    assert "no paper" in capsys.readouterr().err
    assert load_calibration(tmp_path / "out" / "calibration.yaml").verdict.usable
    assert not (tmp_path / "out" / "report.html").exists()


def test_python_of_the_page_on_reports_writes_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "report.md").read_text(encoding="utf-8")
    block = text.split("```python\n")[1].split("```")[0]
    rig = load_rig(ROOT / "examples" / "rig.yaml")
    log = simulate(rig).log
    monkeypatch.chdir(tmp_path)
    exec(block, {"tw": tw, "rig": rig, "log": rows_of(log, log.time < 4.0)})
    assert "<h1>" in (tmp_path / "report.html").read_text(encoding="utf-8")
