"""Broken recordings: which file is at fault, and what repairs it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa

from truewrench.model.errors import InputError
from truewrench.model.files import read_yaml

CDR = "messages in CDR, as ROS 2 writes them by default"
"""What is read of ROS 2."""

_REMEDIES = {
    ".mcap": "`mcap recover {}` repairs one that was cut off",
    ".db3": "`sqlite3 {} .recover` reads one that is malformed",
    ".zstd": "`zstdcat {}` reads one that was cut off",
    ".bag": "`rosbag reindex {}` repairs one that was cut off",
}  # by the ending of a file
_REINDEX = "`ros2 bag reindex` writes metadata.yaml anew"
_BLOCK = 1 << 20  # bytes unpacked at once


@contextmanager
def faults_of(path: Path, *, reading: bool = False) -> Iterator[None]:
    """Whatever a foreign reader trips over, on opening or reading, is a fault of the file that it reads."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise _fault(path, error, reading) from error


def _fault(path: Path, error: Exception, reading: bool) -> InputError:
    if path.is_dir():
        other = sorted(_formats_in(path) - {"cdr"})
        if other:
            found = f"messages in {', '.join(f'`{name}`' for name in other)}"
            return InputError.at(path / "metadata.yaml", "serialization_format", found, CDR)
        for part in sorted(path.iterdir()):
            fault = _fault_in(part, reading)
            if fault is not None:
                path, error = part, fault
                break
    reason = " ".join(str(error).split()) or type(error).__name__
    remedy = _REINDEX if path.is_dir() else _REMEDIES[path.suffix.lower()].format(path.name)
    return InputError.at(path, "", f"a broken recording ({reason})", f"a complete recording ({remedy})")


def _formats_in(folder: Path) -> set[str]:
    """In which the messages are serialised, by metadata that can be read."""
    try:
        information = read_yaml(folder / "metadata.yaml")[0]["rosbag2_bagfile_information"]
        topics = [topic["topic_metadata"] for topic in information["topics_with_message_count"]]
        return {str(topic["serialization_format"]) for topic in topics}
    except (InputError, LookupError, TypeError):
        return set()


def _fault_in(part: Path, reading: bool) -> Exception | None:
    """Of one file of a folder, None if it opens, or can be read to its end, or is none of the recording's."""
    from rosbags.rosbag2 import Reader

    try:
        if part.suffix == ".zstd":
            with pa.input_stream(str(part), compression="zstd") as file:
                while file.read(_BLOCK):
                    pass
        elif part.suffix in (".mcap", ".db3"):
            with Reader(part) as reader:
                for _ in reader.messages() if reading else ():
                    pass
    except Exception as error:
        return error
    return None
