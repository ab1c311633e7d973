"""An rclpy program that creates endpoints, sends, receives and counts."""

from __future__ import annotations

import os
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from typing_extensions import override

from benchmarks.endurance.program import DEPTH, Close, OnMessage, Program
from benchmarks.latency.taker import Taker, message_class


class Ros2Publisher:
    """A raw publisher."""

    def __init__(self, node: Any, topic: str, type_: str, *, latched: bool) -> None:
        self._node = node
        self._publisher = node.create_publisher(message_class(type_), topic, _qos(latched=latched))

    def put(self, payload: bytes) -> None:
        """Publish raw bytes."""
        self._publisher.publish(payload)

    def close(self) -> None:
        self._node.destroy_publisher(self._publisher)


class Ros2Program(Program):
    """A program with one rclpy node."""

    def __init__(self) -> None:
        super().__init__()
        rclpy.init()
        self._node = rclpy.create_node(f"program_{os.getpid()}", enable_rosout=False, start_parameter_services=False)
        self._taker = Taker()

    @override
    def publisher(self, topic: str, type_: str, *, latched: bool) -> Ros2Publisher:
        return Ros2Publisher(self._node, topic, type_, latched=latched)

    @override
    def listen(self, topic: str, type_: str, *, latched: bool, on_message: OnMessage) -> Close:
        return self._taker.listen(self._node, topic, type_, _qos(latched=latched), on_message)

    @override
    def close(self) -> None:
        """Exit at once, without closing the middleware."""
        self._taker.abandon()
        rclpy.shutdown()
        os._exit(0)


def _qos(*, latched: bool) -> Any:
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=DEPTH, durability=durability)  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    Ros2Program().run()
