"""A real ROS 2 node (rclpy) that plays streams of numbers by their stamps, and prints the wrenches it hears.

The first line of the input is one JSON object: `streams` {topic: [type, [[stamp ns, [numbers]], ...]]},
`listen` (topics of wrenches) and `pause` (a stamp). Messages without a stamp go out on every topic until a
second line of the input says that all of them have been heard; those with stamps follow, as fast as time
passes, but from the pause on not before a third line. The output is one list of
[topic, stamp ns, [six numbers]].
"""

import json
import sys
import threading
import time
from functools import reduce
from typing import Any

import rclpy
from geometry_msgs.msg import TwistStamped, Vector3Stamped, WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Temperature

TYPES = {
    "geometry_msgs/msg/WrenchStamped": (WrenchStamped, ["wrench.force", "wrench.torque"]),
    "geometry_msgs/msg/TwistStamped": (TwistStamped, ["twist.linear", "twist.angular"]),
    "geometry_msgs/msg/Vector3Stamped": (Vector3Stamped, ["vector"]),
    "sensor_msgs/msg/Temperature": (Temperature, []),
}

asked: dict[str, Any] = json.loads(sys.stdin.readline())
rclpy.init()
node = rclpy.create_node("robot")
quality = QoSProfile(depth=10_000)
publishers = {
    topic: node.create_publisher(TYPES[kind][0], topic, quality)
    for topic, (kind, _) in asked["streams"].items()
}
received: list[Any] = []


def note(topic: str, message: WrenchStamped) -> None:
    """Keep a wrench."""
    f, n, stamp = message.wrench.force, message.wrench.torque, message.header.stamp
    received.append([topic, stamp.sec * 10**9 + stamp.nanosec, [f.x, f.y, f.z, n.x, n.y, n.z]])


for name in asked["listen"]:
    node.create_subscription(WrenchStamped, name, lambda message, name=name: note(name, message), quality)
executor = SingleThreadedExecutor()
executor.add_node(node)


def publish(topic: str, stamp: int, values: list[float]) -> None:
    """One message."""
    kind, vectors = TYPES[asked["streams"][topic][0]]
    message = kind()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    for k, path in enumerate(vectors):
        vector = reduce(getattr, path.split("."), message)
        vector.x, vector.y, vector.z = values[3 * k : 3 * k + 3]
    if not vectors:
        message.temperature = values[0]
    publishers[topic].publish(message)


heard, resumed = threading.Event(), threading.Event()


def listen() -> None:
    """The further lines of the input."""
    for event in (heard, resumed):
        if sys.stdin.readline():
            event.set()


threading.Thread(target=listen, daemon=True).start()
end = time.monotonic() + 60.0
while not heard.is_set() and time.monotonic() < end:
    for topic, (_, samples) in asked["streams"].items():
        publish(topic, 0, samples[0][1])
    executor.spin_once(timeout_sec=0.1)

events = sorted((stamp, topic, values) for topic, (_, of) in asked["streams"].items() for stamp, values in of)
begun, first = time.monotonic(), events[0][0]
end = begun + 60.0
for stamp, topic, values in events:
    while stamp >= asked["pause"] and not resumed.is_set() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
        begun, first = time.monotonic(), stamp
    due = begun + 1e-9 * (stamp - first)
    while time.monotonic() < due:
        executor.spin_once(timeout_sec=max(0.0, due - time.monotonic()))
    publish(topic, stamp, values)
end = time.monotonic() + 2.0
while time.monotonic() < end:
    executor.spin_once(timeout_sec=0.1)
print(json.dumps(received))  # noqa: T201
