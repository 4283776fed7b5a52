"""A real ROS 2 node (rclpy): publishes what it is told on standard input, and prints what it received.

The first line of the input is one JSON object: `wrenches` [[stamp ns, frame, [six numbers]], ...], `joints`
[[stamp ns, names, positions, velocities], ...], `listen` (topics of corrected wrenches), `until` (messages to
wait for there), `reliable` and `diagnostics` (whether to wait for a final one).

Before that it makes sure that the other side hears: by wrenches of the frame `probe` until one comes back, or
by messages without a stamp until another line of the input says that they have been refused.
"""

import json
import sys
import threading
import time
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

asked: dict[str, Any] = json.loads(sys.stdin.readline())
PATIENCE = 60.0  # [s] for everything

rclpy.init()
node = rclpy.create_node("driver")
quality = QoSProfile(depth=10_000)
if not asked.get("reliable", True):
    quality.reliability = ReliabilityPolicy.BEST_EFFORT
wrenches = node.create_publisher(WrenchStamped, "/ft/wrench_raw", quality)
publishers = [wrenches]
if "joints" in asked:
    publishers.append(joints := node.create_publisher(JointState, "/joint_states", quality))

received: list[Any] = []
diagnostics: list[Any] = []


def note(message: WrenchStamped) -> None:
    """Keep a corrected wrench."""
    f, n = message.wrench.force, message.wrench.torque
    stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    received.append([stamp, message.header.frame_id, [f.x, f.y, f.z, n.x, n.y, n.z]])


def diagnose(message: DiagnosticArray) -> None:
    """Keep a diagnostic."""
    status = message.status[0]
    values = {item.key: item.value for item in status.values}
    diagnostics.append([status.level[0], status.name, status.message, values])


expected = [(topic, WrenchStamped) for topic in asked.get("listen", [])]
if asked.get("diagnostics"):
    expected.append(("/diagnostics", DiagnosticArray))
for topic, kind in expected:
    node.create_subscription(kind, topic, note if kind is WrenchStamped else diagnose, 10_000)

executor = SingleThreadedExecutor()
executor.add_node(node)
end = time.monotonic() + PATIENCE


def spin_until(done: Any) -> None:
    """Serve the node until something holds, at most until the end."""
    while not done() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.02)


spin_until(
    lambda: (
        all(p.get_subscription_count() for p in publishers)
        and all(node.count_publishers(topic) for topic, _ in expected)
    )
)


def stamped(time_ns: int) -> Time:
    """A stamp."""
    return Time(sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000)


def publish_wrench(stamp: int, frame: str, values: list[float]) -> None:
    """One sample of the sensor."""
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = stamped(stamp), frame
    f, n = message.wrench.force, message.wrench.torque
    f.x, f.y, f.z, n.x, n.y, n.z = values
    wrenches.publish(message)


def publish_joints(stamp: int, names: list[str], position: list[float], velocity: list[float]) -> None:
    """One sample of the joints."""
    message = JointState(name=names, position=position, velocity=velocity)
    message.header.stamp = stamped(stamp)
    joints.publish(message)


first, probes = asked["wrenches"][0][0], 0
heard = threading.Event()
if not asked.get("listen"):
    threading.Thread(target=lambda: sys.stdin.readline() and heard.set(), daemon=True).start()
while not (received or heard.is_set()) and time.monotonic() < end:
    probes += 1
    publish_wrench(first - 1_000_000_000 + probes if asked.get("listen") else 0, "probe", [0.0] * 6)
    if "joints" in asked:
        publish_joints(0, ["probe"], [0.0], [])
    executor.spin_once(timeout_sec=0.05)
    time.sleep(0.05)
step = time.monotonic() + 0.5  # for the last probes to come back
while time.monotonic() < step:
    executor.spin_once(timeout_sec=0.02)
received.clear()

events = [(w[0], publish_wrench, w) for w in asked["wrenches"]]
events += [(j[0], publish_joints, j) for j in asked.get("joints", [])]
for _, publish, arguments in events if "joints" not in asked else sorted(events, key=lambda e: e[0]):
    publish(*arguments)
    executor.spin_once(timeout_sec=0.0)
    time.sleep(0.0005)
if asked.get("diagnostics"):
    spin_until(lambda: diagnostics and diagnostics[-1][3]["final"] == "true")
else:
    spin_until(lambda: len(received) >= asked.get("until", 0))


def shown(info: Any) -> list[str]:
    """What `ros2 topic info -v` shows of an endpoint."""
    return [info.topic_type, str(info.topic_type_hash), info.qos_profile.reliability.name]


endpoints = {topic: [shown(i) for i in node.get_publishers_info_by_topic(topic)] for topic, _ in expected}
for own in ("/ft/wrench_raw", "/joint_states"):
    endpoints[own] = [shown(i) for i in node.get_subscriptions_info_by_topic(own)]
own_hash = {
    topic: [str(i.topic_type_hash) for i in node.get_publishers_info_by_topic(topic)]
    for topic in ("/ft/wrench_raw", "/joint_states")
}
found = {"received": received, "diagnostics": diagnostics, "endpoints": endpoints, "own": own_hash}
print(json.dumps(found))  # noqa: T201
