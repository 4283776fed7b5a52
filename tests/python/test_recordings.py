"""A recording is read like the table of the same samples, and what it leaves open is asked for."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bags import KINDS, Bag, record

from truewrench.errors import InputError
from truewrench.io.tables import read_log, write_table
from truewrench.pipeline import calibrate
from truewrench.rig import Rig
from truewrench.simulate import simulate

Array = np.ndarray[Any, np.dtype[np.float64]]
Columns = dict[str, np.ndarray[Any, Any]]

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
START = 1_700_000_000_000_000_000  # stamps as large as real ones: a double does not hold their nanoseconds
MS = 1_000_000


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


def test_number_of_messages_other_than_stated_is_noted(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "mcap", run[1])
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace("message_count: 400", "message_count: 500"))
    notes = read_log(folder, run[0]).notes
    assert notes == ("/ft/wrench: 400 messages, though the recording counts 500",)


def test_log_says_its_payload(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    path = record(tmp_path / "run", "bag", run[1])
    assert read_log(f"{path}@default", run[0]).payload == "default"


# --- sensors ---


def write(tmp_path: Path, kind: str, fill: Callable[[Bag], None]) -> Path:
    with Bag(tmp_path / "run", kind) as bag:
        fill(bag)
    return bag.path


def still(bag: Bag, samples: int = 20) -> None:
    """A sensor and a twist on topics of their own."""
    for i in range(samples):
        bag.wrench("/ft", START + i * MS, [i, 0, 0, 0, 0, 1])
        bag.twist("/twist", START + i * MS, [0, 0, 0, 0, 0, i])


def with_recording(rig: Rig, **recording: str) -> Rig:
    return Rig.from_mapping({**rig.to_mapping(), "recording": recording})


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


# --- joints ---


@pytest.fixture
def joint_rig(arm_rig: Callable[..., Rig]) -> Rig:
    return arm_rig("ur10")


def swing(names: tuple[str, ...], i: int) -> tuple[dict[str, float], dict[str, float]]:
    q = {name: 0.1 * np.sin(0.3 * i + j) for j, name in enumerate(names)}
    return q, {name: 30.0 * np.cos(0.3 * i + j) for j, name in enumerate(names)}


def joints_of(rig: Rig) -> tuple[str, ...]:
    from truewrench.robot import robot_of

    return tuple(robot_of(rig).joints)


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_joints_are_matched_by_name_among_several_publishers(
    joint_rig: Rig, tmp_path: Path, kind: str
) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(60):
            stamp = START + 10 * i * MS
            bag.wrench("/ft", stamp, [i] * 6)
            q, dq = swing(names, i)
            order = names[::-1] if i % 2 else names
            bag.joints("/joint_states", stamp, {n: q[n] for n in order}, dq)
            bag.joints("/joint_states", stamp + MS, {"gripper": 0.5}, {"gripper": 0.0})

    log = read_log(write(tmp_path, kind, fill), joint_rig)
    assert log.position is not None
    assert log.velocity is not None
    assert len(log.time_ns) == 60
    for i in range(60):
        q, dq = swing(names, i)
        np.testing.assert_array_equal(log.position[i], list(q.values()))
        np.testing.assert_array_equal(log.velocity[i], list(dq.values()))


@pytest.mark.parametrize("fill_in", [None, np.nan])
def test_joints_without_velocities_are_positions_alone(
    joint_rig: Rig, tmp_path: Path, fill_in: float | None
) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(60):
            q = swing(names, i)[0]
            bag.wrench("/ft", START + 10 * i * MS, [i] * 6)
            dq = None if fill_in is None else dict.fromkeys(names, fill_in)
            bag.joints("/joint_states", START + 10 * i * MS, q, dq)

    settings = joint_rig.to_mapping()
    settings["motion"] |= {"position_noise": [1e-5] * len(names)}
    log = read_log(write(tmp_path, "mcap", fill), Rig.from_mapping(settings, joint_rig.path))
    assert log.velocity is None
    assert log.position is not None
    assert np.isfinite(log.position).all()


def test_joint_on_two_topics_is_ambiguous(joint_rig: Rig, tmp_path: Path) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(20):
            q, dq = swing(names, i)
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.joints("/joint_states", START + i * MS, q, dq)
            bag.joints("/joint_states_filtered", START + i * MS, q, dq)

    with pytest.raises(InputError, match=r"on several topics: /joint_states .*; /joint_states_filtered"):
        read_log(write(tmp_path, "mcap", fill), joint_rig)


def test_publishers_that_contradict_one_another_are_refused(joint_rig: Rig, tmp_path: Path) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(20):
            q, dq = swing(names, i)
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.joints("/joint_states", START + i * MS, q, dq)
            bag.joints("/joint_states", START + i * MS, {names[0]: 1.0}, dq)

    with pytest.raises(InputError, match=f"joint `{names[0]}` in messages with different sets of joints"):
        read_log(write(tmp_path, "mcap", fill), joint_rig)


def test_parts_of_an_arm_need_stamps_in_common(joint_rig: Rig, tmp_path: Path) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(20):
            q, dq = swing(names, i)
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.joints("/joint_states", START + i * MS, {n: q[n] for n in names[:3]}, dq)
            bag.joints("/joint_states", START + i * MS + 5, {n: q[n] for n in names[3:]}, dq)

    with pytest.raises(InputError, match="no stamp in common for the joints"):
        read_log(write(tmp_path, "mcap", fill), joint_rig)


def test_joint_that_is_missing_is_named_with_those_that_are_there(joint_rig: Rig, tmp_path: Path) -> None:
    names = joints_of(joint_rig)

    def fill(bag: Bag) -> None:
        for i in range(5):
            q = swing(names, i)[0]
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.joints(
                "/joint_states", START + i * MS, {("elbow" if n == names[2] else n): q[n] for n in names}
            )

    with pytest.raises(
        InputError, match=rf"no samples of the joints {names[2]} \(joints in the recording: elbow, "
    ):
        read_log(write(tmp_path, "mcap", fill), joint_rig)


# --- other streams ---


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
    settings["motion"]["acceleration_noise"] = [0.01] * 3
    settings["temperature"] = {"prior": 0.001}
    log = read_log(path, Rig.from_mapping(settings))
    assert log.specific_force is not None
    assert log.temperature is not None
    np.testing.assert_array_equal(log.specific_force[4], [4, 1, 2])
    np.testing.assert_array_equal(log.temperature, 20.0 + np.arange(20))


# --- stamps ---


def test_header_and_receive_stamps_as_asked(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(400):
            bag.wrench("/ft", START + i * MS, [i] * 6, receive=START + i * MS + 250 * MS)
            bag.twist("/twist", START + i * MS, [i] * 6, receive=START + i * MS + 3 * MS)

    path = write(tmp_path, "mcap", fill)
    header = read_log(path, rig)
    np.testing.assert_array_equal(header.time_ns, START + MS * np.arange(400))
    assert any(note.startswith("/ft: header stamps are 0.25 s before") for note in header.notes)
    assert any("stamps are 0.247 s apart" in note for note in header.notes)
    receive = read_log(path, with_recording(rig, stamps="receive"))
    sensed = np.isfinite(receive.raw[:, 0])
    np.testing.assert_array_equal(receive.time_ns[sensed], START + MS * (250 + np.arange(400)))


def test_drift_of_the_stamps_is_noted(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(500):
            bag.wrench("/ft", START + i * MS, [i] * 6, receive=START + int(i * MS * 1.1))
            bag.twist("/twist", START + i * MS, [i] * 6)

    notes = read_log(write(tmp_path, "mcap", fill), rig).notes
    assert any(note.startswith("/ft: header stamps drift by 0.0499 s") for note in notes)


def test_messages_without_a_header_have_receive_stamps(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(20):
            six = bag.type("geometry_msgs/msg/Wrench")(
                force=bag.vector([i, 0, 0]), torque=bag.vector([0, 0, 0])
            )
            bag.write("/ft", "geometry_msgs/msg/Wrench", START + i * MS, six)
            bag.twist("/twist", START + i * MS, [0] * 6)

    log = read_log(write(tmp_path, "sqlite3", fill), rig)
    np.testing.assert_array_equal(log.time_ns, START + MS * np.arange(20))
    np.testing.assert_array_equal(log.raw[:, 0], np.arange(20))


def test_late_messages_are_sorted_in_and_noted(rig: Rig, tmp_path: Path) -> None:
    order = np.random.default_rng(0).permutation(5000)

    def fill(bag: Bag) -> None:
        for k, i in enumerate(order.tolist()):
            bag.wrench("/ft", START + i * MS, [i] * 6, receive=START + k * MS)
            bag.twist("/twist", START + k * MS, [k] * 6)

    log = read_log(write(tmp_path, "mcap", fill), rig)
    np.testing.assert_array_equal(log.time_ns, START + MS * np.arange(5000))
    np.testing.assert_array_equal(log.raw[:, 0], np.arange(5000))
    late = int((order < np.maximum.accumulate(order)).sum())
    assert f"/ft: {late} messages came late and were sorted in by their stamps" in log.notes


def test_repeated_stamps_are_counted_or_refused(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag, 400)
        bag.wrench("/ft", START + 399 * MS, [1e3] * 6, receive=START + 400 * MS)

    log = read_log(write(tmp_path, "mcap", fill), rig)
    assert log.raw[-1, 0] == 399
    assert "/ft: 1 messages with the stamp of an earlier one left out" in log.notes

    def unset(bag: Bag) -> None:
        for i in range(20):
            bag.wrench("/ft", 0, [i] * 6, receive=START + i * MS)
            bag.twist("/twist", START + i * MS, [0] * 6)

    shutil.rmtree(tmp_path / "run")
    with pytest.raises(InputError, match=r"19 of 20 messages with a stamp .*stamps: receive"):
        read_log(write(tmp_path, "mcap", unset), rig)


def test_streams_of_clocks_without_a_time_in_common_are_refused(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(20):
            bag.wrench("/ft", (i + 1) * MS, [i] * 6, receive=START + i * MS)
            bag.twist("/twist", START + i * MS, [0] * 6)

    path = write(tmp_path, "mcap", fill)
    with pytest.raises(InputError, match=r"expected streams that overlap; .*stamps: receive"):
        read_log(path, rig)
    assert len(read_log(path, with_recording(rig, stamps="receive")).time_ns) == 20


# --- faults ---


def test_nan_is_left_out_and_counted_and_infinity_refused(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        bag.wrench("/ft", START + 20 * MS, [1, np.nan, 1, 1, 1, 1])

    log = read_log(write(tmp_path, "mcap", fill), rig)
    assert log.nan_counts == {"raw_1": 1}
    assert np.isnan(log.raw[-1]).tolist() == [False, True, False, False, False, False]
    shutil.rmtree(tmp_path / "run")

    def infinite(bag: Bag) -> None:
        still(bag)
        bag.wrench("/ft", START + 20 * MS, [1, np.inf, 1, 1, 1, 1])

    place = rf"stamp {START + 20 * MS} ns, column `raw_1`: found inf, expected a finite number"
    with pytest.raises(InputError, match=place):
        read_log(write(tmp_path, "mcap", infinite), rig)


@pytest.mark.parametrize("kind", ["mcap", "mcap-storage", "mcap-file", "mcap-message", "sqlite3", "bag"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_truncated_file_is_a_clear_error(
    run: tuple[Rig, Columns], tmp_path: Path, kind: str, share: float
) -> None:
    path = record(tmp_path / "run", kind, run[1])
    file = path if path.is_file() else next(f for f in path.iterdir() if f.name != "metadata.yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"found a broken recording \(.*\), expected a complete recording"):
        read_log(path, run[0])


def test_message_of_another_shape_is_named(rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        still(bag)
        bag.write_bytes("/ft", "geometry_msgs/msg/WrenchStamped", START + 20 * MS, b"\0\1\0\0" + bytes(30))

    words = r"topic /ft, message 21: found a broken message \(34 bytes, fewer than its type has\)"
    with pytest.raises(InputError, match=words):
        read_log(write(tmp_path, "mcap", fill), rig)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.mcap", b"", "found an empty file"),
        ("run.bag", b"time_ns,raw_0\n", "found a file that does not begin like one"),
        ("run.csv", b"\x89MCAP0\r\n", r"found MCAP under this name, expected a name that ends in \.mcap"),
    ],
)
def test_what_is_no_recording_is_refused(
    rig: Rig, tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_log(tmp_path / name, rig)


def test_database_that_was_not_closed_is_refused(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "sqlite3", run[1])
    (folder / "run.db3-wal").write_bytes(b"rows that have not been merged")
    with pytest.raises(InputError, match=r"a recording that was cut off \(run\.db3-wal beside it\)"):
        read_log(folder, run[0])


def test_folder_without_metadata_names_its_files(run: tuple[Rig, Columns], tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "mcap", run[1])
    (folder / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"a folder without metadata\.yaml, expected .*files: run\.mcap"):
        read_log(folder, run[0])
