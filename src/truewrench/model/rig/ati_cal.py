"""ATI's calibration files (`.cal`), read as the maker's own C library reads them (ATIDAQ F/T, `ftconfig.c`).

An `Axis` row over its `scale` gives a wrench component at the transducer's own origin per unit of every
gauge; `BasicTransform` moves it to the origin that the user sees, where `UserAxis` rows already are.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers.expat import ErrorString

import numpy as np
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError

_AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
_AGREES = (
    1e-2  # of a row's largest entry: `UserAxis` rows have few digits, another calibration is further off
)

_POUND, _INCH, _KILOPOND = 4.4482216152605, 0.0254, 9.80665


def _units(values: Mapping[str, float]) -> dict[str, float]:
    return {name: value for names, value in values.items() for name in names.split()}


_FORCE = _units(
    {
        "N": 1.0,
        "kN": 1e3,
        "lb lbf": _POUND,
        "klb klbf": 1e3 * _POUND,
        "kg": _KILOPOND,
        "g": 1e-3 * _KILOPOND,
    }
)
_TORQUE = _units(
    {
        "N-m Nm": 1.0,
        "N-mm Nmm": 1e-3,
        "kN-m kNm": 1e3,
        "in-lb in-lbf lb-in lbf-in": _POUND * _INCH,
        "ft-lb ft-lbf lb-ft lbf-ft": _POUND * 12 * _INCH,
        "kg-cm kgcm": 1e-2 * _KILOPOND,
    }
)
_DISTANCE = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": _INCH, "ft": 12 * _INCH}
_ANGLE = _units({"deg degree degrees": math.radians(1.0), "rad radian radians": 1.0})


@dataclass(frozen=True, slots=True, eq=False)
class AtiCalibration:
    """One calibration of a `.cal` file, in SI units.

    Attributes:
        matrix: (6, n) wrench = matrix @ (gauges - bias) [N, N m per unit of the gauges], at the origin that
            the user sees.
        range: (6,) rated loads [N, N m], 0 where the file states none.
        serial: of the transducer.
        part_number: of the calibration.
        date: of the calibration, as it is written.
    """

    matrix: Array
    range: Array
    serial: str
    part_number: str
    date: str

    @property
    def gain(self) -> Array:
        """(n, 6) raw = gain @ wrench + bias; of a transducer with six gauges."""
        gain: Array = np.linalg.inv(self.matrix).astype(np.float64)
        return gain


def read_ati_cal(path: str | Path, index: int = 1) -> AtiCalibration:
    """Read one calibration of an ATI `.cal` file.

    Args:
        path: the file.
        index: which of its calibrations, from 1.

    Raises:
        InputError: naming file, place, what was found and what was expected.
    """
    sensor = _root(path)
    calibrations = sensor.findall("Calibration")
    if not 1 <= index <= len(calibrations):
        raise InputError.at(path, f"calibration {index}", f"{len(calibrations)} in the file", "one of them")
    gauges = _number(path, sensor, "NumGages", "FTSensor: ")
    if gauges not in range(6, 33):
        raise InputError.at(path, "FTSensor: NumGages", f"{gauges:g}", "6 or more gauges")
    return _calibration(path, sensor.get("Serial", ""), calibrations[index - 1], int(gauges))


def _calibration(
    path: str | Path, serial: str, calibration: ElementTree.Element, gauges: int
) -> AtiCalibration:
    units = np.repeat(
        [_unit(path, calibration, "ForceUnits", _FORCE), _unit(path, calibration, "TorqueUnits", _TORQUE)], 3
    )
    basic, basic_range = _rows(path, calibration, "Axis", gauges)
    user, user_range = _rows(path, calibration, "UserAxis", gauges)
    if basic is None and user is None:
        raise InputError.at(path, "Calibration", "no row", f"`Axis` or `UserAxis` for {', '.join(_AXES)}")
    if basic is not None:
        # the maker's library takes these, too: they have more digits
        matrix = _transform(path, calibration) @ (units[:, None] * basic)
        if user is not None:
            apart = np.abs(matrix - units[:, None] * user).max(axis=1) > _AGREES * np.abs(matrix).max(axis=1)
            if apart.any():
                name = _AXES[int(np.argmax(apart))]
                expected = "the rows `Axis` over `scale`, moved by `BasicTransform`"
                raise InputError.at(path, f"UserAxis {name}", "other values", expected)
    else:
        assert user is not None
        matrix = units[:, None] * user
    if np.linalg.matrix_rank(matrix / np.abs(matrix).max(axis=1, keepdims=True).clip(1e-300)) < 6:
        raise InputError.at(path, "Calibration", "rows that depend on one another", "rows of rank 6")
    return AtiCalibration(
        matrix=matrix,
        range=units * (user_range if basic is None else basic_range),
        serial=serial,
        part_number=calibration.get("PartNumber", ""),
        date=calibration.get("CalDate", ""),
    )


def _root(path: str | Path) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(Path(path).read_bytes().rstrip(b"\0\r\n\t "))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ElementTree.ParseError as error:
        line, column = error.position
        why = ErrorString(error.code)
        raise InputError(f"{path}:{line}: column {column + 1}: not readable as XML: {why}") from error
    except (LookupError, ValueError) as error:
        raise InputError.at(path, "", f"an encoding that cannot be read ({error})", "XML in UTF-8") from error
    if root.tag != "FTSensor":
        raise InputError.at(path, "", f"an element <{root.tag}>", "a calibration file of ATI: <FTSensor>")
    return root


def _rows(
    path: str | Path, calibration: ElementTree.Element, tag: str, gauges: int
) -> tuple[Array | None, Array]:
    """The six rows of a kind (6, n) in the file's units, None where there are none, and the rated loads."""
    elements = {element.get("Name", ""): element for element in calibration.findall(tag)}
    if not elements:
        return None, np.zeros(6)
    if sorted(elements) != sorted(_AXES) or len(calibration.findall(tag)) != 6:
        found = ", ".join(repr(element.get("Name")) for element in calibration.findall(tag))
        raise InputError.at(path, tag, found, f"one row each for {', '.join(_AXES)}")
    matrix, loads = np.empty((6, gauges)), np.empty(6)
    for i, name in enumerate(_AXES):
        place = f"{tag} {name}: "
        values = [_float(path, text, f"{place}values") for text in elements[name].get("values", "").split()]
        if len(values) != gauges:
            raise InputError.at(path, f"{place}values", f"{len(values)}", f"{gauges}: one per gauge")
        scale = _number(path, elements[name], "scale", place, 1.0)
        if scale == 0.0:
            raise InputError.at(path, f"{place}scale", "0", "a number that is not 0")
        matrix[i] = np.array(values) / scale
        loads[i] = _number(path, elements[name], "max", place, 0.0)
    return matrix, loads


