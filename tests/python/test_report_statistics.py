"""What a report draws is what the residuals are, and what becomes of a calibration whose report fails."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import truewrench as tw
from truewrench import report as package
from truewrench.calibration import load_calibration
from truewrench.cli import main
from truewrench.report.series import Record, Series
from truewrench.report.statistics import envelope, histogram, spectrum
from truewrench.rig import load_rig
from truewrench.simulation.free_body import simulate
from truewrench.split import rows_of

ROOT = Path(__file__).resolve().parents[2]


def record_of(residual: Any, period: float = 1e-3, sigma: float = 1.0, lagged: Any = None) -> Record:
    """Residuals of one log and nothing else."""
    nothing = np.zeros_like(residual)
    time = period * np.arange(len(residual))
    lagged = np.zeros((1, 6)) if lagged is None else lagged
    return Record(
        (Series(time, nothing, nothing, residual, np.full(6, sigma), lagged, 0.0, float(time[-1])),), ""
    )


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


def test_correlation_that_the_motion_brings_is_expected_of_the_spectrum() -> None:
    draw = np.random.default_rng(7).normal(size=(100_002, 6))
    residual = (draw[2:] + draw[1:-1] + draw[:-2]) / np.sqrt(3.0)  # autocorrelation 1, 2/3, 1/3, 0, ...
    lagged = np.repeat([[0.99], [2.0 / 3.0], [1.0 / 3.0]], 6, axis=1)
    found = spectrum(record_of(residual, lagged=lagged))
    assert found is not None
    low = found.frequency < 200.0
    assert np.mean(found.ratio[low]) == pytest.approx(1.0, abs=0.05)


def test_peaks_survive_decimation() -> None:
    draw = np.random.default_rng(5)
    residual = draw.normal(size=(60_000, 6))
    residual[31_234, 2], residual[777, 5] = 40.0, -30.0
    residual[40_000:45_000] = np.nan
    time = 1e-3 * np.arange(60_000)
    nothing = np.zeros((60_000, 6))
    series = Series(time, nothing, nothing, residual, np.ones(6), np.zeros((1, 6)), 0.0, 60.0)
    drawn = envelope(Record((series,), ""))
    assert drawn.bucket == pytest.approx(60.0 / 1000)
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
    with pytest.raises(SystemExit) as left:
        main(["calibrate", str(rig), str(tmp_path / "run.csv"), "-o", str(tmp_path / "out"),
              "--no-held-out"])  # fmt: skip
    assert left.value.code == 0
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
