"""Stamps and broken files: what is sorted, counted, noted, or refused."""

from __future__ import annotations

import re
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bags import MS, START, Bag, record, still, with_recording, write

from truewrench.io.tables import read_log
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig

Columns = dict[str, np.ndarray[Any, Any]]


@pytest.fixture
def run(rig: Rig) -> tuple[Rig, Columns]:
    """A rig, and a table that it can read."""
    draw = np.random.default_rng(0)
    names = [*(f"raw_{i}" for i in range(6)), "vx", "vy", "vz", "wx", "wy", "wz"]
    return rig, {"time_ns": START + MS * np.arange(400)} | {name: draw.normal(size=400) for name in names}


def test_header_and_receive_stamps_as_asked(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(400):
            bag.wrench("/ft", START + i * MS, [i] * 6, receive=START + i * MS + 250 * MS)
            bag.twist("/twist", START + i * MS, [i] * 6, receive=START + i * MS + 3 * MS)

    path = write(tmp_path, "mcap", fill)
    header = read_log(path, rig)
    np.testing.assert_array_equal(header.time_ns, START + MS * np.arange(400))
    assert any(note.startswith("/ft: header stamps are 0.25 s before") for note in header.notes)
    assert any("stamps are 0.247 s apart" in note for note in header.notes)
    receive = read_log(path, with_recording(rig, stamps="receive"))
    sensed = np.isfinite(receive.raw[:, 0])
    np.testing.assert_array_equal(receive.time_ns[sensed], START + MS * (250 + np.arange(400)))


def test_drift_of_the_stamps_is_noted(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(500):
            bag.wrench("/ft", START + i * MS, [i] * 6, receive=START + int(i * MS * 1.1))
            bag.twist("/twist", START + i * MS, [i] * 6)

    notes = read_log(write(tmp_path, "mcap", fill), rig).notes
    assert any(note.startswith("/ft: header stamps drift by 0.0499 s") for note in notes)


def test_messages_without_a_header_have_receive_stamps(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(20):
            six = bag.type("geometry_msgs/msg/Wrench")(
                force=bag.vector([i, 0, 0]), torque=bag.vector([0, 0, 0])
            )
            bag.write("/ft", "geometry_msgs/msg/Wrench", START + i * MS, six)
            bag.twist("/twist", START + i * MS, [0] * 6)

    log = read_log(write(tmp_path, "sqlite3", fill), rig)
    np.testing.assert_array_equal(log.time_ns, START + MS * np.arange(20))
    np.testing.assert_array_equal(log.raw[:, 0], np.arange(20))


def test_late_messages_are_sorted_in_and_noted(rig: Rig, tmp_path: Path) -> None:
    order = np.random.default_rng(0).permutation(5000)

    def fill(bag: Bag) -> None:
        for k, i in enumerate(order.tolist()):
            bag.wrench("/ft", START + i * MS, [i] * 6, receive=START + k * MS)
            bag.twist("/twist", START + k * MS, [k] * 6)

    log = read_log(write(tmp_path, "mcap", fill), rig)
    np.testing.assert_array_equal(log.time_ns, START + MS * np.arange(5000))
    np.testing.assert_array_equal(log.raw[:, 0], np.arange(5000))
    late = int((order < np.maximum.accumulate(order)).sum())
    assert f"/ft: {late} messages came late and were sorted in by their stamps" in log.notes


def test_repeated_stamps_are_counted_or_refused(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag, 400)
        bag.wrench("/ft", START + 399 * MS, [1e3] * 6, receive=START + 400 * MS)

    log = read_log(write(tmp_path, "mcap", fill), rig)
    assert log.raw[-1, 0] == 399
    assert "/ft: 1 messages with the stamp of an earlier one left out" in log.notes

    def unset(bag: Bag) -> None:
        for i in range(20):
            bag.wrench("/ft", 0, [i] * 6, receive=START + i * MS)
            bag.twist("/twist", START + i * MS, [0] * 6)

    shutil.rmtree(tmp_path / "run")
    with pytest.raises(InputError, match=r"19 of 20 messages with a stamp .*stamps: receive"):
        read_log(write(tmp_path, "mcap", unset), rig)


def test_streams_of_clocks_without_a_time_in_common_are_refused(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(20):
            bag.wrench("/ft", (i + 1) * MS, [i] * 6, receive=START + i * MS)
            bag.twist("/twist", START + i * MS, [0] * 6)

    path = write(tmp_path, "mcap", fill)
    with pytest.raises(InputError, match=r"expected streams that overlap; .*stamps: receive"):
        read_log(path, rig)
    assert len(read_log(path, with_recording(rig, stamps="receive")).time_ns) == 20


def test_nan_is_left_out_and_counted_and_infinity_refused(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        bag.wrench("/ft", START + 20 * MS, [1, np.nan, 1, 1, 1, 1])

    log = read_log(write(tmp_path, "mcap", fill), rig)
    assert log.nan_counts == {"raw_1": 1}
    assert np.isnan(log.raw[-1]).tolist() == [False, True, False, False, False, False]
    shutil.rmtree(tmp_path / "run")

    def infinite(bag: Bag) -> None:
        still(bag)
        bag.wrench("/ft", START + 20 * MS, [1, np.inf, 1, 1, 1, 1])

    place = rf"stamp {START + 20 * MS} ns, column `raw_1`: found inf, expected a finite number"
    with pytest.raises(InputError, match=place):
        read_log(write(tmp_path, "mcap", infinite), rig)


@pytest.mark.parametrize("kind", ["mcap", "mcap-storage", "mcap-file", "mcap-message", "sqlite3", "bag"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_truncated_file_is_a_clear_error(
    run: tuple[Rig, Columns], tmp_path: Path, kind: str, share: float
) -> None:
    path = record(tmp_path / "run", kind, run[1])
    file = path if path.is_file() else next(f for f in path.iterdir() if f.name != "metadata.yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"found a broken recording \(.*\), expected a complete recording"):
        read_log(path, run[0])


@pytest.mark.parametrize(
    ("kind", "remedy"),
    [
        ("mcap", r"`mcap recover run\.mcap`"),
        ("sqlite3", r"`sqlite3 run\.db3 \.recover`"),
        ("sqlite3-file", r"`zstdcat run\.db3\.zstd`"),
        ("bag", r"`rosbag reindex run\.bag`"),
    ],
)
def test_remedy_is_that_of_the_broken_file(
    run: tuple[Rig, Columns], tmp_path: Path, kind: str, remedy: str
) -> None:
    path = record(tmp_path / "run", kind, run[1])
    file = path if path.is_file() else next(f for f in path.iterdir() if f.name != "metadata.yaml")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(InputError, match=rf"{file.name}: found a broken recording .*\({remedy}"):
        read_log(path, run[0])


def split(path: Path, columns: Columns) -> Path:
    """A recording in three files."""
    for k in range(3):
        record(path.with_name(f"{path.name}_{k}"), "mcap", columns)
    folder = path.with_name(f"{path.name}_0")
    metadata = yaml.safe_load((folder / "metadata.yaml").read_text())
    names = [f"{path.name}_{k}.mcap" for k in range(3)]
    for name in names[1:]:
        (path.with_name(name[:-5]) / name).rename(folder / name)
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = names
    (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    return folder


def test_broken_part_of_a_folder_is_named(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = split(tmp_path / "run", run[1])
    part = folder / "run_1.mcap"
    whole = part.read_bytes()
    part.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"run_1\.mcap: found a broken .*`mcap recover run_1\.mcap`"):
        read_log(folder, run[0])
    inside = bytearray(whole)  # its index stays
    inside[200 : len(whole) // 2] = bytes(len(whole) // 2 - 200)
    part.write_bytes(bytes(inside))
    with pytest.raises(InputError, match=r"run_1\.mcap: found a broken .*`mcap recover run_1\.mcap`"):
        read_log(folder, run[0])
    part.unlink()
    with pytest.raises(InputError, match=r"run_0: found a broken .*run_1\.mcap.*`ros2 bag reindex`"):
        read_log(folder, run[0])


def test_another_serialisation_is_named(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "sqlite3", run[1])
    metadata = folder / "metadata.yaml"
    metadata.write_text(
        re.sub("serialization_format: .*", "serialization_format: xcdr", metadata.read_text())
    )
    words = r"metadata\.yaml: serialization_format: found messages in `xcdr`, expected messages in CDR"
    with pytest.raises(InputError, match=words):
        read_log(folder, run[0])
    database = sqlite3.connect(folder / "run.db3")
    database.execute("UPDATE topics SET serialization_format = 'xcdr'")
    database.commit()
    database.close()
    with pytest.raises(InputError, match=r"run\.db3: topic /.*: found messages in `xcdr`, expected messages"):
        read_log(folder / "run.db3", run[0])


def test_message_of_another_shape_is_named(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        bag.write_bytes("/ft", "geometry_msgs/msg/WrenchStamped", START + 20 * MS, b"\0\1\0\0" + bytes(30))

    words = r"topic /ft, message 21: found a broken message \(34 bytes, fewer than its type has\)"
    with pytest.raises(InputError, match=words):
        read_log(write(tmp_path, "mcap", fill), rig)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.mcap", b"", "found an empty file"),
        ("run.bag", b"time_ns,raw_0\n", "found a file that does not begin like one"),
        ("run.csv", b"\x89MCAP0\r\n", r"found MCAP under this name, expected a name that ends in \.mcap"),
    ],
)
def test_what_is_no_recording_is_refused(
    rig: Rig, tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_log(tmp_path / name, rig)


def test_database_that_was_not_closed_is_refused(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "sqlite3", run[1])
    (folder / "run.db3-wal").write_bytes(b"rows that have not been merged")
    with pytest.raises(InputError, match=r"a recording that was cut off \(run\.db3-wal beside it\)"):
        read_log(folder, run[0])


def test_folder_without_metadata_names_its_files(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "mcap", run[1])
    (folder / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"a folder without metadata\.yaml, expected .*files: run\.mcap"):
        read_log(folder, run[0])
