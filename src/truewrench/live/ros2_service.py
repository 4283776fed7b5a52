"""The tare as a ROS 2 service, std_srvs/srv/Trigger, where rclpy can be imported.

Topics of different middlewares talk to each other, services do not: whoever calls it needs the middleware of
the rclpy that is installed here. The topic of the same name does without.
"""

import importlib
import importlib.util
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_LONGEST = 2.0  # [s] that a caller waits for an answer

Answer = Callable[[bool, str], None]


class TareService:
    """Calls that wait for an answer; without rclpy there are none."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[Answer] = queue.SimpleQueue()

    def asked(self) -> Iterator[Answer]:
        """Calls since the last time, each to be answered with success and a message."""
        while not self._calls.empty():
            yield self._calls.get()

    def call(self, request: Any, response: Any) -> Any:
        """Serve a call, in rclpy's thread."""
        done, said = threading.Event(), list[tuple[bool, str]]()

        def answer(accepted: bool, reason: str) -> None:
            said.append((accepted, reason))
            done.set()

        self._calls.put(answer)
        done.wait(_LONGEST)
        response.success, response.message = said[0] if said else (False, "no answer")
        return response


@contextmanager
def tare_service(name: str, complain: Callable[[str], None]) -> Iterator[TareService]:
    """The service, while the context lasts."""
    service = TareService()
    if importlib.util.find_spec("rclpy") is None or importlib.util.find_spec("std_srvs") is None:
        yield service
        return
    try:
        rclpy, kinds = importlib.import_module("rclpy"), importlib.import_module("std_srvs.srv")
        context = rclpy.context.Context()
        rclpy.init(context=context)
        node = rclpy.create_node("truewrench", context=context)
        node.create_service(kinds.Trigger, name, service.call)
        executor = importlib.import_module("rclpy.executors").SingleThreadedExecutor(context=context)
        executor.add_node(node)
    except Exception as error:  # a ROS that is half installed costs no more than the service
        complain(f"{name}: no service: {type(error).__name__}: {error}")
        yield service
        return
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        yield service
    finally:
        executor.shutdown(timeout_sec=1.0)
        thread.join(1.0)
        node.destroy_node()
        rclpy.shutdown(context=context)
