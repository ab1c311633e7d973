"""A stand-in for Nav2: an action server of NavigateToPose on rclpy, whose robot is a point that the stand-in moves.

As nav2_bt_navigator (Jazzy): one goal at a time, a new one has the old one ABORTED; ``/goal_pose`` becomes a goal;
feedback with what is left; an abort has a code and a text. Goals with x of 900 and more are unreachable.
Usage: ros2_nav2.py SPEED PATIENCE
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Path
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node

PERIOD = 0.1
UNREACHABLE = 900.0
NO_PATH = 208
"""``NO_VALID_PATH`` of ComputePathToPose."""


class Navigator(Node):
    """One goal at a time."""

    def __init__(self, speed: float, patience: float) -> None:
        super().__init__("bt_navigator")
        self.speed, self.patience = speed, patience
        self.x = self.y = 0.0
        self.newest: Any = None
        self.lock = threading.Lock()
        group = ReentrantCallbackGroup()
        self.path = self.create_publisher(Path, "plan", 1)
        self.server = ActionServer(
            self,
            NavigateToPose,
            "navigate_to_pose",
            self.execute,
            callback_group=group,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )
        self.itself = ActionClient(self, NavigateToPose, "navigate_to_pose", callback_group=group)
        self.create_subscription(PoseStamped, "goal_pose", self.asked, 1, callback_group=group)

    def asked(self, pose: PoseStamped) -> None:
        self.itself.send_goal_async(NavigateToPose.Goal(pose=pose))

    def execute(self, handle: Any) -> Any:
        with self.lock:
            self.newest = handle
        goal, began = handle.request.pose, time.monotonic()
        self.path.publish(Path(header=goal.header, poses=[goal]))
        while True:
            result = self.step(handle, goal, began)
            if result is not None:
                return result
            time.sleep(PERIOD)

    def step(self, handle: Any, goal: PoseStamped, began: float) -> Any:
        """One control cycle; the result where it ended."""
        if handle.is_cancel_requested:
            handle.canceled()
            return NavigateToPose.Result()
        if self.newest is not handle:
            handle.abort()
            return NavigateToPose.Result()
        place = goal.pose.position
        if place.x >= UNREACHABLE:
            if time.monotonic() - began < self.patience:
                return None
            handle.abort()
            return NavigateToPose.Result(error_code=NO_PATH, error_msg="no valid path to the goal")
        left = math.hypot(place.x - self.x, place.y - self.y)
        step = min(1.0, self.speed * PERIOD / left) if left else 1.0
        self.x, self.y = self.x + step * (place.x - self.x), self.y + step * (place.y - self.y)
        feedback = NavigateToPose.Feedback(distance_remaining=left * (1.0 - step))
        feedback.current_pose.header.frame_id = "map"
        feedback.current_pose.pose.position.x, feedback.current_pose.pose.position.y = self.x, self.y
        handle.publish_feedback(feedback)
        if step < 1.0:
            return None
        handle.succeed()
        return NavigateToPose.Result()


def main() -> None:
    rclpy.init()
    executor = MultiThreadedExecutor(4)
    executor.add_node(Navigator(float(sys.argv[1]), float(sys.argv[2])))
    print("ready", flush=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


main()
