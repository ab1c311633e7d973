"""Other robots of the hub, each where its frames say that it is: by the feed ``robots``."""

from __future__ import annotations

from functools import partial
from typing import Any

from bridge.config.sections.web import OtherRobot
from bridge.hub.wire.qos import LATCHED
from bridge.modules.endpoints import Subscription
from bridge.modules.host import Host
from bridge.tf.transform import LATEST
from bridge.web.feeds.frames import FrameFeed, FrameFollower
from bridge.web.feeds.robot import ROBOT_SECONDS, disc, place, points_of_path
from navigation.frames import FramesError
from navigation.gateway.telemetry import PATH

AGE = 3.0
"""Seconds after which a robot of which nothing new is said is not drawn."""


class RobotsFeed(FrameFeed):
    """``robots``: pose, footprint and path of each robot of ``web.robots``, in that order."""

    def __init__(self, host: Host, follower: FrameFollower, robots: tuple[OtherRobot, ...]) -> None:
        super().__init__(host, follower, "robots", ROBOT_SECONDS)
        self._robots = robots
        self._paths: dict[str, list[float]] = {}
        self._ends: list[Subscription] = []

    def open(self) -> None:
        """Follow the frames and the paths."""
        if not self._robots:
            self.put([])
            return
        for robot in self._robots:
            if robot.path:
                take = partial(self._take, robot.name)
                self._ends.append(self._host.node.subscription(robot.path, PATH, take, LATCHED))
        super().open()

    def close(self) -> None:
        """Rest."""
        if not self._robots:
            return
        super().close()
        ends, self._ends = self._ends, []
        for end in ends:
            self._host.node.release(end)
        self._paths.clear()

    def look(self) -> None:
        """Put where they are."""
        self.put([self._seen(robot) for robot in self._robots])

    def _seen(self, robot: OtherRobot) -> dict[str, Any]:
        frames = self._follower.frames
        try:
            pose = frames.transform(frames.map_frame, robot.base_frame, LATEST)
        except FramesError as err:
            return {"name": robot.name, "pose": None, "why": str(err)}
        late = (self._host.clock.now_ns() - pose.stamp_ns) / 1e9 if pose.stamp_ns else 0.0
        if late > AGE:
            return {"name": robot.name, "pose": None, "why": f"nothing new is said of {robot.base_frame}"}
        path = self._paths.get(robot.name, [])
        return {"name": robot.name, "pose": place(pose), "footprint": disc(robot.radius), "path": path}

    def _take(self, name: str, path: dict[str, Any]) -> None:
        self._paths[name] = points_of_path(path)
