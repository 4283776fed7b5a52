"""ATI's calibration files, beside the maker's own C library (ATIDAQ F/T, wrapped by atiiaftt)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import atiiaftt
import numpy as np
import pytest
from numpy.typing import NDArray

from truewrench.model.errors import InputError
from truewrench.model.rig import load_rig
from truewrench.model.rig.ati_cal import read_ati_cal

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


def cal_file(
    path: Path,
    *,
    rows: NDArray[np.float64],
    tag: str = "Axis",
    scale: tuple[float, ...] = (1,) * 6,
    units: tuple[str, str, str] = ("N", "N-m", "m"),
    angle: str = "",
    transform: tuple[float, ...] | None = None,
    extra: str = "",
) -> Path:
    lines = "".join(
        f'<{tag} Name="{name}" values=" {" ".join(f"{x:.9g}" for x in row)} " max="{k + 1}" scale="{s}"/>'
        for k, (name, row, s) in enumerate(zip(AXES, rows, scale, strict=True))
    )
    names = ("Dx", "Dy", "Dz", "Rx", "Ry", "Rz")
    moved = " ".join(f'{n}="{x}"' for n, x in zip(names, transform or (), strict=False))
    path.write_text(
        f"""<?xml version="1.0" encoding="utf-8"?>
<!-- ATI does not support parsing of this file. -->
<FTSensor Serial="FT00001" BodyStyle="Gamma" Family="DAQ" NumGages="{rows.shape[1]}" CalFileVersion="1.1">
  <Calibration PartNumber="SI-130-10" CalDate="3/5/2014" ForceUnits="{units[0]}" TorqueUnits="{units[1]}"
    DistUnits="{units[2]}" {f'AngleUnits="{angle}"' if angle else ""} OutputBipolar="True">
    {lines}{f"<BasicTransform {moved}/>" if transform else ""}{extra}
  </Calibration>
</FTSensor>"""
    )
    return path


def library_matrix(path: Path) -> NDArray[np.float64]:
    """The matrix that the maker's library multiplies voltages with, in N and N m."""
    sensor = atiiaftt.FTSensor(str(path), 1)
    sensor.setForceUnits(atiiaftt.FTUnit.FORCE_N)
    sensor.setTorqueUnits(atiiaftt.FTUnit.TORQUE_N_M)
    columns = sensor.calibration.rt.NumChannels - 1
    return np.array([list(row)[:columns] for row in sensor.calibration.rt.working_matrix])


@pytest.mark.parametrize(
    ("units", "angle"),
    [
        (("N", "N-m", "m"), ""),
        (("N", "N-mm", "mm"), "degrees"),
        (("lbf", "in-lb", "in"), "deg"),
        (("kN", "kN-m", "ft"), "rad"),
        (("kg", "kg-cm", "cm"), "radians"),
        (("klb", "ft-lb", "m"), "degree"),
    ],
)
def test_units_scale_and_transform_are_those_of_the_makers_library(
    tmp_path: Path, units: tuple[str, str, str], angle: str
) -> None:
    draw = np.random.default_rng(3)
    path = cal_file(
        tmp_path / "FT.cal",
        rows=draw.normal(size=(6, 6)),
        scale=tuple(draw.uniform(0.5, 40.0, 6)),
        units=units,
        angle=angle,
        transform=(0.3, -0.2, 0.1, 0.4, -0.7, 1.1),
    )
    ours, theirs = read_ati_cal(path).matrix, library_matrix(path)
    assert np.abs(ours - theirs).max() < 2e-6 * np.abs(theirs).max()  # it computes in single precision


def test_eight_gauges_are_read_as_the_makers_library_reads_them(tmp_path: Path) -> None:
    path = cal_file(tmp_path / "FT.cal", rows=np.random.default_rng(4).normal(size=(6, 8)))
    ours = read_ati_cal(path).matrix
    assert ours.shape == (6, 8)
    np.testing.assert_allclose(ours, library_matrix(path), rtol=1e-6)


def test_a_displaced_origin_changes_moments_by_the_lever_times_the_force(tmp_path: Path) -> None:
    path = cal_file(tmp_path / "FT.cal", rows=np.eye(6), transform=(0, 0, 0.012, 0, 0, 0))
    wrench = read_ati_cal(path).matrix @ np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(wrench[3:], -np.cross([0, 0, 0.012], [1.0, 2.0, 3.0]))


def test_user_rows_alone_are_the_matrix_and_rated_loads_come_in_si(tmp_path: Path) -> None:
    rows = np.random.default_rng(5).normal(size=(6, 6))
    path = cal_file(
        tmp_path / "FT.cal",
        rows=rows,
        tag="UserAxis",
        units=("N", "N-mm", "mm"),
        transform=(0, 0, 5, 0, 0, 0),
    )
    read = read_ati_cal(path)
    np.testing.assert_allclose(read.matrix, rows * np.repeat([[1.0], [1e-3]], 3, axis=0), rtol=1e-8)
    np.testing.assert_allclose(read.range, [1, 2, 3, 4e-3, 5e-3, 6e-3])
    assert (read.serial, read.part_number, read.date) == ("FT00001", "SI-130-10", "3/5/2014")


