"""The contact wrench of `truewrench stream --tool --ros2` in a real ROS 2 graph: lost, latency, numbers.

    python benchmarks/live_tool.py
    python benchmarks/live_tool.py --duration 10 --rate 500

Topics of sensor, twist and gravity; processes as in live.py.
A tool of 2 kg is swung about one axis; nothing touches it. Its publisher keeps what it sent, stamps
included, as a log, which `truewrench apply --tool` reads afterwards.
"""

from __future__ import annotations

import json
import signal
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import live
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

CONTACT = "/truewrench/contact"
TWIST, GRAVITY = "/twist", "/gravity"
COMMAND = str(Path(sys.executable).with_name("truewrench"))
HALF = 0.01  # [s] of the kernel, which a wrench waits for
LEARNT = 40  # rows that may have no message: periods are learnt from the first 20
RIG: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.1, 0.1, 0.1, 0.005, 0.005, 0.005],
        "range": [100, 100, 100, 10, 10, 10],
    },
    "motion": {"source": "twist", "of": "sensor", "noise": [1e-3] * 6},
    "gravity": [0, 0, -9.81],
    "recording": {"wrench_topic": live.SOURCE, "twist_topic": TWIST, "gravity_topic": GRAVITY},
}
MASS, CENTER = 2.0, np.array([0.01, -0.02, 0.09])
INERTIA = np.diag([0.012, 0.011, 0.006])
AXIS = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
AMPLITUDE, RATE = 0.8, 2.0  # of the swing [rad, rad/s]
COLUMNS = ["vx", "vy", "vz", "wx", "wy", "wz", "gx", "gy", "gz"]


def main() -> None:
    parser = live.asked(__doc__)
    parser.add_argument("--folder", type=Path, help="of a role's files")
    arguments = parser.parse_args()
    if arguments.role is not None:
        role(arguments.role, arguments.folder, arguments.count, arguments.rate)
        return
    live.graph_of_its_own()
    table(round(arguments.duration * arguments.rate), arguments.rate)


