"""Files beside calibration.yaml, each read back by the reader that it is meant for.

numpy, ATI's own C library (atiiaftt) and ROS 2's parameter parser (rclpy) are the readers; what nodes compute
that no package index has is computed as their sources publish it.
"""

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import atiiaftt
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from truewrench.cli import main
from truewrench.io.exports import Exports, write_exports
from truewrench.model.calibration import Calibration, Verdict
from truewrench.model.rig import Rig

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
BROADCASTER = "force_torque_sensor_broadcaster"
ALL = {"matrix.txt", "calibration.npz", "calibration.cal", f"{BROADCASTER}.yaml", "ft_calib_data.yaml"}

# What the broadcaster's node finds among its parameters: parsed by rcl, typed as it declares them.
ROS_READER = f"""
import json, sys, rclpy
from rclpy.node import Node
rclpy.init(args=["--ros-args", "--params-file", sys.argv[1], "--disable-rosout-logs"])
node = Node("{BROADCASTER}", enable_rosout=False, start_parameter_services=False)
kinds = ("offset", "multiplier")
names = [f"{{kind}}.{{what}}.{{axis}}" for kind in kinds for what in ("force", "torque") for axis in "xyz"]
print(json.dumps([node.declare_parameter(name, float("nan")).value for name in names]))
"""


def names(paths: Any) -> set[str]:
    return {Path(path).name for path in paths}


def by_axis(values: dict[str, dict[str, float]]) -> NDArray[np.float64]:
    return np.array([values[kind][axis] for kind in ("force", "torque") for axis in "xyz"])


@pytest.fixture
def with_channels(calibration: Calibration, settings: dict[str, Any]) -> Callable[[int], Calibration]:
    """The same for a sensor of n channels."""

    def of(n: int) -> Calibration:
        draw = np.random.default_rng(n)
        gain = draw.normal(size=(n, 6))
        settings["sensor"] |= {
            "channels": [f"g{i}" for i in range(n)], "noise": [0.1] * n, "nominal_gain": gain.tolist(),
        }  # fmt: skip
        return replace(
            calibration, rig=Rig.from_mapping(settings), gain=gain, gain_std=0.01 * np.abs(gain),
            offset=draw.normal(size=n), offset_std=np.full(n, 0.1), inverse=np.linalg.pinv(gain),
            covariance=np.eye(7 * n),
        )  # fmt: skip

    return of


def test_plain_text_is_the_matrix_that_numpy_reads(calibration: Calibration, tmp_path: Path) -> None:
    assert names(write_exports(calibration, tmp_path).written) == ALL
    matrix = np.loadtxt(tmp_path / "matrix.txt")
    assert np.array_equal(matrix, calibration.inverse)
    wrench = np.array([10.0, -20.0, 30.0, 1.0, 2.0, -3.0])
    raw = calibration.gain @ wrench + calibration.offset
    np.testing.assert_allclose(matrix @ (raw - calibration.offset), wrench)
    text = (tmp_path / "matrix.txt").read_text()
    for said in ("N and N m", "payload_on_sensor", "sensor's origin", "matrix @ (raw - offset)", "fx fy fz"):
        assert said in text
    (offset,) = (line for line in text.splitlines() if line.startswith("# offset: "))
    assert [float(x) for x in offset.split()[2:]] == calibration.offset.tolist()


def test_npz_holds_every_number_and_needs_no_pickle(calibration: Calibration, tmp_path: Path) -> None:
    write_exports(calibration, tmp_path)
    with np.load(tmp_path / "calibration.npz", allow_pickle=False) as read:
        for key in ("gain", "gain_std", "offset", "offset_std", "inverse", "covariance"):
            assert np.array_equal(read[key], getattr(calibration, key))
        assert tuple(read["channels"]) == calibration.rig.sensor.channels
        assert tuple(read["axes"]) == AXES
        assert read["usable"]
        assert str(read["feels"]) == "payload_on_sensor"
        assert len(read["reasons"]) == 0


