"""A ROS 2 program of the demo: listens to the robot, says hello and drives; plain typed rclpy over DDS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import Image, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from bridge.demo import topics, wording
from bridge.demo.report import Voice

_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # type: ignore[no-untyped-call]


class Listener:
    """The node and what it heard."""

    def __init__(self) -> None:
        self.voice = Voice(self._state)
        self.node = rclpy.create_node("demo_ros2")
        self._pose: list[float] | None = None
        self._hellos = 0
        self._static_frames: set[str] = set()
        self._drive = self.node.create_publisher(Twist, topics.CMD_VEL, 10)
        self._hello = self.node.create_publisher(String, topics.FROM_ROS2, 10)
        self.node.create_timer(1 / topics.HELLO_RATE, self._say_hello)
        self._hear(LaserScan, topics.SCAN, wording.stamp, wording.scan, qos_profile_sensor_data)
        self._hear(Odometry, topics.ODOM, wording.stamp, self._odometry, 10)
        self._hear(TFMessage, topics.TF, wording.first_stamp, wording.frames, 50)
        self._hear(Image, topics.IMAGE, wording.stamp, wording.image, qos_profile_sensor_data)
        for topic in topics.HELLOS:
            self._hear(String, topic, wording.text, wording.text, 10)

    def join_late(self) -> None:
        """Listen to what was published once, long ago."""
        self._hear(OccupancyGrid, topics.MAP, wording.stamp, wording.grid, _LATCHED)
        self._hear(TFMessage, topics.TF_STATIC, lambda _message: None, self._mounts, _LATCHED)

    def drive(self, linear: float, angular: float, seconds: float) -> None:
        """Publish a velocity for some seconds, then fall silent; tells where the robot was and is."""
        before, sent = self._pose, 0
        twist = Twist()
        twist.linear.x, twist.angular.z = linear, angular
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._drive.publish(twist)
            sent += 1
            time.sleep(1 / topics.DRIVE_RATE)
        self.voice.tell("drove", before=before, after=self._pose, sent=sent)

    def _hear(
        self,
        type_: type,
        topic: str,
        key: Callable[[Any], Any],
        detail: Callable[[Any], str],
        qos: QoSProfile | int,
    ) -> None:
        ear = self.voice.ear(topic)
        self.node.create_subscription(type_, topic, lambda m: ear.hear(key(m), detail(m)), qos)

    def _say_hello(self) -> None:
        self._hellos += 1
        self._hello.publish(String(data=f"hello {self._hellos} from ROS 2"))

    def _odometry(self, message: Odometry) -> str:
        self._pose = wording.pose(message)
        return wording.position(message)

    def _mounts(self, message: TFMessage) -> str:
        self._static_frames.update(t.child_frame_id for t in message.transforms)
        return ", ".join(sorted(self._static_frames))

    def _state(self) -> dict[str, Any]:
        return {"pose": self._pose}


def main() -> int:
    """Run until the standard input ends."""
    rclpy.init()
    listener = Listener()
    executor = SingleThreadedExecutor()
    executor.add_node(listener.node)

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            return

    spinner = threading.Thread(target=spin, name="spin", daemon=True)
    spinner.start()
    try:
        listener.voice.tell("ready")
        listener.voice.attend({"drive": listener.drive, "join_late": listener.join_late})
    finally:
        executor.shutdown(2.0)
        spinner.join(2.0)
        rclpy.shutdown()  # destroys the node
    return 0


if __name__ == "__main__":
    sys.exit(main())
