"""JSON lines with the columns of a log, read strictly: an object a line, every number finite."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from truewrench.io.joints import BASE_ATTITUDE, BASE_TWIST
from truewrench.io.table import ACCELERATION, ATTITUDE, GRAVITY, REFERENCE, SPECIFIC_FORCE, TWIST
from truewrench.live.lines import LONGEST
from truewrench.model.rig.strict import shown

_COLUMNS = frozenset(
    [*TWIST, *GRAVITY, *ATTITUDE, *ACCELERATION, *SPECIFIC_FORCE, *REFERENCE]
    + [*BASE_TWIST, *BASE_ATTITUDE, "temperature"]
)
_JOINT = re.compile(r"d?q_.+")
_LARGEST_SECONDS = 9e9  # int64 nanoseconds end at 9.22e9 s


class LineError(Exception):
    """What is wrong with a line; its text is for a person."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line."""

    time_ns: int  # its time [ns]
    stamp: tuple[str, int | float]  # key and value of the time as the line has them
    raw: tuple[float, ...] | None  # n channels, NaN for null; None in a line without any channel
    data: dict[str, Any]  # all that the line says


def read_row(line: bytes, n: int) -> Row:
    """One line as a row of a log with n channels; LineError if it is none."""
    data = _object(line)
    time_ns, stamp = _time(data)
    return Row(time_ns, stamp, _raw(data, n), data)


def stamp_of(line: bytes) -> dict[str, int | float]:
    """The time that a line tells, however wrong it is otherwise, under its key; else nothing."""
    try:
        data = json.loads(line.decode("utf-8-sig"))  # NaN and keys twice, too
        key, value = _time(data)[1]
    except (LineError, ValueError, TypeError, RecursionError):
        return {}
    return {key: value}


def motion_of(row: Row) -> dict[str, float]:
    """The columns of a row that a log has besides time and channels; NaN for null, unknown ones left out.

    LineError: one of them holds no number.
    """
    return {
        key: _number(key, value) for key, value in row.data.items() if key in _COLUMNS or _JOINT.match(key)
    }


def temperature_of(row: Row) -> float:
    """The temperature that a row tells [degC]; NaN where it tells none, LineError if it is no number."""
    return _number("temperature", row.data["temperature"]) if "temperature" in row.data else math.nan


def tare_of(line: bytes) -> bool:
    """Whether a line asks for a tare, `{"tare": true}`; LineError if it says something else of one."""
    if b'"tare"' not in line:  # most lines: not worth a second look
        return False
    data = _object(line)
    if "tare" not in data:
        return False
    if data != {"tare": True}:
        raise LineError(f'found {shown(data)}, expected {{"tare": true}} alone')
    return True


def _object(line: bytes) -> dict[str, Any]:
    if len(line) > LONGEST:
        raise LineError(f"found more than {LONGEST} bytes, expected one object a line")
    try:
        data = _DECODER.decode(line.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise LineError("found bytes that are not UTF-8, expected a JSON object") from None
    except json.JSONDecodeError as error:
        raise LineError(f"not JSON: {error.msg} at column {error.colno}") from None
    except (RecursionError, ValueError) as error:
        raise LineError(f"not JSON: {error}") from None
    if not isinstance(data, dict):
        raise LineError(f"found {shown(data)}, expected a JSON object")
    return data


def _refuse(constant: str) -> NoReturn:
    raise LineError(f"found {constant}, expected finite numbers, or null where there is no sample")


def _unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for k, key in enumerate(keys) if key in keys[:k])
        raise LineError(f"`{twice}`: found a second time, expected every key once")
    return data


_DECODER = json.JSONDecoder(parse_constant=_refuse, object_pairs_hook=_unique)


def _number(key: str, value: Any) -> float:
    if value is None:
        return math.nan
    if type(value) is float or type(value) is int:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
    raise LineError(f"`{key}`: found {shown(value)}, expected a finite number, or null where there is none")


def _time(data: dict[str, Any]) -> tuple[int, tuple[str, int | float]]:
    if "time_ns" in data:
        value = data["time_ns"]
        if type(value) is float and value.is_integer() and abs(value) <= 2.0**53:
            value = int(value)
        if type(value) is not int or abs(value) >= 2**63:
            expected = "whole nanoseconds that a 64-bit integer holds"
            raise LineError(f"`time_ns`: found {shown(data['time_ns'])}, expected {expected}")
        return value, ("time_ns", value)
    if "time_s" in data:
        seconds = _number("time_s", data["time_s"])
        if not abs(seconds) <= _LARGEST_SECONDS:
            expected = "seconds, at most 9e9 in size"
            raise LineError(f"`time_s`: found {shown(data['time_s'])}, expected {expected}")
        whole = math.floor(seconds)
        return whole * 1_000_000_000 + round((seconds - whole) * 1e9), ("time_s", data["time_s"])
    raise LineError("found no time, expected `time_ns` or `time_s`")


def _raw(data: dict[str, Any], n: int) -> tuple[float, ...] | None:
    names = [key for key in data if key.startswith("raw_") and key[4:].isdecimal()]
    if "raw" in data:
        values = data["raw"]
        if names:
            raise LineError(f"found `raw` and `{names[0]}`, expected one of the two")
        if not isinstance(values, list) or len(values) != n:
            found = f"{len(values)} entries" if isinstance(values, list) else shown(values)
            raise LineError(f"`raw`: found {found}, expected an array of {n}: one per channel")
        return tuple([_number(f"raw[{i}]", value) for i, value in enumerate(values)])
    if not names:
        return None
    expected = [f"raw_{i}" for i in range(n)]
    for name in expected:
        if name not in data:
            raise LineError(f"found no `{name}`, expected all channels, raw_0 to raw_{n - 1}")
    if len(names) > n:
        extra = next(name for name in names if name not in expected)
        raise LineError(f"`{extra}`: one raw channel too many, expected raw_0 to raw_{n - 1}")
    return tuple([_number(name, data[name]) for name in expected])
