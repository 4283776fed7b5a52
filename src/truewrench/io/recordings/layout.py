"""Where the numbers of a serialised message stand.

Messages of one topic differ in their numbers alone, as long as their texts and the lengths of their lists
stay the same: the layout of the first then holds for all, and thousands are decoded at once.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from truewrench.model.arrays import Mask

_KEPT = 16  # layouts of a topic: publishers with other names, or texts that change
Definitions = Mapping[str, Any]  # fields by name of a message type, as `rosbags` parses them

_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4  # kinds of fields in `rosbags`

_CODES = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "int8": "i1", "uint8": "u1", "int16": "i2",
    "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4",
    "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Numbers:
    """Where `count` numbers stand: their first byte and their type."""

    offset: int
    dtype: np.dtype[Any]
    count: int


@dataclass(frozen=True, slots=True)
class Layout:
    """Of one message."""

    message: npt.NDArray[np.uint8]  # the bytes that it was read from
    # by the path of their field, `wrench.force.x`; a list of numbers is one entry
    numbers: Mapping[str, Numbers]
    texts: Mapping[str, tuple[str, ...]]  # likewise
    # (K,) places of the bytes that say how long texts and lists are, and of the texts
    structure: npt.NDArray[np.intp]

    def holds_for(self, messages: npt.NDArray[np.uint8]) -> Mask:
        """Which of messages (N, length) have this layout, and these texts."""
        same = messages[:, self.structure] == self.message[self.structure]
        return np.asarray(same.all(axis=1))

    def read(self, messages: npt.NDArray[np.uint8], path: str) -> npt.NDArray[Any]:
        """(N, count) numbers of messages that have this layout."""
        place = self.numbers[path]
        end = place.offset + place.count * place.dtype.itemsize
        return np.ascontiguousarray(messages[:, place.offset : end]).view(place.dtype)


@dataclass(slots=True)
class _Walk:
    data: bytes
    definitions: Definitions
    order: str  # of bytes
    start: int  # that alignment counts from
    aligned: bool
    at: int
    numbers: dict[str, Numbers] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)
    structure: list[int] = field(default_factory=list)
    lengths: int = 0  # of texts and lists, that were read

    def message(self, name: str, path: str) -> None:
        for member, (kind, what) in self.definitions[name][1]:
            inner = f"{path}.{member}" if path else member
            if kind == _BASE:
                self.base(what[0], inner, 1)
            elif kind == _NAME:
                self.message(what, inner)
            else:
                (of, item), count = what
                if kind == _SEQUENCE:
                    count = self.length()
                if of == _NAME:
                    for i in range(count):
                        self.message(item, f"{inner}.{i}")
                else:
                    self.base(item[0], inner, count)

    def base(self, name: str, path: str, count: int) -> None:
        if name in ("string", "wstring"):
            found = self.texts.setdefault(path, [])
            for _ in range(count):
                found.append(self.text(name))
            return
        dtype = np.dtype(self.order + _CODES[name])
        if count:
            self.align(dtype.itemsize)
        self.numbers[path] = Numbers(self.at, dtype, count)
        self.skip(count * dtype.itemsize)

    def align(self, size: int) -> None:
        if self.aligned:
            self.at += -(self.at - self.start) % size

    def skip(self, size: int) -> None:
        self.at += size
        if self.at > len(self.data):
            raise ValueError(f"{len(self.data)} bytes, fewer than its type has")

    def length(self) -> int:
        self.lengths += 1
        self.align(4)
        at = self.at
        self.skip(4)
        self.structure.extend(range(at, at + 4))
        return int(struct.unpack_from(f"{self.order}I", self.data, at)[0])

    def text(self, name: str) -> str:
        size = self.length() * (2 if name == "wstring" else 1)
        at = self.at
        self.skip(size)
        self.structure.extend(range(at, at + size))
        if name == "wstring":
            return self.data[at : at + size].decode("utf-16-le" if self.order == "<" else "utf-16-be")
        return self.data[at : at + size].removesuffix(b"\0").decode()


def read_layout(data: bytes, type_name: str, definitions: Definitions, ros1: bool) -> Layout:
    """The layout of one message, in CDR or the serialisation of ROS 1; ValueError if it is none."""
    if ros1:
        walk = _Walk(data, definitions, "<", 0, False, 0)
    else:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise ValueError(f"an encoding {data[:2].hex() or 'of no byte'}, which is not plain CDR")
        walk = _Walk(data, definitions, "<" if data[1] else ">", 4, True, 4, structure=[0, 1])
    walk.message(type_name, "")
    # CDR may be padded to a multiple of 4, and ROS 2 reserves the alignment of the numbers in empty lists
    spare = 0 if ros1 else 3 + 8 * walk.lengths
    if len(data) - walk.at > spare:
        raise ValueError(f"{len(data)} bytes, more than the {walk.at} of its type")
    return Layout(
        message=np.frombuffer(data, np.uint8),
        numbers=walk.numbers,
        texts={path: tuple(texts) for path, texts in walk.texts.items()},
        structure=np.array(walk.structure, dtype=np.intp),
    )


def layouts_of(
    messages: Sequence[bytes], known: list[Layout], type_name: str, definitions: Definitions, ros1: bool
) -> list[tuple[npt.NDArray[np.intp], Layout, npt.NDArray[np.uint8]]]:
    """Messages of one type grouped by layout; new layouts are added to the known ones.

    Per group: the places of its messages in the sequence, their layout, and they themselves (N, length). A
    ValueError says which message is not of this type, and why.
    """
    groups = []
    lengths = np.fromiter(map(len, messages), dtype=np.intp, count=len(messages))
    for length in np.unique(lengths):
        rest = np.flatnonzero(lengths == length)
        block = np.frombuffer(b"".join(messages[i] for i in rest.tolist()), np.uint8).reshape(
            len(rest), int(length)
        )
        candidates = [layout for layout in reversed(known) if len(layout.message) == length]
        while len(rest):
            if candidates:
                layout = candidates.pop(0)
            else:
                try:
                    layout = read_layout(messages[int(rest[0])], type_name, definitions, ros1)
                except (ValueError, KeyError, struct.error, RecursionError) as error:
                    raise ValueError(f"message {rest[0]}: {error}") from error
                known.append(layout)
                del known[:-_KEPT]
            same = layout.holds_for(block)
            if same.any():
                groups.append((rest[same], layout, block[same]))
                rest, block = rest[~same], block[~same]
    return groups