def test_rows_of_both_kinds_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    user = "".join(f'<UserAxis Name="{n}" values="{"1 " * 6}"/>' for n in AXES)
    path = cal_file(tmp_path / "FT.cal", rows=np.eye(6), extra=user)
    with pytest.raises(
        InputError, match=r"FT.cal: UserAxis Fx: found other values, expected the rows `Axis`"
    ):
        read_ati_cal(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('ForceUnits="N"', 'ForceUnits="dyn"', "Calibration: ForceUnits: found `dyn`, expected one of N, kN"),
        ('DistUnits="m"', "", "Calibration: DistUnits: found nothing, expected one of m, cm"),
        ('NumGages="6"', 'NumGages="7"', "Axis Fx: values: found 6, expected 7: one per gauge"),
        ('NumGages="6"', "", "FTSensor: NumGages: found '', expected a finite number"),
        ('Name="Tz"', 'Name="Tx"', "Axis: found 'Fx', 'Fy', 'Fz', 'Tx', 'Ty', 'Tx', expected one row each"),
        ('values=" 1 0', 'values=" one 0', "Axis Fx: values: found 'one', expected a finite number"),
        ('values=" 1 0', 'values=" nan 0', "Axis Fx: values: found 'nan', expected a finite number"),
        ('scale="1"', 'scale="0"', "Axis Fx: scale: found 0, expected a number that is not 0"),
        ('values=" 0 1', 'values=" 1 0', "Calibration: found rows that depend on one another"),
        ('Dz="0"', 'Dz="x"', "BasicTransform: Dz: found 'x', expected a finite number"),
        ("Calibration", "Other", "calibration 1: found 0 in the file, expected one of them"),
        ("FTSensor", "Sensor", "found an element <Sensor>, expected a calibration file of ATI: <FTSensor>"),
        ("</FTSensor>", "", "FT.cal:7: column 17: not readable as XML: no element found"),
    ],
)
def test_a_faulty_file_is_refused_with_place_and_value(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = cal_file(tmp_path / "FT.cal", rows=np.eye(6), transform=(0, 0, 0, 0, 0, 0))
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError) as error:
        read_ati_cal(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)


@pytest.mark.parametrize("encoding", ["klingon", "gb2312"])
def test_an_encoding_that_is_not_read_is_named(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "FT.cal"
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?><FTSensor/>', encoding="utf-8")
    with pytest.raises(InputError, match=r"FT\.cal: found an encoding that cannot be read \(.*XML in UTF-8"):
        read_ati_cal(path)


def test_a_missing_file_and_a_missing_calibration_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"FT.cal: cannot be read"):
        read_ati_cal(tmp_path / "FT.cal")
    path = cal_file(tmp_path / "FT.cal", rows=np.eye(6))
    with pytest.raises(InputError, match="calibration 2: found 1 in the file"):
        read_ati_cal(path, 2)


def test_a_rig_takes_its_nominal_gain_from_the_file(
    tmp_path: Path, settings: dict[str, Any], rig_of: Callable[..., Any]
) -> None:
    matrix = 20.0 * (np.eye(6) + 0.2 * np.random.default_rng(6).normal(size=(6, 6)))
    cal_file(tmp_path / "FT.cal", rows=matrix)
    settings["sensor"]["nominal_gain"] = {"ati_cal": "FT.cal"}
    rig = rig_of(settings)
    np.testing.assert_allclose(matrix @ rig.sensor.nominal_gain_array, np.eye(6), atol=1e-7)
    assert rig.from_mapping(rig.to_mapping()).sensor == rig.sensor  # and does without it from then on


@pytest.mark.parametrize(
    ("gain", "message"),
    [
        ({"ati_cal": "none.cal"}, "none.cal: cannot be read"),
        ({"cal": "FT.cal"}, "unknown key `cal`; nearest known key: `ati_cal`"),
        ({"ati_cal": "FT.cal", "calibration": 2}, "calibration 2: found 1 in the file"),
        ({"ati_cal": 3}, "sensor.nominal_gain.ati_cal: found 3, expected text"),
        ({"ati_cal": "eight.cal"}, "sensor.nominal_gain.ati_cal: found 8 gauges, expected 6"),
    ],
)
def test_a_rig_with_a_faulty_file_is_refused(
    tmp_path: Path, settings: dict[str, Any], gain: dict[str, Any], message: str
) -> None:
    import yaml

    cal_file(tmp_path / "FT.cal", rows=np.eye(6))
    cal_file(tmp_path / "eight.cal", rows=np.eye(6, 8))
    settings["sensor"]["nominal_gain"] = gain
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(settings))
    with pytest.raises(InputError) as error:
        load_rig(tmp_path / "rig.yaml")
    assert message in str(error.value)
