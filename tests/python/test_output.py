"""Output that cannot be written is refused with its name, and a fault of an input stays one of the input."""

from __future__ import annotations

import errno
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from truewrench.io.output import write_batches, write_lines
from truewrench.model.errors import InputError
from truewrench.model.files import atomic_output, write_yaml

BATCH = pa.RecordBatch.from_pydict({"a": np.random.default_rng(0).random(20_000)})


def put_lines(path: Path) -> None:
    write_lines(path, [b"0.123456789\n" * 20_000])


def put_batch(path: Path) -> None:
    write_batches(path, [BATCH])


def put_yaml(path: Path) -> None:
    write_yaml(path, {"a": np.arange(20_000.0)})


@contextmanager
def room(size: int) -> Iterator[None]:
    """No file may grow beyond a size [bytes], as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize(
    ("write", "name"), [(put_lines, "o.csv"), (put_batch, "o.csv"), (put_batch, "o.pq"), (put_yaml, "o.yaml")]
)
def test_a_disk_that_is_full_is_named_with_the_file(
    tmp_path: Path, write: Callable[[Path], None], name: str
) -> None:
    path = tmp_path / "new" / name
    with room(20_000), pytest.raises(InputError) as caught:
        write(path)
    assert str(caught.value) == f"{path}: cannot be written: File too large"
    assert not list(tmp_path.iterdir())


def test_a_folder_is_refused_before_any_work(tmp_path: Path) -> None:
    def batches() -> Iterator[pa.RecordBatch]:
        raise AssertionError("worked for nothing")
        yield BATCH

    with pytest.raises(InputError, match=r": cannot be written: Is a directory$") as caught:
        write_batches(tmp_path, batches())
    assert str(tmp_path) in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_name_that_is_too_long_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r": cannot be written: File name too long$"):
        write_lines(tmp_path / ("a" * 300), [b""])


def test_a_place_that_was_taken_meanwhile_is_named(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    with pytest.raises(InputError, match=r"out\.txt: cannot be written: Is a directory"), atomic_output(path):
        path.mkdir()
    assert [entry.name for entry in tmp_path.iterdir()] == ["out.txt"]


@pytest.mark.parametrize("fault", [OSError(errno.EIO, "Input/output error"), pa.ArrowInvalid("of the log")])
def test_a_fault_of_the_input_is_not_told_as_one_of_the_output(tmp_path: Path, fault: Exception) -> None:
    def lines() -> Iterator[bytes]:
        yield b"1\n"
        raise fault

    def batches() -> Iterator[pa.RecordBatch]:
        yield BATCH
        raise fault

    with pytest.raises(type(fault)) as caught:
        write_lines(tmp_path / "o.csv", lines())
    assert caught.value is fault
    with pytest.raises(type(fault)) as caught:
        write_batches(tmp_path / "o.csv", batches())
    assert caught.value is fault
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("value", [[1.0], {"x": 1.0}])
def test_a_column_that_csv_cannot_hold_is_named(tmp_path: Path, value: object) -> None:
    batch = pa.RecordBatch.from_pydict({"a": [1.0], "odd": [value]})
    with pytest.raises(InputError, match=r"o\.csv: column `odd`: found values of type (list|struct)<.*\.pa"):
        write_batches(tmp_path / "o.csv", [batch])
    assert not list(tmp_path.iterdir())
    write_batches(tmp_path / "o.parquet", [batch])
    assert (tmp_path / "o.parquet").is_file()
