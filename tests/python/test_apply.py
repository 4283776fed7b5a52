"""The corrected log is the log itself, with the true wrench and its uncertainty at the end of each row."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest

from truewrench.correction.apply import NEW_COLUMNS, apply
from truewrench.io import csv_table, parquet_table
from truewrench.io.tables import write_table
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig

CsvOf = Callable[..., Path]
Cells = dict[str, list[str]]
Array = np.ndarray[Any, np.dtype[np.float64]]


def new_columns(path: Path) -> Array:
    table = pq.read_table(path) if path.suffix == ".parquet" else pacsv.read_csv(path)
    return np.column_stack([table.column(name).to_numpy() for name in NEW_COLUMNS]).astype(np.float64)


def raw_of(cells: Cells, n: int = 6) -> Array:
    return np.array([[float(cells[f"raw_{i}"][k] or "nan") for i in range(n)] for k in range(10)])


def drawn_std(calibration: Calibration, wrench: Array, draws: int = 20_000) -> Array:
    """Scatter of the wrench over gains and offsets drawn from the covariance and noise from the rig."""
    rng = np.random.default_rng(5)
    n = calibration.n
    theta = np.concatenate([calibration.gain.ravel(), calibration.offset])
    scatter = rng.multivariate_normal(theta, calibration.covariance, size=draws, method="eigh")
    raw = np.einsum("dij,j->di", scatter[:, : 6 * n].reshape(draws, n, 6), wrench) + scatter[:, 6 * n :]
    raw += calibration.rig.sensor.noise_array * rng.normal(size=(draws, n))
    deviation: Array = np.std((raw - calibration.offset) @ calibration.inverse.T, axis=0)
    return deviation


def test_offset_follows_the_latest_temperature_whatever_the_blocks(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    slope = np.array([0.3, -0.2, 0.1, 0.02, 0.01, -0.03])
    warm = replace(calibration, offset_temperature=slope)
    reference = calibration.rig.temperature.reference
    readings = ["", "", "22.5", "", "", "nan", "31", "", "30.25", ""]
    held = np.array([np.nan, np.nan, 22.5, 22.5, 22.5, 22.5, 31, 31, 30.25, 30.25])
    raw = raw_of(cells) - calibration.offset - np.outer(held - reference, slope)
    expected = np.linalg.solve(calibration.gain, raw.T).T
    log = csv_of({**cells, "temperature": readings}, "warm.csv")
    np.testing.assert_allclose(warm.wrench(raw_of(cells), held), expected, rtol=1e-9, atol=1e-12)
    for block in (1 << 20, 300):  # one, and several
        monkeypatch.setattr(csv_table, "_BLOCK", block)
        done = apply(warm, log, tmp_path / "out.csv")
        assert (done.rows, done.corrected, done.notes) == (10, 8, ())
        np.testing.assert_allclose(new_columns(tmp_path / "out.csv")[:, :6], expected, rtol=1e-9, atol=1e-12)
    (note,) = apply(warm, csv_of(cells), tmp_path / "out.csv").notes
    assert note == f"no `temperature`, which the offset follows: it is taken for that of {reference:g} degC"
    assert apply(calibration, log, tmp_path / "out.csv").corrected == 10  # nothing follows it


def test_an_overloaded_channel_is_told_whatever_the_blocks(
    csv_of: CsvOf, tmp_path: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw = 2.0 * np.sin(np.linspace(0.0, 20.0, 400)[:, None] + np.arange(6))
    clipped = raw.copy()
    clipped[:, 2] = np.maximum(raw[:, 2], -1.5)
    for block in (1 << 20, 3000):  # one, and several, in some of which nothing is clipped
        monkeypatch.setattr(csv_table, "_BLOCK", block)
        notes = []
        for samples in (raw, clipped):
            columns = {f"raw_{i}": [repr(float(x)) for x in samples[:, i]] for i in range(6)}
            log = csv_of({"time_ns": [str(10_000_000 * k) for k in range(400)]} | columns)
            notes.append(apply(calibration, log, tmp_path / "out.csv").notes)
        assert notes[0] == ()
        (note,) = notes[1]
        share = 100.0 * np.mean(raw[:, 2] <= -1.5)
        name = calibration.rig.sensor.channels[2]
        assert note.startswith(f"channel {name} stands at -1.5, its extreme value, for {share:.2g} %")


def test_wrench_and_its_scatter_are_those_of_the_sensor_model(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration
) -> None:
    done = apply(calibration, csv_of(cells), tmp_path / "out.csv")
    assert (done.rows, done.corrected) == (10, 10)
    new = new_columns(tmp_path / "out.csv")
    expected = np.linalg.solve(calibration.gain, (raw_of(cells) - calibration.offset).T).T
    np.testing.assert_allclose(new[:, :6], expected, rtol=1e-10, atol=1e-12)
    for k in (0, 7):
        np.testing.assert_allclose(new[k, 6:], drawn_std(calibration, expected[k]), rtol=0.03)


def test_eight_channels_are_weighted_by_their_noise(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, settings: dict[str, Any], calibration: Calibration
) -> None:
    draw = np.random.default_rng(2)
    gain, noise = draw.normal(size=(8, 6)), draw.uniform(0.1, 3, size=8)
    settings["sensor"] |= {
        "channels": [f"g{i}" for i in range(8)], "noise": noise.tolist(), "nominal_gain": gain.tolist(),
    }  # fmt: skip
    rig = Rig.from_mapping(settings)
    eight = replace(
        calibration,
        quadratic=None,
        quadratic_std=None,
        discrepancy=None,
        gain=gain,
        gain_std=gain * 0,
        offset=np.arange(8.0),
        covariance=np.zeros((56, 56)),
        rig=rig,
    )
    cells |= {f"raw_{i}": [str(x) for x in draw.normal(size=10)] for i in (6, 7)}
    apply(eight, csv_of(cells), tmp_path / "out.csv")
    weight = 1 / noise
    expected, *_ = np.linalg.lstsq(
        gain * weight[:, None], ((raw_of(cells, 8) - eight.offset) * weight).T, rcond=None
    )
    new = new_columns(tmp_path / "out.csv")
    np.testing.assert_allclose(new[:, :6], expected.T, rtol=1e-9, atol=1e-11)
    information = gain.T @ np.diag(weight**2) @ gain
    np.testing.assert_allclose(new[:, 6:], np.tile(np.sqrt(np.diag(np.linalg.inv(information))), (10, 1)))


def test_every_character_of_the_log_is_kept(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_table, "_BLOCK", 500)
    cells["raw_1"][4] = ""
    cells["raw_2"][5] = "NaN"
    cells["raw_0"][6] = "+1.50e0"
    cells["note"] = ['say "hi", twice', "ünïcode", *[" spaced "] * 8]
    path = csv_of(cells)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    done = apply(calibration, path, tmp_path / "out.csv")
    assert (done.rows, done.corrected) == (10, 8)
    before = path.read_bytes().split(b"\r\n")
    after = (tmp_path / "out.csv").read_bytes().split(b"\r\n")
    assert len(after) == len(before)
    for old, new in zip(before[:-1], after[:-1], strict=True):
        assert new.startswith(old + b",")
    assert after[5].endswith(b"," * 12)
    assert after[6].endswith(b"," * 12)
    assert not after[7].endswith(b",")


def test_every_cell_of_a_parquet_log_is_kept(
    cells: Cells, tmp_path: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parquet_table, "_ROWS", 3)
    columns = {
        name: pa.array([float(x) for x in column]) for name, column in cells.items() if name != "time_ns"
    }
    columns |= {
        "time_ns": pa.array(range(10)),
        "note": pa.array(["a", None] * 5),
        "ok": pa.array([True] * 10),
    }
    pq.write_table(pa.table(columns), tmp_path / "run.parquet")
    apply(calibration, tmp_path / "run.parquet", tmp_path / "out.parquet")
    after = pq.read_table(tmp_path / "out.parquet")
    assert after.select(list(columns)).equals(pa.table(columns))
    assert after.num_columns == len(columns) + 12


def test_format_follows_the_name_of_the_output(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration
) -> None:
    cells["note"] = list("abcdefghij")
    path = csv_of(cells)
    apply(calibration, path, tmp_path / "a.csv")
    apply(calibration, path, tmp_path / "b.parquet")
    stripped = pq.read_table(tmp_path / "b.parquet").drop_columns(list(NEW_COLUMNS))
    pq.write_table(stripped, tmp_path / "back.parquet")
    apply(calibration, tmp_path / "back.parquet", tmp_path / "c.csv")
    for name in ("b.parquet", "c.csv"):
        np.testing.assert_array_equal(new_columns(tmp_path / name), new_columns(tmp_path / "a.csv"))
    assert stripped.column("note").to_pylist() == cells["note"]
    assert stripped.column("time_ns").to_pylist() == [int(x) for x in cells["time_ns"]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"raw_3": None}, "no column `raw_3`"),
        ({"raw_6": ["1"] * 10}, "column `raw_6`: found one raw channel too many"),
        ({"fx_std": ["1"] * 10}, "column `fx_std`: found a column to be written"),
        ({"raw_2": ["1"] * 9 + ["inf"]}, r"row 10 \(line 11\), column `raw_2`: found 'inf'"),
        ({"time_ns": ["0"] * 10}, "found 0 ns after 0 ns"),
    ],
)
def test_nothing_is_left_of_a_log_that_is_refused(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration,
    change: dict[str, list[str] | None], message: str,
) -> None:  # fmt: skip
    path = csv_of({name: column for name, column in (cells | change).items() if column is not None})
    for output in ("new/out.csv", "new/out.parquet"):
        with pytest.raises(InputError, match=message):
            apply(calibration, path, tmp_path / output)
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.csv"]


def test_log_is_not_overwritten_by_itself(cells: Cells, csv_of: CsvOf, calibration: Calibration) -> None:
    path = csv_of(cells)
    with pytest.raises(InputError, match="found the log itself, expected another file"):
        apply(calibration, path, path)


@pytest.mark.parametrize("output", ["new/out.csv", "new/out.parquet"])
def test_a_log_of_which_no_row_can_be_corrected_is_refused(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration, output: str
) -> None:
    path = csv_of(cells | {"raw_2": [""] * 10})
    with pytest.raises(InputError, match=r"run\.csv: found no row with all raw channels, expected at least"):
        apply(calibration, path, tmp_path / output)
    warm = replace(calibration, offset_temperature=np.ones(6))
    path = csv_of(cells | {"temperature": ["nan"] * 10})
    with pytest.raises(InputError, match=r"no row with all raw channels and a temperature"):
        apply(warm, path, tmp_path / output)
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.csv"]


def test_empty_log_is_refused(cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration) -> None:
    path = csv_of({name: [] for name in cells})
    for output in ("out.csv", "out.parquet"):
        with pytest.raises(InputError, match="found no row"):
            apply(calibration, path, tmp_path / output)


def test_gain_without_inverse_is_refused(
    cells: Cells, csv_of: CsvOf, tmp_path: Path, calibration: Calibration
) -> None:
    singular = replace(calibration, gain=np.ones((6, 6)))
    with pytest.raises(InputError, match="the gain cannot be inverted"):
        apply(singular, csv_of(cells), tmp_path / "out.csv")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_memory_does_not_grow_with_the_log(
    tmp_path: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(csv_table, "_BLOCK", 1 << 16)
    monkeypatch.setattr(parquet_table, "_ROWS", 500)
    peaks = []
    for rows in (5_000, 40_000):
        draw = np.random.default_rng(rows)
        columns = {f"raw_{i}": draw.normal(size=rows) for i in range(6)} | {"time_ns": np.arange(rows)}
        path = tmp_path / f"{rows}.{kind}"
        if kind == "csv":
            write_table(path, columns)
        else:  # a page of a column is what Parquet has to hold
            pq.write_table(pa.table(columns), path, use_dictionary=False, data_page_size=4096)
        before = pa.total_allocated_bytes()
        arrow = [0]
        tracemalloc.start()
        apply(
            calibration,
            path,
            tmp_path / f"out.{kind}",
            progress=lambda _, arrow=arrow: arrow.append(pa.total_allocated_bytes()),
        )
        peaks.append(tracemalloc.get_traced_memory()[1] + max(arrow) - before)
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0] + 100_000, peaks
