"""The feed of obstacles in the local map of the chosen planner, such as people and chairs near the robot."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.config.model import Config
from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.web.feeds.frames import FrameFollower
from bridge.web.feeds.robot import MOST_POINTS, DrivingFeed, TopicsFeed
from navigation.frames import FramesError
from navigation.gateway.telemetry import local_map_topic
from navigation.maps.grid import yaw_of
from navigation.messages import GRID
from navigation.pose import Pose

SECONDS = 0.25
MOST_CELLS = 1 << 20
"""Maximum number of cells of a local map; a larger map is not shown."""

OCCUPIED = 100
"""Value of an occupied cell; lower values are inflation (Nav2's costmap_2d_publisher: lethal 100, inscribed 99)."""


class ObstaclesFeed(TopicsFeed):
    """``obstacles``: the occupied cells of the planner's local map, in the map frame, at most four times a second."""

    def __init__(self, host: Host, config: Config, follower: FrameFollower, driving: DrivingFeed) -> None:
        super().__init__(host, "obstacles")
        self._config, self._follower, self._driving = config, follower, driving
        self._topic = ""
        self._newest: dict[str, Any] | None = None
        self._timer: Timer | None = None
        driving.on_change(self._choose)

    @override
    def open(self) -> None:
        self._follower.begin()
        self._timer = self._host.loop.every(SECONDS, self._refresh)
        self._choose()

    @override
    def close(self) -> None:
        super().close()
        self._topic, self._newest = "", None
        if self._timer is not None:
            self._timer.close()
            self._timer = None
            self._follower.end()

    def _choose(self) -> None:
        if not self.watched:
            return
        section, planner = self._config.navigation, self._driving.planner
        topic = local_map_topic(section, planner) if planner else ""
        if topic != self._topic:
            super().close()
            self._topic = topic
            if topic:
                self.follow(topic, GRID, self._on_grid, LATCHED)
        if not self._driving.drives or not topic:
            self.put({"points": [], "size": 0.0})  # obstacles of the last drive may be outdated

    def _on_grid(self, grid: dict[str, Any]) -> None:
        self._newest = grid

    def _refresh(self) -> None:
        grid, self._newest = self._newest, None
        if grid is None or not self._driving.drives:
            return
        try:
            frame = self._follower.grid_frame(self._topic, grid, MOST_CELLS)
        except FramesError as err:
            self.put(None, str(err))
            return
        self.put({"points": cells_on_map(grid, frame), "size": round(float(grid["info"]["resolution"]), 4)})


def cells_on_map(grid: dict[str, Any], frame: Pose) -> list[float]:
    """Return the centers of the occupied cells as x, y, x, y ...; ``frame``: pose of the grid's frame on the map."""
    info, cells = grid["info"], np.asarray(grid["data"], np.int8)
    width, height = int(info["width"]), int(info["height"])
    if cells.size != width * height or not cells.size:
        return []
    rows, columns = np.nonzero(cells.reshape(height, width) >= OCCUPIED)
    step = max(1, math.ceil(len(rows) / MOST_POINTS))
    x, y = ((part[::step] + 0.5) * float(info["resolution"]) for part in (columns, rows))
    position, orientation = info["origin"]["position"], info["origin"]["orientation"]
    origin = frame @ Pose(float(position["x"]), float(position["y"]), yaw_of(orientation))
    cos, sin = math.cos(origin.theta), math.sin(origin.theta)
    centers = np.stack([origin.x + cos * x - sin * y, origin.y + sin * x + cos * y], axis=1)
    points: list[float] = np.round(centers, 2).reshape(-1).tolist()
    return points
