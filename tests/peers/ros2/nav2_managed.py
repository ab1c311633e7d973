"""Stand-ins for further Nav2 servers (Jazzy): lifecycle nodes, their manager, docking_server and waypoint_follower.

They follow the public sources (ros-navigation/navigation2, branch jazzy: lifecycle_manager.cpp, waypoint_follower.cpp,
simple_action_server.hpp, docking_server.cpp). The nodes are rclpy's real lifecycle nodes. All action servers exist
from configuration on, and reject goals while their node is not active; shutdown and reset remove them.

- `NavigateToPose` is reached at once.
- `NavigateThroughPoses`: each pose is reached after `DRIVE_SECONDS`; x from 900 on is never reached.
- `DockRobot`: the dock ``home``, or a dock's pose with x below 900, is reached after `DRIVE_SECONDS`; the dock ``gone``
  fails with 901; any other goal drives until it is canceled. `UndockRobot` drives for `DRIVE_SECONDS`.
- `FollowWaypoints`: each pose is reached after `DRIVE_SECONDS`; x below 0 is missed; x from 900 on is never reached.

The servers that drive publish ``/cmd_vel``. Output: ``ready``, and ``goal`` with the action and the goal's fields.
Usage: nav2_managed.py
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav2_msgs.action import DockRobot, FollowWaypoints, NavigateThroughPoses, NavigateToPose, UndockRobot
from nav2_msgs.msg import MissedWaypoint
from nav2_msgs.srv import ManageLifecycleNodes
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn
from rclpy.node import Node
from std_srvs.srv import Trigger

DRIVE_SECONDS, PERIOD, SPEED, FAR = 0.3, 0.05, 0.3, 900.0
DOCK_NOT_IN_DB, TASK_EXECUTOR_FAILED = 901, 601


class Server(LifecycleNode):
    """A lifecycle node with actions, each given by type, name and the method that executes a goal."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.group = ReentrantCallbackGroup()
        self.active = False
        self.servers: list[ActionServer] = []
        self.velocity = self.create_publisher(Twist, "cmd_vel", 1)

    def actions(self) -> list[tuple[Any, str, Callable[[Any], Any]]]:
        """Return the node's actions."""
        return []

    def on_configure(self, _state: State) -> TransitionCallbackReturn:
        for type_, name, execute in self.actions():
            self.servers.append(
                ActionServer(
                    self,
                    type_,
                    name,
                    execute,
                    callback_group=self.group,
                    goal_callback=lambda _goal: GoalResponse.ACCEPT if self.active else GoalResponse.REJECT,
                    cancel_callback=lambda _goal: CancelResponse.ACCEPT,
                )
            )
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, _state: State) -> TransitionCallbackReturn:
        self.active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, _state: State) -> TransitionCallbackReturn:
        self.active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, _state: State) -> TransitionCallbackReturn:
        while self.servers:
            self.servers.pop().destroy()
        return TransitionCallbackReturn.SUCCESS

    def drive(self, handle: Any, seconds: float) -> bool:
        """Drive for some seconds; return False if the goal was canceled."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.active:
            if handle.is_cancel_requested:
                self.velocity.publish(Twist())
                return False
            twist = Twist()
            twist.linear.x = SPEED
            self.velocity.publish(twist)
            time.sleep(PERIOD)
        self.velocity.publish(Twist())
        return True


class Navigator(Server):
    """The stand-in for bt_navigator."""

    def actions(self) -> list[tuple[Any, str, Callable[[Any], Any]]]:
        return [
            (NavigateToPose, "navigate_to_pose", self.navigate),
            (NavigateThroughPoses, "navigate_through_poses", self.navigate_through),
        ]

    def navigate(self, handle: Any) -> Any:
        show("navigate_to_pose", {})
        handle.succeed()
        return NavigateToPose.Result()

    def navigate_through(self, handle: Any) -> Any:
        poses = handle.request.poses
        show("navigate_through_poses", {"x": [pose.pose.position.x for pose in poses]})
        for index, pose in enumerate(poses):
            left = len(poses) - index
            handle.publish_feedback(NavigateThroughPoses.Feedback(number_of_poses_remaining=left))
            if not self.drive(handle, DRIVE_SECONDS if pose.pose.position.x < FAR else 1e6):
                handle.canceled()
                return NavigateThroughPoses.Result()
        handle.succeed()
        return NavigateThroughPoses.Result()


class Docking(Server):
    """The stand-in for docking_server."""

    def actions(self) -> list[tuple[Any, str, Callable[[Any], Any]]]:
        return [(DockRobot, "dock_robot", self.dock), (UndockRobot, "undock_robot", self.undock)]

    def dock(self, handle: Any) -> Any:
        goal = handle.request
        x = goal.dock_pose.pose.position.x
        show(
            "dock_robot",
            {"id": goal.dock_id if goal.use_dock_id else None, "type": goal.dock_type, "x": x,
             "frame": goal.dock_pose.header.frame_id, "stages": goal.navigate_to_staging_pose},
        )  # fmt: skip
        if goal.use_dock_id and goal.dock_id == "gone":
            handle.abort()
            return DockRobot.Result(success=False, error_code=DOCK_NOT_IN_DB)
        handle.publish_feedback(DockRobot.Feedback(state=DockRobot.Feedback.CONTROLLING))
        near = goal.dock_id == "home" if goal.use_dock_id else x < FAR
        if not self.drive(handle, DRIVE_SECONDS if near else 1e6):
            handle.canceled()
            return DockRobot.Result(success=False)
        handle.succeed()
        return DockRobot.Result(success=True)

    def undock(self, handle: Any) -> Any:
        show("undock_robot", {"type": handle.request.dock_type})
        driven = self.drive(handle, DRIVE_SECONDS)
        handle.succeed() if driven else handle.canceled()
        return UndockRobot.Result(success=driven)


class Waypoints(Server):
    """The stand-in for waypoint_follower."""

    def actions(self) -> list[tuple[Any, str, Callable[[Any], Any]]]:
        return [(FollowWaypoints, "follow_waypoints", self.follow)]

    def follow(self, handle: Any) -> Any:
        result = FollowWaypoints.Result()
        poses = handle.request.poses
        show("follow_waypoints", {"x": [pose.pose.position.x for pose in poses]})
        for index, pose in enumerate(poses):
            handle.publish_feedback(FollowWaypoints.Feedback(current_waypoint=index))
            x = pose.pose.position.x
            if x < 0:
                result.missed_waypoints.append(MissedWaypoint(index=index, goal=pose, error_code=208))
            elif not self.drive(handle, DRIVE_SECONDS if x < FAR else 1e6):
                handle.canceled()
                return result
        handle.succeed()
        return result


class Manager(Node):
    """The stand-in for lifecycle_manager_navigation, which commands its nodes in order, and fails if one refuses."""

    def __init__(self, nodes: list[Server]) -> None:
        super().__init__("lifecycle_manager_navigation")
        self.nodes = nodes
        self.create_service(ManageLifecycleNodes, "~/manage_nodes", self.on_command)
        self.create_service(Trigger, "~/is_active", self.on_question)

    def on_command(self, request: Any, reply: Any) -> Any:
        steps = {
            request.STARTUP: ("configure", "activate"),
            request.PAUSE: ("deactivate",),
            request.RESUME: ("activate",),
            request.RESET: ("deactivate", "cleanup"),
            request.SHUTDOWN: ("deactivate", "cleanup", "shutdown"),
        }[request.command]
        down = request.command in (request.RESET, request.SHUTDOWN)
        reply.success = all(self.change(node, step, lenient=down) for step in steps for node in self.nodes)
        return reply

    def change(self, node: Server, step: str, *, lenient: bool) -> bool:
        """Request a transition; if ``lenient``, skip a transition that the node's state does not have."""
        try:
            return bool(getattr(node, f"trigger_{step}")() is TransitionCallbackReturn.SUCCESS)
        except Exception as err:
            print("transition", node.get_name(), step, err, flush=True)
            return lenient

    def on_question(self, _request: Any, reply: Any) -> Any:
        reply.success = all(node.active for node in self.nodes)
        return reply


def show(action: str, goal: dict[str, Any]) -> None:
    print("goal", action, json.dumps(goal), flush=True)


def main() -> None:
    rclpy.init()
    nodes = [Navigator("bt_navigator"), Waypoints("waypoint_follower"), Docking("docking_server")]
    executor = MultiThreadedExecutor(6)
    for node in (*nodes, Manager(nodes)):
        executor.add_node(node)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        spinner.start()
        print("ready", flush=True)
        while spinner.is_alive():
            spinner.join(PERIOD)


main()
