"""A stand-in for Nav2's bt_navigator (Jazzy), an action server of NavigateToPose on rclpy.

It follows the public sources (ros-navigation/navigation2, branch jazzy: bt_action_node.hpp,
simple_action_server.hpp, navigate_to_pose.cpp) and measurements of Nav2 1.3.13:

- One goal at a time: a new goal ends the old one ABORTED without a code, even if the old one was canceled, and the
  robot drives on.
- ``/goal_pose`` becomes a goal. An abort has a code and no text.
- It only plans; controller_server (`controller.py`) drives, by a FollowPath goal that is sent again each second.
- If controller_server acknowledges a path late, the goal is ABORTED with code 0, and the path is not canceled: the
  robot drives to the path's end. SIGUSR1 makes the next acknowledgment late.
- If another client cancels the path, the behavior tree counts it as done, and the goal ends SUCCEEDED.
- A canceled goal ends after `CANCEL_SECONDS` even if controller_server has not stopped.

Goals with x of 900 and more are unreachable. Without ``--servers``, the stand-in itself moves the robot, a point.
It prints ``ended`` and ``time.monotonic()`` when it cancels a goal.
Usage: nav2.py SPEED PATIENCE [--servers] [--tf-tolerance S]
"""

from __future__ import annotations

import argparse
import contextlib
import math
import pathlib
import signal
import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import FollowPath, NavigateToPose
from nav_msgs.msg import Path
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[3]))

from tests.peers.ros2.calls import on_executor
from tests.peers.ros2.transforms import Transforms

PERIOD = 0.1
PLAN_SECONDS = 1.0
ACKNOWLEDGE_SECONDS = 10.0
"""Seconds. Nav2's default is 0.02 s, which a busy machine exceeds; the tests choose the moment with a signal."""
CANCEL_SECONDS = 0.05
UNREACHABLE = 900.0
TF_ERROR, NO_PATH = 202, 208
"""``TF_ERROR`` and ``NO_VALID_PATH`` of ComputePathToPose."""
SUCCEEDED, CANCELED = 4, 5


class Following:
    """The client of controller_server: a node with its own executor, as in Nav2."""

    def __init__(self) -> None:
        self.node: Any = rclpy.create_node("bt_navigator_navigate_to_pose_rclcpp_node")
        self.client = ActionClient(self.node, FollowPath, "follow_path")
        self.current: Any = None
        self.end: Any = None
        self.lock = threading.Lock()
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def connect(self) -> None:
        """Wait until controller_server responds: a server that is visible may not have discovered its client yet."""
        self.client.wait_for_server()
        print("sees controller_server", flush=True)
        while not self.send(Path(), 1.0):
            pass

    def send(self, path: Path, seconds: float) -> bool:
        """Send a path, and return whether it was acknowledged in time. If it was not, it is never canceled."""
        acknowledged = threading.Event()
        number = object()
        with self.lock:
            self.number, self.end = number, None

        def on_answer(future: Any) -> None:
            with self.lock:
                if self.number is not number:
                    return
                self.current = future.result()
            acknowledged.set()
            future.result().get_result_async().add_done_callback(on_result)

        def on_result(future: Any) -> None:
            with self.lock:
                if self.number is number:
                    self.current, self.end = None, future.result()

        goal = FollowPath.Goal(path=path, controller_id="FollowPath")
        on_executor(self.node, lambda: self.client.send_goal_async(goal).add_done_callback(on_answer))
        if seconds > 0 and acknowledged.wait(seconds):
            return True
        with self.lock:
            self.number = self.current = None
        return False

    def halt(self) -> None:
        """Cancel the path, and wait a moment for its end."""
        with self.lock:
            handle = self.current
        if handle is None:
            return
        on_executor(self.node, handle.cancel_goal_async)
        until = time.monotonic() + CANCEL_SECONDS
        while self.end is None and time.monotonic() < until:
            time.sleep(0.005)
        with self.lock:
            self.number = self.current = None


