"""Errors of the package: each says where the fault is, what was found and what was expected."""

from collections.abc import Sequence
from pathlib import Path
from typing import Self


class TruewrenchError(Exception):
    """Base of every error the package raises on purpose."""


class InputError(TruewrenchError):
    """Bad input or settings.

    `str(error)` is a block of text ready to be shown to a person, one line per problem.
    """

    def __init__(self, message: str, *, problems: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.problems: tuple[str, ...] = tuple(problems) or (message,)

    @classmethod
    def at(cls, file: str | Path | None, place: str, found: str, expected: str) -> Self:
        """The usual form: `file: place: found ..., expected ...`."""
        prefix = ": ".join(str(part) for part in (file, place) if part is not None and str(part))
        return cls(f"{prefix}: found {found}, expected {expected}")


def check_word(name: str, value: object, known: Sequence[str]) -> None:
    """Refuse what is none of some words, as callers may pass that types do not hold back."""
    if value not in known:
        raise InputError.at(None, name, repr(value), f"one of {', '.join(known)}")


class UnsupportedError(InputError):
    """The input is valid, but this combination of settings is not supported."""
