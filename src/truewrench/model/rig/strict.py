"""Field types of the settings, and error messages that say where, what was found and what was expected."""

import difflib
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    StringConstraints,
    Tag,
    ValidationError,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from truewrench.model.errors import InputError
from truewrench.model.files import Locate


class Section(BaseModel):
    """One mapping of a settings file: immutable, and no key that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)


def refuse(key: str, found: str, expected: str) -> PydanticCustomError:
    """The error of one key (`noise`, `channels.2`) of a section, for validators that look at several keys."""
    return PydanticCustomError("refused", "{expected}", {"key": key, "found": found, "expected": expected})


def is_finite(value: object) -> bool:
    """Whether a value is a number that a double holds; an integer may be of any size, NaN is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max


def printable(text: str) -> str:
    """Text with whatever would move a terminal or break a line shown escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shown(value: object) -> str:
    """A value as a person wrote it, cut where it is long."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "nothing"
    if isinstance(value, str):
        text = f"the text {value!r}"
    elif isinstance(value, Mapping):
        keys = [str(key) if str(key).isprintable() else repr(key) for key in value]
        text = f"a mapping with {', '.join(keys) or 'no key'}"
    elif isinstance(value, float) and not math.isfinite(value):
        text = {"nan": "NaN"}.get(str(value), str(value))
    else:
        text = str(list(value)) if isinstance(value, tuple) else str(value)
    return text if len(text) <= 80 else text[:77] + "..."


_Sized = TypeVar("_Sized", bound=Sequence[Any])


def of_length(n: int, what: str) -> Callable[[_Sized], _Sized]:
    """A validator that wants `n` entries; `what` names them."""

    def check(value: _Sized) -> _Sized:
        if len(value) != n:
            entries = "1 entry" if len(value) == 1 else f"{len(value)} entries"
            raise PydanticCustomError("length", "{expected}", {"found": entries, "expected": f"{n}: {what}"})
        return value

    return check


def word_or_number(
    word: str, number: str, least: float = -math.inf, most: float = math.inf
) -> BeforeValidator:
    """A validator that wants one word, or a finite number from `least` to `most`; `number` says so."""

    def check(value: Any) -> Any:
        if value != word and not (is_finite(value) and least <= value <= most):
            raise refuse("", shown(value), f"`{word}` or {number}")
        return value

    return BeforeValidator(check)


def _for_all_or_each(value: Any) -> Any:
    def positive(x: Any) -> bool:
        return is_finite(x) and x > 0

    if isinstance(value, list | tuple):
        asked = [x for x in value if x is not None]
        if len(value) == 6 and asked and all(positive(x) for x in asked):
            return tuple(None if x is None else float(x) for x in value)
    elif positive(value):
        return float(value)
    expected = "a number greater than 0, or six, one per wrench axis, null where an axis is not asked for"
    raise refuse("", shown(value), expected)


def _of_a_size(value: float) -> float:
    if not 1e-30 <= value <= 1e30:
        raise refuse("", shown(value), "a number of 1e-30 to 1e+30")
    return value


Number = Annotated[float, Strict(), AllowInfNan(False)]
Positive = Annotated[Number, Field(gt=0)]
Fraction = Annotated[Number, Field(gt=0, le=1)]
Rate = Annotated[Number, Field(gt=0, le=1e6)]  # [Hz]: stamps are whole nanoseconds
Duration = Annotated[Number, Field(ge=1e-3, le=1e6)]  # [s]
NonNegative = Annotated[Number, Field(ge=0)]
Switch = Annotated[bool, Strict()]
Text = Annotated[str, Strict(), StringConstraints(min_length=1)]
WholeNumber = Annotated[int, Strict(), Field(ge=0)]
PositiveInteger = Annotated[int, Strict(), Field(ge=1)]
Numbers = tuple[Number, ...]
Positives = tuple[Positive, ...]
NonNegatives = tuple[NonNegative, ...]
ThreeNumbers = Annotated[Numbers, AfterValidator(of_length(3, "x, y, z"))]
SixNumbers = Annotated[Numbers, AfterValidator(of_length(6, "one per axis"))]
# whose ratios and squares are numbers, too
Counted = Annotated[Positive, AfterValidator(_of_a_size)]
CountedEach = tuple[Counted, ...]
Uncertainty = Annotated[NonNegative, Field(le=1e30)]
SixPositives = Annotated[tuple[Counted, ...], AfterValidator(of_length(6, "one per axis"))]
ForAllOrEach = Annotated[float | tuple[float | None, ...], BeforeValidator(_for_all_or_each)]
Matrix = tuple[SixNumbers, ...]


def _choice(value: Any) -> str | None:
    if isinstance(value, bool):
        return "<switch>"
    if isinstance(value, (int, float)):
        return "<zero>" if value == 0 else None
    if isinstance(value, (Mapping, BaseModel)):  # read, and about to be written
        return "<mapping>"
    return "<word>" if isinstance(value, str) else "<list>"


