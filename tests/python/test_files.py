"""What is written comes back the same, and a file is there whole or not at all."""

from __future__ import annotations

import math
import os
import stat
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from truewrench.model.errors import InputError
from truewrench.model.files import atomic_output, read_yaml, write_yaml

text = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)
awkward = st.sampled_from(
    ["1e-3", "010", "1:30", "yes", "null", "~", "2026-01-01", "0x1F", ".5", "- a", "a: b"]
)
scalar = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | text | awkward
document = st.dictionaries(
    text | awkward,
    st.recursive(
        scalar, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(text, inner, max_size=4)
    ),
    max_size=5,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(document)
def test_any_mapping_comes_back_the_same_here_and_elsewhere(tmp_path: Path, data: dict[str, Any]) -> None:
    path = tmp_path / "file.yaml"
    write_yaml(path, data)
    assert read_yaml(path)[0] == data
    assert yaml.safe_load(path.read_text(encoding="utf-8")) == data


@pytest.mark.parametrize(
    ("spelt", "value"),
    [
        ("1e-3", 1e-3), ("1E+3", 1e3), ("-2e3", -2e3), (".5", 0.5), ("5.", 5.0), ("-.inf", -math.inf),
        ("+5", 5), ("010", 10), ("0x1F", 31), ("0o17", 15), ("true", True), ("null", None),
        ("1:30", "1:30"), ("1_000", "1_000"), ("2026-01-01", "2026-01-01"), ('"1"', "1"),
    ],
)  # fmt: skip
def test_scalars_are_read_as_a_person_means_them(tmp_path: Path, spelt: str, value: object) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(f"key: {spelt}\n", encoding="utf-8")
    data, _ = read_yaml(path)
    assert data == {"key": value}
    assert type(data["key"]) is type(value)


def test_line_of_a_key_path_is_found(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("a:\n  b:\n    - 1\n    - {c: 2,\n       d: 3}\n", encoding="utf-8")
    _, locate = read_yaml(path)
    places: list[list[str | int]] = [["a"], ["a", "b", 0], ["a", "b", 1, "d"], ["a", "b", 1, "e"]]
    assert [locate(keys) for keys in places] == [1, 3, 5, 4]
    assert locate(["z"]) is None


def test_merged_keys_may_be_given_again(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("base: &base {a: 1, b: 2}\nother: {<<: *base, b: 3}\n", encoding="utf-8")
    assert read_yaml(path)[0]["other"] == {"a": 1, "b": 3}


@pytest.mark.parametrize("content", ["{[1]: 2}", "a: *b", "a: \x01", "a: b: c"])
def test_what_is_no_yaml_is_named(tmp_path: Path, content: str) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=r"file\.yaml: "):
        read_yaml(path)


def test_binary_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_bytes(b"a: \xff\xfe")
    with pytest.raises(InputError, match=r"file\.yaml: byte 3: found a byte that is not UTF-8"):
        read_yaml(path)


def interrupt_writing(path: Path) -> None:
    with atomic_output(path) as temporary:
        temporary.write_text("other", encoding="utf-8")
        raise KeyboardInterrupt


def test_file_appears_only_when_complete(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "out.txt"
    with atomic_output(path) as temporary:
        temporary.write_text("half", encoding="utf-8")
        assert not path.exists()
    assert path.read_text(encoding="utf-8") == "half"
    with pytest.raises(KeyboardInterrupt):
        interrupt_writing(path)
    assert [entry.name for entry in path.parent.iterdir()] == ["out.txt"]
    assert path.read_text(encoding="utf-8") == "half"


def test_what_is_no_file_keeps_its_place(tmp_path: Path) -> None:
    """`-o /dev/null`, as root, put a file where the device had been."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    link = tmp_path / "stdout"
    link.symlink_to(pipe)
    for path in (pipe, link):
        with (
            pytest.raises(InputError, match=r"found a device or a pipe, expected a file"),
            atomic_output(path),
        ):
            pass
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert link.is_symlink()


def test_a_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    link = tmp_path / "out.txt"
    link.symlink_to(Path("data") / "out.txt")
    with atomic_output(link) as temporary:
        temporary.write_text("new", encoding="utf-8")
    assert link.is_symlink()
    assert (tmp_path / "data" / "out.txt").read_text(encoding="utf-8") == "new"


def test_file_has_the_permissions_that_the_user_wants(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with atomic_output(tmp_path / "out.txt"):
            pass
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "out.txt").stat().st_mode) == 0o640


def test_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with (
        pytest.raises(InputError, match=r"file/out\.txt: cannot be written: "),
        atomic_output(tmp_path / "file" / "out.txt"),
    ):
        pass


def test_a_row_of_numbers_stands_on_one_line(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    write_yaml(path, {"rows": [[1.0, 2.5], [3.0, 1e-9]], "names": ("a", "b")})
    assert path.read_text(encoding="utf-8") == "rows:\n- [1.0, 2.5]\n- [3.0, 1.0e-09]\nnames: [a, b]\n"
