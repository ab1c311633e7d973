"""A ROS 2 program of the demo: subscribes to the robot, publishes greetings and drives, with plain rclpy over DDS."""

from __future__ import annotations

import sys
import threading
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
from typing_extensions import override

from bridge.demo.topics_demo import messages
from bridge.demo.topics_demo.report import TopicsProgram, serve

_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # type: ignore[no-untyped-call]


class Ros2Program(TopicsProgram):
    """The node, and what it received."""

    def __init__(self) -> None:
        super().__init__()
        self.node = rclpy.create_node("demo_ros2")
        self._velocity = self.node.create_publisher(Twist, messages.CMD_VEL, 10)
        self._hello = self.node.create_publisher(String, messages.FROM_ROS2, 10)
        self._subscribe(LaserScan, messages.SCAN, messages.stamp, messages.scan, qos_profile_sensor_data)
        self._subscribe(Odometry, messages.ODOM, messages.stamp, self._odometry, 10)
        self._subscribe(TFMessage, messages.TF, messages.first_stamp, messages.frames, 50)
        self._subscribe(Image, messages.IMAGE, messages.stamp, messages.image, qos_profile_sensor_data)
        for topic in messages.HELLOS:
            self._subscribe(String, topic, messages.text, messages.text, 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._spinner = threading.Thread(target=self._spin, name="spin", daemon=True)
        self._spinner.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    @override
    def join_late(self) -> None:
        self._subscribe(OccupancyGrid, messages.MAP, messages.stamp, messages.grid, _LATCHED)
        self._subscribe(TFMessage, messages.TF_STATIC, lambda _message: None, self._mounts, _LATCHED)

    @override
    def close(self) -> None:
        self._executor.shutdown(2.0)
        self._spinner.join(2.0)
        rclpy.shutdown()  # destroys the node

    @override
    def _send(self, linear: float, angular: float) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = linear, angular
        self._velocity.publish(twist)

    @override
    def _publish_hello(self, text: str) -> None:
        self._hello.publish(String(data=text))

    def _subscribe(
        self, type_: type, topic: str, key: Callable[[Any], Any], detail: Callable[[Any], str], qos: QoSProfile | int
    ) -> None:
        received = self.reporter.received(topic)
        self.node.create_subscription(type_, topic, lambda m: received.add(key(m), detail(m)), qos)


def main() -> int:
    """Run until standard input ends."""
    rclpy.init()
    serve(Ros2Program(), "ROS 2")
    return 0


if __name__ == "__main__":
    sys.exit(main())
