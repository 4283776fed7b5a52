"""Typed access to the keys of a file that the package wrote, with errors that name the place."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.files import Locate, read_yaml
from truewrench.model.rig.strict import is_finite, key_path, shown


class Fields:
    """One mapping of a file, and where in the file it stands.

    Every accessor raises InputError naming file, line, key, what was found and what was expected.
    """

    def __init__(
        self, data: Any, path: str | Path, locate: Locate, place: tuple[str | int, ...] = ()
    ) -> None:
        self.path = path
        self._locate = locate
        self._place = place
        if not isinstance(data, dict):
            raise self._error(place, "a mapping", shown(data))
        self.data: dict[str, Any] = data

    @classmethod
    def of_file(cls, path: str | Path, form: str | None = None) -> Fields:
        """All of a file, whose key `format` says the form where there is one."""
        data, locate = read_yaml(path)
        top = cls(data, path, locate)
        if form is not None and top.data.get("format") != form:
            raise top.error("format", f"`{form}`")
        return top

    def error(self, key: str, expected: str, found: str | None = None) -> InputError:
        """The error of one key of this mapping."""
        return self._error((*self._place, key), expected, found or shown(self.data.get(key)))

    def _error(self, place: Sequence[str | int], expected: str, found: str) -> InputError:
        line = self._locate(place)
        return InputError.at(f"{self.path}:{line}" if line else self.path, key_path(place), found, expected)

    def get(self, key: str) -> Any:
        """The value of a required key."""
        if key not in self.data:
            raise self.error(key, "this key", "nothing")
        return self.data[key]

    def section(self, key: str) -> Fields:
        """A mapping."""
        return Fields(self.get(key), self.path, self._locate, (*self._place, key))

    def sections(self, key: str) -> list[Fields]:
        """A list of mappings."""
        return [
            Fields(item, self.path, self._locate, (*self._place, key, i))
            for i, item in enumerate(self._list(key))
        ]

    def _list(self, key: str) -> list[Any]:
        value = self.get(key)
        if not isinstance(value, list):
            raise self.error(key, "a list")
        return value

    def text(self, key: str) -> str:
        """Text."""
        value = self.get(key)
        if not isinstance(value, str):
            raise self.error(key, "text")
        return value

    def texts(self, key: str) -> list[str]:
        """A list of texts."""
        for i, item in enumerate(self._list(key)):
            if not isinstance(item, str):
                raise self._error((*self._place, key, i), "text", shown(item))
        return self._list(key)

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self.get(key)
        if not isinstance(value, bool):
            raise self.error(key, "true or false")
        return value

    def count(self, key: str) -> int:
        """A whole number of at least 0."""
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self.error(key, "a whole number of at least 0")
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        return float(self.array(key, ()))

    def whole(self, key: str) -> int:
        """A whole number that 64 bits hold."""
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**63:
            raise self.error(key, "a whole number of 64 bits")
        return value

    def positive(self, key: str) -> float:
        """A number greater than 0."""
        value = self.number(key)
        if value <= 0.0:
            raise self.error(key, "a number greater than 0")
        return value

    def size(self, key: str) -> float:
        """A number of at least 0."""
        value = self.number(key)
        if value < 0.0:
            raise self.error(key, "a number of at least 0")
        return value

    def sizes(self, key: str, count: int) -> Array:
        """As many numbers of at least 0."""
        values = self.array(key, (count,))
        if (values < 0.0).any():
            raise self.error(key, "numbers of at least 0", f"{values.min():g}")
        return values

    def covariance(self, key: str, size: int) -> Array:
        """A symmetric matrix (size, size) without a negative eigenvalue, both as correlations."""
        covariance = self.array(key, (size, size))
        scale = np.sqrt(np.abs(np.diag(covariance)))
        correlation = covariance / np.outer(scale, scale).clip(min=np.finfo(np.float64).tiny)
        if np.abs(correlation - correlation.T).max() > 1e-9:
            raise self.error(key, "a symmetric matrix", "a matrix that is not symmetric")
        smallest = float(np.linalg.eigvalsh(correlation).min())
        if smallest < -1e-9:
            found = f"a correlation of eigenvalue {smallest:.3g}"
            raise self.error(key, "a positive semidefinite matrix", found)
        return covariance

    def array(self, key: str, shape: tuple[int, ...], *, nan_allowed: bool = False) -> Array:
        """Finite numbers, and NaN where it is allowed, in nested lists of the given shape."""
        place = (*self._place, key)
        self._check(self.get(key), place, shape, nan_allowed)
        return np.array(self.data[key], dtype=np.float64)

    def _check(
        self, value: Any, place: tuple[str | int, ...], shape: tuple[int, ...], nan_allowed: bool
    ) -> None:
        if not shape:
            absent = nan_allowed and isinstance(value, float) and np.isnan(value)
            if not is_finite(value) and not absent:
                raise self._error(place, "a finite number", shown(value))
            return
        if not isinstance(value, list) or len(value) != shape[0]:
            found = f"{len(value)} entries" if isinstance(value, list) else shown(value)
            raise self._error(place, f"a list of {shape[0]}", found)
        for i, item in enumerate(value):
            self._check(item, (*place, i), shape[1:], nan_allowed)
