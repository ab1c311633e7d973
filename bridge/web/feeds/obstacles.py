"""The feed of what the chosen planner takes for obstacles: people, chairs, what its local map has about the robot."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

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
"""Of a local map; a larger one is not shown."""

OCCUPIED = 100
"""What the robot cannot be on; less is the room about it (Nav2's costmap_2d_publisher: lethal 100, inscribed 99)."""


class ObstaclesFeed(TopicsFeed):
    """``obstacles``: the occupied cells of the planner's local map, on the map, at most four times a second."""

    def __init__(self, host: Host, config: Config, follower: FrameFollower, driving: DrivingFeed) -> None:
        super().__init__(host, "obstacles")
        self._config, self._follower, self._driving = config, follower, driving
        self._topic = ""
        self._newest: dict[str, Any] | None = None
        self._timer: Timer | None = None
        driving.on_change(self._choose)

    def open(self) -> None:
        """Follow the planner that is chosen, and the frames."""
        self._follower.begin()
        self._timer = self._host.loop.every(SECONDS, self._look)
        self._choose()

    def close(self) -> None:
        """Rest."""
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
                self.follow(topic, GRID, self._take, LATCHED)
        if not self._driving.drives or not topic:
            self.put({"points": [], "size": 0.0})  # what was there when it last drove need not be there now

    def _take(self, grid: dict[str, Any]) -> None:
        self._newest = grid

    def _look(self) -> None:
        grid, self._newest = self._newest, None
        if grid is None or not self._driving.drives:
            return
        info = grid["info"]
        if int(info["width"]) * int(info["height"]) > MOST_CELLS:
            self.put(None, f"{self._topic} has {info['width']} x {info['height']} cells; up to {MOST_CELLS} are shown")
            return
        try:
            frame = self._follower.frames.on_map(str(grid["header"]["frame_id"]).lstrip("/"))
        except FramesError as err:
            self.put(None, str(err))
            return
        self.put({"points": cells_on_map(grid, frame), "size": round(float(info["resolution"]), 4)})


def cells_on_map(grid: dict[str, Any], frame: Pose) -> list[float]:
    """The middles of the occupied cells, x, y, x, y ...; ``frame``: where the grid's frame is on the map."""
    info, cells = grid["info"], np.asarray(grid["data"], np.int8)
    width, height = int(info["width"]), int(info["height"])
    if cells.size != width * height or not cells.size:
        return []
    rows, columns = np.nonzero(cells.reshape(height, width) >= OCCUPIED)
    step = max(1, math.ceil(len(rows) / MOST_POINTS))
    x, y = ((part[::step] + 0.5) * float(info["resolution"]) for part in (columns, rows))
    place, turn = info["origin"]["position"], info["origin"]["orientation"]
    origin = frame @ Pose(float(place["x"]), float(place["y"]), yaw_of(turn))
    cos, sin = math.cos(origin.theta), math.sin(origin.theta)
    ends = np.stack([origin.x + cos * x - sin * y, origin.y + sin * x + cos * y], axis=1)
    found: list[float] = np.round(ends, 2).reshape(-1).tolist()
    return found
