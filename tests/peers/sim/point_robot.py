"""A point robot on the hub, which follows ``/cmd_vel`` and publishes its transforms and empty laser scans."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bridge.clock import SYSTEM
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Durability, Qos
from tests.peers.hub.node import HubNode

PERIOD = 0.02
TIMEOUT = 0.3
_KEPT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
BEAMS = 90


class PointRobot(HubNode):
    """A robot that starts at (0, 0) of the map, facing along x, and publishes a free map.

    Args:
        settings: settings of the robot's session.
        size: of the map, meters along x and y; the robot starts 5 m from the left border, at the middle of y.
        localized: whether the robot publishes the odometry's frame in the map; otherwise a localizer has to.
    """

    def __init__(self, settings: HubSettings, size: tuple[float, float], *, localized: bool = True) -> None:
        self._localized = localized
        self.x = self.y = self.theta = 0.0
        self._speed, self._turn, self._silent = 0.0, 0.0, 0.0
        super().__init__(settings)
        node = self.node
        self._tf = node.publisher("/tf", "tf2_msgs/msg/TFMessage", Qos(depth=10))
        self._scan = node.publisher("/scan", "sensor_msgs/msg/LaserScan", Qos(depth=5))
        self._map = node.publisher("/map", "nav_msgs/msg/OccupancyGrid", _KEPT)
        self._map.publish(_free(size))
        node.subscription("/cmd_vel", "geometry_msgs/msg/Twist", self._on_velocity, Qos(depth=1))
        self._count = 0
        self.loop.every(PERIOD, self._step)

    def _on_velocity(self, message: dict[str, Any]) -> None:
        self._speed, self._turn, self._silent = message["linear"]["x"], message["angular"]["z"], 0.0

    def _step(self) -> None:
        self._silent += PERIOD
        if self._silent > TIMEOUT:
            self._speed = self._turn = 0.0
        self.theta += self._turn * PERIOD
        self.x += self._speed * PERIOD * math.cos(self.theta)
        self.y += self._speed * PERIOD * math.sin(self.theta)
        self._count += 1
        stamp = SYSTEM.stamp()
        if self._count % 2 == 0:
            turn = {"z": math.sin(self.theta / 2), "w": math.cos(self.theta / 2)}
            at = {"translation": {"x": self.x, "y": self.y}, "rotation": turn}
            frames = [_frame(stamp, "odom", "base_link", at)]
            if self._localized:
                frames.append(_frame(stamp, "map", "odom", {"rotation": {"w": 1.0}}))
            self._tf.publish({"transforms": frames})
        if self._count % 5 == 0:
            step = 2 * math.pi / BEAMS
            self._scan.publish({
                "header": {"stamp": stamp, "frame_id": "base_link"},
                "angle_min": -math.pi, "angle_max": math.pi - step, "angle_increment": step,
                "range_min": 0.05, "range_max": 10.0, "ranges": np.full(BEAMS, np.inf, np.float32),
            })  # fmt: skip


def _frame(stamp: dict[str, int], parent: str, child: str, at: dict[str, Any]) -> dict[str, Any]:
    return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": at}


def _free(size: tuple[float, float], resolution: float = 0.1) -> dict[str, Any]:
    width, height = (round(side / resolution) for side in size)
    origin = {"position": {"x": -5.0, "y": -size[1] / 2}, "orientation": {"w": 1.0}}
    info = {"resolution": resolution, "width": width, "height": height, "origin": origin}
    return {"header": {"frame_id": "map"}, "info": info, "data": np.zeros(width * height, np.int8)}