def table(count: int, rate: float) -> None:
    """Run everything, and print."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "rig.yaml").write_text(yaml.safe_dump(RIG))
        identify(folder)
        np.savez(folder / "motion.npz", samples=swung(np.arange(count) / rate))
        command = [COMMAND, "stream", str(folder / "rig.yaml"), "--tool", str(folder / "tool.yaml")]
        command += ["--ros2", "--reliable", "--json"]
        streaming = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        echoing = live.role("echo")
        more = ("--folder", scratch)
        measuring, publishing = (
            live.role(name, count, rate, *more, script=__file__) for name in ("measure", "publish")
        )
        measuring.wait()
        for process in (streaming, echoing):
            process.send_signal(signal.SIGINT)
        figures = json.loads(streaming.communicate()[0])["figures"]
        echoing.wait()
        publishing.wait()
        told(folder, count, rate, figures)


def told(folder: Path, count: int, rate: float, figures: dict[str, int]) -> None:
    """The table."""
    import pyarrow.parquet as pq

    command = [COMMAND, "apply", "rig.yaml", "record.csv", "--tool", "tool.yaml", "-o", "out.parquet"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    out = pq.read_table(folder / "out.parquet")
    stamps = out["time_ns"].to_numpy()
    names = ("cfx", "cfy", "cfz", "cmx", "cmy", "cmz")
    applied = np.column_stack([out[name].to_numpy() for name in names])
    found = np.load(folder / "found.npz")
    lag, settled = round(HALF * rate), live.SETTLED * rate
    of_contact = np.searchsorted(stamps, found["contact_stamp"])
    of_echo = np.searchsorted(stamps, found["echo_stamp"])
    known = np.flatnonzero(np.isfinite(applied).all(axis=1))
    expected = known[(known >= LEARNT) & (known < count - lag)]
    lost = np.setdiff1d(expected, of_contact).size

    away = np.abs(found["wrench"] - applied[of_contact]) / np.maximum(1.0, np.abs(applied[of_contact]))
    print(f"{count} samples each of sensor, twist and gravity at {rate:g} Hz; truewrench received "
          f"{figures['received']}, lost {figures['lost']}; {expected.size} rows with a wrench\n")  # fmt: skip
    print("| | lost | median | 99 % | largest |\n|---|---|---|---|---|")
    kept = of_contact >= settled
    arrived, at = found["contact_arrived"][kept], of_contact[kept]
    print(live.row("contact, from its stamp", lost, 1e-3 * (arrived - stamps[at])))
    newest = stamps[np.minimum(at + lag, count - 1)]
    print(live.row("contact, from the newest sample in it", lost, 1e-3 * (arrived - newest)))
    kept = of_echo >= settled
    latency = 1e-3 * (found["echo_arrived"][kept] - stamps[of_echo[kept]])
    print(live.row("rclpy echo of the sensor", count - np.unique(of_echo).size, latency))
    print(f"\nlargest difference from `apply --tool`: {away.max():.1e} of 1 N or N m, or of the wrench")


def identify(folder: Path) -> None:
    """The tool, from 12 poses that end now: its offset is as old as a minute."""
    from truewrench import identify_tool, read_log
    from truewrench.model.rig.tool_rig import load_tool_rig

    rng, rig = np.random.default_rng(0), load_tool_rig(folder / "rig.yaml")
    fall = Rotation.random(12, random_state=0).as_matrix()[:, 2] * -9.81
    raw = MASS * np.hstack([fall, np.cross(CENTER, fall)]) + rig.sensor.noise_array * rng.normal(size=(12, 6))
    stamps = time.time_ns() - (12 - np.arange(12)) * 5_000_000_000
    write(folder / "poses.csv", stamps, np.hstack([raw, np.zeros((12, 6)), fall]))
    identify_tool(rig, read_log(folder / "poses.csv", rig)).write_yaml(folder / "tool.yaml")


def swung(time: Array) -> Array:
    """(N, 15) channels, twist and free fall: Newton's and Euler's laws at the origin, which rests."""
    angle = AMPLITUDE * np.sin(RATE * time)
    omega = (AMPLITUDE * RATE * np.cos(RATE * time))[:, None] * AXIS
    alpha = (-AMPLITUDE * RATE**2 * np.sin(RATE * time))[:, None] * AXIS
    turns = Rotation.from_rotvec([0.4, -0.7, 0.2]) * Rotation.from_rotvec(angle[:, None] * AXIS)
    fall = turns.inv().apply([0.0, 0.0, -9.81])
    force = MASS * (np.cross(alpha, CENTER) + np.cross(omega, np.cross(omega, CENTER)) - fall)
    moment = alpha @ INERTIA + np.cross(omega, omega @ INERTIA) + np.cross(CENTER, force)
    rng = np.random.default_rng(1)
    raw = -np.hstack([force, moment]) + np.array(RIG["sensor"]["noise"]) * rng.normal(size=(time.size, 6))
    twist = np.hstack([np.zeros((time.size, 3)), omega]) + 1e-3 * rng.normal(size=(time.size, 6))
    return np.hstack([raw, twist, fall])


def write(path: Path, stamps: NDArray[np.int64], samples: Array) -> None:
    """A log, every number to its last bit."""
    lines = [",".join(["time_ns", *(f"raw_{i}" for i in range(6)), *COLUMNS])]
    for stamp, values in zip(stamps, samples.tolist(), strict=True):
        lines.append(",".join([str(int(stamp)), *map(repr, values)]))
    path.write_text("\n".join(lines) + "\n")


def role(name: str, folder: Path, count: int, rate: float) -> None:
    """A process of its own."""
    publish(folder, rate) if name == "publish" else measure(folder, count)


def publish(folder: Path, rate: float) -> None:
    """Sensor, twist and gravity with one stamp, and the log of them."""
    from geometry_msgs.msg import TwistStamped, Vector3Stamped

    made, wrench_kind, quality = live.node("driver")
    kinds = {GRAVITY: Vector3Stamped, TWIST: TwistStamped, live.SOURCE: wrench_kind}
    gravity, twist, wrench = (made.create_publisher(kind, topic, quality) for topic, kind in kinds.items())
    while not (
        gravity.get_subscription_count()
        and twist.get_subscription_count()
        and wrench.get_subscription_count() > 1
        and made.count_publishers(CONTACT)
        and made.count_publishers(live.ECHO)
    ):
        time.sleep(0.1)
    time.sleep(1.0)  # for the measuring subscriber to have matched both
    samples = np.load(folder / "motion.npz")["samples"]
    stamps, due = np.empty(len(samples), dtype=np.int64), time.perf_counter()
    a, b, c = Vector3Stamped(), TwistStamped(), wrench_kind()
    c.header.frame_id = "tool0"
    vectors = (c.wrench.force, c.wrench.torque, b.twist.linear, b.twist.angular, a.vector)
    for index, values in enumerate(samples.tolist()):
        for k, vector in enumerate(vectors):
            vector.x, vector.y, vector.z = values[3 * k : 3 * k + 3]
        while (left := due - time.perf_counter()) > 0.0:
            time.sleep(left)
        due = max(due + 1.0 / rate, time.perf_counter())  # a driver that was late makes no burst
        stamps[index] = now = time.time_ns()
        for message, publisher in ((a, gravity), (b, twist), (c, wrench)):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 1_000_000_000)
            publisher.publish(message)
    write(folder / "record.csv", stamps, samples)
    time.sleep(2.0)


def measure(folder: Path, count: int) -> None:
    """Stamp and arrival of every contact wrench and echo, and the wrench: bytes, as in `live.measure`."""
    from rclpy.impl.implementation_singleton import rclpy_implementation

    made, kind, quality = live.node("measure")
    found: dict[str, list[tuple[int, bytes]]] = {CONTACT: [], live.ECHO: []}
    subscriptions = [made.create_subscription(kind, topic, print, quality, raw=True) for topic in found]
    with made.context.handle, ExitStack() as stack:
        handles = [one.handle for one in subscriptions]
        for handle in handles:
            stack.enter_context(handle)
        ready = rclpy_implementation.WaitSet(len(handles), 0, 0, 0, 0, 0, made.context.handle)
        last, seen = time.monotonic(), 0
        while seen < 2 * count and (not seen or time.monotonic() - last < 5.0):
            ready.clear_entities()
            for handle in handles:
                ready.add_subscription(handle)
            ready.wait(500_000_000)
            for topic, handle in zip(found, handles, strict=True):
                while (taken := handle.take_message(kind, True)) is not None:
                    found[topic].append((time.time_ns(), taken[0]))
            if (now_seen := sum(map(len, found.values()))) > seen:
                seen, last = now_seen, time.monotonic()
    contact, echo = ([read(message) for _, message in found[topic]] for topic in found)
    np.savez(
        folder / "found.npz",
        contact_stamp=np.array([one[0] for one in contact], dtype=np.int64),
        contact_arrived=np.array([at for at, _ in found[CONTACT]], dtype=np.int64),
        wrench=np.array([one[1] for one in contact]),
        echo_stamp=np.array([one[0] for one in echo], dtype=np.int64),
        echo_arrived=np.array([at for at, _ in found[live.ECHO]], dtype=np.int64),
    )


def read(message: bytes) -> tuple[int, tuple[float, ...]]:
    """Stamp [ns] and wrench of a WrenchStamped in CDR: numbers of eight bytes stand at multiples of eight."""
    sec, nanosec, length = struct.unpack_from("<iII", message, 4)
    begin = 4 + -(-(12 + length) // 8) * 8
    return sec * 1_000_000_000 + nanosec, struct.unpack_from("<6d", message, begin)


if __name__ == "__main__":
    main()