def choice(expected: str) -> Discriminator:
    """Tells apart the fields that hold a `Word`, a `Zero`, a `Listed`, a `Mapped` or a `Switched` value."""
    return Discriminator(_choice, custom_error_type="choice", custom_error_message=expected)


Word, Zero, Listed, Mapped = Tag("<word>"), Tag("<zero>"), Tag("<list>"), Tag("<mapping>")
Switched = Tag("<switch>")
_TAGS = (
    *("<word>", "<zero>", "<list>", "<mapping>", "<switch>"),
    *("[key]", "<body>", "<urdf>", "<franka>", "<ur>"),
)


def input_error(
    error: ValidationError, model: type[BaseModel], path: str | Path | None, locate: Locate | None = None
) -> InputError:
    """Every problem that pydantic found, one line each, in the words of the settings file."""
    found = error.errors(include_url=False)
    problems = [printable(_problem(details, model, path, locate)) for details in found]
    return InputError("\n".join(problems), problems=problems)


_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "string_type": "text",
    "string_too_short": "text that is not empty",
    "tuple_type": "a list",
    "too_short": "one entry at least",
    "invalid_key": "text as a key",
    "dict_type": "a mapping",
    "model_type": "a mapping",
}


def _problem(
    details: ErrorDetails, model: type[BaseModel], path: str | Path | None, locate: Locate | None
) -> str:
    keys = [key for key in details["loc"] if key not in _TAGS]
    context: dict[str, Any] = details.get("ctx", {})
    kind = details["type"]
    if kind == "refused":
        keys += [int(part) if part.isdigit() else part for part in context["key"].split(".") if part]
    place = key_path(keys)
    line = locate(keys) if locate else None
    file = "" if path is None else f"{path}:{line}" if line else f"{path}"
    where = ": ".join(part for part in (file, place) if part)
    if kind == "missing":
        without = ", which only `reference_noise` makes up for (logs with ref_*)"
        choices = _choices(model, details["loc"])
        expected = f", expected {' or '.join(f'`{word}`' for word in choices)}" if choices else ""
        return f"{where}: missing required key{without if place in ('motion', 'payloads') else expected}"
    if kind == "extra_forbidden":
        known = list(_fields_at(model, details["loc"][:-1]))
        near = difflib.get_close_matches(str(keys[-1]), known, n=1, cutoff=0.0)[0]
        return f"{where}: unknown key `{keys[-1]}`; nearest known key: `{near}`"
    if kind in ("refused", "length"):
        return f"{where}: found {context['found']}, expected {context['expected']}"
    return f"{where}: found {shown(details['input'])}, expected {_expectation(kind, context, details['msg'])}"


def _expectation(kind: str, context: Mapping[str, Any], message: str) -> str:
    if kind == "greater_than":
        return f"a number greater than {context['gt']:g}"
    if kind == "greater_than_equal":
        return f"a number of at least {context['ge']:g}"
    if kind == "less_than_equal":
        return f"a number of at most {context['le']:g}"
    if kind == "literal_error":
        return str(context["expected"]).replace("'", "`")
    return _EXPECTED.get(kind, message)


def key_path(keys: Sequence[int | str]) -> str:
    """`sensor.noise[3]` from ("sensor", "noise", 3)."""
    text = ""
    for key in keys:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else str(key)
    return printable(text)


def _fields_at(model: type[BaseModel], keys: Sequence[int | str]) -> Iterator[str]:
    """The keys that the section at a key path knows."""
    here = _section_at(model, keys)
    if isinstance(here, type) and issubclass(here, BaseModel):
        yield from (field.alias or name for name, field in here.model_fields.items())


def _choices(model: type[BaseModel], keys: Sequence[int | str]) -> tuple[str, ...]:
    """The words that the key at a path may have; none where it takes other values."""
    here = _section_at(model, keys[:-1])
    if not (isinstance(here, type) and issubclass(here, BaseModel)):
        return ()
    field = here.model_fields.get(str(keys[-1]))
    kind = None if field is None else field.annotation
    return get_args(kind) if get_origin(kind) is Literal else ()


def _section_at(model: type[BaseModel], keys: Sequence[int | str]) -> Any:
    here: Any = model
    for key in keys:
        if isinstance(here, type) and issubclass(here, BaseModel):
            here = here.model_fields[str(key)].annotation
        elif key in _TAGS:
            here = next(option for option in get_args(here) if Tag(str(key)) in get_args(option))
        else:  # dict[str, Section]
            here = get_args(here)[-1]
        if get_origin(here) is Annotated:
            here = get_args(here)[0]
        if get_origin(here) in (Union, UnionType):
            options = [option for option in get_args(here) if option is not type(None)]
            here = options[0] if len(options) == 1 else here
    return here
