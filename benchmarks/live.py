"""`truewrench stream --ros2` in a real ROS 2 graph on loopback: samples lost, latency: a markdown table.

    python benchmarks/live.py
    python benchmarks/live.py --duration 10 --rate 500

A publisher (rclpy, rmw_fastrtps_cpp, reliable) sends stamped wrenches. Two receive them, each a process:
truewrench, and an rclpy node that publishes what it receives and does nothing else. A subscriber to
both, which reads bytes so as to keep up, takes the time from the stamp to its callback. The first second
is left out, in which everybody is still waking up.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import yaml

SOURCE, OUTPUT, ECHO = "/ft/wrench_raw", "/truewrench/wrench", "/echo/wrench"
SETTLED = 1.0  # [s] of the run that are left out
DEPTH = 5000  # messages kept: nobody's queue is what is measured


def main() -> None:
    arguments = asked(__doc__).parse_args()
    if arguments.role is not None:
        if arguments.role == "publish":
            publish(arguments.count, arguments.rate)
        elif arguments.role == "echo":
            echo()
        else:
            measure(arguments.count)
        return
    graph_of_its_own()
    table(round(arguments.duration * arguments.rate), arguments.rate)


def asked(description: str | None) -> argparse.ArgumentParser:
    """What a user may ask for, and the roles of processes."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--duration", type=float, default=60.0, help="of the stream [s]")
    parser.add_argument("--rate", type=float, default=1000.0, help="of its samples [Hz]")
    parser.add_argument("--role", choices=["publish", "echo", "measure"], help="of a process of its own")
    parser.add_argument("--count", type=int, default=0, help="messages that the role is about")
    return parser


def graph_of_its_own() -> None:
    """On loopback, for this process and those that it starts."""
    os.environ.update(
        RMW_IMPLEMENTATION="rmw_fastrtps_cpp",
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        ROS_DOMAIN_ID=str(random.randint(1, 99)),
    )


def table(count: int, rate: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        command = [
            str(Path(sys.executable).with_name("truewrench")),
            "stream",
            str(calibration(Path(folder))),
        ]
        command += ["--ros2", "--reliable", "--wrench-topic", SOURCE, "--json"]
        live = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        echoing = role("echo")
        measuring = role("measure", count)
        publishing = role("publish", count, rate)
        found = json.loads(measuring.communicate()[0])
        for process in (live, echoing):
            process.send_signal(signal.SIGINT)
        figures = json.loads(live.communicate()[0])["figures"]
        echoing.wait()
        publishing.wait()
    print(f"{count} samples at {rate:g} Hz; truewrench received {figures['received']}\n")
    print("| | samples lost | median | 99 % | largest |\n|---|---|---|---|---|")
    for name, topic in (("`truewrench stream --ros2`", OUTPUT), ("rclpy echo", ECHO)):
        index, latency = np.array(found[topic]).T
        kept = latency[index >= SETTLED * rate] * 1e-3
        print(row(name, count - np.unique(index).size, kept))


def row(name: str, lost: int, latency: Any) -> str:
    """Of the table; latency in microseconds."""
    median, high = np.percentile(latency, [50, 99])
    return f"| {name} | {lost} | {median:.0f} µs | {high:.0f} µs | {latency.max():.0f} µs |"


def role(
    name: str, count: int = 0, rate: float = 0.0, *more: str, script: str = __file__
) -> subprocess.Popen[str]:
    command = [sys.executable, script, "--role", name, "--count", str(count), "--rate", str(rate), *more]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def calibration(folder: Path) -> Path:
    """One that is fit for use, of a short simulated run."""
    from truewrench import calibrate, load_rig
    from truewrench.simulation.free_body import simulate

    rig = folder / "rig.yaml"
    rig.write_text(yaml.safe_dump(yaml.safe_load(RIG)))
    settings = load_rig(rig)
    simulation = simulate(settings)
    path = folder / "calibration.yaml"
    calibrate(settings, simulation.log, "online", held_out=False).write_yaml(path)
    return path


RIG = """
sensor:
  channels: [fx, fy, fz, mx, my, mz]
  feels: payload_on_sensor
  noise: [0.5, 0.5, 0.5, 0.05, 0.05, 0.05]
  range: [500, 500, 500, 50, 50, 50]
payloads:
  default: {mass: 50, center_of_mass: [0.2, 0, 0], inertia: {xx: 1.5, yy: 1.5, zz: 0.4, xy: 0, xz: 0, yz: 0}}
motion: {source: twist, of: com, noise: [1.0e-3, 1.0e-3, 1.0e-3, 1.0e-3, 1.0e-3, 1.0e-3]}
"""


def node(name: str) -> tuple[Any, Any, Any]:
    """A node, the type of its messages and a reliable quality of service."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile

    rclpy.init()
    return rclpy.create_node(name), WrenchStamped, QoSProfile(depth=DEPTH)


def publish(count: int, rate: float) -> None:
    made, kind, quality = node("driver")
    publisher = made.create_publisher(kind, SOURCE, quality)
    while publisher.get_subscription_count() < 2 or not (
        made.count_publishers(OUTPUT) and made.count_publishers(ECHO)
    ):
        time.sleep(0.1)
    time.sleep(1.0)  # for the measuring subscriber to have matched both
    begun = time.perf_counter()
    for index in range(count):
        while (left := begun + index / rate - time.perf_counter()) > 0.0:
            time.sleep(left)
        message = kind()
        message.header.frame_id = str(index)
        message.wrench.force.x = float(index % 100)
        message.header.stamp = made.get_clock().now().to_msg()
        publisher.publish(message)
    time.sleep(2.0)


def spin(made: Any) -> None:
    import rclpy
    from rclpy.executors import ExternalShutdownException

    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(made)


def echo() -> None:
    made, kind, quality = node("echo")
    publisher = made.create_publisher(kind, ECHO, quality)
    made.create_subscription(kind, SOURCE, publisher.publish, quality)
    spin(made)


def measure(count: int) -> None:
    """By topic, index and latency [ns] of every message.

    An executor of rclpy is too slow for two streams; this is what it does, all messages at a time.
    """
    from rclpy.impl.implementation_singleton import rclpy_implementation

    made, kind, quality = node("measure")
    found: dict[str, list[tuple[int, int]]] = {OUTPUT: [], ECHO: []}
    subscriptions = {
        topic: made.create_subscription(kind, topic, lambda _: None, quality, raw=True) for topic in found
    }
    with made.context.handle, ExitStack() as stack:
        handles = {topic: one.handle for topic, one in subscriptions.items()}
        for handle in handles.values():
            stack.enter_context(handle)
        ready = rclpy_implementation.WaitSet(len(handles), 0, 0, 0, 0, 0, made.context.handle)
        last = time.monotonic()
        # until everything has come, or nothing has for a while after the stream has begun
        while (seen := sum(map(len, found.values()))) < 2 * count:
            ready.clear_entities()
            for handle in handles.values():
                ready.add_subscription(handle)
            ready.wait(500_000_000)
            for topic, handle in handles.items():
                while (taken := handle.take_message(kind, True)) is not None:
                    now = time.time_ns()
                    sec, nanosec, length = struct.unpack_from("<iII", taken[0], 4)
                    index = int(taken[0][16 : 15 + length])
                    found[topic].append((index, now - sec * 1_000_000_000 - nanosec))
            now_seen = sum(map(len, found.values()))
            if now_seen > seen or not now_seen:
                last = time.monotonic()
            elif time.monotonic() - last > 5.0:
                break
    print(json.dumps(found))


if __name__ == "__main__":
    main()