@pytest.mark.parametrize("n", [6, 7, 8])
def test_ati_library_converts_raw_samples_to_the_calibrated_wrench(
    with_channels: Callable[[int], Calibration], n: int, tmp_path: Path
) -> None:
    calibration = with_channels(n)
    write_exports(calibration, tmp_path)
    sensor = atiiaftt.FTSensor(str(tmp_path / "calibration.cal"), 1)
    wrench = np.array([10.0, -20.0, 30.0, 1.0, 2.0, -3.0])
    thermistor = 0.0
    sensor.bias([*calibration.offset, thermistor])
    raw = calibration.gain @ wrench + calibration.offset
    np.testing.assert_allclose(sensor.convertToFt([*raw, thermistor]), wrench, rtol=1e-4)
    np.testing.assert_allclose(list(sensor.calibration.MaxLoads), calibration.rig.sensor.range_array)


def test_user_rows_of_the_cal_file_are_the_matrix(calibration: Calibration, tmp_path: Path) -> None:
    write_exports(calibration, tmp_path)
    root = ElementTree.parse(tmp_path / "calibration.cal").getroot()
    rows = {row.get("Name"): row.get("values", "").split() for row in root.iter("UserAxis")}
    assert list(rows) == ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]
    assert np.array_equal(np.array(list(rows.values()), dtype=float), calibration.inverse)


