"""A recording is read like the table of the same samples, and what it leaves open is asked for."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bags import KINDS, MS, START, Bag, record, still, with_recording, write

from truewrench.calibrating.pipeline import calibrate
from truewrench.io.tables import read_log, write_table
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

Array = np.ndarray[Any, np.dtype[np.float64]]
Columns = dict[str, np.ndarray[Any, Any]]

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


@pytest.fixture(scope="module")
def run(valid_settings: dict[str, Any]) -> tuple[Rig, Columns]:
    """A simulated log whose sensor and motion have rates and stamps of their own."""
    settings = {**valid_settings, "simulate": {"rate": 60, "sensor_rate": 100}, "required": 10.0}
    settings["plan"] = {"duration": 4}
    rig = Rig.from_mapping(settings)
    log = simulate(rig, seed=3).log
    assert log.twist is not None
    columns: Columns = {"time_ns": log.time_ns + START}
    columns |= {f"raw_{i}": log.raw[:, i] for i in range(6)}
    columns |= {name: log.twist[:, i] for i, name in enumerate(TWIST)}
    return rig, columns


@pytest.fixture(scope="module")
def gain(run: tuple[Rig, Columns], tmp_path_factory: pytest.TempPathFactory) -> Array:
    """What the table calibrates to."""
    path = tmp_path_factory.mktemp("table") / "run.csv"
    write_table(path, run[1])
    return calibrate(run[0], read_log(path, run[0]), held_out=False).gain


@pytest.mark.parametrize("kind", ["parquet", *KINDS])
def test_every_format_gives_the_gain_of_the_table(
    run: tuple[Rig, Columns], gain: Array, tmp_path: Path, kind: str
) -> None:
    rig, columns = run
    path = tmp_path / "run.parquet"
    if kind == "parquet":
        write_table(path, columns)
    else:
        path = record(tmp_path / "run", kind, columns)
    log = read_log(path, rig)
    np.testing.assert_array_equal(log.time_ns, columns["time_ns"])
    assert log.notes == ()
    np.testing.assert_allclose(calibrate(rig, log, held_out=False).gain, gain, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("kind", "name"), [("mcap", "run.mcap"), ("sqlite3", "run.db3")])
def test_file_of_a_folder_reads_like_the_folder(
    run: tuple[Rig, Columns], tmp_path: Path, kind: str, name: str
) -> None:
    rig, columns = run
    folder = record(tmp_path / "run", kind, columns)
    bare, whole = read_log(folder / name, rig), read_log(folder, rig)
    np.testing.assert_array_equal(bare.raw, whole.raw)
    np.testing.assert_array_equal(bare.time_ns, whole.time_ns)
    assert bare.sha256 == hashlib.sha256((folder / name).read_bytes()).hexdigest()


@pytest.mark.skipif(shutil.which("sha256sum") is None, reason="asks sha256sum as the independent witness")
def test_sha256_of_a_folder_is_that_of_its_list(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "mcap", run[1])
    lines = subprocess.run("LC_ALL=C sha256sum *", shell=True, cwd=folder, capture_output=True, check=True)
    assert read_log(folder, run[0]).sha256 == hashlib.sha256(lines.stdout).hexdigest()


def test_recording_split_over_files_is_one_log(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    rig, columns = run
    half = len(columns["time_ns"]) // 2
    parts = [
        {name: values[rows] for name, values in columns.items()} for rows in (slice(half), slice(half, None))
    ]
    first, second = (record(tmp_path / name, "mcap", part) for name, part in zip("ab", parts, strict=True))
    shutil.copy(second / "b.mcap", first)
    said = [yaml.safe_load((folder / "metadata.yaml").read_text()) for folder in (first, second)]
    whole, rest = (each["rosbag2_bagfile_information"] for each in said)
    whole["relative_file_paths"] += rest["relative_file_paths"]
    whole["message_count"] += rest["message_count"]
    for topic, more in zip(*(each["topics_with_message_count"] for each in (whole, rest)), strict=True):
        topic["message_count"] += more["message_count"]
    (first / "metadata.yaml").write_text(yaml.safe_dump(said[0]))
    log = read_log(first, rig)
    np.testing.assert_array_equal(log.time_ns, columns["time_ns"])
    np.testing.assert_array_equal(log.raw[:, 2], columns["raw_2"])
    assert log.notes == ()


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_folder_that_states_another_quality_of_service_than_its_files_is_read(
    run: tuple[Rig, Columns], tmp_path: Path, kind: str
) -> None:
    """As after a conversion by `ros2 bag`."""
    folder = record(tmp_path / "run", kind, run[1])
    said = yaml.safe_load((folder / "metadata.yaml").read_text())
    for topic in said["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic["topic_metadata"]["offered_qos_profiles"] = [{
            "history": "keep_last", "depth": 7, "reliability": "best_effort", "durability": "volatile",
            "deadline": {"sec": 0, "nsec": 0}, "lifespan": {"sec": 0, "nsec": 0}, "liveliness": "automatic",
            "liveliness_lease_duration": {"sec": 0, "nsec": 0}, "avoid_ros_namespace_conventions": False,
        }]  # fmt: skip
    (folder / "metadata.yaml").write_text(yaml.safe_dump(said))
    log = read_log(folder, run[0])
    np.testing.assert_array_equal(log.raw[:, 2], run[1]["raw_2"])
    assert log.notes == ()


def test_number_of_messages_other_than_stated_is_noted(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "mcap", run[1])
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace("message_count: 400", "message_count: 500"))
    notes = read_log(folder, run[0]).notes
    assert notes == ("/ft/wrench: 400 messages, though the recording counts 500",)


def test_log_says_its_payload(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    path = record(tmp_path / "run", "bag", run[1])
    assert read_log(f"{path}@default", run[0]).payload == "default"


def test_channels_called_after_axes_are_found_by_their_names(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    path = write(tmp_path, "mcap", still)
    settings["sensor"] |= {"channels": ["mx", "my", "mz", "fx", "fy", "fz"], "noise": [0.05] * 3 + [0.5] * 3}
    settings["sensor"]["nominal_gain"] = np.roll(np.eye(6), 3, axis=0).tolist()
    log = read_log(path, Rig.from_mapping(settings))
    np.testing.assert_array_equal(log.raw[5], [0, 0, 1, 5, 0, 0])


@pytest.mark.parametrize("kind", ["Float64", "Float32", "Int32"])
@pytest.mark.parametrize("storage", ["mcap", "bag"])
def test_gauges_come_from_an_array_with_as_many_numbers(
    settings: dict[str, Any], tmp_path: Path, kind: str, storage: str
) -> None:
    gauges = np.arange(160.0).reshape(20, 8)

    def fill(bag: Bag) -> None:
        still(bag)
        for i in range(20):
            bag.array("/gauges", START + i * MS, gauges[i], kind)
            bag.array("/other", START + i * MS, [1.0, 2.0], kind)

    draw = np.random.default_rng(1)
    settings["sensor"] |= {
        "channels": [f"g{i}" for i in range(8)], "noise": [1.0] * 8,
        "nominal_gain": draw.normal(size=(8, 6)).tolist(),
    }  # fmt: skip
    log = read_log(write(tmp_path, storage, fill), Rig.from_mapping(settings))
    np.testing.assert_array_equal(log.raw, gauges)


def test_several_sensors_are_listed_for_the_choice(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        for i in range(10):
            bag.wrench("/ft_filtered", START + 2 * i * MS, [7, 0, 0, 0, 0, 0])

    path = write(tmp_path, "mcap", fill)
    words = (
        r"/ft \(geometry_msgs/msg/WrenchStamped, 20 messages, 1000 Hz\); /ft_filtered \(.*10 messages, 500 Hz"
    )
    with pytest.raises(InputError, match=words):
        read_log(path, rig)
    log = read_log(path, with_recording(rig, wrench_topic="ft_filtered"))
    np.testing.assert_array_equal(log.raw[np.isfinite(log.raw[:, 0]), 0], [7] * 10)
    with pytest.raises(
        InputError, match=r"recording\.wrench_topic: found no topic `/ftt`, expected one of: /ft "
    ):
        read_log(path, with_recording(rig, wrench_topic="/ftt"))
    with pytest.raises(InputError, match=r"found `/twist` of type geometry_msgs/msg/TwistStamped"):
        read_log(path, with_recording(rig, wrench_topic="/twist"))


def test_recording_without_a_sensor_or_motion_is_refused(rig: Rig, tmp_path: Path) -> None:
    path = write(tmp_path, "mcap", lambda bag: bag.twist("/twist", START, [0] * 6))
    with pytest.raises(InputError, match="none for the sensor among /twist"):
        read_log(path, rig)
    shutil.rmtree(path)
    path = write(tmp_path, "mcap", lambda bag: bag.wrench("/ft", START, [0] * 6))
    with pytest.raises(InputError, match="expected a topic with the twist"):
        read_log(path, rig)


def test_command_is_not_taken_for_a_measurement(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        bag.twist("/cmd_vel", START, [9] * 6)

    path = write(tmp_path, "mcap", fill)
    log = read_log(path, rig)
    assert log.twist is not None
    assert log.twist.max() == 19
    assert read_log(path, with_recording(rig, twist_topic="/cmd_vel")).twist is not None


def test_twist_in_gravity_asks_for_its_topic(settings: dict[str, Any], tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        kind = "geometry_msgs/msg/Vector3Stamped"
        for i in range(20):
            down = bag.type(kind)(header=bag.header(START + i * MS), vector=bag.vector([0, 0, -9.81]))
            bag.write("/down", kind, START + i * MS, down)

    path = write(tmp_path, "mcap", fill)
    settings["gravity"] = [0, 0, -9.81]
    with pytest.raises(InputError, match=r"recording\.gravity_topic: found nothing"):
        read_log(path, Rig.from_mapping(settings))
    log = read_log(path, with_recording(Rig.from_mapping(settings), gravity_topic="/down"))
    assert log.gravity is not None
    np.testing.assert_array_equal(log.gravity, [[0, 0, -9.81]] * 20)


def test_accelerometer_and_temperature_are_read_where_the_rig_uses_them(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        quaternion = bag.type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)
        zeros = np.zeros(9)
        for i in range(20):
            imu = bag.type("sensor_msgs/msg/Imu")(
                header=bag.header(START + i * MS), orientation=quaternion, orientation_covariance=zeros,
                angular_velocity=bag.vector([7, 7, 7]), angular_velocity_covariance=zeros,
                linear_acceleration=bag.vector([i, 1, 2]), linear_acceleration_covariance=zeros,
            )  # fmt: skip
            bag.write("/imu", "sensor_msgs/msg/Imu", START + i * MS, imu)
            warm = bag.type("sensor_msgs/msg/Temperature")
            warm = warm(header=bag.header(START + i * MS), temperature=20.0 + i, variance=0.0)
            bag.write("/warm", "sensor_msgs/msg/Temperature", START + i * MS, warm)

    path = write(tmp_path, "mcap", fill)
    plain = read_log(path, Rig.from_mapping(settings))
    assert plain.specific_force is None
    assert plain.temperature is None
    without = write(tmp_path / "without", "mcap", still)
    settings["motion"]["acceleration_noise"] = [0.01] * 3
    settings["temperature"] = {"prior": 0.001}
    log = read_log(path, Rig.from_mapping(settings))
    assert log.specific_force is not None
    assert log.temperature is not None
    np.testing.assert_array_equal(log.specific_force[4], [4, 1, 2])
    np.testing.assert_array_equal(log.temperature, 20.0 + np.arange(20))
    assert (
        read_log(without, Rig.from_mapping(settings)).temperature is None
    )  # as of a table without the column
