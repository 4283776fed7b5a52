"""ATI's calibration file (`.cal`), for their C library and for whatever parses `UserAxis` rows.

`Axis` rows have a scale of one and `BasicTransform` moves nothing, so that both kinds of rows are the matrix
itself. The file has no place for an offset: ATI's users take the bias from an unloaded sensor.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

from truewrench.io.exports.words import introduction, numbers
from truewrench.model.calibration import Calibration

_MOST_GAUGES = 8  # MAX_GAUGES of ATI's library
_AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


def unfit(calibration: Calibration) -> str | None:
    """Why a calibration cannot be held."""
    n = calibration.n
    return None if n <= _MOST_GAUGES else f"{n} channels; ATI's library takes at most {_MOST_GAUGES} gauges"


def write(calibration: Calibration, path: Path) -> None:
    """One calibration in N, N-m and m."""
    usable = calibration.verdict.usable
    root = ElementTree.Element(
        "FTSensor",
        Serial="not stated",
        BodyStyle="not stated",
        Family="DAQ",
        NumGages=str(calibration.n),
        CalFileVersion="1.1",
    )
    words = [
        *introduction(calibration),
        "wrench = UserAxis values * (raw - bias)",
        f"bias: {numbers(calibration.offset)}",
    ]
    for line in words:
        root.append(ElementTree.Comment(f" {re.sub('-(?=-)', '- ', line)} "))  # two hyphens would end it
    section = ElementTree.SubElement(
        root,
        "Calibration",
        PartNumber=f"TrueWrench {calibration.version}" if usable else "NOT TO BE USED AS IT STANDS",
        CalDate=calibration.created[:10],
        ForceUnits="N",
        TorqueUnits="N-m",
        DistUnits="m",
    )
    limits = calibration.rig.sensor.range_array
    rows = [
        {"Name": name, "values": numbers(row), "max": f"{limit:.17g}"}
        for name, row, limit in zip(_AXES, calibration.inverse, limits, strict=True)
    ]
    for row in rows:
        ElementTree.SubElement(section, "Axis", {**row, "scale": "1"})
    ElementTree.SubElement(
        section, "BasicTransform", dict.fromkeys(("Dx", "Dy", "Dz", "Rx", "Ry", "Rz"), "0")
    )
    for row in rows:
        ElementTree.SubElement(section, "UserAxis", row)
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
