"""A running RobotPathPlanner, with a local navigator that follows its goals exactly."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from bridge.clock import SYSTEM
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.actions import GoalState
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from bridge.stores.kinds import MAP
from navigation.constraints import Constraints
from navigation.maps.grid import yaw_of
from navigation.pose import Pose
from navigation.status import Fault, PlannerStatus, State, status_message
from tests.peers.navigation.floors import ROOMS, floor
from tests.peers.navigation.served import ACTION, Program, Served
from tests.support.wait import until

PLANNER = "/planner/robot_path_planner"
TICK = 0.02
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)


class Robot(Program):
    """A local navigator on the hub, whose robot follows its goals exactly, and a client of the planner."""

    def __init__(self, hub: Hub, registry: Registry) -> None:
        super().__init__(hub, registry, PLANNER)
        self.x, self.y, self.yaw = 1.0, 1.0, 0.0
        self.goal: Goal | None = None
        self.asked: list[tuple[float, float, Constraints]] = []
        self.fails, self.code = "", Fault.BLOCKED
        self.speed = 3.0
        self._tf = self.node.publisher("/tf", "tf2_msgs/msg/TFMessage")
        self._status = self.node.publisher("/planner/robot_goto/status", "midspan_msgs/msg/NavigationStatus", LATCHED)
        self.node.action_server("/planner/robot_goto/navigate_to_pose", ACTION, self._accept, self._cancel)
        self.beat(TICK, self._tick)

    def _accept(self, goal: Goal) -> bool:
        if self.goal is not None and self.goal.active:
            self.goal.abort()
        self.goal = goal
        pose = goal.goal["pose"]["pose"]["position"]
        self.asked.append((pose["x"], pose["y"], Constraints.from_text(goal.goal["behavior_tree"])))
        goal.execute()
        if self.fails:
            goal.abort({"error_code": int(self.code), "error_msg": self.fails})
        return True

    def report(self, state: State, reason: str) -> None:
        """Publish a status of the current goal that the action cannot express."""
        assert self.goal is not None
        status = status_message(SYSTEM.stamp(), PlannerStatus(state, reason), goal_id=self.goal.id)
        self.loop.call(lambda: self._status.publish(status))

    def _cancel(self, goal: Goal) -> bool:
        self.loop.post(goal.canceled)
        return True

    def _tick(self) -> None:
        goal = self.goal
        if goal is not None and goal.active and goal.status is GoalState.EXECUTING:
            pose = goal.goal["pose"]["pose"]
            dx, dy = pose["position"]["x"] - self.x, pose["position"]["y"] - self.y
            distance = math.hypot(dx, dy)
            fraction = min(1.0, self.speed * TICK / distance) if distance else 1.0
            self.x, self.y = self.x + dx * fraction, self.y + dy * fraction
            if fraction == 1.0:
                self.yaw = yaw_of(pose["orientation"])
                goal.succeed()
        rotation = {"x": 0.0, "y": 0.0, "z": math.sin(self.yaw / 2), "w": math.cos(self.yaw / 2)}
        transform = {"translation": {"x": self.x, "y": self.y, "z": 0.0}, "rotation": rotation}
        header = {"stamp": SYSTEM.stamp(), "frame_id": "map"}
        self._tf.publish({"transforms": [{"header": header, "child_frame_id": "base_link", "transform": transform}]})


class Planning(Served):
    """A running planner."""

    def __init__(self, folder: Path, **more: Any) -> None:
        super().__init__(folder, "robot_path_planner")
        self.robot = Robot(self.far.hub, self.far.registry)
        section = {
            "enabled": True,
            "robot_radius": 0.2,
            "clearance": 0.1,
            "image_hz": 20.0,
            "goal": {"tolerance_lin": 0.05},
            **more,
        }
        self.worker.start(self.config(modules={"robot_path_planner": section}))
        store = self.worker.store
        store.put(MAP, "floor", floor(*ROOMS))
        store.use_map("floor")
        until(lambda: self.planner_status().get("map") == "floor", "the planner has the map", 30)
        until(lambda: self.planner_status()["navigator"]["state"] == "idle", "the local navigator is reachable", 30)

    def planner_status(self) -> dict[str, Any]:
        return self.answer("robot_path_planner")

    def put(self, x: float, y: float) -> None:
        """Put the robot at a place, and wait until the planner has its pose: a later jump would resend a waypoint."""
        self.robot.x, self.robot.y, self.robot.yaw = x, y, 0.0
        at = pytest.approx((x, y, 0.0), abs=1e-6)
        until(lambda: pose_of(self.module)[:3] == at, "the planner has the robot's pose", 30)

    def close(self) -> None:
        self.robot.close()
        super().close()


def pose_of(module: Any) -> Pose:
    """Return the planner's pose of the robot, infinite as long as the pose is unknown."""
    try:
        return module.pose()
    except RuntimeError:
        return Pose(math.inf, math.inf, math.inf)