def test_ros_reads_offsets_and_multipliers_of_the_broadcaster(
    calibration: Calibration, tmp_path: Path
) -> None:
    write_exports(calibration, tmp_path)
    path = tmp_path / f"{BROADCASTER}.yaml"
    result = subprocess.run(
        [sys.executable, "-c", ROS_READER, str(path)],
        env={**os.environ, "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "ROS_LOG_DIR": str(tmp_path)},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    parameters = yaml.safe_load(path.read_text())[BROADCASTER]["ros__parameters"]
    seen = np.array(json.loads(result.stdout.splitlines()[-1])).reshape(2, 6)
    assert np.array_equal(seen, [by_axis(parameters["offset"]), by_axis(parameters["multiplier"])])
    # apply_sensor_offset adds, apply_sensor_multiplier multiplies (ros2_controllers 5.0)
    np.testing.assert_allclose((calibration.offset + seen[0]) * seen[1], 0, atol=1e-12)


def test_loss_of_the_broadcaster_is_that_of_its_own_arithmetic(
    calibration: Calibration, tmp_path: Path
) -> None:
    loss = write_exports(calibration, tmp_path).loss[f"{BROADCASTER}.yaml"]
    file = tmp_path / f"{BROADCASTER}.yaml"
    parameters = yaml.safe_load(file.read_text())[BROADCASTER]["ros__parameters"]
    offset, multiplier = (by_axis(parameters[key]) for key in ("offset", "multiplier"))

    def error(wrench: NDArray[np.float64], factor: NDArray[np.float64] = multiplier) -> NDArray[np.float64]:
        return (wrench @ calibration.gain.T + calibration.offset + offset) * factor - wrench

    scale = calibration.rig.sensor.range_array
    corners = np.array(list(itertools.product([-1.0, 1.0], repeat=6))) * scale
    np.testing.assert_allclose(np.abs(error(corners)).max(axis=0), loss.worst)
    np.testing.assert_allclose(np.abs(error(corners, np.ones(6))).max(axis=0), loss.worst_before)
    loads = np.random.default_rng(1).uniform(-scale, scale, size=(200_000, 6))
    np.testing.assert_allclose(np.sqrt((error(loads) ** 2).mean(axis=0)), loss.rms, rtol=0.01)
    for other in (0.99, 1.01):  # and no other factor does better
        assert (np.sqrt((error(loads, other * multiplier) ** 2).mean(axis=0)) > loss.rms * 0.999).all()
    assert (loss.rms <= loss.rms_before).all()
    (worst,) = (line for line in file.read_text().splitlines() if "at worst within" in line)
    np.testing.assert_allclose([float(x) for x in worst.split(": ")[1].split()], loss.worst, rtol=1e-3)


@pytest.mark.parametrize(("feels", "sign"), [("payload_on_sensor", 1.0), ("sensor_on_payload", -1.0)])
def test_gravity_compensation_takes_bias_and_weight_away(
    calibration: Calibration, settings: dict[str, Any], feels: str, sign: float, tmp_path: Path
) -> None:
    settings["sensor"]["feels"] = feels
    write_exports(replace(calibration, rig=Rig.from_mapping(settings)), tmp_path)
    text = (tmp_path / "ft_calib_data.yaml").read_text()
    read = yaml.safe_load(text)
    payload = calibration.rig.payloads["default"]
    mass, lever = 50.1, payload.center_of_mass_array  # 50.1: what the data say of the mass
    for gravity in ([0, 0, -9.81], [3.0, -4.0, 8.4]):
        weight = mass * np.array(gravity)
        raw = sign * np.concatenate([weight, np.cross(lever, weight)]) + calibration.offset
        imu = -np.array(gravity)
        # gravity_compensation.cpp: Zero, then Compensate; gravity is -imu since May 2021, before it was imu
        force = -sign * imu * read["gripper_mass"]
        gripper = np.concatenate([force, np.cross(read["gripper_com_pose"][:3], force)])
        np.testing.assert_allclose(raw - read["bias"] - gripper, 0, atol=1e-9)
    assert read["gripper_com_pose"][3:] == [0, 0, 0]
    assert read.keys() >= {"gripper_com_frame_id", "gripper_com_child_frame_id"}  # the node wants both
    assert "set bias to zero" in text
    suited = "sources of May 2021 and later, not" if sign > 0 else "of releases up to 1.2.0, not"
    assert suited in text


def test_a_calibration_from_reference_wrenches_knows_no_weight(
    calibration: Calibration, tmp_path: Path
) -> None:
    exports = write_exports(replace(calibration, estimator="reference"), tmp_path)
    assert exports.left_out.keys() == {"ft_calib_data.yaml"}


def test_formats_that_cannot_hold_more_channels_are_left_out(
    with_channels: Callable[[int], Calibration], tmp_path: Path
) -> None:
    exports = write_exports(with_channels(9), tmp_path)
    assert names(exports.written) == {"matrix.txt", "calibration.npz"} == names(tmp_path.iterdir())
    assert exports.left_out.keys() == ALL - names(exports.written)
    assert "at most 8 gauges" in exports.left_out["calibration.cal"]
    assert "six channels" in exports.left_out[f"{BROADCASTER}.yaml"]
    assert np.loadtxt(tmp_path / "matrix.txt").shape == (6, 9)


def test_gauges_that_are_no_wrench_axes_go_into_no_file_of_factors(
    with_channels: Callable[[int], Calibration], tmp_path: Path
) -> None:
    exports = write_exports(with_channels(6), tmp_path)
    assert exports.left_out.keys() == {f"{BROADCASTER}.yaml", "ft_calib_data.yaml"}


def test_a_raw_unit_of_its_own_is_no_obstacle_to_factors_but_to_weights(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path
) -> None:
    nominal = np.diag([100.0, 100, 100, -2000, 2000, 2000])
    settings["sensor"]["nominal_gain"] = nominal.tolist()
    counts = replace(calibration, rig=Rig.from_mapping(settings), gain=nominal @ calibration.gain)
    exports = write_exports(counts, tmp_path / "counts")
    assert exports.left_out.keys() == {"ft_calib_data.yaml"}
    newtons = write_exports(calibration, tmp_path / "newtons")
    name = f"{BROADCASTER}.yaml"
    np.testing.assert_allclose(exports.loss[name].rms, newtons.loss[name].rms)
    np.testing.assert_allclose(exports.loss[name].worst_before, newtons.loss[name].worst_before)


def test_an_axis_that_its_channel_does_not_feel_is_no_factor(
    calibration: Calibration, tmp_path: Path
) -> None:
    swapped = calibration.gain[[1, 0, 2, 3, 4, 5]]
    exports = write_exports(replace(calibration, gain=swapped), tmp_path)
    assert "the channel of fx hardly feels fx" in exports.left_out[f"{BROADCASTER}.yaml"]


def test_no_file_hides_that_a_calibration_is_not_to_be_used(calibration: Calibration, tmp_path: Path) -> None:
    reason = "time runs --> backwards -- on Sundays\nand\x07 more"
    exports = write_exports(replace(calibration, verdict=Verdict(usable=False, reasons=(reason,))), tmp_path)
    assert names(exports.written) == ALL
    for path in exports.written:
        if path.suffix != ".npz":
            text = path.read_text()
            assert "NOT TO BE USED AS IT STANDS" in text
            assert "on Sundays and more" in text
    with np.load(tmp_path / "calibration.npz", allow_pickle=False) as read:
        assert not read["usable"]
        assert read["reasons"].tolist() == [reason]
    # and every reader still reads: what a name or a reason holds ends no comment
    assert np.loadtxt(tmp_path / "matrix.txt").shape == (6, 6)
    assert yaml.safe_load((tmp_path / "ft_calib_data.yaml").read_text()).keys() > {"bias"}
    cal = ElementTree.parse(tmp_path / "calibration.cal").getroot().find("Calibration")
    assert cal is not None
    assert cal.get("PartNumber") == "NOT TO BE USED AS IT STANDS"
    assert atiiaftt.FTSensor(str(tmp_path / "calibration.cal"), 1).calibration.rt.NumAxes == 6


def test_a_gain_without_an_inverse_leaves_numbers_alone(calibration: Calibration, tmp_path: Path) -> None:
    exports = write_exports(replace(calibration, inverse=np.full((6, 6), np.nan)), tmp_path)
    assert names(exports.written) == {"calibration.npz"}
    assert set(exports.left_out.values()) == {"the gain has no inverse"}


def test_no_file_of_an_earlier_calibration_stays_beside_a_new_one(
    calibration: Calibration, tmp_path: Path
) -> None:
    write_exports(calibration, tmp_path)
    write_exports(replace(calibration, inverse=np.full((6, 6), np.nan)), tmp_path)
    assert names(tmp_path.iterdir()) == {"calibration.npz"}


def test_one_export_that_fails_takes_nothing_with_it(calibration: Calibration, tmp_path: Path) -> None:
    (tmp_path / "matrix.txt").mkdir()
    exports: Exports = write_exports(calibration, tmp_path)
    assert names(exports.written) == ALL - {"matrix.txt"}
    assert exports.left_out["matrix.txt"].endswith("matrix.txt: cannot be written: Is a directory")


def test_calibrate_writes_exports_and_says_what_they_lose(
    rig_of: Callable[..., Rig], settings: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from truewrench.simulation.free_body import simulate

    settings["payloads"]["default"]["uncertainty"] = {"mass": 0, "center_of_mass": 0, "inertia": 0}
    settings["sensor"] |= {"time_offset_prior": 0, "noise": [0.05] * 3 + [0.005] * 3}
    settings["plan"] = {"duration": 10}
    rig = rig_of(settings)
    simulate(rig).write(tmp_path / "run.csv")
    (tmp_path / "out" / "matrix.txt").mkdir(parents=True)  # even when one cannot be written
    arguments = [str(rig.path), str(tmp_path / "run.csv"), "-o", str(tmp_path / "out"), "--no-held-out"]

    def status(*options: str) -> Any:
        return main(["calibrate", *arguments, *options])

    assert status("--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert names(document["outputs"]) >= {"calibration.yaml", *ALL} - {"matrix.txt"}
    assert all(Path(path).is_file() for path in document["outputs"])
    loss = document["figures"]["exports"]["loss"][f"{BROADCASTER}.yaml"]
    assert len(loss["worst"]) == len(loss["rms"]) == 6
    assert "matrix.txt" in document["figures"]["exports"]["left_out"]
    assert status() == 0
    words = capsys.readouterr().out
    assert f"{BROADCASTER}.yaml cannot hold the whole gain: within the range it errs by up to" in words
    assert f"No matrix.txt: {tmp_path / 'out' / 'matrix.txt'}: cannot be written: Is a directory." in words
