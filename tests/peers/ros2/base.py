"""A robot's base on ROS 2, which follows ``/cmd_vel`` and publishes ``/tf``, like the base on ROS 1.

Usage: base.py [--ramp M/S2] [--watchdog S] [--no-odometry]
"""

from __future__ import annotations

import contextlib
import math
import sys
from pathlib import Path

import rclpy
from geometry_msgs.msg import TransformStamped, Twist
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from tf2_msgs.msg import TFMessage

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.sim.base_body import PERIOD, Body, arguments


class Base(Node):
    """The node of the base."""

    def __init__(self) -> None:
        super().__init__("base")
        options = arguments()
        self.body, self.odometry = Body(options.ramp, options.watchdog), options.odometry
        self.frames = self.create_publisher(TFMessage, "tf", 10)
        self.create_subscription(Twist, "cmd_vel", self.on_velocity, 1)
        self.create_timer(PERIOD, self.step)

    def on_velocity(self, twist: Twist) -> None:
        self.body.command(twist.linear.x, twist.linear.y, twist.angular.z)

    def step(self) -> None:
        frames = self.body.frames(*self.body.step(), odometry=self.odometry)
        self.frames.publish(TFMessage(transforms=[self.transform(*frame) for frame in frames]))

    def transform(self, parent: str, child: str, x: float, y: float, yaw: float) -> TransformStamped:
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id, message.header.stamp = parent, self.get_clock().now().to_msg()
        message.transform.translation.x, message.transform.translation.y = x, y
        message.transform.rotation.z, message.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        return message


def main() -> None:
    rclpy.init()
    executor = SingleThreadedExecutor()
    executor.add_node(Base())
    print("ready", flush=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


main()
