"""What CSV and Parquet have in common: a table that is read in chunks of rows."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa

from truewrench.io.cells import Column
from truewrench.model.errors import InputError

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
AT_REST = "0 in all of vx ... wz, if each row is a pose at rest"
"""What would do where a log has attitudes and no twist."""

ANGULAR_VELOCITY = TWIST[3:]
ATTITUDE = ("qw", "qx", "qy", "qz")
ACCELERATION = ("ax", "ay", "az", "alx", "aly", "alz")
GRAVITY = ("gx", "gy", "gz")
SPECIFIC_FORCE = ("accel_x", "accel_y", "accel_z")
REFERENCE = ("ref_fx", "ref_fy", "ref_fz", "ref_mx", "ref_my", "ref_mz")


class Chunk(ABC):
    """Consecutive rows of a table."""

    rows: int

    @abstractmethod
    def column(self, name: str) -> Column:
        """The cells of one column."""

    @abstractmethod
    def batch(self) -> pa.RecordBatch:
        """All columns, with the types that a table file would give them."""


MOST_ROWS = 1 << 25  # of a log, unless more are asked for
MOST_BYTES = 4_000_000_000  # of the numbers in its columns, likewise


class Table(ABC):
    """A table file, of any size; one larger than a log should be is refused once it is read so far."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self.path = path
        self.max_rows: int | None = None  # None: `MOST_ROWS` and `MOST_BYTES`
        self.names = tuple(names)  # of the columns, each once, in order
        self.notes: tuple[str, ...] = ()  # what is no fault but worth a look
        for i, name in enumerate(self.names):
            if name in self.names[:i]:
                found = f"`{name}` a second time"
                raise InputError.at(path, f"header, column {i + 1}", found, "every column name once")

    def sha256(self) -> str:
        """Of the file."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def chunks(self, names: Sequence[str] | None = None) -> Iterator[Chunk]:
        """The rows in order, in chunks of bounded size; with `names`, these columns alone."""
        width, rows = 8 * len(self.names if names is None else names), 0
        for chunk in self.blocks(names):
            rows += chunk.rows
            most = MOST_ROWS if self.max_rows is None else self.max_rows
            if rows > most:
                raise InputError.at(self.path, "", f"more than {most} rows", "fewer, or more by --max-rows N")
            if self.max_rows is None and rows * width > MOST_BYTES:
                found = f"more than {MOST_BYTES // 10**9} GB of numbers in {rows} rows"
                raise InputError.at(self.path, "", found, "fewer, or as many rows as --max-rows N allows")
            yield chunk

    @abstractmethod
    def blocks(self, names: Sequence[str] | None) -> Iterator[Chunk]:
        """The same, whatever their number."""
