"""RobotGoto on a hub, and a robot in a room that follows RobotGoto's commands."""

from __future__ import annotations

import contextlib
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from bridge.clock import SYSTEM
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.messages.velocities import TWIST
from navigation.frames import FramesError
from navigation.planner_module import PlannerModule
from navigation.pose import Pose
from sim.laser import reference
from tests.peers.navigation.served import Program, Served

PLANNER = "/planner/robot_goto"
TICK, TIMEOUT = 0.02, 0.3
WALLS = np.array([[-3.0, -3, 3, -3], [3.0, -3, 3, 3], [3.0, 3, -3, 3], [-3.0, 3, -3, -3]])
BEAMS = 180


class Robot(Program):
    """A holonomic robot with a laser, and a client of RobotGoto."""

    def __init__(self, hub: Hub, registry: Registry) -> None:
        super().__init__(hub, registry, PLANNER)
        self.sees = self.knows = True
        self.cloud: dict[str, Any] | None = None
        self.commands: list[tuple[float, float, float]] = []
        self._until, self._ticked, self._ticks = 0.0, 0.0, 0
        self._tf = self.node.publisher("/tf", "tf2_msgs/msg/TFMessage")
        self._scan = self.node.publisher("/scan", "sensor_msgs/msg/LaserScan")
        self._points = self.node.publisher("/points", "sensor_msgs/msg/PointCloud2")
        latched = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
        self._localized, self._reason = (
            self.node.publisher(f"/localization/{name}", "std_msgs/msg/String", latched)
            for name in ("status", "reason")
        )
        self._commanded = self.node.subscription("/cmd_vel", TWIST, self._command)
        self.stand(0.0, 0.0, 0.0)
        self.beat(TICK, self._tick)

    def stand(self, x: float, y: float, yaw: float) -> None:
        self.x, self.y, self.yaw = x, y, yaw
        self._velocity = (0.0, 0.0, 0.0)

    def subscribe_to(self, type_name: str) -> None:
        """Subscribe to velocities of another type, on the robot's thread."""
        self.node.release(self._commanded)
        self._commanded = self.node.subscription("/cmd_vel", type_name, self._command)

    def localized(self, status: str, reason: str = "") -> None:
        self._localized.publish({"data": status})
        self._reason.publish({"data": reason})

    def _command(self, message: dict[str, Any]) -> None:
        twist = message.get("twist", message)
        linear, angular = twist["linear"], twist["angular"]
        self._velocity = (linear["x"], linear["y"], angular["z"])
        self._until = time.monotonic() + TIMEOUT
        self.commands.append(self._velocity)

    def _tick(self) -> None:
        now = time.monotonic()
        # the real time since the last tick, not TICK, because a busy machine skips ticks
        passed, self._ticked = max(0.0, min(now, self._until) - self._ticked), now
        vx, vy, turn = self._velocity
        self.yaw += turn * passed
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        self.x, self.y = self.x + (c * vx - s * vy) * passed, self.y + (s * vx + c * vy) * passed
        stamp = SYSTEM.stamp()
        # the odometry frame is elsewhere on the map
        frames = [("map", "odom", 5.0, 0.0, 0.0)] if self.knows else []
        frames += [("odom", "base_link", self.x - 5.0, self.y, self.yaw)]
        self._tf.publish({"transforms": [_transform(stamp, *frame) for frame in frames]})
        self._ticks += 1
        if self._ticks % 8 == 0 and self.cloud is not None:
            self._points.publish({"header": {"stamp": stamp, "frame_id": "base_link"}, **self.cloud})
        if self._ticks % 4 == 0 and self.sees:
            angles = -math.pi + np.arange(BEAMS) * 2 * math.pi / BEAMS
            ranges = reference(WALLS, np.zeros((0, 3)), (self.x, self.y, self.yaw), angles, 20.0)
            self._scan.publish({
                "header": {"stamp": stamp, "frame_id": "base_link"},
                "angle_min": -math.pi, "angle_max": math.pi, "angle_increment": 2 * math.pi / BEAMS,
                "range_min": 0.1, "range_max": 20.0, "ranges": ranges.astype(np.float32),
            })  # fmt: skip


def _transform(stamp: Any, parent: str, child: str, x: float, y: float, yaw: float) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    transform = {"translation": {"x": x, "y": y, "z": 0.0}, "rotation": turn}
    return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": transform}


class Goto(Served):
    """A running RobotGoto."""

    def __init__(self, folder: Path, **more: Any) -> None:
        super().__init__(folder, "robot_goto")
        self.robot = Robot(self.far.hub, self.far.registry)
        section = {
            "enabled": True,
            "max_lin_speed": 1.0,
            "max_ang_speed": 180.0,
            "max_lin_acc": 5.0,
            "max_ang_acc": 1000.0,
            "lin_speed_gain": 2.0,
            "ang_speed_gain": 3.0,
            "goal_tolerance_lin": 0.1,
            "goal_tolerance_ang": 5.0,
            "max_waiting_time": 30.0,
            "laser_timeout": 1.5,  # on a loaded machine scans are late
            **more,
        }
        self.worker.start(self.config(modules={"robot_goto": section}))

    @property
    def state(self) -> str:
        return str(self.module.driver.status.state.value)

    def close(self) -> None:
        self.robot.close()
        super().close()


def pose_of(module: PlannerModule) -> Pose | None:
    with contextlib.suppress(FramesError):
        return module.pose()
    return None
