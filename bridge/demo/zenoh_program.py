"""A zenoh program of the demo: ROS 2 topics without ROS 2, by zenoh-ros2-sdk, which shares no code with Midspan.

Usage: ``python -m bridge.demo.zenoh_program ROUTER_PORT DOMAIN``. Message definitions and type hashes are rosbags',
given to the SDK whole, since it would fetch them from the network otherwise.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
from zenoh_ros2_sdk.session import ZenohSession

from bridge.demo import topics, wording
from bridge.demo.report import Voice, serve

_JAZZY = get_typestore(Stores.ROS2_JAZZY)
_LATCHED = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=100)


class Listener:
    """The program's endpoints and what it heard."""

    def __init__(self, port: int, domain: int) -> None:
        self._where = {"domain_id": domain, "router_port": port}
        self._endpoints: list[Any] = []
        self._late: dict[str, Any] = {}
        self._pose: list[float] | None = None
        self._static_frames: set[str] = set()
        self.voice = Voice(self._state)
        self._drive = self._publisher(topics.CMD_VEL, "geometry_msgs/msg/Twist")
        self._hello = self._publisher(topics.FROM_ZENOH, "std_msgs/msg/String")
        self._hear("sensor_msgs/msg/LaserScan", topics.SCAN, wording.stamp, wording.scan)
        self._hear("nav_msgs/msg/Odometry", topics.ODOM, wording.stamp, self._odometry)
        self._hear("tf2_msgs/msg/TFMessage", topics.TF, wording.first_stamp, wording.frames)
        self._hear("sensor_msgs/msg/Image", topics.IMAGE, wording.stamp, wording.image)
        for topic in topics.HELLOS:
            self._hear("std_msgs/msg/String", topic, wording.text, wording.text)

    def join_late(self) -> None:
        """Listen to what was published once, long ago; asked again, to what has not come."""
        for topic, type_, key, detail in (
            (topics.MAP, "nav_msgs/msg/OccupancyGrid", wording.stamp, wording.grid),
            (topics.TF_STATIC, "tf2_msgs/msg/TFMessage", lambda _message: None, self._mounts),
        ):
            if self.voice.ear(topic).count:
                continue
            if topic in self._late:
                self._late[topic].close()
            self._late[topic] = self._hear(type_, topic, key, detail, _LATCHED)

    def drive(self, linear: float, angular: float, seconds: float) -> None:
        """Publish a velocity for some seconds, then fall silent; tells where the robot was and is."""
        before, sent = self._pose, 0
        vector: Any = _JAZZY.types["geometry_msgs/msg/Vector3"]
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._drive.publish(linear=vector(x=linear, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=angular))
            sent += 1
            time.sleep(1 / topics.DRIVE_RATE)
        self.voice.tell("drove", before=before, after=self._pose, sent=sent)

    def say_hello(self, ended: threading.Event) -> None:
        """Say hello once in a while until the event is set."""
        number = 0
        while not ended.wait(1 / topics.HELLO_RATE):
            number += 1
            self._hello.publish(data=f"hello {number} from zenoh")

    def close(self) -> None:
        """Leave the network; a process that ends with an open zenoh session hangs."""
        for endpoint in self._endpoints:
            endpoint.close()
        ZenohSession.get_instance().close()

    def _publisher(self, topic: str, type_: str) -> Any:
        publisher = ROS2Publisher(topic, type_, **_definition(type_), **self._where)
        self._endpoints.append(publisher)
        return publisher

    def _hear(
        self, type_: str, topic: str, key: Callable[[Any], Any], detail: Callable[[Any], str], qos: Any = None
    ) -> Any:
        ear = self.voice.ear(topic)
        subscriber = ROS2Subscriber(
            topic, type_, lambda m: ear.hear(key(m), detail(m)), qos=qos, **_definition(type_), **self._where
        )
        self._endpoints.append(subscriber)
        return subscriber

    def _odometry(self, message: Any) -> str:
        self._pose = wording.pose(message)
        return wording.position(message)

    def _mounts(self, message: Any) -> str:
        self._static_frames.update(t.child_frame_id for t in message.transforms)
        return ", ".join(sorted(self._static_frames))

    def _state(self) -> dict[str, Any]:
        return {"pose": self._pose}


def _definition(type_: str) -> dict[str, str]:
    text, _ = _JAZZY.generate_msgdef(type_, ros_version=2)
    return {"msg_definition": text, "type_hash": f"RIHS01_{_JAZZY.hash_rihs01(type_).removeprefix('RIHS01_')}"}


def main() -> int:
    """Run until the standard input ends."""
    serve(Listener(int(sys.argv[1]), int(sys.argv[2])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
