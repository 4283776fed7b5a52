"""A table is read as it was meant, or refused with file, row, column, what was found and expected."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from truewrench.io import csv_table, table
from truewrench.io.tables import REFERENCE, read_log, split_payload, write_table
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig

CsvOf = Callable[..., Path]
Cells = dict[str, list[str]]


def parquet_of(cells: Cells, path: Path) -> Path:
    """The same log as Parquet: empty cells as null."""
    columns = {
        name: pa.array([int(x) if name == "time_ns" else None if x == "" else float(x) for x in column])
        for name, column in cells.items()
    }
    pq.write_table(pa.table(columns), path)
    return path


def test_csv_and_parquet_give_the_same_log(cells: Cells, csv_of: CsvOf, rig: Rig, tmp_path: Path) -> None:
    cells["raw_2"][3] = ""
    cells["vx"][4] = "nan"
    logs = [read_log(csv_of(cells), rig), read_log(parquet_of(cells, tmp_path / "run.parquet"), rig)]
    for log in logs:
        assert log.payload == "default"
        np.testing.assert_array_equal(log.time_ns, np.arange(10) * 10_000_000)
        expected = [[float(cells[f"raw_{i}"][k] or "nan") for i in range(6)] for k in range(10)]
        np.testing.assert_array_equal(log.raw, expected)
        assert log.twist is not None
        assert log.twist[7, 5] == float(cells["wz"][7])
        assert log.nan_counts == {"vx": 1}
        assert log.dropped_rows == 0
    assert logs[0].sha256 == hashlib.sha256((tmp_path / "run.csv").read_bytes()).hexdigest()
    np.testing.assert_allclose(logs[0].time, np.arange(10) * 0.01, atol=1e-15)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_log_beyond_what_is_allowed_is_refused(
    cells: Cells, csv_of: CsvOf, rig: Rig, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = csv_of(cells) if kind == "csv" else parquet_of(cells, tmp_path / "run.parquet")
    with pytest.raises(InputError, match="found more than 9 rows, expected fewer, or more by --max-rows N"):
        read_log(path, rig, max_rows=9)
    assert len(read_log(path, rig, max_rows=10).time_ns) == 10
    monkeypatch.setattr(table, "MOST_BYTES", 10 * 8 * 5)
    with pytest.raises(InputError, match="of numbers in 10 rows"):
        read_log(path, rig)
    assert len(read_log(path, rig, max_rows=10).time_ns) == 10
    monkeypatch.setattr(table, "MOST_ROWS", 4)
    with pytest.raises(InputError, match="more than 4 rows"):
        read_log(path, rig)


def test_rows_without_any_measurement_are_dropped_and_counted(cells: Cells, csv_of: CsvOf, rig: Rig) -> None:
    for name in cells:
        if name != "time_ns":
            cells[name][2] = ""
            cells[name][5] = "NaN"
    log = read_log(csv_of(cells), rig)
    assert log.dropped_rows == 2
    assert list(log.time_ns // 10_000_000) == [0, 1, 3, 4, 6, 7, 8, 9]
    assert log.nan_counts == {name: 1 for name in cells if name != "time_ns"}


def test_streams_of_different_rates_share_a_table(cells: Cells, csv_of: CsvOf, rig: Rig) -> None:
    for name in cells:
        for k in range(10):
            if (name.startswith("raw") and k % 2) or (name[0] in "vw" and not k % 2):
                cells[name][k] = ""
    log = read_log(csv_of(cells), rig)
    assert log.twist is not None
    np.testing.assert_array_equal(np.isnan(log.raw).all(axis=1), np.arange(10) % 2 == 1)
    np.testing.assert_array_equal(np.isnan(log.twist).all(axis=1), np.arange(10) % 2 == 0)
    assert (log.dropped_rows, log.nan_counts) == (0, {})


@pytest.mark.parametrize("spoil", ["bom", "crlf", "blanks", "quotes", "blank lines", "no final line end"])
def test_spelling_of_a_csv_does_not_matter(cells: Cells, csv_of: CsvOf, rig: Rig, spoil: str) -> None:
    path = csv_of(cells)
    log = read_log(path, rig)
    text = path.read_bytes()
    path.write_bytes(
        {
            "bom": b"\xef\xbb\xbf" + text,
            "crlf": text.replace(b"\n", b"\r\n"),
            "blanks": text.replace(b",", b" , "),
            "quotes": b'"' + text[:-1].replace(b",", b'","').replace(b"\n", b'"\n"') + b'"\n',
            "blank lines": text.replace(b"\n", b"\n\n") + b"\n  \n",
            "no final line end": text[:-1],
        }[spoil]
    )
    again = read_log(path, rig)
    np.testing.assert_array_equal(again.time_ns, log.time_ns)
    np.testing.assert_array_equal(again.raw, log.raw)
    np.testing.assert_array_equal(again.twist, log.twist)


def test_optional_groups_are_read_whole(cells: Cells, csv_of: CsvOf, rig: Rig) -> None:
    ones = ["1.0"] * 10
    groups = dict.fromkeys(
        ["gx", "gy", "gz", "ax", "ay", "az", "alx", "aly", "alz", "temperature", "note"], ones
    )
    log = read_log(csv_of(cells | groups), rig)
    assert log.gravity is not None
    assert log.acceleration is not None
    assert log.temperature is not None
    assert (log.gravity.shape, log.acceleration.shape, log.temperature.shape) == ((10, 3), (10, 6), (10,))
    del groups["gy"]
    with pytest.raises(InputError, match=r"run\.csv: header: found no column `gy` \(nearest: `..`\)"):
        read_log(csv_of(cells | groups), rig)


def test_twist_log_in_gravity_needs_its_direction(
    cells: Cells, csv_of: CsvOf, settings: dict[str, Any]
) -> None:
    settings["gravity"] = [0, 0, -9.81]
    with pytest.raises(InputError, match=r"found no column `gx`.*no column `gy`.*no column `gz`"):
        read_log(csv_of(cells), Rig.from_mapping(settings))


@pytest.mark.parametrize(
    ("column", "row", "text", "found"),
    [
        ("raw_3", 4, "abc", "the text 'abc'"),
        ("vx", 9, "1,5", "the text '1,5'"),
        ("wz", 0, "1_000", "the text '1_000'"),
        ("raw_0", 2, "inf", "'inf'"),
        ("raw_5", 7, "-Infinity", "'-Infinity'"),
        ("vy", 1, "1e400", "'1e400'"),
        ("time_ns", 3, "", "an empty cell"),
        ("time_ns", 3, "nan", "nan"),
        ("time_ns", 3, "1.5", "1.5"),
        ("time_ns", 3, "1e30", "1e30"),
        ("time_ns", 3, "noon", "the text 'noon'"),
        ("time_ns", 3, "20000000", "20000000 ns after 20000000 ns"),
        ("time_ns", 6, "1", "1 ns after 50000000 ns"),
    ],
)
def test_bad_cell_is_named_by_row_line_and_column(
    cells: Cells, csv_of: CsvOf, rig: Rig, column: str, row: int, text: str, found: str
) -> None:
    cells[column][row] = text
    with pytest.raises(InputError) as caught:
        read_log(csv_of(cells), rig)
    place = f"run.csv: row {row + 1} (line {row + 2}), column `{column}`: found {found}, expected "
    assert place in str(caught.value)


def test_lines_are_counted_across_blocks_and_blank_lines(
    cells: Cells, csv_of: CsvOf, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_table, "_BLOCK", 300)
    cells["raw_3"][8] = "abc"
    path = csv_of(cells)
    lines = path.read_bytes().split(b"\n")
    path.write_bytes(b"\n".join([*lines[:3], b"", b"", *lines[3:]]))
    with pytest.raises(InputError, match=r"row 9 \(line 12\), column `raw_3`: found the text 'abc'"):
        read_log(path, rig)


@pytest.mark.parametrize("cut", [b",1.0", b""])
def test_row_of_another_length_is_named(cells: Cells, csv_of: CsvOf, rig: Rig, cut: bytes) -> None:
    path = csv_of(cells)
    lines = path.read_bytes().split(b"\n")
    lines[6] = lines[6] + cut if cut else lines[6].rpartition(b",")[0]
    path.write_bytes(b"\n".join(lines))
    count = 14 if cut else 12
    with pytest.raises(InputError, match=rf"row 6 \(line 7\): found {count} cells, expected 13, as in"):
        read_log(path, rig)


def test_parquet_cell_is_named_by_row_and_column(cells: Cells, rig: Rig, tmp_path: Path) -> None:
    cells["vy"][4] = "inf"
    with pytest.raises(InputError, match=r"run\.parquet: row 5, column `vy`: found inf, expected a finite"):
        read_log(parquet_of(cells, tmp_path / "run.parquet"), rig)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vx": None}, r"header: found no column `vx` \(nearest: `..`\)"),
        ({"raw_5": None}, r"header: found no column `raw_5` \(nearest: `raw_[0-4]`\)"),
        ({"time_ns": None}, r"header: found no time \(nearest column: "),
        ({"raw_6": ["1"] * 10}, r"column `raw_6`: found one raw channel too many, expected the 6 channels"),
        ({"wy": [""] * 10}, r"column `wy`: found not one number"),
        ({f"raw_{i}": ["nan"] * 10 for i in range(6)}, r"column `raw_0`: found not one number"),
    ],
)
def test_wrong_columns_are_named(
    cells: Cells, csv_of: CsvOf, rig: Rig, change: dict[str, list[str] | None], message: str
) -> None:
    columns = {name: column for name, column in (cells | change).items() if column is not None}
    with pytest.raises(InputError, match=rf"run\.csv: {message}"):
        read_log(csv_of(columns), rig)


def test_a_channel_that_is_silent_is_read(cells: Cells, csv_of: CsvOf, rig: Rig) -> None:
    log = read_log(csv_of(cells | {"raw_1": [""] * 10}), rig)
    assert np.isnan(log.raw[:, 1]).all()
    with pytest.raises(InputError, match=r"column `raw_1`: found not one number, expected samples of every"):
        log.check_channels()


@pytest.mark.parametrize(("rows", "found"), [(0, "no row"), (1, "one row")])
def test_empty_and_one_row_logs_are_refused(
    cells: Cells, csv_of: CsvOf, rig: Rig, rows: int, found: str, tmp_path: Path
) -> None:
    short = {name: column[:rows] for name, column in cells.items()}
    for path in (csv_of(short), parquet_of(short, tmp_path / "run.parquet")):
        with pytest.raises(InputError, match=rf"run\.[a-z]+: found {found}, expected at least two rows"):
            read_log(path, rig)


def test_one_row_with_measurements_is_not_enough(cells: Cells, csv_of: CsvOf, rig: Rig) -> None:
    blank = {name: column if name == "time_ns" else [column[0]] + [""] * 9 for name, column in cells.items()}
    with pytest.raises(InputError, match="found a measurement in one row only"):
        read_log(csv_of(blank), rig)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "line 1: found an empty file"),
        (b"\n1,2\n", "line 1: found an empty line"),
        (b"time_ns,raw_0", "header: found no column"),
        (b"time_ns;raw_0\n0;1\n", "line 1: found one column, .*expected columns separated by commas"),
        (b"\x1f\x8b\x08\x00\xff\xfe", "line 1: found a gzip file, expected .*unpacked"),
        (b"\x00\x8b\x08\x00\xff\xfe", "line 1: found bytes that are not text"),
        (b"# a recorder\ntime_ns,raw_0\n0,1\n", "line 1: found '# a recorder', expected a header"),
        (b"0,1,1\n2,1,1\n", "line 1: found '0', expected a header with the names of the columns"),
        (b"0.5,1,2\n1.5,1,1\n", "line 1: found '0.5', expected a header with the names of the columns"),
        (b"PAR1 and no more", "found a broken file"),
        (b"time_ns,vx,vx\n0,1,2\n", "header, column 3: found `vx` a second time"),
        (b"time_ns,vx\r0,1\r", "line 1: found a carriage return within"),
        (b"time_ns," + b"x" * 200_000 + b"\n0,1\n", "line 1: found field larger than field limit"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, rig: Rig, content: bytes, message: str) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"run\.csv: {message}"):
        read_log(path, rig)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (b'"1\n"', "an unclosed quote"),
        (b"1\r2", "a carriage return within"),
        (b"\xff", "unreadable text .*UTF"),
    ],
)
def test_line_that_is_no_row_is_named(
    cells: Cells, csv_of: CsvOf, rig: Rig, cell: bytes, message: str
) -> None:
    path = csv_of(cells)
    path.write_bytes(path.read_bytes().replace(b"\n10000000,", b"\n10000000," + cell, 1))
    with pytest.raises(InputError, match=rf"run\.csv: lines? (2 to 11|3): found {message}"):
        read_log(path, rig)


def last_cells(kind: str, count: int) -> list[str]:
    """Numbers as programs write them, of sizes from 1e-2 to 1e4."""
    draw = np.random.default_rng(3)
    values = [float(x) for x in draw.normal(size=count) * 10.0 ** draw.uniform(-2.0, 4.0, size=count)]
    write: dict[str, Callable[[float], str]] = {
        "repr": repr, "fixed": "{:.6f}".format, "exponent": "{:.18e}".format, "integer": "{:.0f}".format,
        "gaps": lambda x: repr(x) if x > 0.0 else "",
    }  # fmt: skip
    return [write[kind](x) for x in values]


def csv_that_ends(path: Path, cells: list[str], last: str) -> Path:
    """A log whose last column has these cells, the last row without a line end."""
    rows = [f"{1_000_000 * k},0.5,{cell}" for k, cell in enumerate([*cells, last])]
    path.write_text("\n".join(["time_ns,vx,raw_0", *rows]))
    return path


def is_read(path: Path) -> bool:
    try:
        return bool(sum(chunk.rows for chunk in csv_table.CsvTable(path).chunks()))
    except InputError as error:
        if "run.csv: last line: found a line that ends within a number, `" in str(error):
            return False
        raise


@pytest.mark.parametrize("kind", ["repr", "fixed", "exponent", "integer", "gaps"])
def test_a_last_line_without_an_end_is_read(tmp_path: Path, kind: str) -> None:
    cells, path = last_cells(kind, 2000), tmp_path / "run.csv"
    assert sum(not is_read(csv_that_ends(path, cells[:-1], cell)) for cell in cells[::20]) <= 1
    for last in ("nan", "", "0.5\r", "0.5\n") if kind == "gaps" else ("nan", "NaN", cells[0] + "\r"):
        assert is_read(csv_that_ends(path, cells, last))
    assert is_read(csv_that_ends(path, cells[:49], "1"))  # too few rows tell how long a cell is


@pytest.mark.parametrize(
    ("kind", "loss"), [("repr", 1e-9), ("fixed", 0.0), ("exponent", 0.0), ("gaps", 1e-9)]
)
def test_a_number_that_is_cut_off_is_refused_or_is_hardly_another(
    tmp_path: Path, kind: str, loss: float
) -> None:
    cells, path = last_cells(kind, 2000), tmp_path / "run.csv"
    for whole in [cell for cell in cells[1000:] if cell][:12]:
        for length in range(1, len(whole)):
            if is_read(csv_that_ends(path, cells[:1000], whole[:length])):
                assert float(whole[:length]) == pytest.approx(float(whole), rel=loss, abs=0.0)
    assert is_read(csv_that_ends(path, cells[:1000], "")) == (kind == "gaps")


def test_missing_file_and_plain_folder_are_refused(tmp_path: Path, rig: Rig) -> None:
    with pytest.raises(InputError, match=r"none\.csv: cannot be read: No such file"):
        read_log(tmp_path / "none.csv", rig)
    with pytest.raises(InputError, match=r"found a folder without metadata\.yaml, expected a rosbag2 folder"):
        read_log(tmp_path, rig)


TOOLS = {"hammer", "clamp"}


@pytest.fixture
def tool_rig(settings: dict[str, Any]) -> Rig:
    payload = settings["payloads"].pop("default")
    settings["payloads"] |= dict.fromkeys(sorted(TOOLS), payload)
    return Rig.from_mapping(settings)


def test_payload_is_split_off_only_when_the_rig_has_it(rig: Rig, tool_rig: Rig, tmp_path: Path) -> None:
    assert split_payload("logs/run.csv@hammer", tool_rig) == (Path("logs/run.csv"), "hammer")
    assert split_payload("a@b/run@2.csv@clamp", tool_rig) == (Path("a@b/run@2.csv"), "clamp")
    assert split_payload("run.csv", rig) == (Path("run.csv"), "default")
    real = tmp_path / "run@home"
    real.write_text("x", encoding="utf-8")
    assert split_payload(real, rig) == (real, "default")


def test_payload_must_be_named_when_there_are_several(tool_rig: Rig) -> None:
    with pytest.raises(InputError, match=r"run\.csv: found no payload named, expected .*: clamp, hammer"):
        split_payload("run.csv", tool_rig)


def test_unknown_payload_is_named_with_the_known_ones(tool_rig: Rig) -> None:
    with pytest.raises(InputError, match=r"no payload `hamer` in the rig, expected one of: clamp, hammer"):
        split_payload("run.csv@hamer", tool_rig)


seconds = st.decimals(Decimal(-10) ** 9, Decimal(8) * 10**9, places=11, allow_nan=False)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50, deadline=None)
@given(st.lists(seconds, min_size=10, max_size=10), st.booleans())
def test_seconds_are_exact_to_the_nearest_nanosecond(
    cells: Cells, csv_of: CsvOf, rig: Rig, times: list[Decimal], exponents: bool
) -> None:
    stamps = sorted({int((t * 10**9).to_integral_value()): t for t in times}.items())
    # a tie may be rounded either way: neighbours could become one stamp
    stamps = [s for i, s in enumerate(stamps) if i == 0 or s[0] - stamps[i - 1][0] > 1]
    if len(stamps) < 2:
        return
    log_cells = {name: column[: len(stamps)] for name, column in cells.items() if name != "time_ns"}
    text = [f"{t:e}" if exponents else f"{t:f}" for _, t in stamps]
    log = read_log(csv_of({"time_s": text} | log_cells), rig)
    assert np.abs(log.time_ns - np.array([ns for ns, _ in stamps])).max() <= 1
    exact = [abs(Decimal(int(ns)) - t * 10**9) for ns, (_, t) in zip(log.time_ns, stamps, strict=True)]
    assert max(exact) <= Decimal("0.5")


def test_parquet_seconds_keep_what_a_double_holds(cells: Cells, rig: Rig, tmp_path: Path) -> None:
    time_s = 1_700_000_000 + np.arange(10) * 0.015625  # exact in binary
    columns = {
        name: np.array([float(x) for x in column]) for name, column in cells.items() if name != "time_ns"
    }
    path = tmp_path / "run.parquet"
    write_table(path, {"time_s": time_s} | columns)
    expected = 1_700_000_000_000_000_000 + np.arange(10) * 15_625_000
    np.testing.assert_array_equal(read_log(path, rig).time_ns, expected)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50, deadline=None)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=False), min_size=6, max_size=6), st.booleans())
def test_any_number_survives_writing_and_reading(
    cells: Cells, rig: Rig, tmp_path: Path, values: list[float], parquet: bool
) -> None:
    columns = {name: np.array([float(x) for x in column]) for name, column in cells.items()}
    columns["time_ns"] = np.arange(10) * 10_000_000
    for i, value in enumerate(values):
        columns[f"raw_{i}"][3] = value
    path = tmp_path / ("run.parquet" if parquet else "run.csv")
    write_table(path, columns)
    log = read_log(path, rig)
    np.testing.assert_array_equal(log.raw[3], values)
    assert log.nan_counts == {}  # a missing sample is written as an empty cell


@pytest.mark.parametrize("parquet", [False, True])
def test_a_reference_makes_up_for_motion_and_gravity(
    cells: Cells, csv_of: CsvOf, settings: dict[str, Any], tmp_path: Path, parquet: bool
) -> None:
    settings["gravity"] = [0, 0, -9.81]
    rig = Rig.from_mapping(settings)
    for moved, known in zip(("vx", "vy", "vz", "wx", "wy", "wz"), REFERENCE, strict=True):
        cells[known] = cells.pop(moved)
    cells["ref_my"][6] = ""
    log = read_log(parquet_of(cells, tmp_path / "run.parquet") if parquet else csv_of(cells), rig)
    assert log.twist is None
    assert log.gravity is None
    assert log.reference is not None
    expected = [[float(cells[name][k] or "nan") for name in REFERENCE] for k in range(10)]
    np.testing.assert_array_equal(log.reference, expected)
    del cells["ref_mz"]
    with pytest.raises(InputError, match="no column `ref_mz`"):
        read_log(csv_of(cells), rig)


@pytest.mark.external
def test_recorded_tools_are_read(external_data: Path, settings: dict[str, Any]) -> None:
    settings["gravity"] = [0, 0, -9.81]
    log = read_log(external_data / "utias" / "hammer.csv", Rig.from_mapping(settings))
    assert log.raw.shape == (1000, 6)
    assert log.gravity is not None
    np.testing.assert_allclose(np.linalg.norm(log.gravity, axis=1), 9.81, rtol=1e-6)
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-9)


def test_two_columns_of_the_time_say_the_same(cells: Cells, csv_of: CsvOf, rig: Rig) -> None:
    times = [int(x) for x in cells["time_ns"]]
    cells["time_s"] = [repr(100.0 + 1e-9 * (t - times[0])) for t in times]
    read_log(csv_of(cells), rig)
    cells["time_s"] = [repr(2e-9 * t) for t in times]
    with pytest.raises(InputError, match=r"row \d+.*`time_s`.*expected the same time in both"):
        read_log(csv_of(cells), rig)


def test_a_header_without_an_end_is_refused_as_such(rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    path.write_text("time_ns," + ",".join(f"c{k}" for k in range(200_000)) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 1: found more than 1048576 bytes, expected a header"):
        read_log(path, rig)
