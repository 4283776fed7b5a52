"""Logs whose motion is an IMU's, and the attitude of a log: read from tables and recordings, and shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import MS, START, Bag, with_recording, write
from scipy.stats import chi2

from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation.estimator import estimate
from truewrench.inspection.log import inspect_log
from truewrench.inspection.recording import inspect_recording
from truewrench.io.tables import read_log, write_table
from truewrench.model.arrays import Array
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.planning.planner import plan
from truewrench.simulation.free_body import simulate

CsvOf = Callable[..., Path]
Cells = dict[str, list[str]]

IMU = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
ACCEL = ("accel_x", "accel_y", "accel_z")


@pytest.fixture
def imu_rig(settings: dict[str, Any]) -> Rig:
    return Rig.from_mapping(settings | {"motion": IMU})


@pytest.fixture
def imu_cells(cells: Cells) -> Cells:
    """The motion as an IMU tells it."""
    kept = {name: column for name, column in cells.items() if name not in ("vx", "vy", "vz")}
    return kept | {name: [repr(0.5 * k + j) for k in range(10)] for j, name in enumerate(ACCEL)}


def test_imu_log_holds_rates_and_specific_force_and_no_twist(
    imu_cells: Cells, csv_of: CsvOf, imu_rig: Rig
) -> None:
    log = read_log(csv_of(imu_cells), imu_rig)
    assert log.twist is None
    assert log.gravity is None
    assert log.angular_velocity is not None
    assert log.specific_force is not None
    np.testing.assert_array_equal(log.angular_velocity[:, 2], [float(x) for x in imu_cells["wz"]])
    np.testing.assert_array_equal(log.specific_force[3], [1.5, 2.5, 3.5])
    odd = rows_of(log, np.arange(10) % 2 == 1)
    assert odd.angular_velocity is not None
    np.testing.assert_array_equal(odd.angular_velocity, log.angular_velocity[1::2])


def test_imu_log_needs_no_gravity_and_no_velocity(
    imu_cells: Cells, csv_of: CsvOf, settings: dict[str, Any]
) -> None:
    rig = Rig.from_mapping(settings | {"motion": IMU, "gravity": [0, 0, -9.81]})
    assert read_log(csv_of(imu_cells), rig).gravity is None
    whole = imu_cells | dict.fromkeys(("vx", "vy", "vz", "gx", "gy", "gz"), ["1.0"] * 10)
    log = read_log(csv_of(whole), rig)
    assert log.twist is None
    np.testing.assert_array_equal(log.gravity, np.ones((10, 3)))


@pytest.mark.parametrize("missing", ["wy", "accel_z"])
def test_column_that_an_imu_lacks_is_named(
    imu_cells: Cells, csv_of: CsvOf, imu_rig: Rig, missing: str
) -> None:
    del imu_cells[missing]
    with pytest.raises(InputError, match=rf"run\.csv: header: found no column `{missing}`"):
        read_log(csv_of(imu_cells), imu_rig)


def test_attitude_stands_for_gravity_where_that_is_not_logged(
    cells: Cells, csv_of: CsvOf, settings: dict[str, Any]
) -> None:
    """A quarter turn about x, sensor to root: what falls along -z of the root falls along -y here."""
    rig = Rig.from_mapping(settings | {"gravity": [0, 0, -9.81]})
    turned = dict.fromkeys(("qw", "qx"), [repr(float(np.sqrt(0.5)))] * 10)
    turned |= {"qy": ["0"] * 10, "qz": ["0"] * 9 + [""]}
    log = read_log(csv_of(cells | turned), rig)
    assert log.attitude is not None
    assert log.gravity is not None
    np.testing.assert_allclose(log.gravity[:9], [[0.0, -9.81, 0.0]] * 9, atol=1e-12)
    assert np.isnan(log.gravity[9]).all()
    both = read_log(csv_of(cells | turned | dict.fromkeys(("gx", "gy", "gz"), ["1.0"] * 10)), rig)
    np.testing.assert_array_equal(both.gravity, np.ones((10, 3)))
    np.testing.assert_array_equal(both.attitude, log.attitude)
    orbit = read_log(csv_of(cells | turned), Rig.from_mapping(settings))
    assert orbit.gravity is None
    assert orbit.attitude is not None


def test_quaternion_that_is_none_is_refused(cells: Cells, csv_of: CsvOf, rig: Rig) -> None:
    wrong = {"qw": ["1.0"] * 10, "qx": ["0"] * 10, "qy": ["0"] * 4 + ["0.5"] + ["0"] * 5, "qz": ["0"] * 10}
    with pytest.raises(InputError, match=r"columns `qw` \.\.\. `qz`, time 40000000 ns: .* length 1\.118"):
        read_log(csv_of(cells | wrong), rig)


def filled(bag: Bag) -> None:
    """A sensor and an IMU of stamps of its own."""
    quaternion = bag.type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)
    zeros = np.zeros(9)
    for i in range(20):
        bag.wrench("/ft", START + 10 * i * MS, [i, 0, 0, 0, 0, 0])
        at = START + 10 * i * MS + MS
        imu = bag.type("sensor_msgs/msg/Imu")(
            header=bag.header(at), orientation=quaternion, orientation_covariance=zeros,
            angular_velocity=bag.vector([0.1 * i, 7, 8]), angular_velocity_covariance=zeros,
            linear_acceleration=bag.vector([i, 1, 2]), linear_acceleration_covariance=zeros,
        )  # fmt: skip
        bag.write("/imu", "sensor_msgs/msg/Imu", at, imu)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "bag"])
def test_imu_of_a_recording_is_the_motion(imu_rig: Rig, tmp_path: Path, kind: str) -> None:
    path = write(tmp_path, kind, filled)
    for rig in (imu_rig, with_recording(imu_rig, imu_topic="/imu")):
        log = read_log(path, rig)
        assert log.angular_velocity is not None
        assert log.specific_force is not None
        known = np.isfinite(log.angular_velocity).all(axis=1)
        np.testing.assert_array_equal(log.angular_velocity[known][4], [0.4, 7.0, 8.0])
        np.testing.assert_array_equal(log.specific_force[known][4], [4.0, 1.0, 2.0])
        np.testing.assert_array_equal(log.time_ns[known] - START, (10 * np.arange(20) + 1) * MS)


def test_recording_without_an_imu_asks_for_one(imu_rig: Rig, tmp_path: Path) -> None:
    def fill(bag: Bag) -> None:
        for i in range(20):
            bag.wrench("/ft", START + i * MS, [i] * 6)
            bag.twist("/tool", START + i * MS, [i] * 6)

    path = write(tmp_path, "mcap", fill)
    with pytest.raises(InputError, match=r"expected a topic with the IMU"):
        read_log(path, imu_rig)
    with pytest.raises(InputError, match=r"recording\.imu_topic: found `/tool` of type .*TwistStamped"):
        read_log(path, with_recording(imu_rig, imu_topic="/tool"))


def columns_of(path: Path, names: Sequence[str]) -> None:
    write_table(path, {"time_s": np.arange(0.0, 1.0, 0.01)} | {name: np.ones(100) for name in names})


def test_inspect_tells_an_imu_from_a_twist_and_knows_the_attitude(tmp_path: Path) -> None:
    columns_of(tmp_path / "imu.csv", ["raw_0", "wx", "wy", "wz", *ACCEL, "qw", "qx", "qy", "qz"])
    content = inspect_log(tmp_path / "imu.csv")
    assert [s.name for s in content.streams] == [
        "raw channels",
        "angular velocity",
        "attitude",
        "accelerometer",
    ]
    assert content.unknown == ()
    columns_of(tmp_path / "twist.csv", ["vx", "vy", "vz", "wx", "wy", "wz"])
    assert [s.name for s in inspect_log(tmp_path / "twist.csv").streams] == ["twist"]


def test_inspect_shows_both_halves_of_an_imu(tmp_path: Path) -> None:
    content = inspect_recording(write(tmp_path, "mcap", filled))
    topic = next(topic for topic in content.topics if topic.topic == "/imu")
    assert [column.name for column in topic.streams[0].columns] == ["wx", "wy", "wz", *ACCEL]
    assert "motion.source: imu" in topic.taken_as


@pytest.mark.parametrize("estimator", ["ekf", "ls"])
def test_references_take_no_imu(imu_cells: Cells, csv_of: CsvOf, imu_rig: Rig, estimator: Any) -> None:
    log = read_log(csv_of(imu_cells), imu_rig)
    with pytest.raises(UnsupportedError, match=r"motion\.source: found `imu`, expected `twist` or `joints`"):
        calibrate(imu_rig, log, estimator)


def test_wrench_known_from_elsewhere_needs_no_motion_of_an_imu(settings: dict[str, Any]) -> None:
    rig = Rig.from_mapping(settings | {"motion": IMU, "reference_noise": [0.1] * 6, "required": 1.0})
    draw = np.random.default_rng(1)
    wrench = draw.normal(size=(300, 6)) * [100, 100, 100, 10, 10, 10]
    raw = wrench + 0.1 * draw.normal(size=(300, 6))
    time_ns = np.arange(300, dtype=np.int64) * 10_000_000
    found = calibrate(rig, Log(None, "default", "", time_ns, raw, reference=wrench), held_out=False)
    np.testing.assert_allclose(found.gain, np.eye(6), atol=0.02)


def test_what_an_imu_cannot_do_yet_is_refused(imu_rig: Rig) -> None:
    for attempt in (lambda: plan(imu_rig), lambda: simulate(imu_rig)):
        with pytest.raises(UnsupportedError, match=r"motion\.source: found `?imu`?, expected `twist`"):
            attempt()


@pytest.mark.parametrize("seed", range(5))
def test_an_arm_that_turns_one_joint_is_solved(settings: dict[str, Any], seed: int) -> None:
    """Five components rest, and the accelerometer's constant errors look like offsets of the sensor.

    Sensor, accelerometer and gyroscope at 700, 250 and 100 Hz, each at stamps of its own.
    """
    rng = np.random.default_rng(seed)
    noise = np.repeat([0.03, 1.5e-3], 3)
    sensor = {"feels": "payload_on_sensor", "noise": noise.tolist(), "gain_prior": 0.05}
    sensor |= {"channels": ["fx", "fy", "fz", "mx", "my", "mz"], "range": [500] * 3 + [20] * 3}
    motion = IMU | {"acceleration_noise": [0.06] * 3, "accelerometer_bias_prior": 1.0}
    body = {"mass": 0.9, "center_of_mass": [0, 0, 0.044], "inertia": {"xx": 0.003, "yy": 0.003, "zz": 0.001}}
    rig = Rig.from_mapping({"sensor": sensor, "motion": motion, "payloads": {"only": body}})
    span = rig.sensor.range_array
    gain = np.eye(6) + 0.05 * rng.normal(size=(6, 6)) * span[:, None] / span

    def turning(t: Array) -> tuple[Array, Array, Array]:
        """Specific force (T, 3) at the sensor's origin, rate and acceleration of a turn about y."""
        x = np.clip((t - 1.0) / 4.3, 0.0, 1.0)
        angle = 2.5 * x**3 * (10 - 15 * x + 6 * x**2) - 0.5 * np.pi
        rate = 2.5 / 4.3 * 30 * x**2 * (1 - x) ** 2
        acceleration = 2.5 / 4.3**2 * 60 * x * (1 - x) * (1 - 2 * x)
        return 9.81 * np.column_stack([-np.sin(angle), 0.0 * x, np.cos(angle)]), rate, acceleration

    times = [np.arange(first, 6.3, 1.0 / hz) for first, hz in ((0.0, 700), (0.0007, 250), (0.0021, 100))]
    f, omega, alpha = turning(times[0])
    force = -0.9 * (f + 0.044 * np.column_stack([alpha, 0.0 * alpha, -(omega**2)]))
    moment = np.cross([0.0, 0.0, 0.044], force) - np.outer(0.003 * alpha, [0.0, 1.0, 0.0])
    values = {
        "raw": np.hstack([force, moment]) @ gain.T + noise * rng.normal(size=(times[0].size, 6)),
        "specific_force": turning(times[1])[0] + 0.3 * rng.normal(size=3),
        "angular_velocity": np.outer(turning(times[2])[1], [0.0, 1.0, 0.0]),
    }
    values["specific_force"] += 0.06 * rng.normal(size=values["specific_force"].shape)
    values["angular_velocity"] += 1e-3 * rng.normal(size=values["angular_velocity"].shape)
    stamps = [(1e9 * t).astype(np.int64) for t in times]
    together = np.unique(np.concatenate(stamps))
    columns = {name: np.full((together.size, x.shape[1]), np.nan) for name, x in values.items()}
    for at, (name, x) in zip(stamps, values.items(), strict=True):
        columns[name][np.searchsorted(together, at)] = x
    found = estimate(rig, [Log(None, "only", "", together, **columns)], threads=1)
    assert found.solved
    assert found.converged
    error = (found.gain - gain).ravel()
    assert error @ np.linalg.solve(found.covariance[:36, :36], error) < chi2.ppf(0.999, 36)
