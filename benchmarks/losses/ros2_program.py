"""A ROS 2 program: standard rclpy. Usage: ``python -m benchmarks.losses.ros2_program NAME``."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import Twist, Vector3
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from typing_extensions import override

from benchmarks.losses.program import MEGABYTE, Program

DEPTH = 100
KINDS = {"stream": Vector3, "cmd_vel": Twist, "large": String}


class Ros2Program(Program):
    """A program with one rclpy node."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        rclpy.init()
        self._node: Any = rclpy.create_node(name)
        self._publishers: dict[str, Any] = {}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._spinner = threading.Thread(target=self._spin, name="spin", daemon=True)
        self._spinner.start()

    @override
    def open(self) -> None:
        for kind, type_ in KINDS.items():
            self._publishers[kind] = self._node.create_publisher(type_, f"/{self.name}/{kind}", DEPTH)
        self._publishers["state"] = self._node.create_publisher(String, "/state", _latched(1))
        self._node.create_subscription(String, "/state", lambda m: self.record_line(m.data), _latched(DEPTH))

    @override
    def publish(self, kind: str, sent: float, number: int) -> None:
        if kind == "clock":
            return  # only the ROS 1 program publishes /clock
        point = Vector3(x=sent, y=float(number))
        large = kind == "large"
        message = String(data=MEGABYTE) if large else Twist(linear=point) if kind == "cmd_vel" else point
        self._publishers[kind].publish(message)

    @override
    def publish_state(self, line: str) -> None:
        self._publishers["state"].publish(String(data=line))

    @override
    def listen(self, source: str) -> None:
        if source == "clock":
            self._node.create_subscription(Clock, "/clock", self._on_clock, DEPTH)
            return
        for kind, type_ in KINDS.items():
            self._node.create_subscription(type_, f"/{source}/{kind}", self.recorder(source, kind), DEPTH)

    def _on_clock(self, message: Any) -> None:
        self.record_message("/clock", message.clock.sec + message.clock.nanosec / 1e9, 0.0)

    @override
    def late(self, take: Callable[[str], None]) -> Callable[[], None]:
        subscription = self._node.create_subscription(String, "/state", lambda m: take(m.data), _latched(DEPTH))
        self._executor.wake()
        return lambda: self._node.destroy_subscription(subscription)

    @override
    def nodes(self) -> list[str]:
        return list(self._node.get_node_names())

    @override
    def close(self) -> None:
        self._executor.shutdown(2.0)
        self._spinner.join(2.0)
        self._node.destroy_node()  # otherwise other participants consider it alive until its lease expires
        rclpy.shutdown()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return


def _latched(depth: int) -> Any:
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    Ros2Program(sys.argv[1]).run(silent="silent" in sys.argv)
