"""Stand-ins for Nav2's controller_server (FollowPath) and behavior_server (Jazzy), action servers on rclpy.

They follow the public sources (ros-navigation/navigation2, branch jazzy: controller_server.cpp,
simple_action_server.hpp, timed_behavior.hpp and the behavior plugins):

- A new path replaces the old one without a stop; the old goal ends ABORTED without a code.
- A canceled path continues for ``--braking`` seconds, like a controller that brakes by itself; then the goal ends, and
  zero velocity follows. Without transforms, the robot stops and the goal ends ABORTED with code 102.
- A behavior first stops the robot, then ends. A second goal of a behavior ends the first one ABORTED.
- assisted_teleop repeats the last velocity of ``/cmd_vel_teleop`` until it receives another one.

Only the path's last pose matters. A behavior with a target of 0 runs until its time is over, as do spin and
assisted_teleop.
Usage: controller.py controller_server|behavior_server SPEED [--braking S] [--tf-tolerance S]
"""

from __future__ import annotations

import argparse
import contextlib
import math
import pathlib
import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav2_msgs.action import AssistedTeleop, BackUp, DriveOnHeading, FollowPath, Spin
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[3]))

from tests.peers.ros2.transforms import Pose, Transforms

PERIOD = 0.05
NEAR, GAIN = 0.05, 5.0
"""Meters within which the goal is reached; speed per meter of remaining distance, 1/s."""
TURN = 1.0
TF_ERROR, INVALID_PATH = 102, 103


def twist(x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> Twist:
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = x, y, turn
    return message


class Server:
    """One Nav2 action. Each goal runs on a thread, and is preempted by a newer goal."""

    def __init__(self, node: Driving, type_: Any, action: str) -> None:
        self.node, self.type = node, type_
        self.newest: Any = None
        self.lock = threading.Lock()
        self.handle = ActionServer(
            node,
            type_,
            action,
            self.execute,
            callback_group=node.group,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )

    def execute(self, handle: Any) -> Any:
        with self.lock:
            self.newest = handle
        began = time.monotonic()
        start = self.node.transforms.pose()
        while True:
            code = self.step(handle, start, time.monotonic() - began)
            if code is not None:
                return self.type.Result(error_code=code)
            time.sleep(PERIOD)

    def step(self, handle: Any, start: Pose | None, seconds: float) -> int | None:
        """Run one control cycle; return the result's code if the goal has ended."""
        raise NotImplementedError


class Path(Server):
    """Follows a path."""

    braking: float | None = None

    def step(self, handle: Any, _start: Pose | None, _seconds: float) -> int | None:
        if self.newest is not handle:
            handle.abort()
            return 0
        if handle.is_cancel_requested:
            self.braking = time.monotonic() if self.braking is None else self.braking
            if time.monotonic() >= self.braking + self.node.options.braking:
                self.braking = None
                handle.canceled()
                self.node.velocity.publish(twist())
                return 0
        if not handle.request.path.poses:
            handle.abort()
            return INVALID_PATH
        pose, place = self.node.transforms.pose(), handle.request.path.poses[-1].pose.position
        if pose is None:
            self.node.velocity.publish(twist())
            handle.abort()
            return TF_ERROR
        dx, dy = place.x - pose[0], place.y - pose[1]
        left = math.hypot(dx, dy)
        if left < NEAR:
            self.node.velocity.publish(twist())
            handle.succeed()
            return 0
        speed = min(self.node.options.speed, GAIN * left)
        handle.publish_feedback(FollowPath.Feedback(distance_to_goal=left, speed=speed))
        heading = math.atan2(dy, dx) - pose[2]
        self.node.velocity.publish(twist(speed * math.cos(heading), speed * math.sin(heading)))
        return None


class Behavior(Server):
    """Moves the robot for a distance, an angle or a time."""

    def step(self, handle: Any, start: Pose | None, seconds: float) -> int | None:
        if self.newest is not handle:
            return self.end(handle.abort)
        if handle.is_cancel_requested:
            return self.end(handle.canceled)
        allowance = handle.request.time_allowance
        if 0 < allowance.sec + allowance.nanosec / 1e9 < seconds:
            return self.end(handle.abort)
        pose = self.node.transforms.pose()
        if pose is None or start is None:
            return self.end(handle.abort)
        if self.done(handle.request, math.hypot(pose[0] - start[0], pose[1] - start[1])):
            return self.end(handle.succeed)
        self.node.velocity.publish(self.command(handle.request))
        return None

    def end(self, how: Any) -> int:
        self.node.velocity.publish(twist())
        how()
        return 0

    def done(self, request: Any, moved: float) -> bool:
        target = getattr(request, "target", None)
        return target is not None and 0 < abs(target.x) <= moved

    def command(self, request: Any) -> Twist:
        if self.type is AssistedTeleop:
            return self.node.teleop
        if self.type is Spin:
            return twist(turn=math.copysign(TURN, request.target_yaw))
        return twist(math.copysign(request.speed, -1.0) if self.type is BackUp else request.speed)


class Driving(Node):
    """The node of one of the two servers."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__(options.server)
        self.options = options
        self.group = ReentrantCallbackGroup()
        self.velocity = self.create_publisher(Twist, "cmd_vel", 1)
        self.transforms = Transforms(self, options.tf_tolerance, self.group)
        self.teleop = twist()
        if options.server == "controller_server":
            self.servers: list[Server] = [Path(self, FollowPath, "follow_path")]
            return
        self.create_subscription(Twist, "cmd_vel_teleop", self.on_teleop, 1, callback_group=self.group)
        types = {"spin": Spin, "backup": BackUp, "drive_on_heading": DriveOnHeading, "assisted_teleop": AssistedTeleop}
        self.servers = [Behavior(self, type_, action) for action, type_ in types.items()]

    def on_teleop(self, message: Twist) -> None:
        self.teleop = message


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("server", choices=("controller_server", "behavior_server"))
    parser.add_argument("speed", type=float)
    parser.add_argument("--braking", type=float, default=0.0)
    parser.add_argument("--tf-tolerance", type=float, default=1.0)
    rclpy.init()
    executor = MultiThreadedExecutor(4)
    node = Driving(parser.parse_args())
    executor.add_node(node)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        spinner.start()
        node.transforms.wait()
        print("ready", flush=True)
        spinner.join()


main()