class Navigator(Node):
    """The node of bt_navigator, which executes one goal at a time."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("bt_navigator")
        self.speed, self.patience = options.speed, options.patience
        self.x = self.y = 0.0
        self.newest: Any = None
        self.gives_up = False
        self.lock = threading.Lock()
        self.group = group = ReentrantCallbackGroup()
        self.following = Following() if options.servers else None
        self.transforms = Transforms(self, options.tf_tolerance, group) if options.servers else None
        self.path = self.create_publisher(Path, "plan", 1)
        self.itself = ActionClient(self, NavigateToPose, "navigate_to_pose", callback_group=group)
        self.create_subscription(PoseStamped, "goal_pose", self.on_pose, 1, callback_group=group)

    def activate(self) -> None:
        """Accept goals once transforms arrive and controller_server responds."""
        if self.transforms is not None and self.following is not None:
            self.transforms.wait()
            print("has transforms", flush=True)  # a failed test shows how far the start came
            self.following.connect()
        self.server = ActionServer(
            self,
            NavigateToPose,
            "navigate_to_pose",
            self.execute,
            callback_group=self.group,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )

    def on_pose(self, pose: PoseStamped) -> None:
        self.itself.send_goal_async(NavigateToPose.Goal(pose=pose))

    def execute(self, handle: Any) -> Any:
        with self.lock:
            self.newest = handle
        began, planned = time.monotonic(), -math.inf
        while True:
            if self.newest is not handle:
                handle.abort()
                return NavigateToPose.Result()
            if handle.is_cancel_requested:
                if self.following is not None:
                    self.following.halt()
                print("ended", time.monotonic(), flush=True)
                handle.canceled()
                return NavigateToPose.Result()
            plans = time.monotonic() - planned > PLAN_SECONDS or self.gives_up
            planned = time.monotonic() if plans else planned
            code = self.step(handle, began, plans=plans)
            if code is not None:
                handle.succeed() if code < 0 else handle.abort()
                return NavigateToPose.Result(error_code=max(0, code))
            time.sleep(PERIOD)

    def step(self, handle: Any, began: float, *, plans: bool) -> int | None:
        """Run one control cycle; return an error code if the goal failed, -1 if it was reached, else None."""
        goal = handle.request.pose
        if self.following is not None and self.transforms is not None:
            pose = self.transforms.pose()
            if pose is None:
                self.following.halt()
                return TF_ERROR if "base_link" in self.transforms.frames else 0
            self.x, self.y, _ = pose
            if goal.header.frame_id.lstrip("/") not in ("map", *self.transforms.frames):
                return 0
        if goal.pose.position.x >= UNREACHABLE:
            return None if time.monotonic() - began < self.patience else NO_PATH
        if plans:
            start = PoseStamped(header=goal.header)
            start.pose.position.x, start.pose.position.y = self.x, self.y
            self.path.publish(Path(header=goal.header, poses=[start, goal]))
        left = math.hypot(goal.pose.position.x - self.x, goal.pose.position.y - self.y)
        self.publish_feedback(handle, left)
        return self.follow(goal, plans=plans) if self.following is not None else self.move(goal, left)

    def follow(self, goal: PoseStamped, *, plans: bool) -> int | None:
        """Drive through controller_server."""
        assert self.following is not None
        if plans:
            start = PoseStamped(header=goal.header)
            start.pose.position.x, start.pose.position.y = self.x, self.y
            late, self.gives_up = self.gives_up, False
            path = Path(header=goal.header, poses=[start, goal])
            if not self.following.send(path, 0.0 if late else ACKNOWLEDGE_SECONDS):
                return 0
        end = self.following.end
        if end is None:
            return None
        return -1 if end.status in (SUCCEEDED, CANCELED) else int(end.result.error_code)

    def move(self, goal: PoseStamped, left: float) -> int | None:
        """Move the point robot."""
        place = goal.pose.position
        step = min(1.0, self.speed * PERIOD / left) if left else 1.0
        self.x, self.y = self.x + step * (place.x - self.x), self.y + step * (place.y - self.y)
        return None if step < 1.0 else -1

    def publish_feedback(self, handle: Any, left: float) -> None:
        feedback = NavigateToPose.Feedback(distance_remaining=left)
        feedback.current_pose.header.frame_id = "map"
        feedback.current_pose.pose.position.x, feedback.current_pose.pose.position.y = self.x, self.y
        handle.publish_feedback(feedback)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("speed", type=float)
    parser.add_argument("patience", type=float)
    parser.add_argument("--servers", action="store_true")
    parser.add_argument("--tf-tolerance", type=float, default=math.inf)
    rclpy.init()
    navigator = Navigator(parser.parse_args())
    signal.signal(signal.SIGUSR1, lambda *_: setattr(navigator, "gives_up", True))
    executor = MultiThreadedExecutor(6)
    executor.add_node(navigator)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        spinner.start()
        navigator.activate()
        print("ready", flush=True)
        while spinner.is_alive():
            spinner.join(PERIOD)  # the main thread handles signals


main()