def _transform(path: str | Path, calibration: ElementTree.Element) -> Array:
    """(6, 6) of `BasicTransform`: to an origin displaced by D, then along axes turned by Rx, Ry, Rz."""
    element = calibration.find("BasicTransform")
    if element is None:
        return np.eye(6)
    distance = _unit(path, calibration, "DistUnits", _DISTANCE)
    angle = _unit(path, calibration, "AngleUnits", _ANGLE, "degrees")
    place = "BasicTransform: "
    dx, dy, dz = (distance * _number(path, element, name, place, 0.0) for name in ("Dx", "Dy", "Dz"))
    turns = [angle * _number(path, element, name, place, 0.0) for name in ("Rx", "Ry", "Rz")]
    R = Rotation.from_euler("XYZ", turns).as_matrix().T
    lever = np.array([[0, -dz, dy], [dz, 0, -dx], [-dy, dx, 0]])
    return np.block([[R, np.zeros((3, 3))], [-R @ lever, R]])


def _unit(
    path: str | Path,
    calibration: ElementTree.Element,
    key: str,
    known: Mapping[str, float],
    default: str | None = None,
) -> float:
    name = calibration.get(key) or default
    if name is None or name not in known:
        found = "nothing" if name is None else f"`{name}`"
        raise InputError.at(path, f"Calibration: {key}", found, f"one of {', '.join(known)}")
    return known[name]


def _number(
    path: str | Path, element: ElementTree.Element, key: str, place: str, default: float | None = None
) -> float:
    text = element.get(key)
    if not text and default is not None:
        return default
    return _float(path, text or "", f"{place}{key}")


def _float(path: str | Path, text: str, place: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError.at(path, place, f"{text!r}", "a finite number")
    return value
