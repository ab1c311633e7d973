"""A ROS 2 end: rclpy, with raw bytes in both directions."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.qos import QoSProfile
from typing_extensions import override

from benchmarks.latency.end import End
from benchmarks.latency.taker import Taker, message_class

DEPTH = 100
"""History depth for ten seconds at 10 Hz, so that a listener that is not scheduled for a while loses nothing."""


class Ros2End(End):
    """A program with one rclpy node."""

    def __init__(self) -> None:
        super().__init__()
        rclpy.init()
        self._node = rclpy.create_node(f"end_{os.getpid()}", enable_rosout=False, start_parameter_services=False)
        self._taker = Taker()

    @override
    def publisher(self, topic: str, type_: str) -> tuple[Callable[[bytes], None], Callable[[], bool]]:
        publisher = self._node.create_publisher(message_class(type_), topic, _qos())
        return publisher.publish, lambda: publisher.get_subscription_count() > 0

    @override
    def listen(self, topic: str, type_: str, on_message: Callable[[bytes], None]) -> None:
        self._taker.listen(self._node, topic, type_, _qos(), on_message)

    @override
    def close(self) -> None:
        """Exit at once, without closing the middleware."""
        self._taker.abandon()
        rclpy.shutdown()
        os._exit(0)


def _qos() -> Any:
    return QoSProfile(depth=DEPTH)  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    Ros2End().run()
