"""The recording of a corrected log is read by `rosbags` and Foxglove's own reader, number by number."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from bags import Bag, record
from rosbags.highlevel import AnyReader

from truewrench.cli import main
from truewrench.correction import apply_recording
from truewrench.correction.apply import apply
from truewrench.correction.apply_recording import CORRECTED, PREDICTED, RAW, STD, apply_to_recording
from truewrench.inspection.recording import inspect_recording
from truewrench.io.recordings import reader, spool
from truewrench.io.tables import write_table
from truewrench.model.calibration import AXES, Calibration
from truewrench.model.errors import InputError
from truewrench.model.motion.trajectory import Body
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate, wrench_on_sensor

Array = np.ndarray[Any, np.dtype[np.float64]]

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
START = 1_700_000_000_123_456_789


def exact(calibration: Calibration, settings: dict[str, Any]) -> tuple[Calibration, Any]:
    """The calibration of a simulated sensor to the last bit, and the simulated run."""
    settings["simulate"] = {"offset": "none", "gain": "random", "rate": 200, "sensor_rate": 100}
    settings["plan"] = {"duration": 4}
    settings["sensor"]["noise"] = [1e-3] * 6
    settings["motion"]["noise"] = [1e-6] * 6
    rig = Rig.from_mapping(settings)
    run = simulate(rig, seed=2)
    gain = run.truth.gain
    zeros = np.zeros((42, 42))
    return replace(
        calibration, rig=rig, gain=gain, gain_std=0 * gain, offset=np.zeros(6), offset_std=np.zeros(6),
        inverse=np.linalg.inv(gain), covariance=zeros, time_offset=0.0,
    ), run  # fmt: skip


def columns_of(run: Any) -> dict[str, Any]:
    columns: dict[str, Any] = {"time_ns": run.log.time_ns + START}
    columns |= {f"raw_{i}": run.log.raw[:, i] for i in range(6)}
    return columns | {name: run.log.twist[:, i] for i, name in enumerate(TWIST)}


def by_rosbags(path: Path) -> dict[str, list[tuple[int, list[float]]]]:
    found: dict[str, list[tuple[int, list[float]]]] = {}
    with AnyReader([path]) as bag:
        for connection, stamp, data in bag.messages():
            message: Any = bag.deserialize(data, connection.msgtype)
            if connection.msgtype.endswith("MultiArray"):
                found.setdefault(connection.topic, []).append((stamp, message.data.tolist()))
                continue
            header = message.header.stamp
            assert header.sec * 10**9 + header.nanosec == stamp
            parts = (message.wrench.force, message.wrench.torque)
            values = [getattr(part, axis) for part in parts for axis in "xyz"]
            found.setdefault(connection.topic, []).append((stamp, values))
    return found


def by_foxglove(path: Path) -> dict[str, list[tuple[int, list[float]]]]:
    foxglove = pytest.importorskip("mcap_ros2.reader")
    found: dict[str, list[tuple[int, list[float]]]] = {}
    for item in foxglove.read_ros2_messages(str(path)):
        message = item.ros_msg
        if hasattr(message, "data"):
            values = list(message.data)
        else:
            parts = (message.wrench.force, message.wrench.torque)
            values = [getattr(part, axis) for part in parts for axis in "xyz"]
        found.setdefault(item.channel.topic, []).append((item.log_time_ns, values))
    return found


@pytest.mark.parametrize("source", ["table", "recording"])
def test_both_readers_find_raw_corrected_and_predicted(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path, source: str
) -> None:
    calibration, run = exact(calibration, settings)
    if source == "table":
        log = tmp_path / "run.csv"
        write_table(log, columns_of(run))
    else:
        log = record(tmp_path / "run", "mcap", columns_of(run))
    done = apply_to_recording(calibration, log, tmp_path / "out.mcap")
    assert done.notes == ()
    found = by_rosbags(tmp_path / "out.mcap")
    assert found == by_foxglove(tmp_path / "out.mcap")
    assert set(found) == {RAW, CORRECTED, STD, PREDICTED}

    sensed = np.isfinite(run.log.raw[:, 0])
    stamps, raw = run.log.time_ns[sensed] + START, run.log.raw[sensed]
    for topic, expected in ((RAW, raw), (CORRECTED, np.linalg.solve(run.truth.gain, raw.T).T)):
        assert [stamp for stamp, _ in found[topic]] == stamps.tolist()
        np.testing.assert_allclose([six for _, six in found[topic]], expected, rtol=1e-9, atol=1e-9)

    predicted = {stamp - START: six for stamp, six in found[PREDICTED]}
    assert len(predicted) > 0.8 * len(stamps)
    time = np.array(list(predicted)) * 1e-9
    motion, body = run.trajectory, run.truth.payloads["default"]
    point = calibration.rig.payloads["default"].center_of_mass_array
    true = wrench_on_sensor(
        body, point, motion.twist(time), motion.acceleration(time), np.zeros((len(time), 3))
    )
    np.testing.assert_allclose(list(predicted.values()), true, atol=0.02 * np.abs(true).max())


def test_prediction_has_no_hole_where_its_parts_meet(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calibration, run = exact(calibration, settings)
    write_table(tmp_path / "run.csv", columns_of(run))
    monkeypatch.setattr(apply_recording, "_ROWS", len(run.log.time_ns) // 2)
    apply_to_recording(calibration, tmp_path / "run.csv", tmp_path / "out.mcap")
    stamps = [stamp for stamp, _ in by_rosbags(tmp_path / "out.mcap")[PREDICTED]]
    assert np.diff(stamps)[20:-20].max() == 10_000_000


@pytest.mark.parametrize("seen", [True, False])
def test_prediction_is_that_of_the_body_which_the_calibration_found(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path, seen: bool
) -> None:
    calibration, run = exact(calibration, settings)
    inertia = {"xx": 1.6, "yy": 1.4, "zz": 0.5, "xy": 0.1, "xz": 0.0, "yz": -0.1}
    found = {"mass": 53.0, "center_of_mass": [0.21, -0.01, 0.02], "inertia": inertia}
    stds = {"mass_std": 0.5, "center_of_mass_std": [1e-3] * 3, "inertia_std": dict.fromkeys(inertia, 0.1)}
    together = {"covariance": np.eye(10).tolist(), "covariance_with_gain": np.zeros((10, 36)).tolist()}
    logs = (replace(calibration.logs[-1], payload="default" if seen else "another"),)
    posterior = {"default": {**found, **stds, **together}}
    calibration = replace(calibration, logs=logs, payload_posterior=posterior)
    write_table(tmp_path / "run.csv", columns_of(run))
    apply_to_recording(calibration, tmp_path / "run.csv", tmp_path / "out.mcap")
    predicted = {stamp - START: six for stamp, six in by_rosbags(tmp_path / "out.mcap")[PREDICTED]}
    time = np.array(list(predicted)) * 1e-9
    body, point = run.truth.payloads["default"], calibration.rig.payloads["default"].center_of_mass_array
    if seen:
        tensor = np.array([[1.6, 0.1, 0.0], [0.1, 1.4, -0.1], [0.0, -0.1, 0.5]])
        body = Body(53.0, np.array(found["center_of_mass"]), tensor)
    motion, none = run.trajectory, np.zeros((len(time), 3))
    true = wrench_on_sensor(body, point, motion.twist(time), motion.acceleration(time), none)
    np.testing.assert_allclose(list(predicted.values()), true, atol=0.01 * np.abs(true).max())


def test_motion_or_payload_that_is_missing_leaves_the_prediction_out(
    cells: dict[str, list[str]], csv_of: Any, tmp_path: Path, calibration: Calibration
) -> None:
    for name in TWIST:
        del cells[name]
    done = apply_to_recording(calibration, csv_of(cells), tmp_path / "out.mcap")
    assert (done.rows, done.corrected) == (10, 10)
    assert done.notes[0].startswith("no /truewrench/predicted: ")
    assert "no column `vx`" in done.notes[0]
    assert set(by_rosbags(tmp_path / "out.mcap")) == {RAW, CORRECTED, STD}


def test_a_calibration_without_payloads_leaves_the_prediction_out(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path
) -> None:
    calibration, run = exact(calibration, settings)
    bare = replace(calibration, rig=calibration.rig.model_copy(update={"payloads": {}}))
    reference = {f"ref_{axis}": np.ones(len(run.log.time_ns)) for axis in AXES}
    write_table(tmp_path / "run.csv", columns_of(run) | reference)
    done = apply_to_recording(bare, tmp_path / "run.csv", tmp_path / "out.mcap")
    assert done.corrected > 0
    assert "found no `default`, expected a payload" in done.notes[0]


@pytest.mark.parametrize("size", [5.0, 65535.0])
def test_one_cell_that_is_no_velocity_does_not_spoil_the_prediction(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path, size: float
) -> None:
    calibration, run = exact(calibration, settings)
    found = {}
    for name, value in (("sound", None), ("spoiled", 40.0 * size)):
        columns = columns_of(run)
        if value is not None:
            row = int(np.flatnonzero(np.isfinite(columns["vx"]))[100])
            columns["vx"] = np.where(np.arange(len(columns["vx"])) == row, value, columns["vx"])
        write_table(tmp_path / "run.csv", columns)
        apply_to_recording(calibration, tmp_path / "run.csv", tmp_path / f"{name}.mcap")
        found[name] = dict(by_rosbags(tmp_path / f"{name}.mcap")[PREDICTED])
    common = found["sound"].keys() & found["spoiled"].keys()
    assert len(common) > 0.95 * len(found["sound"])
    apart = np.array([found["sound"][k] for k in common]) - [found["spoiled"][k] for k in common]
    assert np.abs(apart).max() < 0.05 * np.abs(np.array(list(found["sound"].values()))).max()


def test_eight_gauges_are_an_array(
    settings: dict[str, Any], calibration: Calibration, tmp_path: Path
) -> None:
    draw = np.random.default_rng(2)
    gain, raw = draw.normal(size=(8, 6)), draw.normal(size=(10, 8))
    settings["sensor"] |= {
        "channels": [f"g{i}" for i in range(8)], "noise": [1.0] * 8, "nominal_gain": gain.tolist(),
    }  # fmt: skip
    eight = replace(
        calibration, quadratic=None, quadratic_std=None, discrepancy=None,
        gain=gain, gain_std=0 * gain, offset=np.zeros(8), covariance=np.zeros((56, 56)),
        rig=Rig.from_mapping(settings),
    )  # fmt: skip
    write_table(tmp_path / "run.csv", {"time_ns": np.arange(10)} | {f"raw_{i}": raw[:, i] for i in range(8)})
    apply_to_recording(eight, tmp_path / "run.csv", tmp_path / "out.mcap", predict=False)
    found = by_rosbags(tmp_path / "out.mcap")
    assert found == by_foxglove(tmp_path / "out.mcap")
    np.testing.assert_array_equal([values for _, values in found[RAW]], raw)
    expected = np.linalg.lstsq(gain, raw.T)[0].T
    np.testing.assert_allclose([values for _, values in found[CORRECTED]], expected, atol=1e-9)


def test_recording_becomes_a_table_of_all_its_streams(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path
) -> None:
    calibration, run = exact(calibration, settings)
    log = record(tmp_path / "run", "bag", columns_of(run))
    done = apply(calibration, log, tmp_path / "out.parquet")
    table = pq.read_table(tmp_path / "out.parquet")
    assert done.rows == table.num_rows == len(run.log.time_ns)
    for name, values in columns_of(run).items():
        np.testing.assert_array_equal(table.column(name).to_numpy(), values)
    assert table.column("fx").null_count == int(np.isnan(run.log.raw[:, 0]).sum())


def test_joints_that_are_ambiguous_do_not_keep_the_wrench_back(
    calibration: Calibration, tmp_path: Path
) -> None:
    with Bag(tmp_path / "run", "mcap") as bag:
        for i in range(5):
            bag.wrench("/ft", START + i, [i] * 6)
            bag.twist("/a", START + i, [i] * 6)
            bag.twist("/b", START + i, [i] * 6)
    done = apply(calibration, tmp_path / "run", tmp_path / "out.csv")
    assert done.corrected == 5
    assert "2 topics that could hold the twist: /a" in done.notes[0]


@pytest.mark.parametrize(
    ("stamp", "words"),
    [(-5, r"a time of -5 ns, expected 0 to 2\^31 s"), (2**31 * 10**9, "a time of 2147483648")],
)
def test_time_that_ros_cannot_hold_is_refused_and_nothing_written(
    cells: dict[str, list[str]], csv_of: Any, tmp_path: Path, calibration: Calibration, stamp: int, words: str
) -> None:
    cells["time_ns"][0 if stamp < 0 else -1] = str(stamp)
    with pytest.raises(InputError, match=words):
        apply_to_recording(calibration, csv_of(cells), tmp_path / "out.mcap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.csv"]


def test_memory_does_not_grow_with_the_recording(
    calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spool, "_ROWS", 1 << 10)
    monkeypatch.setattr(reader, "_BATCH", 1 << 9)
    peaks = []
    for samples in (10_000, 25_000):  # of which 8000 fill a chunk of MCAP
        time = np.arange(samples) * 1000 + START
        columns = {"time_ns": time} | {f"raw_{i}": np.full(samples, 0.1 + i) for i in range(6)}
        path = tmp_path / f"run{samples}"
        with Bag(path, "mcap") as bag:
            for i in range(samples):
                bag.wrench("/ft", int(time[i]), [columns[f"raw_{j}"][i] for j in range(6)])
        tracemalloc.start()
        apply(calibration, path, tmp_path / f"{samples}.parquet")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 1e6  # where 15000 messages more are 1.8 MB, and their numbers 2.3 MB


def test_command_writes_what_its_name_says_and_notes_what_is_left_out(
    cells: dict[str, list[str]], csv_of: Any, tmp_path: Path, calibration: Calibration,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    calibration.write_yaml(tmp_path / "calibration.yaml")
    log, output = csv_of(cells), tmp_path / "out.mcap"
    status = main(["apply", str(tmp_path / "calibration.yaml"), str(log), "-o", str(output), "--json"])
    out, err = capsys.readouterr()
    assert status == 0
    assert json.loads(out)["figures"]["corrected"] == 10
    assert "no /truewrench/predicted" in err  # ten rows are too few
    assert len(by_rosbags(output)[apply_recording.CORRECTED]) == 10


def two_sensors(tmp_path: Path) -> Path:
    with Bag(tmp_path / "run", "mcap") as bag:
        for i in range(5):
            bag.wrench("/ft", START + i, [1] * 6)
            bag.wrench("/ft_filtered", START + i, [7] * 6)
    return bag.path


def test_wrench_topic_is_chosen_by_an_option_of_the_command(
    cells: dict[str, list[str]], csv_of: Any, tmp_path: Path, calibration: Calibration,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def run(log: Path, *words: str) -> tuple[int, str]:
        fixed = ["apply", str(tmp_path / "calibration.yaml"), str(log), "-o", str(tmp_path / "out.parquet")]
        return main([*fixed, *words]), " ".join(capsys.readouterr().err.split())

    calibration.write_yaml(tmp_path / "calibration.yaml")
    log = two_sensors(tmp_path)
    status, err = run(log)
    assert status == 2
    assert "`recording: {wrench_topic: /ft}`; in `apply` also: `--wrench-topic /ft`" in err
    assert run(log, "--wrench-topic", "/ft_filtered")[0] == 0
    assert pq.read_table(tmp_path / "out.parquet").column("raw_0").to_pylist() == [7] * 5
    status, err = run(log, "--wrench-topic", "/ftt")
    assert status == 2
    assert "found no topic `/ftt`, expected one of: /ft" in err
    status, err = run(csv_of(cells), "--wrench-topic", "/ft")
    assert status == 2
    assert "--wrench-topic: found a table, expected this option with a recording only" in err


def test_what_apply_wrote_is_no_sensor_when_it_is_read_again(
    calibration: Calibration, settings: dict[str, Any], tmp_path: Path
) -> None:
    calibration, run = exact(calibration, settings)
    write_table(tmp_path / "run.csv", columns_of(run))
    apply_to_recording(calibration, tmp_path / "run.csv", tmp_path / "out.mcap")
    taken = {topic.topic: topic.taken_as for topic in inspect_recording(tmp_path / "out.mcap").topics}
    assert taken[RAW] == "sensor"
    assert taken[STD] == "a result of truewrench, by its name; unless named in recording.wrench_topic"
    apply(calibration, tmp_path / "out.mcap", tmp_path / "again.parquet")
    raw = pq.read_table(tmp_path / "again.parquet").column("raw_0").to_numpy()
    sensed = run.log.raw[np.isfinite(run.log.raw[:, 0]), 0]
    np.testing.assert_array_equal(raw, sensed)
