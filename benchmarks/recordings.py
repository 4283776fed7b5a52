"""Recordings: the gain by format, read throughput beside plain `rosbags`, and peak memory: markdown tables.

    python benchmarks/recordings.py gains
    python benchmarks/recordings.py throughput
    python benchmarks/recordings.py memory [--numbers] [--format bag]

`gains` calibrates one simulated run out of every format. `throughput` reads a file whose every message is of
use, in turn by `rosbags`, which makes an object of every message, and by this package, which makes the
columns of a log; the fastest of several turns counts. `memory` writes a recording of 2 GB, mostly pictures,
or with `--numbers` wrenches and joints alone, under a temporary folder and reports the largest resident set
of processes that read it.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy is imported
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cases
import numpy as np
from rosbags.highlevel import AnyReader

from truewrench import robots
from truewrench.calibrating.pipeline import calibrate
from truewrench.io.tables import open_table, read_log, write_table
from truewrench.model.rig import Rig, load_rig
from truewrench.robot.arm import robot_of
from truewrench.simulation.free_body import simulate

sys.path.append(str(Path(__file__).parents[1] / "tests" / "python"))
from bags import KINDS, Bag, record

START = 1_700_000_000_000_000_000
MS = 1_000_000
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["gains", "throughput", "memory"])
    parser.add_argument("--duration", type=float, default=60.0, help="of the run [s]")
    parser.add_argument("--repeat", type=int, default=3, help="turns of which the fastest counts")
    parser.add_argument("--size", type=float, default=2.0, help="of the recording for `memory` [GB]")
    parser.add_argument("--numbers", action="store_true", help="`memory` of a recording without pictures")
    parser.add_argument("--format", choices=["mcap", "bag"], default="mcap", help="for `memory`")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if arguments.what == "gains":
            gains(Path(folder), arguments.duration)
        elif arguments.what == "throughput":
            throughput(Path(folder), arguments.duration, arguments.repeat)
        else:
            memory(Path(folder), arguments.format, arguments.size, arguments.numbers)


def run_of(duration: float) -> tuple[Rig, dict[str, Any]]:
    """A sensor at 1 kHz and a twist at 500 Hz, with a clock of its own."""
    settings = cases.rig_of("scenario", (0.5, 1e-3)).to_mapping()
    settings["simulate"] |= {
        "rate": 500,
        "sensor_rate": 1000,
        "time_offset": 0.0013,
        "gain": "random",
        "seed": 1,
    }
    settings["sensor"] |= {"time_offset_prior": 5e-3}
    settings["plan"] |= {"duration": duration}
    rig = Rig.from_mapping(settings)
    log = simulate(rig).log
    columns: dict[str, Any] = {"time_ns": log.time_ns + START}
    columns |= {f"raw_{i}": log.raw[:, i] for i in range(6)}
    return rig, columns | {name: log.twist[:, i] for i, name in enumerate(TWIST)}


def gains(folder: Path, duration: float) -> None:
    rig, columns = run_of(duration)
    print("| format | MB | rows | read, s | largest difference of a gain |\n|---|---|---|---|---|")
    reference = None
    for kind in ("csv", "parquet", *KINDS):
        path = folder / f"run.{kind}"
        if kind in ("csv", "parquet"):
            write_table(path, columns)
        else:
            path = record(folder / kind, kind, columns)
        started = time.perf_counter()
        log = read_log(path, rig)
        spent = time.perf_counter() - started
        gain = calibrate(rig, log, held_out=False).gain
        reference = gain if reference is None else reference
        difference = np.abs(gain - reference).max()
        print(
            f"| {kind} | {size_of(path):.1f} | {len(log.raw)} | {spent:.2f} | {difference:.1e} |", flush=True
        )


def size_of(path: Path) -> float:
    files = [path] if path.is_file() else list(path.iterdir())
    return sum(file.stat().st_size for file in files) * 1e-6


def arm_run(folder: Path, kind: str, duration: float, pictures: int = 0) -> tuple[Rig, Path]:
    """Wrenches and seven joints at 1 kHz, and pictures of 1 MB spread among them."""
    rig = load_rig(robots.path("panda"))
    names = robot_of(rig).joints
    samples = int(1000 * duration)
    picture = np.random.default_rng(0).integers(0, 256, 1_000_000, dtype=np.uint8)
    with Bag(folder / kind, kind) as bag:
        kind_of_picture = "sensor_msgs/msg/CompressedImage"
        for i in range(samples):
            stamp = START + i * MS
            q = {name: np.sin(1e-3 * i + j) for j, name in enumerate(names)}
            dq = {name: np.cos(1e-3 * i + j) for j, name in enumerate(names)}
            bag.wrench("/ft", stamp, [np.sin(i + j) for j in range(6)])
            bag.joints("/joint_states", stamp, q, dq)
            if pictures and i * pictures // samples != (i + 1) * pictures // samples:
                message = bag.type(kind_of_picture)(header=bag.header(stamp), format="x", data=picture)
                bag.write("/camera", kind_of_picture, stamp, message)
    return rig, bag.path


def throughput(folder: Path, duration: float, repeat: int) -> None:
    print(
        "| format | messages | rosbags, messages/s | truewrench, messages/s | ratio |\n|---|---|---|---|---|"
    )
    for kind in ("sqlite3", "mcap", "mcap-storage", "bag"):
        rig, path = arm_run(folder, kind, duration)
        plain, ours = [], []
        for _ in range(repeat):  # in turn: what else the machine does then meets both
            plain.append(timed(lambda path=path: by_rosbags(path)))
            ours.append(timed(lambda path=path, rig=rig: by_this_package(path, rig)))
        messages = 2 * int(1000 * duration)
        a, b = messages / min(plain), messages / min(ours)
        print(f"| {kind} | {messages} | {a:.0f} | {b:.0f} | {b / a:.1f} |", flush=True)


def timed(call: Callable[[], object]) -> float:
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def by_rosbags(path: Path) -> None:
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)


def by_this_package(path: Path, rig: Rig) -> None:
    table = open_table(path, rig)
    for chunk in table.chunks():
        for name in table.names:
            chunk.column(name)


READERS = {
    "start and imports": (
        "import truewrench.correction.apply, truewrench.inspection.recording, rosbags.highlevel"
    ),
    "rosbags, every message": "recordings.by_rosbags(path)",
    "truewrench inspect": "inspect_recording(path)",
    "truewrench, the columns of a log": "recordings.by_this_package(path, rig)",
    "truewrench apply, to Parquet": "apply(calibration_of(rig), path, path.parent / 'out.parquet')",
    "truewrench apply --no-predict, to MCAP": (
        "apply_to_recording(calibration_of(rig), path, path.parent / 'out.mcap', predict=False)"
    ),
}


def numbers_run(folder: Path, storage: str, size: float) -> Path:
    """As many wrenches and joints as make a file of a size [GB]: two messages, but for their stamps."""
    _, short = arm_run(folder, storage, 0.001)
    with AnyReader([short]) as reader:
        messages = [(c.topic, c.msgtype, data[:4], data[12:]) for c, _, data in reader.messages()]
    weight = sum(43 + len(rest) + 12 for *_, rest in messages)
    with Bag(folder / "numbers", storage) as bag:
        for i in range(int(size * 1e9 / weight)):
            stamp = START + i * MS
            packed = struct.pack("<iI", *divmod(stamp, 10**9))
            for topic, kind, head, rest in messages:
                bag.write_bytes(topic, kind, stamp, head + packed + rest)
    return bag.path


def memory(folder: Path, kind: str, size: float, numbers: bool) -> None:
    print("| reading | GB | peak memory, MB |\n|---|---|---|")
    for share in (0.1, 1.0):
        part = folder / str(share)
        part.mkdir()
        if numbers:
            path = numbers_run(part, kind, size * share)
        else:
            _, path = arm_run(part, kind, 60.0 * share, int(1000 * size * share))
        for words, code in READERS.items():
            script = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
import recordings
from recordings import calibration_of
from truewrench import robots
from truewrench.correction.apply import apply
from truewrench.correction.apply_recording import apply_to_recording
from truewrench.inspection.recording import inspect_recording
from truewrench.model.rig import load_rig
path, rig = Path({str(path)!r}), load_rig(robots.path("panda"))
{code}
status = Path("/proc/self/status").read_text()  # of this program alone, not of the one that started it
print(float(status.split("VmHWM:")[1].split()[0]) / 1024)
"""
            done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
            print(f"| {words} | {size * share:.2g} | {float(done.stdout):.0f} |", flush=True)


def calibration_of(rig: Rig) -> Any:
    """A calibration that changes nothing: reading is what is looked at."""
    from truewrench.model.calibration import Calibration, Verdict

    n = rig.sensor.n
    gain = rig.sensor.nominal_gain_array
    return Calibration(
        gain=gain, gain_std=0 * gain, offset=np.zeros(n), offset_std=np.zeros(n),
        inverse=np.linalg.pinv(gain), covariance=np.zeros((7 * n, 7 * n)), verdict=Verdict(usable=True),
        logs=(), rig=rig, estimator="map", version="", created="",
    )  # fmt: skip


if __name__ == "__main__":
    main()
