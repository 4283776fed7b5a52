"""YAML that is read strictly and written exactly, and files that appear whole or not at all.

Reading differs from plain PyYAML where that would misread a setting in silence: `1e-3` is a number
(PyYAML: text), `010` is ten (PyYAML: eight), `1:30` is text (PyYAML: ninety), a date stays text, and
a key given twice is an error.
"""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from truewrench.model.errors import InputError

Locate = Callable[[Sequence[str | int]], int | None]
"""Line (from 1) at which a key path such as ("sensor", "noise", 3) stands, None when it does not."""


# Parsing and emitting in C, where PyYAML was built with it: a covariance of many channels is a long file.
if TYPE_CHECKING:
    from yaml import SafeDumper as _Dumper
    from yaml import SafeLoader as _Loader
else:
    _Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    _Dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _StrictLoader(_Loader):
    """YAML 1.2 numbers; duplicate keys are errors."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: dict[Any, int] = {}
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            line = key_node.start_mark.line + 1
            if not isinstance(key, Hashable):
                raise yaml.constructor.ConstructorError(
                    None, None, "found a list or mapping as a key", key_node.start_mark
                )
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None,
                    None,
                    f"found key `{key}` a second time (first on line {seen[key]})",
                    key_node.start_mark,
                )
            seen[key] = line
        return super().construct_mapping(node, deep=deep)

    def construct_decimal_int(self, node: yaml.ScalarNode) -> int:
        text = str(self.construct_scalar(node))
        return int(text, 0) if text[:2] in ("0x", "0o") else int(text)


_REPLACED_TAGS = frozenset(f"tag:yaml.org,2002:{name}" for name in ("int", "float", "timestamp"))
_StrictLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in _REPLACED_TAGS]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$"), list("-+0123456789")
)
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+.0123456789"),
)
_StrictLoader.add_constructor("tag:yaml.org,2002:int", _StrictLoader.construct_decimal_int)


def read_yaml(path: str | Path) -> tuple[Any, Locate]:
    """Read one YAML document; returned with it is a function that gives the line of a key path in it.

    InputError: the file cannot be read, or is not one YAML document without duplicate keys.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError.at(path, f"byte {error.start}", "a byte that is not UTF-8", "a text file") from error
    loader = _StrictLoader(text)
    try:
        node = loader.get_single_node()
        data = None if node is None else loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = error.problem or error.context or "a fault"
        raise InputError(f"{path}: {place}: {problem}; expected YAML with every key once") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{path}: not readable as YAML: {error}") from error
    finally:
        loader.dispose()
    return data, lambda keys: _line_of(node, keys)


def _line_of(node: yaml.Node | None, keys: Sequence[str | int]) -> int | None:
    line = None
    for key in keys:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and 0 <= key < len(node.value):
            node = node.value[key]
            line = node.start_mark.line + 1
        elif isinstance(node, yaml.MappingNode):
            pairs = [(k, v) for k, v in node.value if str(k.value) == str(key)]
            if not pairs:
                return line
            line, node = pairs[0][0].start_mark.line + 1, pairs[0][1]
        else:
            return line
    return line


class _ExactDumper(_Dumper):
    """Keeps the order of keys, writes a list of scalars on one line and no anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_plain_sequence(self, data: Sequence[Any]) -> yaml.Node:
        flat = not any(isinstance(item, (list, tuple, Mapping, np.ndarray)) for item in data)
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=flat)


# Text that any reader, strict or not, could take for a number is quoted.
_ExactDumper.yaml_implicit_resolvers = {
    first: yaml.SafeLoader.yaml_implicit_resolvers.get(first, [])
    + _StrictLoader.yaml_implicit_resolvers.get(first, [])
    for first in {**yaml.SafeLoader.yaml_implicit_resolvers, **_StrictLoader.yaml_implicit_resolvers}
}
_ExactDumper.add_representer(list, _ExactDumper.represent_plain_sequence)
_ExactDumper.add_representer(tuple, _ExactDumper.represent_plain_sequence)
_ExactDumper.add_multi_representer(
    np.ndarray, lambda dumper, data: dumper.represent_plain_sequence(data.tolist())
)
for _scalar in (np.float64, np.int64, np.bool_):
    _ExactDumper.add_representer(_scalar, lambda dumper, data: dumper.represent_data(data.item()))


def write_yaml(path: str | Path, data: Mapping[str, Any]) -> None:
    """Write a mapping so that reading it back gives the same numbers to the last bit."""
    with atomic_output(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        yaml.dump(data, file, Dumper=_ExactDumper, sort_keys=False, allow_unicode=True, width=10**6)


# what only writing meets: any other OSError of a block may be that of an input it reads
NO_ROOM = frozenset({errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EROFS})


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written: {os.strerror(error.errno) if error.errno else error}")


def is_special(path: Path) -> bool:
    """Whether something stands there that is neither a file nor a folder."""
    return os.path.exists(path) and not (path.is_file() or path.is_dir())


@contextmanager
def atomic_output(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends without an error.

    Until then nothing that stood at `path` is touched; after an error nothing of the attempt is left. A link
    stays one. InputError: it is a folder, lies in none that can be written, or there is no room for it; or a
    device or a pipe, whose place a file would take.
    """
    named, target = Path(path), Path(os.path.realpath(path))
    try:
        if is_special(target):
            raise InputError.at(named, "", "a device or a pipe", "a file to write")
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        created = [folder for folder in (target.parent, *target.parent.parents) if not folder.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    except OSError as error:
        raise _unwritable(named, error) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        try:
            temporary.chmod(0o666 & ~mask)  # mkstemp made it private
            temporary.replace(target)
        except OSError as error:
            raise _unwritable(named, error) from error
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        for folder in created:
            with suppress(OSError):  # something else has been put there meanwhile
                folder.rmdir()
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            raise _unwritable(named, error) from error
        raise
