"""A zenoh program of the demo: ROS 2 topics without ROS 2, with zenoh-ros2-sdk, which shares no code with Midspan.

Usage: ``python -m bridge.demo.topics_demo.zenoh_program ROUTER_PORT DOMAIN``. Message definitions and type hashes come
from the Python package rosbags and are passed to the SDK, which would otherwise fetch them from the network.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from rosbags.typesys import Stores, get_typestore
from typing_extensions import override
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
from zenoh_ros2_sdk.session import ZenohSession

from bridge.demo.topics_demo import messages
from bridge.demo.topics_demo.report import TopicsProgram, serve

_JAZZY = get_typestore(Stores.ROS2_JAZZY)
_LATCHED = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=100)


class ZenohProgram(TopicsProgram):
    """The program's endpoints and what it received."""

    def __init__(self, port: int, domain: int) -> None:
        super().__init__()
        self._where = {"domain_id": domain, "router_port": port}
        self._endpoints: list[Any] = []
        self._late: dict[str, Any] = {}
        self._velocity = self._publisher(messages.CMD_VEL, "geometry_msgs/msg/Twist")
        self._hello = self._publisher(messages.FROM_ZENOH, "std_msgs/msg/String")
        self._subscribe("sensor_msgs/msg/LaserScan", messages.SCAN, messages.stamp, messages.scan)
        self._subscribe("nav_msgs/msg/Odometry", messages.ODOM, messages.stamp, self._odometry)
        self._subscribe("tf2_msgs/msg/TFMessage", messages.TF, messages.first_stamp, messages.frames)
        self._subscribe("sensor_msgs/msg/Image", messages.IMAGE, messages.stamp, messages.image)
        for topic in messages.HELLOS:
            self._subscribe("std_msgs/msg/String", topic, messages.text, messages.text)

    @override
    def join_late(self) -> None:
        """Subscribe to topics that were published once, long ago; a later call subscribes to those not received yet."""
        for topic, type_, key, detail in (
            (messages.MAP, "nav_msgs/msg/OccupancyGrid", messages.stamp, messages.grid),
            (messages.TF_STATIC, "tf2_msgs/msg/TFMessage", lambda _message: None, self._mounts),
        ):
            if self.reporter.received(topic).count:
                continue
            if topic in self._late:
                self._late[topic].close()
            self._late[topic] = self._subscribe(type_, topic, key, detail, _LATCHED)

    @override
    def _send(self, linear: float, angular: float) -> None:
        vector: Any = _JAZZY.types["geometry_msgs/msg/Vector3"]
        self._velocity.publish(linear=vector(x=linear, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=angular))

    @override
    def _publish_hello(self, text: str) -> None:
        self._hello.publish(data=text)

    @override
    def close(self) -> None:
        """Close the session, because a process that exits with an open zenoh session hangs."""
        for endpoint in self._endpoints:
            endpoint.close()
        ZenohSession.get_instance().close()

    def _publisher(self, topic: str, type_: str) -> Any:
        publisher = ROS2Publisher(topic, type_, **_definition(type_), **self._where)
        self._endpoints.append(publisher)
        return publisher

    def _subscribe(
        self, type_: str, topic: str, key: Callable[[Any], Any], detail: Callable[[Any], str], qos: Any = None
    ) -> Any:
        received = self.reporter.received(topic)
        subscriber = ROS2Subscriber(
            topic, type_, lambda m: received.add(key(m), detail(m)), qos=qos, **_definition(type_), **self._where
        )
        self._endpoints.append(subscriber)
        return subscriber


def _definition(type_: str) -> dict[str, str]:
    text, _ = _JAZZY.generate_msgdef(type_, ros_version=2)
    return {"msg_definition": text, "type_hash": f"RIHS01_{_JAZZY.hash_rihs01(type_).removeprefix('RIHS01_')}"}


def main() -> int:
    """Run until standard input ends."""
    serve(ZenohProgram(int(sys.argv[1]), int(sys.argv[2])), "zenoh")
    return 0


if __name__ == "__main__":
    sys.exit(main())
